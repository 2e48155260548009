"""tools/bench/turns.py: the fastest over all rounds, and a checkout that goes again."""

import subprocess

import pytest
from test_history import run

from tools.bench import turns


def test_rounds_are_merged_to_the_fastest_and_the_median_of_medians():
    found = turns.merged([run(fastest=1.0, median=4.0), run(fastest=3.0, median=9.0), run(fastest=2.0, median=5.0)])
    assert found["rows"] == {"query": {"min": 1.0, "median": 5.0, "rounds": 15}}


def test_a_commit_is_checked_out_beside_and_removed(tmp_path):
    def git(*words):
        return subprocess.run(["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True,
                              capture_output=True, text=True).stdout

    git("init", "--quiet")
    for text in ("old", "new"):
        (tmp_path / "file").write_text(text)
        git("add", "file")
        git("commit", "--quiet", "-m", text)
    with turns.checked_out("HEAD~1", tmp_path) as root:
        assert (root / "file").read_text() == "old" and len(git("worktree", "list").splitlines()) == 2
    assert not root.exists() and len(git("worktree", "list").splitlines()) == 1


@pytest.mark.parametrize("after, code", [(1.2, 1), (1.05, 0)])
def test_slower_sides_are_told_and_the_first_round_does_not_count(monkeypatch, capsys, after, code):
    rounds = iter([run(fastest=0.1, median=0.1), run(fastest=9.0, median=9.0)] + [run(), run("c" * 40, after, after)] * 2)
    monkeypatch.setattr(turns, "round_of", lambda root, only: next(rounds))
    assert turns.main(["HEAD", "--rounds", "2"]) == code
    assert f"| query | 1 | {after:.3g} | {after:.2f} |" in capsys.readouterr().out
