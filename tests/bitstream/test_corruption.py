"""Damaged and lying streams: the decoder ends with a result or a coded error, in bounded time and memory."""

import json
import os
import pickle
import subprocess
import sys
import zlib

import numpy as np
import pytest
from conftest import REPOSITORY
from damage import END, fields_of, outcome, repacked, small, with_a_bit_flipped
from shapes import painted_sphere

from texfcodec.api import decode
from texfcodec.bitstream.inspect import inspect
from texfcodec.bitstream.stream import read_stream, write_stream
from texfcodec.bitstream.syntax import UNIT_ATTRIBUTE, UNIT_FIELD, UNIT_GEOMETRY, UNIT_HEADER, UNIT_METADATA
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.errors import StreamError, SupportError
from texfcodec.field.keyed import keys_crc
from texfcodec.field.voxelise import voxelise
from texfcodec.limits import Limits
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report

# Whole streams


@pytest.mark.parametrize("kind", ["sphere", "sheets", "texels"])
def test_decoder_refuses_every_prefix(kind):
    data = small(kind)
    for end in range(len(data)):
        with pytest.raises(StreamError):
            decode(data[:end])


@pytest.mark.parametrize("kind", ["sphere", "sheets", "texels"])
def test_decoder_refuses_a_flipped_bit_in_any_byte(kind):
    for damaged in with_a_bit_flipped(small(kind)):
        with pytest.raises((StreamError, SupportError)):
            decode(damaged)


@pytest.mark.parametrize("cut", [1, 4, 20])
def test_decoder_refuses_a_stream_with_bytes_missing_in_the_middle(cut):
    data = small()
    for i in range(0, len(data) - cut, 7):
        with pytest.raises((StreamError, SupportError)):
            decode(data[:i] + data[i + cut :])


def test_unknown_ancillary_units_are_skipped_and_named_and_critical_ones_refused():
    data = small()
    first = read_units(data)[0][0].stop
    report = Report()
    odd = data[:first] + write_unit(250, b"future") + data[first:-6] + write_unit(199, b"") + END
    texf = decode(odd, report=report)
    assert [s["type"] for s in texf.skipped] == [250, 199] and len(report.warnings) == 2 and "250" in report.warnings[0]
    assert [(f.keys.tolist(), f.rgba.tolist()) for f in texf.fields] == fields_of(data)
    with pytest.raises(SupportError) as caught:
        decode(data[:-6] + write_unit(127, b"") + END)
    assert caught.value.code == "TXF-U01" and caught.value.exit_code == 5


def test_metadata_that_are_no_json_object_are_passed_over_with_a_warning():
    for raw in (b"\0not json", b"\0[1]", b"\0" + b"[" * 5000, b"\0\xff\xfe", b"\0"):
        report = Report()
        data = repacked(small("sheets"), lambda t, p, raw=raw: raw if t == UNIT_METADATA else p)
        assert decode(data, report=report).metadata == {} and any("metadata" in w for w in report.warnings)


# Payloads under a right checksum


def test_a_draco_substream_without_points_is_refused():
    """One bit of two triangles' connectivity, found by the search below."""
    def change(unit_type, payload):
        if unit_type == UNIT_GEOMETRY and payload[1] == 0:
            payload[31] ^= 1
        return payload

    assert outcome(repacked(small("sheets"), change)) == "TXF-S20"


def attribute_data():
    return bytes(read_stream(small(), Limits()).attributes[0]["codeword_data"])


def test_every_flipped_codeword_bit_that_changes_a_value_is_caught():
    """All bits of the first 40 bytes: most are noticed, and what is not has decoded to the very same values."""
    length, caught = len(attribute_data()), 0
    for bit in range(8 * min(40, length)):
        def change(unit_type, payload, bit=bit):
            if unit_type == UNIT_ATTRIBUTE:
                payload[len(payload) - length + bit // 8] ^= 1 << bit % 8
            return payload

        bent = repacked(small(), change)
        code = outcome(bent)
        caught += code == "TXF-S32"
        assert code == "TXF-S32" or fields_of(bent) == fields_of(small())
    assert caught >= 0.9 * 8 * min(40, length)


def restated(change, kind="sphere"):
    """The small stream with its parsed values changed and written again."""
    stream = read_stream(small(kind), Limits())
    for unit in (*stream.geometry, *stream.attributes):
        for name, value in unit.items():
            unit[name] = bytes(value) if isinstance(value, memoryview) else value
    change(stream)
    return write_stream(stream)[0]


@pytest.mark.parametrize("kind", ["sphere", "sheets", "texels"])
def test_restating_without_a_change_gives_the_same_bytes(kind):
    assert restated(lambda s: None, kind) == small(kind)


def lie(where, index=0, **values):
    return lambda s: (s.header if where == "header" else getattr(s, where)[index]).update(values)


@pytest.mark.parametrize("limits,code", [(Limits(samples=30), "TXF-L05"), (Limits(voxels=90), "TXF-L04"),
                                         (Limits(texels=255), "TXF-L11")])
def test_a_field_over_texels_meets_the_limits(limits, code):
    assert outcome(small("texels"), DecodeOptions(limits=limits, threads=1)) == code


def test_images_that_nobody_needs_count_as_samples():
    """Many fields of large images with a face each would take long without a sample."""
    large = lie("fields", width=16384, height=8192)
    assert outcome(restated(large, "texels"), DecodeOptions(limits=Limits(samples=1 << 22), threads=1)) == "TXF-L05"


@pytest.mark.parametrize("limits,code", [(Limits(samples=1 << 20), "TXF-L05"), (Limits(voxels=50_000), "TXF-L04")])
def test_a_resolution_that_lies_meets_the_limits(limits, code):
    huge = lie("fields", resolution=8192 if code == "TXF-L05" else 256, num_keys=1)

    def change(stream):
        huge(stream)
        for unit in stream.attributes:  # the codeword header must fit the new depth
            depth = 13 if code == "TXF-L05" else 8
            unit["codewords"] = [{"codeword_length": len(unit["codeword_data"]), "level_bytes": [0] * depth}]

    assert outcome(restated(change), DecodeOptions(limits=limits, threads=1)) == code


# Draco that lies


def with_draco(data, vertices=None, faces=None):
    def change(stream):
        unit = stream.geometry[0]
        unit["draco_data"] = data
        unit["unit_vertices"], unit["unit_faces"] = vertices or unit["unit_vertices"], faces or unit["unit_faces"]

    return restated(change)


def test_bytes_after_the_end_of_the_draco_mesh_are_ignored():
    """Draco does not say how many bytes it read; spec 5.6 allows them."""
    good = bytes(read_stream(small(), Limits()).geometry[0]["draco_data"])
    assert outcome(with_draco(good + b"hidden")) == "decoded"


# Memory


WITNESS = """
import numpy as np
from texfcodec.errors import LimitError
from texfcodec.report import peak_memory_bytes
from texfcodec.field.voxelise import voxelise
corners = np.array([[0, 0, 0], [16383, 0, 0], [16383, 16383, 0], [0, 16383, 0]])
faces = np.array([[0, 1, 2], [0, 2, 3]])
voxelise(corners, faces, 14, 8)
before = peak_memory_bytes()
try:
    voxelise(corners, faces, 14, 2048, max_voxels=1000)
except LimitError:
    print((peak_memory_bytes() - before) >> 20)
"""


def test_a_surface_over_the_voxel_limit_is_refused_before_its_memory_is_taken():
    run = subprocess.run([sys.executable, "-c", WITNESS], cwd=REPOSITORY, capture_output=True, text=True, check=False,
                         env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) < 20  # megabytes, for a limit of 1000 voxels


# Compiled code with its bounds checked


CHECKED = """
import json, pickle, sys
import numba, numpy as np
sys.path.insert(0, "tests")
from damage import outcome, small

@numba.njit
def beyond(a):
    return a[7]

try:
    beyond(np.zeros(3))
    raise SystemExit("bounds are not checked")
except IndexError:
    pass
small(), small("sheets"), small("texels")
print(json.dumps([outcome(s) for s in pickle.load(open(sys.argv[1], "rb"))]))
"""


def corpus():
    """Attribute units bent under right checksums, geometry, fields and headers too, sliced and not."""
    from texfcodec.codecs.raht import attribute_coder

    rng, streams = np.random.default_rng(4), []
    before = attribute_coder.WHOLE_VOXELS, attribute_coder.SLICE_VOXELS, attribute_coder.SLICE_NODES
    attribute_coder.WHOLE_VOXELS, attribute_coder.SLICE_VOXELS, attribute_coder.SLICE_NODES = 1, 60, 8
    try:
        sliced = encode_scene(painted_sphere(3), EncodeOptions(resolution=12, qp=20, partition="off")).data
    finally:
        attribute_coder.WHOLE_VOXELS, attribute_coder.SLICE_VOXELS, attribute_coder.SLICE_NODES = before
    assert len(inspect(sliced)["groups"][0]["codeword_bytes"]) > 3
    for source in (small(), small("sheets"), small("texels"), sliced):
        for kind in (UNIT_ATTRIBUTE, UNIT_ATTRIBUTE, UNIT_FIELD, UNIT_GEOMETRY, UNIT_HEADER):
            for _ in range(12):
                def change(unit_type, payload, kind=kind):
                    if unit_type == kind:
                        for i in rng.integers(0, len(payload), 2).tolist():
                            payload[i] ^= 1 << int(rng.integers(8))
                    return payload

                streams.append(repacked(source, change))
    return streams


@pytest.mark.slow
def test_with_bounds_checked_no_damaged_stream_reads_outside_an_array(tmp_path):
    """The checked code is compiled into a cache of its own, so that it meets nobody else; unchecked code ends the same way."""
    streams = corpus()
    (tmp_path / "corpus").write_bytes(pickle.dumps(streams))
    environment = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(REPOSITORY)}
    run = subprocess.run([sys.executable, "-c", CHECKED, str(tmp_path / "corpus")], cwd=REPOSITORY, capture_output=True,
                         text=True, check=False, env={**os.environ, **environment})
    assert run.returncode == 0, run.stderr[-3000:]
    codes = json.loads(run.stdout)
    assert codes == [outcome(s) for s in streams]
    assert codes.count("TXF-S32") >= 20 and len(set(codes)) >= 5


def test_the_checksum_of_the_voxels_is_the_one_of_their_keys():
    keys, _ = voxelise(np.array([[0, 0, 0], [255, 0, 0], [0, 255, 0]]), np.array([[0, 1, 2]]), 8, 16)
    assert keys_crc(keys) == zlib.crc32(b"".join(k.to_bytes(8, "little") for k in keys.tolist()))
