"""Signed distances of a mesh on a grid, and their coding: a narrow band around the surface, quantised, for sdf.py.

Signs are those of generalised winding numbers (Jacobson and others, 2013): inside is where the faces, seen from there, cover more
than half of all directions. Clusters of faces that are far away count as one dipole (Barnes and Hut). Small holes and faces that
run through each other do no harm; a sheet has no inside and is refused (lost_share).

Only the corners of cells that the surface crosses need their distance, all others no more than their sign. Values are predicted
from the seven neighbours behind them as planes are, and the differences coded by our own adaptive range coder; where only the
sign is needed, whatever was predicted stands if its sign is right.
"""

import numpy as np

from texfcodec.codecs.raht.entropy.contexts import _dec_escape, _enc_escape
from texfcodec.codecs.raht.entropy.range_coder import Coder, _dec_bit, _enc_bit, finish, new_contexts, new_decoder, new_encoder
from texfcodec.core.kernel import kernel
from texfcodec.field.morton import encode_morton
from texfcodec.geometry.areas import sample_surface
from texfcodec.geometry.mesh import face_normals

LEAF, FAR = 8, 3.0  # faces of a leaf; from how many radii on a cluster counts as one dipole
BAND = 1.8  # cells: corners of crossed cells are at most the square root of 3 away
PAD = 2  # cells around the mesh
PROBES = 20_000
UNARY = 12
NEAR, SIGNS, ENERGIES = 4, 4, 5
ZERO_CONTEXTS = NEAR * SIGNS * ENERGIES


class Winding:
    """Generalised winding numbers around a mesh. corners: float64 [F, 3, 3], F >= 1."""

    def __init__(self, corners):
        low, side = corners.min(axis=(0, 1)), np.ptp(corners, axis=(0, 1)).max()
        centre = ((corners.mean(axis=1) - low) / max(side, 1e-300) * 65535).astype(np.int64)
        corners = corners[np.argsort(encode_morton(np.clip(centre, 0, 65535)))]
        leaves = 1 << max(-(-len(corners) // LEAF) - 1, 0).bit_length()
        corners = np.concatenate([corners, np.broadcast_to(corners[-1:, :1], (leaves * LEAF - len(corners), 3, 3))])
        self._corners = np.ascontiguousarray(corners)
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        weight = np.maximum(np.linalg.norm(area, axis=1), 1e-300)[:, None]
        self._dipole, self._centre, self._radius = np.zeros((2 * leaves, 3)), np.zeros((2 * leaves, 3)), np.zeros(2 * leaves)
        number, faces = leaves, LEAF
        while number:
            mine = slice(number, 2 * number)
            self._dipole[mine] = area.reshape(number, faces, 3).sum(axis=1)
            weights = weight.reshape(number, faces, 1)
            self._centre[mine] = (weights * corners.mean(axis=1).reshape(number, faces, 3)).sum(axis=1) / weights.sum(axis=1)
            away = corners.reshape(number, -1, 3) - self._centre[mine, None]
            self._radius[mine] = np.sqrt((away * away).sum(axis=2).max(axis=1))
            number, faces = number // 2, faces * 2

    def at(self, points):
        """Winding number at points float64 [M, 3]: float64 [M]."""
        out = np.empty(len(points))
        _winding(np.ascontiguousarray(points), self._corners, self._dipole, self._centre, self._radius, out)
        return out


@kernel
def _solid_angle(corners, f, x, y, z):
    """Signed solid angle of a triangle from a point (van Oosterom and Strackee)."""
    ax, ay, az = corners[f, 0, 0] - x, corners[f, 0, 1] - y, corners[f, 0, 2] - z
    bx, by, bz = corners[f, 1, 0] - x, corners[f, 1, 1] - y, corners[f, 1, 2] - z
    cx, cy, cz = corners[f, 2, 0] - x, corners[f, 2, 1] - y, corners[f, 2, 2] - z
    a, b, c = np.sqrt(ax * ax + ay * ay + az * az), np.sqrt(bx * bx + by * by + bz * bz), np.sqrt(cx * cx + cy * cy + cz * cz)
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
    return 2.0 * np.arctan2(volume, a * b * c + ab * c + bc * a + ca * b)


@kernel(allocates=True)
def _winding(points, corners, dipole, centre, radius, out):
    """Winding numbers into out. The tree is a heap whose second half are leaves of LEAF faces; its depth is below 60."""
    leaves = radius.shape[0] // 2
    stack = np.empty(128, np.int64)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        total, top = 0.0, 1
        stack[0] = 1
        while top > 0:
            top -= 1
            node = stack[top]
            dx, dy, dz = centre[node, 0] - x, centre[node, 1] - y, centre[node, 2] - z
            away = np.sqrt(dx * dx + dy * dy + dz * dz)
            if away > FAR * radius[node]:
                total += (dipole[node, 0] * dx + dipole[node, 1] * dy + dipole[node, 2] * dz) / max(away**3, 1e-300)
            elif node >= leaves:
                for f in range((node - leaves) * LEAF, (node - leaves + 1) * LEAF):
                    total += _solid_angle(corners, f, x, y, z)
            else:
                stack[top], stack[top + 1] = 2 * node, 2 * node + 1
                top += 2
        out[i] = total / (4.0 * np.pi)


def lost_share(positions, faces, winding, step):
    """Share of the surface that is seen from outside and has no inside behind it, at PROBES points that are looked at a step to
    either side."""
    face, bary = sample_surface(positions, faces, PROBES)
    corners = positions[faces[face]]
    points, normals = np.einsum("mk,mkc->mc", bary, corners), face_normals(corners)
    before, behind = (winding.at(points + side * step * normals) for side in (1, -1))
    return float(((before < 0.5) & (behind < 0.5)).mean())


@kernel
def _edge_distance(corners, f, i, x, y, z):
    """Squared distance of a point from edge i of a triangle."""
    j = (i + 1) % 3
    ex, ey, ez = (corners[f, j, 0] - corners[f, i, 0], corners[f, j, 1] - corners[f, i, 1], corners[f, j, 2] - corners[f, i, 2])
    px, py, pz = x - corners[f, i, 0], y - corners[f, i, 1], z - corners[f, i, 2]
    t = min(max((px * ex + py * ey + pz * ez) / max(ex * ex + ey * ey + ez * ez, 1e-300), 0.0), 1.0)
    px, py, pz = px - t * ex, py - t * ey, pz - t * ez
    return px * px + py * py + pz * pz


@kernel
def _triangle_distance(corners, f, x, y, z):
    """Squared distance of a point from a triangle."""
    ux, uy, uz = corners[f, 1, 0] - corners[f, 0, 0], corners[f, 1, 1] - corners[f, 0, 1], corners[f, 1, 2] - corners[f, 0, 2]
    vx, vy, vz = corners[f, 2, 0] - corners[f, 0, 0], corners[f, 2, 1] - corners[f, 0, 1], corners[f, 2, 2] - corners[f, 0, 2]
    px, py, pz = x - corners[f, 0, 0], y - corners[f, 0, 1], z - corners[f, 0, 2]
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    up, vp = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    area = uu * vv - uv * uv
    s, t = vv * up - uv * vp, uu * vp - uv * up
    if area > 1e-30 and s >= 0 and t >= 0 and s + t <= area:
        px, py, pz = px - (s * ux + t * vx) / area, py - (s * uy + t * vy) / area, pz - (s * uz + t * vz) / area
        return px * px + py * py + pz * pz
    return min(_edge_distance(corners, f, 0, x, y, z),
               min(_edge_distance(corners, f, 1, x, y, z), _edge_distance(corners, f, 2, x, y, z)))


@kernel(allocates=True)
def _band(corners, squared):
    """Least squared distance into squared float32 [X, Y, Z], which holds BAND**2 at first. corners: in grid units."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(corners.shape[0]):
        for c in range(3):
            low[c] = max(np.int64(np.ceil(min(corners[f, 0, c], min(corners[f, 1, c], corners[f, 2, c])) - BAND)), 0)
            high[c] = min(np.int64(np.floor(max(corners[f, 0, c], max(corners[f, 1, c], corners[f, 2, c])) + BAND)) + 1,
                          squared.shape[c])
        for x in range(low[0], high[0]):
            for y in range(low[1], high[1]):
                for z in range(low[2], high[2]):
                    distance = _triangle_distance(corners, f, np.float64(x), np.float64(y), np.float64(z))
                    if distance < squared[x, y, z]:
                        squared[x, y, z] = distance


def signed_distances(corners, shape, winding):
    """Distances float32 [X, Y, Z] in cells, negative inside, exact up to BAND and of that size elsewhere. corners: float64
    [F, 3, 3] in grid units, PAD or more inside of the grid; winding: a Winding of them."""
    squared = np.full(shape, BAND * BAND, np.float32)
    _band(np.ascontiguousarray(corners), squared)
    band = squared < BAND * BAND
    inside = np.zeros(shape, bool)
    inside[band] = winding.at(np.argwhere(band).astype(np.float64)) > 0.5
    # outside the band nothing is crossed: the sign of the last point of the band in the row, outside where there is none
    last = np.maximum.accumulate(np.where(band, np.arange(shape[2]), -1), axis=2)
    inside &= band
    inside = np.take_along_axis(inside, np.maximum(last, 0), axis=2) & (last >= 0)
    return np.where(inside, -1, 1) * np.sqrt(squared)


def quantised(distances, steps):
    """Distances in steps of 1 / steps of a cell: (int16 [X, Y, Z], n standing for (n + 1/2) / steps; bool [X, Y, Z]: corners of
    crossed cells). Never zero, so that no sign is lost."""
    most = most_steps(steps)
    values = np.clip(np.floor(distances * steps), -most, most - 1).astype(np.int16)
    inside, mixed = values < 0, np.zeros(values.shape, bool)
    cells = [inside[tuple(slice(k, n - 1 + k) for k, n in zip(at, inside.shape, strict=True))] for at in np.ndindex(2, 2, 2)]
    crossed = np.logical_or.reduce(cells) & ~np.logical_and.reduce(cells)
    for at in np.ndindex(2, 2, 2):
        mixed[tuple(slice(k, n - 1 + k) for k, n in zip(at, inside.shape, strict=True))] |= crossed
    return values, mixed


def most_steps(steps):
    """Values are in -most..most - 1."""
    return int(np.ceil(BAND * steps))


@kernel
def _look(field, x, y, z, most, found):
    """What is known before the value of point (x, y, z), which stands one further along every axis of field: prediction and
    context of whether it is right, into found int64 [2]. The last component of field int16 [X, Y, Z, 2] holds differences."""
    a, b, c = np.int64(field[x, y + 1, z + 1, 0]), np.int64(field[x + 1, y, z + 1, 0]), np.int64(field[x + 1, y + 1, z, 0])
    predicted = a + b + c - field[x, y, z + 1, 0] - field[x, y + 1, z, 0] - field[x + 1, y, z, 0] + field[x, y, z, 0]
    predicted = min(max(predicted, -most), most - 1)
    size = abs(2 * predicted + 1)  # in half steps
    near = 0 if size < most // 2 else (1 if size < most else (2 if size < 2 * most - 1 else 3))
    signs = (1 if a < 0 else 0) + (1 if b < 0 else 0) + (1 if c < 0 else 0)
    energy = abs(field[x, y + 1, z + 1, 1]) + abs(field[x + 1, y, z + 1, 1]) + abs(field[x + 1, y + 1, z, 1])
    energy = min(energy, 3) if energy < 6 else 4
    found[0], found[1] = predicted, (near * SIGNS + signs) * ENERGIES + energy


@kernel(allocates=True)
def _enc_values(coder, contexts, values, needed, most, field):
    """Codes values int16 [X, Y, Z], exact where needed, of the same sign elsewhere; field: as _look() has it."""
    found = np.empty(2, np.int64)
    state, out = coder.state, coder.buffer
    for x in range(values.shape[0]):
        for y in range(values.shape[1]):
            for z in range(values.shape[2]):
                _look(field, x, y, z, most, found)
                value = np.int64(values[x, y, z])
                if not needed[x, y, z]:
                    value = found[0] if (found[0] < 0) == (value < 0) else (-1 if value < 0 else 0)
                rest = value - found[0]
                field[x + 1, y + 1, z + 1, 0], field[x + 1, y + 1, z + 1, 1] = value, rest
                _enc_bit(state, out, contexts, found[1], 1 if rest else 0)
                if rest == 0:
                    continue
                base = ZERO_CONTEXTS + (found[1] % ENERGIES) * (UNARY + 4)
                _enc_bit(state, out, contexts, base + UNARY + (found[1] // ENERGIES) % SIGNS, 1 if rest < 0 else 0)
                size = abs(rest)
                for n in range(1, UNARY + 1):
                    _enc_bit(state, out, contexts, base + n - 1, 1 if size > n else 0)
                    if size <= n:
                        break
                if size > UNARY:
                    _enc_escape(state, out, size - UNARY)


@kernel(allocates=True)
def _dec_values(coder, contexts, shape, most, field):
    """Mirror of _enc_values: fills field."""
    found = np.empty(2, np.int64)
    state, data, end = coder.state, coder.buffer, coder.end
    for x in range(shape[0]):
        for y in range(shape[1]):
            for z in range(shape[2]):
                _look(field, x, y, z, most, found)
                rest = np.int64(0)
                if _dec_bit(state, data, end, contexts, found[1]):
                    base = ZERO_CONTEXTS + (found[1] % ENERGIES) * (UNARY + 4)
                    negative = _dec_bit(state, data, end, contexts, base + UNARY + (found[1] // ENERGIES) % SIGNS)
                    rest = np.int64(1)
                    while rest <= UNARY and _dec_bit(state, data, end, contexts, base + rest - 1):
                        rest += 1
                    if rest > UNARY:
                        rest = UNARY + _dec_escape(state, data, end)
                    rest = -rest if negative else rest
                value = min(max(found[0] + rest, -most), most - 1)
                field[x + 1, y + 1, z + 1, 0], field[x + 1, y + 1, z + 1, 1] = value, rest


def _scratch(shape, steps):
    """(contexts, field before the first value: outside, as far away as can be)."""
    field = np.zeros((*(n + 1 for n in shape), 2), np.int16)
    field[..., 0] = most_steps(steps) - 1
    return new_contexts(ZERO_CONTEXTS + ENERGIES * (UNARY + 4)), field


def enc_distances(values, needed, steps):
    """Bytes of quantised() values."""
    contexts, field = _scratch(values.shape, steps)
    out = np.empty(2 * values.size + 64, np.uint8)
    coder = Coder(new_encoder(), out, 0)
    _enc_values(coder, contexts, values, needed, most_steps(steps), field)
    return finish(coder.state, out)


def dec_distances(data, shape, steps):
    """Mirror of enc_distances: int16 [X, Y, Z], exact where they are needed."""
    contexts, field = _scratch(shape, steps)
    buffer = np.frombuffer(data, np.uint8)
    coder = Coder(new_decoder(buffer, 0, len(buffer)), buffer, len(buffer))
    _dec_values(coder, contexts, np.array(shape, np.int64), most_steps(steps), field)
    return field[1:, 1:, 1:, 0]
