"""The same bytes and arrays whatever the number of threads, and with the JIT off."""

import hashlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import REPOSITORY
from shapes import crossing_sheets, painted_sphere

from texfcodec.api import decode
from texfcodec.codecs.raht import codec as codec_room
from texfcodec.encoder import encode_scene
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.support import voxelise as voxelise_room


def fingerprint(texf):
    """SHA-256 of every decoded array."""
    arrays = [texf.lattice_positions, texf.faces, texf.face_material, *(a for f in texf.fields for a in (f.keys, f.rgba))]
    return [hashlib.sha256(np.ascontiguousarray(a).tobytes()).hexdigest() for a in arrays]


@pytest.fixture
def many_parts(monkeypatch):
    """Small meshes are cut like large ones: a slab for every thread, slices of 1000 voxels."""
    monkeypatch.setattr(voxelise_room, "MIN_SLAB_SAMPLES", 1)
    monkeypatch.setattr(codec_room, "WHOLE_VOXELS", 1)
    monkeypatch.setattr(codec_room, "SLICE_VOXELS", 1000)
    monkeypatch.setattr(codec_room, "SLICE_NODES", 64)


@pytest.mark.parametrize("make,options", [(painted_sphere, {"qp": 16}), (crossing_sheets, {"qp": 30, "effort": "best"})])
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
sys.path.insert(0, "tests")
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
    program = "from texfcodec.support.morton import decode_morton; print(decode_morton([511]).tolist())"
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False,
                         env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(REPOSITORY)})
    assert run.stdout.strip() == "[[7, 7, 7]]", run.stderr[-500:]
