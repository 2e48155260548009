"""O-Voxel files (.vxz) of TRELLIS.2 -> Scene.

Facts of the format, from its public source: "VXZ", a zero byte, the offset of the binary part as 32 bits big-endian, a JSON text,
chunks. A chunk is a cube of chunk_size voxels a side; it has an octree, a byte for each node, depth first, a bit for each child
in the order 4 x + 2 y + z; and 8-bit attributes of its voxels in that order, as one block, a block for each attribute or for each
component. Blocks are compressed each by itself, and may hold differences from a neighbour, or along the octree.
"""

from __future__ import annotations

import json
import lzma
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.integer import _ones
from ...core.kernel import kernel
from ...errors import InputError, LimitError, SupportError
from ..parts import Notes
from .arrays import read_arrays
from .dual_grid import with_surface
from .npz_file import npz_arrays

if TYPE_CHECKING:
    from ...scene.scene import Scene

MOST_CHUNK, MOST_DENSE = 1024, 256  # voxels along a chunk; of one whose differences are from neighbours, which need a full grid
MOST_COMPONENTS = 64
ALL, EACH, NONE = "all", "as_is", "none"  # attr_interleave
SIDECAR = ".mesh.npz"


def read_vxz(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of a .vxz file as a Scene, turned from Z up to Y up. The surface is that of the file's dual grid or, beside
    it, NAME.mesh.npz. Raises InputError TXF-I42 to I44, SupportError TXF-I35, LimitError TXF-I41."""
    arrays: dict[str, Any] = vxz_arrays(data, notes)
    beside = notes.path.with_name(notes.path.stem + SIDECAR) if notes.path and notes.path.name else None
    if beside is not None and beside.is_file():
        mesh = npz_arrays(beside.read_bytes())
        arrays |= {name: mesh[name] for name in ("vertices", "faces", "resolution", "origin", "voxel_size") if name in mesh}
    scene = read_arrays(with_surface(arrays, notes), notes)
    scene.positions = np.ascontiguousarray(scene.positions[:, [0, 2, 1]] * (1, 1, -1))
    scene.remarks.append("positions are turned from Z up, as TRELLIS.2 has them, to Y up")
    return scene


def vxz_arrays(data: bytes, notes: Notes) -> dict[str, np.ndarray]:
    """Return {"voxels": int64 [N, 3], attribute: uint8 [N, C]} of a .vxz file. Raises as read_vxz()."""
    header, binary = _header(data)
    size, names = int(header["chunk_size"]), [(str(name), int(count)) for name, count in header["attr"]]
    total, limit = int(header["num_voxel"]), notes.limits.voxels
    if not 2 <= size <= MOST_CHUNK or size & (size - 1) or not 0 < total <= len(data) * 8 * size**2:
        raise _broken("its chunk size or number of voxels is out of range", value=str((size, total))[:60])
    if limit is not None and total > limit:
        raise LimitError("TXF-I41", "the input has more voxels than the limit allows", value=total, allowed=limit)
    if not names or any(count < 1 for _, count in names) or sum(count for _, count in names) > MOST_COMPONENTS:
        raise _broken("it has no attribute, or too many", value=str(names)[:80])
    coords, values, left = [], [], total
    for chunk in header["chunks"]:
        xyz, attributes = _chunk(chunk, binary, header, names, left)
        coords.append(xyz + np.array([int(i) for i in chunk["idx"]], np.int64).reshape(1, 3) * size)
        values.append(attributes)
        left -= len(xyz)
    if left or not coords or min(int(xyz.min()) for xyz in coords) < 0:
        raise _broken("its chunks do not hold the voxels that it states", value=total - left, allowed=total)
    joined, ends = np.concatenate(values), np.cumsum([count for _, count in names])[:-1]
    split = dict(zip((name for name, _ in names), np.split(joined, ends, axis=1), strict=True))
    return {name: np.ascontiguousarray(part) for name, part in split.items()} | {"voxels": np.concatenate(coords)}


def _broken(message, **details):
    return InputError("TXF-I42", f"the .vxz file is malformed: {message}", **details)


def _header(data):
    """(the JSON part as a dict, the binary part)."""
    begin = int.from_bytes(data[4:8], "big")
    if data[:4] != b"VXZ\0" or not 8 < begin <= len(data):
        raise _broken("its version is not 0, or its first part ends behind the file", value=data[:8].hex())
    try:
        header = json.loads(data[8:begin])
    except (ValueError, RecursionError) as error:
        raise _broken("its first part is not JSON", reason=str(error)[:100]) from error
    needed = ("chunk_size", "num_voxel", "attr", "chunks", "filter", "compression", "attr_interleave")
    if not isinstance(header, dict) or not all(name in header for name in needed):
        raise _broken("its first part lacks an entry", allowed=" ".join(needed))
    if header["filter"] not in (NONE, "parent", "neighbor") or header["attr_interleave"] not in (ALL, EACH, NONE):
        raise _broken("its filter or the order of its attributes is unknown",
                      value=f"{header['filter']!s:.20} {header['attr_interleave']!s:.20}")
    return header, memoryview(data)[begin:]


def _chunk(chunk, binary, header, names, most):
    """(places in the chunk int64 [n, 3], attributes uint8 [n, C]) of at most so many voxels."""
    size, width = int(header["chunk_size"]), sum(count for _, count in names)
    depth = size.bit_length() - 1
    block = _slice(binary, chunk["ptr"])

    def unpacked(name, bound):
        return np.frombuffer(_unpacked(_slice(block, chunk[name]), str(header["compression"]), bound), np.uint8)

    octree = unpacked("svo", depth * most + 1)
    codes = np.empty(min(most, 8 * len(octree)), np.int64)
    count = _walk(octree, depth, codes)
    if count < 1:
        raise _broken("an octree has empty nodes, or more voxels than stated", value=int(count))
    codes = codes[:count]
    if header["attr_interleave"] == ALL:
        parts = [unpacked("attr", count * width)]
    elif header["attr_interleave"] == EACH:
        parts = [unpacked(name, count * components) for name, components in names]
    else:
        parts = [unpacked(f"{name}_{i}", count) for name, components in names for i in range(components)]
    if sum(len(part) for part in parts) != count * width or any(len(part) % count for part in parts):
        raise _broken("a block of attributes is shorter than its voxels", value=sum(map(len, parts)), allowed=int(count * width))
    attributes = np.ascontiguousarray(np.concatenate([part.reshape(count, -1) for part in parts], axis=1))
    xyz = np.stack([_compact(codes >> 2), _compact(codes >> 1), _compact(codes)], axis=1)
    return xyz, _unfiltered(header["filter"], octree, depth, xyz, attributes)


def _slice(data, place):
    """Bytes at [offset, length]."""
    offset, length = (int(number) for number in place)
    if offset < 0 or length < 0 or offset + length > len(data):
        raise _broken("a chunk reaches beyond the file", value=str((offset, length))[:40], allowed=len(data))
    return data[offset : offset + length]


def _unpacked(data, method, bound):
    """Bytes of a block, at most bound. Raises InputError for more, SupportError without a package for zstd."""
    try:
        if method == NONE:
            out = bytes(data[: bound + 1])
        elif method == "deflate":
            out = zlib.decompressobj(wbits=-15).decompress(data, bound + 1)
        elif method == "lzma":
            filters = [{"id": lzma.FILTER_LZMA2, "preset": 9}]
            out = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=filters).decompress(data, bound + 1)
        elif method == "zstd":
            out = _zstd(data, bound + 1)
        else:
            raise _broken("its compression is unknown", value=method[:20])
    except (zlib.error, lzma.LZMAError, EOFError) as error:
        raise _broken("a block cannot be unpacked", reason=str(error)[:100]) from error
    if len(out) > bound:
        raise _broken("a block unpacks to more than its voxels need", allowed=bound)
    return out


def _zstd(data, most):
    try:
        import zstandard
    except ImportError as error:
        raise SupportError("TXF-I35", "the .vxz file is compressed with Zstandard, which requires the package zstandard"
                           ) from error
    try:
        return zstandard.ZstdDecompressor().stream_reader(data).read(most)
    except zstandard.ZstdError as error:
        raise _broken("a block cannot be unpacked", reason=str(error)[:100]) from error


def _compact(code):
    """Every third bit of codes below 2**30, gathered."""
    out = np.zeros_like(code)
    for bit in range(MOST_CHUNK.bit_length()):
        out |= (code >> 2 * bit) & (1 << bit)
    return out


def _unfiltered(method, octree, depth, xyz, attributes):
    if method == "parent":
        out = np.empty_like(attributes)
        _add_along_octree(octree, depth, attributes, np.empty((depth + 1, attributes.shape[1]), np.uint8), out)
        return out
    if method == "neighbor":
        if 1 << depth > MOST_DENSE:
            raise SupportError("TXF-I35", "differences from neighbours are read in chunks of at most 256 voxels a side; write "
                               "the file with another filter")
        grid = np.full((1 << depth,) * 3, -1, np.int32)
        order = np.lexsort(xyz.T).astype(np.int64)  # by z, y, x
        _add_neighbours(xyz, order, grid, attributes)
    return attributes


@kernel(allocates=True)
def _walk(octree, depth, codes):
    """Write the codes of an octree's voxels, depth first, to codes int64, and return their number; -1 for a node without children
    or beyond the end, or for more voxels than codes has room for. left: children of the node at each level that are not visited
    yet; depth <= 10."""
    if octree.shape[0] == 0 or octree[0] == 0:
        return np.int64(-1)
    left, count, at, level, path = np.zeros(12, np.int64), np.int64(0), np.int64(1), np.int64(0), np.int64(0)
    left[0] = octree[0]
    while level >= 0:
        if left[level] == 0:
            level -= 1
            path >>= 3
            continue
        child = _lowest(left[level])
        left[level] &= left[level] - 1
        if level == depth - 1:
            if count >= codes.shape[0]:
                return np.int64(-1)
            codes[count] = path << 3 | child
            count += 1
            continue
        if at >= octree.shape[0] or octree[at] == 0:
            return np.int64(-1)
        path = path << 3 | child
        level += 1
        left[level] = octree[at]
        at += 1
    return count


@kernel
def _lowest(bits):
    """Number of the lowest bit of bits > 0."""
    number = np.int64(0)
    while not (bits >> number) & 1:
        number += 1
    return number


@kernel(allocates=True)
def _add_along_octree(octree, depth, delta, run, out):
    """Write attributes uint8 [n, C] to out from differences along an octree that _walk() has checked: a node's first child has
    its value, each further child that of the one before it plus a difference; differences of a node's children stand together, in
    the order in which nodes are visited. run: uint8 [depth + 1, C], scratch."""
    left, next_one = np.zeros(12, np.int64), np.zeros(12, np.int64)
    is_first = np.ones(12, np.bool_)
    level, at, leaf, width = np.int64(0), np.int64(1), np.int64(0), delta.shape[1]
    left[0], next_one[0] = octree[0], 1
    free = _ones(left[0])  # the first difference behind the root's
    run[0] = delta[0]
    while level >= 0:
        if left[level] == 0:
            level -= 1
            continue
        left[level] &= left[level] - 1
        if not is_first[level]:
            for c in range(width):
                run[level, c] = (np.int64(run[level, c]) + np.int64(delta[next_one[level], c])) & 255
            next_one[level] += 1
        is_first[level] = False
        if level == depth - 1:
            out[leaf] = run[level]
            leaf += 1
            continue
        run[level + 1] = run[level]
        level += 1
        left[level], next_one[level], is_first[level] = octree[at], free, True
        free += _ones(left[level]) - 1
        at += 1


@kernel
def _add_neighbours(xyz, order, grid, values):
    """Add to values uint8 [n, C], in place, those of an earlier neighbour. order: voxels by z, y, x; grid: int32, all -1. Of the
    neighbours at lower x, y or z the last in the format's order counts: x, y, z, xy, xz, yz, xyz."""
    for i in range(order.shape[0]):
        here = order[i]
        x, y, z = xyz[here, 0], xyz[here, 1], xyz[here, 2]
        other = np.int64(-1)
        for which in _STEPS:
            dx, dy, dz = which & 1, (which >> 1) & 1, which >> 2
            if x >= dx and y >= dy and z >= dz and grid[x - dx, y - dy, z - dz] >= 0:
                other = np.int64(grid[x - dx, y - dy, z - dz])
        grid[x, y, z] = here
        if other >= 0:
            for c in range(values.shape[1]):
                values[here, c] = (np.int64(values[here, c]) + np.int64(values[other, c])) & 255


_STEPS = (1, 2, 4, 3, 5, 6, 7)  # bits of x, y and z
