"""Where a unit of values is not coded at the QP that was asked for: palettes come back exactly, squares of texels stay squares,
and what a lossy image file has lost already is not paid for again."""

import io

import numpy as np
import pytest
from mesh_files import SQUARE_UV, Builder, encoded
from PIL import Image
from walls import boxes, smooth_image, wall

from texfcodec import EncodeOptions, Report, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.place.prefilter_textures import prefilter_textures
from texfcodec.encoder.requests import Requests
from texfcodec.encoder.values.unit_qp import EXACT_BYTES, HOPELESS, LEAST_SAVED, CodedUnit, choose_qp, has_few_colours
from texfcodec.geometry.surface import make_surface
from texfcodec.io.load import load
from texfcodec.metrics.psnr_3d import measure


@pytest.mark.parametrize("rate", ["r01", "r03", "r05"])
def test_a_palette_with_uvs_at_texel_centres_comes_back_exactly_and_asks_no_texel_more_than_it_shows(rate):
    scene = boxes()
    made = encode_scene(scene, EncodeOptions(rate=rate))
    assert measure(scene, decode(made.data), 5_000)["rgb"] is None
    assert made.counts["texels"] == len(np.unique(scene.corner_uv[..., 0])) and made.choices["channels"][0]["exact"]


def test_few_colours_are_exact_only_where_that_costs_little():
    rng = np.random.default_rng(1)
    image = np.full((256, 256, 4), 255, np.uint8)
    image[..., :3] = rng.integers(0, 256, (200, 3))[rng.integers(0, 200, (256, 256))]
    scene = wall(image, n=4)
    made = encode_scene(scene, EncodeOptions(rate="r01", support="texels"))
    channel = made.choices["channels"][0]
    assert "exact" not in channel and channel["psnr"][channel["channels"][0]] < 60


def test_what_counts_as_few_colours():
    rows = np.random.default_rng(0).integers(0, 256, (256, 3)).astype(np.float32)
    assert has_few_colours(np.repeat(rows, 100, axis=0)) and has_few_colours(0.9 * rows)  # of a factor, and so rounded
    assert not has_few_colours(np.concatenate([rows, rows[::-1] + 1.0]))


def glb(image, mime="image/png", **sampler):
    """A textured square without light as a GLB."""
    builder = Builder()
    material = builder.material(builder.texture(image, **sampler), extensions={"KHR_materials_unlit": {}})
    builder.primitive(uv=SQUARE_UV, material=material)
    builder.tree["images"][0]["mimeType"], builder.tree["extensionsUsed"] = mime, ["KHR_materials_unlit"]
    return builder.glb()


def test_squares_of_texels_go_through_a_stream_and_back_into_a_glb_with_their_sampler(tmp_path):
    image = np.random.default_rng(2).integers(0, 4, (16, 16, 1)).repeat(3, axis=2).astype(np.uint8) * 80
    source = tmp_path / "pixels.glb"
    source.write_bytes(glb(encoded(image), magFilter=9728, minFilter=9728))
    scene, report = load(source), Report()
    assert scene.textures[0].nearest and not scene.dropped
    made = encode_scene(scene, EncodeOptions(rate="r01"), report)
    assert not report.dropped
    decode(made.data).save(tmp_path / "back.glb")
    back = load(tmp_path / "back.glb")
    assert back.textures[0].nearest and np.array_equal(back.textures[0].image[..., :3], image)


def test_squares_of_texels_that_go_over_voxels_are_named_as_lost(tmp_path):
    image = np.random.default_rng(2).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    source = tmp_path / "pixels.glb"
    source.write_bytes(glb(encoded(image), magFilter=9728))
    report = Report()
    encode_scene(load(source), EncodeOptions(resolution=64, qp=28), report)
    assert report.dropped == ["NEAREST filter of texture 'image 0'"]


def test_a_jpeg_is_not_coded_in_more_bytes_than_it_has(tmp_path):
    rng = np.random.default_rng(3)
    noise = np.clip(smooth_image(128, 128, 3)[..., :3].astype(float) + rng.normal(0, 40, (128, 128, 3)), 0, 255).astype(np.uint8)
    jpeg = encoded(noise, "JPEG", quality=30)
    sizes = {}
    for name, data in (("image/jpeg", jpeg), ("image/png", encoded(Image.open(io.BytesIO(jpeg))))):
        (tmp_path / "wall.glb").write_bytes(glb(data, name))
        made = encode_scene(load(tmp_path / "wall.glb"), EncodeOptions(rate="r05", support="texels"))
        sizes[name] = made.sizes["attributes"], made.choices["channels"][0]
    assert sizes["image/png"][0] > len(jpeg) and "source_image_bytes" not in sizes["image/png"][1]
    assert 0.5 * len(jpeg) < sizes["image/jpeg"][0] <= len(jpeg) + LEAST_SAVED
    channel = sizes["image/jpeg"][1]
    assert channel["source_image_bytes"] == len(jpeg) and channel["bytes_at_qp"] > len(jpeg) and channel["qp"] > 22


def test_an_image_that_voxels_cannot_hold_becomes_its_mean_and_no_megabyte_of_noise():
    scene = wall(smooth_image(64, 64, 3), n=8)
    usual = encode_scene(scene, EncodeOptions(resolution=256, qp=28))
    scene.corner_uv = scene.corner_uv * 1e6
    made = encode_scene(scene, EncodeOptions(resolution=256, qp=28))
    assert made.sizes["attributes"] < usual.sizes["attributes"]
    mean = scene.textures[0].image[..., :3].reshape(-1, 3).mean(axis=0)
    assert np.abs(decode(made.data).fields[0].rgba[:, :3] - mean).max() <= 2


def test_images_that_texels_need_keep_their_detail_where_voxels_share_them():
    scene = wall(smooth_image(64, 64, 3), n=8)
    surface = make_surface(scene, EncodeOptions())
    over = np.ones(len(surface.faces), bool)
    assert prefilter_textures(scene, surface, over, 1).textures[0].image.shape == (16, 16, 4)
    assert prefilter_textures(scene, surface, over, 64).textures[0].image.shape == (64, 64, 4)
    over[0] = False
    assert prefilter_textures(scene, surface, over, 1).textures[0] is scene.textures[0]


def test_a_small_share_of_a_jpeg_does_not_take_the_quality_of_a_small_unit():
    """What a unit takes at any QP is no quality, and no budget makes a step more than eight times as large."""
    plane = np.random.default_rng(0).integers(0, 256, (400, 3)).astype(np.float32)
    tried = []

    def code(coder, size=5000):
        tried.append(coder.qp)
        return CodedUnit(codec=None, values={}, bytes=size, plane=plane, decoded=np.zeros((400, 3), np.uint8))

    coder = Requests.of(EncodeOptions(rate="r03")).price.planes
    small = code(coder, 60)
    assert choose_qp(small, code, coder, 10_000, 20.0, float).value is small
    assert choose_qp(code(coder), code, coder, 10_000, 20.0, float).evidence["qp"] == max(tried) == 28 + 18


@pytest.mark.parametrize("share, is_tried", [(0.9, True), (1.1, False)])
def test_exact_values_are_coded_only_where_an_estimate_leaves_them_a_chance(share, is_tried):
    plane, tried = np.repeat(np.arange(4, dtype=np.float32), 100)[:, None], []

    def code(coder):
        tried.append(coder.qp)
        return CodedUnit(codec=None, values={}, bytes=1000, plane=plane, decoded=np.zeros((400, 1), np.uint8))

    coder = Requests.of(EncodeOptions(rate="r03")).price.planes
    most = 1000 + EXACT_BYTES
    choose_qp(code(coder), code, coder, 0.0, None, lambda: share * HOPELESS * most)
    assert (None in tried) == is_tried


def test_what_an_image_file_allows_is_the_same_quality_from_any_rate():
    """A finer rate that is over the file's bytes may not come out coarser than one that was just within them."""
    plane = np.random.default_rng(0).integers(0, 256, (400, 3)).astype(np.float32)

    def code(coder):
        size = round(11_549 * 2 ** (-0.155 * (coder.qp - 23.1)))
        return CodedUnit(codec=None, values={}, bytes=size, plane=plane, decoded=np.zeros((400, 3), np.uint8))

    coder, found = Requests.of(EncodeOptions(rate="r03")).price.planes, []
    for qp in range(16, 26):
        at = coder.at(qp=qp)
        found.append(choose_qp(code(at), code, at, 1.0, 11_549.0, float).evidence.get("qp", qp))
    assert found == [23] * 8 + [24, 25]
