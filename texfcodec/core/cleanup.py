"""Removes temporary files and folders and ends child processes when the process is interrupted.

Files are created and renamed only under GATE. The thread that ends the process (cli/interrupts.py) takes GATE and keeps it, so
that nothing new appears while remove_all() runs. Slow imports are deferred: this module must be ready before the first Ctrl-C.
"""

from __future__ import annotations

import _thread
import os

TYPE_CHECKING = False  # to a type checker it is true; the module typing takes long to import
if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Iterable
    from os import PathLike
    from typing import BinaryIO, TypeVar

    Child = TypeVar("Child")

GATE = _thread.allocate_lock()
_paths: set = set()
_folders: set = set()
_children: set = set()


class _Stage:
    """State of the command. last: the next rename is the command's last step; done: the outcome is in place, and an interrupt has
    no effect; ending: an interrupt is being handled, and the process is about to end."""

    last = done = ending = False


def begin() -> None:
    """Marks the start of a command: nothing is written yet."""
    with GATE:
        _Stage.last = _Stage.done = _Stage.ending = False


def last_step() -> None:
    """Marks the next rename as the last step: once it has succeeded, the command is done."""
    _Stage.last = True


def finish() -> None:
    """Marks the command as done: from here on an interrupt has no effect. Blocks forever if an interrupt is being handled."""
    with GATE:
        _Stage.done = True


def is_finished() -> bool:
    """Return whether the outcome of the command is in place."""
    return _Stage.done


def is_ending() -> bool:
    """Return whether an interrupt has ended the children of this process. Their exit codes are then meaningless."""
    return _Stage.ending


def new_file(path: PathLike) -> BinaryIO:
    """Open a new temporary file for binary writing, which an interrupt removes. path: its name, which must not exist yet; the
    caller passes it to rename_all() or remove() later."""
    with GATE:
        _paths.add(path)
        return open(path, "xb")


def rename_all(names: Iterable[tuple[PathLike, PathLike]]) -> None:
    """Renames temporary files in order. names: [(temporary, final)]. If a rename fails, the new files of the renames before it
    are removed again, so that no incomplete set remains."""
    with GATE:
        new = []
        try:
            for temporary, final in names:
                is_new = not os.path.lexists(final)
                os.replace(temporary, final)
                new += [final] * is_new
        except OSError:
            for final in new:
                _unlink(final)
            raise
        _paths.difference_update(temporary for temporary, _ in names)
        _Stage.done = _Stage.done or _Stage.last


def remove(path: PathLike) -> None:
    """Removes a temporary file, if it is there."""
    with GATE:
        _unlink(path)
        _paths.discard(path)


class Folder:
    """Context manager: a new temporary folder for this user only, as tempfile.TemporaryDirectory. Yields its path as text."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix

    def __enter__(self):
        import tempfile

        with GATE:
            self.path = tempfile.mkdtemp(prefix=self.prefix)
            _folders.add(self.path)
        return self.path

    def __exit__(self, *_):
        _empty(self.path)
        _folders.discard(self.path)


def hold_folder(path: PathLike | str) -> None:
    """Registers a folder for removal, with its content, when the process is interrupted."""
    _folders.add(path)


def drop_folder(path: PathLike | str) -> None:
    """Unregisters a folder, which is removed already or is to stay."""
    _folders.discard(path)


def hold(start: Callable[[], Child]) -> Child:
    """Starts a child process and registers it, so that it ends with this process. start: returns the child, which has kill() and
    pid."""
    with GATE:
        child = start()
        _children.add(child)
    return child


def drop(child: object) -> None:
    """Unregisters a child process that has ended."""
    _children.discard(child)


def run_child(command: list[str], data: bytes, timeout: float | None, environment: dict[str, str],
              ) -> subprocess.CompletedProcess:
    """Run a command with data on its stdin and return its CompletedProcess, with stdout and stderr as bytes. The child ends with
    this process.

    data: bytes; timeout: seconds or None; environment: all environment variables of the child. Raises subprocess.TimeoutExpired,
    OSError.
    """
    import subprocess

    pipe = subprocess.PIPE
    with GATE:
        child = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, env=environment)
        _children.add(child)
    try:
        with child:
            try:
                out, said = child.communicate(data, timeout)
            except BaseException:
                child.kill()
                raise
    finally:
        _children.discard(child)
    return subprocess.CompletedProcess(command, child.returncode, out, said)


def remove_all() -> None:
    """Ends the registered children and removes the temporary files and folders. The caller holds GATE and ends the process
    next."""
    _Stage.ending = True  # before the first child ends, whose exit code others may be waiting for
    for child in list(_children):
        try:
            child.kill()
            os.waitpid(child.pid, 0)  # it may still be writing into a folder; child.wait() could wait for a lock
        except (OSError, AttributeError):
            pass
    for path in list(_paths):
        _unlink(path)
    for path in list(_folders):
        _empty(path)


def _unlink(path):
    try:
        os.unlink(path)
    except OSError:
        pass


def _empty(folder):
    """Removes a folder with its content."""
    try:
        for place, folders, names in os.walk(folder, topdown=False):
            for name in names:
                _unlink(os.path.join(place, name))
            for name in folders:
                os.rmdir(os.path.join(place, name))
        os.rmdir(folder)
    except OSError:
        pass
