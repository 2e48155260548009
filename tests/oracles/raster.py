"""Rasterisation in plain Python with exact fractions: every face against every pixel, no spans, no bands, no buffers.

The top-left rule is had without naming it: a sample that is moved a hair to the right and a hair's hair down lies inside exactly
one of the faces along an edge.
"""

import math
from fractions import Fraction

HAIR = Fraction(1, 1 << 24)


def look(camera, point):
    """(x, y, depth, w) of one world point on the camera's screen, y downwards; w is 1 when orthographic."""
    offset = [p - e for p, e in zip(point, camera.eye, strict=True)]
    along = [sum(a * b for a, b in zip(axis, offset, strict=True)) for axis in (camera.right, camera.up, camera.forward)]
    w = along[2] if camera.perspective else 1.0
    scale = camera.height / (2 * camera.half)
    return camera.width / 2 + scale * along[0] / w, camera.height / 2 - scale * along[1] / w, along[2], w


def snap(value):
    """The nearest multiple of 1/256, the upper of two."""
    return Fraction(math.floor(Fraction(value) * 256 + Fraction(1, 2)), 256)


def turn(a, b, c):
    """Twice the signed area; positive for corners that run clockwise on a screen with y downwards."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])


def covers(corners, x, y):
    """Whether snapped corners cover the centre of pixel (x, y)."""
    sample = (x + Fraction(1, 2) + HAIR, y + Fraction(1, 2) + HAIR * HAIR)
    sides = [turn(corners[i], corners[(i + 1) % 3], sample) for i in range(3)]
    return all(s > 0 for s in sides) or all(s < 0 for s in sides)


def weights(corners, x, y):
    """Screen-space barycentric coordinates of a pixel centre, floats, from corners that were not snapped."""
    centre = (x + 0.5, y + 0.5)
    parts = [turn(corners[(i + 1) % 3], corners[(i + 2) % 3], centre) for i in range(3)]
    return [p / sum(parts) for p in parts]


def rasterise(camera, positions, faces, cull=True, two_sided=()):
    """{(x, y): [(depth, face), ...] in ascending depth} of every covered pixel; all corners must lie before the camera."""
    seen = [look(camera, p) for p in positions]
    out = {}
    for number, face in enumerate(faces):
        corners = [seen[i] for i in face]
        snapped = [(snap(c[0]), snap(c[1])) for c in corners]
        area = turn(*snapped)
        if area == 0 or (cull and area > 0 and number not in two_sided):
            continue
        for y in range(camera.height):
            for x in range(camera.width):
                if covers(snapped, x, y):
                    out.setdefault((x, y), []).append((_depth(camera, corners, x, y), number))
    return {pixel: sorted(faces_there) for pixel, faces_there in out.items()}


def _depth(camera, corners, x, y):
    """Depth of a face at a pixel centre, linear in depth (orthographic) or in 1 / depth, no farther than its corners."""
    values = [1 / c[2] if camera.perspective else c[2] for c in corners]
    value = sum(w * v for w, v in zip(weights(corners, x, y), values, strict=True))
    value = min(max(value, min(values)), max(values))
    return 1 / value if camera.perspective else value


def first_hit(camera, positions, faces, x, y):
    """(depth, face) where the ray through the centre of pixel (x, y) meets the mesh first, on either side; None: nowhere."""
    pixel = 2 * camera.half / camera.height
    right, down = (x + 0.5 - camera.width / 2) * pixel, (y + 0.5 - camera.height / 2) * pixel
    ray = [f + right * r - down * u for f, r, u in zip(camera.forward, camera.right, camera.up, strict=True)]
    hits = []
    for number, (i, j, k) in enumerate(faces):
        a, b, c = ([p - e for p, e in zip(positions[n], camera.eye, strict=True)] for n in (i, j, k))
        u, v, w = det(ray, b, c), det(ray, c, a), det(ray, a, b)
        if u + v + w != 0 and min(u, v, w) * max(u, v, w) >= 0 and det(a, b, c) / (u + v + w) > 0:
            hits.append((det(a, b, c) / (u + v + w), number))
    return min(hits, default=None)


def det(a, b, c):
    """Determinant of three rows."""
    return (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]))


def levels(keys, values, level):
    """{key >> 3 level: mean of the values} by plain sums."""
    groups = {}
    for key, value in zip(keys, values, strict=True):
        groups.setdefault(key >> 3 * level, []).append(value)
    return {key: [sum(v) / len(rows) for v in zip(*rows, strict=True)] for key, rows in groups.items()}
