"""Image metrics: rendered views by the MPEG protocol, angles, LPIPS, and texf-eval on top of them."""

import json
import math
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from batches import write_ball
from shapes import painted_sphere, scene_of, square

from texfcodec import EncodeOptions, InputError, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.metrics.angular_error import angular_error
from texfcodec.metrics.face_match import decoded_faces
from texfcodec.metrics.perceptual import Lpips
from texfcodec.metrics.ssim import ssim
from texfcodec.metrics.views import compare_views, mesh_psnr_3d
from texfcodec.precompile import kernels_compiled, warm_up
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.shade import render_scene

# Angles


def test_angles_keep_their_digits_near_0_and_180_degrees():
    for angle in (1e-9, 1e-5, 30.0, 90.0, 180.0 - 1e-7, 180.0):
        got = [[math.cos(math.radians(angle)), math.sin(math.radians(angle)), 0.0]]
        result = angular_error([[1e-200, 0, 0]], np.array(got) * 1e200)
        assert result["mean_degrees"] == pytest.approx(angle, rel=1e-9) and result["samples"] == 1
    assert angular_error([[1, 2, 3]], [[2, 4, 6]])["mean_degrees"] < 1e-13


def test_angles_by_hand_and_by_weight():
    ref, got = [[1, 0, 0]] * 4, [[1, 0, 0], [0, 2, 0], [-1, 0, 0], [1, 1, 0]]
    plain = angular_error(ref, got)
    assert plain == {"mean_degrees": pytest.approx(78.75), "rms_degrees": pytest.approx(math.sqrt((90**2 + 180**2 + 45**2) / 4)),
                     "median_degrees": pytest.approx(45), "p95_degrees": pytest.approx(180),
                     "p99_degrees": pytest.approx(180), "samples": 4}  # fmt: skip
    weighted = angular_error(ref, got, [96, 2, 1, 1])
    assert weighted["mean_degrees"] == pytest.approx((2 * 90 + 180 + 45) / 100) and weighted["p95_degrees"] == 0


def test_a_reference_without_direction_is_left_out_and_a_result_without_one_is_180_degrees():
    bad = [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]]
    with pytest.raises(ValueError, match="no reference"):
        angular_error(bad, [[0, 0, 1]] * 3)
    result = angular_error([[0, 0, 1]] * 4, [*bad, [0, 0, 1]])
    assert result["mean_degrees"] == pytest.approx(135) and result["samples"] == 4


@pytest.mark.parametrize("ref, got, weights, word", [
    (np.ones((3, 3)), np.ones((2, 3)), None, "N, 3"), (np.ones((3, 2)), np.ones((3, 2)), None, "N, 3"),
    (np.ones((3, 3)), np.ones((3, 3)), [1, 1], "weights"), (np.ones((3, 3)), np.ones((3, 3)), [1, 1, -1], "negative"),
    (np.ones((3, 3)), np.ones((3, 3)), [0, 0, 0], "weight zero"), (np.ones((0, 3)), np.ones((0, 3)), None, "no reference"),
])  # fmt: skip
def test_angles_refuse(ref, got, weights, word):
    with pytest.raises(ValueError, match=word):
        angular_error(ref, got, weights)


# LPIPS


def test_lpips_without_its_packages_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "lpips", None)
    with pytest.raises(InputError, match=r"pip install texfcodec\[lpips\]") as caught:
        Lpips(tmp_path / "alex.pth")
    assert caught.value.code == "TXF-I96"


@pytest.fixture(scope="module")
def alexnet(tmp_path_factory):
    """A file of random AlexNet weights, and its state dict."""
    pytest.importorskip("lpips", reason="LPIPS is an optional extra: pip install texfcodec[lpips]")
    torch = pytest.importorskip("torch")
    from torchvision.models import alexnet as network

    torch.manual_seed(1)
    state, path = network(weights=None).state_dict(), tmp_path_factory.mktemp("weights") / "alex.pth"
    torch.save(state, path)
    return SimpleNamespace(path=path, state=state, save=torch.save)


def test_lpips_is_zero_for_equal_images_and_grows_with_noise(alexnet):
    measure, rng = Lpips(alexnet.path), np.random.default_rng(4)
    y, x, c = np.mgrid[:96, :128, :3]
    a, noise = 127 + 100 * np.sin(0.2 * x + 0.1 * y + c), rng.normal(0, 1, x.shape)
    images = [np.clip(np.rint(a + s * noise), 0, 255).astype(np.uint8) for s in (0, 3, 10, 40)]
    distances = [measure(images[0], image) for image in images]
    assert distances[0] == 0 and all(p < q for p, q in zip(distances[:-1], distances[1:], strict=True))
    assert measure(images[0].astype(np.float64), images[1]) == pytest.approx(distances[1], rel=1e-6)
    with pytest.raises(ValueError, match="64"):
        measure(a[:20], a[:20])


def test_lpips_refuses_files_that_are_not_alexnet(alexnet, tmp_path):
    def refused(path):
        with pytest.raises(InputError) as caught:
            Lpips(path)
        return caught.value.code, str(caught.value)

    assert refused(tmp_path / "missing.pth")[0] == "TXF-I97" and refused(tmp_path)[0] == "TXF-I97"
    for content in (b"", b"no weights", b"PK\3\4" + bytes(40)):
        (tmp_path / "bad.pth").write_bytes(content)
        assert refused(tmp_path / "bad.pth")[0] == "TXF-I98"
    key = "features.3.weight"
    cases = [[1, 2], {"a": 1}, {**alexnet.state, key: alexnet.state[key][:, :1]}, {**alexnet.state, key: 5}]
    for case in cases:
        alexnet.save(case, tmp_path / "bad.pth")
        assert refused(tmp_path / "bad.pth")[0] == "TXF-I98"
    assert key in refused(tmp_path / "bad.pth")[1]


# Views

PROTOCOL = {"views": 5, "size": 96}


@pytest.fixture(scope="module")
def ball():
    return painted_sphere(12)


@pytest.fixture(scope="module")
def field(ball):
    """The ball coded and decoded."""
    return decode(encode_scene(ball, EncodeOptions(resolution=64, qp=22)).data)


def brighter(scene, factor):
    return replace(scene, corner_color=scene.corner_color * np.float32([factor, factor, 1, 1]))


@pytest.mark.parametrize("side", ["ball", "field"])
def test_identical_sides_have_no_error(side, request):
    asset = request.getfixturevalue(side)
    result = compare_views(asset, asset, **PROTOCOL, ssim=True, lpips=lambda a, b: float(np.abs(a - 1.0 * b).max()))
    assert set(result["psnr"].values()) == {None} and result["lpips"] == 0
    assert result["ssim"] == pytest.approx(1, abs=1e-6)


def test_figures_are_those_of_the_protocol_step_by_step(ball):
    """Rendered pixel by pixel, with the mask, the pooling and the weights written out."""
    other = replace(brighter(ball, 0.8), positions=ball.positions * [1, 0.9, 1])
    centre, radius = bounding_sphere(ball.positions)
    squares, pixels, similar, outline, either = np.zeros(6), 0, 0.0, 0.0, 0
    for i in range(PROTOCOL["views"]):
        camera = orthographic(fibonacci_direction(i, PROTOCOL["views"]), centre, radius, PROTOCOL["size"])
        a, b = render_scene(ball, camera), render_scene(other, camera)
        image_a, image_b = a.image().astype(float), b.image().astype(float)
        both = np.isin(np.arange(camera.width * camera.height), np.intersect1d(a.pixel, b.pixel)).reshape(image_a.shape[:2])
        d = image_b[both] - image_a[both]
        luma = d @ [0.2126, 0.7152, 0.0722]
        u, v = (d[:, 2] - luma) / 1.8556, (d[:, 0] - luma) / 1.5748
        squares += [np.sum(x**2) for x in (*d.T, luma, u, v)]
        similar += ssim(image_a, image_b, both) * both.sum()
        pixels += int(both.sum())
        union = np.isin(np.arange(camera.width * camera.height), np.union1d(a.pixel, b.pixel)).reshape(image_a.shape[:2])
        outline += ((image_b - image_a)[union] ** 2).sum() / 3
        either += int(union.sum())
    r, g, b, y, u, v = squares / pixels
    expected = {"rgb": (r + g + b) / 3, "y": y, "u": u, "v": v, "yuv": (6 * y + u + v) / 8}
    result = compare_views(ball, other, **PROTOCOL, ssim=True)
    assert result["psnr"] == pytest.approx({k: 10 * math.log10(255**2 / m) for k, m in expected.items()}, abs=1e-9)
    assert result["union_psnr"]["rgb"] == pytest.approx(10 * math.log10(255**2 * either / outline), abs=1e-9)
    assert result["silhouette"]["pixels"] == either - pixels > 0
    assert result["pixels"] == pixels and result["ssim"] == pytest.approx(similar / pixels, abs=1e-5)


@pytest.mark.parametrize("shift", [(3, 0), (0, -5)])
def test_a_shifted_square_loses_and_gains_the_pixels_of_its_shift(shift):
    """The square is 64 / sqrt(2) pixels a side, 46 rows and columns of pixel centres, and brown on white."""
    source = scene_of(*square())
    pixel = 2 * bounding_sphere(source.positions)[1] / 64
    other = replace(source, positions=source.positions + pixel * np.array([*shift, 0]))
    result, moved = compare_views(source, other, views=1, size=64), max(map(abs, shift))
    rows = math.isqrt(compare_views(source, source, views=1, size=64)["pixels"])
    assert rows in (45, 46) and result["pixels"] == rows * (rows - moved)
    share = 2 * moved / (rows + moved)
    assert result["silhouette"] == {"lost": rows * moved, "gained": rows * moved, "pixels": 2 * rows * moved,
                                    "share": pytest.approx(share)}
    brown = render_scene(source, orthographic([0, 0, 1], *bounding_sphere(source.positions), 64)).image()[32, 32].astype(float)
    off = np.mean((255 - brown) ** 2)
    assert result["psnr"]["rgb"] is None and result["union_psnr"]["rgb"] == pytest.approx(10 * math.log10(255**2 / share / off))


def test_a_part_that_no_view_of_the_source_has_counts_as_gained():
    near, far = square(), square(side=0.25)
    both = scene_of(np.concatenate([near[0], far[0] + [0, 0.01, 0.25]]), np.concatenate([near[1], far[1] + 4]))
    one = scene_of(*near)
    up, side = compare_views(one, both, views=1, size=64), compare_views(one, both, views=4, size=64)
    assert up["silhouette"]["pixels"] == 0 and up["union_psnr"]["y"] is None  # the part is in front of the square
    assert side["silhouette"]["lost"] == 0 and side["silhouette"]["gained"] > 0 and side["union_psnr"]["y"] < 40
    again = compare_views(both, one, views=4, size=64)["silhouette"]
    assert again["gained"] == 0 and again["lost"] > 0


def test_result_does_not_depend_on_threads_and_views_are_told_in_order(ball, field):
    told = []
    one = compare_views(ball, field, **PROTOCOL, ssim=True, on_view=lambda *done: told.append(done))
    assert told == [(i, 5) for i in range(1, 6)]
    assert one == compare_views(ball, field, **PROTOCOL, ssim=True, threads=3)


def test_back_faces_of_double_sided_materials_are_culled_too(ball):
    doubled = replace(ball, materials=[replace(m, double_sided=True) for m in ball.materials])
    open_ball, open_doubled = (replace(s, faces=s.faces[::2], face_material=s.face_material[::2], corner_uv=s.corner_uv[::2],
                                       corner_color=s.corner_color[::2]) for s in (ball, doubled))  # fmt: skip
    results = [compare_views(a, b, **PROTOCOL) for a in (open_ball, open_doubled) for b in (open_ball, open_doubled)]
    assert all(r == results[0] for r in results) and set(results[0]["psnr"].values()) == {None}


def test_cancelling_stops_the_comparison(ball):
    def stop(done, _):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare_views(ball, ball, views=2000, size=64, on_view=stop)


def test_sides_that_show_no_common_pixel_are_refused():
    positions, faces = square()
    front = scene_of(positions, faces)
    with pytest.raises(InputError) as caught:
        compare_views(front, scene_of(positions, faces[:, ::-1]), **PROTOCOL)
    assert caught.value.code == "TXF-I95"
    away = scene_of(positions + 100, faces)
    with pytest.raises(InputError, match="TXF-I95"):
        compare_views(front, away, **PROTOCOL)
    assert compare_views(front, front, **PROTOCOL)["pixels"] > 0  # although half of the views see nothing


def test_degenerate_and_empty_meshes_are_refused_with_a_code(ball):
    point = scene_of(np.ones((3, 3)), [[0, 1, 2]])
    nothing = scene_of(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    for pair in ((point, point), (ball, point), (ball, nothing)):
        with pytest.raises(InputError):
            compare_views(*pair, **PROTOCOL)


def test_nan_uvs_are_the_renderers_origin_and_a_nan_colour_is_refused(ball, sample_scene):
    nan, zero = (replace(sample_scene, corner_uv=np.full_like(sample_scene.corner_uv, v)) for v in (np.nan, 0.0))
    assert set(compare_views(zero, nan, **PROTOCOL)["psnr"].values()) == {None}
    with pytest.raises(InputError) as caught:
        compare_views(ball, brighter(ball, np.nan), **PROTOCOL)
    assert caught.value.code == "TXF-I99"


@pytest.mark.parametrize("views, size", [(0, 10), (3, 0)])
def test_views_and_size_must_be_positive(ball, views, size):
    with pytest.raises(ValueError, match="at least one"):
        compare_views(ball, ball, views=views, size=size)


def test_lpips_is_the_mean_over_views(ball):
    seen = []

    def measure(a, b):
        assert a.dtype == b.dtype == np.uint8 and a.shape == b.shape == (96, 96, 3)
        seen.append(float(np.abs(a - 1.0 * b).mean()))
        return seen[-1]

    result = compare_views(ball, brighter(ball, 0.8), **PROTOCOL, lpips=measure)
    assert len(seen) == 5 and result["lpips"] == pytest.approx(np.mean(seen))


# Points of the surface, where faces must be found on the other side


def shuffled(scene):
    """The same mesh with its faces in another order, so that each has to be found."""
    order = np.random.default_rng(0).permutation(len(scene.faces))
    taken = {name: getattr(scene, name) for name in ("faces", "face_material", "corner_uv", "corner_color")}
    return replace(scene, **{name: None if array is None else array[order] for name, array in taken.items()})


def test_a_mesh_with_the_same_faces_is_asked_at_the_same_points(ball):
    assert mesh_psnr_3d(ball, ball, 3000)["y"] is None


def test_a_mesh_finds_its_own_colours(ball, sample_scene):
    for scene in (ball, sample_scene):
        result = mesh_psnr_3d(scene, shuffled(scene), 3000)
        assert result["samples"] == 3000 and (result["y"] is None or result["y"] > 55)
    assert mesh_psnr_3d(ball, shuffled(brighter(ball, 0.8)), 3000)["y"] < 40


def lined_ball(ball):
    """The ball with a lining: the same faces turned over, in another colour."""
    lining = replace(ball, faces=ball.faces[:, ::-1], corner_color=1 - 0.9 * ball.corner_color[:, ::-1])
    join = lambda name: np.concatenate([getattr(ball, name), getattr(lining, name)])
    names = ("faces", "face_material", "corner_uv", "corner_color")
    return replace(ball, **{name: join(name) for name in names})


def test_of_surfaces_on_each_other_the_one_that_faces_the_same_way_answers(ball):
    both = lined_ball(ball)
    result = mesh_psnr_3d(both, shuffled(both), 3000)
    assert result["y"] is None or result["y"] > 55


def test_each_face_of_the_source_finds_its_field(ball):
    from texfcodec import Report

    both, report = lined_ball(ball), Report()
    flat = replace(both, faces=np.concatenate([both.faces, [[3, 3, 4]]]), face_material=np.append(both.face_material, 0),
                   corner_uv=np.concatenate([both.corner_uv, both.corner_uv[:1]]),
                   corner_color=np.concatenate([both.corner_color, both.corner_color[:1]]))  # fmt: skip
    made = encode_scene(flat, EncodeOptions(resolution=64, qp=22), report)
    texf = decode(made.data)
    found, _ = decoded_faces(flat, texf)
    assert len(texf.fields) == 2 and found[-1] == -1 and (found[:-1] >= 0).all()
    assert np.array_equal(texf.face_field[found[:-1]], made.face_field[:-1]) and set(made.face_field[:-1]) == {0, 1}
    away = replace(flat, positions=flat.positions[:, ::-1] * [1, 2, 1])
    assert (decoded_faces(away, texf)[0] == -1).all()


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_mesh_colours_do_not_depend_on_scale(ball, scale):
    big, other = (replace(s, positions=s.positions * scale) for s in (ball, brighter(ball, 0.8)))
    found = mesh_psnr_3d(ball, shuffled(brighter(ball, 0.8)), 500)["y"]
    assert mesh_psnr_3d(big, shuffled(other), 500)["y"] == pytest.approx(found, abs=1e-3)


OFFICIAL = {"jpeg10": (33.813, 35.649, 40.759, 42.302, 36.534), "jpeg40": (39.422, 42.326, 44.627, 47.610, 42.978),
            "box512": (36.173, 36.963, 47.973, 52.371, 38.135)}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", OFFICIAL)
def test_psnr_is_within_a_hundredth_of_a_decibel_of_the_official_tool(shared_dir, name):
    from PIL import Image

    from texfcodec.io.load import load

    scene = load(shared_dir / "assets" / "bball_0001.glb")
    with Image.open(shared_dir / "anchors" / "image_metric" / f"{name}.png") as image:
        texture = replace(scene.textures[0], image=np.asarray(image.convert("RGBA")))
    psnr = compare_views(scene, replace(scene, textures=[texture]), threads=2)["psnr"]
    expected = dict(zip(("rgb", "y", "u", "v", "yuv"), OFFICIAL[name], strict=True))
    assert psnr == pytest.approx(expected, abs=0.01)


# texf-eval

SMALL = ("--views", "4", "--size", "64")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """ball.ply, and its stream and decoded GLB, in one folder."""
    from texfcodec import encode

    folder = tmp_path_factory.mktemp("eval")
    write_ball(folder)
    data = encode(folder / "ball.ply", EncodeOptions(resolution=32, qp=24))
    (folder / "ball.texf").write_bytes(data)
    decode(data).save(folder / "ball.glb", texture_size=64)
    return folder


@pytest.fixture
def call(call):
    """call(arguments...) of texf-eval, whose first run says that it compiles."""
    if not kernels_compiled():
        warm_up()
    return partial(call, "texf-eval")


@pytest.mark.parametrize("other", ["ball.texf", "ball.glb"])
def test_json_follows_the_schema(call, files, monkeypatch, other):
    monkeypatch.setattr("texfcodec.metrics.views.NEAREST_SAMPLES", 2000)
    code, out, err = call(files / "ball.ply", files / other, *SMALL, "--json")
    facts = json.loads(out)
    assert (code, err, out.count("\n")) == (0, "", 1)
    assert set(facts) == {"schema", "psnr", "ssim", "lpips", "psnr_3d", "views", "size", "pixels", "seconds", "shaded", "mipmaps",
                          "union_psnr", "silhouette", "surface", "peak_memory_bytes", "warnings", "remarks"}  # fmt: skip
    assert set(facts["surface"]) == {"d1", "d2", "peak", "hausdorff"} and facts["surface"]["d1"]["psnr"] > 60
    assert set(facts["psnr"]) == {"rgb", "y", "u", "v", "yuv"} and all(v > 20 for v in facts["psnr"].values())
    assert set(facts["psnr_3d"]) == {"y", "yuv611", "rgb", "samples"} and facts["psnr_3d"]["samples"] == 2000
    assert 0.8 < facts["ssim"] < 1 and facts["lpips"] is None and (facts["views"], facts["size"]) == (4, 64)
    assert {"load", "views", "psnr_3d", "surface", "total"} <= set(facts["seconds"])


def test_stream_and_the_mesh_decoded_from_it_are_judged_alike(call, files):
    stream, mesh = (json.loads(call(files / "ball.ply", files / f"ball.{suffix}", *SMALL, "--no-3d", "--json")[1])["psnr"]
                    for suffix in ("texf", "glb"))  # fmt: skip
    assert all(abs(stream[name] - mesh[name]) < 3 for name in stream)


def test_summary_is_for_people_and_flags_leave_things_out(call, files):
    code, out, err = call(files / "ball.ply", files / "ball.texf", *SMALL)
    assert code == 0 and err == "" and "SSIM 0." in out and "3D-PSNR: Y " in out and "4 views of 64 x 64" in out
    code, out, _ = call(files / "ball.ply", files / "ball.texf", *SMALL, "--no-ssim", "--no-3d")
    assert code == 0 and "SSIM" not in out and "3D" not in out and "PSNR: RGB " in out
    assert call(files / "ball.ply", files / "ball.ply", *SMALL, "--no-3d")[1].count("exact") == 8
    assert call(files / "ball.ply", files / "ball.texf", *SMALL, "--quiet", "--no-3d") == (0, "", "")


@pytest.mark.parametrize("flags", [("--views", "0"), ("--size", "8"), ("--threads", "-1"), ("--nonsense",), ("--views", "x")])
def test_wrong_command_line_is_exit_1(call, files, flags):
    code, out, err = call(files / "ball.ply", files / "ball.texf", *flags, "--json")
    assert (code, json.loads(out)["error"]["code"], err) == (1, "TXF-C01", "")


@pytest.mark.parametrize("source, other, expected", [
    ("missing.ply", "ball.texf", (2, "TXF-I01")), ("ball.ply", "missing.texf", (2, "TXF-I01")),
    ("ball.ply", "missing.glb", (2, "TXF-I01")), ("ball.texf", "ball.texf", (2, "TXF-I05")), ("ball.ply", ".", (2, "TXF-I02")),
    ("ball.ply", "cut.texf", (3, "TXF-S02")), ("ball.ply", "away.ply", (2, "TXF-I95")),
])  # fmt: skip
def test_bad_input_is_a_coded_error(call, files, source, other, expected):
    (files / "cut.texf").write_bytes((files / "ball.texf").read_bytes()[:-3])
    text = (files / "ball.ply").read_text().splitlines()
    start = text.index("end_header") + 1
    rows = [line.split(maxsplit=1) for line in text[start:]]
    away = [f"{float(x) + 9} {rest}" if rest.count(" ") == 4 else f"{x} {rest}" for x, rest in rows]
    (files / "away.ply").write_text("\n".join(text[:start] + away) + "\n")
    code, out, err = call(files / source, files / other, *SMALL, "--json")
    assert (code, json.loads(out)["error"]["code"]) == expected and err == ""
    code, out, err = call(files / source, files / other, *SMALL)
    assert code == expected[0] and out == "" and err.startswith(f"error {expected[1]}: ") and err.count("\n") == 1


def test_lpips_is_refused_before_any_work(call, files, monkeypatch):
    monkeypatch.setitem(sys.modules, "lpips", None)
    monkeypatch.setattr("texfcodec.io.load.load", lambda *a, **k: pytest.fail("loaded all the same"))
    code, _, err = call(files / "ball.ply", files / "ball.texf", *SMALL, "--lpips", files / "alex.pth")
    assert code == 2 and "texfcodec[lpips]" in err and err.count("\n") == 1


def test_empty_stream_is_a_coded_error(call, files):
    empty = encode_scene(scene_of(np.ones((3, 3)), [[0, 1, 2]]), EncodeOptions(allow_empty=True)).data
    assert len(decode(empty).faces) == 0
    (files / "empty.texf").write_bytes(empty)
    code, out, _ = call(files / "ball.ply", files / "empty.texf", *SMALL, "--json")
    assert (code, json.loads(out)["error"]["code"]) == (2, "TXF-I95")
