"""Ctrl-C at any moment: the temporaries are removed, one line is printed, and the process ends with 130.

No exception is raised. Python raises KeyboardInterrupt wherever the main thread happens to be, and some libraries cannot handle
it: numba calls Python while it converts results, and continues with the exception set. While a kernel runs, nothing is raised
until it returns. So the handler does nothing, and a thread that waits for the signal's number ends the process.

The handler is active from the first line of texfcodec.cli on if the process is one of the tools. Before that line the interpreter
starts, computes its paths and, with `python -m`, imports runpy; an interrupt then gets Python's own answer.
"""

import _signal  # not signal, which imports enum and what that needs: time in which Python's own handler would answer
import _thread
import os
import sys

from ..core import cleanup
from ..errors import EXIT_INTERRUPTED, EXIT_OK

CODE = "TXF-C02"
NOTHING_WRITTEN = "interrupted; nothing was written"
KEPT = "interrupted; finished work is kept, and the same command resumes it"
INCOMPLETE = "interrupted; the output is incomplete"
CLOSED = "closed"


class Talk:
    """State of the command, which the thread that answers Ctrl-C reads.

    partly: a pipe or device may have received a part; kept: finished results are kept; bar: a progress bar is on the terminal;
    closes: Ctrl-C is the intended end of the command; quiet: it prints nothing then; errors: the descriptor for errors as JSON,
    None before the command line is read; installed: the handler is active.
    """

    errors: int | None = None
    partly, kept, bar, closes, quiet, installed = False, False, False, False, False, False


def is_program() -> bool:
    """Return whether this process is one of the tools, by its command line: `texf-enc ...` or `python -m texfcodec.cli.enc
    ...`."""
    name = sys.argv[0] if sys.argv else ""
    if name == "-m":  # while runpy looks for the module
        return any(word.removeprefix("-m").startswith("texfcodec.cli.") for word in sys.orig_argv[1:4])
    return os.path.basename(name).startswith("texf-")


def install() -> None:
    """Handles SIGINT from here on, unless the caller of the process ignores it or another handler is set."""
    if _signal.getsignal(_signal.SIGINT) is not _signal.default_int_handler:
        return
    try:
        ear, mouth = os.pipe()
        os.set_blocking(mouth, False)
        _signal.set_wakeup_fd(mouth)
        _signal.signal(_signal.SIGINT, lambda *_: None)
    except (ValueError, OSError, AttributeError):  # not the main thread, no more files, an old Windows: Python's way stays
        return
    try:
        _thread.start_new_thread(_wait, (ear,))
        Talk.installed = True
    except RuntimeError:  # no more threads
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def ignore() -> None:
    """Ignores SIGINT at the end of a process with a code of its own; Python would give SIGINT back to the system."""
    if Talk.installed:
        _signal.signal(_signal.SIGINT, _signal.SIG_IGN)


def _wait(ear):
    """Body of the thread. After the outcome a first interrupt is ignored, but not a second one: the reader of our output may
    hang."""
    interrupts = 0
    while True:
        if _signal.SIGINT not in os.read(ear, 64):
            continue
        interrupts += 1
        cleanup.GATE.acquire()
        if Talk.closes:
            cleanup.remove_all()
            _say_closed()
            os._exit(EXIT_OK)
        if not cleanup.is_finished():
            cleanup.remove_all()
            _say()
        elif interrupts < 2:
            cleanup.GATE.release()
            continue
        os._exit(EXIT_INTERRUPTED)


def error_line(message: str) -> bytes:
    """Return the error of an interrupt as bytes, a line for people or JSON with --json, without using the json module."""
    if "--json" in sys.argv[1:]:
        error = f'"code": "{CODE}", "message": "{message}", "exit_code": {EXIT_INTERRUPTED}'
        return f'{{"schema": 1, "error": {{{error}}}}}\n'.encode()
    return f"error {CODE}: {message}\n".encode()


def message() -> str:
    """A sentence on the state of the output."""
    return KEPT if Talk.kept else INCOMPLETE if Talk.partly else NOTHING_WRITTEN


def _say():
    line, target = error_line(message()), 2
    if "--json" in sys.argv[1:]:
        target = Talk.errors or _guessed_target()
    elif Talk.bar:
        line = b"\x1b[?25h\n" + line
    try:
        os.write(target, line)
    except OSError:
        pass


def _say_closed():
    if not Talk.quiet:
        try:
            os.write(2, f"{CLOSED}\n".encode())
        except OSError:
            pass


def _guessed_target():
    """Descriptor before the command line is read: stdout, or stderr if a lone dash may stand for stdout."""
    return 2 if "-" in sys.argv[2:] else 1
