"""OBJ, PLY and NPZ out: light is written where the format has a place for it, and all the rest is named, one by one."""

import re

import numpy as np
import pytest
from analytic import decoded, sphere_mesh, two_materials
from shapes import mapped_sheet, plain_image
from test_materials_back import CLAMPED, EXACT, FACTORS, everything, waves

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.load import load
from texfcodec.io.save import save
from texfcodec.io.written_normals import face_areas
from texfcodec.options import EncodeOptions
from texfcodec.scene.factors import factor_of
from texfcodec.scene.fetch import values_of_map
from texfcodec.scene.scene import ALPHA_BLEND

IN_MTL = ("normal", "roughness", "metallic", "emissive")


def coded(scene, **options):
    return decode(encode_scene(scene, EncodeOptions(**(options or EXACT))).data)


def lost(scene):
    """What a reader left out, but for statements of an older model of light, which no writer leaves away."""
    return [name for name in scene.dropped if name.split(" of ")[0] not in ("Ka", "Ks", "illum")]


def entry_of(path):
    """Statements of the first material of an MTL file, {word: rest}."""
    block = path.read_text("utf-8").split("newmtl ")[1]
    return dict(line.split(None, 1) for line in block.splitlines()[1:] if " " in line)


@pytest.fixture(scope="module")
def rich():
    """Decoded, with a map of every channel and a value of every parameter."""
    return coded(everything())


@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_an_obj_has_the_maps_and_factors_that_mtl_knows(tmp_path, support):
    maps = {name: waves(number) for number, name in enumerate(IN_MTL)}
    given = {"roughness": (0.75,), "emissive": (0.5, 0.25, 1.0), "emissive_strength": (3.0,)}
    texf = coded(mapped_sheet(maps, waves(9), wrap=CLAMPED, parameters=given),
                 **(EXACT if support == "texels" else {"support": "voxels", "resolution": 48, "qp": 16}))
    report = save(texf, tmp_path / "a.obj", texture_size=None if support == "texels" else 128)
    entry = entry_of(tmp_path / "a.mtl")
    assert {"map_Kd", "map_Ke", "map_Pr", "map_Pm", "norm", "map_Bump", "Kd", "Ke", "Pr", "Pm", "d"} <= entry.keys()
    assert report["dropped"] == [] and len({entry[key] for key in ("map_Kd", "map_Ke", "map_Pr", "map_Pm", "norm")}) == 5
    back = load(tmp_path / "a.obj", strict=True)
    (material,) = back.materials
    assert set(material.maps) == set(IN_MTL) and lost(back) == []
    for name, wanted in given.items():
        assert factor_of(material.parameters, name) == pytest.approx(wanted, rel=1e-5), name


def test_maps_of_an_obj_show_at_every_point_what_the_stream_shows(tmp_path):
    scene = mapped_sheet({name: waves(number) for number, name in enumerate(IN_MTL)}, waves(9), wrap=CLAMPED,
                         parameters={"emissive": (1.0,) * 3})
    save(coded(scene), tmp_path / "a.obj", texture_format="png")
    back = load(tmp_path / "a.obj")
    for name in IN_MTL:
        before, after = (values_of_map(name, s.textures[s.materials[0].maps[name]].image) for s in (scene, back))
        assert np.abs(before - after).max() <= 1, name


def test_grey_maps_of_an_obj_are_the_same_in_every_channel(tmp_path):
    from PIL import Image

    save(coded(mapped_sheet({"roughness": waves(1), "metallic": waves(2)}, waves(3))), tmp_path / "a.obj", texture_format="png")
    for statement in ("map_Pr", "map_Pm"):
        image = np.asarray(Image.open(tmp_path / entry_of(tmp_path / "a.mtl")[statement]))
        assert (image == image[..., :1]).all() and np.ptp(image) > 50


def test_colours_that_are_constant_are_kd_and_take_no_image(tmp_path):
    scene = mapped_sheet({"roughness": plain_image(51)}, plain_image(100, 150, 200), alpha_mode=ALPHA_BLEND)
    scene.materials[0].factor = np.array([1, 1, 1, 0.5])
    report = save(coded(scene), tmp_path / "a.obj")
    entry = entry_of(tmp_path / "a.mtl")
    assert report["files"] == ["a.mtl", "a.obj"] and "map_Kd" not in entry and float(entry["Pr"]) == pytest.approx(0.2, abs=1e-3)
    assert [float(v) * 255 for v in entry["Kd"].split()] == pytest.approx([100, 150, 200], abs=1)
    assert float(entry["d"]) == pytest.approx(0.5, abs=3e-3)
    assert load(tmp_path / "a.obj", strict=True).materials[0].alpha_mode == ALPHA_BLEND


def test_alpha_of_an_image_comes_back_from_an_obj(tmp_path):
    image = waves(3)
    save(coded(mapped_sheet({}, image, wrap=CLAMPED, alpha_mode=ALPHA_BLEND)), tmp_path / "a.obj", texture_format="png")
    back = load(tmp_path / "a.obj")
    assert back.materials[0].alpha_mode == ALPHA_BLEND and lost(back) == []
    assert np.abs(back.textures[back.materials[0].texture].image.astype(int) - image).max() <= 1


def test_normals_of_an_obj_are_those_of_the_stream(tmp_path):
    texf = decoded(*sphere_mesh(12))
    for appearance in ("texture", "vertex"):
        save(texf, tmp_path / "a.obj", appearance, overwrite=True)
        text = (tmp_path / "a.obj").read_text()
        normal = np.array(re.findall(r"^vn (\S+) (\S+) (\S+)$", text, re.M), float)
        corner = np.array(re.findall(r"^f " + " ".join([r"\d+/\d*/(\d+)"] * 3), text, re.M), int) - 1
        if appearance == "vertex":
            assert np.abs(normal[corner] - texf.shading_normals()).max() < 2e-4
        back = load(tmp_path / "a.obj").corner_normal
        assert back is not None and len(corner) == len(texf.faces) == len(back) and len(normal) < 2 * len(texf.faces)


def test_another_reader_finds_the_normals_of_an_obj(tmp_path):
    import trimesh

    texf = coded(mapped_sheet({}, waves(3), wrap=CLAMPED))
    save(texf, tmp_path / "a.obj")
    mesh = trimesh.load(tmp_path / "a.obj", process=False, maintain_order=True)
    assert "vertex_normals" in mesh._cache and mesh.visual.material.image is not None
    found = {tuple(row) for row in (np.round(mesh.vertex_normals, 2) + 0.0).tolist()}
    assert found == {tuple(row) for row in (np.round(texf.shading_normals().reshape(-1, 3).astype(float), 2) + 0.0).tolist()}


def test_what_an_obj_cannot_hold_is_named_effect_by_effect(rich, tmp_path):
    dropped = save(rich, tmp_path / "a.obj")["dropped"]
    wanted = ("double-sidedness", "occlusion map", "clearcoat", "clearcoat normal map", "sheen", "specular reflection",
              "transmission", "volume", "iridescence", "anisotropy", "diffuse transmission", "dispersion", "index of refraction")
    assert dropped == [f"{words} of material 'sheet'" for words in wanted]


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_a_plain_stream_loses_nothing_but_what_is_named(tmp_path, suffix):
    report = save(two_materials(decoded(*sphere_mesh(24))), tmp_path / f"a{suffix}", "vertex")
    assert report["dropped"][0] == "metadata"
    assert {name.split(" of ")[0] for name in report["dropped"][1:]} == {
        "unlit flag", "alpha mode MASK", "double-sidedness", "metalness"}


def test_a_ply_has_normals_where_a_vertex_has_one_and_names_hard_edges(tmp_path):
    import trimesh

    smooth = decoded(*sphere_mesh(16))
    assert "the shading of hard edges" not in save(smooth, tmp_path / "a.ply")["dropped"]
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    there = face_areas(smooth) > 0
    found = np.einsum("fck,fck->fc", mesh.vertex_normals[mesh.faces], smooth.shading_normals())[there]
    assert found.min() > 0.999
    cube = decoded(np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float), np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7],
         [1, 7, 3]]))
    assert "the shading of hard edges" in save(cube, tmp_path / "b.ply")["dropped"]
    assert b"property float nx" in (tmp_path / "a.ply").read_bytes()[:500]
    assert b"property float nx" not in (tmp_path / "b.ply").read_bytes()[:500]


def test_a_ply_names_images_whose_detail_vertices_do_not_show(tmp_path):
    texf = coded(mapped_sheet({"normal": waves(1)}))
    dropped = save(texf, tmp_path / "a.ply")["dropped"]
    assert any(re.match(r"the detail of images between vertices .* \d+\.\d dB", name) for name in dropped)
    assert "normal map of material 'sheet'" in dropped
    plain = coded(mapped_sheet({}, plain_image(9, 99, 200)))
    assert save(plain, tmp_path / "b.ply")["dropped"] == ["metalness of material 'sheet'"]


def test_an_npz_holds_every_channel_factor_and_normal(rich, tmp_path):
    import json

    assert save(rich, tmp_path / "a.npz")["dropped"] == []
    with np.load(tmp_path / "a.npz") as held:
        for name, plane in rich.fields[0].planes.items():
            if name not in ("base_colour", "alpha"):
                assert np.array_equal(held[f"field0_{name}"], plane)
                assert np.array_equal(held[f"field0_{name}_at"], rich.fields[0].support_of(name).xy())
        assert np.array_equal(held["corner_normal"], rich.shading_normals())
        (material,) = json.loads(str(held["materials"]))
    assert set(material["parameters"]) == set(FACTORS) and material["maps"] == sorted(rich.materials[0].maps)


def test_an_npz_of_colours_names_the_maps_that_it_leaves_out(tmp_path):
    dropped = save(coded(mapped_sheet({"roughness": waves(1)})), tmp_path / "a.npz", "vertex")["dropped"]
    assert dropped == ["the map of roughness", "shading normals"]


# Statements of other programs.


def read(folder, mtl, **images):
    """Scene of a square whose material is mtl. images: uint8 arrays by name without suffix."""
    from PIL import Image

    for name, image in images.items():
        Image.fromarray(image).save(folder / f"{name}.png")
    (folder / "a.mtl").write_text("newmtl m\n" + mtl)
    (folder / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\n"
                                  "f 1/1 2/2 3/3 4/4\n")
    return load(folder / "a.obj")


def test_pm_of_one_is_metal_and_none_is_not(tmp_path):
    assert factor_of(read(tmp_path, "Pm 1\nPr 0.25\n").materials[0].parameters, "metallic") == (1.0,)
    assert factor_of(read(tmp_path, "Pr 0.25\n").materials[0].parameters, "metallic") == (0.0,)


def test_a_bump_map_is_a_normal_map_where_it_holds_normals(tmp_path):
    normal = np.full((8, 8, 3), (128, 128, 255), np.uint8)
    normal[::2] = (170, 120, 230)
    scene = read(tmp_path, "map_Bump -bm 0.5 n.png\n", n=normal)
    assert lost(scene) == [] and scene.materials[0].maps.keys() == {"normal"}
    assert scene.materials[0].parameters["normal_scale"] == (0.5,)
    scene = read(tmp_path, "map_bump h.png\n", h=np.arange(64, dtype=np.uint8).reshape(8, 8))
    assert "map_bump of material 'm', a map of heights" in scene.dropped and "normal" not in scene.materials[0].maps


def test_a_black_ke_beside_its_map_means_the_map(tmp_path):
    scene = read(tmp_path, "Ke 0 0 0\nmap_Ke e.png\n", e=waves(1)[..., :3])
    assert scene.materials[0].parameters["emissive"] == (1.0,) * 3 and "Ke" not in str(scene.dropped)
    assert "emissive" not in read(tmp_path, "Ke 0 0 0\n").materials[0].parameters


def test_an_alpha_image_of_its_own_joins_that_of_the_colour(tmp_path):
    grey = np.tile(np.arange(0, 256, 16, dtype=np.uint8), (16, 1))
    scene = read(tmp_path, "map_Kd c.png\nmap_d d.png\n", c=waves(1, 8, 8)[..., :3], d=grey)
    (material,) = scene.materials
    assert material.alpha_mode == ALPHA_BLEND and np.array_equal(scene.textures[material.texture].image[..., 3], grey)


def test_an_alpha_image_without_one_of_colour_makes_white_that_blends(tmp_path):
    grey = np.tile(np.arange(0, 256, 16, dtype=np.uint8), (16, 1))
    (texture,) = read(tmp_path, "map_d d.png\n", d=grey).textures
    assert (texture.image[..., :3] == 255).all() and np.array_equal(texture.image[..., 3], grey)


def test_a_roughness_of_0_beside_its_map_means_the_map_and_a_map_at_another_place_is_named(tmp_path):
    scene = read(tmp_path, "map_Kd c.png\nPr 0\nmap_Pr -s 2 2 r.png\n", c=waves(1)[..., :3], r=waves(2)[..., :3])
    assert factor_of(scene.materials[0].parameters, "roughness") == (1.0,) and "roughness" in scene.materials[0].maps
    assert scene.dropped == ["-s, -o or -clamp of map_Pr of material 'm', which differ from those of its first image"]


def test_a_dry_run_says_what_becomes_of_each_map(call, tmp_path):
    read(tmp_path, "map_Pr r.png\n", r=waves(2)[..., :3])
    assert "\n  roughness: " in call("texf-enc", tmp_path / "a.obj", "--dry-run")[1]


def test_an_image_of_squares_is_named_by_an_obj(tmp_path):
    scene = mapped_sheet({}, waves(3))
    scene.textures[0].nearest = True
    assert "OBJ cannot hold how an image is filtered: texels of a.png, which are squares, are blended" in save(
        coded(scene), tmp_path / "a.obj")["warnings"]


def test_a_map_that_is_missing_is_named(tmp_path):
    scene = read(tmp_path, "map_Pr gone.png\n")
    assert any("gone.png" in text for text in scene.warnings) and not scene.materials[0].maps


def test_values_of_light_survive_a_second_way_through_an_obj(tmp_path):
    scene = mapped_sheet({"roughness": waves(1), "metallic": waves(2)}, waves(3), wrap=CLAMPED)
    save(coded(scene), tmp_path / "a.obj", texture_format="png")
    again = load(tmp_path / "a.obj")
    save(coded(again), tmp_path / "b.obj", texture_format="png")
    last = load(tmp_path / "b.obj")
    for name in ("roughness", "metallic"):
        one, two = (scene.textures[scene.materials[0].maps[name]].image.astype(int) for scene in (again, last))
        assert np.abs(one - two).max() <= 1, name
