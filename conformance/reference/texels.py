"""Clauses 5.6.2, 6.5 and 8.2.2 in plain Python: which texels the faces ask, place by place, and what a point asks of them."""

import math
from fractions import Fraction

from conformance.reference.voxels import clip, morton_key

REPEAT, CLAMP, MIRROR = 0, 1, 2


def whole_number(value, uv_bits, uv_range):
    """Clause 5.6.2: the integer that a 32-bit float stands for, None where it stands for none."""
    last = (1 << uv_bits) - 1
    if not math.isfinite(value):
        return None
    s = value * (last / uv_range)
    n = math.floor(s + 0.5)
    return (2 * n * uv_range + last) // (2 * last) if 0 <= n <= last and abs(s - n) <= 0.25 else None


def wrap(mode, i, size):
    """Clause 6.5.3."""
    if mode == REPEAT:
        return i % size
    if mode == CLAMP:
        return clip(0, size - 1, i)
    t = i % (2 * size)
    return t if t < size else 2 * size - 1 - t


def meet(triangle, i, j, one):
    """Clause 6.5.2: whether the open square of place (i, j) meets a closed triangle of UVs, `one` steps a texel.

    Two convex figures are apart exactly if a line along a side of one of them has them on its two sides; a line or a point is a
    triangle whose sides run back and forth. All lengths are doubled, so that the square's border is whole.
    """
    corners = [(2 * u, 2 * v) for u, v in triangle]
    square = [((2 * i + p) * one, (2 * j + q) * one) for p in (-1, 3) for q in (-1, 3)]
    sides = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    for x, y in [(1, 0), (0, 1), *((-dv, du) for du, dv in sides)]:
        mine, its = [x * u + y * v for u, v in corners], [x * u + y * v for u, v in square]
        if (x or y) and (max(mine) <= min(its) or min(mine) >= max(its)):
            return False
    return True


def places(triangle, one):
    """All places that a face asks."""
    span = [range(min(axis) // one - 2, max(axis) // one + 3) for axis in zip(*triangle, strict=True)]
    return [(i, j) for j in span[1] for i in span[0] if meet(triangle, i, j, one)]


def referenced_texels(triangles, field):
    """Clause 6.5.4: ascending Morton keys; triangles: corner triples of UVs; field: as clause 5.5 names its elements."""
    texels, one = set(), 1 << field["uv_fraction_bits"]
    for triangle in triangles:
        for i, j in places(triangle, one):
            texels.add((wrap(field["wrap_s"], i, field["width"]), wrap(field["wrap_t"], j, field["height"])))
    return sorted(morton_key(x, y, 0) for x, y in texels)


def fold(mode, u, size):
    """Clause 8.2.2; u: Fraction."""
    if mode == REPEAT:
        return u - size * (u // size)
    if mode == CLAMP:
        return clip(-1, size + 1, u)
    t = u - 2 * size * (u // (2 * size))
    return t if t < size else 2 * size - t


def bilinear(uv, field, values, level=0):
    """Clause 8.2.2: the exact answer at a UV in texels (two Fractions), a list of Fractions, None where no cell is in the field.
    values: dict from (column, row) at a level of detail to components."""
    axes = []
    for u, size, mode in zip(uv, (field["width"], field["height"]), (field["wrap_s"], field["wrap_t"]), strict=True):
        cells = -(-size >> level)
        x = fold(mode, Fraction(u), size) / (1 << level) - Fraction(1, 2)
        i, beside = math.floor(x), (lambda n, cells=cells, mode=mode: n % cells if mode == REPEAT else clip(0, cells - 1, n))
        axes.append([(beside(i), 1 - (x - i)), (beside(i + 1), x - i)])
    asked = [(values[column, row], f * g) for column, f in axes[0] for row, g in axes[1] if f * g and (column, row) in values]
    total = sum(weight for _, weight in asked)
    return [sum(weight * value[c] for value, weight in asked) / total for c in range(len(asked[0][0]))] if asked else None
