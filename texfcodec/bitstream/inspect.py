"""Describes a stream by the names of its syntax elements, without decoding it and without numba."""

from ..codecs import codec_of_unit
from ..codecs.base import PRIVATE_IDS, PROFILES
from ..limits import Limits, level_of
from ..scene.channels import channels_of
from ..scene.effects import effects_mask, in_words
from .appearance import material_of
from .stream import read_stream
from .syntax import (
    SIGNATURE,
    SUPPORT_TEXELS,
    UNIT_ATTRIBUTE,
    UNIT_CODED_NORMALS,
    UNIT_END,
    UNIT_GEOMETRY,
    UNIT_NAMES,
    UNIT_SHARP_EDGES,
)

SCHEMA = 1
ABSENT: dict = {"qp": None, "codeword_bytes": [], "slice_level": None, "level_bytes": None}
_KINDS = {UNIT_GEOMETRY: "geometry", UNIT_ATTRIBUTE: "attributes", UNIT_SHARP_EDGES: "geometry",
          UNIT_CODED_NORMALS: "geometry"}


def inspect(data: bytes, limits: Limits | None = None) -> dict:
    """Describes the units and elements of a .texf stream.

    data: bytes; limits: Limits. Returns a JSON-ready dict: "bytes" by kind, counts ("voxels" of fields over voxels, "texels" of
    the others), "level" and the "needs" that determine it (spec 10.1), "profile" (10.3), "fields" (an element that a field does
    not have is None), "groups" (one per attribute unit: qp, codewords, bytes by octree level if the stream has them) and "units",
    whose elements with the signature name every byte of the file exactly once. Raises StreamError, LimitError, SupportError.
    """
    data = bytes(data)
    trace: list[tuple] = []
    stream = read_stream(data, limits or Limits(), trace)
    units = [_unit(data, unit.type, unit.start, unit.begin, unit.end, rows) for unit, rows in trace]
    units += [_skipped_unit(data, skipped) for skipped in stream.skipped]
    end = len(data) - 6  # type, length 0 and CRC-32: read_stream has made sure of it
    units.append(_unit(data, UNIT_END, end, end + 2, end + 2, []))
    units.sort(key=lambda unit: unit["offset"])
    grids = [f for f in stream.fields if f["support"] != SUPPORT_TEXELS]
    needs = _needs(stream, len(data))
    header, sizes = stream.header, {"total": len(data), "geometry": 0, "attributes": 0, "other": len(SIGNATURE)}
    for unit in units:
        sizes[_KINDS.get(unit["type"], "other")] += unit["size"]
    return {
        "schema": SCHEMA, "bytes": sizes, "version": header["version"], "level": level_of(needs), "needs": needs,
        "profile": _profile(stream),
        "position_bits": header["position_bits"],
        "vertices": stream.vertices, "faces": stream.faces, "voxels": sum(f["num_keys"] for f in grids),
        "texels": sum(f["num_keys"] for f in stream.fields) - sum(f["num_keys"] for f in grids),
        "resolution": max((f["resolution"] for f in grids), default=None),
        "fields": [{**f, "geometry_units": sum(g["field_index"] == i for g in stream.geometry)}
                   for i, f in enumerate(stream.fields)],
        "groups": _groups(stream, [u["size"] for u in units if u["type"] == UNIT_ATTRIBUTE]),
        "effects": in_words(effects_mask(map(material_of, stream.materials))), "materials": stream.materials,
        "sharp_edges": _sharp_edges(stream), "coded_normals": _coded_normals(stream),
        "skipped": stream.skipped, "units": units,
    }


def _profile(stream):
    """The profile that the attribute units require; None if one has a private codec."""
    profiles = [codec_of_unit(unit).profile(unit) for unit in stream.attributes if unit["codec_id"] < PRIVATE_IDS[0]]
    return max(profiles, key=PROFILES.index, default=PROFILES[0]) if len(profiles) == len(stream.attributes) else None


def _needs(stream, size):
    """The quantities that a level bounds (spec 10.1), by names of Limits' fields. Samples and touched voxels are known only after
    decoding."""
    images = [f["width"] * f["height"] for f in stream.fields if f["support"] == SUPPORT_TEXELS]
    return {"file_bytes": size, "vertices": stream.vertices, "faces": stream.faces,
            "voxels": sum(f["num_keys"] for f in stream.fields), "texels": max(images, default=0),
            "latents": sum(codec_of_unit(a).count_latents(a) for a in stream.attributes),
            "metadata_bytes": 0 if stream.metadata is None else 1 + len(stream.metadata)}


def _sharp_edges(stream):
    """Number of marked edges and bytes of their marks; None if there are none."""
    unit = stream.sharp_edges
    return unit and {"num_edges": unit["num_edges"], "bytes": len(unit["marks_data"])}


def _coded_normals(stream):
    """Number of corner groups with a coded normal, their step and bytes; None if there are none."""
    unit = stream.coded_normals
    return unit and {"num_groups": unit["num_groups"], "normal_step": unit["normal_step"], "bytes": len(unit["residual_data"])}


def _unit(data, unit_type, start, begin, end, rows):
    """Describes one unit with its frame: type and length before the payload, CRC-32 after it."""
    row = lambda name, offset, size, value: {"name": name, "offset": offset, "size": size, "value": value}
    crc = int.from_bytes(data[end : end + 4], "little")
    frame = [row("unit_type", start, 1, unit_type), row("unit_length", start + 1, begin - start - 1, end - begin)]
    elements = [*frame, *(row(*r) for r in rows), row("unit_crc", end, 4, crc)]
    name = UNIT_NAMES.get(unit_type, "unknown")
    return {"name": name, "type": unit_type, "offset": start, "size": end + 4 - start, "elements": elements}


def _skipped_unit(data, skipped):
    """Describes an unknown ancillary unit: its frame, and its payload as one element."""
    start, stop = skipped["offset"], skipped["offset"] + skipped["bytes"]
    begin = start + 2
    while data[begin - 1] & 0x80:
        begin += 1
    payload = [("unknown_payload", begin, stop - 4 - begin, f"{stop - 4 - begin} bytes")] if stop - 4 > begin else []
    return _unit(data, skipped["type"], start, begin, stop - 4, payload)


def _groups(stream, unit_bytes):
    """Entries by attribute unit, including those of its codec; elements of other codecs are None."""
    out = []
    for values, size in zip(stream.attributes, unit_bytes, strict=True):
        group, codec = stream.header["channel_groups"][values["group_index"]], codec_of_unit(values)
        entry = {"field_index": values["field_index"], "group_index": values["group_index"],
                 "semantic": " + ".join(channel.name for channel in channels_of([group])[0]),
                 "components": group["group_components"], "level_shift": values["level_shift"],
                 "codec_id": values["codec_id"], "codec": codec.name, "bytes": size, **ABSENT}
        if codec.joint:
            entry |= {"semantic": "all fields and groups", "components": values["NumOutputs"]}
        out.append(entry | codec.describe(values))
    return out
