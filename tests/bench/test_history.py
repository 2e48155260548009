"""tools/bench/history.py: a line a run, and what counts as slower."""

import json

import pytest

from tools.bench import history

FOUND = {"machine_info": {"cpu": {"brand_raw": "a processor", "count": 2}, "python_version": "3.12.1", "machine": "x86_64"},
         "commit_info": {"id": "a" * 40, "dirty": True}, "datetime": "2026-11-26T09:30:00.000001+00:00",
         "benchmarks": [{"name": "test_speed[query-1]", "stats": {"min": 0.5, "median": 0.75, "rounds": 5, "mean": 0.7}}]}


def run(commit="b" * 40, fastest=1.0, median=1.0, processor="a processor", name="query"):
    """A line of a history with one row."""
    return {"commit": commit, "dirty": False, "date": "2026-11-26T10:00:00+00:00", "processor": processor, "cores": 2,
            "python": "3.12.1", "rows": {name: {"min": fastest, "median": median, "rounds": 5}}}


def written(path, *runs):
    """The path of a history of runs."""
    for line in runs:
        history.append(path, line)
    return path


def test_a_run_holds_what_pytest_benchmark_measured_and_the_processes_beside_it():
    found = history.run_of(FOUND, {"process": {"min": 1.0, "median": 2.0, "rounds": 3}})
    assert found == {"commit": "a" * 40, "dirty": True, "date": FOUND["datetime"], "processor": "a processor", "cores": 2,
                     "python": "3.12.1", "rows": {"test_speed[query-1]": {"min": 0.5, "median": 0.75, "rounds": 5},
                                                  "process": {"min": 1.0, "median": 2.0, "rounds": 3}}}


@pytest.mark.parametrize("fastest, median, code", [(1.11, 1.11, 1), (1.5, 1.05, 0), (1.05, 1.5, 0), (1.09, 1.09, 0),
                                                   (0.5, 0.5, 0)])
def test_slower_is_what_is_slower_in_its_fastest_run_and_its_median(tmp_path, capsys, fastest, median, code):
    path = written(tmp_path / "h.jsonl", run(), run("c" * 40, fastest, median))
    assert history.main([str(path), "--compare"]) == code
    said = capsys.readouterr().out
    assert f"| query | 1 | {fastest:.3g} | {fastest:.2f} | {median:.2f} | {'**slower**' * code} |" in said
    assert said.startswith("cccccccc of 2026-11-26 10:00 against bbbbbbbb of")


def test_runs_of_another_machine_are_passed_over_and_none_is_said(tmp_path, capsys):
    path = written(tmp_path / "h.jsonl", run(processor="another"), run("c" * 40, 9.0, 9.0))
    assert history.main([str(path), "--compare"]) == 0
    assert capsys.readouterr().out == ("nothing to compare cccccccc of 2026-11-26 10:00 with: no earlier run on this machine\n")
    written(path, run("d" * 40, 9.0, 9.0))
    assert history.main([str(path), "--before", "bbbb"]) == 0 and "no earlier run of bbbb" in capsys.readouterr().out


def test_a_commit_may_be_named_for_the_comparison(tmp_path, capsys):
    path = written(tmp_path / "h.jsonl", run(), run("c" * 40, 2.0, 2.0), run("d" * 40, 2.0, 2.0))
    assert history.main([str(path), "--compare"]) == 0
    assert history.main([str(path), "--before", "bbbb"]) == 1
    assert "against bbbbbbbb" in capsys.readouterr().out


def test_a_history_grows_by_a_line_a_run_and_its_page_shows_the_last_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(history, "load_pyplot", lambda: None)
    monkeypatch.setattr(history, "process_rows", lambda: {"process": {"min": 1.5, "median": 2.0, "rounds": 3}})
    (tmp_path / "b.json").write_text(json.dumps(FOUND))
    path = written(tmp_path / "deep/h.jsonl", *(run(f"{i:040d}", name="old") for i in range(9)))
    assert history.main([str(path), "--append", str(tmp_path / "b.json"), "--page", str(tmp_path / "p.md")]) == 0
    assert len(history.read_runs(path)) == 10
    page = (tmp_path / "p.md").read_text()
    head = next(line for line in page.splitlines() if line.startswith("| benchmark"))
    assert head.count("|") == history.SHOWN + 2 and head.endswith("| aaaaaaaa* 2026-11-26 |") and "![" not in page
    assert "| process |  |  |  |  |  |  |  | 1.5 |" in page


def test_an_empty_history_is_a_mistake_of_the_command_line(tmp_path):
    with pytest.raises(SystemExit, match="2"):
        history.main([str(tmp_path / "none.jsonl"), "--compare"])
