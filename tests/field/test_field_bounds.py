"""Bounds of voxels and texels: which of them a surface touches, on boundaries and with slivers, and what a point looks up."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from bounds import Draws, Group
from shapes import scene_of

from conformance.reference import texels as naive
from oracles import kernels as oracles
from texfcodec.core.integer import _isqrt
from texfcodec.field.grid import build_brick_map
from texfcodec.field.morton import decode_morton
from texfcodec.field.query import query_field
from texfcodec.field.texel_set import referenced_texels
from texfcodec.field.texels import TexelSupport
from texfcodec.field.transfer import transfer
from texfcodec.field.voxelise import voxelise
from texfcodec.scene.fetch import pack_source

case = Group("Voxels and texels")

NUDGE = Fraction(1, 1 << 40)  # in texels, far less than what 8.2 allows
EXACT = "voxels or weights that differ"


def differing_voxels(lattice: np.ndarray, faces: np.ndarray, bits: int, resolution: int, threads: int) -> int:
    """Voxels or area weights that are not those of the oracle."""
    got = dict(zip(*(a.tolist() for a in voxelise(lattice, faces, bits, resolution, 0, threads)), strict=True))
    return len(set(got.items()) ^ set(oracles.voxelise(lattice.tolist(), faces.tolist(), bits, resolution).items()))


@case("every K, any shape", 0, EXACT, seeds=20)
def every_resolution(draw: Draws) -> float:
    """Random, flat, linear and point faces at every K to 64 and powers of two to 8192.
    Stress: random, flat, linear and point faces at K = 1 to 64 and powers of two to 8192, 8 to 20 position bits, one to three
    threads
    Bound: Clause 6 is integer arithmetic below 2^62 (clause 10: cross products < 2^60, sums of squares < 2^62), so the kernel
    and unlimited integers agree; sums over faces know no order or slabs.
    """
    k = draw.integer(1, 71)
    resolution, bits = (k if k <= 64 else 1 << (k - 58)), draw.integer(8, 20)
    last = (1 << bits) - 1
    reach = min(last, max(4, (40 << bits) // resolution))  # some 40 voxels, or the naive walk takes minutes
    lattice = np.clip(draw.integers((3,), 0, last) + draw.integers((6, 3), -reach // 2, reach // 2), 0, last)
    shape = draw.integer(0, 3)
    if shape == 1:
        lattice[:, draw.integer(0, 2)] = lattice[0, 0]
    elif shape > 1:
        lattice[:] = lattice[0] + (np.arange(6) * (shape - 2))[:, None] * np.sign(last // 2 - lattice[0])
    return differing_voxels(lattice, draw.integers((4, 3), 0, 5), bits, resolution, draw.pick((1, 3)))


@case("voxel boundaries", 0, EXACT, seeds=20)
def on_voxel_boundaries(draw: Draws) -> float:
    """Corners exactly on boundaries of voxels and a lattice step beside them, and where no lattice position is on a boundary.
    Stress: corners on boundaries of voxels and a lattice step beside them
    Bound: 6.1 rounds down to 1/65536 voxel without a float, and a sample on a boundary belongs to the upper voxel (6.3).
    """
    bits, resolution = draw.integer(8, 14), draw.pick((2, 4, 8, 16, 32, draw.integer(1, 64)))
    edge = draw.integers((6, 3), 0, resolution)
    lattice = np.clip(-(-(edge << bits) // resolution) + draw.integers((6, 3), -1, 1), 0, (1 << bits) - 1)
    return differing_voxels(lattice, draw.integers((4, 3), 0, 5), bits, resolution, draw.pick((1, 2)))


@case("slivers are covered", 2, "voxels", seeds=30)
def uncovered_sliver(draw: Draws) -> float:
    """Distance in voxels from a point of a thin face to the nearest voxel that it touches.
    Stress: points of faces of an aspect to 10^6, the finest that a lattice holds, from the nearest voxel of the face
    Bound: Rows lie at most half a voxel apart and samples in a row as well (6.2, 6.3), a row may begin up to one voxel inside
    a slanted side, and slivers have rows on their edge instead: in all at most two voxels.
    """
    resolution, bits = draw.integer(2, 64), 20
    aspect, last = draw.power(0, 6), (1 << bits) - 1
    turn = np.linalg.qr(draw.generator().normal(size=(3, 3)))[0]
    thin = np.array([[0, 0, 0], [1, 0, 0], [draw.real(-0.3, 1.3), 1 / aspect, 0]]) @ turn
    thin = (thin - thin.min(axis=0)) / np.ptp(thin, axis=0).max()
    lattice = np.rint(thin * last * draw.real(0.05, 1)).astype(np.int64)
    keys, _ = voxelise(lattice, np.array([[0, 1, 2]]), bits, resolution)
    share = draw.reals((40, 2), 0, 1)
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    share[0], share[1], share[2] = (0, 0), (1, 0), (0, 1)
    points = (lattice[0] + share @ (lattice[1:] - lattice[0])) * (resolution / (1 << bits))
    low = decode_morton(keys)[None]
    beside = np.maximum(np.maximum(low - points[:, None], points[:, None] - low - 1), 0)
    return float(beside.max(axis=2).min(axis=1).max())


@case("integer roots", 0, "wrong roots", seeds=200)
def area_of_crossed_edges(draw: Draws) -> float:
    """How far the integer root of a sum of squares is from the exact one: 1 where it is not the largest whole root.
    Stress: roots of squares to 2^62 and two beside them, and of any number below
    Bound: The digits of the root are found one by one in integers (4.1), so no float rounds.
    """
    around = draw.integer(0, 2**31 - 1) ** 2 + draw.integer(-2, 2)
    value = min(draw.pick((around, draw.integer(0, 2**62 - 1))), 2**62 - 1)
    root = int(_isqrt(np.int64(max(value, 0))))
    return float(not root * root <= max(value, 0) < (root + 1) ** 2)


@case("coplanar duplicates", 1e-4, "levels", seeds=2, search=False, heavy=True)
def coplanar_duplicates(draw: Draws) -> float:
    """Levels that the colour of a voxel is off under very many coplanar copies of a square, and infinite where its weights are
    not exactly so many times those of one.
    Stress: a million copies of a face (ten with --most), one upon the other, in a grid of two voxels a side
    Bound: Weights are exact: 2^31 samples of at most 2^31 stay below 2^62 (6.3). A colour is a quotient of two sums in
    binary64, off by 2^-29 of itself at most after 2^24 samples, and kept in binary32: 256 levels times 2^-23 in all.
    """
    copies, level = draw.size(20_000, 1_000_000, 10_000_000), draw.real(0.05, 1)
    shift = draw.integer(0, 3000)
    square = np.array([[0, 0, 0], [4095, 0, 0], [4095, 4095, 0], [0, 4095, 0]], np.int64)
    square[:, :2] = np.clip(square[:, :2] - shift, 0, 4095)
    faces, resolution = np.array([[0, 1, 2], [0, 2, 3]]), 2
    keys, once = voxelise(square, faces, 12, resolution)
    crowd = np.tile(faces, (copies // 2, 1))
    found, weights = voxelise(square, crowd, 12, resolution, threads=2)
    if not np.array_equal(keys, found) or weights.tolist() != [w * (copies // 2) for w in once.tolist()]:
        return np.inf
    colours = np.tile([level, level / 2, level / 3, 1.0], (4, 1))
    one = scene_of(square, faces, colours)
    at = lambda source, rows: transfer(square, rows, source, 12, resolution, keys, build_brick_map(keys), 2, 2)
    want = at(pack_source(one), faces)
    got = at(pack_source(one, np.arange(len(crowd)) % 2), crowd)
    return float(max(np.abs(a.astype(np.float64) - b).max() for a, b in zip(got, want, strict=True)))


def beside(draw: Draws, value: float) -> float:
    """A number, or the one just below or above it."""
    way = draw.integer(-1, 1)
    return float(np.nextafter(value, np.inf * way)) if way else value


@case("voxels asked on boundaries", 0.01, "levels", seeds=40)
def queried_voxels(draw: Draws) -> float:
    """Error in levels of an answer at faces, edges, corners and centres of voxels and an ulp beside them.
    Stress: answers on faces, edges, corners and centres of voxels and an ulp beside them
    Bound: The clause allows 0.01 (8.2): weights are products of binary64 differences, off by 2^-50, and the answer is rounded
    to binary32. Of voxels equally near, either may answer.
    """
    size = draw.integer(1, 4)
    chosen = draw.integers((draw.integer(1, 12), 3), 0, size - 1)
    keys = np.unique([oracles.morton(*map(int, v)) for v in chosen])
    values = draw.integers((len(keys), 1), 0, 255).astype(np.uint8)
    held = {tuple(map(int, v)): int(values[i, 0]) for i, v in enumerate(decode_morton(keys))}
    points = np.array([[beside(draw, draw.integer(0, 2 * size) / 2) for _ in range(3)] for _ in range(4)])
    got, _ = query_field(points, size, keys, build_brick_map(keys), values)
    worst = 0.0
    for point, answer in zip(points.tolist(), got[:, 0].tolist(), strict=True):
        low, high = oracles.query([Fraction(v) for v in point], held)
        worst = max(worst, float(low - Fraction(answer)), float(Fraction(answer) - high))
    return worst


def support_of(draw: Draws, corners: np.ndarray, size: tuple, fraction: int) -> tuple[TexelSupport, dict]:
    """(TexelSupport of one face, its field as the oracle takes it)."""
    wrap = draw.integer(0, 2), draw.integer(0, 2)
    field = {"width": size[0], "height": size[1], "wrap_s": wrap[0], "wrap_t": wrap[1], "uv_fraction_bits": fraction}
    keys = referenced_texels(corners, np.array([[0, 1, 2]]), fraction, size, wrap)
    return TexelSupport(keys=keys, width=size[0], height=size[1], wrap=wrap, fraction_bits=fraction), field


def texel_face(draw: Draws) -> tuple[np.ndarray, tuple, int]:
    """(UVs of a face, size of the image, fraction bits): on corners, sides and centres of texels, or without area."""
    fraction, size = draw.integer(0, 8), (draw.integer(1, 16), draw.integer(1, 16))
    half, reach = 1 << max(fraction - 1, 0), 3 * max(size)
    corners = draw.integers((3, 2), -reach, 2 * reach) * half + draw.integers((3, 2), -1, 1)
    kind = draw.integer(0, 3)
    if kind == 1:
        corners[2] = corners[0] + (corners[1] - corners[0]) * draw.integer(0, 2)
    elif kind == 2:
        corners[:] = corners[0]
    return corners, size, fraction


@case("texels on boundaries", 0, "texels that differ", seeds=40)
def texels_of_one_face(draw: Draws) -> float:
    """Texels that are asked and should not be, or the other way round.
    Stress: faces on corners, sides and centres of texels, tiled, mirrored, lines and points
    Bound: The columns of a row are quotients of integers below 2^57 (6.5), rounded the way that leaves the border of the open
    square out.
    """
    corners, size, fraction = texel_face(draw)
    support, field = support_of(draw, corners, size, fraction)
    return float(len(set(support.keys.tolist()) ^ set(naive.referenced_texels([corners.tolist()], field))))


@case("texels asked on boundaries", 0.01, "levels", seeds=40)
def answers_of_texels(draw: Draws) -> float:
    """Error in levels of a bilinear answer on sides and centres of texels and an ulp beside them, at any level of detail.
    Stress: answers on sides and centres of texels and an ulp beside them, at four levels of detail
    Bound: As for voxels (8.2.2). A point beside the asked one counts as well (8.2): coarse levels jump where a tiled image of
    odd width begins again, and rounding brings -5e-324 to one side of that. A point of the face always weighs a texel that is
    there, and where an ulp has left none the answer is not compared.
    """
    corners, size, fraction = texel_face(draw)
    full, field = support_of(draw, corners, size, fraction)
    support = full.coarser(draw.integer(0, 3))
    values = draw.generator().integers(0, 256, (len(support), 1)).astype(np.uint8)
    held = {tuple(xy): [int(v[0])] for xy, v in zip(support.xy().tolist(), values, strict=True)}
    share = draw.reals((4, 2), 0, 1).round(draw.pick((0, 1, 9)))
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    texel = (corners[0] + share @ (corners[1:] - corners[0])) / (1 << fraction)
    texel = np.array([[beside(draw, np.round(v * 2) / 2 if draw.pick((True, False)) else v) for v in at] for at in texel])
    worst = 0.0
    for at, answer in zip(texel.tolist(), support.query(texel, values)[:, 0].tolist(), strict=True):
        errors = []
        for nudge in product((0, NUDGE, -NUDGE), repeat=2):
            wanted = naive.bilinear([Fraction(v) + d for v, d in zip(at, nudge, strict=True)], field, held, support.level_shift)
            errors.append(0.0 if wanted is None else float(abs(wanted[0] - Fraction(answer))))
            if errors[-1] <= 0.01:
                break
        worst = max(worst, min(errors))
    return worst


@pytest.mark.parametrize("hard", [*case], ids=lambda hard: hard.name)
def test_no_trial_of_a_case_is_worse_than_its_bound(hard):
    worst = hard.worst()
    assert worst.value <= hard.bound, worst
