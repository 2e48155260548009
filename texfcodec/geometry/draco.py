"""The Draco substream of a geometry unit: positions only, edgebreaker, mesh bitstream 2.2 (spec clause 5.6).

Draco has no limits of its own, so its header is checked against ours before it sees a byte, and its result after.
"""

import numpy as np

from ..errors import InputError, StreamError
from ..ground.walk import Reader

COMPRESSION_LEVEL = 10
_HEADER = b"DRACO\x02\x02\x01\x01\x00\x00"  # magic, version 2.2, mesh, edgebreaker, no flags


def enc_geometry(lattice: np.ndarray, faces: np.ndarray, position_bits: int) -> bytes:
    """Draco bytes of one unit. lattice: int64 [V, 3] in 0..2**position_bits-1 (<= 2**20); faces: int64 [F, 3]."""
    import DracoPy

    if lattice.min() < 0 or lattice.max() >= 1 << position_bits:
        raise ValueError("lattice position out of range")
    try:
        return DracoPy.encode(lattice.astype(np.uint32), faces=faces.astype(np.uint32), compression_level=COMPRESSION_LEVEL,
                              preserve_order=False, create_metadata=False)
    except Exception as error:
        raise InputError("TXF-I62", f"Draco cannot code this mesh: {error}") from error


def counts_of(data: bytes, offset: int = 0) -> tuple[int, int]:
    """(vertices, faces) as the Draco header names them, which must be of the one form that the specification allows (5.6)."""
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
    """Decodes one unit: (lattice int64 [vertices, 3], faces int64 [faces, 3]).

    Raises StreamError where the substream is not what the unit says, in form, counts or ranges.
    """
    import DracoPy

    counts = counts_of(data, offset)
    if counts != (vertices, faces):
        raise StreamError("TXF-S21", "the Draco substream's counts are not the unit's", clause="5.6", offset=offset,
                          value=list(counts), allowed=[vertices, faces])
    try:
        mesh = DracoPy.decode(bytes(data))
    except Exception as error:
        raise StreamError("TXF-S22", f"Draco refuses its substream: {error}", clause="5.6", offset=offset) from error
    if len(mesh.attributes) != 1:
        raise StreamError("TXF-S20", "the Draco substream has other attributes than positions", clause="5.6", offset=offset,
                          value=len(mesh.attributes), allowed=1)
    points, triangles = np.asarray(mesh.points), np.asarray(getattr(mesh, "faces", None))
    if points.dtype != np.uint32 or points.shape != (vertices, 3) or triangles.shape != (faces, 3):
        raise StreamError("TXF-S21", "the Draco substream decodes to another number of vertices or faces", clause="5.6",
                          offset=offset, value=[list(points.shape), list(triangles.shape)], allowed=[vertices, faces])
    lattice, triangles = points.astype(np.int64), triangles.astype(np.int64)
    if triangles.min() < 0 or triangles.max() >= vertices or lattice.max() >= 1 << position_bits:
        raise StreamError("TXF-S23", "the Draco substream has an index or a position out of range", clause="5.6", offset=offset)
    return lattice, triangles
