"""The normal equations of a fit of vertices: a symmetric matrix of 3 by 3 blocks for vertices that share a face (encoder
only)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...core.kernel import kernel

TOLERANCE, MOST_STEPS = 1e-4, 200  # of conjugate gradients


@dataclass(frozen=True)
class NormalMatrix:
    """Block rows by vertex: first: int64 [V + 1], column: int32 [N], block: float64 [N, 3, 3]; block k of row v has the column
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
        head, after, mark = (np.full(count, -1, np.int32) for count in (vertices, 3 * len(faces), vertices))
        self._first, self._own = np.zeros(vertices + 1, np.int64), np.empty(vertices, np.int64)
        _count_blocks(self._faces, head, after, mark, self._first)
        np.cumsum(self._first, out=self._first)
        self._slot, self._column = np.empty((len(faces), 9), np.int32), np.empty(self._first[-1], np.int32)
        _lay_out(self._faces, head, after, mark, self._first[:-1].copy(), self._slot, self._own, self._column)
        self._block = np.zeros((len(self._column), 3, 3))
        self._right = np.zeros((vertices, 3))

    def add(self, points: PointResiduals, along: float, around: float) -> None:
        """Add the squared error of points: the sum of weight * (along (n r)^2 + around r^2), with the residual r that remains of
        a point's wanted movement and its direction n. along, around: weights of the part along n and of the whole."""
        _add(self._faces, self._slot, *points, along, around, self._block, self._right)

    def matrix(self, stiffness: float, damping: float) -> NormalMatrix:
        """Return the matrix of the equations, which takes their blocks over: nothing can be added later. stiffness: weight of the
        squared differences of displacements of neighbours; damping: weight of the displacements; both in units of the mean
        diagonal."""
        block, own = self._block, self._own
        scale = float(np.einsum("vii->v", block[own]).mean() / 3) if len(own) else 0.0
        scale = scale if scale > 0 else 1.0
        degree = np.diff(self._first) - 1
        eye = np.eye(3)
        block -= stiffness * scale * eye
        block[own] += ((stiffness * (degree + 1) + damping) * scale)[:, None, None] * eye
        del self._block
        return NormalMatrix(self._first, self._column, block)

    def solve(self, stiffness: float, damping: float) -> tuple[np.ndarray, NormalMatrix]:
        """Return (displacements float64 [V, 3], the matrix() that they solve)."""
        matrix = self.matrix(stiffness, damping)
        return _conjugate_gradients(matrix, self._right, np.linalg.inv(matrix.block[self._own])), matrix


@kernel
def _count_blocks(faces, head, after, mark, first):
    """Fill head [V] and after [3 F], the corners 3 f + i of every vertex as a list that ends with -1, and first from 1 on with
    the numbers of blocks of rows. mark: [V], -1."""
    for corner in range(3 * faces.shape[0]):
        v = faces[corner // 3, corner % 3]
        after[corner], head[v] = head[v], corner
    for v in range(head.shape[0]):
        mark[v], count, corner = v, 1, head[v]
        while corner >= 0:
            for i in range(3):
                w = faces[corner // 3, i]
                count += mark[w] != v
                mark[w] = v
            corner = after[corner]
        first[v + 1] = count


@kernel
def _lay_out(faces, head, after, mark, end, slot, own, column):
    """Fill column, the slots of every face's nine blocks [F, 9] and of the diagonal [V]. end: the first block of every row, and
    afterwards that of the next. Columns come in their order, so that those of a row ascend; the block of a column is the last one
    of its rows then."""
    mark[:] = -1
    for w in range(head.shape[0]):
        own[w], mark[w] = end[w], w
        column[end[w]] = w
        end[w] += 1
        corner = head[w]
        while corner >= 0:
            f, j = corner // 3, corner % 3
            for i in range(3):
                v = faces[f, i]
                if mark[v] != w:
                    mark[v], column[end[v]] = w, w
                    end[v] += 1
                slot[f, 3 * i + j] = end[v] - 1
            corner = after[corner]


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
