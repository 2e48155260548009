"""Draco meshes as rivals have them: what stands at corners comes back as it was rounded, and every attribute is paid for."""

import json
from dataclasses import replace

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere, sphere

from texfcodec.geometry.tangents import corner_tangents
from texfcodec.metrics.views import ViewSettings, compare_views
from texfcodec.render.environment import DAYLIGHT
from texfcodec.report import Report
from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench.methods import draco_mesh, find
from tools.bench.methods.draco_mesh import dec_mesh, enc_mesh, quantise_uv, rival_of


def textured_sphere(images=1, spread=1.0):
    """Sphere of rows with a material each of `images` distinct pictures, UVs over `spread` and off zero."""
    positions, faces = sphere(6)
    rng = np.random.default_rng(2)
    wave = 128 + 90 * np.sin(np.mgrid[:32, :48].sum(axis=0)[..., None] / (3.0, 5.0, 7.0, 9.0))
    textures = [Texture(np.clip(wave + 20 * n, 0, 255).astype(np.uint8)) for n in range(images)]
    uv = spread * (rng.random((len(positions), 2)) - 0.3)[faces]
    materials = [Material(f"m{n}", texture=n) for n in range(images)]
    return Scene(positions, faces, np.arange(len(faces)) % images, uv, None, materials, textures)


def bumpy_sphere(hand=1):
    """Sphere under a normal map of noise, smooth, with the TANGENTs of its UVs, or those of another hand."""
    positions, faces = sphere(16)
    uv = (positions[:, :2] * 0.4 + 0.5)[faces]
    rng = np.random.default_rng(0)
    colour, bumps = (np.dstack([rng.integers(90, 166, (32, 32, 2)), np.full((32, 32, 2), 255)]).astype(np.uint8)
                     for _ in range(2))
    scene = Scene(positions, faces, np.zeros(len(faces), np.int64), uv, None,
                  [Material("skin", texture=0, maps={"normal": 1, "roughness": 0})], [Texture(colour), Texture(bumps)])
    scene.corner_normal = positions[faces].astype(np.float32)
    scene.corner_tangent = corner_tangents(positions, faces, uv, scene.corner_normal) * np.float32([1, 1, 1, hand])
    return scene


def rows(*parts):
    """Corners of faces, each once, in order."""
    return np.unique(np.concatenate(parts, axis=2).reshape(-1, sum(p.shape[2] for p in parts)).round(6), axis=0)


@pytest.mark.parametrize("bits", [10, 14])
@pytest.mark.parametrize("scene", [textured_sphere(), textured_sphere(3, 40.0), textured_sphere(spread=0.0)])
def test_draco_gives_every_uv_back_as_the_integer_it_was(scene, bits):
    rival = rival_of(scene)
    uv, faces = quantise_uv(rival, bits), rival.scene.faces
    assert uv.min() == 0 and uv.max() == ((1 << bits) - 1) * bool(np.ptp(scene.corner_uv))
    back = dec_mesh(enc_mesh(rival.lattice, faces, {"uv": uv}, {"uv": bits}))
    np.testing.assert_array_equal(rows(back["vertex"], back["uv"]), rows(rival.lattice[faces], uv))
    low, side = draco_mesh.uv_boxes(rival)
    shown = low[rival.scene.face_material][:, None] + uv / ((1 << bits) - 1) * side[rival.scene.face_material][:, None, None]
    assert np.abs(shown - rival.scene.corner_uv).max() <= 0.5001 * side.max() / ((1 << bits) - 1)


@pytest.mark.parametrize("bits", [8, 10])
def test_draco_gives_normals_and_tangents_back_as_they_were_rounded(bits):
    rival = rival_of(bumpy_sphere())
    scene, faces = rival.scene, rival.scene.faces
    normal, steps = draco_mesh.octahedral(scene.corner_normal, bits), draco_mesh.quantise_tangent(scene.corner_tangent, bits)
    assert (normal * scene.corner_normal).sum(axis=2).min() > np.cos(np.radians(4 * 90 / (1 << bits)))
    parts = {"uv": quantise_uv(rival, 12), "normal": normal, "tangent": steps}
    back = dec_mesh(enc_mesh(rival.lattice, faces, parts, {"uv": 12, "normal": bits}))
    np.testing.assert_array_equal(rows(*(back[name] for name in ("vertex", "normal", "tangent"))),
                                  rows(rival.lattice[faces], normal, steps))
    again = draco_mesh.dequantise_tangent(steps, bits)
    assert np.abs(again - scene.corner_tangent).max() < 3 / (1 << bits) and set(np.unique(again[..., 3])) <= {-1, 0, 1}


@pytest.mark.parametrize("bits", [8, 12])  # Draco's own colours hold bytes; above that a generic attribute
def test_draco_carries_wide_and_narrow_colours_exactly(bits):
    rival = rival_of(painted_sphere())
    colour = draco_mesh.quantise_colour(rival, bits)
    back = dec_mesh(enc_mesh(rival.lattice, rival.scene.faces, {"colour": colour}))
    assert back["colour"].shape[2] == 3  # alpha is there, but the material is opaque
    np.testing.assert_array_equal(rows(back["vertex"], back["colour"]), rows(rival.lattice[rival.scene.faces], colour[..., :3]))


def test_equal_images_count_once_and_alpha_where_it_shows():
    scene = textured_sphere(3)
    scene.textures[1] = Texture(scene.textures[0].image.copy())
    scene.textures.append(Texture(np.zeros((8, 8, 4), np.uint8)))
    rival = rival_of(scene)
    assert rival.content[0] == rival.content[1] != rival.content[2] and rival.content[3] is None and len(rival.images) == 2
    assert set(map(frozenset, rival.columns.values())) == {frozenset({0, 1, 2})}
    assert [3 in columns for columns in rival_of(crossing_sheets()).columns.values()] == [True]


@pytest.mark.parametrize(("hand", "is_turned"), [(1, False), (-1, True)])
def test_maps_that_tangents_turn_over_are_turned_back_and_look_the_same(hand, is_turned):
    scene = bumpy_sphere(hand)
    turned = draco_mesh.upright(scene)
    assert (turned is scene) != is_turned
    lit = ViewSettings(environment=DAYLIGHT)
    psnr = compare_views(scene, replace(turned, corner_tangent=None), 2, 64, settings=lit)["psnr"]["y"]
    assert psnr is None or psnr > 50


def coded(scene, folder, **options):
    """(facts, decoded Scene, PSNR of Y in light) of the method uv."""
    folder.mkdir()
    options = {"codec": "jpeg", "quality": 90, "chroma": "best", "maps": "all", "uv_bits": 12, **options}
    facts = json.loads(json.dumps(find("uv").encode(scene, options, folder, 1, Report())))
    decoded = find("uv").decode(folder, options, 1, Report())
    return facts, decoded, compare_views(scene, decoded, 2, 64, settings=ViewSettings(environment=DAYLIGHT))["psnr"]["y"]


def test_every_attribute_is_paid_for_and_finer_ones_look_better(tmp_path):
    scene, found = bumpy_sphere(), {}
    for bits in ((0, 0), (8, 0), (8, 8), (10, 10)):
        facts, decoded, psnr = coded(scene, tmp_path / f"{bits}", normal_bits=bits[0], tangent_bits=bits[1])
        found[bits] = facts["bytes"]["uv"], psnr
        assert (decoded.corner_normal is None, decoded.corner_tangent is None) == (bits[0] == 0, bits[1] == 0)
        assert decoded.materials[0].maps == scene.materials[0].maps
    sizes = [size for size, _ in found.values()]
    assert sizes == sorted(set(sizes)) and found[8, 8][1] <= found[10, 10][1] + 0.3


def test_vertex_colours_are_coded_where_bits_are_asked_for(tmp_path):
    scene = painted_sphere()
    facts, decoded, psnr = coded(scene, tmp_path / "a", maps="none", colour_bits=8)
    assert facts["bytes"]["texture"] == 0 < facts["bytes"]["uv"] and facts["images"] == [] and psnr > 40
    few, _, worse = coded(scene, tmp_path / "b", maps="none", colour_bits=3)
    assert few["bytes"]["uv"] < facts["bytes"]["uv"] and worse < psnr


@pytest.mark.parametrize("name, value", [("maps", "some"), ("colour_bits", 13), ("normal_bits", True), ("tangent_bits", -1)])
def test_options_of_corners_out_of_range_are_refused(name, value):
    from tools.bench.methods.uv import checked

    with pytest.raises(ValueError, match=f"{name} must be"):
        checked({"codec": "jpeg", name: value})
