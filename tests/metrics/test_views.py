"""Image metrics: SSIM and its gradient, rendered views by the MPEG protocol, angles, LPIPS, and texf-eval on top of them."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from shapes import painted_sphere, scene_of, square

from naive.ssim import ssim_mean
from texfcodec import EncodeOptions, InputError, decode
from texfcodec.cli import eval as eval_command
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.metrics.angular_error import angular_error
from texfcodec.metrics.perceptual import Lpips
from texfcodec.metrics.ssim import RADIUS, ssim, ssim_gradient, ssim_map
from texfcodec.metrics.views import compare_views, fields_of_faces, mesh_psnr_3d
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.shade import render_scene

REPOSITORY = Path(__file__).resolve().parents[2]


# SSIM


def noisy_pair(height, width, channels=3, seed=0, noise=20.0):
    """A smooth image with some flat areas, and the same with noise: float64 [H, W, C] in 0..255."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = [127 + 120 * np.sin(x * rng.uniform(0.02, 0.4) + y * rng.uniform(0.02, 0.4) + c) for c in range(channels)]
    a = np.clip(np.stack(waves, -1), 20, 235)
    return a, np.clip(a + rng.normal(0, noise, a.shape), 0, 255)


@pytest.mark.parametrize("dtype, tolerance", [(np.float64, 1e-9), (np.float32, 1e-4), (np.uint8, 1e-4)])
def test_ssim_is_scikit_images_inside(dtype, tolerance):
    from skimage.metrics import structural_similarity

    a, b = (np.rint(v).astype(dtype) for v in noisy_pair(90, 130))
    _, expected = structural_similarity(a.astype(np.float64), b.astype(np.float64), gaussian_weights=True, sigma=1.5, full=True,
                                        use_sample_covariance=False, data_range=255, channel_axis=2)
    inner = (slice(RADIUS, -RADIUS),) * 2
    assert np.abs(ssim_map(a, b) - expected)[inner].max() < tolerance
    mask = np.zeros(a.shape[:2], bool)
    mask[inner] = True
    assert ssim(a, b, mask) == pytest.approx(expected[inner].mean(), abs=tolerance)


@pytest.mark.parametrize("shape", [(13, 17, 3), (4, 30, 1), (70, 6, 2), (1, 1, 3)])
def test_ssim_agrees_with_the_naive_one_borders_included(shape):
    a, b = noisy_pair(*shape, seed=3)
    mask = np.random.default_rng(1).random(shape[:2]) < 0.3
    mask[-1, 0] = True
    planes = [np.moveaxis(v, 2, 0).tolist() for v in (a, b)]
    assert ssim(a, b, mask) == pytest.approx(ssim_mean(*planes, mask.tolist()), abs=1e-10)
    assert ssim(a.astype(np.float32), b.astype(np.float32), mask) == pytest.approx(ssim(a, b, mask), abs=1e-4)
    assert ssim_map(a, b)[mask].mean() == pytest.approx(ssim(a, b, mask), abs=1e-12)


def test_ssim_of_equal_images_is_one_and_its_gradient_nothing():
    a = noisy_pair(40, 50)[0].astype(np.float32)
    assert ssim(a, a) == pytest.approx(1, abs=1e-6)
    value, gradient = ssim_gradient(a, a)
    assert value == pytest.approx(1, abs=1e-6)
    assert np.abs(gradient).max() < 1e-3 * np.abs(ssim_gradient(a, noisy_pair(40, 50)[1])[1]).max()


def test_ssim_of_extreme_images_stays_in_range():
    black, white = np.zeros((30, 30, 3), np.float32), np.full((30, 30, 3), 255, np.float32)
    checks = np.float32(255) * (np.indices((30, 30)).sum(0) % 2)[:, :, None].repeat(3, 2).astype(np.float32)
    assert 0 < ssim(black, white) < 2e-4
    assert -1 <= ssim(checks, 255 - checks) < -0.9
    assert all(np.isfinite(ssim_gradient(a, b)[1]).all() for a in (black, checks) for b in (black, white, 255 - checks))


def test_ssim_does_not_depend_on_threads_or_on_what_is_far_from_the_mask():
    a, b = (v.astype(np.float32) for v in noisy_pair(200, 90))
    mask = np.zeros((200, 90), bool)
    mask[60:75, 40:60] = mask[150, 3] = True
    one, two = ssim_gradient(a, b, mask, threads=1), ssim_gradient(a, b, mask, threads=3)
    assert one[0] == two[0] == ssim(a, b, mask) and np.array_equal(one[1], two[1])
    near = np.zeros_like(mask)
    near[60 - RADIUS : 75 + RADIUS, 40 - RADIUS : 60 + RADIUS] = near[150 - RADIUS : 151 + RADIUS, : 4 + RADIUS] = True
    assert not one[1][~near].any() and one[1][near].any()
    other = np.where(near[:, :, None], b, 0).astype(np.float32)
    assert ssim(a, other, mask) == one[0] and np.array_equal(ssim_gradient(a, other, mask)[1], one[1])


@pytest.mark.parametrize("shape", [(80, 24, 3), (9, 31, 1)])
def test_ssim_gradient_is_that_of_finite_differences(shape):
    """At values of its own choice: corners, borders, mask edges and the rest."""
    a, b = noisy_pair(*shape, seed=5)
    rng = np.random.default_rng(2)
    mask = rng.random(shape[:2]) < 0.4
    mask[0, 0] = mask[-1, -1] = True
    _, gradient = ssim_gradient(a, b, mask)
    largest, step = np.abs(gradient).max(), 1e-3
    places = [(0, 0, 0), (shape[0] - 1, shape[1] - 1, 0), *zip(*(rng.integers(0, n, 60) for n in shape), strict=True)]
    for place in places:
        up, down = b.copy(), b.copy()
        up[place] += step
        down[place] -= step
        expected = (ssim(a, up, mask) - ssim(a, down, mask)) / (2 * step)
        assert gradient[place] == pytest.approx(expected, rel=1e-3, abs=1e-6 * largest)
    single = ssim_gradient(a.astype(np.float32), b.astype(np.float32), mask)[1]
    assert single.dtype == np.float32 and np.abs(single - gradient).max() < 1e-3 * largest


def test_a_step_up_the_gradient_raises_ssim():
    a, b = (v.astype(np.float32) for v in noisy_pair(64, 64))
    for _ in range(3):
        before, gradient = ssim_gradient(a, b)
        b = b + np.float32(3.0 / np.abs(gradient).max()) * gradient
        assert ssim(a, b) > before


@pytest.mark.parametrize("a, b, mask, word", [
    (np.zeros((5, 5, 3)), np.zeros((5, 4, 3)), None, "H, W, C"), (np.zeros((5, 5)), np.zeros((5, 5)), None, "H, W, C"),
    (np.zeros((0, 5, 3)), np.zeros((0, 5, 3)), None, "empty"), (np.zeros((5, 5, 3)),) * 2 + (np.ones((4, 5)), "mask"),
    (np.zeros((5, 5, 3)),) * 2 + (np.zeros((5, 5)), "no pixel"),
])  # fmt: skip
def test_ssim_refuses(a, b, mask, word):
    for function in (ssim, ssim_gradient):
        with pytest.raises(ValueError, match=word):
            function(a, b, mask)


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
    measure, (a, _) = Lpips(alexnet.path), noisy_pair(96, 128)
    noise = np.random.default_rng(4).normal(0, 1, a.shape)
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


def test_result_has_the_promised_form(ball, field):
    result = compare_views(ball, field, **PROTOCOL)
    assert set(result) == {"psnr", "ssim", "lpips", "views", "size", "pixels"}
    assert set(result["psnr"]) == {"rgb", "y", "u", "v", "yuv"} and (result["views"], result["size"]) == (5, 96)
    assert result["ssim"] is None and result["lpips"] is None and json.loads(json.dumps(result, allow_nan=False)) == result


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
    squares, pixels, similar = np.zeros(6), 0, 0.0
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
    r, g, b, y, u, v = squares / pixels
    expected = {"rgb": (r + g + b) / 3, "y": y, "u": u, "v": v, "yuv": (6 * y + u + v) / 8}
    result = compare_views(ball, other, **PROTOCOL, ssim=True)
    assert result["psnr"] == pytest.approx({k: 10 * math.log10(255**2 / m) for k, m in expected.items()}, abs=1e-9)
    assert result["pixels"] == pixels and result["ssim"] == pytest.approx(similar / pixels, abs=1e-5)


def test_quality_falls_with_the_error(ball):
    results = [compare_views(ball, brighter(ball, f), **PROTOCOL, ssim=True) for f in (0.98, 0.9, 0.6)]
    for name in ("rgb", "y", "u", "v", "yuv"):
        values = [r["psnr"][name] for r in results]
        assert values == sorted(values, reverse=True)
    assert results[0]["ssim"] > results[1]["ssim"] > results[2]["ssim"]


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
    from texfcodec.metrics.psnr_3d import measure

    both, report = lined_ball(ball), Report()
    flat = replace(both, faces=np.concatenate([both.faces, [[3, 3, 4]]]), face_material=np.append(both.face_material, 0),
                   corner_uv=np.concatenate([both.corner_uv, both.corner_uv[:1]]),
                   corner_color=np.concatenate([both.corner_color, both.corner_color[:1]]))  # fmt: skip
    made = encode_scene(flat, EncodeOptions(resolution=64, qp=22), report)
    texf = decode(made.data)
    found = fields_of_faces(flat, texf)
    assert len(texf.fields) == 2 and found[-1] == -1 and set(found[:-1]) == {0, 1}
    assert np.array_equal(found, made.face_field)
    assert measure(flat, texf, 3000, face_field=found)["y"] > measure(flat, texf, 3000)["y"] + 3
    away = replace(flat, positions=flat.positions[:, ::-1] * [1, 2, 1])
    assert fields_of_faces(away, texf) is None


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
    ball = painted_sphere(6)
    colours = np.zeros((len(ball.positions), 4))
    colours[ball.faces.ravel()] = ball.corner_color.reshape(-1, 4)
    head = f"ply\nformat ascii 1.0\nelement vertex {len(colours)}\n" + "".join(f"property float {c}\n" for c in "xyz")
    head += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + f"element face {len(ball.faces)}\n"
    rows = [f"{x} {y} {z} {r} {g} {b}" for (x, y, z), (r, g, b) in
            zip(ball.positions, (255 * colours[:, :3]).astype(int), strict=True)]  # fmt: skip
    rows += [f"3 {a} {b} {c}" for a, b, c in ball.faces]
    (folder / "ball.ply").write_text(head + "property list uchar int vertex_indices\nend_header\n" + "\n".join(rows) + "\n")
    data = encode(folder / "ball.ply", EncodeOptions(resolution=32, qp=24))
    (folder / "ball.texf").write_bytes(data)
    decode(data).save(folder / "ball.glb", texture_size=64)
    return folder


@pytest.fixture
def call(capsys):
    """call(arguments...) -> (exit code, stdout, stderr) of texf-eval, in this process."""
    from texfcodec.precompile import kernels_compiled, warm_up

    if not kernels_compiled():
        warm_up()

    def run(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            eval_command.main([str(a) for a in arguments])
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    return run


@pytest.mark.parametrize("other, samples", [("ball.texf", 2000), ("ball.glb", 2000)])
def test_json_follows_the_schema(call, files, monkeypatch, other, samples):
    monkeypatch.setattr("texfcodec.metrics.views.NEAREST_SAMPLES", 2000)
    code, out, err = call(files / "ball.ply", files / other, *SMALL, "--json")
    facts = json.loads(out)
    assert (code, err, out.count("\n")) == (0, "", 1)
    assert set(facts) == {"schema", "psnr", "ssim", "lpips", "psnr_3d", "views", "size", "pixels", "seconds", "shaded", "mipmaps",
                          "peak_memory_bytes", "warnings"}  # fmt: skip
    assert set(facts["psnr"]) == {"rgb", "y", "u", "v", "yuv"} and all(v > 20 for v in facts["psnr"].values())
    assert set(facts["psnr_3d"]) == {"y", "yuv611", "rgb", "samples"} and facts["psnr_3d"]["samples"] == samples
    assert 0.8 < facts["ssim"] < 1 and facts["lpips"] is None and (facts["views"], facts["size"]) == (4, 64)
    assert {"load", "views", "psnr_3d", "total"} <= set(facts["seconds"])


def test_stream_and_the_mesh_decoded_from_it_are_judged_alike(call, files):
    stream, mesh = (json.loads(call(files / "ball.ply", files / f"ball.{suffix}", *SMALL, "--no-3d", "--json")[1])["psnr"]
                    for suffix in ("texf", "glb"))  # fmt: skip
    assert all(abs(stream[name] - mesh[name]) < 3 for name in stream)


def test_summary_is_for_people_and_flags_leave_things_out(call, files):
    code, out, err = call(files / "ball.ply", files / "ball.texf", *SMALL)
    assert code == 0 and err == "" and "SSIM 0." in out and "3D-PSNR: Y " in out and "4 views of 64 x 64" in out
    code, out, _ = call(files / "ball.ply", files / "ball.texf", *SMALL, "--no-ssim", "--no-3d")
    assert code == 0 and "SSIM" not in out and "3D" not in out and "PSNR: RGB " in out
    assert call(files / "ball.ply", files / "ball.ply", *SMALL, "--no-3d")[1].count("exact") == 5
    assert call(files / "ball.ply", files / "ball.texf", *SMALL, "--quiet", "--no-3d") == (0, "", "")


def test_help_and_version_are_told(call):
    code, out, err = call("--help")
    assert code == 0 and err == "" and all(flag in out for flag in ("--lpips WEIGHTS", "--no-3d", "--no-ssim", "Exit codes"))
    assert call("--version")[1].startswith("texf-eval ")


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


def test_lpips_stands_in_the_report(call, files, alexnet):
    code, out, _ = call(files / "ball.ply", files / "ball.texf", *SMALL, "--no-3d", "--lpips", alexnet.path, "--json")
    assert code == 0 and json.loads(out)["lpips"] > 0


def test_stream_may_come_from_stdin(files):
    program = [sys.executable, "-m", "texfcodec.cli.eval", files / "ball.ply", "-", *SMALL, "--no-3d", "--json"]
    with open(files / "ball.texf", "rb") as stream:
        run = subprocess.run(program, cwd=REPOSITORY, stdin=stream, capture_output=True, check=False, timeout=120)
    assert run.returncode == 0 and json.loads(run.stdout)["psnr"]["y"] > 20


def test_empty_stream_is_a_coded_error(call, files):
    empty = encode_scene(scene_of(np.ones((3, 3)), [[0, 1, 2]]), EncodeOptions(allow_empty=True)).data
    assert len(decode(empty).faces) == 0
    (files / "empty.texf").write_bytes(empty)
    code, out, _ = call(files / "ball.ply", files / "empty.texf", *SMALL, "--json")
    assert (code, json.loads(out)["error"]["code"]) == (2, "TXF-I95")
