"""The geometry of baking: the face and the surface point of each texel of an atlas, and the least-squares fit of its values.

B is the matrix of bilinear look-ups of the atlas at sample points of the surface, and s holds the field's values there. The
texels t minimise |B t - s|^2 with some damping towards the field at their centres. B depends on the atlas alone, so that an
AtlasSystem serves any number of fields and planes. B^T B ties a texel to its eight neighbours and is stored as five numbers for
each texel; Gauss-Seidel sweeps, which keep every value in its range, solve the system in place.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial

import numpy as np

from ...core.components import components
from ...core.kernel import kernel
from ...core.threads import in_order
from ...field.texel_cover import nearest_on_triangle, span_in_band
from .seams import split_edges
from .unwrap import Atlas

BLOCK = 1 << 18  # points sampled of the field at once: about 20 MB in flight, for each of a few blocks
SAMPLES = 2  # points along the side of a texel: 3 and 4 gain less than 0.2 dB of 48 to 57 and take two to four times as long
BORDER_SAMPLES = 4  # along a texel's length of a chart's border: jumps there fall by half, for 0.05 dB of 48
SWEEPS = 4  # 8 or 20 gain less than 0.1 dB
DAMPING = 0.1  # times the mean weight of a texel: settles those that hardly a sample looks up

FieldFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]


class AtlasSystem:
    """The texels of an atlas and the surface that they show.

    texels: float64 [F, 3, 2], corners in texels; owner: int32 [H, W], the face that a texel shows, -1 if no face comes within a
    texel of it; covered: bool [H, W]. A field is a FieldFunction: (points float64 [M, 3] in the world, faces int64 [M]) -> values
    [M, C]. At 4096 x 4096 and C = 3 it needs about 700 MB.
    """

    def __init__(self, atlas: Atlas, positions: np.ndarray, faces: np.ndarray) -> None:
        """atlas: of these faces; positions: float64 [V, 3]; faces: int64 [F, 3]."""
        self.texels = np.ascontiguousarray(atlas.corner_uv * np.array([atlas.width, atlas.height], np.float64))
        self._mesh = np.ascontiguousarray(faces, np.int64), np.ascontiguousarray(positions, np.float64)
        self.owner = cover(self.texels, atlas.width, atlas.height)
        self.covered = self.owner >= 0
        self._number = np.full(self.owner.shape, -1, np.int32)
        self._number[self.covered] = np.arange(np.count_nonzero(self.covered), dtype=np.int32)
        self._matrix: np.ndarray | None = None

    @property
    def borders(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges between charts on the surface, as of seams.border_edges(), with ends in texels."""
        return self._edges[:2]

    @property
    def charts(self) -> np.ndarray:
        """Chart number of each face, int64 [F]."""
        return self._edges[2]

    @cached_property
    def _edges(self):
        faces, positions = self._mesh
        half, ends, inner = split_edges(positions, faces, self.texels, np.zeros(len(faces), np.int64))
        return half, ends, components(len(faces), inner[0] // 3, inner[1] // 3)

    def normals(self, chosen: np.ndarray) -> np.ndarray:
        """Return unit normals of the chosen faces, float64 [n, 3]; 0 without area. chosen: int64 [n]."""
        faces, positions = self._mesh
        used = np.zeros(len(positions), bool)
        used[faces] = True
        points = positions / max(np.abs(positions).max(initial=0.0), 1e-300)  # no square overflows or vanishes
        points -= points[faces.ravel()[:1]].sum(axis=0)
        points /= max(np.abs(points[used]).max(initial=0.0), 1e-30)
        a, b, c = (points[faces[chosen, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)

    def at_centres(self, sample: FieldFunction, channels: int) -> np.ndarray:
        """Return the field's values at the centre of every covered texel, row by row: float32 [n, channels]. sample: the field;
        channels: number of its columns."""
        out, done = np.empty((int(self.covered.sum()), channels), np.float32), 0
        rows = max(BLOCK // self.owner.shape[1], 1)
        for top in range(0, self.owner.shape[0], rows):
            row, column = np.nonzero(self.covered[top : top + rows])
            face = self.owner[top + row, column].astype(np.int64)
            out[done : done + len(row)] = sample(self._points(column + 0.5, row + (top + 0.5), face), face)
            done += len(row)
        return out

    def fitted(self, sample: FieldFunction, channels: int, weighted: bool = False, threads: int = 1) -> np.ndarray:
        """Return the least-squares values of the covered texels, row by row, float32 [n, channels] in 0..255: those whose
        bilinear interpolation comes closest to the field. sample: the field; channels: number of its columns; weighted: whether
        the field has an additional column, the weight of a point, 0..1; a texel with weight 0 at its centre starts from the
        weighted mean around it. The result does not depend on threads."""
        values = np.clip(np.nan_to_num(self.at_centres(sample, channels + weighted)), 0.0, 255.0)
        matrix, right = self._equations(sample, channels, weighted, threads)
        if weighted:
            lost = (values[:, channels] <= 0) & (right[channels] > 0)
            values[lost, :channels] = (right[:channels, lost] / right[channels, lost]).T
        damping = np.float32(max(DAMPING * matrix[:, 0].mean(), 1e-30)) if len(values) else np.float32(1)

        def solve(c):
            t = np.ascontiguousarray(values[:, c])
            right[c] += damping * t
            for sweep in range(SWEEPS):
                _sweep(t, right[c], matrix, self._number, damping, sweep % 2 == 1)
            values[:, c] = t

        with ThreadPoolExecutor(max(threads, 1)) as pool:
            list(pool.map(solve, range(channels)))
        return values[:, :channels]

    def _equations(self, sample, channels, weighted, threads):
        """(B^T W B float32 [n, 5], B^T W s float32 [channels, n], with B^T W 1 as the last row if points are weighted)."""
        known = None if weighted else self._matrix
        count = np.count_nonzero(self.covered)
        matrix = np.zeros((count, 5), np.float32) if known is None else known
        right = np.zeros((channels + weighted, count), np.float32)

        def shown_at(block):
            x, y, face = block()
            return x, y, np.ascontiguousarray(np.nan_to_num(sample(self._points(x, y, face), face)), np.float32)

        for x, y, shown in in_order(shown_at, self._sample_blocks(), threads):
            weight = np.ones(len(x), np.float32)
            if weighted:
                weight, shown[:, channels] = shown[:, channels].copy(), 1
            _add_right(x, y, weight, shown, self._number, right)
            if known is None:
                _add_matrix(x, y, weight, self._number, matrix)
        if not weighted:
            self._matrix = matrix
        return matrix, right

    def _points(self, x, y, face):
        return _surface_points(x, y, face, self.texels, *self._mesh)

    def _sample_blocks(self):
        """Functions that return at most about BLOCK sample points each: (x, y float64 [M] in texels, face int64 [M])."""
        height, rows = len(self.owner), self._rows
        ends = np.linalg.norm(np.subtract(*self.borders[1].reshape(-1, 2, 2).swapaxes(0, 1)), axis=1)
        done = np.concatenate([[0], np.cumsum(np.ceil(ends * BORDER_SAMPLES).astype(np.int64))])
        return [*(partial(self._samples, top) for top in range(0, height, rows)),
                *(partial(self._border_samples, done, first) for first in range(0, int(done[-1]), BLOCK))]

    @property
    def _rows(self):
        """Number of rows of texels whose sample points are a block."""
        return max(BLOCK // (self.owner.shape[1] * SAMPLES * SAMPLES), 1)

    @cached_property
    def _faces_of_blocks(self):
        """(Faces that may cross each block of rows, ascending, block by block, int32 [n]; where each block begins, int64)."""
        last = (len(self.owner) - 1) // self._rows
        row = self.texels[..., 1] / self._rows
        top, bottom = (np.clip(edge, 0, last).astype(np.int16) for edge in (row.min(axis=1), row.max(axis=1)))
        count = bottom - top + np.int64(1)
        face = np.repeat(np.arange(len(top), dtype=np.int32), count)
        block = top[face] + (np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)).astype(np.int16)
        return face[np.argsort(block, kind="stable")], np.append(0, np.cumsum(np.bincount(block, minlength=last + 1)))

    def _samples(self, top):
        """Sample points of a block of rows of texels. top: first row."""
        height, width = self.owner.shape
        owner = np.full((min(self._rows, height - top) * SAMPLES, width * SAMPLES), -1, np.int32)
        face, start = self._faces_of_blocks
        block = top // self._rows
        _scan(self.texels, face[start[block] : start[block + 1]], SAMPLES, top * SAMPLES, owner)
        row, column = np.nonzero(owner >= 0)
        return (column + 0.5) / SAMPLES, (row + 0.5) / SAMPLES + top, owner[row, column].astype(np.int64)

    def _border_samples(self, done, first):
        """Sample points along chart borders, on both sides. done: int64 [E + 1], number of samples before each edge; first:
        number of the first sample."""
        face, ends = self.borders[0].reshape(-1) // 3, self.borders[1].reshape(-1, 2, 2)
        number = np.arange(first, min(first + BLOCK, int(done[-1])))
        edge = np.searchsorted(done, number, side="right") - 1
        share = ((number - done[edge] + 0.5) / (done[edge + 1] - done[edge]))[:, None]
        place = ends[edge, 0] * (1 - share) + ends[edge, 1] * share
        return place[:, 0], place[:, 1], face[edge]


def cover(texels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the face that each texel of an image shows, int32 [height, width]; -1 if no face comes within a texel of it.

    texels: float64 [F, 3, 2] corners in texels. A texel shows the face that contains its centre, else the nearest face.
    """
    owner = np.full((height, width), -1, np.int32)
    nearness = np.full((height, width), np.inf, np.float32)
    _cover(texels, owner, nearness)
    return owner


@kernel
def _cover(texels, owner, nearness):
    """See cover(). Bounds: rows and columns are clipped to the image before they index it; F < 2**31."""
    height, width = owner.shape
    for f in range(texels.shape[0]):
        ax, ay = texels[f, 0, 0], texels[f, 0, 1]
        bx, by = texels[f, 1, 0], texels[f, 1, 1]
        cx, cy = texels[f, 2, 0], texels[f, 2, 1]
        top = max(int(np.ceil(min(ay, by, cy) - 1.5)), 0)
        bottom = min(int(np.floor(max(ay, by, cy) + 0.5)), height - 1)
        for row in range(top, bottom + 1):
            left, right = span_in_band(ax, ay, bx, by, cx, cy, row - 0.5, row + 1.5)
            if left > right:
                continue
            for col in range(max(int(np.ceil(left - 1.5)), 0), min(int(np.floor(right + 0.5)), width - 1) + 1):
                if nearness[row, col] == 0.0:
                    continue
                distance, _, _ = nearest_on_triangle(col + 0.5, row + 0.5, ax, ay, bx, by, cx, cy)
                if distance < nearness[row, col]:
                    nearness[row, col] = distance
                    owner[row, col] = f


@kernel(allocates=True)
def _surface_points(x, y, face, texels, faces, positions):
    """World points float64 [M, 3] at places (x, y), in texels, on their faces; the nearest point of the face if outside."""
    out = np.empty((len(face), 3))
    for i in range(len(face)):
        t = texels[face[i]]
        _, wa, wb = nearest_on_triangle(x[i], y[i], t[0, 0], t[0, 1], t[1, 0], t[1, 1], t[2, 0], t[2, 1])
        corner = faces[face[i]]
        for k in range(3):
            out[i, k] = wa * positions[corner[0], k] + wb * positions[corner[1], k] + (1.0 - wa - wb) * positions[corner[2], k]
    return out



@kernel
def _scan(texels, faces, fineness, top, owner):
    """Write which of some faces is at each point of a grid to owner. fineness: points along a texel; top: first row. Points
    outside all faces stay -1. Bounds: rows and columns are clipped to owner before they index it."""
    height, width = owner.shape
    for f in faces:
        ax, ay = texels[f, 0, 0] * fineness, texels[f, 0, 1] * fineness - top
        bx, by = texels[f, 1, 0] * fineness, texels[f, 1, 1] * fineness - top
        cx, cy = texels[f, 2, 0] * fineness, texels[f, 2, 1] * fineness - top
        first = max(int(np.ceil(max(min(ay, by, cy), 0.0) - 0.5)), 0)
        last = int(np.floor(min(max(ay, by, cy), height + 0.0) - 0.5))
        for row in range(first, min(last, height - 1) + 1):
            left, right = span_in_band(ax, ay, bx, by, cx, cy, row + 0.5, row + 0.5)
            if left > right:
                continue
            for column in range(max(int(np.ceil(left - 0.5)), 0), min(int(np.floor(right - 0.5)), width - 1) + 1):
                owner[row, column] = f


@kernel
def _between(place, size):
    """(texel before, texel after, share of the second) of a look-up at place, in texels, clamped to 0..size - 1."""
    place = min(max(place - 0.5, 0.0), size - 1.0)
    low = min(int(place), max(size - 2, 0))
    return low, min(low + 1, size - 1), np.float32(place - low)


@kernel
def _add_right(x, y, weight, shown, number, right):
    """Add B^T W s to right, float32 [C, n]. shown: s, float32 [M, C]. Bounds: _between() clamps rows and columns; texels with
    number -1 are skipped."""
    height, width = number.shape
    for i in range(x.shape[0]):
        c0, c1, u = _between(x[i], width)
        r0, r1, v = _between(y[i], height)
        for corner in range(4):
            n = number[r1 if corner > 1 else r0, c1 if corner % 2 else c0]
            if n < 0:
                continue
            w = weight[i] * (v if corner > 1 else 1 - v) * (u if corner % 2 else 1 - u)
            for c in range(shown.shape[1]):
                right[c, n] += w * shown[i, c]


@kernel
def _add_matrix(x, y, weight, number, matrix):
    """Add B^T W B to matrix, float32 [n, 5]: products of a texel with itself, its right neighbour, the texel below, and the
    texels below right and below left. Bounds: as _add_right()."""
    height, width = number.shape
    for i in range(x.shape[0]):
        c0, c1, u = _between(x[i], width)
        r0, r1, v = _between(y[i], height)
        a, b, c, d = number[r0, c0], number[r0, c1], number[r1, c0], number[r1, c1]
        root = np.sqrt(weight[i])
        wa, wb, wc, wd = root * (1 - v) * (1 - u), root * (1 - v) * u, root * v * (1 - u), root * v * u
        if a >= 0:
            matrix[a, 0] += wa * wa
            matrix[a, 1] += wa * wb
            matrix[a, 2] += wa * wc
            matrix[a, 3] += wa * wd
        if b >= 0:
            matrix[b, 0] += wb * wb
            matrix[b, 2] += wb * wd
            matrix[b, 4] += wb * wc
        if c >= 0:
            matrix[c, 0] += wc * wc
            matrix[c, 1] += wc * wd
        if d >= 0:
            matrix[d, 0] += wd * wd


@kernel
def _row_of(t, matrix, number, row, column):
    """Sum of the neighbours of a covered texel, weighted by B^T B. Bounds: rows and columns are compared with the image before
    they index it."""
    height, width = number.shape
    n, total = number[row, column], np.float32(0)
    for k in range(1, 5):
        down = 0 if k == 1 else 1
        right = 0 if k == 2 else (-1 if k == 4 else 1)
        r, c = row + down, column + right
        if r < height and 0 <= c < width and number[r, c] >= 0:
            total += matrix[n, k] * t[number[r, c]]
        r, c = row - down, column - right
        if r >= 0 and 0 <= c < width and number[r, c] >= 0:
            total += matrix[number[r, c], k] * t[number[r, c]]
    return total


@kernel
def _sweep(t, right, matrix, number, damping, backwards):
    """Gauss-Seidel sweep over all texels of a channel, t float32 [n], in place, each clipped to 0..255."""
    height, width = number.shape
    for i in range(height):
        row = height - 1 - i if backwards else i
        for j in range(width):
            column = width - 1 - j if backwards else j
            n = number[row, column]
            if n >= 0:
                value = (right[n] - _row_of(t, matrix, number, row, column)) / (matrix[n, 0] + damping)
                t[n] = min(max(value, np.float32(0)), np.float32(255))
