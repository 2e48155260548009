"""Texels: the set that faces ask, the query, and UVs through Draco, against the reference decoder's texels.py."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from shapes import crossing_sheets, sphere

from conformance.reference import texels as naive
from texfcodec.errors import LimitError, StreamError
from texfcodec.field import texel_set
from texfcodec.field.morton import decode_morton
from texfcodec.field.on_face import texel_positions
from texfcodec.field.texel_set import MAX_UV, count_rows, referenced_texels
from texfcodec.field.texels import TexelSupport, texels_are_sound
from texfcodec.geometry import draco
from texfcodec.geometry.draco import UvCoding, counts_of, dec_textured, enc_textured
from texfcodec.scene.scene import WRAP_NAMES

WRAPS = [(s, t) for s in range(3) for t in range(3)]
ID = lambda wrap: "-".join(WRAP_NAMES[w] for w in wrap)


def oracle(uv, faces, fraction, size, wrap):
    """What the naive decoder makes of the same surface."""
    field = {"width": size[0], "height": size[1], "wrap_s": wrap[0], "wrap_t": wrap[1], "uv_fraction_bits": fraction}
    return naive.referenced_texels([[tuple(map(int, uv[v])) for v in face] for face in faces], field)


def agree(uv, faces, fraction, size, wrap):
    """Asserts that kernel and oracle ask the same texels; returns how many."""
    uv, faces = np.asarray(uv, np.int64), np.asarray(faces, np.int64)
    ours = referenced_texels(uv, faces, fraction, size, wrap)
    assert ours.tolist() == oracle(uv, faces, fraction, size, wrap), (uv.tolist(), fraction, size, wrap)
    return len(ours)


# The set


@pytest.mark.parametrize("wrap", WRAPS, ids=ID)
def test_referenced_texels_are_those_of_separating_axes_on_random_faces(wrap):
    rng = np.random.default_rng(WRAPS.index(wrap))
    for size in ((1, 1), (5, 3), (8, 8), (1, 13), (17, 1), (2, 7)):
        for fraction in (0, 1, 3, 8):
            reach = max(size) * (1 << fraction)
            uv = rng.integers(-2 * reach, 3 * reach + 1, (9, 2))
            uv[3:6] = uv[3] + rng.integers(0, (1 << fraction) + 1, (3, 2))  # smaller than a texel
            agree(uv, np.arange(9).reshape(3, 3), fraction, size, wrap)


@pytest.mark.parametrize("wrap", WRAPS, ids=ID)
def test_referenced_texels_of_points_and_lines(wrap):
    size, one = (6, 5), 1 << 2
    for at in ((0, 0), (2, 2), (4, 4), (4, 6), (24, 20), (-4, 9), (-2, -6), (1, 3)):  # corners, centres and sides of texels
        agree([at, at, at], [[0, 1, 2]], 2, size, wrap)
        for along in ((3 * one, 0), (0, -7 * one), (5 * one, 5 * one), (9, -23), (1, 40)):
            far = (at[0] + along[0], at[1] + along[1])
            middle = (at[0] + along[0] // 2, at[1] + along[1] // 2)
            agree([at, far, far], [[0, 1, 2]], 2, size, wrap)
            agree([far, at, middle], [[0, 1, 2]], 2, size, wrap)


def test_a_point_on_a_centre_asks_one_texel_beside_it_two_or_four():
    counts = [agree([at] * 3, [[0, 1, 2]], 3, (9, 9), (0, 0)) for at in ((12, 12), (13, 12), (12, 11), (13, 11), (16, 16))]
    assert counts == [1, 2, 2, 4, 4]


def test_largest_coordinates_ask_what_they_ask_in_plain_integers():
    last = MAX_UV - 1
    for at in (last, -last):
        uv = np.array([[at, at], [at - 70, at], [at, at - 40]] if at > 0 else [[at, at], [at + 70, at], [at, at + 40]])
        for wrap in WRAPS:
            agree(uv, [[0, 1, 2]], 3, (11, 6), wrap)
            agree(uv, [[0, 1, 2]], 0, (16384, 1), wrap)


def test_a_face_as_large_as_a_unit_may_be_fills_a_tiled_image():
    most = (1 << draco.MAX_UV_BITS) - 1
    uv, faces = np.array([[0, 0], [most, 0], [0, most]]) - (1 << 25) + 1, np.array([[0, 1, 2]])
    for wrap, count in (((0, 0), 77), ((2, 2), 77), ((1, 1), 1), ((0, 1), 11), ((1, 2), 7)):
        assert len(referenced_texels(uv, faces, 0, (11, 7), wrap)) == count
    assert count_rows(uv, faces, 0) == most + 2


def test_a_long_thin_line_is_exact_over_a_large_image():
    uv = np.array([[3, 1], [(1 << 20) - 9, 255], [(1 << 20) - 9, 255]])
    keys = referenced_texels(uv, np.array([[0, 1, 2]]), 6, (16384, 4), (0, 1))
    xy = decode_morton(keys)[:, :2]
    for x, y in xy[:: len(xy) // 50].tolist():
        assert naive.meet([tuple(map(int, v)) for v in uv], x, y, 64)
    inside = {tuple(v) for v in xy.tolist()}
    for x in range(40, 16340, 397):
        for y in range(4):
            assert ((x, y) in inside) == naive.meet([tuple(map(int, v)) for v in uv], x, y, 64)


def test_more_rows_than_32_bits_count_are_counted_in_64(monkeypatch):
    kinds = []
    rasterise = texel_set._rasterise
    monkeypatch.setattr(texel_set, "_rasterise", lambda *a: (kinds.append(a[-1].dtype), rasterise(*a))[1])
    uv, faces = np.array([[0, 0], [90, 10], [30, 70]]), np.array([[0, 1, 2]])
    plain = referenced_texels(uv, faces, 2, (9, 7), (0, 2))
    monkeypatch.setattr(texel_set, "MOST_IN_32_BITS", 5)
    assert np.array_equal(referenced_texels(uv, faces, 2, (9, 7), (0, 2)), plain)
    assert kinds == [np.int32, np.int64]


def test_limit_is_kept_before_keys_are_made():
    uv, faces = np.array([[0, 0], [90, 10], [30, 70]]), np.array([[0, 1, 2]])
    count = len(referenced_texels(uv, faces, 2, (90, 70), (0, 0)))
    assert len(referenced_texels(uv, faces, 2, (90, 70), (0, 0), count)) == count
    with pytest.raises(LimitError) as caught:
        referenced_texels(uv, faces, 2, (90, 70), (0, 0), count - 1)
    assert caught.value.code == "TXF-L04"


@pytest.mark.parametrize("keys, sound", [([0, 1, 2], True), ([], False), ([2, 1], False), ([1, 1], False), ([0, 4], False),
                                         ([-1, 0], False), ([0, 8], True), ([0, 64], False), ([0, 16], False),
                                         ([0, 1 << 42], False)])
def test_keys_of_an_image_of_three_columns_and_two_rows(keys, sound):
    assert texels_are_sound(np.array(keys, np.int64), (3, 2)) == sound


# The query


def support_of(uv, faces, fraction, size, wrap):
    keys = referenced_texels(uv, faces, fraction, size, wrap)
    return TexelSupport(keys=keys, width=size[0], height=size[1], wrap=wrap, fraction_bits=fraction)


@pytest.mark.parametrize("level", [0, 1, 2, 9])
@pytest.mark.parametrize("wrap", WRAPS, ids=ID)
def test_query_is_the_exact_bilinear_answer(wrap, level):
    rng = np.random.default_rng(level)
    for size in ((7, 5), (8, 4), (1, 1), (1, 6)):
        uv, faces = rng.integers(-60, 90, (6, 2)), np.array([[0, 1, 2], [3, 4, 5]])
        full = support_of(uv, faces, 2, size, wrap)
        support = full.coarser(level)
        values = rng.integers(0, 256, (len(support), 3)).astype(np.uint8)
        field = {"width": size[0], "height": size[1], "wrap_s": wrap[0], "wrap_t": wrap[1]}
        cells = {tuple(xy): value.tolist() for xy, value in zip(support.xy().tolist(), values, strict=True)}
        weight = rng.dirichlet([0.5] * 3, 40)
        weight[:3] = np.eye(3)
        texel = np.concatenate([np.einsum("mk,kc->mc", weight, uv[face]) for face in faces]) / 4
        for at, answer in zip(texel, support.query(texel, values), strict=True):
            wanted = naive.bilinear([Fraction(float(x)) for x in at], field, cells, support.level_shift)
            assert np.allclose(answer, [float(v) for v in wanted], atol=0.01), (size, at)


def test_query_of_every_point_of_a_face_finds_all_it_weighs():
    """On a field of one value but for texels that no face asks, which an image would have at 0, no answer is mixed."""
    rng = np.random.default_rng(5)
    for wrap in WRAPS:
        uv, faces = rng.integers(-400, 400, (3, 2)), np.array([[0, 1, 2]])
        support = support_of(uv, faces, 4, (19, 23), wrap)
        held = set(map(tuple, support.xy().tolist()))
        field = {"width": 19, "height": 23, "wrap_s": wrap[0], "wrap_t": wrap[1]}
        whole = {(x, y): [(x, y) in held] for x in range(19) for y in range(23)}
        for weight in rng.dirichlet([0.7] * 3, 200):
            shares = [Fraction(int(w * 2**20)) for w in weight]
            at = [sum(s * int(v) for s, v in zip(shares, uv[:, c], strict=True)) / sum(shares) / 16 for c in (0, 1)]
            assert naive.bilinear(at, field, whole) == [1]


def test_levels_of_detail_hold_rounded_means_of_the_texels_below():
    support = support_of(np.array([[0, 0], [90, 0], [0, 55]]), np.array([[0, 1, 2]]), 2, (21, 13), (1, 1))
    values = np.random.default_rng(0).integers(0, 256, (len(support), 1)).astype(np.uint8)
    coarse = support.coarser(2)
    assert coarse.size == (6, 4) and texels_are_sound(coarse.keys, coarse.size) and support.coarser(99).size == (1, 1)
    below = {}
    for (x, y), value in zip(support.xy().tolist(), values[:, 0].tolist(), strict=True):
        below.setdefault((x >> 2, y >> 2), []).append(value)
    wanted = [(2 * sum(v) + len(v)) // (2 * len(v)) for v in (below[tuple(xy)] for xy in coarse.xy().tolist())]
    assert support.mean(values, 2)[:, 0].tolist() == wanted and len(below) == len(coarse)


def nearest_by_search(point, corner, steps=200):
    """The place of a triangle that is nearest to a point, by trying many: its distance."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    i, j = i[i + j <= steps] / steps, j[i + j <= steps] / steps
    places = np.column_stack([1 - i - j, i, j]) @ corner
    return np.linalg.norm(places - point, axis=1).min()


def test_a_point_is_taken_to_the_nearest_place_of_its_face():
    rng = np.random.default_rng(1)
    corners = rng.integers(0, 1000, (12, 3, 3)).astype(np.float64)
    corners[2] = corners[2, 0]  # a point
    corners[3, 2] = (corners[3, 0] + corners[3, 1]) / 2  # a line
    positions, faces = corners.reshape(-1, 3), np.arange(36).reshape(12, 3)
    eye = np.tile(np.eye(3), (12, 1))
    for number, corner in enumerate(corners):
        points = rng.uniform(-500, 1500, (60, 3))
        index = np.full(60, number)
        weight = np.column_stack([texel_positions(points, positions, faces, eye[:, :2], index),
                                  texel_positions(points, positions, faces, eye[:, 1:], index)[:, 1]])
        assert (weight >= 0).all() and np.allclose(weight.sum(axis=1), 1)
        for point, distance in zip(points, np.linalg.norm(weight @ corner - points, axis=1), strict=True):
            searched = nearest_by_search(point, corner)
            assert distance <= searched + 1e-6 and searched <= distance + 15


def test_weights_on_slivers_are_those_of_the_point():
    """Faces a million long and one lattice step wide, as exact fractions have them."""
    last = (1 << 20) - 1
    positions = np.array([[0, 0, 0], [last, last - 1, last], [last - 1, last - 2, last - 1], [3, 0, last]], np.float64)
    uv = np.array([[0, 0], [4096, 0], [0, 4096], [9, 9]], np.float64)
    for face in ([0, 1, 2], [0, 3, 1], [2, 1, 0]):
        corner, weight = positions[face], np.random.default_rng(2).dirichlet([1, 1, 1], 300)
        got = texel_positions(weight @ corner, positions, np.array([face]), uv, np.zeros(300, np.int64))
        assert np.abs(got - weight @ uv[face]).max() < 4, face  # a point's own rounding is worth a texel here


# UVs through Draco


def rows_of(lattice, faces, uv):
    """Faces as sorted rows of corners, each beginning with its least corner: what Draco's order has no part in."""
    corners = np.column_stack([lattice, uv])[faces].tolist()
    return sorted(min(tuple(map(tuple, face[i:] + face[:i])) for i in range(3)) for face in corners)


def assert_round_trip(lattice, faces, uv, bits=14):
    """UVs int64 [F, 3, 2] by corner come back with their corners, plain and quantised."""
    flat = np.column_stack([lattice[faces.reshape(-1)], uv.reshape(-1, 2)])
    unique, local = np.unique(flat, axis=0, return_inverse=True)
    positions, uv, faces = unique[:, :3], unique[:, 3:], local.reshape(-1, 3)
    wanted, codings = rows_of(positions, faces, uv), set()
    for quantised in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            encode, other = draco._encode, "generic_attributes" if quantised else "tex_coord"
            patch.setattr(draco, "_encode", lambda *a, encode=encode, other=other, **k:
                          bytes(1 << 20) if other in k else encode(*a, **k))
            data, coding = enc_textured(positions, faces, uv, bits)
        if data == bytes(1 << 20):
            assert quantised and uv.max() > 1 << 19  # only there quantised UVs would not come back
            continue
        codings.add(coding.bits > 0)
        counts = counts_of(data)
        got = dec_textured(data, *counts, coding, bits)
        assert rows_of(got[0], got[1], got[2]) == wanted
        assert counts[0] <= len(got[0]) <= 3 * len(faces)
    assert False in codings
    return codings


def shape(kind):
    if kind == "sphere":
        positions, faces = sphere(9)
    else:
        scene = crossing_sheets()
        positions, faces = scene.positions, scene.faces
    return np.floor((positions - positions.min(axis=0)) / np.ptp(positions) * 16383).astype(np.int64), faces


@pytest.mark.parametrize("kind", ["sphere", "sheets"])
@pytest.mark.parametrize("longest", [0, 1, 2, 255, 4094, 65534, 131070, 262142, 524286, 690000, (1 << 20) - 1])
def test_uvs_come_back_exactly_with_seams_everywhere(kind, longest):
    lattice, faces = shape(kind)
    uv = np.random.default_rng(longest).integers(0, longest + 1, (len(faces), 3, 2))
    uv[0, 0], uv[0, 1] = 0, longest
    assert_round_trip(lattice, faces, uv)


@pytest.mark.parametrize("kind", ["sphere", "sheets"])
def test_uvs_of_charts_flipped_overlapping_and_without_area_come_back(kind):
    lattice, faces = shape(kind)
    smooth = (lattice[faces][:, :, :2] * 4).astype(np.int64)
    for change in (lambda uv: uv, lambda uv: 65532 - uv, lambda uv: uv * [1, 0], lambda uv: np.repeat(uv[:, :1], 3, axis=1),
                   lambda uv: uv // 2 + 1000 * (np.arange(len(uv)) % 3)[:, None, None]):
        uv = change(smooth)
        assert_round_trip(lattice, faces, uv - uv.min(axis=(0, 1)))


def test_every_range_of_quantised_uvs_is_exact():
    """All whole numbers of a range at once, in 32-bit floats as Draco scales and rounds them."""
    for longest in (1, 2, 3, 1000, 4094, 8190, 65534, 65535, 131070, 260000, 262142, 400000, 524286, 690000, (1 << 20) - 1):
        bits = draco._exact_bits(longest)
        if bits > draco.MAX_UV_BITS:
            continue
        last, number = np.float32((1 << bits) - 1), np.arange(longest + 1)
        steps = np.floor(number.astype(np.float32) * (last / np.float32(longest)) + np.float32(0.5))
        floats = (steps * (np.float32(longest) / last)).astype(np.float32)
        assert np.array_equal(draco._unquantised(floats[:, None], UvCoding(bits, longest))[:, 0], number), longest


def test_floats_that_stand_for_no_number_are_told_as_the_specification_has_them():
    coding = UvCoding(5, 29)
    rng = np.random.default_rng(0)
    step = 29 / 31
    near = [(np.arange(33) + beside) * step for beside in (0, 0.25, 0.26)]
    odd = [np.nan, np.inf, -np.inf, -0.0, 1e38, -1e38, 1e-40]
    floats = np.concatenate([rng.uniform(-3, 34, 500), *near, odd]).astype(np.float32)
    ours = draco._unquantised(floats[:, None], coding)[:, 0]
    wanted = [naive.whole_number(float(v), 5, 29) for v in floats]
    assert ours.tolist() == [-1 if n is None else n for n in wanted] and None in wanted and 29 in wanted


def test_uv_that_does_not_begin_at_zero_is_refused_by_the_encoder():
    lattice, faces = shape("sheets")
    uv = np.ones((len(lattice), 2), np.int64)
    for wrong in (uv, uv * [0, 1], -uv, uv * [1 << 20, 0] - [0, 0]):
        with pytest.raises(ValueError):
            enc_textured(lattice, faces, wrong, 14)


def test_an_answer_with_other_uvs_or_vertices_than_there_should_be_is_refused(monkeypatch):
    import DracoPy

    lattice, faces = shape("sphere")
    data, coding = enc_textured(lattice, faces, lattice[:, :2] - lattice[:, :2].min(axis=0), 14)
    mesh, counts = DracoPy.decode(data), counts_of(data)
    fewer = mesh.points[: counts[0] - 1]
    short = [attribute if attribute["attribute_type"] == 0 else attribute | {"data": attribute["data"][1:]}
             for attribute in mesh.attributes]
    for points, triangles, attributes, code in ((mesh.points, mesh.faces, short, "TXF-S20"),
                                                (fewer, mesh.faces * 0, mesh.attributes, "TXF-S21")):
        answer = SimpleNamespace(points=points, faces=triangles, attributes=attributes)
        monkeypatch.setattr(DracoPy, "decode", lambda data, answer=answer: answer)
        with pytest.raises(StreamError) as caught:
            dec_textured(data, *counts, coding, 14)
        assert caught.value.code == code
