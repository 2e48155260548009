"""Compiled kernels never outlive the sources they were made from."""

import ast
import shutil
from pathlib import Path

import numba

from texfcodec.ground import kernel as kernel_room
from texfcodec.ground.kernel import cache_folder, fingerprint, kernel

PACKAGE = kernel_room.PACKAGE


def test_a_change_in_any_source_file_moves_the_cache(tmp_path, monkeypatch):
    shutil.copytree(PACKAGE, tmp_path / "p", ignore=shutil.ignore_patterns("__pycache__"))
    here = fingerprint()
    monkeypatch.setattr(kernel_room, "PACKAGE", tmp_path / "p")
    same = fingerprint.__wrapped__()
    assert same == fingerprint.__wrapped__() != here
    for name in ("codecs/raht/entropy/range_coder.py", "errors.py"):
        path = tmp_path / "p" / name
        path.write_text(path.read_text() + "\n")
        assert fingerprint.__wrapped__() != same
        same = fingerprint.__wrapped__()


def test_kernels_are_cached_there_and_other_packages_keep_their_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_room, "cache_folder", lambda: tmp_path)
    usual = numba.config.CACHE_DIR

    @kernel
    def _twice(v):
        return 2 * v

    assert _twice(21) == 42 and numba.config.CACHE_DIR == usual
    assert list(tmp_path.glob("*/*.nbi"))


def test_a_cache_folder_of_the_users_is_honoured(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert cache_folder() == tmp_path / "texfcodec" / fingerprint()


def test_without_a_home_the_cache_stays_with_the_package(monkeypatch):
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("no home")

    monkeypatch.setattr(Path, "home", homeless)
    assert PACKAGE in cache_folder().parents


def test_a_cache_that_cannot_be_made_is_passed_over(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "next"))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "next"))
    assert cache_folder() == tmp_path / "next" / "texfcodec" / fingerprint()


def test_only_the_kernel_room_asks_numba():
    asking = [path for path in PACKAGE.rglob("*.py") for node in ast.walk(ast.parse(path.read_text()))
              if isinstance(node, ast.Import | ast.ImportFrom)
              and any(n.split(".")[0] == "numba" for n in [getattr(node, "module", None) or "", *(a.name for a in node.names)])]
    assert [path.relative_to(PACKAGE).as_posix() for path in asking] == ["ground/kernel.py"]
