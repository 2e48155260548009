"""The Draco substream of a geometry unit: positions, and UVs for a field over texels; edgebreaker, mesh bitstream 2.2 (spec
clause 5.6).

Draco has no limits of its own, so its header is checked against ours before decoding, and its result afterwards.
"""

from dataclasses import dataclass

import numpy as np

from ..core.syntax_walk import Reader
from ..errors import InputError, StreamError

COMPRESSION_LEVEL = 10
MAX_UV_BITS = 20  # of a UV before its unit's origin is added, in steps
PLAIN_ID = 1  # of the integer attribute; decoders find it by its type
_POSITION, _TEX_COORD, _GENERIC = 0, 3, 4  # Draco's attribute types
_UINT32, _FLOAT32 = 6, 9  # and data types
_HEADER = b"DRACO\x02\x02\x01\x01\x00\x00"  # magic, version 2.2, mesh, edgebreaker, no flags


@dataclass(frozen=True)
class UvCoding:
    """Coding of UVs by Draco in 0..range, range being the larger of the two columns'. bits: of the quantisation; 0 for plain
    integers."""

    bits: int
    range: int


def enc_geometry(lattice: np.ndarray, faces: np.ndarray, position_bits: int) -> bytes:
    """Code a mesh without UVs as the Draco bytes of one unit. lattice: int64 [V, 3] in 0..2**position_bits-1 (<= 2**20); faces:
    int64 [F, 3]."""
    if lattice.min() < 0 or lattice.max() >= 1 << position_bits:
        raise ValueError("lattice position out of range")
    return _encode(lattice, faces)


def split_corners(faces: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make one point of each pair of a vertex and a UV that occurs at a corner. Returns (vertex of every point int64 [P], its UV
    int64 [P, 2], faces int64 [F, 3] of points). faces: int64 [F, 3]; uv: int64 [F, 3, 2], of the corners."""
    vertex, (u, v) = faces.reshape(-1), uv.reshape(-1, 2).T
    order = np.lexsort((v, u, vertex))  # a fifth of the time of unique rows
    new = np.zeros(len(order), bool)
    new[:1] = True
    for column in (vertex, u, v):
        ordered = column[order]
        new[1:] |= ordered[1:] != ordered[:-1]
    local, first = np.empty(len(order), np.int64), order[new]
    local[order] = np.cumsum(new) - 1
    return vertex[first], np.column_stack([u[first], v[first]]), local.reshape(-1, 3)


def enc_textured(lattice: np.ndarray, faces: np.ndarray, uv: np.ndarray, position_bits: int) -> tuple[bytes, UvCoding]:
    """Code a mesh with UVs: (Draco bytes of one unit, the UvCoding that was used). uv: int64 [V, 2], minimum 0 in both columns,
    maximum below 2**MAX_UV_BITS; the other arguments as in enc_geometry(). Draco predicts quantised texture coordinates from the
    positions, which suits scans, and integers from their neighbours, which suits charts drawn by hand (UV bytes -22 to +92 % on
    seven assets). The smaller result wins."""
    if lattice.min() < 0 or lattice.max() >= 1 << position_bits or uv.min(axis=0).any() or uv.max() >= 1 << MAX_UV_BITS:
        raise ValueError("lattice position or UV out of range")
    longest = max(int(uv.max()), 1)
    plain = _encode(lattice, faces, generic_attributes={PLAIN_ID: uv.astype(np.uint32)})
    bits = _exact_bits(longest)
    if bits <= MAX_UV_BITS:
        quantised = _encode(lattice, faces, tex_coord=uv.astype(np.float64), tex_coord_quantization_bits=bits)
        if len(quantised) <= len(plain):
            return quantised, UvCoding(bits, longest)
    return plain, UvCoding(0, longest)


def _exact_bits(longest):
    """Least bits of a quantisation of 0..longest that preserves every integer.

    Draco scales by 2**bits - 1 over longest in 32-bit floats. This moves a number by up to 2**(bits - 22) steps, in addition to
    half a step of rounding; a scale of 1 moves nothing.
    """
    bits = longest.bit_length()
    last = (1 << bits) - 1
    safe = longest == last or longest * ((1 << 22) + (2 << bits)) < last << 22
    return bits if safe else bits + 1


def _encode(lattice, faces, **attributes):
    import DracoPy

    try:
        return DracoPy.encode(lattice.astype(np.uint32), faces=faces.astype(np.uint32), compression_level=COMPRESSION_LEVEL,
                              preserve_order=False, create_metadata=False, **attributes)
    except Exception as error:
        raise InputError("TXF-I62", f"Draco cannot code this mesh: {error}") from error


def counts_of(data: bytes, offset: int = 0) -> tuple[int, int]:
    """Return (vertices, faces) as the Draco header states them. data: a unit's Draco bytes; offset: theirs in the file, for
    errors. Raises StreamError if the substream has another form than the specification allows (5.6)."""
    if bytes(data[: len(_HEADER)]) != _HEADER:
        raise StreamError("TXF-S20", "the Draco substream is not an edgebreaker mesh of version 2.2", clause="5.6", offset=offset)
    reader = Reader(data, len(_HEADER), len(data), offset)
    traversal = reader.take(1, "draco traversal type", "5.6")[0]
    coded_vertices = reader.read_v("draco vertex count", "5.6")
    coded_faces = reader.read_v("draco face count", "5.6")
    if traversal not in (0, 2):
        raise StreamError("TXF-S20", "unknown Draco traversal", clause="5.6", offset=offset, value=traversal)
    return coded_vertices, coded_faces


def dec_geometry(data: bytes, vertices: int, faces: int, position_bits: int, offset: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Decode the Draco bytes of one unit: (lattice int64 [vertices, 3], faces int64 [faces, 3]).

    vertices, faces: counts that the unit states; offset: of data in the file, for errors. Raises StreamError if the substream
    differs from the unit's values in form, counts or ranges.
    """
    mesh = _decode(data, (vertices, faces), [(_POSITION, _UINT32, 3)], offset)
    lattice, triangles = _surface_of(mesh, faces, position_bits, offset)
    if len(lattice) != vertices:
        raise _other_counts(len(lattice), vertices, offset)
    return lattice, triangles


def dec_textured(data: bytes, vertices: int, faces: int, uv: UvCoding, position_bits: int,
                 offset: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decode the Draco bytes of one unit with UVs: (lattice int64 [P, 3], faces int64 [faces, 3], uv int64 [P, 2] below
    2**MAX_UV_BITS). A vertex occurs once for every chart that contains it. uv: the unit's UvCoding; the other arguments and
    errors as in dec_geometry()."""
    kind = (_TEX_COORD, _FLOAT32, 2) if uv.bits else (_GENERIC, _UINT32, 2)
    mesh = _decode(data, (vertices, faces), [(_POSITION, _UINT32, 3), kind], offset)
    lattice, triangles = _surface_of(mesh, faces, position_bits, offset)
    if not vertices <= len(lattice) <= 3 * faces:
        raise _other_counts(len(lattice), [vertices, 3 * faces], offset)
    return lattice, triangles, _uv_of(mesh, len(lattice), uv, offset)


def _decode(data, counts, attributes, offset):
    """DracoPy's mesh, after checking that its counts (vertices, faces) and its sorted attributes (type, data type, components)
    are those of the unit."""
    import DracoPy

    said = counts_of(data, offset)
    if said != counts:
        raise StreamError("TXF-S21", "the counts in the Draco substream differ from those of the unit", clause="5.6",
                          offset=offset, value=list(said), allowed=list(counts))
    try:
        mesh = DracoPy.decode(bytes(data))
    except Exception as error:
        raise StreamError("TXF-S22", f"Draco cannot decode its substream: {error}", clause="5.6", offset=offset) from error
    received = sorted((a["attribute_type"], a["data_type"], a["num_components"]) for a in mesh.attributes)
    if received != attributes:
        raise StreamError("TXF-S20", "the Draco substream has unexpected attributes", clause="5.6", offset=offset,
                          value=received, allowed=attributes)
    return mesh


def _other_counts(value, allowed, offset):
    return StreamError("TXF-S21", "the Draco substream decodes to an unexpected number of vertices or faces", clause="5.6",
                       offset=offset, value=value, allowed=allowed)


def _surface_of(mesh, faces, position_bits, offset):
    points, triangles = np.asarray(mesh.points), np.asarray(getattr(mesh, "faces", None))
    if points.dtype != np.uint32 or points.ndim != 2 or points.shape[1] != 3 or triangles.shape != (faces, 3):
        raise _other_counts([list(points.shape), list(triangles.shape)], faces, offset)
    lattice, triangles = points.astype(np.int64), triangles.astype(np.int64)
    if triangles.min() < 0 or triangles.max() >= len(lattice) or lattice.max() >= 1 << position_bits:
        raise StreamError("TXF-S23", "the Draco substream has an index or a position out of range", clause="5.6", offset=offset)
    return lattice, triangles


def _uv_of(mesh, count, coding, offset):
    """UVs int64 [count, 2]. Draco returns quantised UVs as n / (2**bits - 1) of the range with n whole; n is recovered
    exactly."""
    data = next(np.asarray(a["data"]) for a in mesh.attributes if a["attribute_type"] != _POSITION)
    if data.shape != (count, 2):
        raise StreamError("TXF-S20", "the numbers of UVs and vertices in the Draco substream differ", clause="5.6", offset=offset,
                          value=list(data.shape), allowed=[count, 2])
    uv = data.astype(np.int64) if coding.bits == 0 else _unquantised(data, coding)
    if uv.min() < 0 or uv.max() >= 1 << MAX_UV_BITS:
        raise StreamError("TXF-S23", "the Draco substream has a UV out of range", clause="5.6", offset=offset,
                          value=[int(uv.min()), int(uv.max())], allowed=f"0..{(1 << MAX_UV_BITS) - 1}")
    return uv


def _unquantised(data, coding):
    """Integers from UVs in 32-bit floats; -1 for a UV that is not near an integer. Draco's own rounding moves a UV by at most
    an eighth of a step, so a tolerance of a quarter is unambiguous."""
    last = (1 << coding.bits) - 1
    steps = np.nan_to_num(data.astype(np.float64) * (last / coding.range), nan=-1.0)
    number = np.floor(steps + 0.5)
    sound = (np.abs(steps - number) <= 0.25) & (number >= 0) & (number <= last)
    number = np.where(sound, number, 0).astype(np.int64)
    return np.where(sound, (2 * number * coding.range + last) // (2 * last), -1)
