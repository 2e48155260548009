"""Which settings pay: fronts and claims say what the figures say, and the sweep goes on where it stopped."""

import math

import numpy as np
import pytest
from shapes import painted_sphere

from tools.accuracy_time import (
    BASE,
    BYTES,
    DECIBELS,
    RATES,
    SECONDS,
    TRANSFER_DENSITY,
    Bench,
    Measured,
    Point,
    claims,
    dominates,
    dominators,
    draw,
    equal_bytes_quality,
    report,
    run_sweep,
    slope_at,
    sweep,
    weigh,
    write_csv,
)


def test_front_is_what_no_other_beats_beyond_the_noise_of_time():
    given = [(1.0, 100, -30.0), (1.04, 100, -30.0), (2.0, 100, -30.0), (2.0, 90, -30.0), (1.03, 90, -31.0), (0.5, 200, -20.0)]
    costs = [(math.log(seconds), math.log(size), quality) for seconds, size, quality in given]
    assert dominators(costs, (SECONDS, BYTES, DECIBELS)) == [[4], [4], [0, 1, 3, 4], [4], [], []]
    assert dominators(costs, ((0, 0), BYTES, DECIBELS)) == [[], [0, 4], [0, 1, 3, 4], [4], [], []]
    a_hair_better = [(0.0, 9.0, -30.0), (0.0, 8.9995, -30.005)]
    assert dominators(a_hair_better, (SECONDS, BYTES, DECIBELS)) == [[], []]


@pytest.mark.parametrize("seed", range(5))
def test_some_point_is_on_every_front_and_none_beats_itself_or_back(seed):
    axes = SECONDS, BYTES, DECIBELS
    costs = [tuple(row) for row in np.random.default_rng(seed).integers(0, 4, (40, 3)) * [0.03, 0.0007, 0.007]]
    found = dominators(costs, axes)
    assert any(not by for by in found) and all(i not in by for i, by in enumerate(found))
    assert not any(dominates(a, b, axes) and dominates(b, a, axes) for a in costs for b in costs)


def test_quality_at_equal_bytes_follows_the_slope():
    sizes, psnr = [400, 100, 200, 800], [34.0, 30.0, 32.0, 36.0]  # 2 dB a doubling
    assert slope_at(sizes, psnr, 300) == pytest.approx(2.0) == slope_at(sizes[:2], psnr[:2], 100)
    assert equal_bytes_quality(36.0, 800, 200, 2.0) == pytest.approx(32.0)


def test_sweep_holds_every_preset_once_and_the_defaults_first():
    points = sweep(False)
    assert len(points) == len(set(points)) and points[0] == Point(*BASE) == sweep(True)[0]
    assert {Point(*rate) for rate in RATES.values()} <= set(points) and len(sweep(True)) < 12
    assert len({p.name for p in points}) == len(points)


def test_sweep_goes_on_from_its_lines_and_measures_again_under_other_conditions(tmp_path):
    tried, seconds = [], iter([4.0, 1.0, 2.0, 1.0, 2.2, 1.0])

    class Fake:
        def run(self, point, with_quality):
            tried.append((point.qp, with_quality))
            return {"seconds": next(seconds, 3.0), "bytes": 1000 - point.qp, "geometry": 50,
                    "psnr_y": 60.0 - point.qp if with_quality and point.qp else None}

    points, cache = [Point(64, qp) for qp in (0, 10, 20)], tmp_path / "points.jsonl"
    first = run_sweep(points[:2], Fake, cache, {"asset": "a"})
    assert tried == [(0, True), (10, True), (0, False), (10, False), (0, False), (10, False)]
    assert [(m.seconds, m.bytes, m.psnr_y) for m in first] == [(2.2, 1000, math.inf), (1.0, 990, 50.0)]
    assert first[0].spread == pytest.approx(1.0)
    with open(cache, "a") as file:
        file.write('{"asset": "a", "poi')  # cut off by a kill
    tried.clear()
    assert run_sweep(points[:2], Fake, cache, {"asset": "a"}) == first and tried == []
    assert len(run_sweep(points, Fake, cache, {"asset": "a"})) == 3 and tried == [(20, True), (20, False), (20, False)]
    run_sweep(points, Fake, cache, {"asset": "b"})
    assert len(tried) == 12
    assert len(run_sweep(points, Fake, cache, {"asset": "a"})) == 3 and len(tried) == 12


def test_report_names_what_beats_a_preset(tmp_path):
    def row(point, seconds=1.0, factor=1.0, gain=0.0):
        return Measured(point, seconds, round(factor * 2 ** (20 - point.qp / 6)), 50, 60.0 - point.qp + gain)

    points = [row(Point(1024, 28)), *(row(Point(1024, qp)) for qp in (24, 32, 36))]
    points += [row(Point(1024, 28, "fast"), 0.5, 1.1), row(Point(1024, 28, density=6), 1.2, gain=-0.1),
               row(Point(1024, 32, "fast"), 0.5, 0.9)]
    there, beaten, slope = weigh(points)
    assert slope == pytest.approx(6.0, abs=0.05) and [m.name for m in there][0] == "K 1024 QP 28"
    assert [bool(by) for by in beaten] == [False, False, True]
    said = dict(zip(RATES, claims(points), strict=True))
    assert "on the front" in said["r03"] and "not in this sweep" in said["r06"]
    assert "dominated by K 1024 QP 32 fast" in said["r02"]
    text = report("vase", points, there, beaten, slope)
    assert "log2(bytes / B0)" in text and "5 %" in text and text.count("front |") >= 2
    write_csv(points, tmp_path / "points.csv")
    assert len((tmp_path / "points.csv").read_text().splitlines()) == len(points) + 1
    draw(points, there, beaten, tmp_path / "points.png")


def test_bench_measures_and_sets_the_density_back():
    usual, bench = dict(TRANSFER_DENSITY), Bench(painted_sphere(8), 2000, 1)
    fine, coarse, unasked = (bench.run(Point(32, qp, "fast", density=3), asked) for qp, asked in ((10, 1), (40, 1), (40, 0)))
    assert TRANSFER_DENSITY == usual and fine["seconds"] > 0 and unasked["psnr_y"] is None
    assert fine["bytes"] > coarse["bytes"] == unasked["bytes"] and fine["psnr_y"] > coarse["psnr_y"]
