"""rate_points.py --verify: recorded bytes that the present code still makes, and those that it does not."""

import json
from argparse import Namespace
from functools import partial

import pytest

from texfcodec.api import encode_to_result
from texfcodec.errors import EXIT_DIFFERS, EXIT_IO
from tools.bench import rate_points, verify
from tools.bench.conditions import SAMPLE, find_assets

OPTIONS = {"resolution": 32, "effort": "fast", "support": "voxels", "refine": "off", "position_bits": 8, "no_check": True}
GOOD, BAD = {**OPTIONS, "qp": 36}, {**OPTIONS, "qp": 40}


def row(made, options, setting, more=0, **facts):
    """A row that recorded so many bytes more than there are."""
    sizes = {"total": made.sizes["total"] + more, "attributes": made.sizes["attributes"] + more}
    return {"asset": SAMPLE, "setting": setting, "group": "ours", "method": "texf", "options": options, "bytes": sizes,
            "reconstruction_sha256": made.reconstruction_sha256, "seconds": {"encode": {"total": 1.0}}} | facts


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """Rows of the sample, one with bytes that are not its own, one that fails, and rows that are not encoded."""
    path = tmp_path_factory.mktemp("again") / "rows.jsonl"
    assets, _ = find_assets([SAMPLE], [], path.parent / "out")  # as the tool reads it: names of a file take bytes too
    good, bad = (encode_to_result(assets[SAMPLE], options) for options in (GOOD, BAD))
    rows = [row(good, GOOD, "good"), row(bad, BAD, "bad", more=-100), row(good, {"effort": "heroic"}, "unheard"),
            row(good, GOOD, "rival", method="uv"), row(good, GOOD, "lost", asset="nowhere"),
            row(good, {"codec": "3dntc"}, "neural"),
            {"asset": SAMPLE, "setting": "none", "group": "uv", "method": "uv", "state": "missing", "reason": "no ffmpeg"}]
    path.write_text("".join(json.dumps(one) + "\n" for one in rows))
    return path


def called(record, *words):
    """The exit code of the tool on a record."""
    return rate_points.main([str(record), "--verify", "--out", str(record.parent / "out"), "--assets", str(record.parent),
                             "--page", str(record.with_name("page.md")), *words])


def test_the_page_says_which_points_have_the_same_bytes_and_a_second_run_encodes_nothing(record, monkeypatch, capsys):
    monkeypatch.setattr(verify, "made_on", lambda: "on a machine, commit 0123abcd")
    assert called(record) == EXIT_DIFFERS
    page, said = record.with_name("page.md").read_text(), capsys.readouterr()
    bad = json.loads(record.read_text().splitlines()[1])["bytes"]["total"]
    lines = {line.split(" | ")[0].strip("| "): line for line in page.splitlines() if line.startswith("| ")}
    percent = f"{100 * 100 / bad:+.2f}"
    assert lines["rows.jsonl"].split(" | ")[1:5] == ["3", "1", "2 of 2", "1"] or "| unheard |" in page
    assert f"| sample | bad | {bad:,} | {bad + 100:,} | {percent} | attributes +100 |" in page
    assert "commit 0123abcd" in page and "| sample | good |" not in page and str(record.parent) not in page
    assert "1 points of nowhere" in page and "1 fits of 3DNTC payloads" in page and "heroic" in page
    assert "nowhere" in said.err and "2 done" in said.out
    assert called(record) == EXIT_DIFFERS and "0 done" in capsys.readouterr().out


def test_a_page_counts_encodes_and_names_what_differs(tmp_path):
    point = partial(verify.Point, record=tmp_path / "rows.jsonl", asset="a", bytes={"total": 100})
    points = [point(setting=name, options={"qp": qp}) for name, qp in (("same", 20), ("more", 30), ("twin", 20))]
    runs = [(each, {"bytes": {"total": total}, "values": None, "seconds": 1.5})
            for each, total in zip(points, (100, 103, 100), strict=True)]
    args = Namespace(asset=[], records=[tmp_path / "rows.jsonl"], neural=False)
    page = verify.page_of(runs, [], args)
    assert "2 encodes in 3 processor" in page and "2 of 3 points have the same bytes" in page.replace("\n", " ")
    assert "| a | more | 100 | 103 | +3.00 |" in page and "| a | same |" not in page


def test_records_of_materials_are_points_and_those_of_rivals_are_not(tmp_path):
    for name, point in (("m", {"qp": 20, "total": 8, "map_bytes": 6}), ("r", {"codec": "avif", "total_bytes": 3})):
        (tmp_path / f"{name}.json").write_text(json.dumps({"asset": "a", "points": [point]}))
    [material], none = (verify.read_points(tmp_path / f"{name}.json") for name in "mr")
    assert (material.asset, material.options, material.bytes) == ("a", {"rate": "r03", "qp": 20}, {"total": 8, "attributes": 6})
    assert none == []


def test_the_committed_records_have_points_of_ours():
    paths = verify.default_records()
    assert {path.parent.name for path in paths} == {"rates", "materials"}
    assert all(verify.read_points(path) for path in paths)


def test_what_is_not_there_is_a_mistake_of_the_command_line(record, tmp_path):
    with pytest.raises(SystemExit, match="no point of ours is recorded of elsewhere"):
        called(record, "--asset", "elsewhere")
    (tmp_path / "list.json").write_text("[1]")
    for name, error in (("nothing.jsonl", "nothing.jsonl"), ("nothing.json", "is no record of ours: FileNotFoundError"),
                        ("list.json", "is no record of ours: TypeError")):
        with pytest.raises(SystemExit, match=error):
            called(tmp_path / name)
    assert called(record, "--asset", "nowhere") == EXIT_IO
