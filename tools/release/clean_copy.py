"""Copies of the committed tree, in which nothing lies that a working folder gathers."""

import io
import os
import subprocess
import sys
import tarfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def run(*command: object, folder: Path = REPOSITORY, **more: str) -> bytes:
    """What a command writes on stdout; its stderr is shown. SystemExit where it fails. more: variables of its environment."""
    words = [os.fspath(word) if isinstance(word, os.PathLike) else str(word) for word in command]
    done = subprocess.run(words, cwd=folder, env=dict(os.environ, **more), stdout=subprocess.PIPE, check=False)
    if done.returncode:
        sys.stderr.buffer.write(done.stdout)
        raise SystemExit(f"{' '.join(words)}: ended with {done.returncode}")
    return done.stdout


def commit_and_time() -> tuple[str, int]:
    """Hash of the last commit, and its time in seconds since 1970."""
    commit, seconds = run("git", "log", "-1", "--format=%H %ct").decode().split()
    return commit, int(seconds)


def changed_files() -> list[str]:
    """Tracked files that are not as committed: no release holds their changes."""
    return run("git", "diff", "--name-only", "HEAD").decode().splitlines()


def copy_commit(commit: str, folder: Path) -> None:
    """Lays the tree of a commit into a new folder."""
    folder.mkdir(parents=True)
    with tarfile.open(fileobj=io.BytesIO(run("git", "archive", "--format=tar", commit))) as tree:
        tree.extractall(folder, filter="data")
