"""The normal equations of a fit of vertices: a symmetric matrix of 3 by 3 blocks for vertices that share a face (encoder
only)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...core.distinct import distinct
from ...core.kernel import kernel

TOLERANCE, MOST_STEPS = 1e-4, 200  # of conjugate gradients


@dataclass(frozen=True)
class NormalMatrix:
    """Block rows by vertex: first: int64 [V + 1], column: int64 [N], block: float64 [N, 3, 3]; block k of row v has the column
    column[k], ascending, for first[v] <= k < first[v + 1], and one of them is v itself."""

    first: np.ndarray
    column: np.ndarray
    block: np.ndarray

    def form(self, step: np.ndarray) -> float:
        """Return the quadratic form step' A step of this matrix A. step: float64 [V, 3], displacements of the vertices."""
        return float(np.vdot(step, self @ step))

    def __matmul__(self, step: np.ndarray) -> np.ndarray:
        """Return A step, float64 [V, 3]. step: float64 [V, 3]."""
        out = np.empty((len(self.first) - 1, 3))
        _times(self.first, self.column, self.block, np.ascontiguousarray(step, np.float64), out)
        return out


class PointResiduals(NamedTuple):
    """Points of faces and their wanted movement. face: int64 [M]; bary, residual, direction: float64 [M, 3], the residual being
    the movement; weight: float64 [M]."""

    face: np.ndarray
    bary: np.ndarray
    residual: np.ndarray
    direction: np.ndarray
    weight: np.ndarray


class NormalEquations:
    """Sum of squared residuals of points on faces; its solution is the displacements of the vertices that minimise it.

    faces: int64 [F, 3] below vertices.
    """

    def __init__(self, faces: np.ndarray, vertices: int) -> None:
        self._faces = np.ascontiguousarray(faces, np.int64)
        rows = np.concatenate([np.repeat(faces, 3, axis=1).ravel(), np.arange(vertices)])  # and a diagonal for idle vertices
        columns = np.concatenate([np.tile(faces, (1, 3)).ravel(), np.arange(vertices)])
        code, slot, _ = distinct(rows * max(vertices, 1) + columns)
        self._slot = np.ascontiguousarray(slot[: 9 * len(faces)].reshape(-1, 9))
        self._own = slot[9 * len(faces):]
        self._first = np.searchsorted(code, np.arange(vertices + 1) * max(vertices, 1))
        self._column = code % max(vertices, 1)
        self._block = np.zeros((len(code), 3, 3))
        self._right = np.zeros((vertices, 3))

    def add(self, points: PointResiduals, along: float, around: float) -> None:
        """Add the squared error of points: the sum of weight * (along (n r)^2 + around r^2), with the residual r that remains of
        a point's wanted movement and its direction n. along, around: weights of the part along n and of the whole."""
        _add(self._faces, self._slot, *points, along, around, self._block, self._right)

    def solve(self, stiffness: float, damping: float) -> tuple[np.ndarray, NormalMatrix]:
        """Return (displacements float64 [V, 3], the matrix that they solve). stiffness: weight of the squared differences of
        displacements of neighbours; damping: weight of the displacements; both in units of the mean diagonal."""
        block, own = self._block.copy(), self._own
        scale = float(np.einsum("vii->v", block[own]).mean() / 3) if len(own) else 0.0
        scale = scale if scale > 0 else 1.0
        degree = np.diff(self._first) - 1
        eye = np.eye(3)
        block -= stiffness * scale * eye
        block[own] += ((stiffness * (degree + 1) + damping) * scale)[:, None, None] * eye
        matrix = NormalMatrix(self._first, self._column, block)
        return _conjugate_gradients(matrix, self._right, np.linalg.inv(block[own])), matrix


def _conjugate_gradients(matrix, right, inverse):
    """Return the solution of matrix x = right, float64 [V, 3], from 0. inverse: float64 [V, 3, 3], inverses of the blocks on the
    diagonal."""
    x, rest = np.zeros_like(right), right.copy()
    ahead = np.einsum("vij,vj->vi", inverse, rest)
    way, energy = ahead.copy(), float(np.vdot(rest, ahead))
    least = energy * TOLERANCE**2
    for _ in range(MOST_STEPS):
        if not energy > least:
            break
        there = matrix @ way
        size = energy / float(np.vdot(way, there))
        x += size * way
        rest -= size * there
        ahead = np.einsum("vij,vj->vi", inverse, rest)
        before, energy = energy, float(np.vdot(rest, ahead))
        way = ahead + (energy / before) * way
    return x


@kernel
def _times(first, column, block, x, out):
    for v in range(first.shape[0] - 1):
        a = b = c = 0.0
        for k in range(first[v], first[v + 1]):
            m, w = block[k], x[column[k]]
            a += m[0, 0] * w[0] + m[0, 1] * w[1] + m[0, 2] * w[2]
            b += m[1, 0] * w[0] + m[1, 1] * w[1] + m[1, 2] * w[2]
            c += m[2, 0] * w[0] + m[2, 1] * w[1] + m[2, 2] * w[2]
        out[v, 0], out[v, 1], out[v, 2] = a, b, c


@kernel
def _add(faces, slot, face, bary, residual, direction, weight, along, around, block, right):
    for s in range(face.shape[0]):
        f, n, r = face[s], direction[s], residual[s]
        reach = along * (n[0] * r[0] + n[1] * r[1] + n[2] * r[2])
        for i in range(3):
            part = weight[s] * bary[s, i]
            if part == 0.0:
                continue
            for k in range(3):
                right[faces[f, i], k] += part * (reach * n[k] + around * r[k])
            for j in range(3):
                both, m = part * bary[s, j], block[slot[f, 3 * i + j]]
                for k in range(3):
                    m[k, k] += both * around
                    for l in range(3):
                        m[k, l] += both * along * n[k] * n[l]
