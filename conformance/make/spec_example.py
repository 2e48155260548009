"""Annex A of bitstream_spec.md: one conformance stream, byte by byte, and what comes of it."""

import textwrap

from texfcodec import Limits, decode
from texfcodec.bitstream.stream import read_stream
from texfcodec.bitstream.syntax import SIGNATURE
from texfcodec.field.morton import decode_morton

SHOWN_CELLS = 6


def example(data):
    """Markdown of a stream over voxels with one field and one channel group: its bytes as a table, then what is decoded."""
    trace = []
    stream, texf = read_stream(data, Limits(), trace), decode(data)
    rows = [(0, len(SIGNATURE), "signature", "")]
    for unit, elements in trace:
        rows += [(unit.start, 1, "**unit_type**", f"{unit.type}, {unit.name}"),
                 (unit.start + 1, unit.begin - unit.start - 1, "unit_length", unit.end - unit.begin)]
        rows += [(offset, size, name, value) for name, offset, size, value in elements if size]
        rows.append((unit.end, unit.stop - unit.end, "unit_crc", ""))
    end = trace[-1][0].stop
    rows += [(end, 1, "**unit_type**", "5, end"), (end + 1, 1, "unit_length", 0), (end + 2, 4, "unit_crc", "")]
    (field,), (plane,) = texf.fields, texf.fields[0].planes.values()
    lines = ["| byte | bytes | element | value |", "|---:|---|---|---|"]
    lines += [f"| {start} | {data[start : start + size].hex(' ').upper()} | {name} | {_value(value)} |"
              for start, size, name, value in rows]
    keys, (unit,) = field.support.keys, texf.units
    shown = (part[:SHOWN_CELLS].tolist() for part in (keys, decode_morton(keys), plane))
    corners = "; ".join(", ".join(str(tuple(unit.lattice[v].tolist())) for v in face) for face in unit.faces)
    root = ", ".join(f"{v / 4096:.2f}" for v in stream.attributes[0]["root_mean"])
    sentences = (f"Draco gives {len(unit.faces)} faces with the corners {corners}, in one order or another. Clause 6 finds "
                 f"{len(keys)} voxels. From the root's means, {root}, values are refined over {field.support.depth} levels. "
                 f"The first {SHOWN_CELLS} values:")
    return "\n".join([
        *lines, "", *textwrap.wrap(sentences, 130), "", "| key | voxel | values |", "|---:|---|---|",
        *(f"| {key} | {tuple(place)} | {', '.join(map(str, value))} |" for key, place, value in zip(*shown, strict=True))])


def _value(value):
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "" if isinstance(value, memoryview | bytes) else f"{value:g}" if isinstance(value, float) else str(value)
