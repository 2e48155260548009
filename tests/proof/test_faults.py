"""Calls of the system that fail, arrays that find no memory, folders that vanish: single ones, and a slice of the sweeps of
tests/fuzz/faults.py."""

import errno
import os
from pathlib import Path

import pytest

from fuzz import faults
from texfcodec import precompile
from texfcodec.bitstream import inspect as inspection
from texfcodec.errors import InputError
from texfcodec.io import output_files
from texfcodec.io.load import load

EVERY = {"memory": 41}  # arrays are many; each run takes another slice of them


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
        output_files.write_all(tmp_path, [("a.bin", [b"new"]), ("a.gltf", [b"new"])])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.gltf": b"old"}


@pytest.mark.parametrize("number, code", [(errno.EACCES, "TXF-O02"), (errno.EIO, "TXF-O04")])
def test_an_output_that_cannot_be_looked_at_is_refused_by_its_code(tmp_path, monkeypatch, number, code):
    monkeypatch.setattr(Path, "is_dir", failing(Path.is_dir, number, lambda path: path == tmp_path / "closed"))
    with pytest.raises(InputError, match=code):
        output_files.check_target(tmp_path / "closed" / "a.glb")


def test_a_material_library_that_cannot_be_read_is_missing(tmp_path, monkeypatch):
    (tmp_path / "a.mtl").write_text("newmtl m\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    monkeypatch.setattr(Path, "read_bytes", failing(Path.read_bytes, errno.EACCES, lambda path: path.suffix == ".mtl"))
    assert "TXF-I16" in load(tmp_path / "a.obj").warnings[0]
    with pytest.raises(InputError, match="TXF-I16"):
        load(tmp_path / "a.obj", strict=True)


def test_a_cache_of_kernels_that_cannot_be_listed_is_an_empty_one(monkeypatch):
    monkeypatch.setattr(os, "scandir", failing(os.scandir, errno.EIO, lambda *_: True))
    assert precompile.kernels_compiled() is False


def test_the_stream_is_written_when_nothing_else_may_fail(call, tmp_path, monkeypatch):
    def no_memory(*_):
        raise MemoryError

    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.setattr(inspection, "inspect", no_memory)  # what the report asks for, last of all
    code, _, said = call("texf-enc", tmp_path / "a.obj", tmp_path / "a.texf", *faults.SMALL)
    assert code == 6 and "TXF-L09" in said and [path.name for path in tmp_path.iterdir()] == ["a.obj"]


@pytest.mark.parametrize("effort, said", [("balanced", "effort fast takes up to a quarter less"), ("fast", "which takes least")])
def test_an_encode_that_runs_out_of_memory_says_which_effort_takes_less(call, tmp_path, monkeypatch, effort, said):
    def no_memory(*_):
        raise MemoryError

    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.setattr("texfcodec.encoder.verify.encode_checked", no_memory)
    code, _, log = call("texf-enc", tmp_path / "a.obj", tmp_path / "a.texf", "--effort", effort)
    assert code == 6 and f"TXF-L09: there is not enough memory at effort {effort}" in log and said in log


# Sweeps


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return faults.Bench(tmp_path_factory.mktemp("faults"))


@pytest.mark.parametrize("kind", ["disk full", "input and output", "memory", "vanished"])
@pytest.mark.parametrize("name", ["enc", "info voxels", "dec texels", "dec neural"])
def test_a_tool_ends_as_it_should_whatever_call_fails(bench, name, kind):
    counts, found = faults.swept(bench, name, kind, EVERY.get(kind, 3 if kind != "vanished" else 5))
    assert not found, "\n".join(found)
    assert counts.total() >= 1


def test_a_fault_is_one_and_all_is_as_before_after_it(bench):
    usual = os.open, os.replace, open
    ends = [ended for _, ended in bench.sweep("dec voxels", "disk full")]
    failed = [ended for ended in ends if ended.code]
    assert {"open()", "os.replace()", "write()"} & {ended.fired for ended in failed}
    assert all(ended.code == 2 and "TXF-" in ended.said and ended.files == {} for ended in failed)
    assert (os.open, os.replace, open) == usual and bench.run("dec voxels", "disk full", None).code == 0


def test_ends_that_are_bad_are_named(bench):
    usual = bench.usual("dec voxels")
    good = faults.Ended(2, "", "error TXF-O03: no room", 9, "open()", {}, [])
    assert list(bench.faults("dec voxels", "disk full", good)) == []
    for change, word in (({"code": 4, "said": "error TXF-C04: internal"}, "ends with 4"), ({"said": "error: no room"}, "names"),
                         ({"said": "error TXF-L09: no memory"}, "names"), ({"said": "Traceback\nTXF-O03"}, "traceback"),
                         ({"left": ["texf-1"]}, "temporary"), ({"files": {"a.ply": b"ply"}}, "leaves"),
                         ({"code": 0, "files": {}}, "other files"), ({"code": "OSError: x"}, "OSError")):
        ended = faults.Ended(**(vars(good) | change))
        assert any(word in fault for fault in bench.faults("dec voxels", "disk full", ended)), change
    whole = faults.Ended(0, "", "", 9, "open()", usual, [])
    assert list(bench.faults("dec voxels", "disk full", whole)) == []
