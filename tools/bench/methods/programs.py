"""Outside programs for methods: where they are, and their runs with a time limit, which leave no process behind.

A run is this file called as a program, in a process group of its own: it starts the command and ends the whole group when its
stdin closes. So a run ends with whoever started it, however that ends.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from functools import lru_cache
from pathlib import Path

LINE = 300  # characters of what a program said that are told
VERSION_SECONDS = 20


class ProgramError(Exception):
    """A program failed; the message is a sentence that says how."""


def program_of(options, variable, name):
    """Return a program as words of a command line: options["program"], an environment variable, or name on PATH; None if none is
    set. The first two may be several words, as in "node cli.js"."""
    given = options.get("program") or os.environ.get(variable)
    if not given:
        path = shutil.which(name)
        return (path,) if path else None
    words = (given,) if Path(given).is_file() else tuple(shlex.split(given))
    path = shutil.which(words[0]) if words else None
    return (path, *words[1:]) if path else None


def run_program(command, log, seconds):
    """Run a command, a list of words, with its output in a new file log. Raises ProgramError if it fails or exceeds seconds."""
    name = Path(command[0]).name
    with open(log, "wb") as said:
        child = subprocess.Popen([sys.executable, "-S", "-E", __file__, *command], stdin=subprocess.PIPE, stdout=said,
                                 stderr=said, start_new_session=True)
        try:
            code = child.wait(seconds)
        except subprocess.TimeoutExpired:
            raise ProgramError(f"{name} did not end within {seconds} s") from None
        finally:
            _end(child)
            child.stdin.close()
    if code:
        raise ProgramError(f"{name} ended with exit code {code}: {_last_line(log)}")


def _end(child):
    """Ends a run that goes on."""
    if child.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()
        child.wait()


def _last_line(log):
    """The last line of a log that speaks of an error, else the last one. What node says last of a crash is its own version."""
    lines = [line for line in Path(log).read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    telling = [line for line in lines if "error" in line.lower()] or lines
    return re.sub(r"\x1b\[[0-9;]*m", "", telling[-1]).strip()[:LINE] if telling else "it said nothing"


@lru_cache(maxsize=8)
def version_of(command):
    """Return what a command, a tuple of words, prints on stdout, stripped; "" if it fails."""
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=VERSION_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.decode(errors="replace").strip()[:LINE] if done.returncode == 0 else ""


def _guard(command):
    """Runs a command and returns its exit code, 128 and the number for a signal; ends the group when stdin closes."""
    try:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    except OSError as error:
        print(f"error: it cannot be started: {error}", file=sys.stderr)
        return 127
    threading.Thread(target=_end_with_stdin, args=(child,), daemon=True).start()
    code = child.wait()
    return 128 - code if code < 0 else code


def _end_with_stdin(child):
    while os.read(0, 1):
        pass
    if hasattr(os, "killpg") and os.getpgid(0) == os.getpid():
        os.killpg(0, signal.SIGKILL)
    child.kill()


if __name__ == "__main__":
    sys.exit(_guard(sys.argv[1:]))
