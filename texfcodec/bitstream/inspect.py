"""A stream described by the names of its syntax elements, without decoding it and without numba."""

from ..limits import Limits
from .stream import read_stream
from .syntax import (
    CODEC_3DNTC,
    FORM_TRANSPORT,
    SEMANTIC_ALPHA,
    SEMANTIC_BASE_COLOUR,
    SIGNATURE,
    UNIT_ATTRIBUTE,
    UNIT_END,
    UNIT_GEOMETRY,
    UNIT_NAMES,
)

SCHEMA = 1
_SEMANTICS = {SEMANTIC_BASE_COLOUR: "base_colour", SEMANTIC_ALPHA: "alpha"}
_KINDS = {UNIT_GEOMETRY: "geometry", UNIT_ATTRIBUTE: "attributes"}


def inspect(data, limits=None):
    """What stands where in a .texf stream.

    data: bytes; limits: Limits. Returns a JSON-ready dict: "bytes" by kind, counts, "fields", "groups" (one per attribute unit:
    qp, codewords, bytes by octree level where the stream tells) and "units", whose elements with the signature name every byte of
    the file exactly once. Raises StreamError, LimitError, SupportError.
    """
    data, trace = bytes(data), []
    stream = read_stream(data, limits or Limits(), trace)
    units = [_unit(data, unit.type, unit.start, unit.begin, unit.end, rows) for unit, rows in trace]
    units += [_skipped_unit(data, skipped) for skipped in stream.skipped]
    end = len(data) - 6  # type, length 0 and CRC-32: read_stream has made sure of it
    units.append(_unit(data, UNIT_END, end, end + 2, end + 2, []))
    units.sort(key=lambda unit: unit["offset"])
    header, sizes = stream.header, {"total": len(data), "geometry": 0, "attributes": 0, "other": len(SIGNATURE)}
    for unit in units:
        sizes[_KINDS.get(unit["type"], "other")] += unit["size"]
    return {
        "schema": SCHEMA, "bytes": sizes, "version": header["version"], "position_bits": header["position_bits"],
        "vertices": header["num_vertices"], "faces": header["num_faces"], "voxels": sum(f["num_voxels"] for f in stream.fields),
        "resolution": max((f["resolution"] for f in stream.fields), default=None),
        "fields": [{**f, "geometry_units": sum(g["field_index"] == i for g in stream.geometry)}
                   for i, f in enumerate(stream.fields)],
        "groups": _groups(stream, [u["size"] for u in units if u["type"] == UNIT_ATTRIBUTE]),
        "materials": stream.materials, "skipped": stream.skipped, "units": units,
    }


def _unit(data, unit_type, start, begin, end, rows):
    """One unit with its frame: type and length before the payload, CRC-32 after it."""
    row = lambda name, offset, size, value: {"name": name, "offset": offset, "size": size, "value": value}
    crc = int.from_bytes(data[end : end + 4], "little")
    frame = [row("unit_type", start, 1, unit_type), row("unit_length", start + 1, begin - start - 1, end - begin)]
    elements = [*frame, *(row(*r) for r in rows), row("unit_crc", end, 4, crc)]
    name = UNIT_NAMES.get(unit_type, "unknown")
    return {"name": name, "type": unit_type, "offset": start, "size": end + 4 - start, "elements": elements}


def _skipped_unit(data, skipped):
    """An unknown ancillary unit: the frame is known, the payload is not."""
    start, stop = skipped["offset"], skipped["offset"] + skipped["bytes"]
    begin = start + 2
    while data[begin - 1] & 0x80:
        begin += 1
    payload = [("unknown_payload", begin, stop - 4 - begin, f"{stop - 4 - begin} bytes")] if stop - 4 > begin else []
    return _unit(data, skipped["type"], start, begin, stop - 4, payload)


def _groups(stream, unit_bytes):
    """One entry per attribute unit; level_bytes is None where the unit has no level index."""
    out = []
    for values, size in zip(stream.attributes, unit_bytes, strict=True):
        group = stream.header["channel_groups"][values["group_index"]]
        out.append({
            "field_index": values["field_index"], "group_index": values["group_index"],
            "semantic": _SEMANTICS.get(group["group_semantic"], str(group["group_semantic"])),
            "components": group["group_components"], "codec_id": values["codec_id"], "qp": values.get("qp"),
            "bytes": size, "codeword_bytes": [c["codeword_length"] for c in values.get("codewords", [])],
            "slice_level": values.get("slice_level"), "level_bytes": _level_bytes(values),
        })
        if values["codec_id"] == CODEC_3DNTC:
            out[-1] |= {"semantic": "all fields and groups", "components": values["NumOutputs"], "neural": _neural(values)}
    return out


def _neural(values):
    """What a 3DNTC unit holds: its form and the bytes of its resident form, without the index that the geometry gives."""
    rows = [level["NumRows"] for level in values["latent_levels"]]
    return {"form": "transport" if values["form"] == FORM_TRANSPORT else "resident", "features": values["num_features"],
            "levels": [{"resolution": one["level_resolution"], "table_log2": one["table_log2"], "rows": n}
                       for one, n in zip(values["latent_levels"], rows, strict=True)],
            "widths": values["Widths"], "latent_bytes": sum(rows) * values["num_features"] // 2,
            "network_bytes": values["ParameterBytes"]}


def _level_bytes(values):
    """Bytes by octree level over all codewords: with slices, the first codeword is the trunk above slice_level."""
    if not values.get("level_index"):
        return None
    total = [0] * values["Depth"]
    for i, codeword in enumerate(values["codewords"]):
        first = values["slice_level"] if i else 0
        for level, count in enumerate(codeword["level_bytes"]):
            total[first + level] += count
    return total
