"""tools/bench/materials.py: what its rival codes of normals, TANGENTs and maps, how both are looked at, and the table."""

import json
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import DracoPy
import numpy as np
import pytest
from shapes import sphere

from texfcodec.api import decode, encode_to_result
from texfcodec.geometry.tangents import corner_tangents
from texfcodec.metrics.views import Look, compare_views
from texfcodec.options import EncodeOptions
from texfcodec.render.environment import DAYLIGHT
from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench import material_rivals, materials
from tools.bench.everyday_rivals import (
    TANGENT_ID,
    CornerFrames,
    dequantise_tangent,
    enc_mesh,
    octahedral,
    quantise_tangent,
    quantise_uv,
    rival_of,
)
from tools.bench.material_views import LitViews


def bumpy_sphere(hand=1):
    """Sphere under a normal map of noise, smooth, with the TANGENTs of its UVs, or those of another hand."""
    positions, faces = sphere(16)
    uv = (positions[:, :2] * 0.4 + 0.5)[faces]
    rng = np.random.default_rng(0)
    colour, bumps = (np.dstack([rng.integers(90, 166, (32, 32, 2)), np.full((32, 32, 2), 255)]).astype(np.uint8)
                     for _ in range(2))
    scene = Scene(positions, faces, np.zeros(len(faces), np.int64), uv, None, [Material("skin", texture=0, maps={"normal": 1})],
                  [Texture(colour), Texture(bumps)])
    scene.corner_normal = positions[faces].astype(np.float32)
    scene.corner_tangent = corner_tangents(positions, faces, uv, scene.corner_normal) * np.float32([1, 1, 1, hand])
    return scene


@pytest.fixture
def looked(monkeypatch, tmp_path):
    """Function Scene -> how materials.py looks at it, small."""
    def look(scene, size=64):
        monkeypatch.setattr(materials, "load", lambda path: scene)
        monkeypatch.setattr(materials, "VIEWS", 2)
        monkeypatch.setattr(materials, "SIZE", size)
        return materials._Looked(tmp_path / "ball.glb", 1, True)
    return look


@pytest.mark.parametrize("bits", material_rivals.NORMAL_BITS)
def test_draco_gives_normals_and_tangents_back_as_they_were_rounded(bits):
    rival = rival_of(bumpy_sphere())
    scene, faces = rival.scene, rival.scene.faces
    normal, steps = octahedral(scene.corner_normal, bits), quantise_tangent(scene.corner_tangent, bits)
    assert (normal * scene.corner_normal).sum(axis=2).min() > np.cos(np.radians(4 * 90 / (1 << bits)))
    mesh = DracoPy.decode(enc_mesh(rival.lattice, faces, quantise_uv(rival, 12), 12, None, CornerFrames(normal, bits, steps)))
    tangent = next(a["data"] for a in mesh.attributes if a["unique_id"] == TANGENT_ID)
    got = [np.asarray(values)[np.asarray(mesh.faces)] for values in (mesh.points, mesh.normals, tangent)]
    rows = [np.unique(np.concatenate(corners, axis=2).reshape(-1, 10).round(6), axis=0)
            for corners in (got, (rival.lattice[faces], normal, steps))]
    np.testing.assert_array_equal(*rows)
    back = dequantise_tangent(steps, bits)
    assert np.abs(back - scene.corner_tangent).max() < 3 / (1 << bits) and set(np.unique(back[..., 3])) <= {-1, 0, 1}


def test_every_attribute_is_paid_for_and_finer_ones_look_better(looked):
    look = looked(bumpy_sphere())
    meshes = material_rivals.lit_meshes(rival_of(look.scene), look.needed.materials)
    bits = {tuple(m.bits.get(f"{part}_bits") for part in ("uv", "normal", "tangent")) for m in meshes}
    assert bits == set(product((12, 14, 16), (8, 10), (None, 8, 10))) and len(bits) == len(meshes)
    assert all(min(m.bytes.values()) > 0 and m.size == sum(m.bytes.values()) for m in meshes)
    kept, told = material_rivals.worth_looking(look, meshes)
    assert len(told) == len(meshes) and len(kept) < len(meshes)
    quality = [look.psnr(mesh.scene)["psnr_y"] for mesh in kept]
    assert quality == sorted(quality) and [m.size for m in kept] == sorted(m.size for m in kept)


@pytest.mark.parametrize(("hand", "is_turned"), [(1, False), (-1, True)])
def test_maps_that_tangents_turn_over_are_turned_back_and_look_the_same(looked, hand, is_turned):
    look = looked(bumpy_sphere(hand))
    scene = material_rivals.upright(look)
    assert (scene is look.scene) != is_turned
    assert look.psnr(replace(scene, corner_tangent=None))["psnr_y"] in (None, pytest.approx(90, abs=40))


def test_pictures_are_those_of_compare_views(looked):
    scene = bumpy_sphere()
    other = replace(scene, textures=[replace(t, image=t.image ^ np.uint8([8, 8, 8, 0])) for t in scene.textures])
    want = compare_views(scene, other, 2, 64, look=Look(environment=DAYLIGHT))["psnr"]
    got = LitViews(scene, 2, 64).psnr(other)
    assert got == {"psnr": pytest.approx(want["rgb"], abs=1e-6), "psnr_y": pytest.approx(want["y"], abs=1e-6)}


def test_alpha_that_is_data_comes_back_and_weighs_nothing():
    image = np.full((32, 32, 4), (200, 100, 50, 0), np.uint8)
    image[:, 16:, 3] = 255
    look = SimpleNamespace(scene=SimpleNamespace(textures=[Texture(image)]), threads=1,
                           maps=lambda: [(0, "sheen_colour", 0), (0, "sheen_roughness", 0)])
    for scale in (1, 2):
        decoded, size, _ = material_rivals.coded_avif(look, 0, scale, 90)
        away = np.abs(decoded.astype(int) - image)
        assert away[:, :, :3].max() < 6 and away[:, [*range(12), *range(20, 32)]].max() < 12 and size > 0


def test_a_record_has_every_mesh_with_every_coding(looked, monkeypatch, capsys):
    monkeypatch.setattr(material_rivals, "SCALES", {1: (30, 90)})
    record = material_rivals.rival_record(looked(bumpy_sphere()))
    assert {p["quality"] for p in record["points"]} == {30, 90} and len(record["maps"]["normal"]) == 2
    bits = ("uv_bits", "normal_bits", "tangent_bits")
    for point in record["points"]:
        mesh = next(m for m in record["meshes"] if all(point.get(k) == m.get(k) for k in bits))
        assert point["total"] == mesh["total"] + point["map_bytes"] and mesh["bytes"]["positions"] == record["positions"]


def test_two_fields_of_one_material_are_both_in_its_images(looked):
    """The columns of the only field are shared out among two: the image is the same but along the border."""
    ours = looked(bumpy_sphere())
    texf = decode(encode_to_result(bumpy_sphere(), EncodeOptions(qp=40, support="texels")).data)
    (whole,), images = texf.fields, materials._our_images(ours, texf)
    parts = SimpleNamespace(fields=[], face_field=np.arange(len(texf.faces)) % 2, face_material=texf.face_material)
    for mine in (0, 1):
        half = replace(whole.support)
        half.rank = whole.support.rank.copy()
        half.rank[:, np.arange(half.rank.shape[1]) * 2 // half.rank.shape[1] != mine] = -1
        parts.fields.append(replace(whole, support=half))
    both, source = materials._our_images(ours, parts), ours.scene.textures[0].image
    assert (images[0, "base_colour"] != source).any(axis=2).mean() > 0.5
    assert (both[0, "base_colour"] == images[0, "base_colour"]).all(axis=2).mean() > 0.9


def test_the_table_says_percent_of_all_bytes_and_without_positions(tmp_path):
    def write(name, kind, **record):
        (tmp_path / f"{name}.{kind}.json").write_text(json.dumps({"asset": name, "maps": {}} | record))

    points = [{"total": 1000 + 1000 * 2**i, "psnr_y": 30.0 + i} for i in range(4)] + [{"total": 10**6, "psnr_y": None}]
    write("ball", "rivals", positions=1000, points=points, maps={"normal": [{"bytes": 2**i, "normal": 30 + i} for i in range(4)]})
    half = [p | {"total": p["total"] / 2} for p in points]
    write("ball", "ours", positions=500, points=half, maps={"normal": [{"bytes": 3 * 2**i, "normal": 30 + i} for i in range(4)]})
    for kind in ("ours", "rivals"):
        write("old", kind, points=[{"total": 1, "psnr": 30}])
    table = "\n".join(materials.compared(tmp_path))
    assert "| ball | **lit, all bytes** | 50 % |" in table and "| ball | **lit, without positions** | 50 % |" in table
    assert "| ball | normal (normal) | 300 % |" in table and "| old | **lit, all bytes** | a record is older" in table
    assert "| **all 1** | **lit, all bytes** | mean 50 %, at most 50 % |" in table


def test_the_envelope_is_the_hull_and_passes_by_what_does_not_pay():
    line = [(100 * 2**i, 30.0 + i) for i in range(4)]
    off = [(110, 30.01), (390, 31.1), (100, 29.0), (800, 33.0)]
    assert materials._envelope(line + off) == line
    assert materials._percent([{"bytes": b, "y": y} for b, y in line + off], [{"bytes": b, "y": y} for b, y in line],
                              ["y"]) == pytest.approx(100)
