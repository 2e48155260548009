"""A second process that compiles kernels beside a first run."""

import threading

import pytest

from texfcodec.batch import compile_beside as room
from texfcodec.codecs.raht.coefficients import mixed, residual
from texfcodec.field import voxelise
from texfcodec.io.atlas import chart_packing
from texfcodec.precompile import SAVING, compile_later_stages, compile_saving
from texfcodec.render import triangles


def test_kernels_of_every_later_stage_are_run():
    compile_later_stages()
    for entry in (mixed._enc_mixed_level, mixed._dec_mixed_level, residual._enc_residuals, voxelise._touched, triangles._set_up):
        assert entry.signatures, entry.py_func.__name__


def test_kernels_of_saving_are_run():
    compile_saving()
    assert chart_packing._pack.signatures


@pytest.mark.parametrize("threads, processors, compiled, begins",
                         [(2, 2, False, True), (1, 2, False, False), (2, 1, False, False), (2, 2, True, False)])
def test_it_begins_where_kernels_are_missing_and_a_processor_is_idle(monkeypatch, threads, processors, compiled, begins):
    asked, begun = [], threading.Event()

    def run(self, words, *rest):
        asked.extend(words)
        begun.set()

    monkeypatch.setattr(room, "kernels_compiled", lambda: compiled)
    monkeypatch.setattr(room, "default_threads", lambda: processors)
    monkeypatch.setattr(room.Children, "run", run)
    room.compile_beside(threads, SAVING)
    assert begun.wait(20 if begins else 0.3) == begins and asked == ["-m", compile_later_stages.__module__, SAVING] * begins
