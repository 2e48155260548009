"""The Texf of a stream whose arrays come from the C++ decoder or a child: this process reads clauses 4 and 5 itself, in Python
alone, and checks every index of a sandbox's answer.

The C++ decoder is a WebAssembly module (wasm.py) or a native library (native.py); the child process is that of isolate.py.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..bitstream.syntax import SUPPORT_TEXELS
from ..codecs import joint_codec_of_unit
from ..decoder import add_planes, appearance_of
from ..errors import LimitError, StreamError, SupportError, TexfError
from ..field.texel_set import MAX_UV
from ..field.texels import TexelSupport, texels_are_sound
from ..field.voxels import VoxelSupport, keys_are_sound
from ..findings import BY_CODE
from ..geometry.edges import coded_edges
from ..geometry.geometry_unit import GeometryUnit
from ..texf import Field

if TYPE_CHECKING:
    from ..bitstream.stream import Stream
    from ..options import DecodeOptions
    from ..report import Report
    from ..texf import Texf

POSITIONS, UVS, FACES, KEYS, VALUES, SHARP_EDGES, CODED_NORMALS = 2, 3, 4, 6, 7, 8, 9  # texf_array_kind of native/texf.h
REFUSAL = struct.Struct("<iiQQ232s")  # texf_refusal of native/texf.h
LIMITS = ("file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes")  # texf_limits
KNOWN = (0, 2)  # codec_id of the C++ decoder's codecs whose values are arrays
_FAMILIES = {3: ("S", StreamError), 4: ("C", StreamError), 5: ("U", SupportError), 6: ("L", LimitError)}  # by exit code


class Answer(Protocol):
    """Arrays that a sandbox has decoded from a stream."""

    def array(self, kind: int, i: int = 0, j: int = 0, dtype: str = "u1") -> np.ndarray:
        """Return a copy of an array, one-dimensional, empty if the stream has none. kind: number of texf_array_kind in
        native/texf.h; i, j: of the geometry unit or field and of the channel group, if the kind has these. Raises ValueError if
        dtype is wrong."""


def can_decode(stream: Stream) -> bool:
    """Return whether the C++ decoder has a stream's codecs: neither private codecs nor a joint one that evaluates points."""
    return stream.joint is None and all(values["codec_id"] in KNOWN for values in stream.attributes)


def error_of(refusal: bytes) -> TexfError | None:
    """Return the error of a refusal by the C++ decoder, None if it has no finding. refusal: bytes of a texf_refusal."""
    number, has_value, value, allowed, said = REFUSAL.unpack(refusal)
    letter, family = _FAMILIES.get(number // 100, ("", LimitError))
    code = f"TXF-{letter}{number % 100:02d}"
    if code not in BY_CODE:
        return None
    clauses, numbers = BY_CODE[code].clauses, {"value": value, "allowed": allowed} if has_value else {}
    sentence = said.split(b"\0")[0].decode("utf-8", "replace")
    return family(code, sentence, clause=clauses[0] if len(clauses) == 1 else None, **numbers)


def texf_of(stream: Stream, answer: Answer, options: DecodeOptions, report: Report, packed: tuple[dict, dict] = ({}, {}),
            confined: bool = True) -> Texf:
    """Build the Texf of a parsed stream from the arrays that a sandbox decoded, after a check of all indices and lengths.

    packed: (facts, arrays) of a joint codec's pack(), from which its evaluators are rebuilt; confined: False for arrays of a
    decoder in this process, which need no check. Raises StreamError TXF-S40 for arrays that do not fit the stream.
    """
    texf = appearance_of(stream, options, report)
    try:
        texf.units += [_unit(values, answer, i) for i, values in enumerate(stream.geometry)]
        texf.fields += [Field(_support(values, answer.array(KEYS, i, dtype="<i8"), options.lod), {})
                        for i, values in enumerate(stream.fields)]
        if stream.joint:
            _add_joint(texf, stream.joint, answer, packed)
        for values in stream.attributes if not stream.joint else ():
            part, group = texf.fields[values["field_index"]], texf.groups[values["group_index"]]
            add_planes(part, group, values, _plane(answer, values["field_index"], values["group_index"], group))
        if stream.sharp_edges:
            texf.sharp_edges = answer.array(SHARP_EDGES).astype(bool)
        if stream.coded_normals:
            texf.coded_normals = answer.array(CODED_NORMALS, dtype="<i2").reshape(-1, 3)
        sound = not confined or _is_sound(texf)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise StreamError("TXF-S40", "the decoder returned an invalid result", reason=type(error).__name__) from error
    if not sound:
        raise StreamError("TXF-S40", "the decoder returned an index out of range")
    return texf


def _unit(values, answer, i):
    uv = answer.array(UVS, i, dtype="<i4").astype(np.int64).reshape(-1, 2) if values["Support"] == SUPPORT_TEXELS else None
    lattice, faces = (answer.array(kind, i, dtype="<u4").astype(np.int64).reshape(-1, 3) for kind in (POSITIONS, FACES))
    return GeometryUnit(values["field_index"], values["material_index"], lattice, faces, uv)


def _support(values, keys, lod):
    """The support of a field at a level of detail. values: of the field unit; keys: at that level."""
    if values["support"] == SUPPORT_TEXELS:
        whole = TexelSupport(keys=keys, width=values["width"], height=values["height"], wrap=(values["wrap_s"], values["wrap_t"]),
                             fraction_bits=values["uv_fraction_bits"])
        return replace(whole, level_shift=min(lod, whole.depth))
    support = VoxelSupport(values["resolution"], keys)
    return replace(support, level_shift=min(lod, support.depth))


def _plane(answer, i, j, group):
    return answer.array(VALUES, i, j).reshape(-1, group.components)


def _add_joint(texf, values, answer, packed):
    """Adds the evaluators of a joint codec, and the planes with their values at the voxels."""
    texf.codec = joint_codec_of_unit(values)
    for i, part in enumerate(texf.fields):
        for j, group in enumerate(texf.groups):
            part.planes |= group.split(_plane(answer, i, j, group))
    try:
        texf.evaluators = texf.codec.unpack(*packed, texf.groups, len(texf.fields))
    except TexfError as error:  # the stream has been checked: the answer is at fault
        raise ValueError("evaluators") from error


def _is_sound(texf):
    """Return whether every index is inside its array, and every array has the length of its counterpart."""
    sound = all(_field_is_sound(part, texf.channels) for part in texf.fields) and all(_unit_is_sound(u, texf) for u in texf.units)
    if sound and texf.sharp_edges is not None:
        marked = np.array([m.normals.has_marks for m in texf.materials], bool)[texf.face_material]
        sound = texf.sharp_edges.shape == (len(coded_edges(texf.lattice_positions, texf.faces, marked)[0]),)
    if sound and texf.coded_normals is not None:
        sound = len(texf.coded_normals) == len(texf.corner_groups())
    return sound


def _field_is_sound(part, channels):
    keys_sound = texels_are_sound if part.over_texels else keys_are_sound
    return keys_sound(part.keys, part.support.size) and all(len(part.planes[c.name]) == len(part.support_of(c.name))
                                                            for c in channels if c.name in part.planes)


def _unit_is_sound(unit, texf):
    uv_is_sound = unit.uv is None or (len(unit.uv) == len(unit.lattice) and bool((np.abs(unit.uv) < MAX_UV).all()))
    return uv_is_sound and _within(unit.faces, len(unit.lattice)) and _within(unit.lattice, 1 << texf.position_bits)


def _within(values, end):
    return len(values) > 0 and values.min() >= 0 and values.max() < end
