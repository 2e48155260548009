"""What leaves as GLB: what it was before, no larger than it has to be, and nothing in it that shows nothing."""

import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from mesh_files import accessor, read_glb
from PIL import Image
from scipy.ndimage import gaussian_filter
from shapes import painted_sphere, scene_of, sphere

from texfcodec import DecodeOptions, EncodeOptions, decode, encode
from texfcodec.errors import InputError
from texfcodec.io.automatic_image import automatic_image
from texfcodec.io.gltf.packing import Column, smallest
from texfcodec.io.images import encode_jpeg
from texfcodec.io.load import load
from texfcodec.io.save import as_glb, save
from texfcodec.scene.normal_rule import NormalRule
from texfcodec.scene.scene import ALPHA_BLEND, Material, Scene, Texture

REPOSITORY = Path(__file__).resolve().parents[2]


def coded(scene, **options):
    return decode(encode(scene, EncodeOptions(**({"support": "voxels", "resolution": 64, "qp": 16, "refine": "off"} | options))))


def printed(image, name="print"):
    """A square of two faces that shows an image."""
    side = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Scene(np.insert(side, 2, 0, axis=1), faces, np.zeros(2, np.int64), side[faces], None, [Material(name, texture=0)],
                 [Texture(image)])


def attributes(document):
    """Names of the attributes of every primitive."""
    return [set(p["attributes"]) for p in document["meshes"][0]["primitives"]]


# Colours where the source had them.


def test_a_surface_of_one_colour_has_no_uvs(tmp_path):
    for support in ("voxels", "auto"):
        save(coded(scene_of(*sphere(8)), support=support), tmp_path / "a.glb")
        document, _ = read_glb(tmp_path / "a.glb")
        assert attributes(document) == [{"POSITION", "NORMAL"}] and "images" not in document


def test_colours_of_vertices_come_back_at_vertices(tmp_path):
    scene = painted_sphere(12)
    texf = coded(scene, resolution=256)
    save(texf, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    assert attributes(document) == [{"POSITION", "NORMAL", "COLOR_0"}] and "images" not in document
    got = accessor(document, binary, document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]) / 65535
    place = accessor(document, binary, document["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    wanted = scene.corner_color.reshape(-1, 4)
    at = scene.positions[scene.faces].reshape(-1, 3)
    nearest = np.array([np.abs(at - p).sum(axis=1).argmin() for p in place])
    assert np.abs(got - wanted[nearest])[:, :3].mean() < 0.01 and np.abs(got - wanted[nearest])[:, :3].max() < 0.06


def test_an_image_is_written_where_one_is_wanted(tmp_path):
    texf = coded(painted_sphere(12))
    for options in ({"appearance": "texture"}, {"texture_size": 64}, {"atlas": "fast"}):
        save(texf, tmp_path / "a.glb", **options)
        document, _ = read_glb(tmp_path / "a.glb")
        assert attributes(document) == [{"POSITION", "NORMAL", "TEXCOORD_0"}] and len(document["images"]) == 1


@pytest.mark.parametrize("kind", ["noise", "small print"])
def test_what_vertices_cannot_show_stays_an_image(kind):
    image = np.full((128, 128, 4), 255, np.uint8)
    if kind == "noise":
        image[..., :3] = np.random.default_rng(0).integers(0, 256, (128, 128, 3))
    else:
        image[60:64, 60:66, :3] = 0  # 24 of 16384 texels: 34 dB if they went missing altogether
    document = json_of(as_glb(coded(printed(image), resolution=128))[0])
    assert attributes(document) == [{"POSITION", "TEXCOORD_0"}] and len(document["images"]) == 1


def json_of(data):
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_materials_with_and_without_images_share_a_file(tmp_path):
    """A painted sphere and a printed square are one stream: each has its own attributes, and the sphere no part in the atlas."""
    ball, page = painted_sphere(12), printed(np.random.default_rng(1).integers(0, 256, (64, 64, 4), np.uint8) | [0, 0, 0, 255])
    both = Scene(
        np.concatenate([ball.positions, page.positions + [3, 0, 0]]),
        np.concatenate([ball.faces, page.faces + len(ball.positions)]),
        np.concatenate([ball.face_material, page.face_material + 1]), np.concatenate([ball.corner_uv, page.corner_uv]),
        np.concatenate([ball.corner_color, np.ones((2, 3, 4), np.float32)]), ball.materials + page.materials, page.textures)
    save(coded(both, resolution=256), tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    assert sorted(map(sorted, attributes(document))) == [["COLOR_0", "NORMAL", "POSITION"], ["POSITION", "TEXCOORD_0"]]
    back = load(tmp_path / "a.glb")
    assert len(back.faces) == len(both.faces) and len(back.textures) == 1


# Images no larger than they have to be.


def photograph(side=256, seed=0):
    """An image with detail of every size, uint8 [side, side, 4]."""
    rng, out = np.random.default_rng(seed), np.full((side, side, 3), 128.0)
    for wide in (0.7, 2, 8, 32):
        layer = gaussian_filter(rng.normal(0, 1, (side, side, 3)), (wide, wide, 0), mode="wrap")
        out += layer * (wide**0.7 * 4 / layer.std())
    return np.dstack([np.clip(out, 0, 255), np.full((side, side, 1), 255)]).astype(np.uint8)


def picture(path):
    """The first image of a file as it is in there: (its format, float [H, W, 3])."""
    document, binary = read_glb(path)
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    image = Image.open(io.BytesIO(binary[view["byteOffset"]:][: view["byteLength"]]))
    return image.format, np.asarray(image.convert("RGB"), np.float64), view["byteLength"]


def luma_error(a, b):
    return float((((a - b) @ [0.2126, 0.7152, 0.0722]) ** 2).mean())


@pytest.mark.parametrize(("rate", "form"), [("r01", "JPEG"), ("r03", "JPEG"), ("r06", "PNG")])
def test_a_jpeg_costs_less_than_a_fifth_of_a_decibel(tmp_path, rate, form):
    scene = printed(photograph())
    texf = decode(encode(scene, EncodeOptions(rate=rate, support="texels", refine="off")))
    for name in ("auto", "png"):
        save(texf, tmp_path / f"{name}.glb", texture_format=name)
    (chosen, small, size), (_, exact, whole) = (picture(tmp_path / f"{name}.glb") for name in ("auto", "png"))
    source = scene.textures[0].image[..., :3].astype(np.float64)
    lost = 10 * np.log10(luma_error(small, source) / luma_error(exact, source))
    assert chosen == form and lost < 0.2 and (form == "PNG") == (lost == 0)
    assert size < (0.6 if form == "JPEG" else 1) * whole


def test_exact_values_stay_exact(tmp_path):
    texf = decode(encode(printed(photograph(64)), EncodeOptions(lossless=True, support="texels")))
    save(texf, tmp_path / "a.glb")
    form, image, _ = picture(tmp_path / "a.glb")
    assert form == "PNG" and (image == photograph(64)[..., :3]).all()


def test_few_colours_and_alpha_are_png():
    flat = np.random.default_rng(0).integers(0, 200, (16, 16, 3), np.uint8).repeat(16, axis=0).repeat(16, axis=1)
    form, data = automatic_image(flat[:, :, :1].repeat(3, axis=2), 0.0)
    read = Image.open(io.BytesIO(data))
    assert form.name == "png" and read.mode == "P" and (np.asarray(read.convert("RGB")) == flat[:, :, :1]).all()
    assert automatic_image(photograph(64), 16.0)[0].name == "png"  # with alpha
    assert automatic_image(photograph(64)[..., :3], None)[0].name == "png"  # nothing known
    assert automatic_image(photograph(256)[..., :3], 40.0)[0].name == "jpeg"


def test_noise_that_no_guess_of_its_size_holds_is_a_jpeg_all_the_same():
    """Pillow gives an optimised JPEG two bytes a texel at most."""
    noise = np.random.default_rng(0).integers(0, 256, (512, 512, 3), np.uint8)
    data = encode_jpeg(noise, quality=100, subsampling=0)
    assert np.abs(np.asarray(Image.open(io.BytesIO(data))).astype(int) - noise).mean() < 1


def test_an_isolated_decoder_says_the_steps_too():
    data = encode(printed(photograph(64)), EncodeOptions(rate="r03", support="texels", refine="off", exact_rate=True))
    here, there = decode(data), decode(data, DecodeOptions(isolate=True))
    assert [f.steps for f in here.fields] == [f.steps for f in there.fields] and here.fields[0].steps["base_colour"] == 16


# What the file says of itself, and what is beside it.


def test_alpha_that_hides_nothing_leaves_as_opaque_and_is_named(tmp_path):
    scene = painted_sphere(6)
    scene.materials[0].alpha_mode = ALPHA_BLEND
    scene.corner_color[..., 3] = 1
    report = save(coded(scene), tmp_path / "a.glb")
    assert "alphaMode" not in read_glb(tmp_path / "a.glb")[0]["materials"][0] and report["warnings"] == []
    assert report["remarks"] == ["alpha is 1 everywhere on skin: written as opaque"]
    scene.corner_color[..., 3] = 0.5
    report = save(coded(scene), tmp_path / "b.glb")
    assert read_glb(tmp_path / "b.glb")[0]["materials"][0]["alphaMode"] == "BLEND" and report["remarks"] == []


def test_faces_that_all_meet_in_sharp_edges_share_vertices_and_have_no_normals(tmp_path):
    """glTF shades a mesh without normals flat: a cube is 8 vertices, not 24 with normals."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                      [0, 6, 4], [1, 5, 7], [1, 7, 3]])
    texf = coded(scene_of(corners, faces))
    texf.materials[0].normals = NormalRule(texf.materials[0].normals.kind, texf.materials[0].normals.weight, 30)
    save(texf, tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    assert attributes(document) == [{"POSITION"}] and document["accessors"][0]["count"] == 8
    save(coded(scene_of(*sphere(8))), tmp_path / "b.glb")
    assert "NORMAL" in attributes(read_glb(tmp_path / "b.glb")[0])[0]


@pytest.mark.parametrize("suffix", ["obj", "gltf"])
def test_an_output_written_twice_replaces_what_it_came_with(tmp_path, suffix):
    texf, path = coded(printed(photograph(64)), support="texels"), tmp_path / f"o.{suffix}"
    first = save(texf, path, texture_format="png")["files"]
    assert "o.png" in first and save(texf, path, texture_format="png")["files"] == first


@pytest.mark.parametrize("suffix", ["obj", "gltf"])
def test_a_strangers_file_beside_the_output_stays(tmp_path, suffix):
    texf, path = coded(printed(photograph(64)), support="texels"), tmp_path / f"o.{suffix}"
    (tmp_path / "o.png").write_text("mine")
    others = {"obj": "# someone else\nmtllib o.mtl\n", "gltf": '{"asset": {"generator": "other"}, "images": [{"uri": "o.png"}]}'}
    for content in (None, others[suffix]):
        if content is not None:
            path.write_text(content)
            (tmp_path / "o.mtl").write_text("newmtl a\nmap_Kd o.png\n")
        with pytest.raises(InputError, match=r"TXF-O08|TXF-O07"):
            save(texf, path, texture_format="png", inputs=[tmp_path / "o.png"] if content else [])
    assert (tmp_path / "o.png").read_text() == "mine"


def test_an_own_file_that_is_read_stays(tmp_path):
    texf, path = coded(printed(photograph(64)), support="texels"), tmp_path / "o.obj"
    save(texf, path, texture_format="png")
    with pytest.raises(InputError, match="TXF-O07"):
        save(texf, path, texture_format="png", inputs=[tmp_path / "o.png"])


def test_a_missing_package_is_named_before_anything_is_decoded(tmp_path, monkeypatch, call):
    monkeypatch.setitem(sys.modules, "alktx2", None)
    (tmp_path / "broken.texf").write_bytes(b"no stream at all")
    code, _, said = call("texf-dec", tmp_path / "broken.texf", tmp_path / "a.glb", "--texture-format", "ktx2")
    assert code == 5 and "TXF-O15" in said


def test_seams_are_those_of_the_new_atlas_alone(tmp_path):
    """UVs and image of a field over texels are the source's, and so is how its charts meet."""
    scene = printed(photograph(64))
    scene.corner_uv[1] = scene.corner_uv[1] * 0.5
    assert save(coded(scene, support="texels"), tmp_path / "a.glb")["seams"] is None
    assert save(coded(scene, support="voxels"), tmp_path / "b.glb", texture_size=64)["seams"] is not None


def test_attributes_take_the_smallest_type_that_is_exact(tmp_path):
    """Corners of an image are whole 65535ths, thirds of it too, quarters not; black and white are whole 255ths."""
    texf = coded(printed(photograph(64)), support="texels")
    save(texf, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    at = document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]
    assert document["accessors"][at]["componentType"] == 5123 and document["accessors"][at]["normalized"]
    assert sorted(map(tuple, accessor(document, binary, at) // 65535)) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    rows = [Column(np.array([[0, value]], np.float32), "VEC2") for value in (1 / 3, 0.25, 2)]
    assert [smallest("TEXCOORD_0", row).values.dtype for row in rows] == [np.uint16, np.float32, np.float32]
    plain, deep = (np.array([[0, 65535, level, 65535]], np.uint16) for level in (257, 258))
    packed = [smallest("COLOR_0", Column(colour, "VEC4", True)).values.tolist() for colour in (plain, deep)]
    assert packed == [[[0, 255, 1, 255]], deep.tolist()]
    assert load(tmp_path / "a.glb").corner_uv.max() == 1


def test_a_drawing_under_the_noise_of_coding_goes_out_as_a_palette():
    rng = np.random.default_rng(0)
    drawn = rng.integers(8, 248, (12, 3))[rng.integers(0, 12, (16, 16))].repeat(16, axis=0).repeat(16, axis=1)
    noisy = (drawn + (rng.random(drawn.shape) < 0.1)).astype(np.uint8)
    form, data = automatic_image(noisy, 16.0)
    shown = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(float)
    assert form.name == "png" and Image.open(io.BytesIO(data)).mode == "P"
    assert ((shown - noisy) ** 2).mean() < 0.1 * 16**2 / 12 and len(data) < 0.5 * len(automatic_image(noisy, 0.0)[1])
