"""Saving: files of every format are whole, valid and exact, or none at all."""

import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from analytic import bilinear, decoded, empty_mesh, grid_mesh, soup_mesh, sphere_mesh, surface, two_materials
from mesh_files import accessor, read_glb
from shapes import scene_of, square

from texfcodec import EncodeOptions, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError
from texfcodec.io import output_files, save_build
from texfcodec.io.atlas.bake import bake
from texfcodec.io.formats import SAVED_SUFFIXES
from texfcodec.io.output_files import as_input_error
from texfcodec.io.own_files import own_sides
from texfcodec.io.save import save
from texfcodec.io.vertex_appearance import linear_u16
from texfcodec.io.vertex_colour_fit import fit_vertex_colours
from texfcodec.scene.scene import Material

# GLB and glTF.


def test_glb_carries_mesh_image_and_materials(tmp_path):
    texf = two_materials(decoded(*grid_mesh(10, 0.3)))
    report = save(texf, tmp_path / "a.glb", texture_size=256, atlas="fast")
    document, binary = read_glb(tmp_path / "a.glb")
    assert report["warnings"] == [] and report["files"] == ["a.glb"] and len(report["seams"]["mean"]) == 5
    assert [m.get("alphaMode", "OPAQUE") for m in document["materials"]] == ["MASK", "OPAQUE", "BLEND"]
    assert document["materials"][0]["alphaCutoff"] == 0.25 and document["materials"][0]["doubleSided"]
    assert "KHR_materials_unlit" in document["materials"][1]["extensions"] and document["extensionsUsed"]
    assert document["asset"]["extras"]["texf"] == texf.metadata and len(document["images"]) == 1
    assert document["samplers"] == [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}]
    primitives = document["meshes"][0]["primitives"]
    assert [p["material"] for p in primitives] == [0, 1]
    found = [
        accessor(document, binary, p["attributes"]["POSITION"])[accessor(document, binary, p["indices"])[:, 0]]
        for p in primitives
    ]
    for number, corners in enumerate(found):
        wanted = texf.positions[texf.faces[texf.face_material == number]].reshape(-1, 3)
        assert np.abs(corners - wanted).max() <= texf.side / 16383 / 4


def test_glb_image_and_uv_give_the_colour_back(tmp_path):
    from PIL import Image

    texf = decoded(*grid_mesh(10, 0.3))
    save(texf, tmp_path / "a.glb", texture_size=512, atlas="fast")
    document, binary = read_glb(tmp_path / "a.glb")
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    (tmp_path / "a.png").write_bytes(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    image = np.asarray(Image.open(tmp_path / "a.png"))
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    points, uv = (accessor(document, binary, attributes[name]).astype(np.float64) for name in ("POSITION", "TEXCOORD_0"))
    assert image.shape == (512, 512, 3) and np.abs(bilinear(image, uv) - texf.query(points)[:, :3]).max() < 4


def test_glb_is_readable_by_trimesh(tmp_path):
    import trimesh

    texf = decoded(*sphere_mesh(12))
    save(texf, tmp_path / "a.glb", texture_size=256, atlas="fast")
    mesh = trimesh.load(tmp_path / "a.glb", process=False).to_geometry()
    assert len(mesh.faces) == len(texf.faces) and mesh.visual.uv.shape == (len(mesh.vertices), 2)
    assert mesh.area == pytest.approx(surface(texf), rel=1e-5)


@pytest.mark.parametrize("appearance", ["texture", "vertex", "voxels"])
@pytest.mark.parametrize(
    ("offset", "scale"), [(0.0, 1.0), (2.5e6, 300.0), (1e7, 1e-3), (0.0, 1e-30), (0.0, 1e30), (1e30, 1e22), (0.0, 1e300)]
)
def test_positions_keep_a_quarter_of_the_lattice(tmp_path, appearance, offset, scale):
    positions, faces = grid_mesh(6, 0.3)
    texf = decoded(positions * scale + offset, faces)
    report = save(texf, tmp_path / "a.glb", appearance, texture_size=64, atlas="fast")
    document, binary = read_glb(tmp_path / "a.glb")
    node = document["nodes"][0]
    local = accessor(document, binary, document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]).astype(np.float64)
    local *= node.get("scale", [1.0])[0]
    shift = np.array(node.get("translation", [0.0] * 3))
    wanted = (texf.positions if appearance != "voxels" else texf.voxels()["center"]) - shift
    assert (offset == 0 and scale == 1) == ("translation" not in node)
    assert bool(report["warnings"]) == (scale == 1e300)
    gap = np.abs(local[:, None] / texf.side - wanted[None] / texf.side).max(2).min(1)
    assert gap.max() <= 1 / 16383 / 4 + np.abs(texf.positions / texf.side).max() * 2**-52


def test_vertex_colours_are_linear_and_split_where_fields_meet(tmp_path):
    texf = decoded(*grid_mesh(5))
    texf.face_field = np.arange(len(texf.faces), dtype=np.int64) % 2
    texf.query = lambda points, face: np.repeat(np.where(texf.face_field[face] > 0, 188.0, 0.0)[:, None], 4, 1).astype(np.float32)
    save(texf, tmp_path / "a.glb", "vertex")
    document, binary = read_glb(tmp_path / "a.glb")
    primitive = document["meshes"][0]["primitives"][0]
    colour = accessor(document, binary, primitive["attributes"]["COLOR_0"])
    index = accessor(document, binary, primitive["indices"])[:, 0].reshape(-1, 3)
    assert colour.dtype == np.uint16 and document["accessors"][primitive["attributes"]["COLOR_0"]]["normalized"]
    assert (colour[index][1::2, :, 0] == pytest.approx(0.5029 * 65535, rel=1e-3)) and (colour[index][0::2] == 0).all()


@pytest.mark.parametrize("suffix", SAVED_SUFFIXES)
def test_arrays_of_all_units_are_joined_once_and_saving_leaves_them_as_they_are(tmp_path, suffix):
    texf = decode(Path(__file__).parents[2] / "conformance/uncommon/texels_mixed/in.texf")
    names = ("lattice_positions", "positions", "faces", "uv", "face_material", "face_field")
    before = {name: getattr(texf, name).copy() for name in names}
    save(texf, tmp_path / f"a{suffix}")
    assert len(texf.units) == 3 and all(getattr(texf, name) is getattr(texf, name) for name in names)
    assert all(np.array_equal(getattr(texf, name), before[name]) for name in names)


def test_linear_colours_agree_between_bytes_and_floats():
    rgba = np.arange(256, dtype=np.uint8).repeat(4).reshape(-1, 4)
    assert np.array_equal(linear_u16(rgba), linear_u16(rgba.astype(np.float32)))
    assert linear_u16(rgba)[[0, 255]].tolist() == [[0] * 4, [65535] * 4]


def test_indices_use_16_bits_only_below_the_restart_value(tmp_path):
    kinds = {}
    for count in (65535, 65538):
        texf = decoded(*soup_mesh(count // 3))
        save(texf, tmp_path / "a.glb", "vertex")
        document, _ = read_glb(tmp_path / "a.glb")
        kinds[count] = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"]
    assert kinds == {65535: 5123, 65538: 5125}


@pytest.mark.parametrize("suffix", SAVED_SUFFIXES)
@pytest.mark.parametrize("appearance", [None, "vertex", "voxels"])
def test_empty_mesh_becomes_a_whole_file(tmp_path, suffix, appearance):
    save(decoded(*empty_mesh()), tmp_path / f"a{suffix}", appearance)
    assert [p.name for p in tmp_path.iterdir()] == [f"a{suffix}"]
    if suffix == ".glb":
        document, binary = read_glb(tmp_path / "a.glb")
        assert "meshes" not in document and binary == b"" and document["scenes"] == [{"name": "texf"}]


def test_gltf_names_its_side_files_and_survives_odd_names(tmp_path):
    report = save(decoded(*grid_mesh(5)), tmp_path / "漢 #1.gltf", texture_size=64, atlas="fast")
    document = json.loads((tmp_path / "漢 #1.gltf").read_text("utf-8"))
    assert report["files"] == ["漢 #1.png", "漢 #1.bin", "漢 #1.gltf"]
    assert document["buffers"][0]["uri"] == "%E6%BC%A2%20%231.bin" and document["images"][0]["uri"].endswith("%231.png")
    assert document["buffers"][0]["byteLength"] == (tmp_path / "漢 #1.bin").stat().st_size


@pytest.mark.parametrize("copyright, written", [("© me", {"copyright": "© me"}), (["me"], {})])
def test_a_copyright_is_the_assets_where_it_is_text(tmp_path, copyright, written):
    save(decoded(*grid_mesh(4), metadata={"copyright": copyright}), tmp_path / "a.glb", "vertex")
    asset = read_glb(tmp_path / "a.glb")[0]["asset"]
    assert asset == {"version": "2.0", "generator": "texfcodec", "extras": {"texf": {"copyright": copyright}}} | written


def test_faces_without_area_have_no_colours_at_vertices():
    flat = decoded(np.eye(3), np.array([[0, 0, 1], [0, 1, 2]]))
    assert fit_vertex_colours(flat, np.array([0])) is None and fit_vertex_colours(flat, np.zeros(0, np.int64)) is None


def test_large_metadata_is_named_not_dropped_silently(tmp_path):
    report = save(decoded(*grid_mesh(4), metadata={"x": "y" * 70000}), tmp_path / "a.glb", "vertex")
    assert "metadata" in report["warnings"][0] and "extras" not in read_glb(tmp_path / "a.glb")[0]["asset"]


# PLY, OBJ, NPZ.


@pytest.mark.parametrize(("offset", "kind"), [(0.0, "float"), (2.5e6, "double")])
def test_ply_holds_colours_and_enough_digits(tmp_path, offset, kind):
    import trimesh

    texf = decoded(grid_mesh(6)[0] + offset, grid_mesh(6)[1])
    save(texf, tmp_path / "a.ply")
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    assert f"property {kind} x".encode() in (tmp_path / "a.ply").read_bytes()[:400]
    assert np.abs(mesh.vertices - texf.positions).max() <= texf.side / 16383 / 4 and np.array_equal(mesh.faces, texf.faces)
    assert np.abs(mesh.visual.vertex_colors[:, :3] - texf.query(texf.positions)[:, :3]).max() <= 0.5


def test_voxel_ply_has_one_record_per_voxel(tmp_path):
    texf = decoded(*grid_mesh(4), has_alpha=True)
    save(texf, tmp_path / "a.ply", "voxels")
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    records = np.frombuffer(body, [("p", "<f4", 3), ("c", "u1", 4)])
    assert b"element vertex 500\n" in header and b"property uchar alpha" in header
    assert np.array_equal(records["c"], texf.voxels()["rgba"]) and np.allclose(records["p"], texf.voxels()["center"])


def test_obj_points_upwards_and_names_its_materials(tmp_path):
    texf = two_materials(decoded(*grid_mesh(5)))
    report = save(texf, tmp_path / "my mesh.obj", texture_size=128, atlas="fast")
    text, entries = (tmp_path / "my mesh.obj").read_text(), (tmp_path / "my_mesh.mtl").read_text("utf-8")
    baked = bake(texf, 128, "fast")
    uv = np.array(re.findall(r"^vt (\S+) (\S+)$", text, re.M), float)
    corners = np.array(re.findall(r"(\d+)/(\d+)/\d+", text), int) - 1
    order = np.argsort(texf.face_material, kind="stable")
    wanted = baked.atlas.corner_uv[order].reshape(-1, 2) * [1, -1] + [0, 1]
    assert np.abs(uv[corners[:, 1]] - wanted).max() < 1e-7 and np.array_equal(corners[:, 0], texf.faces[order].ravel())
    assert re.findall("usemtl (.*)", text) == re.findall("newmtl (.*)", entries)[:2] == ["0_a_b", "1_漢"]
    assert report["files"] == ["my_mesh.png", "my_mesh.mtl", "my mesh.obj"]
    dropped = [name.split(" of ")[0] for name in report["dropped"]]
    assert dropped == ["metadata", "unlit flag", "alpha mode MASK", "double-sidedness"]


def test_obj_digits_hold_far_off_coordinates(tmp_path):
    texf = decoded(grid_mesh(5)[0] + 2.5e6, grid_mesh(5)[1])
    save(texf, tmp_path / "a.obj", "vertex")
    rows = np.array([line.split()[1:] for line in (tmp_path / "a.obj").read_text().splitlines() if line.startswith("v ")], float)
    assert rows.shape[1] == 6 and np.abs(rows[:, :3] - texf.positions).max() <= texf.side / 16383 / 4


def test_npz_holds_every_decoded_array(tmp_path):
    texf = two_materials(decoded(*grid_mesh(5)))
    save(texf, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        for name in ("lattice_positions", "faces", "face_material", "face_field", "origin", "side"):
            assert np.array_equal(arrays[name], getattr(texf, name))
        for name in ("xyz", "field", "rgba"):
            assert np.array_equal(arrays["voxel_" + name], texf.voxels()[name])
        assert json.loads(str(arrays["metadata"])) == texf.metadata and len(json.loads(str(arrays["materials"]))) == 3


def test_losses_of_simple_formats_are_named(tmp_path):
    report = save(two_materials(decoded(*grid_mesh(4))), tmp_path / "a.ply", "texture")
    words = ("without textures", "metadata", "alpha mode", "materials")
    assert [any(word in w for w in report["warnings"]) for word in words] == [
        True
    ] * 4


# Files appear whole or not at all.


@pytest.mark.parametrize(("number", "code"), [(errno.ENOSPC, "TXF-O03"), (errno.EACCES, "TXF-O02"), (errno.EIO, "TXF-O04")])
def test_failed_writing_leaves_nothing_behind(tmp_path, monkeypatch, number, code):
    (tmp_path / "a.gltf").write_text("old")
    monkeypatch.setattr(output_files.os, "replace", lambda *_: (_ for _ in ()).throw(OSError(number, "no")))
    with pytest.raises(InputError, match=code):
        save(decoded(*grid_mesh(4)), tmp_path / "a.gltf", texture_size=64, atlas="fast")
    assert [p.name for p in tmp_path.iterdir()] == ["a.gltf"] and (tmp_path / "a.gltf").read_text() == "old"


@pytest.mark.parametrize("number, code", [(errno.ENOENT, "TXF-O01"), (errno.ENOTDIR, "TXF-O01"), (errno.EROFS, "TXF-O02"),
                                          (errno.ENOSPC, "TXF-O03"), (errno.EIO, "TXF-O04")])
def test_an_output_that_fails_has_a_code(number, code):
    assert as_input_error(OSError(number, "no"), Path("folder/a.glb")).code == code


@pytest.mark.parametrize("obj, mtl, own", [
    ("# texfcodec\nmtllib a.mtl\n", "# texfcodec\nmap_Kd -clamp on a.png\nmap_d b.png\nmap_Kd ../c.png\n",
     {"a.mtl", "a.png", "b.png"}),
    ("# texfcodec\nmtllib a.mtl\n", "newmtl m\nmap_Kd a.png\n", set()), ("# texfcodec\nmtllib ./a.mtl\n", "# texfcodec\n", set()),
    ("# texfcodec\nv 0 0 0\n", "# texfcodec\n", set()), ("# another\nmtllib a.mtl\n", "# texfcodec\n", set()),
])
def test_the_files_of_an_obj_are_its_own_where_both_are_ours(tmp_path, obj, mtl, own):
    (tmp_path / "a.obj").write_text(obj)
    (tmp_path / "a.mtl").write_text(mtl)
    assert own_sides(tmp_path / "a.obj") == own


def test_interrupted_writing_leaves_nothing_behind(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(save_build.np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save(decoded(*grid_mesh(4)), tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "options", "code"), [
    ("none/a.glb", {}, "TXF-O01"), ("a.fbx", {}, "TXF-O05"), ("a.glb", {"appearance": "shiny"}, "TXF-O06"),
    ("d.glb", {}, "TXF-O02"),
])
def test_hopeless_requests_are_refused_before_any_work(tmp_path, name, options, code):
    (tmp_path / "d.glb").mkdir()
    texf = decoded(*grid_mesh(4), query=None)
    with pytest.raises(InputError, match=code):
        save(texf, tmp_path / name, **options)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="TXF-O02"):
        save(decoded(*grid_mesh(4)), tmp_path / "a.ply")


@pytest.fixture(scope="module")
def veil():
    """A decoded square of a material without a name that is see-through here and there."""
    positions, faces = square()
    colours = np.array([[0.5, 0.4, 0.3, 0.5], [0.5, 0.1, 0.3, 1.0], [0.1, 0.4, 0.3, 0.0], [0.9, 0.4, 0.3, 0.7]])
    scene = scene_of(positions, faces, colours, materials=[Material("", alpha_mode=2)])
    return decode(encode_scene(scene, EncodeOptions(resolution=8, qp=30)).data)


def test_vertex_colours_with_alpha_lose_it_in_an_obj(veil, tmp_path):
    assert any("no alpha" in text for text in veil.save(tmp_path / "a.obj", appearance="vertex")["warnings"])


def test_alpha_is_kept_by_a_texture_of_an_obj_and_by_points(veil, tmp_path):
    veil.save(tmp_path / "a.obj", texture_size=16)
    assert "map_d a" in (tmp_path / "a.mtl").read_text()
    veil.save(tmp_path / "a.gltf", appearance="voxels")
    (points,) = json.loads((tmp_path / "a.gltf").read_text())["materials"]
    assert points["alphaMode"] == "BLEND"
    veil.save(tmp_path / "b.gltf", texture_size=16, overwrite=True)
    (material,) = json.loads((tmp_path / "b.gltf").read_text())["materials"]
    assert "name" not in material and material["alphaMode"] == "BLEND"
