"""tools/bench/again.py: recorded bytes that the present code still makes, and those that it does not."""

import json

import pytest

from texfcodec.api import encode_to_result
from texfcodec.errors import EXIT_DIFFERS, EXIT_IO
from tools.bench import again
from tools.bench.accuracy_bench import read_runs
from tools.bench.conditions import SAMPLE, find_assets

OPTIONS = {"resolution": 32, "effort": "fast", "support": "voxels", "refine": "off", "position_bits": 8, "no_check": True}
GOOD, BAD = {**OPTIONS, "qp": 36}, {**OPTIONS, "qp": 40}


def row(made, options, setting, more=0, **facts):
    """A row of rate_points.py that recorded so many bytes more than there are."""
    sizes = {"total": made.sizes["total"] + more, "attributes": made.sizes["attributes"] + more}
    return {"asset": SAMPLE, "setting": setting, "group": "ours", "method": "texf", "options": options, "bytes": sizes,
            "reconstruction_sha256": made.reconstruction_sha256, "seconds": {"encode": {"total": 1.0}}} | facts


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """Rows of the sample, one with bytes that are not its own, and rows that are not encoded."""
    path = tmp_path_factory.mktemp("again") / "rows.jsonl"
    assets, _ = find_assets([SAMPLE], [], path.parent)  # as the tool reads it: names of a file take bytes too
    good, bad = (encode_to_result(assets[SAMPLE], options) for options in (GOOD, BAD))
    rows = [row(good, GOOD, "good"), row(bad, BAD, "bad", more=-100), row(good, GOOD, "rival", method="uv"),
            row(good, GOOD, "lost", asset="nowhere"), row(good, {"codec": "3dntc"}, "neural"),
            {"asset": SAMPLE, "setting": "none", "group": "uv", "method": "uv", "state": "missing", "reason": "no ffmpeg"}]
    path.write_text("".join(json.dumps(one) + "\n" for one in rows))
    return path


def called(record, *words):
    """The exit code and the page of the tool on a record, whose state lies beside it."""
    page = record.with_name("page.md")
    code = again.main(["--assets", str(record.parent), "--rows", str(record), "--state", str(record.with_name("state.jsonl")),
                       "--page", str(page), *words])
    return code, " ".join(page.read_text().split())


@pytest.fixture(autouse=True)
def commit(monkeypatch):
    """The tests may run where there is no checkout."""
    monkeypatch.setattr(again, "made_on", lambda: "on a machine, commit 0123abcd")


@pytest.fixture(scope="module")
def first(record):
    """What the first run says, which encodes: (exit code, page, lines that it printed)."""
    said = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(again, "made_on", lambda: "on a machine, commit 0123abcd")
        patch.setattr(again, "print", lambda text, file=None: said.append(text), raising=False)
        return *called(record), said


def test_the_page_says_which_points_have_the_same_bytes(record, first):
    code, page, _ = first
    good, bad = (json.loads(line)["bytes"]["total"] for line in record.read_text().splitlines()[:2])
    assert code == EXIT_DIFFERS and "**1 of 2 points have the same bytes.**" in page and "commit 0123abcd" in page
    percent = f"{100 * 100 / bad:+.2f}"
    assert f"| rows.jsonl | 2 | 1 | 2 of 2 | 0 | {50 * 100 / bad:+.2f} | {percent} |" in page
    assert f"| sample | bad | {bad:,} | {bad + 100:,} | {percent} | attributes +100 |" in page
    assert "| sample | good |" not in page and f"{good:,}" not in page and str(record.parent) not in page


def test_what_is_not_encoded_is_named(record, first):
    _, page, said = first
    assert "Passed over, because the assets are not there: 1 points of nowhere." in page
    assert "Left out: 1 fits of 3DNTC payloads" in page and "rival" not in page
    assert any(text.startswith("nowhere: not in ") for text in said)


def test_a_second_run_encodes_what_is_not_finished_by_this_code(record, first, monkeypatch):
    asked = []

    def encode_beside(todo, args, code):
        asked.append({asset: options for asset, (_, _, options) in todo.items()})
        return {asset: "encode: out of luck" for asset in todo}

    monkeypatch.setattr(again, "encode_beside", encode_beside)
    assert called(record) == first[:2] and not asked
    state = record.with_name("state.jsonl")
    lines = state.read_text().splitlines()
    assert len(lines) == 2
    state.write_text(lines[0] + "\n" + lines[1][:50])  # killed while it wrote
    code, page = called(record)
    assert asked == [{SAMPLE: [BAD]}] and code == EXIT_DIFFERS and "| sample | bad | encode: out of luck |" in page
    monkeypatch.setattr(again, "code_of", lambda *given: "another")
    assert "**0 of 2" in called(record)[1] and asked[1:] == [{SAMPLE: [GOOD, BAD]}]
    state.write_text("\n".join(lines) + "\n")


def test_the_state_has_a_line_per_encode_of_this_code(record, first):
    runs = read_runs(record.with_name("state.jsonl"), {"code": again.code_of("texf", ())})
    assert [json.loads(key)["options"] for key in runs] == [GOOD, BAD]
    assert all(run["seconds"] > 0 for [run] in runs.values())


def test_a_child_stops_where_the_code_is_another(record, first, tmp_path, capsys):
    asset = record.parent / SAMPLE / "source.glb"
    (tmp_path / "job.json").write_text(json.dumps({"asset": SAMPLE, "asset_sha256": "", "options": [GOOD], "code": "another",
                                                   "state": str(tmp_path / "state.jsonl")}))
    assert again.main(["--step", str(tmp_path), str(asset)]) == 5
    assert "the code has changed" in capsys.readouterr().err and not (tmp_path / "state.jsonl").exists()


def test_there_is_no_page_where_the_code_has_changed_meanwhile(record, first, monkeypatch):
    codes = iter(["before", "after"])
    monkeypatch.setattr(again, "code_of", lambda *given: next(codes))
    monkeypatch.setattr(again, "encode_beside", lambda *given: {SAMPLE: "encode: the code has changed"})
    with pytest.raises(SystemExit, match="no page: the code has changed"):
        called(record)


@pytest.mark.parametrize("options, error", [({"effort": "heroic"}, "TXF-"), ({"heroism": 1}, "TypeError: ")])
def test_a_point_that_fails_is_a_row(sample_scene, options, error, record):
    run = again.encoded(sample_scene, options)
    assert run["error"].startswith(error)
    point = again.Point(record=record, asset="a", setting="s", options=options, bytes={"total": 5})
    args = type("Args", (), {"rows": [], "asset": [], "neural": False})
    page = again.page_of([(point, run)], [], args)
    assert "0 of 1 points" in page and f"| rows.jsonl | a | s | {run['error']} |" in page


def test_records_of_materials_and_of_everyday_are_points_and_those_of_rivals_are_not(tmp_path):
    everyday = {"rate": "r01", "total": 9, "geometry": 3, "attributes": 5, "encode_seconds": 2.5}
    for name, held in (("m", {"asset": "a", "points": [{"qp": 20, "total": 8, "map_bytes": 6}], "maps": {}}),
                       ("e", {"b": {"asset": "b", "settings": {"effects": "none"}, "points": [everyday]}}),
                       ("r", {"asset": "a", "points": [{"codec": "avif", "total_bytes": 3}]})):
        (tmp_path / f"{name}.json").write_text(json.dumps(held))
    [material], [daily], none = (again.read_points(tmp_path / f"{name}.json") for name in "mer")
    assert (material.asset, material.options, material.bytes) == ("a", {"rate": "r03", "qp": 20}, {"total": 8, "attributes": 6})
    assert (daily.asset, daily.options, daily.bytes) == ("b", {"rate": "r01", "effects": "none"}, {"total": 9, "attributes": 5})
    assert none == [] and daily.seconds == 2.5


def test_the_committed_records_have_points_of_ours():
    paths = again.default_records()
    assert {path.parent.name for path in paths} == {"rates", "materials"}
    assert all(again.read_points(path) for path in paths)


def test_what_is_not_there_is_a_mistake_of_the_command_line(record, tmp_path):
    with pytest.raises(SystemExit, match="no point of ours is recorded of elsewhere"):
        called(record, "--asset", "elsewhere")
    (tmp_path / "list.json").write_text("[1]")
    for name, error in (("nothing.jsonl", "nothing.jsonl"), ("nothing.json", "is no record of ours: FileNotFoundError"),
                        ("list.json", "is no record of ours: AttributeError")):
        with pytest.raises(SystemExit, match=error):
            called(tmp_path / name)
    assert again.main(["--assets", str(tmp_path), "--rows", str(record), "--asset", "nowhere", "--state",
                       str(tmp_path / "state.jsonl")]) == EXIT_IO
