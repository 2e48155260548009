"""Rivals of tools/bench/methods: they count what they would have to be paid, and what is measured is what is counted."""

import dataclasses
import json
import sys

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere

from texfcodec.report import Report
from texfcodec.scene.scene import Material, Scene, Texture


@pytest.fixture
def needs_astc():
    pytest.importorskip("astc_encoder", reason="astc-encoder-py is not installed: pip install \"texfcodec[baselines]\"")


def seamed_strip(shift=0.0):
    """Two textured triangles that share an edge but no UV at one of its ends, and one triangle without a texture."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], np.float64)
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [0.5, 0.5], [0, 1]], [[0, 0], [0, 0], [0, 0]]]) + shift
    image = np.random.default_rng(3).integers(0, 256, (20, 30, 4), np.uint8)
    return Scene(positions, np.array([[0, 1, 2], [0, 2, 3], [1, 4, 2]]), np.array([1, 1, 0]), uv, None,
                 [Material("bare"), Material("cloth", texture=1), Material("unused", texture=0)],
                 [Texture(np.zeros((64, 64, 4), np.uint8), name="unused"), Texture(image, name="cloth")])


@pytest.mark.parametrize("width, height, block, blocks", [(1, 1, (12, 12), 1), (12, 13, (12, 12), 2), (25, 9, (10, 5), 6),
                                                           (2048, 2048, (6, 6), 116_964)])
def test_blocks_that_an_image_begins_count_whole(width, height, block, blocks):
    from tools.bench.methods.astc import texture_bytes

    assert texture_bytes(width, height, block) == 16 * blocks


def test_uvs_are_counted_once_per_vertex_of_a_renderer():
    from tools.bench.methods.astc import textured_vertices

    scene = seamed_strip()
    uv, vertex = textured_vertices(scene)
    assert len(uv) == 5 and vertex.shape == (2, 3)  # four places, one of them on a seam; the face without texture has none
    np.testing.assert_array_equal(uv[vertex], scene.corner_uv[:2])
    apart = dataclasses.replace(scene, faces=np.arange(9).reshape(3, 3), positions=np.zeros((9, 3)))
    assert len(textured_vertices(apart)[0]) == 6


def test_uvs_of_the_basketball_player_are_those_of_its_file(shared_dir):
    from texfcodec.io.load import load
    from tools.bench.methods.astc import quantise_uv, textured_vertices, uv_box

    uv, _ = textured_vertices(load(shared_dir / "assets/bball_0001.glb"))
    assert uv_box(uv) == [[0, 0], [1, 1]] and quantise_uv(uv, uv_box(uv)).nbytes == 82_768


@pytest.mark.parametrize(
    "low, high, box", [(0.2, 0.9, [[0, 0], [1, 1]]), (0, 1, [[0, 0], [1, 1]]), (-1.5, 3.2, [[-2, -2], [4, 4]])]
)
def test_uvs_are_rounded_to_sixteen_bits_of_whole_tiles(low, high, box):
    from tools.bench.methods.astc import UV_STEPS, dequantise_uv, quantise_uv, uv_box

    uv = np.concatenate([np.random.default_rng(1).uniform(low, high, (999, 2)), [[low, low], [high, high]]])
    assert uv_box(uv) == box
    steps = quantise_uv(uv, box)
    assert steps.dtype == np.uint16 and steps.nbytes == 4 * len(uv)
    off = np.abs(dequantise_uv(steps, box) - uv)
    assert 0 < off[:999].max() <= (0.5 + 1e-6) * (box[1][0] - box[0][0]) / UV_STEPS
    ends = np.array([box[0], box[1]], np.float64)
    np.testing.assert_array_equal(dequantise_uv(quantise_uv(ends, box), box), ends)


def test_images_are_coded_once_and_only_where_a_face_uses_them():
    from tools.bench.methods.astc import used_textures

    scene = seamed_strip()
    images, textures = used_textures(scene)
    assert [image.shape for image in images] == [(20, 30, 4)]
    assert [(number, name) for number, _, name in textures] == [(0, "unused"), (0, "cloth")]
    scene.textures.append(Texture(scene.textures[1].image, (1, 2), "again"))
    scene.materials[0] = Material("bare", texture=2)
    images, textures = used_textures(scene)
    assert len(images) == 1 and textures[2] == (0, (1, 2), "again")


def test_scene_without_textures_is_refused():
    from tools.bench.methods.astc import used_textures

    with pytest.raises(LookupError, match="no face has a base-colour texture"):
        used_textures(painted_sphere(4))


def test_missing_library_is_named_and_hides_no_method(monkeypatch):
    from tools.bench.methods import METHODS, find

    monkeypatch.setitem(sys.modules, "astc_encoder", None)
    monkeypatch.delitem(sys.modules, "tools.bench.methods.astc", raising=False)
    monkeypatch.delitem(METHODS, "astc", raising=False)
    rival = find("astc")
    assert find("texf") and isinstance(rival.version(), str)
    with pytest.raises(LookupError, match=r"pip install .texfcodec\[baselines\]"):
        rival.warm_up({}, 1)


@pytest.mark.parametrize(
    "name, value", [("block", "7x7"), ("quality", 101), ("quality", True), ("uv_bytes", "float"), ("profile", "hdr")]
)
def test_options_out_of_range_are_refused(name, value):
    from tools.bench.methods.astc import Codec

    with pytest.raises(ValueError, match=f"{name} must be"):
        Codec({name: value}, 1)


# With the library.


def coded(scene, folder, **options):
    """(what encode says, the decoded Scene, its hash), the decoder being another Astc than the encoder."""
    from tools.bench.methods import find

    folder.mkdir()
    facts = find("astc").encode(scene, {"quality": 60, **options}, folder, 1, Report())
    other = find("astc")
    decoded = other.decode(folder, {"quality": 60, **options}, 1, Report())
    return json.loads(json.dumps(facts)), decoded, other.values_sha256(decoded)


def test_astc_decodes_to_what_the_encoder_hashed(needs_astc, tmp_path):
    from tools.bench.methods.astc import Astc

    scene = crossing_sheets()
    facts, decoded, sha256 = coded(scene, tmp_path / "a", block="4x4")
    assert facts["reconstruction_sha256"] == sha256
    assert facts["bytes"] == {"total": 16 * 16 + 8 * 4, "geometry": 0, "texture": 16 * 16, "uv": 8 * 4}
    for name in ("positions", "faces", "face_material"):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(scene, name))
    assert [(m.name, m.alpha_mode, m.texture) for m in decoded.materials] == [("stone", 0, 0), ("glass", 2, 0)]
    assert decoded.corner_color is None and decoded.textures[0].image.shape == (16, 16, 4)
    other = dataclasses.replace(decoded, corner_uv=decoded.corner_uv + 1e-3)
    assert Astc().values_sha256(other) != sha256


def test_files_of_astc_are_as_large_as_what_is_counted(needs_astc, tmp_path):
    from tools.bench.methods.astc import IMAGE, UVS

    facts, _, _ = coded(seamed_strip(), tmp_path / "a", block="12x10")
    assert (tmp_path / "a" / IMAGE.format(0)).stat().st_size == facts["bytes"]["texture"] == 16 * 3 * 2
    assert (tmp_path / "a" / UVS).stat().st_size == facts["bytes"]["uv"] == 5 * 4
    facts, decoded, sha256 = coded(seamed_strip(), tmp_path / "b", block="12x10", uv_bytes="none")
    assert facts["bytes"]["total"] == facts["bytes"]["texture"] and not (tmp_path / "b" / UVS).exists()
    np.testing.assert_array_equal(decoded.corner_uv, seamed_strip().corner_uv)
    assert sha256 == facts["reconstruction_sha256"]


def test_uvs_that_count_are_the_ones_that_are_measured(needs_astc, tmp_path):
    scene = seamed_strip(shift=0.3141)
    _, decoded, _ = coded(scene, tmp_path / "a", block="8x8")
    off = np.abs(decoded.corner_uv - scene.corner_uv)[:2]
    assert 0 < off.max() <= 1.01 / 65535  # two tiles
    np.testing.assert_array_equal(decoded.corner_uv[2], np.zeros((3, 2)))


def test_smaller_blocks_are_closer_and_alpha_is_kept(needs_astc, tmp_path):
    y, x = np.mgrid[:64, :64]
    image = np.stack([4 * x, 4 * y, 2 * (x + y), 255 - 3 * x], -1).astype(np.uint8)
    scene = crossing_sheets()
    scene.textures[0] = Texture(image)
    errors = []
    for block in ("12x12", "6x6", "4x4"):
        _, decoded, _ = coded(scene, tmp_path / block, block=block)
        errors.append(np.abs(decoded.textures[0].image.astype(int) - image).mean(axis=(0, 1)))
    assert errors[0].sum() > errors[1].sum() > errors[2].sum() and np.max(errors[2]) < 2


def test_vertex_colours_beside_textures_are_named(needs_astc, sample_scene, tmp_path):
    from tools.bench.methods import find

    report = Report()
    facts = find("astc").encode(sample_scene, {"block": "12x12", "quality": 0}, tmp_path, 1, report)
    assert any("vertex colours are handed through" in warning for warning in report.warnings)
    assert len(facts["images"]) == 4
    np.testing.assert_array_equal(find("astc").decode(tmp_path, {"block": "12x12"}, 1, Report()).corner_color,
                                  sample_scene.corner_color)


# Maps of whole materials.


def material_sheet(**maps):
    """A square whose base colour is image 0; maps: image by channel, 1 for data and 2 for normals."""
    side, faces = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64), np.array([[0, 1, 2], [0, 2, 3]])
    random = np.random.default_rng(8)
    images = [random.integers(0, 256, (32, 32, 4), np.uint8), random.integers(0, 256, (32, 32, 4), np.uint8)]
    slope = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 32), np.linspace(-0.4, 0.6, 32)), axis=-1)
    normal = np.concatenate([slope, np.sqrt(1 - (slope**2).sum(axis=2, keepdims=True)), np.ones((32, 32, 1))], axis=2)
    images.append(np.rint((normal + 1) * 127.5).astype(np.uint8))
    return Scene(np.insert(side, 2, 0.5, axis=1), faces, np.zeros(2, np.int64), side[faces], None,
                 [Material("rich", texture=0, maps=maps)], [Texture(image) for image in images])


def test_maps_are_packed_as_gltf_packs_them():
    from tools.bench.methods.packed_maps import COLOUR, DATA, NORMAL, pack_maps

    scene = material_sheet(occlusion=1, roughness=0, metallic=1, normal=2, emissive=1)
    packed, placed = pack_maps(scene)
    assert [(s.names, s.kind) for s in packed] == [(("occlusion", "roughness", "metallic"), DATA), (("normal",), NORMAL),
                                                   (("emissive",), COLOUR)]
    assert placed == [{"occlusion": 0, "roughness": 0, "metallic": 0, "normal": 1, "emissive": 2}]
    images = [t.image for t in scene.textures]
    np.testing.assert_array_equal(packed[0].image[..., :3], np.dstack([images[1][..., 0], images[0][..., 1], images[1][..., 2]]))
    assert (packed[0].image[..., 3] == 255).all()
    np.testing.assert_array_equal(packed[1].image, images[2])
    scene.textures[0] = Texture(images[0][:16])
    assert [s.names for s in pack_maps(scene)[0]][:2] == [("occlusion", "metallic"), ("roughness",)]  # of one size no more
    scene.materials.append(Material("unused", maps={"clearcoat": 1}))
    assert len(pack_maps(scene)[0]) == 4
    with pytest.raises(ValueError, match="UVs of their own"):
        pack_maps(dataclasses.replace(scene, map_uv={"normal": scene.corner_uv}))


def test_two_components_hold_a_normal_map():
    from tools.bench.methods.packed_maps import three_components, two_components

    image = material_sheet().textures[2].image
    packed = two_components(image)
    assert (packed[..., 0] == packed[..., 1]).all() and (packed[..., 0] == packed[..., 2]).all()
    assert np.abs(three_components(packed).astype(int) - image).max() <= 1


def test_a_scene_is_its_own_equal_and_errors_are_told_by_channel():
    from tools.bench.map_errors import map_errors

    scene = material_sheet(roughness=1, normal=2)
    same = map_errors(scene, dataclasses.replace(scene), 2000)
    assert same["pooled"] is None and list(same["channels"]) == ["base_colour", "normal", "roughness"]
    assert same["channels"]["normal"]["p95_degrees"] < 1e-3
    other = scene.textures[1].image.copy()
    other[..., 1] = np.where(other[..., 1] < 128, other[..., 1] + 10, other[..., 1] - 10)
    textures = [scene.textures[0], Texture(other), scene.textures[2]]
    off = map_errors(scene, dataclasses.replace(scene, textures=textures), 2000)
    assert off["channels"]["base_colour"]["psnr"] is None and 28 < off["channels"]["roughness"]["psnr"] < 40
    assert off["plain"] == pytest.approx(off["channels"]["roughness"]["psnr"] + 10 * np.log10(7), abs=1e-6)  # one of 7 components


def test_normals_of_a_payload_are_those_that_a_viewer_shades_with():
    from texfcodec import EncodeOptions, decode
    from texfcodec.encoder.encode import encode_scene
    from tools.bench.map_errors import map_errors

    scene = material_sheet(normal=2)
    made = encode_scene(scene, EncodeOptions(codec="3dntc", threads=1, resolution=32, resident_bytes=40_000, steps=400,
                                             fit_engine="numba"))
    told = map_errors(scene, decode(made.data), 4000)["channels"]["normal"]
    assert told["mean_degrees"] < 2 and told["psnr"] > 35


@pytest.mark.parametrize("normals, closest", [("xy", 0.1), ("rgb", 1.5)])
def test_astc_of_all_maps_counts_and_keeps_them(needs_astc, tmp_path, normals, closest):
    from tools.bench.map_errors import map_errors

    scene = material_sheet(roughness=1, metallic=1, normal=2)
    scene.corner_normal = np.broadcast_to(np.float32([0, 0.6, 0.8]), (2, 3, 3)).copy()
    options = {"block": "4x4", "maps": "all", "normals": normals}
    facts, decoded, sha256 = coded(scene, tmp_path / "a", **options)
    assert facts["reconstruction_sha256"] == sha256
    assert facts["bytes"]["texture"] == 3 * 16 * 64 and facts["bytes"]["uv"] == 4 * 4  # base, roughness with metallic, normal
    told = map_errors(scene, decoded, 2000)
    assert list(told["channels"]) == ["base_colour", "normal", "roughness", "metallic"]
    assert told["channels"]["normal"]["mean_degrees"] < closest and told["channels"]["roughness"]["psnr"] > 15
    bare, plain, _ = coded(scene, tmp_path / "b", block="4x4")
    assert bare["bytes"]["texture"] == 16 * 64 and plain.materials[0].maps == {}


def test_bc7_and_bc5_of_all_maps_count_and_keep_them(tmp_path):
    pytest.importorskip("etcpak", reason="etcpak is not installed: pip install \"texfcodec[baselines]\"")
    from tools.bench.map_errors import map_errors
    from tools.bench.methods import find

    scene, sizes, found = material_sheet(metallic=1, normal=2), [], []
    scene.textures[0] = Texture(scene.textures[2].image)
    for halvings in (0, 1):
        folder, options = tmp_path / str(halvings), {"halvings": halvings, "maps": "all"}
        folder.mkdir()
        facts = find("bc7").encode(scene, options, folder, 1, Report())
        decoded = find("bc7").decode(folder, options, 1, Report())
        assert find("bc7").values_sha256(decoded) == facts["reconstruction_sha256"]
        sizes.append(facts["bytes"])
        found.append(map_errors(scene, decoded, 2000)["channels"])
    assert sizes[0] == {"total": 3 * 16 * 64 + 16, "geometry": 0, "texture": 3 * 16 * 64, "uv": 16}
    assert sizes[1]["texture"] == 3 * 16 * 16
    assert found[0]["base_colour"]["psnr"] > 40 and found[0]["normal"]["mean_degrees"] < 0.6
    assert found[1]["metallic"]["psnr"] < found[0]["metallic"]["psnr"]


@pytest.mark.parametrize("name, value", [("halvings", -1), ("uber", 5), ("uber", True), ("uv_bytes", "float"), ("maps", "some")])
def test_options_of_bc7_out_of_range_are_refused(name, value):
    from tools.bench.methods.bc7 import Codec

    with pytest.raises(ValueError, match=f"{name} must be"):
        Codec({name: value})
