"""Fields over texels on their way back: the image and UVs that came, whole files, clean padding, the same picture."""

import json
from pathlib import Path

import numpy as np
import pytest
from mesh_files import accessor, read_glb
from walls import coded, smooth_image, wall

from texfcodec.api import decode, encode
from texfcodec.errors import InputError
from texfcodec.field.texels import TexelSupport
from texfcodec.io.load import load
from texfcodec.io.save import as_glb, save
from texfcodec.options import EncodeOptions
from texfcodec.render.camera import perspective_around
from texfcodec.render.shade import render_scene, render_texf
from texfcodec.scene.scene import ALPHA_MASK, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Texture

CONFORMANCE = Path(__file__).parents[2] / "conformance"

# Scenes


def mixed(image, shared_material=False, **material):
    """A wall over texels, and a small plain square beside it over voxels, because it has colours of its own, which no image
    holds. shared_material: it has the wall's material, else one without an image."""
    scene = wall(image, **material)
    count = len(scene.positions)
    scene.positions = np.concatenate([scene.positions, [[1.1, 0, 0], [1.3, 0, 0], [1.3, 0.2, 0], [1.1, 0.2, 0]]])
    square = np.array([[0, 1, 2], [0, 2, 3]])
    scene.faces = np.concatenate([scene.faces, square + count])
    scene.corner_uv = np.concatenate([scene.corner_uv, np.zeros((2, 3, 2))])
    scene.corner_color = np.ones((len(scene.faces), 3, 4), np.float32)
    scene.corner_color[-2:, :, :3] = 0.2 + 0.1 * square[..., None]  # one colour would be a factor and no image
    if not shared_material:
        scene.materials.append(Material("plain", factor=np.array([0.5, 0.2, 0.1, 1.0]), double_sided=True))
    scene.face_material = np.append(scene.face_material, [0 if shared_material else 1] * 2)
    return scene


# What is seen


def views(width=200):
    for direction in ((0.2, 0.1, 1), (-0.5, 0.4, 1)):
        yield perspective_around(direction, (0.5, 0.5, 0), 0.75, 40, width)


def picture_psnr(texf, scene):
    """dB over the pixels of two views that are covered by both."""
    squares = []
    for camera in views():
        a, b = render_texf(texf, camera, filtering=False), render_scene(scene, camera)
        both = np.intersect1d(a.pixel, b.pixel)
        assert len(both) > 0.99 * max(len(a.pixel), len(b.pixel)) > 5000
        pictures = [p.image().reshape(-1, 3)[both].astype(float) for p in (a, b)]
        squares.append(((pictures[0] - pictures[1]) ** 2).mean())
    return 10 * np.log10(255**2 / max(np.mean(squares), 1e-6))


WRAPS = {
    "repeat": ((WRAP_REPEAT, WRAP_REPEAT), -1.3, 2.4), "clamp": ((WRAP_CLAMP, WRAP_CLAMP), -0.2, 1.3),
    "mirror": ((WRAP_MIRROR, WRAP_MIRROR), -1.3, 2.4), "both": ((WRAP_CLAMP, WRAP_REPEAT), -0.2, 2.5),
    "inside": ((WRAP_REPEAT, WRAP_REPEAT), 0.1, 0.7),
}  # fmt: skip


@pytest.mark.parametrize("name", WRAPS)
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_saved_file_shows_the_same_picture(tmp_path, name, suffix):
    wrap, low, high = WRAPS[name]
    texf = coded(wall(smooth_image(40, 24), wrap, low, high))
    report = save(texf, tmp_path / f"a.{suffix}")
    scene = load(tmp_path / f"a.{suffix}")
    assert [tuple(t.wrap) for t in scene.textures] == [wrap] and report["warnings"] == []
    assert scene.textures[0].image.shape == (24, 40, 4) and picture_psnr(texf, scene) > 50


@pytest.mark.parametrize("lod", [1, 2, 3])
@pytest.mark.parametrize("name", WRAPS)
def test_lower_levels_show_the_same_picture_with_the_same_uvs(tmp_path, lod, name):
    scene = wall(smooth_image(40, 24), *WRAPS[name])
    texf = coded(scene, lod)
    save(texf, tmp_path / "a.glb")
    saved = load(tmp_path / "a.glb")
    ours, theirs = (np.sort(s.corner_uv.reshape(-1, 2), axis=0) for s in (saved, scene))
    assert saved.textures[0].image.shape[1::-1] == (40 >> lod, 24 >> lod) and np.abs(ours - theirs).max() < 0.02
    assert picture_psnr(texf, saved) > 50


@pytest.mark.parametrize("lod", [1, 2, 3])
@pytest.mark.parametrize("size", [(37, 29), (36, 33)])
@pytest.mark.parametrize("wrap", [WRAP_REPEAT, WRAP_CLAMP, WRAP_MIRROR])
def test_lower_levels_of_odd_images_keep_their_texels_where_no_face_crosses_a_border(tmp_path, lod, size, wrap):
    scene = wall(smooth_image(*size), (wrap, wrap), low=0.02, high=0.97)
    if wrap != WRAP_CLAMP:
        scene.corner_uv += np.arange(len(scene.faces))[:, None, None] % 4 - 2  # whole tiles, backwards ones among them
    if wrap == WRAP_MIRROR:
        odd = np.arange(len(scene.faces)) % 2 == 1
        scene.corner_uv[odd] = 2 * np.floor(scene.corner_uv[odd]) + 1 - scene.corner_uv[odd]
    texf = coded(scene, lod)
    save(texf, tmp_path / "a.glb")
    saved = load(tmp_path / "a.glb")
    assert saved.textures[0].image.shape[1::-1] == tuple(-(-side >> lod) for side in size) == texf.fields[0].support.size
    assert picture_psnr(texf, saved) > 50


@pytest.mark.parametrize("lod", [1, 2, 3])
@pytest.mark.parametrize("size", [(37, 29), (36, 33)])
def test_lower_levels_of_odd_images_that_tile_are_written_finer(tmp_path, lod, size):
    texf = coded(wall(smooth_image(*size), low=-0.6, high=1.7), lod)
    save(texf, tmp_path / "a.glb")
    saved = load(tmp_path / "a.glb")
    whole = [min(lod, (side & -side).bit_length() - 1) for side in size]
    assert saved.textures[0].image.shape[1::-1] == (size[0] >> whole[0], size[1] >> whole[1])
    assert picture_psnr(texf, saved) > 34  # 15 to 24 with the coarse image in place of the full one


def test_lossless_streams_give_the_sources_texels_and_uvs_back(tmp_path):
    image = np.random.default_rng(1).integers(0, 256, (48, 64, 4), np.uint8)
    image[..., 3] = 255
    scene = wall(image, low=0.1, high=0.6)
    texf = coded(scene, max_error=0, qp=None)
    save(texf, tmp_path / "a.glb")
    saved, asked = load(tmp_path / "a.glb"), texf.fields[0].support.rank >= 0
    assert 0.2 < asked.mean() < 0.6 and np.array_equal(saved.textures[0].image[asked], image[asked])
    ours, theirs = (np.sort(s.corner_uv.reshape(-1, 2), axis=0) for s in (saved, scene))
    assert np.abs(ours - theirs).max() <= 0.51 / (1 << texf.fields[0].support.fraction_bits) / 48


def test_texels_that_no_face_asks_take_the_colours_beside_them(tmp_path):
    image = np.zeros((64, 64, 4), np.uint8)
    image[...] = (0, 200, 0, 255)  # nobody sees the green
    image[5:30, 9:40] = (220, 40, 30, 255)
    image[6, 10, 0] = 221  # one colour alone would be a factor and no image
    scene = wall(image)
    scene.corner_uv = (np.array([10.0, 6.0]) + scene.positions[scene.faces][..., :2] * [28, 22]) / 64
    texf = coded(scene, max_error=0, qp=None)
    save(texf, tmp_path / "a.glb")
    level = load(tmp_path / "a.glb").textures[0].image.astype(float)
    assert (texf.fields[0].support.rank < 0).mean() > 0.5
    while len(level) > 1:  # every mip level, so every blend of them
        assert (np.abs(level - (220.5, 40, 30, 255)) <= (0.5, 0, 0, 0)).all()
        level = level.reshape(len(level) // 2, 2, len(level) // 2, 2, 4).mean(axis=(1, 3))


def test_alpha_is_written_only_where_it_was_coded_and_hidden_colours_stay(tmp_path):
    image = smooth_image(32, 32, channels=4)
    image[..., 3] = np.where(np.arange(32) < 16, 255, 0)  # columns
    scene = wall(image, low=0.1, high=0.9, alpha_mode=ALPHA_MASK)
    scene.materials.append(Material("solid", texture=1, double_sided=True))
    scene.textures.append(Texture(smooth_image(16, 16, channels=3, seed=3)))
    scene.face_material[::2] = 1
    texf = coded(scene, max_error=0, qp=None)
    save(texf, tmp_path / "a.gltf")
    from PIL import Image

    shown = {}
    for path in tmp_path.glob("*.png"):
        with Image.open(path) as file:
            shown[file.mode] = np.asarray(file)
    assert sorted(shown) == ["P", "RGBA"] and texf.has_alpha and len(texf.fields) == 2
    rank = next(f.support.rank for f in texf.fields if f.support.width == 32)
    assert np.array_equal(shown["RGBA"][rank >= 0], image[rank >= 0]) and 0.5 < (rank >= 0).mean() < 0.9
    assert shown["RGBA"][0, 28, 3] == 0 and shown["RGBA"][0, 2, 3] == 255
    visible = image[..., :3][(rank >= 0) & (image[..., 3] > 0)]
    unasked = shown["RGBA"][..., :3][rank < 0]
    assert (unasked >= visible.min(0)).all() and (unasked <= visible.max(0)).all()


# Mixed streams


@pytest.mark.parametrize("shared_material", [False, True])
def test_mixed_streams_have_an_atlas_and_their_images(tmp_path, shared_material):
    texf = coded(mixed(smooth_image(), shared_material))
    save(texf, tmp_path / "a.glb", texture_size=64, atlas="fast")
    document, binary = read_glb(tmp_path / "a.glb")
    saved = load(tmp_path / "a.glb")
    assert sorted((t.image.shape[0], t.wrap[0]) for t in saved.textures) == [(32, WRAP_REPEAT), (64, WRAP_CLAMP)]
    used = [(m["name"], m["pbrMetallicRoughness"]["baseColorTexture"]["index"]) for m in document["materials"]]
    assert used == ([("wall", 0), ("wall", 1)] if shared_material else [("wall", 1), ("plain", 0)])
    faces = {used[p["material"]][1]: len(accessor(document, binary, p["indices"])) // 3
             for p in document["meshes"][0]["primitives"]}
    assert faces == {0: 2, 1: 72} and all(m["doubleSided"] for m in document["materials"])
    assert picture_psnr(texf, saved) > 45


def test_the_atlas_is_as_fine_as_the_voxels_of_its_own_faces(tmp_path):
    texf = coded(mixed(smooth_image()), resolution=1024)
    save(texf, tmp_path / "a.glb", atlas="fast")
    clamped = [t.image.shape[0] for t in load(tmp_path / "a.glb").textures if t.wrap[0] == WRAP_CLAMP]
    assert clamped == [256]  # 158 voxels a side; the whole mesh would take 2048


@pytest.mark.parametrize("shared_material", [False, True])
def test_obj_has_a_material_for_every_pair_and_shows_the_same_picture(tmp_path, shared_material):
    texf = coded(mixed(smooth_image(), shared_material))
    report = save(texf, tmp_path / "my wall.obj", texture_size=64, atlas="fast")
    assert report["files"] == ["my_wall_0.png", "my_wall_1.png", "my_wall.mtl", "my wall.obj"]
    names = [line.split()[1] for line in (tmp_path / "my_wall.mtl").read_text().splitlines() if line.startswith("newmtl")]
    assert names == (["0_wall_0", "0_wall_1"] if shared_material else ["0_wall", "1_plain"])
    scene = load(tmp_path / "my wall.obj")
    for material in scene.materials:
        material.double_sided = True  # OBJ cannot say it
    assert picture_psnr(texf, scene) > 45


@pytest.mark.parametrize("name", WRAPS)
def test_obj_wraps_as_far_as_it_can_and_names_the_rest(tmp_path, name):
    wrap, low, high = WRAPS[name]
    texf = coded(wall(smooth_image(), wrap, low, high))
    report = save(texf, tmp_path / "a.obj")
    told = [w for w in report["warnings"] if "mirror" in w]
    assert len(told) == (name in ("mirror", "both"))
    assert ("-clamp on a.png" in (tmp_path / "a.mtl").read_text()) == (name == "clamp")
    scene = load(tmp_path / "a.obj")
    scene.materials[0].double_sided = True
    assert (picture_psnr(texf, scene) > 50) == (not told)


# Geometry


def test_charts_do_not_break_the_shading(tmp_path):
    """Every square its own chart: vertices stand there once per chart, and normals must be those of the closed surface."""
    scene, found = wall(smooth_image(64, 64), n=8), {}
    scene.corner_uv[...] = np.array([[0.1, 0.1], [0.3, 0.1], [0.1, 0.3]]) + np.arange(len(scene.faces))[:, None, None] * 0.003
    for support in ("texels", "voxels"):
        texf = decode(encode(scene, EncodeOptions(support=support, resolution=64, qp=20, position_bits=14)))
        save(texf, tmp_path / "a.glb", texture_size=64, atlas="fast")
        document, binary = read_glb(tmp_path / "a.glb")
        (primitive,) = document["meshes"][0]["primitives"]
        index = accessor(document, binary, primitive["indices"])[:, 0]
        rows = np.hstack([accessor(document, binary, primitive["attributes"][name]) for name in ("POSITION", "NORMAL")])[index]
        found[support] = len(texf.lattice_positions), np.unique(np.round(rows, 4), axis=0)
    assert found["texels"][0] > 2 * found["voxels"][0]
    assert np.array_equal(found["texels"][1], found["voxels"][1]) and len(found["voxels"][1]) == found["voxels"][0]


# Other forms


def test_vertex_colours_come_from_the_texels(tmp_path):
    import trimesh

    texf = coded(wall(smooth_image(), high=1.9))
    save(texf, tmp_path / "a.ply")
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    wanted = texf.fields[0].support.query(texf.uv[texf.faces.ravel()], texf.fields[0].rgba)[:, :3]
    assert np.abs(mesh.visual.vertex_colors[mesh.faces.ravel(), :3] - wanted).max() <= 0.51


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "ply", "npz"])
def test_voxels_are_refused_where_there_are_none_and_named_where_some_are_missing(tmp_path, suffix):
    with pytest.raises(InputError) as raised:
        save(coded(wall(smooth_image())), tmp_path / f"a.{suffix}", "voxels")
    assert raised.value.code == "TXF-O13" and list(tmp_path.iterdir()) == []
    report = save(coded(mixed(smooth_image())), tmp_path / f"b.{suffix}", "voxels")
    assert "72 of 74 faces" in " ".join(report["warnings"])


def test_maps_at_their_own_texels_are_what_a_query_there_returns(monkeypatch):
    texf = decode((CONFORMANCE / "subset/maps_texels/in.texf").read_bytes())
    gathered = as_glb(texf)[0]
    monkeypatch.setattr(TexelSupport, "has_centres", lambda *_: False)
    assert as_glb(texf)[0] == gathered


def test_npz_holds_uvs_texels_and_images(tmp_path):
    texf = coded(mixed(smooth_image(40, 24)))
    save(texf, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as held:
        fields = json.loads(str(held["fields"]))
        number = [f["support"] for f in fields].index("texels")
        assert (fields[number]["width"], fields[number]["height"], fields[number]["wrap"]) == (40, 24, [0, 0])
        xy, rgba = held[f"field{number}_xy"], held[f"field{number}_rgba"]
        assert np.array_equal(held[f"field{number}_image"][xy[:, 1], xy[:, 0]], rgba[:, :3])
        assert np.array_equal(rgba, texf.fields[number].rgba) and np.array_equal(held["uv"], texf.uv)
        assert set(np.unique(held["voxel_field"])) == {1 - number} and len(held["uv"]) == len(held["lattice_positions"])


# Options and files


def test_atlas_options_without_an_atlas_are_named(tmp_path):
    texf = coded(wall(smooth_image()))
    for options in ({"texture_size": 64}, {"atlas": "fast"}):
        assert "are ignored" in save(texf, tmp_path / "a.glb", **options)["warnings"][0]
        assert load(tmp_path / "a.glb").textures[0].image.shape[:2] == (32, 32)
    assert save(coded(mixed(smooth_image())), tmp_path / "a.glb", texture_size=64, atlas="fast")["warnings"] == []
    for options in ({"texture_size": 3}, {"atlas": "best"}):
        with pytest.raises(InputError, match="TXF-O10"):
            save(texf, tmp_path / "a.glb", **options)


@pytest.mark.parametrize("out, sides", [("a.gltf", ("a_0.png", "a_1.png", "a.bin")), ("a.obj", ("a_0.png", "a_1.png", "a.mtl"))])
def test_every_image_beside_the_output_stays_unless_asked(tmp_path, monkeypatch, out, sides):
    texf, options = coded(mixed(smooth_image())), {"texture_size": 64, "atlas": "fast"}
    for side in sides:
        (tmp_path / side).write_bytes(b"mine")
        with monkeypatch.context() as patch:
            patch.setattr("texfcodec.io.output_textures.bake", None)  # refused before the work
            for more, code in (({}, "TXF-O08"), ({"overwrite": True, "inputs": [tmp_path / side]}, "TXF-O07")):
                with pytest.raises(InputError) as raised:
                    save(texf, tmp_path / out, **options, **more)
                assert raised.value.code == code and [p.name for p in tmp_path.iterdir()] == [side]
        (tmp_path / side).unlink()
    for side in sides:
        (tmp_path / side).write_bytes(b"mine")
    assert set(save(texf, tmp_path / out, **options, overwrite=True)["files"]) == {out, *sides}
    assert {p.name for p in tmp_path.iterdir()} == {out, *sides} and all(p.read_bytes() != b"mine" for p in tmp_path.iterdir())


def test_the_tool_counts_texels_and_passes_warnings_on(tmp_path, capsys):
    from texfcodec.cli.dec import main

    (tmp_path / "a.texf").write_bytes(encode(wall(smooth_image()), EncodeOptions(support="texels", qp=20)))
    with pytest.raises(SystemExit) as left:
        main([str(tmp_path / "a.texf"), str(tmp_path / "a.glb"), "--texture-size", "64", "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert left.value.code in (0, None) and (facts["voxels"], facts["texels"]) == (0, 1024)
    assert "are ignored" in " ".join(facts["warnings"])
