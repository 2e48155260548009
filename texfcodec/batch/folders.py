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
    """Makes the folder for results, and locks it against other runs; the system drops the lock with its process.

    Raises InputError TXF-O17 if another run is at work there, TXF-O01 to O04 if there can be no such folder.
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
    """A new folder below a folder that only_run() holds, on the same file system.

    PROBE in it holds its name, by which workers recognise the same folder. Folders that killed runs have left are removed first.
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
