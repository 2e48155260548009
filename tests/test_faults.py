"""Calls of the system that fail, arrays that find no memory, folders that vanish."""

import errno
import os
from pathlib import Path

import pytest

from texfcodec import warmup
from texfcodec.asset.load.files import load
from texfcodec.asset.save import files as save_room
from texfcodec.errors import InputError


def failing(call, number, only):
    """The call, which fails where only(arguments)."""
    def run(*arguments, **more):
        if only(*arguments):
            raise OSError(number, os.strerror(number))
        return call(*arguments, **more)

    return run


def test_a_rename_that_fails_takes_the_new_files_before_it_away_again(tmp_path, monkeypatch):
    (tmp_path / "a.gltf").write_bytes(b"old")
    monkeypatch.setattr(os, "replace", failing(os.replace, errno.EIO, lambda _, final: str(final).endswith(".gltf")))
    with pytest.raises(InputError, match="TXF-O04"):
        save_room.write_all(tmp_path, [("a.bin", [b"new"]), ("a.gltf", [b"new"])])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.gltf": b"old"}


@pytest.mark.parametrize("number, code", [(errno.EACCES, "TXF-O02"), (errno.EIO, "TXF-O04")])
def test_an_output_that_cannot_be_looked_at_is_refused_by_its_code(tmp_path, monkeypatch, number, code):
    monkeypatch.setattr(Path, "is_dir", failing(Path.is_dir, number, lambda path: path == tmp_path / "closed"))
    with pytest.raises(InputError, match=code):
        save_room.check_target(tmp_path / "closed" / "a.glb")


def test_a_material_library_that_cannot_be_read_is_missing(tmp_path, monkeypatch):
    (tmp_path / "a.mtl").write_text("newmtl m\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    monkeypatch.setattr(Path, "read_bytes", failing(Path.read_bytes, errno.EACCES, lambda path: path.suffix == ".mtl"))
    assert "TXF-I16" in load(tmp_path / "a.obj").warnings[0]
    with pytest.raises(InputError, match="TXF-I16"):
        load(tmp_path / "a.obj", strict=True)


def test_a_cache_of_kernels_that_cannot_be_listed_is_an_empty_one(monkeypatch):
    monkeypatch.setattr(os, "scandir", failing(os.scandir, errno.EIO, lambda *_: True))
    assert warmup.kernels_compiled() is False
