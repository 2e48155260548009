"""The bitstream room: every structure goes through writer, reader and trace, and every rule that needs no decoding is kept."""

import struct
import zlib
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from texfcodec.bitstream.inspect import inspect
from texfcodec.bitstream.stream import Stream, read_stream, write_stream
from texfcodec.bitstream.syntax import (
    SEQUENCE_HEADER,
    SIGNATURE,
    UNIT_ATTRIBUTE,
    UNIT_END,
    UNIT_FIELD,
    UNIT_GEOMETRY,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    VERSION,
    structures,
)
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.codecs.raht.raht_syntax import RAHT
from texfcodec.core.syntax_table import V_MAX, Derived, Element, Structure
from texfcodec.core.syntax_walk import Reader, read_structure, write_structure, write_v
from texfcodec.errors import LimitError, StreamError, TexfError
from texfcodec.limits import Limits

FIXED = {"u8": (0, 255), "u16": (0, 65535), "u32": (0, 2**32 - 1), "i8": (-128, 127), "i32": (-(2**31), 2**31 - 1),
         "v": (0, V_MAX)}
GIVEN = {"num_materials": 3, "supports": [0, 1], "num_channel_groups": 2, "resolution": 40, "NumComponents": 3,
         "level_index": 1, "NumLevels": 4, "NumOutputs": 3, "num_fields": 2, "Planar": 1}
COUNTS = {"num_materials", "num_channel_groups", "num_slices", "name_length", "slice_level", "num_hidden",
          "num_levels", "hidden_width", "num_features", "wave_octaves", "num_parameters",
          "num_semantics"}  # kept small: they make arrays
CHARACTERS = st.characters(exclude_categories=["Cs"])


def scalars(element):
    """Values of one element: the whole range, its ends more often."""
    if element.descriptor == "f32":
        return st.floats(width=32, allow_nan=False, allow_infinity=False)
    if element.descriptor == "f64":
        low = 0.0 if element.low == 0 else -1e300
        return st.floats(low, 1e300)
    low, high = FIXED[element.descriptor]
    low = low if element.low is None else max(low, element.low)
    high = high if element.high is None else min(high, element.high)
    if element.name in COUNTS:
        high = min(high, 5)
    return st.one_of(st.integers(low, high), st.sampled_from([low, high]))


def draw_values(data, structure, values):
    """Random values of a structure by its table; values: variables known so far. Returns those of its own elements."""
    known = dict(values)
    for element in structure.elements:
        if isinstance(element, Derived):
            known[element.name] = element.value(known)
        elif element.when and not element.when[1](known):
            known[element.name] = [] if element.count else None
        elif element.descriptor == "bytes":
            least, most = (0, 40) if element.count is None else (known[element.count], known[element.count])
            known[element.name] = data.draw(st.binary(min_size=least, max_size=most))
        elif element.descriptor == "utf8":
            least = next(e.low or 0 for e in structure.elements if e.name == element.count)
            known[element.name] = data.draw(st.text(CHARACTERS, min_size=least, max_size=8))
            known[element.count] = len(known[element.name].encode())
        else:
            count = element.count and (int(element.count) if element.count.isdigit() else known[element.count])
            item = lambda i, e=element: {**known, **(e.each(known, i) if e.each else {})}
            made = [draw_values(data, element.descriptor, item(i)) if isinstance(element.descriptor, Structure)
                    else data.draw(scalars(element)) for i in range(1 if count is None else count)]
            known[element.name] = made[0] if count is None else made
    return {e.name: known[e.name] for e in structure.elements if not isinstance(e, Derived)}


def read(structure, data, known, trace=None):
    reader = Reader(data, 0, len(data))
    out = read_structure(structure, reader, dict(known), trace)
    return own_elements(structure, out), reader.position


def own_elements(structure, values):
    """What was read without the variables that follow from it, in nested structures too."""
    nested = {e.name: e.descriptor for e in structure.elements if isinstance(e, Element) and isinstance(e.descriptor, Structure)}
    return {e.name: [own_elements(nested[e.name], v) for v in values[e.name]] if e.name in nested else values[e.name]
            for e in structure.elements if isinstance(e, Element)}


@pytest.mark.parametrize("structure", structures(), ids=lambda s: s.name)
@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_what_the_writer_writes_the_reader_reads_and_the_trace_accounts_for(structure, data):
    values = draw_values(data, structure, GIVEN)
    coded, trace = write_structure(structure, {**GIVEN, **values}), []
    got, position = read(structure, coded, GIVEN, trace)
    assert got == values and position == len(coded)
    ends, last = [offset + size for _, offset, size, _ in trace], [e for e in structure.elements if isinstance(e, Element)][-1]
    assert [offset for _, offset, _, _ in trace] == [0, *ends][: len(trace)] and (not ends or ends[-1] == len(coded))
    for end in range(len(coded)):
        if last.descriptor != "bytes" or end < trace[-1][1]:
            with pytest.raises(StreamError):
                read(structure, coded[:end], GIVEN)


RANGED = [(s, e) for s in structures() for e in s.elements
          if isinstance(e, Element) and e.descriptor in FIXED and (e.low, e.high) != (None, None)]


@pytest.mark.parametrize("structure,element", RANGED, ids=lambda x: x.name)
def test_values_just_outside_their_range_are_refused_by_writer_and_reader(structure, element):
    for value in (element.low - 1, None if element.high is None else element.high + 1):
        low, high = FIXED[element.descriptor]
        if value is None:
            continue
        code = "TXF-U09" if element.registry and value > element.low else "TXF-S04"
        alone = Structure(structure.name, structure.clause, (replace(element, when=None, count=None),))
        with pytest.raises(TexfError) as caught:
            write_structure(alone, {element.name: value})
        assert caught.value.code == code
        if low <= value <= high:
            free = Structure(structure.name, structure.clause, (replace(element, when=None, count=None, low=None, high=None),))
            with pytest.raises(TexfError) as caught:
                read(alone, write_structure(free, {element.name: value}), {})
            assert (caught.value.code, caught.value.details["value"]) == (code, value)
            assert caught.value.details["clause"] == structure.clause


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1.1e300, -1.1e300])
def test_floats_that_are_not_finite_or_too_large_are_refused(value):
    origin = Structure("x", "5.3", (SEQUENCE_HEADER.elements[2],))
    with pytest.raises(StreamError) as caught:
        read(origin, struct.pack("<3d", 0.0, value, 0.0), {})
    assert caught.value.code == "TXF-S04"


# Variable-length numbers


@settings(deadline=None)
@given(st.one_of(st.integers(0, V_MAX), st.sampled_from([0, 127, 128, 16383, 16384, V_MAX])))
def test_variable_length_numbers_come_back_from_their_shortest_form(value):
    coded = write_v(value)
    assert len(coded) == max(1, -(-value.bit_length() // 7))
    reader = Reader(coded, 0, len(coded))
    assert reader.read_v("x", "4.3") == value and reader.position == len(coded)


def test_a_number_over_56_bits_is_not_written():
    field_index = Structure("x", "5.5", (Element("n", "v", 0),))
    with pytest.raises(ValueError, match="does not fit"):
        write_structure(field_index, {"n": V_MAX + 1})


@pytest.mark.parametrize("length", [6, 8])
def test_an_array_of_another_length_than_its_count_is_not_written(length):
    with pytest.raises(ValueError, match="count"):
        write_structure(Structure("x", "5.7.1", (RAHT.elements[2],)), {"kernel": [1] * length})


# Units


def units_of(*units):
    return SIGNATURE + b"".join(units)


END = write_unit(UNIT_END, b"")
PLAIN = [write_unit(t, b"\1bc") for t in (UNIT_HEADER, UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE)]


@settings(deadline=None)
@given(st.integers(0, 255), st.binary(max_size=300))
def test_a_unit_is_its_type_length_payload_and_checksum(unit_type, payload):
    unit = write_unit(unit_type, payload)
    assert unit[:-4] == bytes([unit_type]) + write_v(len(payload)) + payload
    assert int.from_bytes(unit[-4:], "little") == zlib.crc32(unit[:-4])


def test_units_are_found_where_they_stand():
    odd = write_unit(200, b"hello")
    data = units_of(PLAIN[0], odd, *PLAIN[1:], write_unit(UNIT_METADATA, b"\0x"), END)
    units, skipped = read_units(data)
    assert [u.type for u in units] == [0, 1, 2, 3, 4, UNIT_METADATA]
    assert [(u.type, data[u.begin : u.end]) for u in skipped] == [(200, b"hello")]
    assert all(data[u.begin : u.end] == b"\1bc" for u in units[:-1])
    assert [u.start for u in units][1] == skipped[0].stop


# The stream


GROUPS = [{"num_semantics": 1, "group_semantics": [0], "group_components": 3},
          {"num_semantics": 1, "group_semantics": [1], "group_components": 1}]
NO_MAPS = {"material_channels": 0, "num_parameters": 0, "parameters": []}


def attribute(field, group, components, codewords=((5, (4, 1, 0)),), planar=False):
    """Values of an attribute unit on a field of resolution 8 without slices."""
    return {"field_index": field, "group_index": group, "codec_id": 0, "level_shift": 0, "values_crc": 7, "colour_transform": 0,
            "qp": [20] * components, "kernel": [9, 0, 1, 2, 3, 4, 5], "colour_range": 5, "num_models": 6,
            "planar_transform": 1 if planar else None, "dct_blocks": 1 if planar else None,
            "component_cross": 11 if components > 1 else None, "num_filters": 1,
            "filters": [{"filter_mask": 0b10010, "filter_coefficients": [-128, 127, 0, 1, -1, 3, *([7, -9, 5, 2] * planar)]}],
            "residual": 128, "residual_cross": [16] * components, "root_mean": [-5] * components, "slice_level": 0,
            "num_slices": None, "slice_step": [], "level_index": 1,
            "codewords": [{"codeword_length": n, "level_bytes": list(b)} for n, b in codewords],
            "codeword_data": bytes(sum(n for n, _ in codewords))}


OVER_VOXELS = {"support": 0, "resolution": 8, "area_threshold": 77, "width": None, "height": None, "wrap_s": None, "wrap_t": None,
               "uv_fraction_bits": None}
OVER_TEXELS = {"support": 1, "resolution": None, "area_threshold": None, "width": 8, "height": 6, "wrap_s": 2, "wrap_t": 1,
               "uv_fraction_bits": 5}
WITH_UV = {"uv_origin": [-3, 70000], "uv_bits": 4, "uv_range": 15}


def small_stream(fields=2):
    """The first field is over voxels, the second over texels."""
    header = {"version": VERSION, "position_bits": 14, "origin": [0.5, -1.0, 2.0], "side": 3.25, "num_materials": 2,
              "num_fields": fields, "num_geometry_units": fields, "num_channel_groups": 2, "channel_groups": GROUPS}
    materials = [{"name_length": 2, "material_name": "é", "alpha_mode": 1, "alpha_cutoff": 9, "material_flags": 3,
                  "normal_rule": None, "normal_angle": None, **NO_MAPS},
                 {"name_length": 0, "material_name": "", "alpha_mode": 0, "alpha_cutoff": None, "material_flags": 0,
                  "normal_rule": 1, "normal_angle": 30, **NO_MAPS}]
    return Stream(
        header, materials,
        [{"field_index": i, **(OVER_TEXELS if i % 2 else OVER_VOXELS), "num_keys": 30, "keys_crc": 1} for i in range(fields)],
        [{"field_index": i, "material_index": i % 2, "unit_vertices": 5, "unit_faces": 4, **(WITH_UV if i % 2 else {}),
          "geometry_crc": 7, "draco_data": b"draco"} for i in range(fields)],
        [attribute(i, g, GROUPS[g]["group_components"], planar=i % 2 > 0) for i in range(fields) for g in range(2)], b'{"a": 1}')


def plain(values, like):
    """The elements that were written, out of all that was read, in nested structures too."""
    def one(value, wanted):
        if isinstance(wanted, list) and wanted and isinstance(wanted[0], dict):
            return [plain(v, w) for v, w in zip(value, wanted, strict=True)]
        return bytes(value) if isinstance(value, memoryview) else value

    return {k: one(values[k], wanted) for k, wanted in like.items()}


def test_a_stream_comes_back_unit_by_unit():
    stream = small_stream()
    data, sizes = write_stream(stream)
    got = read_stream(data, Limits())
    assert sum(sizes.values()) == len(data)
    for name in ("header", "materials", "fields", "metadata"):
        assert getattr(got, name) == getattr(stream, name)
    for name in ("geometry", "attributes"):
        pairs = zip(getattr(got, name), getattr(stream, name), strict=True)
        assert all(plain(a, b) == b for a, b in pairs)
    assert all(data[g["offset"] :][:5] == b"draco" for g in got.geometry)


def test_inspect_names_every_byte_exactly_once():
    data = write_stream(small_stream())[0][:-len(END)] + write_unit(199, b"later") + END
    facts = inspect(data)
    rows = [(e["offset"], e["size"]) for u in facts["units"] for e in u["elements"]]
    position = len(SIGNATURE)
    for offset, size in rows:
        assert offset == position
        position += size
    assert position == len(data) == facts["bytes"]["total"] == sum(v for k, v in facts["bytes"].items() if k != "total")
    assert [u["name"] for u in facts["units"]][-2:] == ["unknown", "end"]
    assert facts["groups"][0]["level_bytes"] == [4, 1, 0] and facts["fields"][1]["geometry_units"] == 1


def test_an_empty_stream_is_valid():
    stream = small_stream(0)
    stream.header.update(num_materials=0)
    stream.materials = []
    assert read_stream(write_stream(stream)[0], Limits()).fields == []


def test_more_materials_than_the_bytes_can_hold_are_refused_before_any_is_read():
    header = {**small_stream().header, "num_materials": 60000}
    data = units_of(write_unit(UNIT_HEADER, write_structure(SEQUENCE_HEADER, header)), write_unit(UNIT_MATERIALS, bytes(9)), END)
    with pytest.raises(StreamError, match="TXF-S02: the data ends inside materials"):
        read_stream(data, Limits())


@pytest.mark.parametrize("limits,code", [
    (Limits(file_bytes=100), "TXF-L01"),
    (Limits(vertices=9), "TXF-L02"),
    (Limits(faces=7), "TXF-L03"),
    (Limits(voxels=59), "TXF-L04"),
    (Limits(metadata_bytes=8), "TXF-L06"),
    (Limits(texels=47), "TXF-L11"),
])
def test_each_limit_that_needs_no_decoding_refuses_with_its_code(limits, code):
    data = write_stream(small_stream())[0]
    with pytest.raises(LimitError) as caught:
        read_stream(data, limits)
    assert caught.value.code == code and caught.value.exit_code == 6
    read_stream(data, Limits(file_bytes=len(data), vertices=10, faces=8, voxels=60, texels=48, metadata_bytes=9))


def test_a_limit_of_zero_or_none_is_off():
    off = Limits(file_bytes=0, vertices=None, faces=0, voxels=None, texels=0, samples=0, latents=0, metadata_bytes=0,
                 image_pixels=0)
    assert set(vars(off).values()) == {None, 4 << 30, 120}
    assert read_stream(write_stream(small_stream())[0], off).fields


# Slices and the index


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_raht_parameters_with_slices_come_back_with_each_codewords_own_levels(data):
    """NumLevels differs from codeword to codeword: the trunk has slice_level levels, every slice the rest."""
    depth, level, slices = 6, data.draw(st.integers(1, 5)), data.draw(st.integers(1, 8))
    lengths = data.draw(st.lists(st.integers(0, 30), min_size=slices + 1, max_size=slices + 1))
    values = {**attribute(0, 0, 3), "slice_level": level, "num_slices": slices,
              "slice_step": data.draw(st.lists(st.integers(1, V_MAX), min_size=slices - 1, max_size=slices - 1)),
              "codewords": [{"codeword_length": n, "level_bytes": [7] * (level if i == 0 else depth - level)}
                            for i, n in enumerate(lengths)], "codeword_data": bytes(sum(lengths))}
    known = {"resolution": 64, "NumComponents": 3, "Planar": 0}
    coded = write_structure(RAHT, {**values, **known})
    reader = Reader(coded, 0, len(coded))
    got = read_structure(RAHT, reader, dict(known))
    written = {e.name: values[e.name] for e in RAHT.elements if not isinstance(e, Derived)}
    assert plain(got, written) == written


def test_the_tables_of_the_specification_are_those_of_the_code():
    from conformance.make import spec_tables as gen_spec_tables

    text = gen_spec_tables.SPEC.read_text(encoding="utf-8")
    assert gen_spec_tables.with_tables(text) == text
    wrong = text.replace("| position_bits | `u8` | 8..20 |", "| position_bits | `u8` | 8..21 |")
    assert wrong != text and gen_spec_tables.with_tables(wrong) == text
