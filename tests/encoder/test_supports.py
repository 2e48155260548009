"""Which supports the encoder chooses, how finely, and what it says of it; and that odd images and UVs break none of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from shapes import painted_sphere
from walls import smooth_image, wall

from texfcodec import EncodeOptions, InputError, LimitError, Limits, decode
from texfcodec.codecs import codec_of
from texfcodec.encoder.caches import Caches
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.prepare.uniform_colour import material_colours
from texfcodec.encoder.requests import Requests
from texfcodec.encoder.stages import Prepared
from texfcodec.encoder.supports import choice as supports
from texfcodec.encoder.supports import trial
from texfcodec.encoder.supports.choice import FINER_COST, choose_supports
from texfcodec.encoder.supports.image_groups import image_groups
from texfcodec.encoder.supports.texel_plan import TexelPlan
from texfcodec.encoder.supports.trial import Trials
from texfcodec.geometry.surface import make_surface
from texfcodec.io.load import load
from texfcodec.metrics.psnr_3d import measure
from texfcodec.options import RATES
from texfcodec.precompile import small_scene
from texfcodec.scene.scene import WRAP_CLAMP, WRAP_REPEAT, Material, Scene, Texture
from texfcodec.scene.srgb import linear_to_srgb

K = 256


@pytest.fixture(autouse=True)
def coarse_rates(monkeypatch):
    """The rates with fewer voxels, so that this takes seconds."""
    for name, (_, qp) in RATES.items():
        monkeypatch.setitem(RATES, name, (K, qp))


def supports_of(scene, options):
    """Supports of a scene and their evidence, nothing coded."""
    surface = make_surface(scene, options)
    colours = material_colours(scene, surface)
    prepared = Prepared(scene=scene, materials=scene.materials, surface=surface, colours=colours, evidence={})
    decision = choose_supports(prepared, Requests.of(options).price, Requests.of(options).support, Caches())[0]
    return SimpleNamespace(**vars(decision.value), evidence=decision.evidence)


def chosen(scene, **options):
    """As supports_of, by names of options."""
    return supports_of(scene, EncodeOptions(**{"rate": "r03", **options}))


def psnr_y(scene, **options):
    """(Encoded, Texf, 3D-PSNR of Y in dB) of a scene over texels; 100 for no error."""
    made = encode_scene(scene, EncodeOptions(**{"support": "texels", **options}))
    texf = decode(made.data)
    y = measure(scene, texf, 20_000)["y"]
    return made, texf, 100.0 if y is None else y


def noise_image(width, height, seed=0):
    """Opaque noise, uint8 [height, width, 4]."""
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 4), np.uint8)
    image[..., 3] = 255
    return image


def detailed_image(size, seed=0):
    """Waves with some noise on them: what a smaller image keeps, and what it does not."""
    image = smooth_image(size, size, 3, seed).astype(float)
    image[..., :3] += np.random.default_rng(seed).normal(0, 12, (size, size, 3))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def scan(n=60, texels=8, noise=6.0):
    """A bumpy wall of 2 n^2 faces, each a chart of its own, charts in no order, with so many texels a side; colours are smooth
    on the surface but for the noise."""
    scene, rng = wall(smooth_image(8, 8), n=n), np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(len(scene.faces))))
    place = rng.permutation(side * side)[: len(scene.faces)]
    corner = np.stack([place % side, place // side], 1)
    scene.corner_uv = (corner[:, None] + np.array([[0.05, 0.05], [0.95, 0.05], [0.05, 0.95]])) / side
    across = ((np.arange(texels) + 0.5) / texels - 0.05) / 0.9
    first, second, third = np.moveaxis(scene.positions[scene.faces], 1, 0)[:, :, None, None]
    shown = first + across[:, None] * (second - first) + across[:, None, None] * (third - first)  # [F, row, column, 3]
    image = np.full((side, texels, side, texels, 4), 255.0)
    waves = 127.5 + 90 * np.sin(shown @ rng.normal(0, 4, (3, 3)))
    image[corner[:, 1], :, corner[:, 0], :, :3] = waves + rng.normal(0, noise, waves.shape)
    scene.textures = [Texture(np.clip(np.rint(image), 0, 255).astype(np.uint8).reshape(side * texels, side * texels, 4))]
    return scene


def tiles(*factors, image=None, wraps=None):
    """A square for each factor, each of its own material; with an image each has its own copy of it."""
    count = len(factors)
    corners = np.array([[0, 0, 0], [0.9, 0, 0], [0.9, 1, 0.2], [0, 1, 0.2]])
    positions = np.concatenate([corners + [i, 0, 0] for i in range(count)])
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(count)])
    uv = np.tile(corners[:, :2][np.array([[0, 1, 2], [0, 2, 3]])], (count, 1, 1))
    textures = [] if image is None else [Texture(image.copy(), wrap) for wrap in wraps or [(0, 0)] * count]
    materials = [Material(f"m{i}", factor=np.array([*f, 1.0]), texture=-1 if image is None else i) for i, f in enumerate(factors)]
    return Scene(positions, faces, np.repeat(np.arange(count), 2), uv, None, materials, textures)


# Which one


def test_an_image_that_is_tiled_goes_over_texels_and_the_report_says_why():
    found = chosen(wall(smooth_image(64, 64), low=0, high=8))
    (plan,), (told,) = found.plans, found.evidence["groups"]
    assert plan.size == (64, 64) and found.evidence["asked"] == "auto"
    assert (told["chosen"], told["image"], told["faces"]) == ("texels", [64, 64], 72)
    assert told["texels"]["values"] == 64 * 64 and told["voxels"]["values"] > 10 * told["texels"]["values"]
    over_texels, over_voxels = (int(word) for word in told["reason"].replace(",", "").split() if word.isdigit())
    assert 0 < over_texels < over_voxels and told["texels"]["geometry_bytes"] > 0


def test_a_scan_with_a_noisy_image_stays_over_voxels():
    found = chosen(scan(n=40))
    (told,) = found.evidence["groups"]
    assert found.plans == [] and told["chosen"] == "voxels"
    assert told["texels"]["geometry_bytes"] + told["texels"]["attribute_bytes"] > told["voxels"]["attribute_bytes"]


def test_vertex_colours_stay_over_voxels_and_get_fewer_of_them():
    made = encode_scene(painted_sphere(8), EncodeOptions(rate="r03"))
    tried = made.choices["supports"]["voxels"]
    assert made.counts["texels"] == 0 < made.counts["voxels"] and made.choices["supports"]["groups"] == []
    assert made.resolution == tried[-1]["resolution"] < K and decode(made.data).resolution == made.resolution
    assert tried[-1]["cost"] <= min(row["cost"] for row in tried) / FINER_COST and len(tried) > 1
    as_fine = encode_scene(painted_sphere(8), EncodeOptions(resolution=K, qp=28 + tried[-1]["qp_offset"]))
    assert made.sizes["attributes"] < 2 / 3 * as_fine.sizes["attributes"]


def test_both_kinds_in_one_mesh():
    scene = wall(smooth_image(64, 64))
    scene.corner_color = np.ones((len(scene.faces), 3, 4), np.float32)
    scene.corner_color[:30, :, 1] = np.linspace(0, 0.9, 30)[:, None]
    found = chosen(scene)
    assert [len(plan.group.faces) for plan in found.plans] == [42]
    assert found.evidence["voxels"][-1]["resolution"] == found.resolution <= K


@pytest.mark.parametrize("asked", [{"exact_rate": True}, {"resolution": K}, {"lossless": True}, {"max_error": 2}])
@pytest.mark.parametrize("make", [lambda: wall(smooth_image(64, 64), low=0, high=8), lambda: painted_sphere(8)])
def test_what_asks_for_voxels_keeps_those_of_the_rate(make, asked):
    found = chosen(make(), **asked)
    assert found.plans == [] and found.resolution == K and "voxels" in found.evidence["reason"] and found.evidence["groups"] == []


def test_no_k_is_taken_that_no_qp_brings_to_the_quality_of_the_rate():
    """Noise in texels twice as large as the voxels: half the voxels blur it for good."""
    found = chosen(scan(n=40, texels=2, noise=90.0), support="voxels", rate="r01")
    tried = {row["resolution"]: row for row in found.evidence["voxels"]}
    assert tried[found.resolution]["psnr_y"] > tried[K]["psnr_y"] - 1.5


def test_k_is_bounded_by_the_voxels_that_it_would_make(monkeypatch):
    scene = scan(n=40, texels=2, noise=90.0)
    before = chosen(scene, support="voxels").resolution
    monkeypatch.setattr(supports, "MOST_VOXELS", 1 << 13)
    assert chosen(scene, support="voxels").resolution == 64 < before
    options = EncodeOptions(rate="r03", support="voxels")
    surface = make_surface(scene, options)
    colours = material_colours(scene, surface)
    request = Requests.of(options, frozenset({0})).support
    prepared = Prepared(scene=scene, materials=scene.materials, surface=surface, colours=colours, evidence={})
    finer = choose_supports(prepared, Requests.of(options).price, request, Caches())[0]
    assert finer.value.resolution < K


def test_voxels_on_request_at_a_k_of_the_encoders_choice():
    found = chosen(painted_sphere(8), support="voxels")
    assert found.plans == [] and found.resolution < K and found.evidence["groups"] == []
    assert chosen(wall(noise_image(256, 256), high=8.0), support="voxels").resolution < K  # noise that none of them shows


def test_a_codec_of_all_fields_together_never_gets_texels():
    options = EncodeOptions(codec="3dntc")
    scene = wall(smooth_image(64, 64), low=0, high=8)
    found = supports_of(scene, options)
    assert found.plans == [] and "codec" in found.evidence["reason"] and not options.may_choose_texels


# How fine


def test_a_smaller_image_is_closer_than_one_with_texels_left_out():
    image, options = detailed_image(128), {"texel_size": 32, "qp": 8}
    made, texf, ours = psnr_y(wall(image), **options)
    assert (texf.fields[0].support.width, texf.fields[0].support.height) == (32, 32) and made.counts["texels"] == 32 * 32
    source = wall(image)
    left_out = encode_scene(wall(np.ascontiguousarray(image[2::4, 2::4])), EncodeOptions(support="texels", qp=8))
    theirs = measure(source, decode(left_out.data), 20_000)["y"]
    assert ours > theirs + 2


def test_a_smaller_image_around_a_few_texels_is_nearly_that_of_the_whole():
    scene = wall(smooth_image(256, 256))
    surface = make_surface(scene, EncodeOptions())
    (group,) = image_groups(scene, surface)
    plan, (x, y) = TexelPlan(group, (128, 128), 2), np.mgrid[40:60, 90:110]
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    near, whole = plan.near_values(surface, xy, 1), plan.values(surface, xy, 1)
    mean = group.image.reshape(128, 2, 128, 2, 4).mean(axis=(1, 3))[xy[:, 1], xy[:, 0]]
    assert 0 < np.abs(near - whole).max() < 0.3 * np.abs(mean - whole).max()


@pytest.mark.slow
def test_sides_keep_their_ratio_and_no_image_grows():
    scene = wall(smooth_image(96, 24))
    sizes = {size: chosen(scene, support="texels", texel_size=size).plans[0].size for size in (1, 12, 48, 500)}
    assert sizes == {1: (1, 1), 12: (12, 3), 48: (48, 12), 500: (96, 24)}


def layers(count=12, gap=3e-5):
    """Walls close behind each other with different noise: rounding positions shows one through the other."""
    one = wall(noise_image(64, 64), n=6)
    positions = np.concatenate([one.positions + [0, 0, i * gap] for i in range(count)])
    faces = np.concatenate([one.faces + i * len(one.positions) for i in range(count)])
    uv = np.concatenate([one.corner_uv + i * 0.37 for i in range(count)])
    return replace(one, positions=positions, faces=faces, corner_uv=uv, face_material=np.zeros(len(faces), np.int64))


def test_position_bits_go_up_or_down_only_where_it_pays_and_nobody_asked():
    """Down: tests/encoder/test_mesh_choice.py."""
    made = encode_scene(layers(), EncodeOptions())
    assert 14 < decode(made.data).position_bits == made.choices["mesh"]["position_bits"] <= 20
    asked = encode_scene(layers(), EncodeOptions(position_bits=14))
    assert decode(asked.data).position_bits == 14 and "position_bits" not in asked.choices["mesh"]


# Palettes, groups


def test_flat_materials_become_one_field_of_exact_colours():
    factors = [(0.5, 0.2, 0.1), (0.05, 0.6, 0.3), (0.9, 0.9, 0.02)]
    made = encode_scene(tiles(*factors), EncodeOptions())
    texf = decode(made.data)
    assert made.counts["texels"] == 3 and made.counts["fields"] == 1 and made.counts["voxels"] == 0
    wanted = {tuple(np.rint(255 * linear_to_srgb(np.array(f))).astype(int)) for f in factors}
    assert {tuple(rgba[:3]) for rgba in texf.fields[0].rgba.astype(int)} == wanted
    centres = texf.positions[texf.faces].mean(axis=1)
    got = texf.query(centres, np.arange(len(centres)))[:, :3]
    right = [np.rint(255 * linear_to_srgb(np.array(factors[m]))) for m in texf.face_material]
    assert np.array_equal(got, right)


def test_a_material_that_finer_positions_bring_to_light_is_in_the_palette(monkeypatch):
    """At 14 bits its only face collapses, at those that are chosen it does not."""
    scene = tiles((0.5, 0.2, 0.1), (0.1, 0.2, 0.5))
    scene.positions[4:] = scene.positions[4:] * 4e-5 + [0.3, 0.3, 0.5]
    scene.positions = np.concatenate([scene.positions, [[0, 0, 1.0], [1, 0, 1], [1, 1, 1]]])
    scene.faces = np.concatenate([scene.faces, [[8, 9, 10]]])
    scene.corner_uv = np.concatenate([scene.corner_uv, np.zeros((1, 3, 2))])
    scene.face_material = np.append(scene.face_material, 2)
    scene.materials.append(Material("third"))
    usual = make_surface(scene, EncodeOptions())
    finer = lambda choice: make_surface(choice.scene, replace(choice.request, position_bits=18))
    monkeypatch.setattr("texfcodec.encoder.mesh.stage.MeshChoice.finer", finer)
    made = encode_scene(scene, EncodeOptions(support="texels"))
    assert 1 not in usual.material and made.counts["faces"] == 5
    assert made.counts["texels"] == 3 and made.counts["voxels"] == 0


def test_images_that_are_equal_share_a_field_and_others_do_not():
    image, white = smooth_image(32, 32), (1, 1, 1)
    same = chosen(tiles(white, white, image=image), support="texels").plans
    assert [len(plan.group.faces) for plan in same] == [4]
    wrapped = chosen(tiles(white, white, image=image, wraps=[(WRAP_REPEAT,) * 2, (WRAP_CLAMP,) * 2]), support="texels").plans
    tinted = chosen(tiles(white, (1, 0.5, 1), image=image), support="texels").plans
    assert len(wrapped) == len(tinted) == 2


# What breaks nothing

ODD_UVS = {
    "not a number": lambda uv: uv * np.nan, "infinite": lambda uv: uv + np.inf, "huge": lambda uv: uv * 1e30,
    "far away": lambda uv: uv + 1e9, "far apart": lambda uv: uv * 1e5,
    "one not a number": lambda uv: np.where(np.arange(uv.size).reshape(uv.shape) == 0, np.nan, uv),
}


@pytest.mark.parametrize("name", ODD_UVS)
@pytest.mark.parametrize("support", ["auto", "texels"])
def test_odd_uvs_go_over_voxels_or_are_a_coded_error(name, support):
    scene = tiles((1, 1, 1), (1, 1, 1), image=smooth_image(32, 32))
    scene.corner_uv[:2] = ODD_UVS[name](scene.corner_uv[:2])
    try:
        made = encode_scene(load(scene), EncodeOptions(support=support, effort="fast"))
    except (InputError, LimitError):
        return
    texf = decode(made.data)
    assert made.counts["faces"] == 4 == len(texf.faces) and len(np.unique(texf.face_field)) == made.counts["fields"]
    are_near = name == "far away" and support == "texels"  # whole periods bring them back
    assert (made.counts["voxels"] == 0) == are_near and (made.counts["texels"] > 0 or support == "auto")


@pytest.mark.parametrize("name", ["no area", "one point", "flipped", "overlapping"])
def test_odd_charts_keep_their_colours(name):
    scene = wall(smooth_image(64, 64), n=4)
    uv = scene.corner_uv
    if name == "no area":
        uv[..., 1] = uv[..., 0]
    elif name == "one point":
        uv[...] = 0.3
    elif name == "flipped":
        uv[::2] = 1 - uv[::2]
    else:
        uv[...] = uv[:2].repeat(len(uv) // 2, axis=0)
    _, texf, psnr = psnr_y(scene, qp=12)
    assert texf.fields[0].over_texels and psnr > 38
    assert chosen(scene).plans or name == "one point"  # and auto takes it as well, but for a single colour


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (16384, 1), (1, 16384)])
def test_images_of_a_single_line_or_texel(size):
    image = smooth_image(*size)
    _, texf, psnr = psnr_y(wall(image, n=2), qp=12)
    assert texf.fields[0].support.size == size and psnr > 38


def test_what_is_over_a_limit_goes_over_voxels_unless_texels_were_asked_for():
    scene = wall(smooth_image(64, 64))
    for limits, code in ((Limits(voxels=1000), "TXF-L04"), (Limits(samples=100), "TXF-L05")):
        found = chosen(scene, limits=limits)
        (told,) = found.evidence["groups"]
        assert found.plans == [] and told["chosen"] == "voxels" and code in told["reason"]
        assert chosen(scene, limits=limits, support="voxels").plans == []
        with pytest.raises(LimitError, match=code):
            chosen(scene, limits=limits, support="texels")


def test_uvs_over_millions_of_tiles_take_no_time():
    scene = wall(smooth_image(64, 64), n=40)
    scene.corner_uv *= 1 + 2e5 * (np.arange(len(scene.faces)) % 2)[:, None, None]
    (told,) = chosen(scene).evidence["groups"]
    assert told["chosen"] == "voxels" and "TXF-L05" in told["reason"]


def test_warming_up_goes_over_texels_too():
    settings = [EncodeOptions(**small) for small in codec_of("raht").small]
    assert [encode_scene(small_scene(), one).counts["texels"] > 0 for one in settings].count(True) == 1


def with_a_small_part(size, image):
    """A wall with a picture, and a wall of a size with another image far in front of it."""
    big, small = wall(smooth_image(256, 256), n=8), wall(image, n=2)
    return replace(big, positions=np.concatenate([big.positions, size * small.positions + [0, 0, 1]]),
                   faces=np.concatenate([big.faces, small.faces + len(big.positions)]),
                   corner_uv=np.concatenate([big.corner_uv, small.corner_uv]),
                   face_material=np.concatenate([big.face_material, np.ones(len(small.faces), np.int64)]),
                   materials=[*big.materials, replace(small.materials[0], texture=1)], textures=[*big.textures, *small.textures])


def test_voxels_that_are_not_there_are_no_alternative_for_a_small_part_and_it_has_the_qp_of_the_rate():
    """By its share alone its texels would be coded three QP coarser."""
    _, row = chosen(with_a_small_part(1e-4, noise_image(64, 64))).evidence["groups"]
    assert row["image"] == [64, 64] and row["voxels"]["psnr_y"] < 60
    _, row = chosen(with_a_small_part(0.05, noise_image(32, 32))).evidence["groups"]
    assert row["image"] == [32, 32] and row["texels"]["qp_offset"] <= 1


def test_images_that_stay_over_voxels_count_by_their_texels_together(monkeypatch):
    """What is left over voxels is no small part with many values where its images are small: its share is the whole surface."""
    scene = wall(smooth_image(16, 16), n=20)
    half = np.arange(len(scene.faces)) % 2
    scene = replace(scene, face_material=half, materials=[Material(texture=0), Material(texture=1)],
                    textures=[Texture(smooth_image(16, 16, 2, seed)) for seed in (0, 1)])
    weights, of = [], Trials.region

    def region(trials, faces, *texels):
        made = of(trials, faces, *texels)
        if len(faces) == len(trials.surface.faces):
            weights.append(made.weight)
        return made

    monkeypatch.setattr(Trials, "region", region)
    monkeypatch.setattr("texfcodec.encoder.supports.choice._Choice._decided", lambda self, one, patch: replace(one, goes=False))
    chosen(scene)
    assert weights and max(weights) == pytest.approx(1.0)


def test_a_qp_far_above_the_rates_has_to_hold_in_more_squares(monkeypatch):
    squares = []
    monkeypatch.setattr(trial, "probe_texels", lambda *given: squares.append(given[4:]))
    for offset, probes in ((3, [()]), (4, [(), (trial.MANY_CELLS,)])):
        squares.clear()
        monkeypatch.setattr(Trials, "_settled", lambda *_, offset=offset: SimpleNamespace(qp_offset=offset))
        assert Trials(None, None, None, None).texels(None, None, np.arange(3), 6).qp_offset == offset
        assert squares == probes
