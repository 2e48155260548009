"""Rate control: what is promised is kept, with few encodes, and said."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from shapes import painted_sphere

from texfcodec import EncodeOptions, InputError, Report, decode, inspect
from texfcodec.encoder.caches import Caches
from texfcodec.encoder.dry_run import estimate
from texfcodec.encoder.encode import Encoder, encode_scene
from texfcodec.encoder.place.stage import OverBudget
from texfcodec.encoder.search import (
    FIRST_QP,
    GAP,
    LAST_QP,
    OVER,
    SIZE,
    UNUSED,
    VIEWS,
    Trial,
    _Search,
    encode_to_target,
    least_bytes,
    next_place,
    slope_of,
)
from texfcodec.encoder.write import write
from texfcodec.metrics.psnr_3d import measure
from texfcodec.metrics.views import ViewSettings, compare_views
from texfcodec.render.environment import DAYLIGHT
from texfcodec.scene.scene import ALPHA_BLEND, Material, Scene, Texture

SAMPLES = 20_000


@pytest.fixture(autouse=True)
def fewer_samples(monkeypatch):
    monkeypatch.setattr("texfcodec.encoder.search.SEARCH_SAMPLES", SAMPLES)


@pytest.fixture(scope="module")
def ribbon():
    """A ribbon of 1 by 0.02 with a smooth random texture: small at any K."""
    rng, n = np.random.default_rng(1), 20
    x = np.linspace(0, 1, n)
    wave = 0.05 * np.sin(6 * x)
    positions = np.concatenate([np.stack([x, 0 * x, wave], 1), np.stack([x, 0.02 + 0 * x, wave], 1)])
    i = np.arange(n - 1)
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    uv = np.concatenate([np.stack([x, 0 * x], 1), np.stack([x, 1 + 0 * x], 1)])[faces]
    noise = np.cumsum(rng.normal(0, 9, (12, 512, 4)), axis=1)
    image = np.clip(128 + noise - noise.mean(1, keepdims=True), 0, 255).astype(np.uint8)
    return Scene(positions, faces, np.zeros(len(faces), np.int64), uv, None, [Material(texture=0)], [Texture(image)])


@pytest.fixture(scope="module")
def sheet():
    """A square with 256 by 256 texels of noise of every size: no step of coding shows much of it at once."""
    rng = np.random.default_rng(2)
    noise = sum(2 * size * gaussian_filter(rng.normal(0, 9, (256, 256, 4)), (size, size, 0)) for size in (1, 2, 4, 8))
    image = np.clip(128 + noise, 0, 255).astype(np.uint8)
    image[..., 3] = 255
    corner = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    positions = np.column_stack([corner, 0.1 * corner[:, 0]])
    return Scene(positions, faces, np.zeros(2, np.int64), corner[faces], None, [Material(texture=0)], [Texture(image)])


@pytest.mark.parametrize("share", [0.35, 1.0, 2.0])
def test_budget_is_kept_and_used_but_for_three_hundredths(ribbon, share):
    sizes = encode_scene(ribbon, EncodeOptions(rate="r03")).sizes
    budget = sizes["geometry"] + sizes["other"] + round(share * sizes["attributes"])
    encoded = encode_to_target(ribbon, EncodeOptions(target_bytes=budget), Report())
    assert (1 - UNUSED) * budget <= len(encoded.data) == encoded.sizes["total"] <= budget
    rows = encoded.choices["search"]
    chosen = next(row for row in rows if row["bytes"] == len(encoded.data))
    assert chosen["psnr_y"] == pytest.approx(encoded.psnr_3d["y"], abs=1e-3) and math.floor(chosen["qp"]) == encoded.qp
    assert chosen["faces"] == encoded.counts["faces"] and chosen["position_bits"] == decode(encoded.data).position_bits
    assert chosen["bytes"] == max(row["bytes"] for row in rows if row["bytes"] <= budget) and len(rows) <= 8
    assert inspect(encoded.data)["resolution"] == encoded.resolution


@pytest.mark.parametrize("target", [30.0, 36.0])
def test_quality_is_met_and_hardly_exceeded(ribbon, target):
    encoded = encode_to_target(ribbon, EncodeOptions(target_psnr=target), Report())
    again = measure(ribbon, decode(encoded.data), SAMPLES)
    assert target <= again["y"] <= target + OVER and math.isclose(again["y"], encoded.psnr_3d["y"])


@pytest.mark.parametrize("of, settings", [("flat", ViewSettings()), ("lit", ViewSettings(environment=DAYLIGHT))])
def test_quality_may_be_that_of_pictures(sheet, of, settings):
    encoded = encode_to_target(sheet, EncodeOptions(target_psnr=34.0, target_psnr_of=of), Report())
    seen = compare_views(sheet, decode(encoded.data), VIEWS, SIZE, settings=settings)
    assert 34.0 <= seen["psnr"]["y"] <= 34.15
    assert all(row["psnr_of"] == of for row in encoded.choices["search"])


@pytest.mark.parametrize("jump", range(29, 37))
def test_a_target_between_what_two_plans_reach_is_met_by_the_better_one(sheet, monkeypatch, jump):
    """A plan from one QP on is 4 dB worse: neither alone passes the target, which lies between what both reach at that QP."""
    target = 60 - 0.45 * jump - 2.0
    made = []

    def plan_of(search, qp, report):
        made.append(qp)
        coder = SimpleNamespace(planes=SimpleNamespace(has_fractions=True))
        return SimpleNamespace(loss=4.0 * (qp >= jump), is_uniform=False, price=coder)

    def encode(search, planned, qp, planning):
        encoded = SimpleNamespace(sizes={"total": round(1e5 * 2 ** (-qp / 6) / (1 + planned.loss))}, data=b"", values=[])
        trial = Trial(encoded=encoded, qp=qp, position_bits=14, psnr=60 - 0.45 * qp - planned.loss, psnr_of="flat",
                      report=Report(), seconds=0.0)
        search.trials.append(trial)
        if search.target.is_met(trial) and search.target.is_better(trial, search.best):
            search.best = trial
        return trial

    monkeypatch.setattr(_Search, "_plan", plan_of)
    monkeypatch.setattr(_Search, "_encode", encode)
    search = _Search(sheet, EncodeOptions(target_psnr=target, target_psnr_of="flat"), Report())
    search.run()
    assert target <= search.best.psnr <= target + OVER
    assert len(made) <= 4 and len(search.trials) <= 8


def test_a_fraction_of_a_qp_is_between_two_qps(ribbon):
    planned = Encoder(scene=ribbon).filled(EncodeOptions(qp=FIRST_QP, support="texels"), Report())
    sizes = [write(planned.between(FIRST_QP + part), Report()).sizes["attributes"] for part in (0, 0.3, 0.7, 1)]
    assert sizes[0] > sizes[2] > sizes[3] and sizes[3] < sizes[1] < 1.005 * sizes[0]  # a third of a step may be lost in the noise
    assert sizes[0] == write(planned, Report()).sizes["attributes"]


@pytest.mark.parametrize("qp", [24, 33])
def test_a_plan_is_the_same_with_what_others_have_left_in_the_caches(qp):
    scene = painted_sphere(16)
    encoder = Encoder(scene=scene, caches=Caches.of_search())
    encoder.filled(EncodeOptions(qp=FIRST_QP), Report())
    plans = [one.filled(EncodeOptions(qp=qp), Report()) for one in (encoder, Encoder(scene=scene))]
    assert len({write(one, Report()).data for one in plans}) == 1


@pytest.mark.slow
@pytest.mark.parametrize("support", ["auto", "voxels"])
@pytest.mark.parametrize("target", ["bytes", "psnr"])
def test_unreachable_target_names_the_best(ribbon, target, support):
    report, least = Report(), sum(least_bytes(ribbon, EncodeOptions()))
    options = {"target_bytes": least} if target == "bytes" else {"target_psnr": 99.0}  # no room for any value, or out of reach
    with pytest.raises(InputError) as raised:
        encode_to_target(ribbon, EncodeOptions(support=support, **options), report)
    error, told = raised.value, raised.value.details
    assert error.code == "TXF-I51" and {"value", "best", "qp"} <= set(told) and "None" not in str(error)
    measure, best = ("bytes", min) if "target_bytes" in options else ("psnr_y", max)
    row = best(report.trials, key=lambda r: r[measure])
    assert told["best"] == round(row[measure], 2) and told["qp"] == row["qp"] and told.get("resolution") == row["resolution"]


@pytest.mark.parametrize("bits", [None, 10])
def test_a_budget_below_the_geometry_is_refused_before_anything_is_probed(ribbon, bits):
    report, options = Report(), EncodeOptions(target_bytes=100, position_bits=bits)
    with pytest.raises(InputError, match="geometry alone takes") as raised:
        encode_to_target(ribbon, options, report)
    _, geometry = least_bytes(ribbon, options)
    assert raised.value.code == "TXF-I51" and raised.value.details == {"value": 100, "allowed": f"> {geometry}"}
    assert set(report.seconds) == {"geometry"} and not report.trials


@pytest.mark.parametrize("support", ["voxels", "texels"])
def test_no_stream_is_smaller_than_the_least_bytes(ribbon, support):
    header, geometry = least_bytes(ribbon, EncodeOptions())
    made = encode_scene(ribbon, EncodeOptions(resolution=64, qp=63, support=support))
    assert made.sizes["other"] > header and made.sizes["geometry"] > geometry


def test_a_budget_that_geometry_takes_up_is_seen_before_colours_are_brought_over(ribbon):
    """Where the first look leaves doubt, geometry as it is coded decides."""
    report, options = Report(), EncodeOptions(rate="r03", support="voxels", position_bits=14)
    with pytest.raises(OverBudget) as raised:
        Encoder(scene=ribbon).filled(options, report, budget=least_bytes(ribbon, options)[1])
    assert raised.value.geometry == least_bytes(ribbon, options)[1]
    assert "geometry" in report.seconds and not {"voxelise", "transfer", "refine"} & set(report.seconds)


def test_warnings_of_an_asset_come_with_whichever_trial_is_kept(ribbon):
    """They come up with the plan, not with the trial that is kept."""
    veil = Material("veil", np.array([1, 1, 1, 0.2]), alpha_mode=ALPHA_BLEND)
    near = ribbon.positions + [0, 0, 0.0005]
    double = replace(ribbon, positions=np.concatenate([ribbon.positions, near]), materials=[*ribbon.materials, veil],
                     faces=np.concatenate([ribbon.faces, ribbon.faces + len(near)]),
                     corner_uv=np.tile(ribbon.corner_uv, (2, 1, 1)), face_material=np.repeat([0, 1], len(ribbon.faces)))
    report = Report()
    made = encode_to_target(double, EncodeOptions(target_bytes=60_000, resolution=256, partition="off"), report)
    assert len(made.choices["search"]) > 1
    assert [text for text in report.warnings if "alpha is mixed" in text]


@pytest.mark.parametrize("support, stage", [("voxels", "transfer"), ("auto", "attributes")])
def test_search_stops_when_cancelled(ribbon, support, stage):
    stages = []

    def watch(name, done, total):
        stages.append(name)
        return stages.count(stage) < 2

    with pytest.raises(KeyboardInterrupt):
        encode_to_target(ribbon, EncodeOptions(target_psnr=35.0, support=support), Report(watch))
    assert stages[-1] == stage


def test_search_leaves_the_choice_what_was_left_free(ribbon):
    """Texels at whatever position bits the encoder chooses for them, unless they were asked for."""
    free = encode_scene(ribbon, EncodeOptions(qp=FIRST_QP))
    made = encode_to_target(ribbon, EncodeOptions(target_bytes=len(free.data)), Report())
    chosen = [decode(one.data).position_bits for one in (free, made)]
    assert free.counts["voxels"] == made.counts["voxels"] == 0 and chosen[0] == chosen[1] > 14
    assert all(r["resolution"] is None for r in made.choices["search"])
    told = encode_to_target(ribbon, EncodeOptions(target_bytes=len(free.data), position_bits=13), Report())
    assert decode(told.data).position_bits == 13


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("curve", [lambda x: 30.2 - x, lambda x: 4 * math.log2(60 / (x + 1)), lambda x: 50 - 0.05 * x * x])
def test_next_place_needs_few_values(curve, whole):
    tried, place, slope = [], 28, 0.5
    while place is not None and not (tried and abs(tried[-1][1]) < 0.05 and not whole):
        tried.append((place, curve(place)))
        slope = slope_of(tried, slope)
        place = next_place(tried, slope, whole)
    assert len(tried) == len({one for one, _ in tried}) <= 9
    if whole:
        best = min((one for one, value in tried if value <= 0), default=None)
        assert best == min((x for x in range(LAST_QP + 1) if curve(x) <= 0), default=None)


@pytest.mark.parametrize("threshold", [-1.0, 0.5, 27.0, 28.5, 62.5, 64.0])
def test_next_place_closes_in_on_any_step(threshold):
    tried, place = [], 28.0
    while place is not None:
        tried.append((place, -1.0 if place >= threshold else 1.0))
        place = next_place(tried, 0.17)
    assert len(tried) < 30 and all(0 <= one <= LAST_QP for one, _ in tried)
    if 0 < threshold < LAST_QP and abs(threshold - 28) < 1:
        ends = max(one for one, value in tried if value > 0), min(one for one, value in tried if value < 0)
        assert ends[0] < threshold <= ends[1] and ends[1] - ends[0] <= GAP


def test_estimate_is_within_a_half(ribbon):
    report, options = Report(), EncodeOptions(resolution=512)
    made = encode_scene(ribbon, options, report)
    voxels, seconds = estimate(ribbon, options)
    assert 0.5 < voxels / made.counts["voxels"] < 1.5 and seconds > 0
