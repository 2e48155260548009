"""Shading normals of the decoded mesh: smooth within a crease angle, so that viewers do not shade every facet flat.

Normals are not in the stream; these are made from the geometry, across unit borders, because the seams of fields and materials
are no creases.
"""

import numpy as np

from ..ground.kernel import kernel

CREASE_COSINE = 0.7071  # faces meeting at more than 45 degrees keep an edge between them
MOST_FACES = 256  # at a vertex; beyond that every face keeps its own normal


@kernel
def _smooth(first, corner_of, face_normal, face_unit, out):
    """out float64 [3 F, 3]: for each corner, the sum of the normals around its vertex that are within the crease angle.

    first: int64 [V + 1] ranges of corner_of, the corners (3 f + c) around each vertex; face_normal: area-weighted.
    """
    for v in range(first.shape[0] - 1):
        low, high = first[v], first[v + 1]
        for i in range(low, high):
            a = corner_of[i] // 3
            out[corner_of[i]] = face_normal[a]
            if high - low > MOST_FACES:
                continue
            for j in range(low, high):
                b = corner_of[j] // 3
                dot = 0.0
                for k in range(3):
                    dot += face_unit[a, k] * face_unit[b, k]
                if b != a and dot >= CREASE_COSINE:
                    for k in range(3):
                        out[corner_of[i], k] += face_normal[b, k]


def _unit(vectors):
    """Vectors [N, 3] scaled to length 1; z for those without a direction."""
    length = np.linalg.norm(vectors, axis=1)
    flat = ~(length > 0)
    out = vectors / np.where(flat, 1.0, length)[:, None]
    out[flat] = (0.0, 0.0, 1.0)
    return out


def corner_normals(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normal of every face corner, float32 [F, 3, 3], rounded to 1/512 so that equal ones merge.

    lattice: int64 [V, 3]; faces: int64 [F, 3]. Vertices at the same position count as one.
    """
    packed = lattice[:, 0] | (lattice[:, 1] << 21) | (lattice[:, 2] << 42)
    welded = np.unique(packed, return_inverse=True)[1].reshape(-1)[faces].ravel()
    corner_of = np.argsort(welded, kind="stable")
    first = np.searchsorted(welded[corner_of], np.arange(int(welded.max(initial=-1)) + 2))
    p = lattice[faces].astype(np.float64)
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    out = np.empty((len(welded), 3), np.float64)
    _smooth(first, corner_of, normal, _unit(normal), out)
    rounded = _unit(np.rint(_unit(out) * 512))
    return rounded.astype(np.float32).reshape(-1, 3, 3)
