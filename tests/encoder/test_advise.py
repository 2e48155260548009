"""--advise tells what the encoder will choose, in a fraction of its time."""

import json
import re

import numpy as np
import pytest

from texfcodec.encoder.advise import advise
from texfcodec.encoder.decide.one_colour import material_colours
from texfcodec.encoder.decide.supports import choose_supports
from texfcodec.encoder.estimates.image_measures import haar_bits
from texfcodec.encoder.plan import outline
from texfcodec.io.load import load
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.scene import Material, Scene, Texture

TEXTURED = ("avocado", "bball_0001", "cat_webp", "hard_broken", "tiny_plane", "waterbottle_pbr", "ycb_chef_can", "ycb_scissors")


def plain(tiles, side=64):
    """A square whose image, noise, is shown tiles x tiles times."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    uv = tiles * np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float64)
    image = np.random.default_rng(5).integers(0, 256, (side, side, 4), np.uint8)
    return Scene(positions, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, np.int64), uv, None, [Material("m", texture=0)],
                 [Texture(image)])


def test_haar_bits_are_nothing_for_flat_squares_and_grow_with_noise():
    flat, rng = np.full((3, 16, 16, 1), 100, np.float32), np.random.default_rng(0)
    noise = [haar_bits(flat + rng.normal(0, s, flat.shape).astype(np.float32), 8.0) for s in (0.5, 8, 64)]
    assert haar_bits(flat, 8.0) == 0 == noise[0] and 0.3 < noise[1] < noise[2] - 1.5


def test_haar_bits_of_one_coefficient_are_those_of_its_level():
    square = np.zeros((1, 2, 2, 1), np.float32)
    square[0, :, 0] = 10  # (10 + 10 - 0 - 0) / 2 = 10: the one coefficient
    assert haar_bits(square, 4.0) == pytest.approx(np.log2(1 + np.floor(10 / 4 + 1 / 3)) / 4)


def test_tiled_images_are_advised_texels_and_the_reason_is_how_often_one_is_shown():
    told = advise(outline(plain(8), EncodeOptions(threads=1), Report()))["images"]
    assert [entry["predicted"] for entry in told] == ["texels"] and told[0]["sure"]
    assert any("each texel 64.0 times" in reason for reason in told[0]["reasons"])
    assert told[0]["texels"] == 64 * 64


def test_a_coarser_picture_of_the_same_image_speaks_less_for_texels():
    times = [advise(outline(plain(8, side), EncodeOptions(threads=1), Report()))["images"][0]["times"] for side in (16, 64, 256)]
    assert times[0] < times[1] < times[2] or times[0] > 20


@pytest.mark.parametrize("chosen, reason", [({"support": "voxels"}, "requested"), ({"lossless": True}, "error bound")])
def test_where_nothing_is_to_choose_it_says_why(chosen, reason):
    for exact_rate in (False, True):
        told = advise(outline(plain(2), EncodeOptions(threads=1, exact_rate=exact_rate, **chosen), Report()))
        assert told["images"] == [] and reason in told["reason"]


@pytest.mark.slow
def test_advice_comes_true_on_real_assets(shared_dir):
    hits, sure = [], []
    for name in TEXTURED:
        scene, options = load(str(shared_dir / "assets" / f"{name}.glb")), EncodeOptions(rate="r03", threads=1)
        told = advise(outline(scene, options, Report()))["images"]
        chosen = prepare_supports(scene, options)
        hits += [entry["predicted"] == group["chosen"] for entry, group in zip(told, chosen, strict=True)]
        sure += [hit for hit, entry in zip(hits[-len(told):], told, strict=True) if entry["sure"]]
    assert np.mean(hits) >= 7 / 8 and all(sure)


def prepare_supports(scene, options):
    """What the encoder itself chooses, by image."""
    begun = outline(scene, options, Report())
    colours = material_colours(begun.scene, begun.surface)
    return choose_supports(begun.scene, begun.surface, begun.rd, options, colours).evidence["groups"]


def test_the_command_line_says_it_without_coding(call, tmp_path):
    from texfcodec.demo.asset import write_sample

    write_sample(tmp_path / "sample.glb")
    code, out, _ = call("texf-enc", tmp_path / "sample.glb", "--advise")
    assert code == 0 and ("over texels" in out or "over voxels" in out) and "nothing was written" in out
    assert re.search(r"^about \d+ s on two processors and [\d,]+ bytes: [\d,]+ faces, ", out, re.MULTILINE)
    code, out, _ = call("texf-enc", tmp_path / "sample.glb", "--advise", "--json")
    advice = json.loads(out)["advice"]
    assert code == 0 and advice["images"][0]["predicted"] in ("texels", "voxels")
    assert advice["cost"]["faces"] > 0 and advice["cost"]["seconds"] > 1 and advice["cost"]["bytes"] > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["sample.glb"]


def test_the_cost_counts_what_goes_over_texels_and_what_over_voxels():
    """The image's texels in one case, the surface's voxels in the other; both cost more where the image is larger or K is."""
    cost = lambda side, **options: advise(outline(plain(8, side), EncodeOptions(threads=1, **options), Report()))["cost"]
    texels, larger = cost(64), cost(256)
    assert texels["voxels"] == 0 and 64**2 <= texels["texels"] < larger["texels"] and texels["seconds"] <= larger["seconds"]
    voxels, finer = (cost(64, support="voxels", resolution=k) for k in (256, 1024))
    assert voxels["texels"] == 0 and finer["voxels"] == pytest.approx(16 * voxels["voxels"], rel=0.01)
    assert finer["seconds"] > voxels["seconds"] and finer["bytes"] > voxels["bytes"]
