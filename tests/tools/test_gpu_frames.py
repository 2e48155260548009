"""Frames by compute (tools/gpu), as a C++ compiler sees them: the functions of a pixel are those that a GPU runs."""

import base64
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from cupy_stand_in import stand_in
from shapes import noise, scene_of, sphere

import texfcodec
from texfcodec.field.morton import encode_morton
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.levels import pyramid_of as pyramid_of_field
from texfcodec.render.textures import halved
from texfcodec.scene.scene import Material, Texture
from tools.gpu import frames, frames_asset, frames_cpu, frames_egl, prepare_frames
from tools.gpu.frames_cpu import HostFrames, picture_psnr
from tools.gpu.rows import Context

SIDE = 192


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    """The compiled functions."""
    try:
        return HostFrames(tmp_path_factory.mktemp("frames"))
    except FileNotFoundError:
        pytest.skip("there is no C++ compiler, and the functions of a pixel are C++")


@pytest.fixture(scope="module")
def shells():
    """Two textured spheres, one just inside the other and inside out, so that voxels need two fields."""
    positions, faces = sphere(12)
    both = np.concatenate([positions, 0.99 * positions])
    all_faces = np.concatenate([faces, faces[:, ::-1] + len(positions)])
    scene = scene_of(both, all_faces, materials=[Material("skin", texture=0)])
    corners = both[all_faces] / np.linalg.norm(both[all_faces], axis=2, keepdims=True)
    image = np.repeat(np.repeat(noise(3, 32, 32), 4, axis=0), 4, axis=1)
    image[..., 3] = 255
    corners[len(faces) :] *= -1  # other colours inside
    return replace(scene, corner_uv=0.5 + 0.45 * corners[..., :2], textures=[Texture(image)])


@pytest.fixture(scope="module")
def streams(shells):
    """Decoded, by kind."""
    options = {"voxels": {"resolution": 96, "qp": 20, "support": "voxels"}, "texels": {"rate": "r03", "support": "texels"},
               "3dntc": {"codec": "3dntc", "steps": 30, "resolution": 96}}
    return {kind: texfcodec.decode(texfcodec.encode(shells, {"no_check": True, **given})) for kind, given in options.items()}


def drawn(host, arrays, zoom, view=7):
    asset = frames_asset.asset_of(arrays)
    axes = prepare_frames.cameras_of(np.zeros(3), 1.0)[view]
    camera = frames_asset.camera_of(*axes, zoom, SIDE, asset.voxels_per_radius)
    return host.draw(asset, camera, asset.kind), float(camera["fineness"][0])


def reference(side, scene, zoom, view=7):
    centre, radius = bounding_sphere(scene.positions)
    return prepare_frames.reference_picture(side, orthographic(fibonacci_direction(view, 16), centre, zoom * radius, SIDE))


@pytest.mark.parametrize("kind, zoom, level", [("voxels", 0.4, 0), ("voxels", 2.2, 1), ("voxels", 8.0, 3), ("3dntc", 0.4, 0),
                                               ("3dntc", 2.2, 1), ("3dntc", 8.0, 3), ("texels", 0.4, 0), ("texels", 5.0, 0)])
def test_a_stream_is_drawn_as_texf_render_draws_it(host, shells, streams, kind, zoom, level):
    arrays = prepare_frames.texf_arrays(streams[kind], *bounding_sphere(shells.positions))
    picture, fineness = drawn(host, arrays, zoom)
    figures = picture_psnr(picture, reference(streams[kind], shells, zoom))
    assert np.ceil(fineness) == level, fineness
    assert figures["psnr_db"] >= 40 and figures["pixels_compared"] > 100
    assert figures["pixels_of_one_alone"] <= figures["pixels_compared"] / 500


def test_a_stream_that_travels_without_coarser_voxels_is_drawn_by_its_network_alone(host, shells, streams):
    arrays = prepare_frames.texf_arrays(streams["3dntc"], *bounding_sphere(shells.positions), is_far=False)
    picture, fineness = drawn(host, arrays, 2.2)
    figures = picture_psnr(picture, reference(streams["3dntc"], shells, 2.2))
    assert fineness == 0 and figures["psnr_db"] > 20


def test_voxels_of_the_pictures_are_in_several_fields(streams):
    assert len(streams["voxels"].fields) > 1 and len(streams["3dntc"].fields) > 1


@pytest.mark.parametrize("zoom", [0.3, 4.0])
def test_a_uv_texture_is_drawn_as_texf_render_draws_it(host, shells, streams, zoom):
    texf = streams["texels"]
    anchor, carried = prepare_frames.anchor_arrays(shells, texf)
    arrays = frames_asset.anchor_of(prepare_frames.texf_arrays(texf, *bounding_sphere(shells.positions)) | anchor)
    figures = picture_psnr(drawn(host, arrays, zoom)[0], reference(carried, shells, zoom))
    assert figures["psnr_db"] >= 40 and figures["pixels_compared"] > 500


def test_the_network_says_what_the_decoder_says(host, shells, streams):
    arrays = prepare_frames.texf_arrays(streams["3dntc"], *bounding_sphere(shells.positions))
    answers = host.points(frames_asset.asset_of(arrays), arrays["points"])
    assert set(arrays["points"][:, 3]) > {0} and np.ptp(arrays["exact"]) > 20
    assert np.abs(answers - arrays["exact"]).max() < 0.5


def test_the_network_on_tensor_cores_says_what_the_decoder_says(shells, streams, tmp_path):
    """Its own text, with a warp of threads and mma as PTX describes it."""
    try:
        warp = frames_cpu.compile_host(frames_cpu.warp_source(), tmp_path, "c++20")
    except (FileNotFoundError, subprocess.CalledProcessError):
        pytest.skip("there is no compiler of C++20 with _Float16 and <barrier>")
    arrays = prepare_frames.texf_arrays(streams["3dntc"], *bounding_sphere(shells.positions))
    answers = frames_cpu.points_by(warp.warp_points, frames_asset.asset_of(arrays), arrays["points"][:64])
    assert np.abs(answers - arrays["exact"][:64]).max() < 1.0


def test_large_faces_fill_their_pixels_without_gaps(host):
    """A square of two faces over the whole picture, and a small one before it: every pixel, and the nearer face."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    places = np.concatenate([np.insert(corners, 2, -0.5, axis=1), np.insert(corners / 4, 2, 0.5, axis=1)]).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    pixels = np.zeros((1, 2, 4), np.uint8)
    pixels[0, :, 3], pixels[0, 1] = 255, (200, 100, 50, 255)
    uv = np.repeat(np.array([[[0.5, 0.5]], [[0.5, 0.5]], [[1.5, 0.5]], [[1.5, 0.5]]], np.float32), 3, axis=1)
    sizes = np.array([(0, 2, 1, 0)], np.int32)
    asset = frames_asset.FrameAsset(frames_asset.TEXELS, {
        "positions": places, "faces": faces, "uv": uv, "density": np.zeros(4, np.float32), "image_levels": sizes,
        "images": frames_asset.rgba_words(pixels[..., :3], pixels[..., 3]).reshape(-1)},
        {"vertices": 8, "face_count": 4, "width": 2, "height": 1, "wrap_s": 1, "wrap_t": 1})
    picture = host.draw(asset, frames_asset.camera_of(*np.diag([1, 1, -1]).astype(np.float32), 1.0, 64), frames_asset.TEXELS)
    assert (picture[..., 3] == 255).all()
    small = (picture[..., :3] == (200, 100, 50)).all(axis=2)
    assert small.sum() == 16 * 16 and small[24:40, 24:40].all()


def test_coarser_levels_of_a_uv_texture_are_those_of_texf_render():
    image = noise(1, 32, 64)
    image[..., 3] = 255
    levels, expected = frames_asset.linear_levels(image), image
    for level in levels[1:]:
        expected = halved(expected, True)
        assert np.abs(level.astype(int) - expected).max() <= 1
    assert levels[-1].shape == (1, 1, 4)


def test_coarser_levels_of_texels_and_voxels_are_those_of_texf_render(streams):
    field = streams["texels"].fields[0]
    alpha = field.support.image(np.full((len(field.support), 1), 255, np.uint8))
    pixels = np.concatenate([field.support.image(field.planes["base_colour"]), alpha], axis=2)
    level, coarser = frames_asset.masked_levels(pixels)[2], pyramid_of_field(field).level(2)
    assert np.array_equal(level[..., 3] > 0, coarser.support.rank >= 0)
    assert np.abs(coarser.support.image(coarser.values)[..., :3] - level[..., :3]).max() <= 0.5001
    field = streams["voxels"].fields[0]
    ones = np.ones(len(field.keys), np.int64)
    levels, words = frames_asset.pyramid_of(field.keys, field.planes["base_colour"], ones, 2)
    coarser = pyramid_of_field(field).level(2)
    assert np.array_equal(frames_asset.keys_of(*levels[2]), coarser.support.keys)
    values = words[-len(coarser.support.keys) :].view(np.uint8).reshape(-1, 4)[:, :3]
    assert np.abs(values - coarser.values[:, :3]).max() <= 0.5001


def test_every_brick_is_found_in_the_table_and_no_other():
    random = np.random.default_rng(0)
    keys = np.unique(encode_morton(random.integers(0, 200, (3000, 3))))
    bricks, words = frames_asset.bricks_of(keys)
    assert np.array_equal(frames_asset.keys_of(bricks, words), keys)
    table, log2, bits = frames_asset.look_up_of([(bricks, words)])
    assert np.array_equal(np.sort(table[table[:, 1] > 0, 1]), np.arange(1, len(bricks) + 1))
    for slot in np.flatnonzero(table[:, 1]):  # no empty place between where the search begins and where it ends
        begin = int(table[slot, 0]) * frames_asset.HASH_FACTOR % (1 << 32) >> (32 - log2)
        assert (table[np.arange(begin, begin + (slot - begin) % len(table) + 1) % len(table), 1] > 0).all()
    assert bits[0, 1] == 0 and bits[-1, 1] + int(bits[-1, 0]).bit_count() == len(keys)


def test_tensor_cores_get_the_weights_that_the_layout_of_mma_names():
    """Thread 4 g + t holds of a tile of 16 inputs and 8 outputs, row k and column g: k = 2 t, 2 t + 1, 2 t + 8, 2 t + 9."""
    random = np.random.default_rng(0)
    weights = [random.integers(-9, 9, (outputs, inputs)).astype(np.float64) for inputs, outputs in ((50, 64), (32, 3))]
    fragments = frames_asset.fragments_of(weights).view(np.float16).astype(np.float64).reshape(-1, 32, 4)
    at = 0
    for weight in weights:
        outputs, inputs = weight.shape
        got = np.zeros((-(-outputs // 8) * 8, -(-inputs // 16) * 16))
        for n in range(len(got) // 8):
            for i in range(got.shape[1] // 16):
                for lane in range(32):
                    rows = 2 * (lane & 3) + np.array([0, 1, 8, 9])
                    got[8 * n + (lane >> 2), 16 * i + rows] = fragments[at + n * (got.shape[1] // 16) + i, lane]
        at += len(got) // 8 * (got.shape[1] // 16)
        assert np.array_equal(got[:outputs, :inputs], weight)
        assert not got[outputs:].any() and not got[:, inputs:].any()
    assert at == len(fragments)


@pytest.fixture(scope="module")
def inputs(shells, streams, tmp_path_factory):
    """A folder as prepare_frames.py fills it, of small pictures."""
    folder, sphere_of = tmp_path_factory.mktemp("inputs"), bounding_sphere(shells.positions)
    for kind in ("texels", "3dntc"):
        zooms = {"near": 1.0} | ({"far": prepare_frames.FAR} if kind == "3dntc" else {})
        arrays = prepare_frames.texf_arrays(streams[kind], *sphere_of) | {"cameras": prepare_frames.cameras_of(*sphere_of)}
        arrays |= prepare_frames.references(streams[kind], *sphere_of, zooms, SIDE) | {"facts": '{"stream_bytes": 1}'}
        if kind == "texels":
            anchor, carried = prepare_frames.anchor_arrays(shells, streams[kind])
            pictures = prepare_frames.references(carried, *sphere_of, zooms, SIDE)
            arrays |= anchor | {f"anchor_{name}": pictures[name] for name in ("reference_near", "window_near")}
        arrays |= {"cameras": arrays["cameras"][6:8], "reference_view": 1}  # two of 16, to be quick
        frames_asset.save_arrays(folder / f"frames_player_{kind}.npz.xz", arrays)
    return folder


def test_frames_on_a_cpu_are_rows_with_the_psnr_of_their_picture(host, inputs, tmp_path):
    context = Context(inputs, tmp_path / "out", scale=SIDE / frames.SIDE, device="cpu")
    rows = {row.key: row.figures for row in frames.measure(context)}
    assert sorted(rows) == ["frames/player/3dntc-far/cpu", "frames/player/3dntc-near/cpu", "frames/player/texels/cpu",
                            "frames/player/uv/cpu"]
    assert all(figures["picture_is_right"] and figures["psnr_db"] >= 40 for figures in rows.values())
    assert (tmp_path / "out" / frames.PICTURES).exists()


def test_on_a_gpu_every_kernel_is_launched_and_timed_and_its_picture_kept(host, inputs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", stand_in(host))
    monkeypatch.setattr(frames, "SIDE", SIDE)
    rows = {row.key: row.figures for row in frames.measure(Context(inputs, tmp_path, scale=0.1))}
    kinds = [f"3dntc-{zoom}/{how}" for zoom in ("near", "far") for how in ("tensor", "plain")] + ["texels/compute", "uv/compute"]
    others = ["frames/build", "frames/fragments", "frames/player/3dntc/check"]
    assert sorted(rows) == sorted([*others, *(f"frames/player/{kind}" for kind in kinds)])
    assert rows["frames/player/3dntc/check"]["kernel"] == "tensor cores"
    for kind in kinds:
        figures = rows[f"frames/player/{kind}"]
        assert figures["picture_is_right"] and figures["visibility_ms_median"] == 1 and figures["frame_ms_median"] == 2
        assert figures["views"] == 2 and figures["repeats"] == 4 and figures["visible_pixels_mean"] > 300
    again = frames.measure(Context(inputs, tmp_path, scale=0.1, done=set(rows)))
    assert [row.key for row in again if "ms_median" in str(row.figures)] == []


def test_a_network_whose_tensor_cores_are_wrong_is_timed_without_them(host, inputs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", stand_in(host, spoilt="points_tensor_kernel"))
    monkeypatch.setattr(frames, "SIDE", SIDE)
    _, check, timed, *_ = islice(frames.measure(Context(inputs, tmp_path, scale=0.1)), 3)
    assert "plain" in check.figures["kernel"] and timed.key == "frames/player/3dntc-near/plain"


def test_the_shaders_that_js_ships_are_drawn_with_the_network_of_the_stream(shells, streams, tmp_path):
    if shutil.which("node") is None:
        pytest.skip("there is no node, which puts the shaders of js/src together")
    arrays = prepare_frames.texf_arrays(streams["3dntc"], *bounding_sphere(shells.positions))
    frames_asset.save_arrays(tmp_path / "frames_player_3dntc.npz.xz", arrays)
    given = json.loads(frames_egl.write_shaders(tmp_path).read_text())["player_3dntc"]
    assert "void network(ivec3 position" in given["shader"] and "row_latents0" in given["shader"]
    first = np.frombuffer(base64.b64decode(given["block"]), np.float32)[: 16 * 13 * 16].reshape(16, 13, 4, 4)  # inputs by column
    expected = np.pad(frames_asset.layers_of(arrays["halves"])[0][0], ((0, 0), (0, 2)))
    assert np.allclose(first.transpose(0, 3, 1, 2).reshape(64, 52), expected)


def test_a_machine_without_egl_gets_one_sentence(tmp_path, monkeypatch):
    (tmp_path / "frames_glsl.json").write_text("{}")
    monkeypatch.setattr(frames.subprocess, "run", lambda *given, **options: subprocess.CompletedProcess(
        given, 1, '{"key": "frames/player/voxels/fragments", "figures": {}}\n', "Traceback\nException: no libEGL"))
    rows = list(frames._by_fragments(Context(tmp_path, tmp_path)))
    assert [row.key for row in rows] == ["frames/player/voxels/fragments", "frames/fragments"]
    assert rows[1].figures["skipped"] == "fragment shaders through EGL: Exception: no libEGL"


def test_without_inputs_one_sentence_says_so(tmp_path):
    (row,) = frames.measure(Context(tmp_path, tmp_path, device="cpu"))
    assert "prepare_frames.py" in row.figures["skipped"]
