"""everyday of tools/bench: the envelope of the rivals, what Draco and the images cost, and our points against them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere, sphere

from texfcodec.metrics.views import compare_views
from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench import everyday, everyday_envelope, everyday_rivals
from tools.bench.everyday_envelope import bd_rate_against, compacted, curves_of, envelope, front, point_differences
from tools.bench.everyday_points import setting_of
from tools.bench.everyday_views import MetricViews

STEEP, SHALLOW = ("avif", 1, 12), ("webp", 2, 10)
TABLE = {"bball_0001": -28, "ycb_scissors": -20, "waterbottle_pbr": -17, "vintage_fan": 1, "cat_webp": 28, "damaged_helmet": 330}
FEW = {"avif": {1: (40,), 2: (40,)}, "webp": {1: (50,)}, "jpeg": {1: (60,)}}


def line(start, slope):
    """(bytes, PSNR) pairs from 30 to 36 dB: 100 * 2**start bytes at 30 dB, slope doublings per dB."""
    return [(100 * 2.0 ** (start + slope * (y - 30)), float(y)) for y in range(30, 37)]


def rival_points(*curves):
    """Rival points of ((codec, scale, uv_bits), pairs)."""
    return [{"codec": c, "scale": s, "uv_bits": b, "total_bytes": size, "y": y, "rgb": y, "yuv": y}
            for (c, s, b), pairs in curves for size, y in pairs]


def crossing():
    """Two curves that cross at 32 dB: doubling every dB, and every second dB from twice as much."""
    return rival_points((STEEP, line(0, 1)), (SHALLOW, line(1, 0.5)))


def textured_sphere(images=1, spread=1.0, **kind):
    """Sphere of rows with a material each of `images` distinct pictures, UVs over `spread` and off zero."""
    positions, faces = sphere(6)
    rng = np.random.default_rng(2)
    wave = 128 + 90 * np.sin(np.mgrid[:32, :48].sum(axis=0)[..., None] / (3.0, 5.0, 7.0, 9.0))
    textures = [Texture(np.clip(wave + 20 * n, 0, 255).astype(np.uint8)) for n in range(images)]
    uv = spread * (rng.random((len(positions), 2)) - 0.3)[faces]
    materials = [Material(f"m{n}", texture=n, **kind) for n in range(images)]
    return Scene(positions, faces, np.arange(len(faces)) % images, uv, None, materials, textures)


# The envelope.


@pytest.mark.parametrize("interpolation", everyday_envelope.INTERPOLATIONS)
def test_the_least_curve_counts_at_every_psnr(interpolation):
    ours = line(-1, 1)  # half of the steep curve: -1 doubling up to 32 dB, from there to 36 dB rising to +1
    rate = bd_rate_against(curves_of(crossing(), "y"), ours, interpolation)
    assert rate == pytest.approx(100 * (2 ** (-1 / 3) - 1), abs=1e-3)
    points = [{"total": size, "y": y} for size, y in ours]
    assert point_differences(curves_of(crossing(), "y"), points, "y", interpolation) == pytest.approx(
        [-50, -50, -50, 100 * (2**-0.5 - 1), 0, 100 * (2**0.5 - 1), 100])


def test_only_the_common_range_of_psnr_counts():
    curves = curves_of(rival_points((STEEP, line(0, 1))), "y")
    ours = [(size, y + 3) for size, y in line(-2, 1)]  # 33 to 39 dB, 2 + 3 doublings less
    assert bd_rate_against(curves, ours) == pytest.approx(100 * (2**-5 - 1))
    assert bd_rate_against(curves, [(size, y + 7) for size, y in line(0, 1)]) is None
    beyond = [{"total": 50, "y": 29.0}, {"total": 50, "y": 36.5}, {"total": 50, "y": None}]
    assert point_differences(curves, beyond, "y") == [pytest.approx(-50), None, None]


def test_a_chord_over_a_knee_is_nobodys():
    knee = [(100, 30.0), (1600, 31.0), (3200, 36.0)]
    at = np.log2(np.exp(envelope(curves_of(rival_points((STEEP, knee)), "y"), np.array([31.0]), "linear")[0]) / 100)
    assert at == pytest.approx([4]) and at > 1  # the chord from 30 to 36 dB is at 5/6


def test_a_smaller_and_better_point_of_another_curve_serves_below_its_own_range():
    curves = curves_of(rival_points((STEEP, [(400, 28.0), (800, 34.0)]), (SHALLOW, [(100, 30.0), (900, 33.0)])), "y")
    psnr = np.array([28.0, 29.0, 30.0, 34.0, 34.1])
    np.testing.assert_allclose(np.exp(envelope(curves, psnr)[0]), [100, 100, 100, 800, np.inf])


def test_points_that_are_larger_and_not_better_are_left_out():
    ours = line(-1, 1)
    worse = [(ours[3][0] * 1.5, ours[3][1] - 0.1), (ours[5][0] * 1.1, ours[5][1])]
    assert front([*worse, *reversed(ours)]) == ours
    curves = curves_of(crossing(), "y")
    assert bd_rate_against(curves, ours + worse) == bd_rate_against(curves, ours)


def test_compacting_keeps_the_envelope_and_drops_the_rest():
    hopeless = (("jpeg", 1, 12), line(3, 1))
    record = {"points": crossing() + rival_points(hopeless)}
    kept = compacted(record)["points"]
    assert {p["codec"] for p in kept} == {"avif", "webp"} and len(kept) == 14
    psnr = np.linspace(30, 36, 77)
    for interpolation in everyday_envelope.INTERPOLATIONS:
        np.testing.assert_array_equal(*(envelope(curves_of(points, "y"), psnr, interpolation)[0]
                                        for points in (kept, record["points"])))


def test_the_table_of_the_anchors_comes_out(shared_dir):
    """The six BD-rates that stand in the anchors' README, from the points beside them."""
    records = everyday_envelope.read_records([shared_dir / "anchors/everyday"], "codec")
    for name, known in TABLE.items():
        ours = [(p["total"], p["y"]) for p in records[name]["texf_2026_11_22"]]
        assert bd_rate_against(curves_of(records[name]["points"], "y"), ours) == pytest.approx(known, abs=0.6)


# Draco and images.


@pytest.mark.parametrize("bits", everyday_rivals.UV_BITS)
@pytest.mark.parametrize("scene", [textured_sphere(), textured_sphere(3, 40.0), textured_sphere(spread=0.0)])
def test_draco_gives_every_uv_back_as_the_integer_it_was(scene, bits):
    rival = everyday_rivals.rival_of(scene)
    uv, faces = everyday_rivals.quantise_uv(rival, bits), rival.scene.faces
    assert uv.min() == 0 and uv.max() == ((1 << bits) - 1) * bool(np.ptp(scene.corner_uv))
    data = everyday_rivals.enc_mesh(rival.lattice, faces, uv, bits, None)
    decoded = np.concatenate(everyday_rivals.dec_mesh(data, bits), axis=2)
    np.testing.assert_array_equal(*(turned(a) for a in (decoded, np.concatenate([rival.lattice[faces], uv], axis=2))))
    back = everyday_rivals.dequantise_uv(rival, uv, bits)
    side = everyday_rivals.uv_boxes(rival)[1].max()
    assert np.abs(back - rival.scene.corner_uv).max() <= 0.5001 * side / ((1 << bits) - 1)


def turned(corners):
    """Faces in one order, each from its first corner on: int64 [F, 3 C] of [F, 3, C]."""
    weights = np.array([1, 1 << 20, 1 << 40])
    start = (corners[:, :, :3] @ weights).argmin(axis=1)
    rows = np.take_along_axis(corners, ((start[:, None] + np.arange(3)) % 3)[:, :, None], axis=1).reshape(len(corners), -1)
    return rows[np.lexsort(rows.T)]


def test_equal_images_count_once_and_those_that_no_face_uses_do_not():
    scene = textured_sphere(3)
    scene.textures[1] = Texture(scene.textures[0].image.copy())
    scene.textures.append(Texture(np.zeros((8, 8, 4), np.uint8)))
    rival = everyday_rivals.rival_of(scene)
    assert rival.content[0] == rival.content[1] != rival.content[2] and rival.content[3] is None and len(rival.images) == 2
    decoded, size = everyday_rivals.coded_images(rival, "webp", 2, 50, 1)
    alone = [len(everyday_rivals.enc_image(everyday_rivals.shrunk(i, 2, False), "webp", 50)) for i in rival.images.values()]
    assert size == sum(alone) and {d.shape for d in decoded.values()} == {(16, 24, 4)}


def test_alpha_counts_where_it_shows_and_jpeg_is_out_then():
    opaque, blend = (everyday_rivals.rival_of(scene) for scene in (textured_sphere(), crossing_sheets()))
    assert not opaque.with_alpha and len(blend.with_alpha) == 1
    assert {codec for codec, *_ in everyday_rivals.plan(opaque, FEW)} == {"avif", "webp", "jpeg"}
    assert {codec for codec, *_ in everyday_rivals.plan(blend, FEW)} == {"avif", "webp"}
    decoded, _ = everyday_rivals.coded_images(blend, "webp", 1, 50, 1)
    assert all((d[:, :, 3] != 255).any() for d in decoded.values())


def test_grey_images_are_coded_as_grey():
    grey = np.repeat(textured_sphere().textures[0].image[:, :, :1], 4, axis=2)
    assert everyday_rivals.shrunk(grey, 1, False).mode == "L" and everyday_rivals.shrunk(grey, 1, True).mode == "RGBA"


@pytest.mark.parametrize("make", [textured_sphere, crossing_sheets, painted_sphere])
def test_variants_are_measured_as_compare_views_measures_them(make):
    scene = make()
    rival = everyday_rivals.rival_of(scene)
    mesh = everyday_rivals.mesh_of(rival, 10 if rival.images else 0, 4 if rival.is_coloured else None)
    decoded = {key: image // 16 * 16 for key, image in rival.images.items()}
    variant = everyday_rivals.with_images(mesh.scene, rival, decoded)
    got = MetricViews(scene, rival.scene, views=3, size=64).psnr(variant)
    known = compare_views(scene, variant, views=3, size=64)["psnr"]
    assert got == pytest.approx({name: known[name] for name in ("y", "rgb", "yuv")}, abs=1e-3) and got["y"] < 45


def test_curves_count_draco_and_images(monkeypatch):
    monkeypatch.setattr(everyday_rivals, "MetricViews", lambda *a: MetricViews(*a, views=2, size=64))
    record = everyday_rivals.curves(textured_sphere(2), "ball", FEW, (10, 14))
    assert (record["asset"], record["textures"]) == ("ball", [[48, 32]] * 2) and len(record["points"]) == 8
    draco = record["draco_bytes"]
    assert draco["positions only"] < draco["with 10-bit UVs"] < draco["with 14-bit UVs"]
    for p in record["points"]:
        assert p["total_bytes"] - p["image_bytes"] == draco[f"with {p['uv_bits']}-bit UVs"]
        assert 10 < p["y"] <= record["ceiling"][str(p["uv_bits"])]["y"]


def test_an_asset_without_images_has_draco_with_its_colours(monkeypatch):
    monkeypatch.setattr(everyday_rivals, "MetricViews", lambda *a: MetricViews(*a, views=2, size=64))
    points = everyday_rivals.curves(painted_sphere(), "ball", FEW)["points"]
    assert {p["codec"] for p in points} == {"draco"} and [p["quality"] for p in points] == [3, 4, 5, 6, 7, 8, 10, 12]
    assert all(p["image_bytes"] == 0 for p in points) and (np.diff([p["y"] for p in points]) > 0).all()
    plain = replace(painted_sphere(), corner_color=None)
    assert [p["quality"] for p in everyday_rivals.curves(plain, "ball", FEW)["points"]] == [0]


def test_draco_carries_wide_and_narrow_colours_exactly():
    import DracoPy

    rival = everyday_rivals.rival_of(painted_sphere())
    for bits in (8, 12):  # Draco's own colours hold bytes; above that a generic attribute
        colour = everyday_rivals.quantise_colour(rival, bits)
        mesh = DracoPy.decode(everyday_rivals.enc_mesh(rival.lattice, rival.scene.faces, None, 0, colour))
        values = mesh.colors if bits == 8 else mesh.attributes[0]["data"]
        known = np.concatenate([rival.lattice[rival.scene.faces], colour[:, :, : np.shape(values)[1]]], axis=2)
        assert np.shape(values)[1] == 3  # alpha is there, but the material is opaque
        got = np.concatenate([np.asarray(mesh.points)[mesh.faces], np.asarray(values)[mesh.faces]], axis=2).astype(np.int64)
        np.testing.assert_array_equal(turned(got), turned(known))


# Ours, and the command line.


def test_settings_have_the_type_of_their_option():
    assert setting_of("chroma_qp_offset=-2") == ("chroma_qp_offset", -2) and setting_of("target_psnr=40") == ("target_psnr", 40.0)
    assert setting_of("lossless=true") == ("lossless", True) and setting_of("effort=best") == ("effort", "best")
    for wrong in ("nothing=1", "effort", "lossless=maybe", "qp=low"):
        with pytest.raises(SystemExit, match=wrong.split("=")[0]):
            setting_of(wrong)


def test_compare_prints_a_row_per_asset_then_mean_and_median(tmp_path, capsys):
    rivals, ours = tmp_path / "rivals", tmp_path / "rivals/before.json"
    rivals.mkdir()
    for name in ("a", "b", "lonely"):
        (rivals / f"{name}.json").write_text(json.dumps({"asset": name, "points": rival_points((STEEP, line(0, 1)))}))
    points = {name: [{"rate": f"r{n:02}", "total": size, "y": y} for n, (size, y) in enumerate(line(start, 1))]
              for name, start in (("a", -1), ("b", 1))}
    points["a"].append({"rate": "r99", "total": 999, "y": 30.0})
    everyday.write_json({name: {"asset": name, "points": p} for name, p in points.items()}, ours)
    everyday.main(["compare", "--anchors", str(rivals), "--points", str(ours)])
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [row.strip("| ").split(" | ")[0] for row in rows] == ["a", "b", "mean of 2", "median"]
    assert [row.split("|")[-2].strip() for row in rows] == ["-50.0 %", "+100.0 %", "+25.0 %", "+25.0 %"]
    assert "r00 50.0 B 30.0 dB -50 %" in rows[0] and "r99* 999 B" in rows[0]


def test_rows_of_rate_points_are_read_as_points(tmp_path):
    rows = [{"asset": "a", "group": group, "options": {"rate": rate}, "bytes": {"total": size},
             "image": {"psnr": {"y": 30.0, "rgb": 29.0, "yuv": 31.0, "u": 40.0}}}
            for group, rate, size in (("TexF auto", "r01", 100), ("TexF texels", "r01", 90), ("TexF auto", "r02", 200))]
    path = tmp_path / "rows.jsonl"
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert everyday_envelope.read_records([path], "rate") == {"a": {"points": [
        {"rate": rate, "total": size, "y": 30.0, "rgb": 29.0, "yuv": 31.0} for rate, size in (("r01", 100), ("r02", 200))]}}


def test_measured_points_have_the_bytes_of_the_stream():
    from tools.bench.everyday_points import point

    p = point(painted_sphere(), "r01", {"resolution": 64, "qp": 30}, 1)
    assert set(p) == {"rate", "total", "geometry", "attributes", "y", "rgb", "yuv", "encode_seconds"}
    assert p["total"] > p["geometry"] + p["attributes"] > 0 and 20 < p["y"] < 60
