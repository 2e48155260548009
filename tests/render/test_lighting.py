"""Pictures in light: what is asked of sources and streams, that both agree, and what the tools say of their difference."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from shapes import crossing_sheets, domed, mapped_sheet, painted_sphere

from texfcodec import EncodeOptions, decode
from texfcodec.core.colour_error import decibels
from texfcodec.encoder.encode import encode_scene
from texfcodec.metrics.shaded import compare_channels, compare_shaded
from texfcodec.metrics.views import ViewSettings, compare_views
from texfcodec.render import lit_scene
from texfcodec.render.camera import bounding_sphere, orthographic, perspective_around
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.lighting import Lighting
from texfcodec.render.shade import render_scene, render_texf
from texfcodec.render.textures import MipScenes, Textures, halved
from texfcodec.scene.channels import BY_NAME, MAPS, PARAMETER_BY_NAME
from texfcodec.scene.fetch import pack_source
from texfcodec.scene.scene import ALPHA_MASK, WRAP_CLAMP, Texture

TEXELS = EncodeOptions(support="texels", lossless=True, partition="off", refine="off")
VOXELS = EncodeOptions(resolution=96, qp=8, partition="off", refine="off")
SIDE = 12
ON = {name: (1.0,) * PARAMETER_BY_NAME[name].count for name in (
    "emissive", "clearcoat", "clearcoat_roughness", "sheen_colour", "sheen_roughness", "transmission", "thickness", "iridescence",
    "anisotropy", "diffuse_transmission")}
NEEDS = {"clearcoat_roughness": ("clearcoat",), "clearcoat_normal": ("clearcoat",), "sheen_roughness": ("sheen_colour",),
         "sheen_colour": ("sheen_roughness",), "thickness": ("transmission",), "iridescence_thickness": ("iridescence",),
         "diffuse_transmission_colour": ("diffuse_transmission",)}


def smooth(seed, low=40, high=215, side=32):
    """An image of smooth waves, uint8 [side, side, 4], alpha too."""
    rng = np.random.default_rng(seed)
    v, u = (np.mgrid[:side, :side] + 0.5) / side
    turn = lambda: rng.uniform(0.4, 1.2)
    waves = [np.sin(2 * np.pi * (u * turn() + v * turn() + rng.uniform())) for _ in range(4)]
    return np.rint(low + (high - low) * (0.5 + 0.5 * np.stack(waves, -1))).astype(np.uint8)


def normal_map(seed, side=32, lean=60):
    image = smooth(seed, 127 - lean, 128 + lean, side).astype(float)
    x, y = image[..., 0] / 127.5 - 1, image[..., 1] / 127.5 - 1
    return np.rint(127.5 * (1 + np.stack([x, y, np.sqrt(1 - x * x - y * y), np.ones_like(x)], -1))).astype(np.uint8)


def dome(names=(), parameters=None, **material):
    """A bent sheet with a smooth image of base colour and maps of these channels, whose factors are 1. It brings no normals: both
    sides make them by the usual rule."""
    base = smooth(0)
    base[..., 3] = 255
    images = {n: normal_map(i) if BY_NAME[n].unit == "degrees" else smooth(i) for i, n in enumerate(names, 1)}
    used = {n: ON[n] for name in names for n in (name, *NEEDS.get(name, ())) if n in ON}
    glass = {"thickness": (0.3,), "attenuation_distance": (0.2,), "attenuation_colour": (0.3, 0.6, 0.9)}
    used |= {"metallic": (0.5,), "roughness": (0.6,), **(glass if "thickness" in names else {}), **(parameters or {})}
    return domed(mapped_sheet(images, base, SIDE, (WRAP_CLAMP, WRAP_CLAMP), parameters=used, **material))


def front(scene, size=128, turn=(0.3, 0.2, 1.0)):
    return orthographic(turn, *bounding_sphere(scene.positions), size)


def psnr(a, b):
    """Decibels between two pictures, where both cover."""
    both, i, j = np.intersect1d(a.pixel, b.pixel, return_indices=True)
    assert len(both) > 0.98 * len(a.pixel)
    return decibels(float(np.mean((a.colour[i].astype(float) - b.colour[j]) ** 2)))


# Source against stream.


NAMES = [channel.name for channel in MAPS]


@pytest.mark.parametrize("name", NAMES)
def test_a_lossless_stream_over_texels_is_lit_as_its_source(name):
    scene = dome([name])
    texf = decode(encode_scene(scene, TEXELS).data)
    assert name in texf.fields[0].planes
    shown = render_scene(scene, front(scene), shaded=DAYLIGHT)
    agreement = psnr(shown, render_texf(texf, front(scene), filtering=False, shaded=DAYLIGHT))
    bare = replace(scene, materials=[replace(scene.materials[0], maps={})])
    missing = psnr(shown, render_scene(bare, front(scene), shaded=DAYLIGHT))
    assert agreement > 55 and agreement > missing + 10


OVER_VOXELS = [n for n in NAMES if n != "anisotropy"]  # its direction has no frame where there are no UVs


@pytest.mark.parametrize("name", OVER_VOXELS)
def test_a_stream_over_voxels_is_lit_as_its_source(name):
    scene = dome([name])
    texf = decode(encode_scene(scene, VOXELS).data)
    shown = render_scene(scene, front(scene), shaded=DAYLIGHT)
    agreement = psnr(shown, render_texf(texf, front(scene), filtering=False, shaded=DAYLIGHT))
    assert agreement > 43


@pytest.mark.parametrize("options", [TEXELS, VOXELS], ids=["texels", "voxels"])
def test_normals_of_maps_come_back_within_degrees(options):
    scene = dome(["normal"])
    found = compare_channels(scene, decode(encode_scene(scene, options).data), 5000)
    assert found["normals"]["with_map"]["p95_degrees"] < 1 and found["normals"]["without_map"]["p99_degrees"] < 0.1
    assert found["channels"]["normal"]["median_degrees"] < 0.4


# What is sampled, and what is left alone.


def sampled_channels(scene, monkeypatch, draw):
    """Names of the channels whose maps a picture samples."""
    names, real = set(), Lighting._points

    def points(self, camera, sample, at, colour):
        return real(self, camera, lambda wanted, *more: names.update(wanted) or sample(wanted, *more), at, colour)

    monkeypatch.setattr(Lighting, "_points", points)
    draw()
    return names


def test_only_channels_of_effects_in_use_are_asked(monkeypatch):
    maps = ["normal", "roughness", "clearcoat", "clearcoat_normal", "sheen_colour", "occlusion", "thickness", "emissive"]
    scene = dome(maps, {"clearcoat": (0.0,), "transmission": (0.0,), "sheen_colour": (0.0,) * 3})
    draw = lambda one: lambda: render_scene(one, front(one, 32), shaded=DAYLIGHT)
    assert sampled_channels(scene, monkeypatch, draw(scene)) == {"normal", "roughness", "occlusion", "emissive"}
    dark = replace(scene, materials=[replace(scene.materials[0], unlit=True)])
    assert sampled_channels(dark, monkeypatch, draw(dark)) == set()


def test_a_material_that_is_not_in_view_asks_nothing(monkeypatch):
    scene = dome(["roughness", "occlusion"])
    plain, rich = replace(scene.materials[0], maps={"occlusion": 2}), scene.materials[0]
    both = replace(scene, materials=[plain, rich], face_material=np.where(np.arange(len(scene.faces)) < 1, 1, 0))
    right = orthographic((0, 0, 1), (1.2, 0.5, 0), 0.5, 32)
    assert sampled_channels(both, monkeypatch, lambda: render_scene(both, right, shaded=DAYLIGHT)) == {"occlusion"}


def test_channels_that_share_images_are_asked_together(monkeypatch):
    scene = dome(["roughness", "metallic", "occlusion", "normal"])
    maps = {"roughness": 1, "metallic": 1, "occlusion": 1, "normal": 4}
    packed = replace(scene, materials=[replace(scene.materials[0], maps=maps)])
    calls, real = [], Textures.sample
    monkeypatch.setattr(Textures, "sample", lambda self, *more: calls.append(self) or real(self, *more))
    render_scene(packed, front(packed, 32), shaded=DAYLIGHT)
    assert len(calls) == 2


@pytest.mark.parametrize("filtering", [True, False])
def test_unlit_pictures_are_the_same_to_the_byte(filtering):
    scene = painted_sphere()
    scene = replace(scene, materials=[replace(scene.materials[0], unlit=True)])
    texf, camera = decode(encode_scene(scene, EncodeOptions(resolution=32, qp=20)).data), front(scene, 64)
    for draw in (lambda light: render_scene(scene, camera, shaded=light), lambda light: render_texf(texf, camera, True, filtering,
                                                                                                    shaded=light)):
        assert_array_equal(draw(None).colour, draw(DAYLIGHT).colour)


def test_unlit_faces_beside_lit_ones_keep_their_colour():
    scene = crossing_sheets()
    mixed = replace(scene, materials=[replace(scene.materials[0], unlit=True), replace(scene.materials[1], alpha_mode=0)])
    camera = orthographic((1, 0.2, 1), *bounding_sphere(scene.positions), 64)
    plain, lit = render_scene(mixed, camera, False), render_scene(mixed, camera, False, shaded=DAYLIGHT)
    same = (plain.colour == lit.colour).all(axis=1)
    assert_array_equal(plain.pixel, lit.pixel)
    assert 0.2 < same.mean() < 0.8


def test_the_back_of_a_double_sided_face_is_lit_as_a_front():
    scene = dome(["normal"], double_sided=True)
    behind = orthographic((0.2, 0.1, -1), *bounding_sphere(scene.positions), 64)
    turned = replace(scene, faces=scene.faces[:, ::-1].copy(), corner_uv=scene.corner_uv[:, ::-1].copy(),
                     materials=[replace(scene.materials[0], maps={})])
    flat = replace(scene, materials=[replace(scene.materials[0], maps={})])
    a, b = render_scene(flat, behind, shaded=DAYLIGHT), render_scene(turned, behind, shaded=DAYLIGHT)
    assert psnr(a, b) > 60
    assert 15 < psnr(render_scene(scene, behind, shaded=DAYLIGHT), a) < 45  # the map is seen from behind too


def test_perspective_looks_at_every_pixel_from_the_eye():
    """A flat mirror: seen from one direction it is of one colour, but for a perspective camera it shows a piece of the sky."""
    scene = dome((), {"roughness": (0.05,), "metallic": (1.0,)})
    positions = scene.positions * [1, 1, 0]
    scene = replace(scene, positions=positions[:, [0, 2, 1]] * [1, 1, -1], textures=[Texture(np.full((4, 4, 4), 200, np.uint8))])
    view, sphere = (0, 0.5, 1), bounding_sphere(scene.positions)
    even, uneven = (np.ptp(render_scene(scene, camera, shaded=DAYLIGHT).colour, axis=0).max() for camera in (
        orthographic(view, *sphere, 64), perspective_around(view, *sphere, 60, 64)))
    assert even < 1 and uneven > 10


def test_pictures_do_not_depend_on_threads_or_blocks(monkeypatch):
    scene = dome(["normal", "roughness", "clearcoat", "clearcoat_normal"])
    texf = decode(encode_scene(scene, VOXELS).data)
    draws = [lambda n: render_scene(scene, front(scene, 64), shaded=DAYLIGHT, threads=n),
             lambda n: render_texf(texf, front(scene, 64), shaded=DAYLIGHT, threads=n)]
    whole = [draw(1).colour for draw in draws]
    monkeypatch.setattr("texfcodec.render.lighting.BLOCK", 500)
    for draw, expected in zip(draws, whole, strict=True):
        assert_allclose(draw(3).colour, expected, atol=1e-3)


def test_minified_streams_ask_coarser_levels_of_maps():
    scene = dome(["roughness", "normal", "occlusion"])
    rng = np.random.default_rng(0)
    noise = [replace(t, image=rng.integers(60, 196, (128, 128, 4)).astype(np.uint8)) for t in scene.textures]
    grey = replace(noise[0], image=np.full((128, 128, 4), 128, np.uint8))
    texf = decode(encode_scene(replace(scene, textures=[grey, *noise[1:]]), TEXELS).data)
    shown = (render_texf(texf, front(scene, 32, (0, 0, 1)), filtering=f, shaded=DAYLIGHT).image() for f in (True, False))
    filtered, plain = (np.abs(np.diff(image[8:-8, 8:-8].astype(float), axis=1)).mean() for image in shown)
    assert filtered < 0.55 * plain


# Mip levels of images.


def test_mip_levels_are_means_in_linear_light_or_of_data():
    board = np.zeros((4, 4, 4), np.uint8)
    board[::2, ::2], board[1::2, 1::2] = 255, 255
    assert (halved(board, True) == [188, 188, 188, 128]).all() and (halved(board, False) == 128).all()
    odd = np.zeros((5, 1, 4), np.uint8)
    odd[2] = 255
    assert halved(odd, False)[:, 0, 0].tolist() == [round(255 * w) for w in (0.2, 0.2)]
    ramp = np.repeat(np.arange(7, dtype=np.uint8)[:, None, None] * 20, 4, axis=2)
    assert_allclose(halved(ramp, False)[:, 0, 0].mean(), ramp.mean(), atol=0.5)
    assert halved(np.full((1, 1, 4), 9, np.uint8), False).tolist() == [[[9] * 4]]


def test_mip_mapped_pictures_are_calm_where_they_are_minified_and_the_same_where_not():
    scene = dome()
    board = np.indices((256, 256)).sum(0) % 2 * 255
    scene = replace(scene, textures=[Texture(np.repeat(board[..., None], 4, axis=2).astype(np.uint8))])
    levels = Textures(scene, pack_source, MipScenes(scene))
    small, large = front(scene, 16, (0, 0, 1)), front(scene, 1024, (0, 0, 1))
    calm = render_scene(scene, small, source=levels).colour
    assert np.ptp(calm) < 40 and abs(calm.mean() - 188) < 8
    assert_array_equal(render_scene(scene, large, source=levels).colour, render_scene(scene, large).colour)


def test_mip_levels_have_the_size_that_a_pixel_has_on_each_face():
    """Two sheets, one with four times the texels: its level is one coarser."""
    scene = dome()
    levels, dense = (Textures(replace(scene, corner_uv=scene.corner_uv * n), pack_source, MipScenes(scene)) for n in (1, 2))
    assert_allclose(dense._density, 2 * levels._density, rtol=1e-6)
    corners = scene.positions[scene.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert_allclose(levels._density, 32 * np.sqrt(0.5 / SIDE**2 / area), rtol=1e-6)


# Differences.


def test_an_asset_beside_itself_is_exact():
    scene = dome(["normal", "roughness", "clearcoat", "clearcoat_normal"])
    found = compare_shaded(scene, scene, 2, 64)
    assert set(found["psnr"].values()) == {None} and set(found["channels"]) == set(scene.materials[0].maps)
    assert found["channels"]["roughness"]["psnr"] is None and found["normals"]["with_map"]["p99_degrees"] < 1e-3


def test_every_channel_is_told_with_its_error():
    scene = dome(["roughness", "emissive"])
    first, second, third = scene.textures
    other = replace(scene, textures=[first, replace(second, image=np.minimum(second.image, 245) + 10), third])
    found = compare_channels(scene, other, 4000)["channels"]
    assert found["roughness"]["psnr"] == pytest.approx(decibels(0.6**2 * 100), abs=0.1) and found["emissive"]["psnr"] is None
    absent = replace(scene, materials=[replace(scene.materials[0], maps={})])
    assert compare_channels(scene, absent, 4000)["channels"]["roughness"]["psnr"] < 20


def test_coverage_of_a_mask_counts_points_on_the_other_side():
    scene = dome()
    image = scene.textures[0].image.copy()
    image[:, :16, 3], image[:, 16:, 3] = 255, 0
    fuller = image.copy()
    fuller[:, 16:20, 3] = 255
    masked = lambda i: replace(scene, materials=[replace(scene.materials[0], alpha_mode=ALPHA_MASK)],
                               textures=[replace(scene.textures[0], image=i)])
    found = compare_channels(masked(image), masked(fuller), 20_000)["channels"]["alpha_mask"]
    assert found["lost"] == 0 and found["gained"] == pytest.approx(4 / 16, abs=0.02)
    back = compare_channels(masked(fuller), masked(image), 20_000)["channels"]["alpha_mask"]
    assert back["gained"] == 0 and back["lost"] == pytest.approx(4 / 20, abs=0.02)


def test_a_mesh_of_other_vertices_is_compared_where_it_is_nearest():
    scene = dome(["normal", "roughness"])
    order = np.random.default_rng(0).permutation(len(scene.faces))
    other = replace(scene, faces=scene.faces[order], corner_uv=scene.corner_uv[order])
    found = compare_channels(scene, other, 4000)
    assert (found["channels"]["roughness"]["psnr"] or 99) > 60 and found["normals"]["with_map"]["p95_degrees"] < 0.1


def test_mipmaps_and_light_are_looks_of_the_same_views():
    scene = dome(["roughness"])
    texf = decode(encode_scene(scene, VOXELS).data)
    all_settings = [ViewSettings(environment=light, mipmaps=mipmaps) for light in (None, DAYLIGHT) for mipmaps in (False, True)]
    found = [compare_views(scene, texf, 2, 48, settings=settings) for settings in all_settings]
    assert len({one["pixels"] for one in found}) == 1 and len({one["psnr"]["y"] for one in found}) == 4
    assert min(one["psnr"]["y"] for one in found) > 30


def test_tools_say_what_light_shows(call, tmp_path):
    scene = dome(["normal", "roughness"])
    stream = encode_scene(scene, TEXELS).data
    (tmp_path / "a.texf").write_bytes(stream)
    decode(stream).save(tmp_path / "a.glb")
    for name in ("a.texf", "a.glb"):
        code, said, _ = call("texf-eval", tmp_path / "a.glb", tmp_path / name, "--views", "2", "--size", "48", "--shaded",
                             "--mipmaps", "--no-3d", "--json")
        found = json.loads(said)
        assert code == 0 and found["mipmaps"] and found["shaded"]["psnr"]["rgb"] is None or found["shaded"]["psnr"]["rgb"] > 35
        assert {"normal", "roughness"} <= set(found["shaded"]["channels"]) and "shaded" in found["seconds"]
    lines = call("texf-eval", tmp_path / "a.glb", tmp_path / "a.texf", "--views", "1", "--size", "32", "--shaded", "--no-3d")[1]
    assert all(word in lines for word in ("shaded PSNR: RGB", "roughness: ", "shading normals: median", "without normal maps"))
    sizes = [call("texf-render", tmp_path / "a.texf", tmp_path / f"{len(flag)}.png", "--size", "64", "--json", *flag)
             for flag in ((), ("--shaded",))]
    assert [json.loads(said)["shaded"] for _, said, _ in sizes] == [False, True]


def test_maps_that_another_thread_has_made_meanwhile_stay(monkeypatch):
    """They were replaced by others whose levels nobody had built: a KeyError in a shaded comparison, now and then."""
    plain, meanwhile = lit_scene.Textures, []
    maps = lit_scene.SceneMaps(painted_sphere(), mipmaps=True)

    def late(*words):
        made = plain(*words)
        if not meanwhile:
            meanwhile.append(None)
            meanwhile.append(maps._of("normal"))
        return made

    monkeypatch.setattr(lit_scene, "Textures", late)
    assert maps._of("normal") is meanwhile[1] is maps._of("normal")
