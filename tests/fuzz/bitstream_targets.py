"""Targets of the bitstream: framing, the units before the codecs, the stream as a whole, its description, the child's answer."""

import copy
import json
from functools import lru_cache

import numpy as np

from fuzz.choices import Choices, edited
from fuzz.seeds import SMALL, vectors, vectors_with
from fuzz.syntax import bent_stream, framed, traced
from fuzz.trees import bend_tree
from texfcodec.bitstream.appearance import check_groups, check_material, groups_of, material_of
from texfcodec.bitstream.inspect import inspect
from texfcodec.bitstream.stream import Stream, read_stream, write_stream
from texfcodec.bitstream.syntax import (
    CHANNEL_GROUP,
    MATERIAL,
    MAX_GROUPS,
    SIGNATURE,
    UNIT_ATTRIBUTE,
    UNIT_CODED_NORMALS,
    UNIT_END,
    UNIT_FIELD,
    UNIT_GEOMETRY,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    UNIT_SHARP_EDGES,
    VERSION,
)
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.core.syntax_table import Element, Structure
from texfcodec.core.syntax_walk import Reader, read_structure, write_structure, write_v
from texfcodec.decoder import decode_stream
from texfcodec.options import DecodeOptions
from texfcodec.report import Report
from texfcodec.sandbox import isolate
from texfcodec.sandbox.answer import texf_of

OPTIONS = DecodeOptions(limits=SMALL, threads=1)
OF_UNITS = (UNIT_HEADER, UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE, UNIT_END, UNIT_METADATA, UNIT_SHARP_EDGES,
            UNIT_CODED_NORMALS, 6, 127, 131, 255)


def decoded(data: bytes, lod: int = 0) -> None:
    """Decodes a stream within small limits and looks at what came out."""
    report = Report()
    texf = decode_stream(data, DecodeOptions(limits=SMALL, threads=1, lod=lod), report)
    for field in texf.fields:
        for channel, plane in field.planes.items():
            assert plane.dtype == np.uint8 and len(plane) == len(field.support_of(channel))
    assert (texf.faces < len(texf.lattice_positions)).all()
    json.dumps([texf.metadata, report.warnings, report.channels])


def numbers(data: bytes) -> None:
    """Variable-length numbers (4.3): what is read is written the same way, and every number comes back."""
    choices = Choices(data)
    value = abs(choices.number())
    written = write_v(value)
    if len(written) <= 8:
        assert Reader(written, 0, len(written)).read_v("a number", "4.3") == value
    raw = choices.rest()
    reader = Reader(raw, 0, len(raw), base=7)
    while reader.position < reader.end:
        begin = reader.position
        value = reader.read_v("a number", "4.3")
        assert write_v(value) == raw[begin : reader.position] and value < 1 << 56


def framing(data: bytes) -> None:
    """Signature, units of any type in any order, with lengths and checksums that are right or lie (5.1, 5.2)."""
    choices = Choices(data)
    kinds = [choices.pick(OF_UNITS) for _ in range(choices.whole(0, 6))]
    if not choices.flag(4):
        kinds = [UNIT_HEADER, *sorted({kind for kind in kinds if kind not in (UNIT_HEADER, UNIT_END, 6, 127)})]
    out = bytearray(SIGNATURE)
    for kind in kinds:
        unit = write_unit(kind, bytes([VERSION]) * (kind == UNIT_HEADER) + choices.take(choices.whole(0, 20)))
        out += edited(unit, choices) if choices.flag(12) else unit
    out += write_unit(UNIT_END, choices.take(1) if choices.flag(6) else b"")
    whole = edited(bytes(out), choices) if choices.flag(8) else bytes(out)
    units, skipped = read_units(whole, SMALL.file_bytes)
    again = b"".join(whole[unit.start : unit.stop] for unit in sorted([*units, *skipped], key=lambda unit: unit.start))
    assert SIGNATURE + again + write_unit(UNIT_END, b"") == whole


def _bent(kinds, most=2):
    """A target: a vector with units of these kinds bent is decoded as a whole."""
    def target(data):
        choices = Choices(data)
        source = choices.pick(vectors())
        decoded(bent_stream(source, choices, kinds, most), choices.whole(0, 1))

    return target


header, materials, field = _bent((UNIT_HEADER,)), _bent((UNIT_MATERIALS,)), _bent((UNIT_FIELD,))
geometry_unit, attribute_unit = _bent((UNIT_GEOMETRY,), 1), _bent((UNIT_ATTRIBUTE,))


@lru_cache(maxsize=1)
def _with_metadata():
    """A small vector that has metadata."""
    units = [(kind, payload) for kind, payload, _ in traced(vectors()[1]) if kind != UNIT_METADATA]
    return framed([*units, (UNIT_METADATA, b'\0{"copyright":"none"}')])


def metadata(data: bytes) -> None:
    """The metadata unit: any bytes, and JSON that is odd."""
    choices = Choices(data)
    tree = bend_tree({"copyright": "none", "nodes": ["a", {"b": 1.5}]}, choices)
    raw = choices.rest() if choices.flag() else json.dumps(tree).encode("utf-8", "surrogatepass")
    units = [(kind, payload if kind != UNIT_METADATA else b"\0" + raw) for kind, payload, _ in traced(_with_metadata())]
    decoded(framed(units))


def geometry_counts(data: bytes) -> None:
    """Units that repeat, are missing or change their places, with counts in the header that go along or not (5.2)."""
    choices = Choices(data)
    units = [(kind, payload) for kind, payload, _ in traced(choices.pick(vectors()))]
    for _ in range(choices.whole(1, 2)):
        kind, a, b = choices.whole(0, 2), choices.whole(0, len(units) - 1), choices.whole(0, len(units) - 1)
        if kind == 0:
            units.insert(b, units[a])
        elif kind == 1 and len(units) > 1:
            del units[a]
        else:
            units[a], units[b] = units[b], units[a]
    decoded(framed(units))


def restated(data: bytes) -> None:
    """Values of a parsed stream bent where the tables let them, and written again: what was written is read, the same."""
    choices = Choices(data)
    try:
        stream = read_stream(bent_stream(choices.pick(vectors()), choices, OF_UNITS), SMALL)
        written, sizes = write_stream(_with_bytes(stream))
    except ValueError as error:  # a count that its array no longer has cannot be written, and says so
        raise AssertionError(f"what was read cannot be written: {error}") from error
    again = read_stream(written, SMALL)
    assert sum(sizes.values()) == len(written) and again.header == stream.header and again.fields == stream.fields
    assert write_stream(_with_bytes(again))[0] == written


def _with_bytes(stream: Stream) -> Stream:
    for unit in (*stream.geometry, *stream.attributes, *([stream.sharp_edges] if stream.sharp_edges else [])):
        unit.update({name: bytes(value) for name, value in unit.items() if isinstance(value, memoryview)})
    return stream


def stream(data: bytes) -> None:
    """The whole decoder on raw bytes, and on vectors with bytes edited, checksums right again or not."""
    choices = Choices(data)
    if choices.flag(8):
        return decoded(SIGNATURE + choices.rest())
    source = choices.pick(vectors())
    if choices.flag():
        return decoded(edited(source, choices))
    units = [[kind, payload] for kind, payload, _ in traced(source)]
    for _ in range(choices.whole(1, 3)):
        unit = choices.pick(units)
        unit[1] = edited(unit[1], choices)
    return decoded(framed(units), choices.whole(0, 2))


def described(data: bytes) -> None:
    """inspect() names every byte once, and texf-info prints what it says."""
    from texfcodec.cli.info import _lines

    choices = Choices(data)
    source = bent_stream(choices.pick(vectors()), choices, OF_UNITS, 3)
    whole = edited(source, choices) if choices.flag(6) else source
    facts = inspect(whole, SMALL)
    sizes = [element["size"] for unit in facts["units"] for element in unit["elements"]]
    assert sum(sizes) + len(SIGNATURE) == len(whole) == sum(facts["bytes"][kind] for kind in ("geometry", "attributes", "other"))
    json.dumps(facts, allow_nan=False)
    assert all("\n" not in line for line in _lines("a.texf", facts))


@lru_cache(maxsize=8)
def _answers():
    """(stream, facts, arrays) of the child for some streams: voxels, texels, marks, a joint codec."""
    chosen = [*vectors()[1:9:3], *vectors_with("3dntc")[:1], *vectors_with(marks=True)[:1]]
    return [(read_stream(data, SMALL), *isolate.packed_answer(decode_stream(data, DecodeOptions(threads=1), Report())))
            for data in chosen]


def answer(data: bytes) -> None:
    """What the parent makes of a child's answer, which somebody may have taken over: a sound asset or TXF-S40."""
    choices = Choices(data)
    stream, facts, arrays = choices.pick(_answers())
    arrays = dict(arrays)
    for _ in range(choices.whole(0, 2) if arrays else 0):
        name = choices.pick(sorted(arrays))
        arrays[name] = _odd_array(arrays[name], choices)
        if choices.flag(8) and len(arrays) > 1:
            del arrays[name]
    texf = texf_of(stream, isolate.ChildAnswer(arrays), DecodeOptions(threads=1), Report(), (facts, arrays))
    if texf.fields and len(texf.faces):
        texf.query(texf.positions[:3], np.zeros(len(texf.positions[:3]), np.int64))
    assert texf.face_material.max(initial=-1) < len(texf.materials)


def _odd_array(array: np.ndarray, choices: Choices) -> np.ndarray:
    """An array like it with other numbers, of another length, shape or type."""
    kind, array = choices.whole(0, 5), copy.deepcopy(array)
    if kind < 2 and array.size:
        flat = array.reshape(-1)
        place, odd = choices.whole(0, array.size - 1), max(min(choices.number(), (1 << 63) - 1), -(1 << 63))
        flat[place] = np.array(odd).astype(flat.dtype)  # of unsigned ones, the low bits
        return array
    if kind == 2:
        return array[: choices.whole(0, max(len(array) - 1, 0))]
    if kind == 3:
        return array.astype(choices.pick((np.float64, np.uint8, np.int16, "U3", np.complex128)))
    return array.reshape(-1) if kind == 4 else np.concatenate([array, array])


APPEARANCE = Structure("appearance", "5.4", (  # channel groups and materials, as a stream has them in two units
    Element("num_channel_groups", "u8", 1, MAX_GROUPS), Element("channel_groups", CHANNEL_GROUP, count="num_channel_groups"),
    Element("num_materials", "v", 0, 65536), Element("materials", MATERIAL, count="num_materials"),
))


def appearance(data: bytes) -> None:
    """Channel groups and materials, in their own little syntax."""
    from fuzz.syntax import bend, draw

    choices = Choices(data)
    given = {"num_channel_groups": lambda *_: choices.whole(1, 3), "num_materials": lambda *_: choices.whole(0, 3),
             "name_length": lambda *_: choices.whole(0, 3)}
    payload = write_structure(APPEARANCE, draw(APPEARANCE, choices, {}, given))
    rows: list = []
    read_structure(APPEARANCE, Reader(payload, 0, len(payload)), {}, rows)
    bent = bend(payload, rows, choices) if choices.flag() else payload
    values = read_structure(APPEARANCE, Reader(bent, 0, len(bent)), {})
    check_groups(values["channel_groups"])
    for material in values["materials"]:
        check_material(material)
    groups_of(values["channel_groups"])
    assert len([material_of(material) for material in values["materials"]]) == values["num_materials"]
