"""tools/bench/provenance.py: what pages say of the state of the code."""

import subprocess
from pathlib import Path

import pytest

from tools.bench.provenance import commit_of, made_on, state_of


@pytest.fixture
def checkout(tmp_path):
    """A repository with a commit of a source and one of a page after it."""
    def git(*words):
        subprocess.run(["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True)

    git("init", "--quiet")
    for file in (Path("texfcodec/a.py"), Path("docs/a.md")):
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text("old")
        git("add", ".")
        git("commit", "--quiet", "-m", str(file))
    return tmp_path


def test_a_state_is_a_commit_that_of_the_package_and_whether_sources_have_changed_since(checkout):
    (checkout / "docs/a.md").write_text("new")
    log = subprocess.check_output(["git", "-C", checkout, "log", "--format=%h", "--abbrev=8"], text=True)
    last, first = log.split()
    assert commit_of(checkout) == last and state_of(checkout) == f"{last} (texfcodec of {first})"
    (checkout / "texfcodec/a.py").write_text("new")
    assert state_of(checkout) == f"{last} (texfcodec of {first}) **with changes that it does not have**"


def test_a_page_says_where_it_was_made_and_nothing_wrong_outside_a_repository(checkout, monkeypatch):
    assert made_on(checkout).endswith(f", commit {state_of(checkout)}")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(checkout.parent))
    empty = checkout.parent / "empty"
    empty.mkdir()
    assert state_of(empty) == "unknown"
