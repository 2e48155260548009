"""The child's side of children.py: it caps its memory, ends with its parent, and becomes the given program.

    python -m texfcodec.batch.child MEMORY SCRIPT ARGUMENT...
    python -m texfcodec.batch.child MEMORY -m MODULE ARGUMENT...

MEMORY: largest bytes of data, 0 for no cap. The parent's end of stdin closes when the parent ends, in whatever way.
"""

import os
import runpy
import signal
import sys
import threading


def end_with_parent() -> None:
    """Makes this process, and all that it has started, end when stdin closes."""
    threading.Thread(target=_wait_for_the_end, daemon=True).start()


def _wait_for_the_end():
    os.read(0, 1)
    if hasattr(os, "killpg") and os.getpgid(0) == os.getpid():  # with whatever it has started
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def cap_data(size: int) -> bool:
    """Cap the data segment of this process (RLIMIT_DATA) at size bytes. Return False if the system has no such cap.

    Data is memory that the process writes to, not memory that it only reserves.
    """
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (size, size))
    except (ImportError, OSError, ValueError):
        return False
    return True


def main() -> None:
    """Becomes the program of the command line."""
    size, *words = sys.argv[1:]
    end_with_parent()
    if int(size):
        cap_data(int(size))
    if words[0] == "-m":
        sys.argv = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv, sys.path[0] = words, os.path.dirname(words[0])
        runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    main()
