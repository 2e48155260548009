"""The loop of the simplification: it collapses the cheapest allowed edge, again and again (encoder only).

The heap keeps stale entries and recognises them by the versions of their ends; ties go to the lower vertices. An edge that may
not collapse in its turn is tried again when one of its ends has changed, and once more when the heap is empty.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.kernel import kernel
from .quadrics import _error_at, _least_place, vertex_quadrics
from .topology import FIXED, FREE, turned_faces

MOST_FACES = 2**29
TURN = 0.2  # cosine of the largest angle by which a collapse may turn a face


class Collapsed(NamedTuple):
    """kept, removed: int32 [C]; placed: float64 [C, 3]; error: float64 [C], the quadric error there; fixed: bool [C], whether the
    kept vertex stays in place; remaining: int32 [C], faces; last: int32 [F], the collapse that removes a face, C if none does."""

    kept: np.ndarray
    removed: np.ndarray
    placed: np.ndarray
    error: np.ndarray
    fixed: np.ndarray
    remaining: np.ndarray
    last: np.ndarray


class _Work(NamedTuple):
    """positions [V, 3], quadrics [V, 10]; kind int8 [V]; faces [F, 3], marked [F, 3], their sides that are lines; last [F], -1 as
    long as a face exists; turned [F], whether it is still one of turned_faces(); head, tail [V] and after [3 F]: the corners
    3 f + i of every vertex as a list that ends with -1; version [V], which rises when a vertex changes, -1 when it is removed;
    mark int64 [V], stamp [1]: sets of vertices; place [3], total [10]: place and quadric of the current edge. Numbers of
    corners are below 2^31 (3 MOST_FACES), all others smaller: int32, half of what the arrays would take."""

    positions: np.ndarray
    quadrics: np.ndarray
    kind: np.ndarray
    faces: np.ndarray
    marked: np.ndarray
    last: np.ndarray
    turned: np.ndarray
    head: np.ndarray
    tail: np.ndarray
    after: np.ndarray
    version: np.ndarray
    mark: np.ndarray
    stamp: np.ndarray
    place: np.ndarray
    total: np.ndarray


class _Heap(NamedTuple):
    """error [N]; entry int32 [N, 4]: the ends of an edge, the lower first, and their versions; size [1]."""

    error: np.ndarray
    entry: np.ndarray
    size: np.ndarray


def collapse_all(positions: np.ndarray, faces: np.ndarray, marked: np.ndarray, kind: np.ndarray, edges: int) -> Collapsed:
    """Collapse allowed edges in the order of their quadric error until none is left; return all collapses in order. positions:
    float64 [V, 3] in -1..1; faces: int64 [F, 3] without equal corners; marked: bool [F, 3], sides that are lines; kind: int64
    [V], of vertex_kinds(); edges: the number that the faces have."""
    vertices, count, int32 = len(positions), len(faces), np.int32
    if count > MOST_FACES:
        raise ValueError(f"{count} faces are too many")
    work = _Work(positions.copy(), vertex_quadrics(positions, faces, marked), kind.astype(np.int8), faces.astype(int32),
                 marked.astype(np.uint8), np.full(count, -1, int32), turned_faces(positions, faces), np.full(vertices, -1, int32),
                 np.full(vertices, -1, int32), np.full(3 * count, -1, int32), np.zeros(vertices, int32),
                 np.zeros(vertices, np.int64), np.zeros(1, np.int64), np.zeros(3), np.zeros(10))
    room = 2 * edges + 16  # an edge has one entry that counts: a full heap is half stale at least
    heap = _Heap(np.empty(room), np.empty((room, 4), int32), np.zeros(1, np.int64))
    ends, placed, remaining = np.empty((vertices, 2), int32), np.empty((vertices, 4)), np.empty(vertices, int32)
    done = _collapse_all(work, heap, ends, placed, remaining)
    last = np.where(work.last >= 0, work.last, int32(done))
    kept, removed = np.ascontiguousarray(ends[:done].T)
    fixed = work.kind[kept] == FIXED  # a vertex is fixed from the start: one that is joined to it goes to it
    return Collapsed(kept, removed, placed[:done, :3].copy(), placed[:done, 3].copy(), fixed, remaining[:done].copy(), last)


@kernel
def _collapse_all(work, heap, ends, placed, remaining):
    """Fill the rows of ends (kept, removed), placed (and the error) and remaining; return their number."""
    faces = work.faces.shape[0]
    for corner in range(3 * faces):
        v = work.faces[corner // 3, corner % 3]
        if work.head[v] < 0:
            work.head[v] = corner
        else:
            work.after[work.tail[v]] = corner
        work.tail[v] = corner
    done, before = 0, -1
    while done > before:
        before = done
        for v in range(work.head.shape[0]):
            if work.version[v] >= 0:
                _push_edges(work, heap, v, True)
        while heap.size[0] > 0:
            a, b = np.int64(heap.entry[0, 0]), np.int64(heap.entry[0, 1])
            version_a, version_b = heap.entry[0, 2], heap.entry[0, 3]
            _pop(heap)
            if work.version[a] != version_a or work.version[b] != version_b:
                continue
            if work.kind[b] == FIXED:
                a, b = b, a
            if not _may_join(work, a, b):
                continue
            placed[done, 3] = _error_of(work, a, b)
            if _turns(work, a, b) or _turns(work, b, a):
                continue
            gone = _join_vertices(work, a, b, done)
            faces -= gone
            ends[done, 0], ends[done, 1] = a, b
            for k in range(3):
                placed[done, k] = work.place[k]
            remaining[done] = faces
            done += 1
            _push_edges(work, heap, a, False)
    return done


@kernel
def _error_of(work, a, b):
    """Return the error of joining two vertices, and write the place into work.place."""
    p, r = work.positions[a], work.positions[b]
    for k in range(10):
        work.total[k] = work.quadrics[a, k] + work.quadrics[b, k]
    if work.kind[a] == FIXED or work.kind[b] == FIXED:
        own = p if work.kind[a] == FIXED else r
        for k in range(3):
            work.place[k] = own[k]
        return _error_at(work.total, own[0], own[1], own[2])
    return _least_place(work.total, p, r, work.place)


@kernel
def _push_edges(work, heap, v, upwards):
    """Put the edges of a vertex on the heap, all or those to higher vertices, unless their lines forbid a collapse for good."""
    work.stamp[0] += 1
    stamp = work.stamp[0]
    corner = work.head[v]
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        if work.last[f] >= 0:
            continue
        for step in (1, 2):
            other = work.faces[f, (i + step) % 3]
            if work.mark[other] == stamp or (upwards and other < v):
                continue
            work.mark[other] = stamp
            line = work.marked[f, i if step == 1 else (i + 2) % 3]
            both = work.kind[v] != FREE and work.kind[other] != FREE
            if both and (not line or (work.kind[v] == FIXED and work.kind[other] == FIXED)):
                continue
            a, b = min(v, other), max(v, other)
            _push(work, heap, _error_of(work, a, b), a, b)


@kernel
def _may_join(work, a, b):
    """Return whether the edge can collapse without a change of topology: its ends have no common neighbours but those across its
    faces (the link condition), and no two lines become the same line."""
    work.stamp[0] += 2
    ring, common = work.stamp[0] - 1, work.stamp[0]
    shared, first, second = 0, -1, -1
    corner = work.head[a]
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        if work.last[f] >= 0:
            continue
        j, k = (i + 1) % 3, (i + 2) % 3
        x, y = work.faces[f, j], work.faces[f, k]
        work.mark[x] = work.mark[y] = ring
        if x == b or y == b:
            shared += 1
            first, second = (y if x == b else x), first
            if work.marked[f, j] and work.marked[f, k if x == b else i]:  # the two sides at the third corner
                return False
    neighbours, closes = 0, False
    corner = work.head[b]
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        if work.last[f] >= 0:
            continue
        x, y = work.faces[f, (i + 1) % 3], work.faces[f, (i + 2) % 3]
        closes |= min(x, y) == min(first, second) and max(x, y) == max(first, second)
        for other in (x, y):
            if other != a and work.mark[other] == ring:
                work.mark[other] = common
                neighbours += 1
    return 1 <= shared <= 2 and neighbours == shared and not (closes and _has_face(work, a, first, second))


@kernel
def _has_face(work, v, x, y):
    corner = work.head[v]
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        if work.last[f] < 0:
            p, q = work.faces[f, (i + 1) % 3], work.faces[f, (i + 2) % 3]
            if (p == x and q == y) or (p == y and q == x):
                return True
    return False


@kernel
def _turns(work, v, other):
    """Return whether a remaining face at v turns too far, or loses its area, when v moves to work.place; a turned face has to
    turn back."""
    corner, p, to = work.head[v], work.positions[v], work.place
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        x, y = work.faces[f, (i + 1) % 3], work.faces[f, (i + 2) % 3]
        if work.last[f] >= 0 or x == other or y == other:
            continue
        r, s = work.positions[x], work.positions[y]
        ex, ey, ez = s[0] - r[0], s[1] - r[1], s[2] - r[2]
        ux, uy, uz = p[0] - r[0], p[1] - r[1], p[2] - r[2]
        vx, vy, vz = to[0] - r[0], to[1] - r[1], to[2] - r[2]
        ax, ay, az = ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux
        bx, by, bz = ey * vz - ez * vy, ez * vx - ex * vz, ex * vy - ey * vx
        old, new = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
        along = ax * bx + ay * by + az * bz
        if old > 0.0 and not (-along if work.turned[f] else along) > TURN * np.sqrt(old * new):
            return True
    return False


@kernel
def _join_vertices(work, a, b, step):
    """Move the faces of b to a, and a to work.place; return the number of removed faces."""
    gone = 0
    for v in (a, b):
        corner = work.head[v]
        while corner >= 0:
            work.turned[corner // 3] = False
            corner = work.after[corner]
    corner = work.head[b]
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        if work.last[f] >= 0:
            continue
        j, k = (i + 1) % 3, (i + 2) % 3
        if work.faces[f, j] == a or work.faces[f, k] == a:
            work.last[f] = step
            gone += 1
            ahead = work.faces[f, j] == a  # j is the side between a and the third corner, whichever way round
            if work.marked[f, j] or work.marked[f, k if ahead else i]:
                opposite = work.faces[f, k if ahead else j]
                _mark_line(work, a, opposite)
                _mark_line(work, b, opposite)
        work.faces[f, i] = a
    _link(work, a, b)
    for k in range(10):
        work.quadrics[a, k] += work.quadrics[b, k]
    for k in range(3):
        work.positions[a, k] = work.place[k]
    work.kind[a] = max(work.kind[a], work.kind[b])
    work.version[a] += 1
    work.version[b] = -1
    return gone


@kernel
def _link(work, a, b):
    """Append the corners of b to those of a, without those of removed faces."""
    last = -1
    for v in (a, b):
        corner = work.head[v]
        while corner >= 0:
            further = work.after[corner]
            if work.last[corner // 3] < 0:
                if last < 0:
                    work.head[a] = corner
                else:
                    work.after[last] = corner
                last = corner
            corner = further
    if last < 0:
        work.head[a] = -1
    else:
        work.after[last] = -1
    work.tail[a] = last


@kernel
def _mark_line(work, v, other):
    """Mark the sides between v and other as a line."""
    corner = work.head[v]
    while corner >= 0:
        f, i = corner // 3, corner % 3
        corner = work.after[corner]
        if work.faces[f, (i + 1) % 3] == other:
            work.marked[f, i] = 1
        if work.faces[f, (i + 2) % 3] == other:
            work.marked[f, (i + 2) % 3] = 1


@kernel
def _before(heap, i, j):
    """Return whether entry i comes before entry j: by error, then by the ends."""
    if heap.error[i] != heap.error[j]:
        return heap.error[i] < heap.error[j]
    if heap.entry[i, 0] != heap.entry[j, 0]:
        return heap.entry[i, 0] < heap.entry[j, 0]
    return heap.entry[i, 1] < heap.entry[j, 1]


@kernel
def _swap(heap, i, j):
    heap.error[i], heap.error[j] = heap.error[j], heap.error[i]
    for k in range(4):
        heap.entry[i, k], heap.entry[j, k] = heap.entry[j, k], heap.entry[i, k]


@kernel
def _copy(heap, i, j):
    """Copy entry j to entry i."""
    heap.error[i] = heap.error[j]
    for k in range(4):
        heap.entry[i, k] = heap.entry[j, k]


@kernel
def _sink(heap, i):
    size = heap.size[0]
    while 2 * i + 1 < size:
        child = 2 * i + 1
        if child + 1 < size and _before(heap, child + 1, child):
            child += 1
        if not _before(heap, child, i):
            return
        _swap(heap, child, i)
        i = child


@kernel
def _pop(heap):
    heap.size[0] -= 1
    _copy(heap, 0, heap.size[0])
    _sink(heap, 0)


@kernel
def _push(work, heap, error, a, b):
    if heap.size[0] == heap.error.shape[0]:
        _drop_stale(work, heap)
    i = heap.size[0]
    heap.size[0] += 1
    heap.error[i] = error
    heap.entry[i, 0], heap.entry[i, 1] = a, b
    heap.entry[i, 2], heap.entry[i, 3] = work.version[a], work.version[b]
    while i > 0 and _before(heap, i, (i - 1) // 2):
        _swap(heap, i, (i - 1) // 2)
        i = (i - 1) // 2


@kernel
def _drop_stale(work, heap):
    kept = 0
    for i in range(heap.size[0]):
        a, b = heap.entry[i, 0], heap.entry[i, 1]
        if work.version[a] == heap.entry[i, 2] and work.version[b] == heap.entry[i, 3]:
            _copy(heap, kept, i)
            kept += 1
    heap.size[0] = kept
    for i in range(kept // 2 - 1, -1, -1):
        _sink(heap, i)
