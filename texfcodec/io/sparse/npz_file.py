"""NPZ files -> Scene: the arrays of arrays.py in numpy's archive, read without pickles and within bounds."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError, LimitError, TexfError
from .arrays import read_arrays
from .dual_grid import with_surface

if TYPE_CHECKING:
    from ...scene.scene import Scene
    from ..parts import Notes

MOST_BYTES = 4 << 30  # of all arrays together, unpacked
MOST_MEMBERS = 64


def read_npz(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of an .npz file as a Scene. folder: unused. Raises InputError TXF-I42 and those of read_arrays()."""
    arrays = npz_arrays(data)
    return read_arrays(with_surface(arrays, notes), notes)


def npz_arrays(data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz file by name. Sizes are checked before memory is taken. Raises InputError TXF-I42, LimitError
    TXF-I41."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > MOST_BYTES or len(members) > MOST_MEMBERS:
                raise LimitError("TXF-I41", "the archive has more arrays or bytes than the limit allows", value=total,
                                 allowed=MOST_BYTES)
            return {member.filename.removesuffix(".npy"): _array(archive, member) for member in members
                    if member.filename.endswith(".npy")}
    except TexfError:
        raise
    except Exception as error:  # of zipfile, its decompressors, and numpy's parser of headers
        raise InputError("TXF-I42", "the archive of arrays is broken", reason=f"{type(error).__name__}: {error}"[:200]) from error


def _array(archive, member):
    """One array. Raises ValueError for a header that does not fit the member."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(file, max_header_size=4096)
        if dtype.hasobject:
            raise InputError("TXF-I42", f"array '{member.filename[:60]}' holds pickled objects, which are not read")
        count = int(np.prod([int(side) for side in shape], dtype=object))
        if len(shape) > 4 or count * dtype.itemsize > member.file_size:
            raise ValueError(f"{member.filename[:60]} states more values than it has")
        content = file.read(count * dtype.itemsize)
    return np.frombuffer(content, dtype, count).reshape(shape, order="F" if fortran else "C")
