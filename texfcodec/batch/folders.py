"""The folder in which attempts are made, inside the one for results: one run at a time, and nothing of it stays behind."""

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
    """Makes the folder for results, and keeps others out of it; the system drops the lock with its process. Raises InputError
    TXF-O17 where another run is at work there, TXF-O01 to O04 where there can be no such folder."""
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
    """A new folder below a folder that only_run() holds, on the same file system. PROBE in it holds its name, by which others
    know that they see the same folder. What killed runs have left goes first."""
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
