"""Texture formats and packed meshes: each reads back, is as small as it should be, and is refused where it makes no sense."""

import json

import numpy as np
import pytest
from analytic import decoded, grid_mesh, sphere_mesh, two_materials
from mesh_files import accessor, read_glb
from walls import coded, smooth_image, wall

from texfcodec.errors import InputError, SupportError
from texfcodec.io.formats import IMAGE_FORMATS
from texfcodec.io.images import check_image_format, encode_image, format_for
from texfcodec.io.load import load
from texfcodec.io.save import as_glb, save
from texfcodec.scene.scene import WRAP_REPEAT

PACKAGES = {"ktx2": ("alktx2", "opengl_basisu"), "meshopt": ("meshoptimizer",)}
EXTENSIONS = {"draco": {"KHR_draco_mesh_compression"}, "meshopt": {"EXT_meshopt_compression", "KHR_mesh_quantization"}}

LOSSES = {"png": 1e-9, "jpeg": 3, "webp": 4, "avif": 3, "ktx2": 6}  # mean over texels and channels; WebP has half the chroma


def need(name):
    for package in PACKAGES.get(name, ()):
        pytest.importorskip(package, reason=f"{package} is not installed: pip install 'texfcodec[formats]'")


def ball(n=16):
    """A sphere whose faces all have area."""
    positions, faces = sphere_mesh(n)
    corner = positions[faces]
    return positions, faces[np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) > 1e-6]


# Textures.


@pytest.mark.parametrize("name", IMAGE_FORMATS)
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_every_texture_format_reads_back(tmp_path, name, suffix):
    need(name)
    texf = decoded(*grid_mesh(8, 0.3))
    report = save(texf, tmp_path / f"a.{suffix}", texture_size=128, atlas="fast", texture_format=name)
    plain = save(texf, tmp_path / "plain.glb", texture_size=128, atlas="fast")
    image, wanted = (load(tmp_path / n).textures[0].image for n in (f"a.{suffix}", "plain.glb"))
    assert report["warnings"] == plain["warnings"] == [] and image.shape == wanted.shape == (128, 128, 4)
    assert np.abs(image.astype(int) - wanted).mean() < LOSSES[name]
    document = json.loads((tmp_path / "a.gltf").read_text()) if suffix == "gltf" else read_glb(tmp_path / "a.glb")[0]
    extension = IMAGE_FORMATS[name].extension
    assert document.get("extensionsRequired", []) == document.get("extensionsUsed", []) == ([extension] if extension else [])
    texture = document["textures"][0]
    assert (texture["extensions"][extension] if extension else texture)["source"] == 0
    assert document["images"][0].get("mimeType") == (IMAGE_FORMATS[name].mime if suffix == "glb" else None)
    assert report["files"][0] == ("a.glb" if suffix == "glb" else "a" + IMAGE_FORMATS[name].suffix)


@pytest.mark.parametrize("name", ["jpeg", "webp", "avif"])
def test_quality_is_paid_for_in_bytes(name):
    image = smooth_image(128, 128, 3)[..., :3] + np.random.default_rng(1).integers(0, 9, (128, 128, 3), np.uint8)
    sizes = [len(encode_image(image, IMAGE_FORMATS[name], quality)) for quality in (20, 60, 95)]
    assert sizes[0] < sizes[1] < sizes[2] < len(encode_image(image, IMAGE_FORMATS["png"]))
    assert sizes[1] < len(encode_image(image, IMAGE_FORMATS[name])) < sizes[2] * 1.01  # the format's own


def test_alpha_survives_in_every_format_that_has_it():
    from io import BytesIO

    from PIL import Image

    image = smooth_image(64, 64)
    for name in ("png", "webp", "avif"):
        read = np.asarray(Image.open(BytesIO(encode_image(image, IMAGE_FORMATS[name]))))
        assert read.shape == image.shape and np.abs(read[..., 3].astype(int) - image[..., 3]).mean() < 3


def test_an_image_that_a_format_cannot_hold_becomes_png_with_a_warning(tmp_path):
    for name, image in (("jpeg", smooth_image(16, 16)), ("ktx2", smooth_image(18, 16, 3)[..., :3])):
        warnings = []
        assert format_for(image, IMAGE_FORMATS[name], warnings).name == "png" and len(warnings) == 1
    texf = decoded(*grid_mesh(5), has_alpha=True)
    report = save(texf, tmp_path / "a.gltf", texture_size=64, atlas="fast", texture_format="jpeg", texture_quality=50)
    assert report["files"][0] == "a.png" and "JPEG" in report["warnings"][0]
    assert load(tmp_path / "a.gltf").textures[0].image.shape == (64, 64, 4)


def test_obj_names_its_jpeg(tmp_path):
    report = save(decoded(*grid_mesh(5)), tmp_path / "a.obj", texture_size=64, atlas="fast", texture_format="jpeg")
    assert report["files"] == ["a.jpg", "a.mtl", "a.obj"] and "map_Kd a.jpg" in (tmp_path / "a.mtl").read_text()
    assert load(tmp_path / "a.obj").textures[0].image.shape == (64, 64, 4)


def test_side_files_of_a_format_are_not_replaced_unasked(tmp_path):
    (tmp_path / "a.webp").write_text("mine")
    with pytest.raises(InputError, match="TXF-O08"):
        save(decoded(*grid_mesh(4), query=None), tmp_path / "a.gltf", texture_format="webp")
    (tmp_path / "b.png").write_text("mine")
    with pytest.raises(InputError, match="TXF-O08"):  # known only when the image is
        save(decoded(*grid_mesh(4), has_alpha=True), tmp_path / "b.gltf", texture_size=64, atlas="fast", texture_format="jpeg")
    assert [(tmp_path / name).read_text() for name in ("a.webp", "b.png")] == ["mine", "mine"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.webp", "b.png"]


# Meshes.


@pytest.mark.parametrize("compress", ["draco", "meshopt"])
@pytest.mark.parametrize("bits", [10, 14, 18])
@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (2.5e6, 300.0), (0.0, 1e-30), (1e30, 1e22)])
def test_packed_meshes_read_back_within_the_lattice(tmp_path, compress, bits, offset, scale):
    need(compress)
    positions, faces = ball()
    texf = decoded(positions * scale + offset, faces)
    last = (1 << bits) - 1
    texf.lattice_positions = np.rint((texf.positions - texf.origin) / texf.side * last).astype(np.int64)
    texf.positions, texf.position_bits = texf.origin + texf.side * (texf.lattice_positions / last), bits
    report = save(two_materials(texf), tmp_path / "a.glb", compress=compress, texture_size=64, atlas="fast")
    scene, (document, _) = load(tmp_path / "a.glb"), read_document(tmp_path / "a.glb")
    found = np.concatenate([scene.positions[scene.faces[scene.face_material == m]].mean(1) for m in (0, 1)])
    corners = texf.positions[texf.faces].mean(1)
    wanted = np.concatenate([corners[0::2], corners[1::2]])
    gap = np.abs(np.sort(found, 0) - np.sort(wanted, 0)).max() / texf.side
    assert report["warnings"] == [] and len(scene.faces) == len(faces)
    assert gap < 0.3 / last + np.abs(texf.positions / texf.side).max() * 2**-51
    assert EXTENSIONS[compress] <= set(document["extensionsRequired"]) and "KHR_materials_unlit" in document["extensionsUsed"]


def read_document(path):
    """(JSON, binary chunk) of a GLB of which the first buffer is the chunk."""
    return read_glb(path)


@pytest.mark.parametrize("compress", ["draco", "meshopt"])
def test_packed_textures_lie_where_plain_ones_do(tmp_path, compress):
    need(compress)
    texf = decoded(*ball(20))
    for name in ("none", compress):
        save(texf, tmp_path / f"{name}.glb", compress=name, texture_size=512, atlas="fast")
    plain, packed = (load(tmp_path / f"{name}.glb") for name in ("none", compress))
    assert np.abs(placed(plain) - placed(packed)).max() < 0.1 / 512


def placed(scene):
    """UVs of all corners in an order that only positions and coarse UVs decide."""
    uv, points = scene.corner_uv.reshape(-1, 2), scene.positions[scene.faces].reshape(-1, 3)
    return uv[np.lexsort([*np.rint(uv * 64).T, *np.rint(points * 4096).T])]


@pytest.mark.parametrize("compress", ["draco", "meshopt"])
def test_uvs_beyond_the_image_survive(tmp_path, compress):
    need(compress)
    texf = coded(wall(smooth_image(40, 24), (WRAP_REPEAT, WRAP_REPEAT), -1.3, 2.4))
    save(texf, tmp_path / "a.glb", compress=compress)
    uv = load(tmp_path / "a.glb").corner_uv
    assert abs(uv.min() + 1.3) < 2e-3 and abs(uv.max() - 2.4) < 2e-3


@pytest.mark.parametrize("compress", ["draco", "meshopt"])
def test_vertex_colours_survive(tmp_path, compress):
    need(compress)
    texf = decoded(*grid_mesh(12, 0.3))
    for name in ("none", compress):
        save(texf, tmp_path / f"{name}.glb", "vertex", compress=name)
    plain, packed = (load(tmp_path / f"{name}.glb") for name in ("none", compress))
    order = [np.lexsort(np.rint(s.positions[s.faces].mean(1) * 4096).T) for s in (plain, packed)]
    assert np.abs(plain.corner_color[order[0]].mean(1) - packed.corner_color[order[1]].mean(1)).max() < 1e-4


@pytest.mark.parametrize(("compress", "share"), [("draco", 0.25), ("meshopt", 0.4)])
def test_packed_files_are_smaller(tmp_path, compress, share):
    need(compress)
    texf = decoded(*ball(80))
    sizes = [len(as_glb(texf, appearance="vertex", compress=name)[0]) for name in ("none", compress)]
    assert sizes[1] < share * sizes[0]


def test_faces_that_draco_leaves_out_are_named(tmp_path):
    positions, faces = grid_mesh(6)
    report = save(decoded(positions, np.vstack([faces, [[1, 1, 2]]])), tmp_path / "a.glb", "vertex", compress="draco")
    assert "1 face without area" in report["warnings"][0] and len(load(tmp_path / "a.glb").faces) == len(faces)


def test_draco_accessors_say_what_is_decoded(tmp_path):
    import DracoPy

    save(two_materials(decoded(*grid_mesh(10, 0.3))), tmp_path / "a.glb", compress="draco", texture_size=64, atlas="fast")
    document, binary = read_glb(tmp_path / "a.glb")
    for primitive in document["meshes"][0]["primitives"]:
        inner = primitive["extensions"]["KHR_draco_mesh_compression"]
        view = document["bufferViews"][inner["bufferView"]]
        mesh = DracoPy.decode(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
        entries = {name: document["accessors"][number] for name, number in primitive["attributes"].items()}
        assert {entry["count"] for entry in entries.values()} == {len(mesh.points)} and set(inner["attributes"]) == set(entries)
        assert document["accessors"][primitive["indices"]]["count"] == mesh.faces.size
        assert entries["POSITION"]["min"] == np.asarray(mesh.points).min(0).tolist()
        assert not any("bufferView" in entry for entry in entries.values())


def test_a_gltf_with_packed_views_names_both_buffers(tmp_path):
    need("meshopt")
    save(decoded(*grid_mesh(6)), tmp_path / "a.gltf", compress="meshopt", texture_size=64, atlas="fast", texture_format="webp")
    document = json.loads((tmp_path / "a.gltf").read_text())
    first, second = document["buffers"]
    assert first == {"byteLength": (tmp_path / "a.bin").stat().st_size, "uri": "a.bin"}
    assert second["extensions"]["EXT_meshopt_compression"] == {"fallback": True} and "uri" not in second
    assert len(load(tmp_path / "a.gltf").faces) == 50


def test_plain_files_are_as_they_were(tmp_path):
    save(decoded(*grid_mesh(6)), tmp_path / "a.glb", texture_size=64, atlas="fast")
    document, binary = read_glb(tmp_path / "a.glb")
    assert "extensionsUsed" not in document and "extensionsRequired" not in document and len(document["buffers"]) == 1
    primitive = document["meshes"][0]["primitives"][0]
    assert accessor(document, binary, primitive["attributes"]["POSITION"]).dtype == np.float32


@pytest.mark.parametrize("compress", ["none", "draco", "meshopt"])
def test_empty_and_flat_meshes_are_packed(tmp_path, compress):
    need(compress)
    save(decoded(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), tmp_path / "a.glb", compress=compress)
    assert "meshes" not in read_glb(tmp_path / "a.glb")[0]
    report = save(decoded(np.ones((3, 3)), np.array([[0, 1, 2]])), tmp_path / "b.glb", "vertex", compress=compress)
    assert any("Draco" in warning for warning in report["warnings"]) == (compress == "draco")
    assert len(read_glb(tmp_path / "b.glb")[0]["meshes"]) == 1


# Careless use.


@pytest.mark.parametrize(("name", "options", "code"), [
    ("a.glb", {"texture_format": "gif"}, "TXF-O14"), ("a.glb", {"texture_format": ["png"]}, "TXF-O14"),
    ("a.glb", {"texture_quality": 50}, "TXF-O14"), ("a.glb", {"texture_format": "png", "texture_quality": 50}, "TXF-O14"),
    ("a.glb", {"texture_format": "jpeg", "texture_quality": 0}, "TXF-O14"),
    ("a.glb", {"texture_format": "jpeg", "texture_quality": 101}, "TXF-O14"),
    ("a.glb", {"texture_format": "jpeg", "texture_quality": 50.5}, "TXF-O14"),
    ("a.glb", {"texture_format": "jpeg", "texture_quality": True}, "TXF-O14"), ("a.glb", {"compress": "zip"}, "TXF-O14"),
    ("a.glb", {"compress": "draco", "appearance": "voxels"}, "TXF-O14"),
    ("a.glb", {"texture_format": "webp", "appearance": "vertex"}, "TXF-O14"), ("a.obj", {"texture_format": "webp"}, "TXF-O14"),
    ("a.obj", {"compress": "draco"}, "TXF-O14"), ("a.ply", {"texture_format": "jpeg"}, "TXF-O14"),
    ("a.npz", {"texture_format": "jpeg"}, "TXF-O14"),
])
def test_formats_that_make_no_sense_are_refused_before_any_work(tmp_path, name, options, code):
    with pytest.raises(InputError, match=code):
        save(decoded(*grid_mesh(4), query=None), tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("option", "package"), [({"texture_format": "ktx2"}, "alktx2"),
                                                 ({"compress": "meshopt"}, "meshoptimizer")])
def test_missing_packages_are_named_before_any_work(tmp_path, monkeypatch, option, package):
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(SupportError, match=r"TXF-O15.*texfcodec\[formats\]"):
        save(decoded(*grid_mesh(4), query=None), tmp_path / "a.glb", **option)


def test_a_pillow_without_a_format_is_told(monkeypatch):
    from PIL import features

    monkeypatch.setattr(features, "check", lambda name: False)
    with pytest.raises(SupportError, match="TXF-O15"):
        check_image_format("webp", None)
