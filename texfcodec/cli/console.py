"""Shared parts of the command lines: exit codes, errors, progress, output and the facts at the end of every report."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from ..core import cleanup
from ..core.json_text import json_text
from ..errors import EXIT_INTERNAL, EXIT_INTERRUPTED, EXIT_IO, EXIT_LIMIT, EXIT_USAGE, InputError, LimitError, TexfError
from ..precompile import first_run
from . import interrupts

if TYPE_CHECKING:
    from ..report import Report

SCHEMA = 1
SIGNS = {"warnings": "warning", "dropped": "not coded", "remarks": "note"}  # what the lines of a report begin with
TRACEBACK = "TEXF_TRACEBACK"  # set to 1 to see where an internal error comes from
BEGIN = time.perf_counter()
STYLE = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Console:
    """Output of a command: results go to stdout, everything else to stderr. With --json errors go with the results. arguments:
    words of the command line, which may contain --json and --quiet."""

    def __init__(self, arguments: list[str]) -> None:
        self.as_json, self.quiet = "--json" in arguments, "--quiet" in arguments
        interrupts.Talk.errors, interrupts.Talk.kept, interrupts.Talk.closes = 1, False, False
        self.results = sys.stdout

    def stdout_is_taken(self) -> None:
        """Sends results, and errors as JSON, to stderr, because the output itself goes to stdout."""
        self.results, interrupts.Talk.errors = sys.stderr, 2

    def note(self, text: str) -> None:
        """Print a line of prose on stderr, unless --quiet."""
        if not self.quiet:
            click.echo(printable(text), err=True)

    def note_first_run(self, seconds: int) -> None:
        """Announce that kernels will be compiled, unless they are cached. seconds: about how long it takes, such as ENCODING."""
        if line := first_run(seconds):
            self.note(line)

    def result(self, facts: dict, lines: Iterable[str]) -> None:
        """Print the result of the command: with --json the facts as one JSON object, else the lines, unless --quiet."""
        cleanup.finish()
        if self.as_json:
            text = json_text({"schema": SCHEMA, **facts})
        elif self.quiet:
            return
        else:
            text = "\n".join(printable(line) for line in lines)
        click.echo(text, file=self.results)
        self.results.flush()

    def warnings(self, report: Report) -> None:
        """Print a report's warnings, dropped properties and remarks on stderr, one line each."""
        for name, sign in SIGNS.items():
            for text in getattr(report, name):
                self.note(f"{sign}: {text}")

    def fail(self, code: str, message: str, exit_code: int, **details: object) -> int:
        """Print an error and return exit_code. code: TXF-...; details: its other facts by name, such as value and allowed."""
        cleanup.finish()
        if self.as_json:
            error = {"code": code, "message": message, "exit_code": exit_code, **details}
            click.echo(json_text({"schema": SCHEMA, "error": error}), file=self.results)
        else:
            facts = ", ".join(f"{k} {v}" for k, v in details.items() if k != "remedy")
            more = (f" ({facts})" if facts else "") + (f"; {details['remedy']}" if "remedy" in details else "")
            click.echo(printable(f"error {code}: {message}{more}"), err=True)
        return exit_code

    def progress(self) -> AbstractContextManager[Report]:
        """Context manager: a Report whose stages are shown by a bar if stderr is a terminal, else by a line now and then."""
        from ..report import Report
        from . import progress

        if not self.quiet and sys.stderr.isatty():
            return progress.bar()
        return nullcontext(Report()) if self.quiet or self.as_json else progress.lines()  # JSON: no prose


def run(command: click.Command, arguments: list[str] | None = None) -> NoReturn:
    """Run a click command and exit with one of the codes of errors.py; every exception becomes an error message. arguments:
    words after the program's name; sys.argv by default, and Ctrl-C is then handled here."""
    cleanup.begin()
    if arguments is None:  # the process is this command; otherwise Ctrl-C is its caller's
        interrupts.install()
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    console = Console(arguments)
    code = _guarded(command, arguments, console)
    cleanup.finish()
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains at its end
        code = code or EXIT_IO
    interrupts.ignore()
    sys.exit(code)


def _guarded(command, arguments, console):
    try:
        code = command.main(args=arguments, prog_name=command.name, standalone_mode=False, obj=console)
        return code if isinstance(code, int) else 0
    except click.ClickException as error:
        return console.fail("TXF-C01", error.format_message().rstrip(".") + f"; see {command.name} --help", EXIT_USAGE)
    except TexfError as error:
        return console.fail(error.code, error.message, error.exit_code, **error.details | _remedy(error))
    except (click.Abort, KeyboardInterrupt) as error:
        if isinstance(error.__cause__, EOFError):  # nobody asks for input: click takes it for an interrupt
            return _internal(console, error.__cause__)
        return console.fail(interrupts.CODE, interrupts.message(), EXIT_INTERRUPTED)
    except BrokenPipeError:
        return EXIT_IO
    except MemoryError as error:
        return console.fail("TXF-L09", "there is not enough memory" + getattr(error, "advice", ""), EXIT_LIMIT)
    except Exception as error:
        return _internal(console, error)


def _internal(console, error):
    if os.environ.get(TRACEBACK, "0") not in ("", "0"):
        raise error
    what = f"{type(error).__name__}: {error}"[:300]
    return console.fail("TXF-C04", f"internal error; run again with {TRACEBACK}=1 and report the output", EXIT_INTERNAL,
                        reason=what)


def _remedy(error):
    """{"remedy": text} for a limit, whose message does not contain it; {} for other errors."""
    from ..findings import BY_CODE

    return {"remedy": BY_CODE[error.code].remedy} if isinstance(error, LimitError) and error.code in BY_CODE else {}


def printable(text: str) -> str:
    """Return the text with control characters escaped, because names in a file must not steer the terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def check_output(path: str, inputs: Iterable[str] = ()) -> None:
    """Raise InputError if an output path cannot be written or is one of the inputs. "-" (stdout) and devices pass."""
    from ..io.output_files import check_target

    if path != "-" and not is_device(path):
        check_target(Path(path), [name for name in inputs if name != "-"])


def write_output(path: str, data: bytes, inputs: Iterable[str] = ()) -> None:
    """Write data to stdout ("-"), to a device, or to a file, under a temporary name beside the path that is then renamed.

    It must be the last step of a command. Raises InputError if the path is one of the inputs or cannot be written.
    """
    from ..io.output_files import as_input_error, write_all

    cleanup.last_step()
    if path != "-" and not is_device(path):
        write_all(Path(path).parent, [(Path(path).name, [data])], inputs)
        return
    interrupts.Talk.partly = True
    try:
        if path == "-":
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
        else:
            with open(path, "wb") as file:
                file.write(data)
    except BrokenPipeError:
        raise InputError("TXF-C03", "the reader of the output closed the pipe", path=path) from None
    except OSError as error:
        raise as_input_error(error, Path(path)) from None
    cleanup.finish()


def is_device(path: str) -> bool:
    """Return whether a path names a device or a pipe, which must be written to and not replaced by a file."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def run_facts(report: Report) -> dict[str, Any]:
    """Return the last entries of every JSON result: seconds by stage, peak memory, warnings, dropped and remarks of a report."""
    from ..report import peak_memory_bytes

    return {"seconds": seconds_of(report), "peak_memory_bytes": peak_memory_bytes(), "warnings": report.warnings,
            "dropped": report.dropped, "remarks": report.remarks}


def seconds_of(report: Report) -> dict[str, float]:
    """Return the seconds of a report by stage, rounded for output, and under "total" those of the whole command so far."""
    stages = {name: round(value, 4) for name, value in report.seconds.items()}
    return {**stages, "total": round(time.perf_counter() - BEGIN, 4)}


def timing_line(seconds: dict[str, float], peak: int | None) -> str:
    """Return one line for people with the seconds, in total and by stage, and the peak memory. seconds: as seconds_of() returns
    them; peak: bytes, None if unknown."""
    stages = ", ".join(f"{name} {value:.2f}" for name, value in seconds.items() if name != "total" and value >= 0.005)
    return f"{seconds['total']:.2f} s ({stages})" + (f", peak memory {peak / 1e6:.0f} MB" if peak else "")
