"""Surface fit: the voxel colours whose trilinear field comes closest to the source on the surface (encoder only).

The transfer gives each voxel the mean colour of the surface inside it, but a renderer blends up to eight voxels at every point,
and blending means blurs twice. The fit minimises, over samples spread evenly by area (those of the voxelisation, spec 6.3),

    sum_s a_s |sum_k w_sk v_k - c_s|^2  +  damping * mean(diagonal) * sum_k |v_k - t_k|^2

with v the voxels' colours, t the transfer's, w_s the renormalised trilinear weights of sample s (spec 8.2), c_s the source's
colour and a_s its area times alpha. The damping keeps voxels that few samples touch (slivers, lonely voxels) at the transfer.
Entries are not negative and the weights of a sample sum to 1, so by Gershgorin the condition number is at most 1 + largest row
sum / (damping * mean diagonal) on any mesh. Solved by conjugate gradients from the transfer.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ...core.colour_error import ColourError
from ...core.integer import _ones
from ...core.kernel import kernel
from ...field.grid import BrickMap, _rank_of_voxel
from ...field.morton import decode_morton
from ...field.query import query_field
from ...field.samples import surface_samples
from ...geometry.areas import relative_areas, sample_surface
from ...scene.fetch import sample_source

DAMPING = 0.02  # 0.005 to 0.05 differ by 0.02 dB (basketball player, K 1024)
DENSITY = 2  # samples per voxel edge: 1, 2, 3, 4 end at 44.9, 47.2, 47.3, 47.3 dB there after 10 iterations, from 44.4
# Stopping early leaves out what costs the most bits: against 10 iterations, 3, 4, 6 have BD-rates Y after coding of -3.5, -3.1,
# -1.6 % (basketball player, K 1024) and -2.1, -1.8, -1.1 % (scissors), and 0.24, 0.19, 0.10 dB less before coding.
ITERATIONS = 4
BLOCK = 1 << 15
HELD_OUT = 1 << 17  # points that decide whether the fit is kept
HELD_OUT_SEED = 1
NEIGHBOURS = 27


@dataclass
class FieldSurface:
    """The part of the source that one field colours. lattice: int64 [V, 3]; faces: int64 [F, 3], face i being face i of `source`
    (of pack_source); position_bits; resolution: K; keys: int64 [N] ascending; brick_map: of the keys."""

    lattice: np.ndarray
    faces: np.ndarray
    source: tuple
    position_bits: int
    resolution: int
    keys: np.ndarray
    brick_map: BrickMap

    @property
    def has_area(self) -> bool:
        """True if there is a point to sample: faces whose corners lie on a line are kept, but have no area."""
        return bool(relative_areas(self.lattice, self.faces).any())

    def sample(self, count: int, seed: int, threads: int) -> tuple[np.ndarray, np.ndarray]:
        """Return `count` points, evenly by area: (grid coordinates float64 [count, 3], source RGBA float32 [count, 4] in
        0..255)."""
        face, bary = sample_surface(self.lattice, self.faces, count, seed)
        points = np.einsum("nc,ncd->nd", bary, self.lattice[self.faces[face]])
        points *= self.resolution / (1 << self.position_bits)
        return points, sample_source(self.source, face, bary, threads)

    def error(self, colour: np.ndarray, points: np.ndarray, rgba: np.ndarray, threads: int) -> dict[str, float]:
        """Return the mean squared errors of the field with the given voxel colours, float32 [N, 3], against the source at
        points: a dict as of ColourError.mse(). points, rgba: of sample()."""
        colour = np.ascontiguousarray(colour, np.float32)
        got, _ = query_field(points, self.resolution, self.keys, self.brick_map, colour, threads)
        error = ColourError()
        error.add(rgba[:, :3], got, rgba[:, 3] / 255 if rgba[:, 3].any() else None)
        return error.mse()


@kernel
def _adjacent(xyz, begin, end, size, slots, bricks, words, ranks, near, mask):
    """Fill near int32 [N, 27] with the active neighbours of voxels begin..end-1, themselves included, and mask int64 [N] with
    bits of the active ones."""
    for i in range(begin, end):
        x, y, z = np.int64(xyz[i, 0]), np.int64(xyz[i, 1]), np.int64(xyz[i, 2])
        mask[i] = 0
        for d in range(NEIGHBOURS):
            near[i - begin, d] = _rank_of_voxel(x + d // 9 - 1, y + d // 3 % 3 - 1, z + d % 3 - 1, size, slots, bricks, words,
                                                ranks)
            if near[i - begin, d] >= 0:
                mask[i] |= 1 << d


@kernel
def _corners(points, begin, end, size, slots, bricks, words, ranks, rank, weight):
    """Fill ranks int32 [M, 8] (-1 if not active) and renormalised trilinear weights float32 [M, 8] of points begin..end-1."""
    for i in range(begin, end):
        x, y, z = points[i, 0] - 0.5, points[i, 1] - 0.5, points[i, 2] - 0.5
        bx, by, bz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        fx, fy, fz = x - bx, y - by, z - bz
        total = 0.0
        for corner in range(8):
            dx, dy, dz = corner >> 2, (corner >> 1) & 1, corner & 1
            w = (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy) * (fz if dz else 1.0 - fz)
            row = _rank_of_voxel(bx + dx, by + dy, bz + dz, size, slots, bricks, words, ranks)
            rank[i, corner] = row
            weight[i, corner] = w
            if row >= 0:
                total += w
        for corner in range(8):
            weight[i, corner] = weight[i, corner] / total if total > 0.0 and rank[i, corner] >= 0 else 0.0


@kernel
def _accumulate(rank, weight, rgba, low, high, first, mask, gram, right):
    """Add the samples to rows low..high-1 of the normal equations: gram float32 [nnz], right float32 [N, 3].

    rank int32 [M, 8] < N with weight float32 [M, 8]; two active corners of one sample are neighbours, so their bit in mask is set
    and the slot lies in the row. Rows get their samples in order, whatever the ranges are.
    """
    for i in range(rank.shape[0]):
        for a in range(8):
            row = np.int64(rank[i, a])
            if row < low or row >= high:
                continue
            wa = rgba[i, 3] * weight[i, a]
            for c in range(3):
                right[row, c] += np.float32(wa * rgba[i, c])
            for b in range(8):
                if rank[i, b] >= 0:
                    d = 9 * ((b >> 2) - (a >> 2) + 1) + 3 * (((b >> 1) & 1) - ((a >> 1) & 1) + 1) + (b & 1) - (a & 1) + 1
                    slot = first[row] + _ones(mask[row] & ((1 << d) - 1))
                    gram[slot] += np.float32(wa * weight[i, b])


def _neighbourhoods(surface, pool):
    """Return the active neighbours of all voxels: int64 [N + 1], the start of each row, int32 [nnz] their ranks, int64 [N]
    masks."""
    n, xyz = len(surface.keys), decode_morton(surface.keys)
    mask = np.empty(n, np.int64)

    def rows(begin):
        near = np.empty((min(BLOCK, n - begin), NEIGHBOURS), np.int32)
        _adjacent(xyz, begin, begin + len(near), surface.resolution, *surface.brick_map.arrays, near, mask)
        active = near >= 0
        return active.sum(axis=1), near[active]

    counts, columns = zip(*pool.map(rows, range(0, n, BLOCK)), strict=True)
    return np.concatenate([[0], np.cumsum(np.concatenate(counts))]), np.concatenate(columns), mask


def _normal_equations(surface, density, threads, on_progress):
    """Return (_Matrix of N rows, right-hand side float32 [N, 3]) over samples at `density` per voxel edge."""
    n = len(surface.keys)
    cuts = np.linspace(0, n, threads + 1).astype(np.int64)
    with ThreadPoolExecutor(threads) as pool:
        first, columns, mask = _neighbourhoods(surface, pool)
        gram, right = np.zeros(len(columns), np.float32), np.zeros((n, 3), np.float32)
        walk = surface_samples(surface.lattice, surface.faces, surface.position_bits, surface.resolution, density)
        for points, face, bary, share in walk:
            rgba = sample_source(surface.source, face, bary, threads)
            rgba[:, 3] *= share / 255
            rank, weight = np.empty((len(points), 8), np.int32), np.empty((len(points), 8), np.float32)
            corners = partial(_corners, points)
            jobs = [pool.submit(corners, begin, min(begin + BLOCK, len(points)), surface.resolution, *surface.brick_map.arrays,
                                rank, weight) for begin in range(0, len(points), BLOCK)]
            [job.result() for job in jobs]
            jobs = [pool.submit(_accumulate, rank, weight, rgba, low, high, first, mask, gram, right)
                    for low, high in zip(cuts[:-1], cuts[1:], strict=True)]
            [job.result() for job in jobs]
            on_progress(int(face[-1]) + 1, len(surface.faces))
    return _Matrix(first, columns, gram), right


@kernel
def _times(first, columns, gram, x, out):
    """Add rows of a matrix times x float32 [N, C] to zeros out float32 [N, C]. columns: ranks of active voxels, < N."""
    for row in range(out.shape[0]):
        for k in range(first[row], first[row + 1]):
            for c in range(out.shape[1]):
                out[row, c] += gram[k] * x[columns[k], c]


class _Matrix(NamedTuple):
    """Entries by row: those of row i have the columns columns[first[i]:first[i + 1]], one of which is i itself.

    first: int64 [N + 1]; columns: int32 [nnz]; gram: float32 [nnz].
    """

    first: np.ndarray
    columns: np.ndarray
    gram: np.ndarray

    def times(self, x: np.ndarray) -> np.ndarray:
        """Return the product of the matrix with x, float32 [N, C]. x: [N, C], a row for each voxel."""
        x = np.ascontiguousarray(x, np.float32)
        out = np.zeros_like(x)
        _times(*self, x, out)
        return out

    def diagonal(self) -> np.ndarray:
        """Entries whose column is their row: float32 [N]."""
        return self.gram[self.columns == np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))]


def _conjugate_gradients(matrix, damping, right, iterations):
    """Return x float32 [N, C] with (matrix + damping) x = right, every column by itself, from 0, after `iterations`
    iterations."""
    x, residual = np.zeros_like(right), right.copy()
    direction, power = residual.copy(), _columns_dot(residual, residual)
    for _ in range(iterations):
        image = matrix.times(direction) + np.float32(damping) * direction
        step = power / np.maximum(_columns_dot(direction, image), 1e-30)
        x += direction * step.astype(np.float32)
        residual -= image * step.astype(np.float32)
        power, before = _columns_dot(residual, residual), power
        direction *= (power / np.maximum(before, 1e-30)).astype(np.float32)
        direction += residual
    return x


def _columns_dot(a, b):
    return np.einsum("nc,nc->c", a, b, dtype=np.float64)


def fit_surface(surface: FieldSurface, colour: np.ndarray, threads: int = 1, iterations: int = ITERATIONS,
                on_progress: Callable[[int, int], object] = lambda done, total: None) -> np.ndarray:
    """Return voxel colours whose trilinear field is closest to the source, float32 [N, 3] in 0..255.

    surface: FieldSurface; colour: float32 [N, 3], the transfer's, 0..255; on_progress: function (done, total). The result does
    not depend on `threads`.
    """
    matrix, right = _normal_equations(surface, DENSITY, threads, on_progress)
    mean_diagonal = float(matrix.diagonal().mean(dtype=np.float64))
    change = _conjugate_gradients(matrix, DAMPING * mean_diagonal, right - matrix.times(colour), iterations)
    return np.clip(colour + change, 0, 255)
