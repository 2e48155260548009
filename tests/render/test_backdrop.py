"""Pictures for people show any model: its outline on grey, its shape in light where it has few colours; metrics know neither."""

import json
import struct

import numpy as np
import pytest
from PIL import Image
from shapes import hand, linear, mapped_sheet, painted_sphere, scene_of, sphere

from texfcodec import EncodeOptions, Texf, decode, encode
from texfcodec.render.backdrop import FEW, GREY, has_few_colours, is_nearly_uniform, rows
from texfcodec.render.difference import names_of_halves
from texfcodec.scene.scene import Material

FLAT = {"white": (255,) * 3, "black": (0,) * 3, "grey": (188,) * 3, "as the top": GREY[0], "as the bottom": GREY[1]}
NOTICED = 8  # coded levels that an eye tells apart


def of_colour(levels, shape=sphere):
    """A Scene of one colour, sRGB levels, whose material is no metal."""
    positions, faces = shape()[:2]
    factor = np.array(linear((*levels, 255)))
    return scene_of(positions, faces, materials=[Material("m", factor, parameters={"metallic": (0.0,)})])


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """Paths of the same model as an STL, which is white, and as OBJs of other colours."""
    folder, (positions, faces, _) = tmp_path_factory.mktemp("meshes"), hand(24)
    rows_ = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    rows_["corners"] = positions[faces]
    (folder / "white.stl").write_bytes(bytes(80) + struct.pack("<I", len(faces)) + rows_.tobytes())
    points = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions)
    text = "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)
    for name, levels in FLAT.items():
        shown = " ".join(str(level / 255) for level in levels)
        (folder / f"{name}.mtl".replace(" ", "_")).write_text(f"newmtl m\nKd {shown}\n")
        (folder / f"{name}.obj").write_text(f"mtllib {name.replace(' ', '_')}.mtl\nusemtl m\n{points}{text}")
    return {path.stem if path.suffix == ".obj" else "stl": path for path in folder.iterdir() if path.suffix != ".mtl"}


def test_a_background_goes_from_its_top_to_its_bottom():
    assert rows((1, 2, 3), 4).tolist() == [[[1, 2, 3]]] * 4
    grey = rows(GREY, 5)[:, 0, 0]
    assert (grey[0], grey[-1]) == (GREY[0][0], GREY[1][0]) and (np.diff(grey.astype(int)) < 0).all()
    assert rows(GREY, 1).tolist() == [[list(GREY[0])]]


def test_white_and_black_and_most_greys_stand_off_from_the_grey():
    ends = np.array([GREY[0][0], GREY[1][0]])
    for level in range(256):
        assert np.abs(ends - level).max() > 2 * NOTICED
    assert min(255 - ends.max(), ends.min()) > 10 * NOTICED


@pytest.mark.parametrize("name", FLAT)
def test_one_colour_is_plain_as_a_mesh_and_as_a_stream(name):
    scene = of_colour(FLAT[name])
    assert is_nearly_uniform(scene) and is_nearly_uniform(decode(encode(scene, EncodeOptions(resolution=16, qp=40))))


def test_textures_and_smooth_colours_are_not_plain_and_an_image_of_one_colour_is():
    assert not is_nearly_uniform(mapped_sheet({})) and not is_nearly_uniform(painted_sphere())
    assert not is_nearly_uniform(decode(encode(painted_sphere(), EncodeOptions(resolution=32, qp=28))))
    assert is_nearly_uniform(mapped_sheet({}, colour=np.full((4, 4, 4), 200, np.uint8)))


def test_few_colours_are_plain_and_more_are_not():
    levels = np.arange(FEW + 1) * 20
    assert has_few_colours(np.repeat(levels[:FEW], 100)[:, None].repeat(3, 1) + np.random.default_rng(0).normal(0, 1, (800, 3)))
    assert not has_few_colours(np.repeat(levels, 100)[:, None].repeat(3, 1))
    assert has_few_colours(np.full((10, 3), np.nan))


def test_what_has_no_surface_is_not_plain():
    flat = scene_of([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    assert not is_nearly_uniform(flat) and not is_nearly_uniform(scene_of([], []))
    empty = decode(encode(flat, EncodeOptions(resolution=8, qp=40, allow_empty=True)))
    assert isinstance(empty, Texf) and not is_nearly_uniform(empty)


@pytest.mark.parametrize("name", ["stl", *FLAT])
def test_a_picture_of_any_flat_model_shows_its_outline_and_its_shape(call, meshes, tmp_path, name):
    facts = json.loads(call("texf-render", meshes[name], tmp_path / "a.png", "--size", "128", "--view", "30,20", "--json")[1])
    image = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    seen = (np.abs(image - rows(GREY, 128)).max(axis=2) > 1).mean()
    assert facts["shaded"] and facts["background"] == [list(GREY[0]), list(GREY[1])]
    assert seen > 0.9 * facts["covered"] / facts["pixels"]
    model = image[np.abs(image - rows(GREY, 128)).max(axis=2) > 1].mean(axis=1)
    assert np.percentile(model, 95) - np.percentile(model, 5) > NOTICED


def test_what_is_told_is_done_and_a_texture_needs_no_light(call, meshes, tmp_path):
    drawn = lambda *flags: json.loads(call("texf-render", meshes["stl"], tmp_path / "a.png", "--size", "64", "--json", *flags)[1])
    assert drawn("--no-shaded", "--background", "white")["shaded"] is False
    assert (np.asarray(Image.open(tmp_path / "a.png")) == 255).all()
    assert drawn("--shaded")["shaded"] is True
    from texfcodec.demo.asset import write_sample

    write_sample(tmp_path / "sample.glb")
    said = json.loads(call("texf-render", tmp_path / "sample.glb", tmp_path / "b.png", "--size", "64", "--json")[1])
    assert said["shaded"] is False and "in light" not in call("texf-render", tmp_path / "sample.glb", tmp_path / "b.png")[1]


def test_figures_are_those_of_colours_without_light_on_any_background(call, meshes, tmp_path):
    white_against_grey = 20 * np.log10(255 / (255 - FLAT["grey"][0]))
    compared = (meshes["stl"], tmp_path / "a.png", "--compare", meshes["grey"], "--size", "64", "--json")
    found = [json.loads(call("texf-render", *compared, *flags)[1]) for flags in ((), ("--background", "black"), ("--no-shaded",))]
    assert [one["shaded"] for one in found] == [True, True, False]
    for one in found:
        assert one["compare"]["psnr_rgb"] == pytest.approx(white_against_grey, abs=0.01)
    told = json.loads(call("texf-eval", meshes["stl"], meshes["grey"], "--views", "2", "--size", "64", "--json")[1])
    figures = [told["psnr"]["rgb"], told["psnr_3d"]["rgb"]]
    assert figures == pytest.approx([white_against_grey] * 2, abs=0.01)


def test_halves_are_source_and_stream_where_they_are():
    assert names_of_halves([(True, "a.glb"), (False, "b.texf")]) == ["source: a.glb", "stream: b.texf"]
    assert names_of_halves([(False, "b.texf"), (True, "a.glb")]) == ["stream: b.texf", "source: a.glb"]
    assert names_of_halves([(True, "a.glb"), (True, "b.glb")]) == ["first: a.glb", "second: b.glb"]


def test_a_notebook_sees_a_white_stream():
    import io

    picture = decode(encode(of_colour(FLAT["white"]), EncodeOptions(resolution=16, qp=40)))._repr_png_()
    image = np.asarray(Image.open(io.BytesIO(picture))).astype(int)
    assert (np.abs(image - rows(GREY, len(image))) > NOTICED).any(axis=2).mean() > 0.2
