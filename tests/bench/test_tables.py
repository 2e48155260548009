"""Tables of docs/ from rows that rate_points.py leaves: claims say what the figures say."""

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from texfcodec.encoder.explain import SAVES
from tools.bench import collect
from tools.bench.tables import accuracy, everyday, lit, neural, paper
from tools.bench.tables.paper import ANCHOR, AUTO, VERTEX_ANCHOR, asset_lines, by_asset_lines, paper_lines

REPOSITORY = Path(__file__).resolve().parents[2]


def cells(lines, first):
    """The cells of the line that begins with a cell."""
    return next([cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith(f"| {first} |"))


def kept(path, rows):
    """The path of a file of rows, as collect.py --keep leaves it."""
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


@pytest.mark.parametrize("table", collect.TABLES)
def test_every_table_has_a_page(table):
    __import__(f"tools.bench.tables.{table}")
    assert callable(getattr(__import__("tools.bench.tables", fromlist=[table]), table).page)


# The paper's rows.


def rows_of(group, asset, factor, uv=None, geometry=None):
    """Three points of a curve with `factor` times the bytes that an equal one has. geometry: its bytes, where others."""
    made, geometry = [], 500 * factor if geometry is None else geometry
    for number, y in enumerate((30.0, 34.0, 38.0)):
        texture = factor * 1000 * 2**number
        parts = {"geometry": geometry, "texture": texture - (uv or 0)} | ({} if uv is None else {"uv": uv})
        made.append({"asset": asset, "group": group, "setting": f"s_r0{number + 1}", "facts": {"supports": ["voxels"]},
                     "bytes": {"total": geometry + texture} | parts, "psnr_3d": {"y": y, "rgb": y},
                     "image": {"psnr": {"y": y, "rgb": y}, "ssim": 0.9 + number / 50}})
    return made


def test_vertex_colours_stand_against_vertex_colours_and_textures_against_uvs():
    rows = [*rows_of(AUTO, "cloth", 1), *rows_of(ANCHOR, "cloth", 2, uv=900),
            *rows_of(AUTO, "fish", 3), *rows_of(ANCHOR, "fish", 9, uv=900), *rows_of(VERTEX_ANCHOR, "fish", 2)]
    lines = asset_lines(rows, {"cloth": {"unused": 0.25}})
    cloth, fish = cells(lines, "cloth"), cells(lines, "fish")
    assert cloth[4:7] == ["900", "voxels", "-50.0"] and fish[4:7] == ["no UVs", "voxels", "+50.0"]
    assert "22%" in cloth[-1] and "25%" in cloth[-1] and fish[-1] == "the rival"


def test_what_auto_saves_on_the_mesh_counts_in_its_part_and_not_in_the_papers():
    rows = [*rows_of(AUTO, "bball_0001", 1, geometry=0), *rows_of(ANCHOR, "bball_0001", 1, uv=900, geometry=5000)]
    assert float(cells(asset_lines(rows, {}), "bball_0001")[6]) < -50
    assert float(cells(paper_lines(rows, ((AUTO, "TexF", (0, 0)),), ANCHOR), AUTO)[3]) == 0


def test_the_page_says_how_many_points_of_ours_are_by_the_present_code(monkeypatch):
    monkeypatch.setattr(paper, "code_of", lambda method, plugins: f"{method} now")
    monkeypatch.setattr(paper, "state_of", lambda root: "0123abcd")
    rows = [{"method": method, "code": code, "image": {"views": 16, "size": 1024}}
            for method, code in (("texf", "texf now"), ("texf_baked", "old"), ("uv", "old"))]
    assert "3 points, **1 of 2 of ours** by the code of commit 0123abcd" in paper._evaluation(rows)
    assert "2 points, all 1 of ours by" in paper._evaluation([rows[0], rows[2]])


def test_rows_of_the_paper_that_were_not_run_are_said():
    lines = paper_lines([*rows_of("ours", "bball_0001", 1), *rows_of("uv", "bball_0001", 2, uv=1)],
                        (("ours", "TexF", (-1, 2)), ("theirs", "Serialized", (112, 21))), "uv")
    assert cells(lines, "ours")[2:5] == ["-1 / +2", "-50.0", "-50.0"]
    assert cells(lines, "theirs")[2:] == ["+112 / +21", *["not run"] * 5]


def test_every_group_has_a_figure_for_every_asset_that_both_have():
    rows = [*rows_of(ANCHOR, "fish", 2.0), *rows_of(ANCHOR, "cloth", 2.0), *rows_of("ours", "cloth", 1.0),
            *rows_of("theirs", "fish", 3.0)]
    lines = by_asset_lines(rows, ANCHOR)
    assert cells(lines, "group") == ["group", "cloth", "fish"]
    assert cells(lines, "ours") == ["ours", "-50.0", "-"] and cells(lines, "theirs") == ["theirs", "-", "+50.0"]


def test_facts_of_an_asset_count_the_texels_that_are_shown(tmp_path, sample_scene):
    from texfcodec.demo.asset import write_sample

    write_sample(tmp_path / "sample.glb")
    facts = paper.asset_facts(tmp_path / "sample.glb")
    assert facts["faces"] == f"{len(sample_scene.faces):,}" and 0 <= facts["unused"] < 1 and float(facts["reuse"].split()[0]) > 0


def test_the_committed_rows_make_the_page(tmp_path):
    rates = REPOSITORY / "tools/bench/rates"
    collect.main([str(rates / "all_assets.jsonl"), str(rates / "paper_1024.jsonl"), "--table", "paper", "--assets", str(tmp_path),
                  "--out", str(tmp_path / "results.md")])
    text, shown = ((folder / "results.md").read_text(encoding="utf-8").splitlines()
                   for folder in (tmp_path, REPOSITORY / "docs/reports"))
    for group in ("UV-Reparam HEVC", "TexF voxels, baked", "SDF, marching cubes", "vertex colours, Draco"):
        assert cells(text, group) == cells(shown, group)


# Fits.


def fit(setting, group, rate, psnr, steps=None):
    """A row, as far as neural reads it."""
    told = {} if steps is None else {"fit": {"steps": steps, "asked_steps": steps}}
    return {"setting": setting, "group": group, "asset": "a", "bytes": {"total": rate + 10, "geometry": 10},
            "seconds": {"encode": {"total": 9e9, "samples": 7, "fit": (steps or 0) / 100}}, "facts": told,
            "psnr_3d": {"y": psnr, "rgb": psnr - 2}, "image": {"psnr": {"y": psnr - 1, "rgb": psnr - 3}}}


def test_fits_of_equal_steps_stand_against_the_rival_under_their_own_asset(tmp_path):
    rival = [fit(f"astc_{n}", "ASTC", 2 * rate, psnr) for n, (rate, psnr) in enumerate([(100, 40), (200, 43), (400, 46)])]
    ours = [fit(f"3dntc_{rate}_{steps}", "3DNTC", rate, psnr - (20 if steps == 1 else 0), steps)
            for rate, psnr in ((100, 40), (200, 43), (400, 46)) for steps in (1, 1000)]
    cup = [row | {"asset": "cup"} for row in ours[:2]]
    rows = kept(tmp_path / "rows.jsonl", ours + rival + cup)
    lines = neural.page(SimpleNamespace(results=[rows], out=tmp_path / "neural.md"))
    assert cells(lines, "1,000")[:3] == ["1,000", "ASTC", "-50.0 %"] and cells(lines, "1")[2] == "none"
    assert cells(lines, "3dntc_400_1000")[1:4] == ["400", "1,000", "17"]  # sampling and fitting, no more
    place = lines.index("## cup")
    assert sum("3dntc_" in line for line in lines[:place]) == 6 and sum("3dntc_" in line for line in lines[place:]) == 2


def test_tables_of_the_documentation_keep_to_one_asset():
    """Bytes of a fit follow from its asset and the size asked for: rows of another asset show by theirs."""
    tables = {}
    for section in (REPOSITORY / "docs/design/neural.md").read_text(encoding="utf-8").split("\n### "):
        for size, resident in re.findall(r"^\| 3dntc_(\d+)_\d+ \| ([\d,]+) \|", section, re.MULTILINE):
            tables.setdefault(section.splitlines()[0], {}).setdefault(size, set()).add(resident)
    assert set(tables) == {"Basketball player", "Water bottle"}
    assert [name for name, sizes in tables.items() if any(len(found) > 1 for found in sizes.values())] == []


# Everyday rivals.


STEEP, SHALLOW = ("avif", 1, 12), ("webp", 2, 10)
BD_RATES = {"bball_0001": -28, "ycb_scissors": -20, "waterbottle_pbr": -17, "vintage_fan": 1, "cat_webp": 28,
            "damaged_helmet": 330}


def line(start, slope):
    """(bytes, PSNR) pairs from 30 to 36 dB: 100 * 2**start bytes at 30 dB, slope doublings per dB."""
    return [(100 * 2.0 ** (start + slope * (y - 30)), float(y)) for y in range(30, 37)]


def rival_points(*curves):
    """Rival points of ((codec, scale, uv_bits), pairs)."""
    return [{"codec": c, "scale": s, "uv_bits": b, "total_bytes": size, "y": y, "rgb": y, "yuv": y}
            for (c, s, b), pairs in curves for size, y in pairs]


def test_the_least_curve_counts_at_every_psnr():
    crossing = everyday.curves_of(rival_points((STEEP, line(0, 1)), (SHALLOW, line(1, 0.5))), "y")
    ours = line(-1, 1)  # half of the steep curve: -1 doubling up to 32 dB, from there to 36 dB rising to +1
    assert everyday.bd_rate_against(crossing, ours) == pytest.approx(100 * (2 ** (-1 / 3) - 1), abs=1e-3)
    points = [{"total": size, "y": y} for size, y in ours]
    assert everyday.point_differences(crossing, points, "y") == pytest.approx(
        [-50, -50, -50, 100 * (2**-0.5 - 1), 0, 100 * (2**0.5 - 1), 100])
    worse = [(ours[3][0] * 1.5, ours[3][1] - 0.1), (ours[5][0] * 1.1, ours[5][1])]
    assert everyday.front([*worse, *reversed(ours)]) == ours
    assert everyday.bd_rate_against(crossing, ours + worse) == everyday.bd_rate_against(crossing, ours)


def test_only_the_common_range_of_psnr_counts_and_chords_are_nobodys():
    curves = everyday.curves_of(rival_points((STEEP, line(0, 1))), "y")
    ours = [(size, y + 3) for size, y in line(-2, 1)]  # 33 to 39 dB, 2 + 3 doublings less
    assert everyday.bd_rate_against(curves, ours) == pytest.approx(100 * (2**-5 - 1))
    assert everyday.bd_rate_against(curves, [(size, y + 7) for size, y in line(0, 1)]) is None
    beyond = [{"total": 50, "y": 29.0}, {"total": 50, "y": 36.5}, {"total": 50, "y": None}]
    assert everyday.point_differences(curves, beyond, "y") == [pytest.approx(-50), None, None]
    knee = everyday.curves_of(rival_points((STEEP, [(100, 30.0), (1600, 31.0), (3200, 36.0)])), "y")
    assert np.exp(everyday.envelope(knee, np.array([31.0]))[0]) == pytest.approx([1600])


def test_a_smaller_and_better_point_of_another_curve_serves_below_its_own_range():
    curves = everyday.curves_of(rival_points((STEEP, [(400, 28.0), (800, 34.0)]), (SHALLOW, [(100, 30.0), (900, 33.0)])), "y")
    psnr = np.array([28.0, 29.0, 30.0, 34.0, 34.1])
    np.testing.assert_allclose(np.exp(everyday.envelope(curves, psnr)[0]), [100, 100, 100, 800, np.inf])


def test_the_table_of_the_anchors_comes_out(shared_dir):
    """The six BD-rates that stand in the anchors' README, from the points beside them."""
    for name, known in BD_RATES.items():
        record = json.loads((shared_dir / f"anchors/everyday/{name}.json").read_text())
        ours = [(p["total"], p["y"]) for p in record["texf_2026_11_22"]]
        assert everyday.bd_rate_against(everyday.curves_of(record["points"], "y"), ours) == pytest.approx(known, abs=0.6)


def test_everyday_has_a_row_per_asset_then_mean_and_median_from_records_and_rows(tmp_path):
    rivals = tmp_path / "rivals"
    rivals.mkdir()
    (rivals / "a.json").write_text(json.dumps({"asset": "a", "points": rival_points((STEEP, line(0, 1)))}))
    theirs = [{"asset": "b", "method": "uv", "group": "avif6", "options": {}, "bytes": {"total": size},
               "image": {"psnr": dict.fromkeys(("y", "rgb", "yuv"), y)}} for size, y in line(0, 1)]
    ours = [{"asset": name, "group": "TexF auto", "options": {"rate": f"r0{n}"}, "bytes": {"total": size},
             "image": {"psnr": dict.fromkeys(("y", "rgb", "yuv"), y)}}
            for name, start in (("a", -1), ("b", 1)) for n, (size, y) in enumerate(line(start, 1)[:6])]
    ours.append(ours[0] | {"bytes": {"total": 9999}, "options": {"rate": "r05"}})
    given = [kept(tmp_path / "ours.jsonl", ours), rivals, kept(tmp_path / "theirs.jsonl", theirs)]
    lines = everyday.page(SimpleNamespace(results=given, measure="y"))
    assert [row.strip("| ").split(" | ")[:2] for row in lines[2:]] == [
        ["a", "-50.0 %"], ["b", "+100.0 %"], ["mean of 2", "+25.0 %"], ["median of 2", "+25.0 %"]]
    assert "r00 50.0 B 30.0 dB -50 %" in lines[2] and "r05* 9,999 B" in lines[2]


# Materials in light.


def test_the_hull_passes_by_what_does_not_pay_and_records_and_rows_say_the_same(tmp_path):
    points = [(100 * 2**i, 30.0 + i) for i in range(4)]
    assert lit.hull(points + [(110, 30.01), (390, 31.1), (100, 29.0), (800, 33.0)]) == points
    rivals = [{"total": 1000 + 1000 * 2**i, "psnr_y": 30.0 + i} for i in range(4)] + [{"total": 10**6, "psnr_y": None}]
    for side, factor in (("rivals", 1), ("ours", 0.5)):
        held = [p | {"total": p["total"] * factor} for p in rivals]
        (tmp_path / f"ball.{side}.json").write_text(json.dumps({"asset": "ball", "positions": 1000 * factor, "points": held}))
    rows = [{"asset": "cup", "method": method, "bytes": {"total": p["total"] * factor, "geometry": 1000 * factor},
             "image": {"psnr": {"y": p["psnr_y"]}}} for method, factor in (("texf", 0.5), ("uv", 1)) for p in rivals]
    lines = lit.page(SimpleNamespace(results=[tmp_path, kept(tmp_path / "rows.jsonl", rows)]))
    for name in ("ball", "cup"):
        assert cells(lines, name)[1:] == ["50 %", "50 %"]
    assert cells(lines, "all 2")[1].startswith("mean 50 %")


def test_the_committed_records_say_what_the_page_says():
    """Read at r03's commit; what differs is a record that was renewed since."""
    lines = lit.page(SimpleNamespace(results=[REPOSITORY / "tools/bench/materials"]))
    shown = (REPOSITORY / "docs/design/materials.md").read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in shown]
    for name in ("cat_webp", "damaged_helmet", "waterbottle_pbr"):
        assert cells(lines, name) in rows


# What accuracy costs.


def ladder_row(tool, effort, psnr, seconds, factor, asset="a"):
    """A row of a rung that takes factor times the bytes of AVIF at speed 6, which double every 3 dB."""
    return {"asset": asset, "tool": tool, "effort": effort, "point": {34.5: 40, 36.0: 82}.get(psnr), "threads": 1,
            "psnr": psnr, "bytes": round(factor * 1e5 * 2 ** (psnr / 3)), "encode": [seconds, 2 * seconds],
            "decode": [seconds / 10, seconds]}


LADDERS = [*(ladder_row("avif6", 6, psnr, 1.0, 1.0, asset) for psnr in (33.0, 34.5, 36.0, 39.0) for asset in "ab"),
           *(ladder_row("ours", "balanced", psnr, 8.0, 0.5, asset) for psnr in (34.0, 37.0) for asset in "ab"),
           *(ladder_row("ours", "fast", psnr, 2.0, 0.75) for psnr in (34.0, 37.0)),
           ladder_row("avif6", 0, 38.0, 64.0, 0.8), ladder_row("etc1s", 0, 33.0, 2.0, 4.0),
           ladder_row("gltfpack", "-cc", 60.0, 0.1, 1.0), ladder_row("texf-enc", "balanced", 36.0, 9.0, 0.5)]


def test_rungs_are_compared_at_equal_quality_and_their_front_is_drawn(tmp_path):
    cells_by_rung = accuracy.cells_of(LADDERS)
    percents = {rung[:2]: round(held["a"].percent) for rung, held in cells_by_rung.items() if math.isfinite(held["a"].percent)}
    assert percents == {("avif6", 6): 100, ("ours", "balanced"): 50, ("ours", "fast"): 75, ("avif6", 0): 80, ("etc1s", 0): 400,
                        ("texf-enc", "balanced"): 50}  # gltfpack is closer than AVIF gets
    means = accuracy.means_of(cells_by_rung)
    assert means["ours", "fast", 1].encode == pytest.approx(2.0) and means["ours", "fast", 1].assets == 1
    assert accuracy.front(accuracy.plotted(means), "encode") == [("avif6", 6, 1), ("ours", "fast", 1), ("ours", "balanced", 1)]
    path = kept(tmp_path / "rows.jsonl", LADDERS)
    lines = accuracy.page(SimpleNamespace(results=[path], out=tmp_path / "page.md"))
    assert "50 % of the bytes" in lines[2] and "Draco, AVIF 0" in lines[2] and "8.0 times its seconds" in lines[2]
    assert cells(lines, "a")[1:3] == ["1.0 s, 0.10 s", "50 %, 8.0 s, 0.80 s"]
    assert (tmp_path / "pictures/accuracy_time.png").exists() == any("![" in one for one in lines)


def test_a_step_has_the_mean_of_its_ratios_over_assets():
    rows = [{"asset": asset, "explained": {"base": {"processor_seconds": 4.0}, "neighbours": [
        {"change": "--effort fast", "processor_seconds": seconds, "percent": 10.0, "verdict": SAVES, "by": []},
        {"change": "--rate r06", "reason": "too large"}]}} for asset, seconds in (("a", 1.0), ("b", 4.0))]
    assert cells(accuracy.knob_lines(rows), "--effort fast")[1:] == ["0.25, +10.0 %", "1.00, +10.0 %", "0.50, +10.0 %", "2 saves"]
