"""Edge collapses by quadric error in plain Python: all errors are looked at anew for every collapse."""

from itertools import combinations

import numpy as np

POINT, LINE, TURN = 1e-5, 10.0, 0.2


def collapses(positions, faces, lines=()):
    """[(kept, removed, place, error)] of a mesh without faces of equal corners, whose edges have one or two faces. lines:
    pairs of vertices."""
    mesh = _Mesh(positions, faces, lines)
    out, refused, before = [], {}, -1
    while True:
        candidates = [(*mesh.error(a, b), a, b) for a, b in mesh.edges() if refused.get((a, b)) != mesh.state(a, b)]
        candidates = sorted((error, a, b, tuple(place)) for error, place, a, b in candidates if place is not None)
        for error, a, b, place in candidates:
            if mesh.may_join(a, b) and not mesh.turns(a, b, np.array(place)):
                kept, removed = (b, a) if mesh.kind[b] == 2 else (a, b)
                mesh.join(kept, removed, np.array(place))
                out.append((kept, removed, np.array(place), error))
                break
            refused[a, b] = mesh.state(a, b)
        else:
            if len(out) == before:
                return out
            before, refused = len(out), {}


class _Mesh:
    def __init__(self, positions, faces, lines):
        self.at = {v: np.array(p, float) for v, p in enumerate(positions)}
        self.faces = {tuple(int(v) for v in f) for f in faces}
        sides = [frozenset(s) for f in self.faces for s in combinations(f, 2)]
        self.lines = {s for s in sides if sides.count(s) == 1} | {frozenset(int(v) for v in s) for s in lines}
        self.kind = {v: {0: 0, 2: 1}.get(sum(v in s for s in self.lines), 2) for v in self.at}
        self.changes = dict.fromkeys(self.at, 0)
        self.quadric = {v: np.zeros((4, 4)) for v in self.at}
        for face in self.faces:
            self._add_planes(face)

    def _add_planes(self, face):
        a, b, c = (self.at[v] for v in face)
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal) / 2
        normal /= 2 * area
        for v in face:
            for row in np.eye(3):
                self._add(v, row, self.at[v], POINT * area)
            self._add(v, normal, a, area)
        for v, w in ((face[0], face[1]), (face[1], face[2]), (face[2], face[0])):
            if frozenset((v, w)) in self.lines:
                way = self.at[w] - self.at[v]
                across = np.cross(way, normal)
                for u in (v, w):
                    self._add(u, across / np.linalg.norm(across), self.at[v], LINE * (way @ way))

    def _add(self, v, normal, point, weight):
        plane = np.append(normal, -normal @ point)
        self.quadric[v] += weight * np.outer(plane, plane)

    def edges(self):
        return sorted({tuple(sorted(s)) for f in self.faces for s in combinations(f, 2)})

    def state(self, a, b):
        return self.changes[a], self.changes[b]

    def error(self, a, b):
        """(error, place), the place None where lines forbid the edge."""
        both = self.kind[a] > 0 and self.kind[b] > 0
        if both and (frozenset((a, b)) not in self.lines or self.kind[a] == self.kind[b] == 2):
            return 0.0, None
        q = self.quadric[a] + self.quadric[b]
        stays = [v for v in (a, b) if self.kind[v] == 2]
        place = self.at[stays[0]] if stays else np.linalg.solve(q[:3, :3], -q[:3, 3])
        middle, length = (self.at[a] + self.at[b]) / 2, np.linalg.norm(self.at[a] - self.at[b])
        if not stays and np.linalg.norm(place - middle) > length:
            place = min((middle, self.at[b], self.at[a]), key=lambda p: np.append(p, 1) @ q @ np.append(p, 1))
        return max(0.0, np.append(place, 1) @ q @ np.append(place, 1)), place

    def may_join(self, a, b):
        """The link condition, with a vertex at infinity behind every border."""
        opposite = {v for f in self.faces if {a, b} <= set(f) for v in f} - {a, b}
        around = [{v for f in self.faces if c in f for v in f} - {c} for c in (a, b)]
        sides = [{frozenset(set(f) - {c}) for f in self.faces if c in f} for c in (a, b)]
        merged = any(frozenset((a, v)) in self.lines and frozenset((b, v)) in self.lines for v in opposite)
        return around[0] & around[1] == opposite and not sides[0] & sides[1] and not merged

    def turns(self, a, b, place):
        for face in self.faces:
            if len({a, b} & set(face)) == 1:
                old, new = (np.cross(q - p, r - p) for p, q, r in (
                    [self.at[v] for v in face], [place if v in (a, b) else self.at[v] for v in face]))
                if not old @ new > TURN * np.linalg.norm(old) * np.linalg.norm(new):
                    return True
        return False

    def join(self, kept, removed, place):
        self.faces = {tuple(kept if v == removed else v for v in f) for f in self.faces if not {kept, removed} <= set(f)}
        moved = {frozenset(kept if v == removed else v for v in s) for s in self.lines}
        self.lines = {s for s in moved if len(s) == 2}
        self.at[kept] = place
        self.kind[kept] = max(self.kind[kept], self.kind[removed])
        self.quadric[kept] = self.quadric[kept] + self.quadric[removed]
        self.changes[kept] += 1
