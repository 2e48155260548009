"""Averages the source's appearance over the active voxels, with the samples of the voxelisation (encoder only)."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..core.kernel import kernel
from ..geometry.areas import face_areas
from ..geometry.mesh import Mesh
from ..geometry.nearest_points import NearestPoints
from ..scene.fetch import _source_at, sample_source
from .grid import BrickMap, _rank
from .morton import _morton_key, decode_morton
from .surface_walk import (
    AXIS,
    FACE,
    GRID_FRACTION,
    HIGH,
    LOW,
    _next_row,
    _row_height,
    _sample_area,
    grid_coordinates,
    surface_walk,
)
from .voxelise import SAMPLES_PER_EDGE, _count_samples, _slabs

LEAST_WEIGHT = 1e-9  # of a sample without area, in voxel faces: lines and slivers get a colour too


@kernel
def _gather(corners, faces, source, per_edge, resolution, walk, only_empty, slots, bricks, words, ranks, bary, rgba, sums):
    """Adds the samples of the walk's slab to sums float64 [N, 6]: alpha-weighted red, green, blue and weight, then alpha, weight.
    bary, rgba: float64 [3] and [4], scratch for one sample.

    Sums in binary32 were 13 levels off in voxels under a million coplanar faces. With only_empty, voxels that already have a
    weight do not change. Every voxel gets its samples in face order, whatever the slabs are, so the sums do not depend on the
    thread count.
    """
    order, start, half, state = walk.order, walk.start, walk.half_step, walk.state
    axis, low, high = state[AXIS], state[LOW], state[HIGH]
    last = resolution - 1
    while True:
        count = _next_row(corners, faces, per_edge, walk)
        if count == 0:
            break
        share = np.float64(_sample_area(state)) * 2.0**-32 + LEAST_WEIGHT
        f, t = state[FACE], _row_height(state)
        base, end, apex = order[0], order[1], order[2]
        dx, dy, dz = 2 * half[0], 2 * half[1], 2 * half[2]
        x, y, z = start[0] - half[0], start[1] - half[1], start[2] - half[2]
        for i in range(count):
            x += dx
            y += dy
            z += dz
            vx = min(max(x >> 32, 0), last)
            vy = min(max(y >> 32, 0), last)
            vz = min(max(z >> 32, 0), last)
            along = vx if axis == 0 else (vy if axis == 1 else vz)
            if not low <= along < high:
                continue
            rank = _rank(_morton_key(vx, vy, vz), slots, bricks, words, ranks)
            if rank < 0 or (only_empty and sums[rank, 5] > 0.0):
                continue
            bary[end] = (2 * i + 1) / (2.0 * count) * (1.0 - t)
            bary[apex] = t
            bary[base] = 1.0 - bary[end] - t
            _source_at(source, f, bary[0], bary[1], bary[2], rgba)
            solid = share * rgba[3] / 255.0
            for c in range(3):
                sums[rank, c] += solid * rgba[c]
            sums[rank, 3] += solid
            sums[rank, 4] += share * rgba[3]
            sums[rank, 5] += share


def _fetch_nearest(corners, faces, source, keys, sums, threads):
    """Gives each voxel without samples the appearance of the surface nearest to its centre. Such voxels exist because they were
    made from a slightly different surface. corners, faces, source, sums: as in _gather()."""
    empty = np.flatnonzero(sums[:, 5] <= 0)
    if not len(empty) or not len(faces):
        return
    middle = decode_morton(keys[empty]).astype(np.float64) + 0.5
    nearest = NearestPoints(Mesh(corners * 2.0**-GRID_FRACTION, faces)).find(middle, threads=threads)
    rgba = sample_source(source, nearest.face, nearest.bary, threads).astype(np.float64)
    solid = LEAST_WEIGHT * rgba[:, 3:] / 255.0
    area = np.full_like(solid, LEAST_WEIGHT)
    sums[empty] = np.column_stack([solid * rgba[:, :3], solid, area * rgba[:, 3:], area])


def fill_uncoloured(keys: np.ndarray, colour: np.ndarray, weight: np.ndarray) -> None:
    """Give voxels of weight 0 (fully transparent) the mean colour of their nearest octree ancestor with colour, in place. keys:
    int64 [N], ascending; colour: float32 [N, C]; weight: [N], area times alpha of each voxel."""
    empty = np.flatnonzero(weight <= 0)
    for shift in range(3, 42, 3):
        if len(empty) == 0:
            return
        parents, first = np.unique(keys >> shift, return_index=True)
        total = np.add.reduceat(weight, first)
        place = np.searchsorted(parents, keys[empty] >> shift)
        mean = np.add.reduceat(colour * weight[:, None], first, axis=0)[place] / np.maximum(total[place], 1e-30)[:, None]
        coloured = total[place] > 0
        colour[empty[coloured]] = mean[coloured]
        empty = empty[~coloured]


def texels_per_edge(lattice: np.ndarray, faces: np.ndarray, source: tuple, position_bits: int, resolution: int) -> float:
    """Return how many texels of the source's textures lie along a voxel edge, as a mean over the surface; 0 without textures.
    Arguments as in transfer()."""
    _, textures, material_texture, _, _, face_material, uv, *_ = source
    texture = material_texture[face_material]
    voxel_faces = face_areas(lattice, faces).sum() * (resolution / (1 << position_bits)) ** 2
    u, v = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    with np.errstate(all="ignore"):
        per_face = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2 * textures[texture, 1] * textures[texture, 2]
    texels = float(np.where((texture >= 0) & np.isfinite(per_face), per_face, 0).sum())
    return min(float(np.sqrt(texels / max(voxel_faces, 1e-9))), 1e6)


def transfer(lattice: np.ndarray, faces: np.ndarray, source: tuple, position_bits: int, resolution: int, keys: np.ndarray,
             brick_map: BrickMap, per_edge: int = SAMPLES_PER_EDGE, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Average the source's colour and alpha over the surface in each active voxel: (float32 [N, 3] sRGB-coded colour 0..255,
    float32 [N] alpha 0..255).

    lattice: int64 [V, 3] below 2**position_bits; faces: int64 [F, 3]; source: of scene.fetch.pack_source(), with the same faces
    in the same order; resolution: voxels a side; keys: int64 [N], ascending Morton keys of the voxels, with their brick map;
    per_edge: samples per voxel edge, at least the normative number.
    """
    corners = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution))
    counts = np.empty(len(faces), np.int64)
    _count_samples(corners, faces, per_edge, counts)
    axis, bounds = _slabs(corners, faces, counts, resolution, threads)
    sums = np.zeros((len(keys), 6))

    def gather(density, only_empty):
        jobs = list(zip(bounds[:-1], bounds[1:], strict=True))
        with ThreadPoolExecutor(len(jobs)) as pool:
            list(pool.map(lambda slab: _gather(corners, faces, source, density, resolution, surface_walk(axis, *slab), only_empty,
                                               *brick_map.arrays, np.empty(3), np.empty(4), sums), jobs))

    gather(per_edge, False)
    if per_edge != SAMPLES_PER_EDGE and (sums[:, 5] <= 0).any():
        gather(SAMPLES_PER_EDGE, True)
    _fetch_nearest(corners, faces, source, keys, sums, threads)
    weight = sums[:, 3]
    colour = (sums[:, :3] / np.maximum(weight, 1e-30)[:, None]).astype(np.float32)
    fill_uncoloured(keys, colour, weight)
    return colour, (sums[:, 4] / np.maximum(sums[:, 5], 1e-30)).astype(np.float32)
