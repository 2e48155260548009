"""The folder of attempts, inside the folder for results: for one run at a time, and removed at its end."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core import cleanup
from ..errors import InputError

WORK, LOCK, PROBE = ".texf-work", ".texf-lock", "probe"  # the first two are nobody else's: WORK is emptied


@contextmanager
def only_run(out: Path) -> Iterator[None]:
    """Context manager: create the folder for results and lock it against other runs. The lock ends with the process.

    Raises InputError TXF-O17 if another run uses the folder, TXF-O01 to O04 if it cannot be created.
    """
    from ..io.output_files import as_input_error

    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = open(out / LOCK, "wb")
    except OSError as error:
        raise as_input_error(error, out) from None
    with lock:
        try:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError("TXF-O17", f"another run is using {out}", path=str(out)) from None
        except (ImportError, OSError):  # not a POSIX system, or a disk without locks: nobody looks after it there
            pass
        yield


@contextmanager
def work_room(out: Path) -> Iterator[Path]:
    """Context manager: a new folder for attempts below out, the folder for results, which only_run() has locked.

    The file PROBE in it holds the folder's name, by which workers recognise it. Folders of killed runs are removed first.
    """
    shutil.rmtree(out / WORK, ignore_errors=True)
    name = os.urandom(8).hex()
    room = out.resolve() / WORK / name
    cleanup.hold_folder(room.parent)
    try:
        room.mkdir(parents=True)
        (room / PROBE).write_text(name, encoding="utf-8")
        yield room
    finally:
        shutil.rmtree(room.parent, ignore_errors=True)
        cleanup.drop_folder(room.parent)
