"""A second process that compiles kernels beside a first run."""

import subprocess
import sys
import threading

import pytest

from texfcodec.batch import compile_beside as room
from texfcodec.cli.dec import _stages
from texfcodec.codecs.raht.coefficients import mixed
from texfcodec.codecs.raht.transform import octree
from texfcodec.core.kernel import PACKAGE
from texfcodec.field import query, voxelise
from texfcodec.io.atlas import chart_packing, chart_padding
from texfcodec.precompile import STAGES, compile_decoding, compile_encoding, compile_saving, kernels_compiled
from texfcodec.render import triangles


def test_kernels_of_every_later_stage_are_run():
    compile_encoding()
    for entry in (mixed._enc_mixed_level, mixed._dec_mixed_level, voxelise._touched, triangles._set_up):
        assert entry.signatures, entry.py_func.__name__


def test_kernels_of_decoding_are_run():
    compile_decoding()
    assert mixed._dec_mixed_level.signatures and octree._neighbours.signatures


def test_kernels_of_saving_are_run():
    compile_saving()
    for entry in (chart_packing._pack, chart_padding._continue, query._query):
        assert entry.signatures, entry.py_func.__name__


def test_a_process_of_its_own_leaves_the_kernels_that_saving_looks_for(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    entries = STAGES["save"].entries
    assert not kernels_compiled(entries)
    subprocess.run([sys.executable, "-m", compile_saving.__module__, "save"], check=True, cwd=PACKAGE.parent, timeout=300)
    assert kernels_compiled(entries) and not kernels_compiled()  # nothing was coded for it


def missing_stages(monkeypatch, threads, processors, compiled, stages, patience):
    """What is begun for these stages, of which some are compiled: words of the command line, [] where nothing is."""
    asked, begun = [], threading.Event()

    def run(self, words, *rest):
        asked.extend(words)
        begun.set()

    monkeypatch.setattr(room, "kernels_compiled", lambda entries: entries in [STAGES[name].entries for name in compiled])
    monkeypatch.setattr(room, "default_threads", lambda: processors)
    monkeypatch.setattr(room.Children, "run", run)
    room.compile_beside(threads, *stages)
    begun.wait(patience)
    return asked


@pytest.mark.parametrize("compiled, missing", [([], ["decode", "save"]), (["decode"], ["save"]), (["save"], ["decode"])])
def test_what_is_missing_is_compiled(monkeypatch, compiled, missing):
    asked = missing_stages(monkeypatch, 2, 2, compiled, ["decode", "save"], 20)
    assert asked == ["-m", compile_saving.__module__, *missing]


@pytest.mark.parametrize("threads, processors, compiled", [(1, 2, []), (2, 1, []), (2, 2, ["decode", "save"])])
def test_nothing_begins_where_no_kernel_is_missing_or_no_processor_idle(monkeypatch, threads, processors, compiled):
    assert missing_stages(monkeypatch, threads, processors, compiled, ["decode", "save"], 0.3) == []


@pytest.mark.parametrize("out, appearance, compiles, over_voxels, stages", [
    ("a.glb", None, False, True, ["save"]), ("-", "texture", True, True, ["decode", "save"]), ("a.glb", None, False, False, []),
    ("a.obj", "vertex", True, True, ["decode"]), ("a.npz", None, False, True, []), ("a.PLY", None, True, True, ["decode"]),
    ("a.texf", None, True, True, ["decode"]),
])
def test_texf_dec_has_what_it_needs_compiled(out, appearance, compiles, over_voxels, stages):
    assert list(_stages(out, appearance, compiles, lambda: over_voxels)) == stages
