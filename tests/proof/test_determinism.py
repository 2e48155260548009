"""The same bytes and arrays whatever the number of threads, and with the JIT off."""

import json
import os
import subprocess
import sys

import pytest
from conftest import REPOSITORY
from shapes import crossing_sheets, painted_sphere

from texfcodec.api import decode
from texfcodec.codecs.raht import attribute_coder as codec_room
from texfcodec.encoder.encode import encode_scene
from texfcodec.field import voxelise as voxelise_room
from texfcodec.options import DecodeOptions, EncodeOptions
from tools.proof import determinism
from tools.proof.determinism import ARRAYS, FAILS, NOT_RUN, SAME, STREAM, verdicts_of
from tools.proof.determinism_child import fingerprint


@pytest.fixture
def many_parts(monkeypatch):
    """Small meshes are cut like large ones: a slab for every thread, slices of 1000 voxels."""
    monkeypatch.setattr(voxelise_room, "MIN_SLAB_SAMPLES", 1)
    monkeypatch.setattr(codec_room, "WHOLE_VOXELS", 1)
    monkeypatch.setattr(codec_room, "SLICE_VOXELS", 1000)
    monkeypatch.setattr(codec_room, "SLICE_NODES", 64)


@pytest.mark.parametrize("make,options", [(painted_sphere, {"qp": 16}), (crossing_sheets, {"qp": 30})])
def test_bytes_and_arrays_are_the_same_for_1_2_3_and_8_threads(make, options, many_parts):
    made = {t: encode_scene(make(), EncodeOptions(resolution=64, threads=t, **options)).data for t in (1, 2, 3, 8)}
    assert len(set(made.values())) == 1
    decoded = [fingerprint(decode(made[1], DecodeOptions(threads=t))) for t in made]
    assert all(d == decoded[0] for d in decoded)


def test_the_parts_are_really_many(many_parts):
    from texfcodec.bitstream.inspect import inspect

    data = encode_scene(painted_sphere(), EncodeOptions(resolution=64, qp=16)).data
    assert len(inspect(data)["groups"][0]["codeword_bytes"]) == 1 + 2 * -(-inspect(data)["voxels"] // 2000) > 5


def test_the_same_scene_twice_is_the_same_stream():
    first, second = (encode_scene(painted_sphere(), EncodeOptions(resolution=40, qp=30)).data for _ in range(2))
    assert first == second


@pytest.mark.parametrize("level", [1, 3, 6, 9])
def test_levels_of_detail_do_not_depend_on_threads(level, many_parts):
    data = encode_scene(painted_sphere(), EncodeOptions(resolution=64, qp=16)).data
    one, three = (fingerprint(decode(data, DecodeOptions(lod=level, threads=t))) for t in (1, 3))
    assert one == three


PLAIN_PYTHON = """
import json, sys
sys.path[:0] = ["tests", "tests/proof"]
import numba
from test_determinism import jit_off_cases
assert numba.config.DISABLE_JIT == (sys.argv[1] == "off")
print(json.dumps(jit_off_cases()))
"""


def jit_off_cases():
    """[stream as hexadecimal, fingerprints] of a few tiny meshes, small enough for interpreted kernels."""
    out = []
    for scene, resolution, qp in ((painted_sphere(3), 8, 4), (crossing_sheets(), 6, 20)):
        data = encode_scene(scene, EncodeOptions(partition="off", threads=2, resolution=resolution, qp=qp)).data
        out.append([data.hex(), fingerprint(decode(data)), fingerprint(decode(data, DecodeOptions(lod=1)))])
    return out


@pytest.mark.slow
def test_without_the_jit_the_bytes_and_arrays_are_the_same():
    """Plain Python integers do not wrap and numpy's warn: warnings are errors here, so nothing overflows either."""
    run = subprocess.run([sys.executable, "-W", "error::RuntimeWarning", "-c", PLAIN_PYTHON, "off"], cwd=REPOSITORY,
                         capture_output=True, text=True, check=False,
                         env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(REPOSITORY)})
    assert run.returncode == 0, run.stderr[-3000:]
    assert json.loads(run.stdout) == jit_off_cases()


def test_without_the_jit_morton_keys_are_made_too():
    program = "from texfcodec.field.morton import decode_morton; print(decode_morton([511]).tolist())"
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False,
                         env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(REPOSITORY)})
    assert run.stdout.strip() == "[[7, 7, 7]]", run.stderr[-500:]


# The matrix of tools/proof/determinism.py


def doctored(path, **changes):
    """Changes the last row that a configuration has left behind."""
    *rows, last = path.read_text().splitlines()
    path.write_text("\n".join([*rows, json.dumps(json.loads(last) | changes)]) + "\n")


@pytest.mark.slow
def test_the_quick_matrix_is_all_the_same_and_a_doctored_difference_is_told(tmp_path, capsys):
    call = ["--quick", "--out", str(tmp_path), "--page", str(tmp_path / "page.md")]
    assert determinism.main(call) == 0
    page = (tmp_path / "page.md").read_text()
    assert "| tiny maps | same | " in page and STREAM not in page
    place = next(one for one in determinism.CONFIGURATIONS if one.name == determinism.QUICK[1])
    kept = tmp_path / f"{place.slug}.jsonl"
    if kept.exists():  # where the system has the locale
        assert json.loads(kept.read_text().splitlines()[0])["facts"]["decimal point"] == ","
    begun = capsys.readouterr().out
    doctored(tmp_path / "7_threads.jsonl", stream="0" * 64)
    assert determinism.main(call) == 7
    said = capsys.readouterr().out
    assert "7 threads: tiny" in begun and "7 threads: tiny" not in said.split("# Determinism")[0]  # nothing was coded again
    assert f"| tiny maps | {STREAM} (" in said
    doctored(tmp_path / "7_threads.jsonl", arrays={})
    assert determinism.main(call) == 7 and f"| tiny maps | {ARRAYS} (" in capsys.readouterr().out


def run_of(configuration, rows, reason=""):
    """A determinism.Run as it ends."""
    run = determinism.Run.__new__(determinism.Run)
    run.configuration, run.facts, run.rows, run.reason = configuration, None, rows, reason
    return run


def test_every_verdict_says_why_and_the_worst_of_a_row_counts():
    sound = {"stream": "a", "bytes": 3, "arrays": {"keys": "k"}}
    cases = [determinism.Case(key, "both", tiny=key == "one") for key in ("one", "two")]
    reference = run_of(determinism.REFERENCE, {"one": sound, "two": sound})

    def verdict(rows, reason="", name="2 threads"):
        configuration = next(one for one in determinism.CONFIGURATIONS if one.name == name)
        return verdicts_of([reference, run_of(configuration, rows, reason)], cases)["both"][name]

    assert verdict({"one": sound, "two": sound}).text == SAME
    other = verdict({"one": sound, "two": sound | {"stream": "b", "bytes": 4}})
    assert other.text == STREAM and other.differs and "two: 4 bytes, where the reference has 3" in other.why
    assert verdict({"one": sound | {"arrays": {"keys": "l"}}, "two": sound | {"stream": "b"}}).text == ARRAYS
    assert verdict({"one": {"error": "ValueError: no"}, "two": sound}).text == FAILS
    missing = verdict({"one": sound}, "its process ended with -9 at two")
    assert missing.text == NOT_RUN and "-9" in missing.why and not missing.differs
    assert verdict({"one": sound}, name="JIT off").why == determinism.SLOW_PYTHON


def test_a_configuration_that_is_not_what_it_says_is_not_run(tmp_path):
    lie = determinism.Configuration("a lie", "", {"decimal point": ";"})
    args = type("Arguments", (), {"out": tmp_path, "environments": False, "python": []})
    run = determinism.run(lie, determinism.cases_of(None, True)[:1], args, {})
    assert not run.rows and run.reason == "decimal point is '.', not ';'"
    environment = next(one for one in determinism.CONFIGURATIONS if one.python)
    assert "--environments" in determinism.run(environment, determinism.cases_of(None, True)[:1], args, {}).reason


def test_cases_have_keys_of_their_own_and_assets_ways_of_their_own(tmp_path):
    cases = determinism.cases_of(tmp_path, False)
    assert len({case.key for case in cases}) == len(cases) > 150 and len(determinism.ASSETS) == 12
    assert len({json.dumps(options) for options in determinism.ASSETS.values()}) == 12
    assert any("small vectors" in case.name and case.tiny for case in cases)
