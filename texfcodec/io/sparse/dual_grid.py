"""The surface of voxels that carry it themselves, as O-Voxel's flexible dual grid: a vertex in each voxel, and for each axis
whether the edge of the voxel along it is crossed by the surface, which joins the four voxels around the edge by a quad."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.kernel import kernel
from ...errors import InputError
from ...geometry.edges import shared_edges
from .arrays import PLACE, VOXELS, grid_place
from .sampler import MOST_SIDE

if TYPE_CHECKING:
    from ..parts import Notes

DUAL, CROSSED = "dual_vertices", "intersected"
_AROUND = np.array([[[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]], [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
                    [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]]])  # the voxels around an edge along x, y and z


def with_surface(arrays: Mapping[str, Any], notes: Notes) -> dict[str, Any]:
    """Return named arrays with the vertices and faces that their dual grid stands for, if they have one and no surface."""
    out = dict(arrays)
    dual, crossed = out.pop(DUAL, None), out.pop(CROSSED, None)
    voxels = next((np.asarray(out[name]) for name in VOXELS if name in out), None)
    if voxels is None:
        return out
    if "resolution" not in out and not {"origin", "voxel_size"} <= out.keys():
        out |= _guessed_place(voxels, notes)
    if dual is None or crossed is None or "vertices" in out:
        return out
    _, origin, size = grid_place({name: out[name] for name in PLACE if name in out})
    vertices, faces = dual_surface(voxels, np.asarray(dual), np.asarray(crossed))
    return out | {"vertices": vertices * size + origin, "faces": faces}


def _guessed_place(voxels, notes):
    """The resolution of a cube that holds the voxels: the power of two above them."""
    if voxels.ndim != 2 or voxels.dtype.kind not in "iu" or not voxels.size:
        return {}
    resolution = 1 << int(np.clip(voxels.max(), 1, MOST_SIDE - 1)).bit_length()
    notes.remark(f"the voxels come without a resolution; {resolution} is taken, for a cube from -0.5 to 0.5")
    return {"resolution": resolution}


def dual_surface(xyz: np.ndarray, dual: np.ndarray, crossed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (vertices float64 [N, 3] in voxels, faces int64 [F, 3]) of a dual grid. xyz: integer [N, 3]; dual: [N, 3], place in
    the voxel, 0..1 or uint8; crossed: bool [N, 3], or [N] or [N, 1] with a bit for each axis. Quads are cut along the diagonal
    across which they bend less. Raises InputError TXF-I44."""
    count = len(xyz)
    crossed = crossed.reshape(count, -1) if count and crossed.size in (count, 3 * count) else crossed
    if xyz.dtype.kind not in "iu" or dual.dtype.kind not in "fiu" or crossed.dtype.kind not in "iub":
        raise InputError("TXF-I44", "the dual grid's arrays are not numbers", value=f"{xyz.dtype} {dual.dtype} {crossed.dtype}")
    if xyz.ndim != 2 or xyz.shape != (count, 3) or dual.shape != (count, 3) or crossed.shape not in ((count, 1), (count, 3)):
        raise InputError("TXF-I44", "the dual grid's arrays do not fit the voxels", value=f"{dual.shape}, {crossed.shape}"[:60],
                         allowed=f"({count}, 3), ({count}, 1)")
    if crossed.shape[1] == 1:
        crossed = (crossed.astype(np.int64) >> np.arange(3)) & 1
    xyz = xyz.astype(np.int64)
    place = np.nan_to_num(dual / 255 if dual.dtype == np.uint8 else dual.astype(np.float64))
    vertices = xyz + np.clip(place, 0, 1)
    voxel, axis = np.nonzero(crossed)
    around = xyz[voxel][:, None] + _AROUND[axis]
    quads = _ranks(xyz, around.reshape(-1, 3)).reshape(-1, 4)
    quads = quads[(quads >= 0).all(axis=1)]
    if not len(quads):
        raise InputError("TXF-I43", "the dual grid has no face")
    return vertices, oriented(vertices, _triangles(vertices, quads))


def oriented(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return faces int64 [F, 3] turned so that neighbours agree and each component, joined by edges of two faces, encloses a
    volume that is not negative. vertices: float64 [V, 3]."""
    edges = shared_edges(faces)
    first = np.flatnonzero(np.r_[True, edges.edge[1:] != edges.edge[:-1]]) if len(edges) else np.zeros(0, np.int64)
    pair = first[np.diff(np.append(first, len(edges.edge))) == 2]
    a, b = edges.half[pair], edges.half[pair + 1]
    across = np.full(3 * len(faces), -1, np.int64)
    across[a], across[b] = b, a
    turned, component = np.full(len(faces), -1, np.int8), np.zeros(len(faces), np.int64)
    _spread_turns(faces, across, turned, component)
    out = np.where(turned[:, None] == 1, faces[:, [0, 2, 1]], faces)
    p, q, r = ((vertices - vertices.mean(axis=0))[out[:, corner]] for corner in range(3))
    volume = np.bincount(component, (p * np.cross(q, r)).sum(axis=1))
    return np.where(volume[component][:, None] < 0, out[:, [0, 2, 1]], out)


@kernel(allocates=True)
def _spread_turns(faces, across, turned, component):
    """Write to turned int8 [F] whether a face has to be turned to agree with the first of its component, and to component int64
    [F] its number. across: int64 [3 F], side beyond that from corner i of face f, 3 f + i, or -1."""
    waiting, number = np.empty(faces.shape[0], np.int64), np.int64(0)
    for start in range(faces.shape[0]):
        if turned[start] >= 0:
            continue
        waiting[0], count, turned[start], component[start] = start, 1, 0, number
        while count > 0:
            count -= 1
            face = waiting[count]
            for i in range(3):
                other = across[3 * face + i]
                if other < 0 or turned[other // 3] >= 0:
                    continue
                same = faces[face, i] == faces[other // 3, other % 3]
                turned[other // 3] = 1 - turned[face] if same else turned[face]
                component[other // 3] = number
                waiting[count] = other // 3
                count += 1
        number += 1


def _ranks(xyz, sought):
    """Index of voxels, int64 [n], -1 where there is none."""
    keys, wanted = ((a[:, 0] << 28) + (a[:, 1] << 14) + a[:, 2] for a in (xyz, sought))
    order = np.argsort(keys)
    at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    return np.where(keys[order][at] == wanted, order[at], -1)


def _triangles(vertices, quads):
    a, b, c, d = (vertices[quads[:, corner]] for corner in range(4))

    def alignment(first, second):
        lengths = np.sqrt((first**2).sum(axis=1) * (second**2).sum(axis=1))
        return (first * second).sum(axis=1) / np.maximum(lengths, 1e-30)

    across_ac = alignment(np.cross(b - a, c - a), np.cross(c - a, d - a))
    across_bd = alignment(np.cross(b - a, d - a), np.cross(c - b, d - b))
    by_ac = quads[:, [0, 1, 2, 0, 2, 3]]
    return np.where((across_ac >= across_bd)[:, None], by_ac, quads[:, [0, 1, 3, 3, 1, 2]]).reshape(-1, 3)
