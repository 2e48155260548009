"""Exact nearest points on a mesh: a tree of boxes over faces in Morton order.

On bball_0001 simplified to 35 % of its faces, a million of its own points take 0.7 s on one core, and 1.0 s in random order. Each
search starts from the previous result, so the points are sorted along a Morton curve; unsorted, a random order takes 4.2 s. If a
face's plane is farther than the best result, its triangle is not tested, which saves a third of the time.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..core.kernel import kernel
from ..core.threads import over_blocks
from .mesh import Mesh, face_normals

LEAF = 2  # faces in a leaf; 1, 4 and 8 take 1.03, 1.1 and 1.4 times as long
THINNEST = 1e-16  # squared sine of a triangle's angle, below which its sides are as exact as its inside: both to 1e-8 of its size
NEARLY, SLACK = 1 - 1e-6, 1e-16  # of squared distances to planes: normals of slivers are right to some 1e-8
BLOCK = 1 << 14  # points that one thread looks for at a time
_DEEPEST = 64  # of the stack: two for every level, and 2**31 faces have 29


class Nearest(NamedTuple):
    """Nearest points on a mesh. face: int64 [M]; bary: float64 [M, 3]; distance: float64 [M], in the mesh's units."""

    face: np.ndarray
    bary: np.ndarray
    distance: np.ndarray


class NearestPoints:
    """Finds nearest points on a mesh that has faces. group: int64 [F], a group for each face; None puts all faces in group 0."""

    def __init__(self, mesh: Mesh, group: np.ndarray | None = None) -> None:
        mesh = mesh.checked()
        if not len(mesh.faces):
            raise ValueError("a mesh without faces has no nearest point")
        self._middle, self._half = mesh.frame()
        positions = (mesh.positions - self._middle) / self._half
        self._order = _curve_order(positions[mesh.faces].mean(axis=1))
        corners = positions[mesh.faces[self._order]]
        self._corners, self._boxes = corners.reshape(-1, 9), _boxes_of(corners)
        self._normals = face_normals(corners)
        self._group = np.zeros(len(mesh.faces), np.int64) if group is None else np.asarray(group, np.int64)[self._order]

    @cached_property
    def _place(self):
        """Return the place of every face in the order, int64 [F]."""
        place = np.empty_like(self._order)
        place[self._order] = np.arange(len(place))
        return place

    def normals(self, face: np.ndarray) -> np.ndarray:
        """Return unit normals of faces, float64 [M, 3]; 0 where a face has no area. face: int64 [M]."""
        return self._normals[self._place[face]]

    def find(self, points: np.ndarray, normals: np.ndarray | None = None, turn: float = 0.0, group: np.ndarray | None = None,
             threads: int = 1) -> Nearest:
        """Return the point of the mesh nearest to each of the points. points: float64 [M, 3]. The result does not depend on
        threads.

        normals: float64 [M, 3]; a face that points against a point's normal counts as farther by `turn`, in the mesh's units, so
        that of two layers the one with the same orientation wins. group: int64 [M]; a face of another group than the point's
        also counts as farther by `turn`. The returned distance excludes this.
        """
        points = (np.asarray(points, np.float64) - self._middle) / self._half
        order, count = _curve_order(points), len(points)
        face, bary, distance = np.empty(count, np.int64), np.empty((count, 3)), np.empty(count)

        def search(begin):
            some = order[begin : begin + BLOCK]
            turned = np.zeros((len(some), 3)) if normals is None else np.asarray(normals[some], np.float64)
            own = np.full(len(some), -1) if group is None else np.asarray(group[some], np.int64)
            _search(points[some], turned, own, some, turn / self._half, self._corners, self._normals, self._group, self._boxes,
                    face, bary, distance)
            face[some], distance[some] = self._order[face[some]], distance[some] * self._half

        over_blocks(search, count, BLOCK, threads)
        return Nearest(face, bary, distance)


@kernel
def _spread(cell):
    """Spreads the 21 bits of a cell to every third bit."""
    for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
                        (2, 0x1249249249249249)):
        cell = (cell | cell << shift) & mask
    return cell


@kernel
def _along_curve(points, out):
    """Writes the positions of points along a Morton curve of 21 bits an axis to out int64 [N]. Points outside -1..1 are
    clipped."""
    for i in range(points.shape[0]):
        code = np.int64(0)
        for axis in range(3):
            cell = min(max((points[i, axis] + 1.0) * (1 << 20), 0.0), (1 << 21) - 1.0)
            code |= _spread(np.int64(cell)) << axis
        out[i] = code


def _curve_order(points):
    """The order of points along a Morton curve, int64 [N]."""
    places = np.empty(len(points), np.int64)
    _along_curve(points, places)
    return np.argsort(places, kind="stable")


def _boxes_of(corners):
    """Boxes of the nodes of a full binary tree, float64 [2 P, 6]. Node n has the children 2 n and 2 n + 1, the leaves begin at P,
    and leaf i holds LEAF faces from LEAF i on. Boxes of leaves without faces are infinitely far. corners: float64 [F, 3, 3]."""
    leaves = -(-len(corners) // LEAF)
    first = 1 << (leaves - 1).bit_length()
    boxes = np.full((2 * first, 6), np.inf)
    starts = np.arange(0, len(corners), LEAF)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]  # one by one: a minimum along a short axis takes three times as long
    boxes[first : first + leaves, :3] = np.minimum.reduceat(np.minimum(np.minimum(a, b), c), starts, axis=0)
    boxes[:, 3:] = -np.inf
    boxes[first : first + leaves, 3:] = np.maximum.reduceat(np.maximum(np.maximum(a, b), c), starts, axis=0)
    while first > 1:
        left, right = boxes[first : 2 * first : 2], boxes[first + 1 : 2 * first : 2]
        first //= 2
        boxes[first : 2 * first, :3] = np.minimum(left[:, :3], right[:, :3])
        boxes[first : 2 * first, 3:] = np.maximum(left[:, 3:], right[:, 3:])
    return boxes


@kernel
def _to_box(box, x, y, z):
    """Squared distance from a point to a box."""
    u = max(box[0] - x, 0.0, x - box[3])
    v = max(box[1] - y, 0.0, y - box[4])
    w = max(box[2] - z, 0.0, z - box[5])
    return u * u + v * v + w * w


@kernel
def _along(part, whole):
    return part / whole if whole > 0.0 else 0.0


@kernel
def _on_triangle(t, x, y, z):
    """(weights of the second and the third corner, squared distance) of a triangle's point nearest to (x, y, z)."""
    ux, uy, uz = t[3] - t[0], t[4] - t[1], t[5] - t[2]
    vx, vy, vz = t[6] - t[0], t[7] - t[1], t[8] - t[2]
    px, py, pz = x - t[0], y - t[1], z - t[2]
    # By cross products, whose errors in slivers grow as 1 / sine of the angle, and not as its square does, as dot products' do.
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    whole = nx * nx + ny * ny + nz * nz
    b = (py * vz - pz * vy) * nx + (pz * vx - px * vz) * ny + (px * vy - py * vx) * nz
    c = (uy * pz - uz * py) * nx + (uz * px - ux * pz) * ny + (ux * py - uy * px) * nz
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    if whole > THINNEST * uu * vv and b >= 0.0 and c >= 0.0 and b + c <= whole:
        b, c = b / whole, c / whole
        dx, dy, dz = px - b * ux - c * vx, py - b * uy - c * vy, pz - b * uz - c * vz
        return b, c, dx * dx + dy * dy + dz * dz
    # Not inside: the nearest point of the three sides, each a segment.
    uv, up, vp = ux * vx + uy * vy + uz * vz, ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    b = min(max(_along(up, uu), 0.0), 1.0)
    dx, dy, dz = px - b * ux, py - b * uy, pz - b * uz
    best, best_b, best_c = dx * dx + dy * dy + dz * dz, b, 0.0
    c = min(max(_along(vp, vv), 0.0), 1.0)
    dx, dy, dz = px - c * vx, py - c * vy, pz - c * vz
    d = dx * dx + dy * dy + dz * dz
    if d < best:
        best, best_b, best_c = d, 0.0, c
    c = min(max(_along(vp - up - uv + uu, uu - 2.0 * uv + vv), 0.0), 1.0)
    dx, dy, dz = px - ux - c * (vx - ux), py - uy - c * (vy - uy), pz - uz - c * (vz - uz)
    d = dx * dx + dy * dy + dz * dz
    if d < best:
        best, best_b, best_c = d, 1.0 - c, c
    return best_b, best_c, best


@kernel(allocates=True)
def _search(points, normals, group, order, turn, corners, face_normals, face_group, boxes, face, bary, distance):
    """Fills the rows `order` of face (rows of corners), bary and distance. All lengths are in units in which the mesh is in
    -1..1. Group -1 matches any group."""
    first = boxes.shape[0] // 2
    nodes, far = np.empty(_DEEPEST, np.int64), np.empty(_DEEPEST)
    answer = 0
    for i in range(points.shape[0]):
        x, y, z, row = points[i, 0], points[i, 1], points[i, 2], order[i]
        best, best_b, best_c, away = np.inf, 0.0, 0.0, np.inf
        height = 1
        nodes[0], far[0] = 1, 0.0
        start = answer // LEAF * LEAF  # the leaf that the last point found is looked at first: it bounds the search
        leaf = True
        while leaf or height > 0:
            if not leaf:
                height -= 1
                if far[height] >= best:
                    continue
                node = nodes[height]
                if node < first:
                    a = _to_box(boxes[2 * node], x, y, z)
                    b = _to_box(boxes[2 * node + 1], x, y, z)
                    near = 2 * node if a <= b else 2 * node + 1
                    nodes[height], far[height] = 4 * node + 1 - near, max(a, b)
                    nodes[height + 1], far[height + 1] = near, min(a, b)
                    height += 2
                    continue
                start = (node - first) * LEAF
            leaf = False
            for f in range(start, min(start + LEAF, corners.shape[0])):
                n, t = face_normals[f], corners[f]
                off = (x - t[0]) * n[0] + (y - t[1]) * n[1] + (z - t[2]) * n[2]
                if off * off * NEARLY - SLACK > best:  # its plane is farther away
                    continue
                b, c, d = _on_triangle(t, x, y, z)
                key = d
                if turn > 0.0 and d < best:
                    wrong = turn if n[0] * normals[i, 0] + n[1] * normals[i, 1] + n[2] * normals[i, 2] < 0.0 else 0.0
                    if group[i] >= 0 and group[i] != face_group[f]:
                        wrong += turn
                    if wrong > 0.0:
                        key = (np.sqrt(d) + wrong) ** 2
                if key < best:
                    best, answer = key, f
                    best_b, best_c, away = b, c, d
        face[row], distance[row] = answer, np.sqrt(away)
        bary[row, 0], bary[row, 1], bary[row, 2] = max(1.0 - best_b - best_c, 0.0), best_b, best_c
