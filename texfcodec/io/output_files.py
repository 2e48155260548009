"""Writing files: all under temporary names first, then renamed. No file that was read is replaced."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

from ..core import cleanup
from ..errors import InputError
from .own_files import own_sides


def check_target(path: Path, inputs: Iterable[str | PathLike] = ()) -> None:
    """Check that an output path can be written, before minutes of work are lost.

    Parameters
    ----------
    path : Path
        The main file.
    inputs : iterable of str or PathLike
        Files that were read.

    Raises
    ------
    InputError
        TXF-O01 to O04 the path cannot be written, TXF-O07 it is an input.
    """
    try:
        if not path.parent.is_dir():
            raise InputError("TXF-O01", "the folder does not exist", path=str(path.parent))
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            raise InputError("TXF-O02", "the output cannot be written", path=str(path))
    except OSError as error:  # a folder on the way that nobody may look into, or a disk that does not answer
        raise as_input_error(error, path) from error
    check_no_input(path, inputs)


def check_no_input(path: Path, inputs: Iterable[str | PathLike]) -> None:
    """Refuse an output that is an input under any spelling or link.

    Parameters
    ----------
    path : Path
        The output.
    inputs : iterable of str or PathLike
        Files that were read.

    Raises
    ------
    InputError
        TXF-O07, path is one of the inputs.
    """
    for read in inputs:
        try:
            same = os.path.samefile(path, read)
        except (OSError, ValueError):  # one of them is not there, so they are not the same
            same = False
        if same:
            raise InputError("TXF-O07", "the output would overwrite an input file", path=str(path), read=str(read))


def check_sides(folder: Path, names: Iterable[str], inputs: Iterable[str | PathLike], overwrite: bool,
                own: frozenset[str] = frozenset()) -> None:
    """Refuse side files, which the user did not name, that would replace other files.

    Parameters
    ----------
    folder : Path
        Folder of the side files.
    names : iterable of str
        Names of the side files.
    inputs : iterable of str or PathLike
        Files that were read.
    overwrite : bool
        Whether side files may replace existing files.
    own : frozenset of str
        Names of side files of the previous output at this path (own_sides()), which may be replaced.

    Raises
    ------
    InputError
        TXF-O07 a side file is an input, TXF-O08 it exists already.
    """
    for name in names:
        check_no_input(folder / name, inputs)
        if not overwrite and name not in own and os.path.lexists(folder / name):
            raise InputError("TXF-O08", "a file beside the output already exists; --overwrite replaces it",
                             path=str(folder / name))


def write_all(folder: Path, files: list[tuple[str, Any]], inputs: Iterable[str | PathLike] = (), overwrite: bool = True) -> None:
    """Write all files under temporary names, then rename them in order; remove the temporary files on failure.

    Parameters
    ----------
    folder : Path
        Folder of the files.
    files : list of (str, pieces)
        Names and contents, the main file last. Pieces are bytes-like items or a function of the open file.
    inputs : iterable of str or PathLike
        Files that no output may replace.
    overwrite : bool
        Whether side files may replace existing files.

    Raises
    ------
    InputError
        TXF-O01 to O04 the operating system refused, TXF-O07 and O08 as check_sides().
    """
    token = secrets.token_hex(4)
    names = [(folder / f".{name}.{token}.tmp", folder / name) for name, _ in files]
    try:
        for (temporary, _), (_, pieces) in zip(names, files, strict=True):
            with cleanup.new_file(temporary) as file:
                if callable(pieces):
                    pieces(file)
                else:
                    file.writelines(pieces)
        check_no_input(names[-1][1], inputs)
        check_sides(folder, [name for name, _ in files[:-1]], inputs, overwrite, own_sides(names[-1][1]))
        cleanup.rename_all(names)
    except OSError as error:
        raise as_input_error(error, names[-1][1]) from error
    finally:
        for temporary, _ in names:
            cleanup.remove(temporary)


def as_input_error(error: OSError, path: Path) -> InputError:
    """Return the InputError for an error of the operating system.

    Parameters
    ----------
    error : OSError
        The error while writing.
    path : Path
        The output.

    Returns
    -------
    InputError
        TXF-O01 to O04.
    """
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return InputError("TXF-O01", "the folder does not exist", path=str(path.parent))
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.EISDIR):
        return InputError("TXF-O02", "the output cannot be written", path=str(path))
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return InputError("TXF-O03", "the disk is full", path=str(path))
    return InputError("TXF-O04", error.strerror or "the operating system rejected the file", path=str(path), errno=error.errno)
