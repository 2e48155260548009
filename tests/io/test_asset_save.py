"""Atlas, bake and save: any mesh gets an atlas, baked colours survive bilinear lookups, files are whole, valid and exact."""

import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from analytic import decoded, grid_mesh, soup_mesh, sphere_mesh, surface_samples, two_materials
from mesh_files import accessor, read_glb

from texfcodec.errors import InputError
from texfcodec.io import save as save_room
from texfcodec.io.atlas import unwrap as atlas_room
from texfcodec.io.atlas.bake import bake
from texfcodec.io.atlas.gaps import fill_gaps
from texfcodec.io.atlas.system import cover
from texfcodec.io.atlas.unwrap import make_atlas
from texfcodec.io.save import save
from texfcodec.io.vertex_appearance import linear_u16
from texfcodec.scene.scene import ALPHA_MASK, Material

ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets"


# Meshes and a stand-in for a decoded stream whose field is an analytic colour.


def broken_mesh():
    """Duplicate, flipped, degenerate and non-manifold faces, slivers, and points far apart."""
    points, faces = grid_mesh(8, 0.3)
    odd = np.array([[0, 0, 1], [2, 2, 2], [0, 1, 2], [0, 7, 63], [0, 7, 40], [0, 7, 33], [0, 63, 1]])
    return points, np.vstack([faces, faces[:5], faces[:5, ::-1], odd])


def empty_mesh():
    return np.zeros((0, 3)), np.zeros((0, 3), np.int64)


MESHES = {
    "triangle": lambda: (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])),
    "sheet": lambda: grid_mesh(24, 0.3),
    "sphere": sphere_mesh,
    "broken": broken_mesh,
    "soup": soup_mesh,
    "needle": lambda: (np.array([[0.0, 0, 0], [1, 1e-7, 0], [0.5, 1e-7, 1e-9]]), np.array([[0, 1, 2]])),
    "point": lambda: (np.ones((3, 3)), np.array([[0, 1, 2], [2, 1, 0]])),
}


def bilinear(image, uv):
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - top)[:, None]

    def texel(dx, dy):
        return image[np.clip(top + dy, 0, height - 1), np.clip(left + dx, 0, width - 1)].astype(float)

    return (texel(0, 0) * (1 - fx) + texel(1, 0) * fx) * (1 - fy) + (texel(0, 1) * (1 - fx) + texel(1, 1) * fx) * fy


def colour_error(texf, baked, **kind):
    points, uv, face = surface_samples(texf, baked.atlas.corner_uv, **kind)
    return np.abs(bilinear(baked.image, uv) - texf.query(points, face)).max(1)


# Atlas.


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("method", ["fast", "quality"])
def test_every_mesh_gets_an_atlas_inside_the_square(name, method):
    positions, faces = MESHES[name]()
    atlas = make_atlas(positions, faces, 256, method)
    assert atlas.corner_uv.shape == (len(faces), 3, 2) and atlas.corner_uv.dtype == np.float64
    assert (atlas.corner_uv >= 0).all() and (atlas.corner_uv <= 1).all()
    assert atlas.width == atlas.height and (atlas.width == 256 or atlas.warnings)
    assert atlas.method == method or atlas.warnings


def test_empty_mesh_gets_an_empty_atlas():
    atlas = make_atlas(*empty_mesh())
    assert atlas.corner_uv.shape == (0, 3, 2) and atlas.width == atlas_room.MIN_SIZE


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e7, 1e30, 1e307])
def test_atlas_does_not_depend_on_the_unit(scale):
    positions, faces = grid_mesh(12, 0.3)
    here, there = make_atlas(positions, faces, 256, "fast"), make_atlas(positions * scale, faces, 256, "fast")
    assert np.abs(here.corner_uv - there.corner_uv).max() < 0.01 or here.utilisation == pytest.approx(there.utilisation, rel=0.05)


@pytest.mark.parametrize("name", ["sphere", "broken", "soup"])
def test_fast_charts_share_no_texel_and_no_bilinear_neighbour(name):
    """Paint every face's widened footprint with its 3D position: two faces may meet in a texel only where their surfaces meet."""
    positions, faces = MESHES[name]()
    atlas = make_atlas(positions, faces, 512, "fast")
    texf = decoded(positions, faces, resolution=512)
    owner = cover(np.ascontiguousarray(atlas.corner_uv * atlas.width), atlas.width, atlas.height)
    points, uv, face = surface_samples(texf, atlas.corner_uv, on_edges=True)
    column, row = np.floor(uv[:, 0] * atlas.width - 0.5).astype(int), np.floor(uv[:, 1] * atlas.height - 0.5).astype(int)
    density = np.sqrt(atlas.utilisation) * atlas.width / np.sqrt(surface(texf))
    center = texf.positions[faces].mean(1)
    reach = np.abs(texf.positions[faces] - center[:, None]).max((1, 2))
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        shown = owner[np.clip(row + dy, 0, atlas.height - 1), np.clip(column + dx, 0, atlas.width - 1)]
        assert (shown >= 0).all()
        gap = np.linalg.norm(center[shown] - points, axis=1) - 2 * reach[shown]
        assert gap.max() * density < 8, "a bilinear lookup meets a face far away"


def surface(texf):
    corner = texf.positions[texf.faces]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum() / 2


def test_groups_never_share_a_chart():
    positions, faces = grid_mesh(9)
    groups = (np.arange(len(faces)) % 2).astype(np.int64)
    atlas = make_atlas(positions, faces, 256, "fast", groups=groups)
    owner = cover(np.ascontiguousarray(atlas.corner_uv * 256), 256, 256)
    beside = (owner[:, 1:] >= 0) & (owner[:, :-1] >= 0)
    inside_one_group = groups[owner[:, 1:]] == groups[owner[:, :-1]]
    assert (beside & ~inside_one_group).sum() < 0.2 * beside.sum()  # rings touch, faces do not
    assert atlas.utilisation < make_atlas(positions, faces, 256, "fast").utilisation


def test_small_texture_grows_until_all_pieces_fit():
    positions, faces = soup_mesh(20000)
    atlas = make_atlas(positions, faces, 128, "fast")
    assert atlas.width > 128 and len(atlas.warnings) == 1


@pytest.mark.parametrize("program", ["import os; os.abort()", "pass", "print('noise')", "import time; time.sleep(9)"])
def test_auto_falls_back_to_fast_with_a_warning(monkeypatch, program):
    monkeypatch.setattr("texfcodec.io.atlas.quality._CHILD", program)
    monkeypatch.setitem(atlas_room._QUALITY_SECONDS, "auto", 0.5)
    atlas = make_atlas(*grid_mesh(6), 256, "auto")
    assert atlas.method == "fast" and "fast" in atlas.warnings[0]


@pytest.mark.parametrize("arguments", [{"method": "best"}, {"texture_size": 3}, {"texture_size": 1 << 20}])
def test_unknown_atlas_arguments_are_refused(arguments):
    with pytest.raises(InputError, match="TXF-O10"):
        make_atlas(*grid_mesh(4), **arguments)


@pytest.mark.parametrize("spoil", [lambda p, f: f.__setitem__((0, 0), 99999), lambda p, f: p.__setitem__((0, 0), np.nan)])
def test_unusable_meshes_are_refused(spoil):
    positions, faces = grid_mesh(4)
    spoil(positions, faces)
    with pytest.raises(InputError, match="TXF-O11"):
        make_atlas(positions, faces)


def test_default_size_follows_the_voxel_density():
    positions, faces = grid_mesh(6)
    sizes = [make_atlas(positions, faces, method="fast", resolution=k).width for k in (16, 400, 1024, 1 << 14)]
    assert sizes == [256, 512, 2048, 4096]


# Bake.


@pytest.mark.parametrize("name", ["triangle", "sheet", "sphere", "broken"])
@pytest.mark.parametrize("method", ["fast", "quality"])
def test_bilinear_lookups_give_the_field_back_even_at_seams(name, method):
    texf = decoded(*MESHES[name]())
    baked = bake(texf, 512, method)
    assert np.percentile(colour_error(texf, baked), 99) < 2.5
    assert colour_error(texf, baked, on_edges=True).max() < 12  # the field changes by up to 6 per texel at this size


def test_soup_is_baked_without_bleeding():
    texf = decoded(*soup_mesh())
    baked = bake(texf, 1024, "fast")
    assert colour_error(texf, baked, on_edges=True).max() < 10


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_extreme_units_bake_like_ordinary_ones(scale):
    positions, faces = grid_mesh(12, 0.3)
    texf = decoded(positions * scale, faces)
    assert colour_error(texf, bake(texf, 256, "fast"), on_edges=True).max() < 12


def test_cover_agrees_with_brute_force():
    rng = np.random.default_rng(2)
    texels = np.vstack([rng.random((6, 3, 2)) * 30 + 1, np.full((1, 3, 2), 20.25), [[[3, 3], [29, 3], [16, 3]]]])
    owner = cover(np.ascontiguousarray(texels), 32, 32)
    for row in range(32):
        for col in range(32):
            gaps = [square_gap(texels[f], col + 0.5, row + 0.5) for f in range(len(texels))]
            if abs(min(gaps) - 1.0) > 0.05:  # sampling cannot decide the rim itself
                assert (owner[row, col] >= 0) == (min(gaps) < 1.0)
            if owner[row, col] >= 0:
                assert gaps[owner[row, col]] <= 1.05
                assert min(gaps) > 0 or gaps[owner[row, col]] == 0


def square_gap(triangle, x, y, steps=400):
    """Chebyshev distance from a point to a triangle, by dense sampling of its edges and an inside test."""
    a, b, c = triangle
    sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
    if all(s > 0 for s in sides) or all(s < 0 for s in sides):
        return 0.0
    t = np.linspace(0, 1, steps)[:, None]
    rim = np.vstack([p + t * (q - p) for p, q in ((a, b), (b, c), (c, a))])
    return np.abs(rim - [x, y]).max(1).min()


def test_gaps_are_filled_with_what_mip_levels_average():
    image = np.zeros((8, 8, 1), np.uint8)
    known = np.zeros((8, 8), bool)
    image[0, 0], image[1, 1], image[5, 6] = 100, 50, 200
    known[0, 0] = known[1, 1] = known[5, 6] = True
    fill_gaps(image, known)
    assert image[0, 1] == 75 and image[4, 7] == 200 and image[3, 3] == 75 and (image > 0).all()
    assert (image[0, 0], image[1, 1], image[5, 6]) == (100, 50, 200)


def test_colour_under_invisible_texels_comes_from_visible_ones():
    texf = decoded(*grid_mesh(6), has_alpha=True, materials=[Material("leaf", alpha_mode=ALPHA_MASK)])
    texf.query = lambda p, f: np.where(p[:, :1] < 0.5, [[0, 0, 0, 0]], [[10, 200, 30, 255]]).astype(np.float32)
    image = bake(texf, 256, "fast").image
    assert {0, 255} <= set(np.unique(image[..., 3])) and (image[..., :3] == [10, 200, 30]).all()


def test_atlas_of_another_mesh_is_refused():
    atlas = make_atlas(*grid_mesh(4), 64, "fast")
    with pytest.raises(InputError, match="TXF-O10"):
        bake(decoded(*grid_mesh(6)), atlas=atlas)


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


@pytest.mark.parametrize("suffix", save_room.SUFFIXES)
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
    corners = np.array(re.findall(r"(\d+)/(\d+)", text), int) - 1
    order = np.argsort(texf.face_material, kind="stable")
    wanted = baked.atlas.corner_uv[order].reshape(-1, 2) * [1, -1] + [0, 1]
    assert np.abs(uv[corners[:, 1]] - wanted).max() < 1e-7 and np.array_equal(corners[:, 0], texf.faces[order].ravel())
    assert re.findall("usemtl (.*)", text) == re.findall("newmtl (.*)", entries)[:2] == ["0_a_b", "1_漢"]
    assert report["files"] == ["my_mesh.png", "my_mesh.mtl", "my mesh.obj"] and len(report["warnings"]) == 2


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
    assert [any(word in w for w in report["warnings"]) for word in ("no texture", "metadata", "alpha mode", "materials")] == [
        True
    ] * 4


# Files appear whole or not at all.


@pytest.mark.parametrize(("number", "code"), [(errno.ENOSPC, "TXF-O03"), (errno.EACCES, "TXF-O02"), (errno.EIO, "TXF-O04")])
def test_failed_writing_leaves_nothing_behind(tmp_path, monkeypatch, number, code):
    (tmp_path / "a.gltf").write_text("old")
    monkeypatch.setattr(save_room.os, "replace", lambda *_: (_ for _ in ()).throw(OSError(number, "no")))
    with pytest.raises(InputError, match=code):
        save(decoded(*grid_mesh(4)), tmp_path / "a.gltf", texture_size=64, atlas="fast")
    assert [p.name for p in tmp_path.iterdir()] == ["a.gltf"] and (tmp_path / "a.gltf").read_text() == "old"


def test_interrupted_writing_leaves_nothing_behind(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(save_room.np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save(decoded(*grid_mesh(4)), tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "options", "code"),
    [
        ("none/a.glb", {}, "TXF-O01"),
        ("a.fbx", {}, "TXF-O05"),
        ("a.glb", {"appearance": "shiny"}, "TXF-O06"),
        ("d.glb", {}, "TXF-O02"),
    ],
)
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


# Real meshes.


@pytest.mark.parametrize("name", ["hard_broken", "waterbottle_pbr"])
def test_real_meshes_bake_cleanly(name):
    path = ASSETS / f"{name}.glb"
    if not path.exists():
        pytest.skip("the shared assets are not here")
    import trimesh

    mesh = trimesh.load(path, process=False).to_geometry()
    positions, weld = np.unique(mesh.vertices, axis=0, return_inverse=True)
    texf = decoded(positions, weld.ravel()[mesh.faces])
    error = colour_error(texf, bake(texf, 1024, "fast"), on_edges=True)
    assert np.percentile(error, 99.9) < 2.5 and error.max() < 15
