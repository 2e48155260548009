"""Codecs of other packages: what they are checked for, so that a fault in one is told as its own."""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING

import numpy as np

from ..core.syntax_table import Structure
from ..errors import SupportError, TexfError
from .base import PRIVATE_IDS, Codec, Evaluator, Group, Joint, JointCodec, PlaneCodec, Settings, Source

if TYPE_CHECKING:
    from ..field.texels import TexelSupport
    from ..field.voxels import VoxelSupport
    from ..geometry.geometry_unit import LatticeMesh
    from ..options import DecodeOptions
    from ..report import Report

# What an attribute unit says itself (5.7), and what inspect() does: names that a stranger's table and describe() leave alone.
UNIT = {"field_index", "group_index", "codec_id", "codec_name_length", "codec_name", "level_shift", "values_crc", "resolution",
        "NumComponents", "NumOutputs", "num_fields", "Planar", "offset"}
INSPECTED = {"field_index", "group_index", "semantic", "components", "level_shift", "codec_id", "codec", "bytes"}
NAME_BYTES = 255  # codec_name_length is a u8
ARRAY = "codec."  # before the names of a stranger's arrays, which are not to meet those of an answer
# What a class may say of itself.
SOUND = {
    "id": lambda v: type(v) is int,
    "purpose": lambda v: isinstance(v, str),
    "structures": lambda v: isinstance(v, tuple) and len(v) > 0 and all(isinstance(one, Structure) for one in v),
    "options": lambda v: isinstance(v, frozenset) and all(isinstance(one, str) for one in v),
    "position_bits": lambda v: type(v) is int and 8 <= v <= 20,
    "checksum_clause": lambda v: isinstance(v, str),
    "has_levels": lambda v: isinstance(v, bool),
}


def load_plugin(point: EntryPoint, taken: dict[int, str]) -> Codec:
    """The codec behind an entry point, wrapped so that its faults name it. taken: names of codecs that stand already, by id.

    Raises SupportError TXF-U08 where it cannot be loaded, is no codec, or claims an id that it may not have.
    """
    try:
        codec = point.load()()
        kind = PluginJoint if isinstance(codec, JointCodec) else PluginPlane
        told = {name: getattr(codec, name, None) for name in kind.TOLD}
        name = getattr(codec, "name", None)
    except (Exception, SystemExit) as error:
        raise _fault(point.name, f"cannot be loaded from {point.value}", error) from error
    if not isinstance(codec, (PlaneCodec, JointCodec)) or name != point.name:
        raise SupportError("TXF-U08", f"the plug-in {point.value} does not provide a codec named {point.name!r}",
                           value=str(name)[:NAME_BYTES])
    if not 0 < len(name.encode()) <= NAME_BYTES:
        raise _fault(name[:NAME_BYTES], f"has a name that is not 1 to {NAME_BYTES} bytes long")
    _check_claims(name, told, taken)
    return kind(codec, told)


def _check_claims(name, told, taken):
    """What a codec says of itself must make sense, and its id and its table must be its own."""
    for what, value in told.items():
        if not SOUND[what](value):
            raise _fault(name, f"has an invalid {what}", value=repr(value)[:80])
    if told["id"] not in PRIVATE_IDS:
        owner = taken.get(told["id"])
        why = "claims an id outside the private range" if owner is None else f"claims the id of {owner!r}"
        raise _fault(name, why, value=told["id"], allowed=f"{PRIVATE_IDS[0]}..{PRIVATE_IDS[-1]}")
    own = sorted(UNIT.intersection(one.name for one in told["structures"][0].elements))
    if own:
        raise _fault(name, "has a table with names that the attribute unit uses", value=", ".join(own))


def _fault(name, what, error=None, **facts):
    reason = None if error is None else f"{type(error).__name__}: {error}"[:300]
    return SupportError("TXF-U08", f"the codec {name!r} of a plug-in {what}", reason=reason, **facts)


def _checked(name, got, dtype, shape):
    if not (isinstance(got, np.ndarray) and got.dtype == dtype and got.shape == shape):
        kind = f"{getattr(got, 'dtype', type(got).__name__)} {list(getattr(got, 'shape', []))}"
        raise _fault(name, f"returns values of the wrong kind: {kind}, not {np.dtype(dtype)} {list(shape)}")
    return np.ascontiguousarray(got)


def _asked(name, inner, what, given, take=lambda got: got):
    """What a stranger's method returns, after take(); whatever is raised on the way names the codec, unless it is coded."""
    try:
        return take(getattr(inner, what)(*given))
    except TexfError:
        raise
    except (Exception, SystemExit) as error:
        raise _fault(name, f"failed in {what}()", error) from error


def _json_dict(told):
    """A copy of what JSON can hold. Raises TypeError, ValueError."""
    told = json.loads(json.dumps(told, allow_nan=False))
    if not isinstance(told, dict):
        raise TypeError("not a dict")
    return told


class _Plugin(Codec):
    """A stranger's codec: its errors become coded ones that name it."""

    TOLD: tuple[str, ...] = ("id", "purpose", "structures", "options", "position_bits", "checksum_clause")

    def __init__(self, inner, told):
        self.inner, self.name = inner, inner.name
        vars(self).update(told)

    def _call(self, what, *given, **take):
        return _asked(self.name, self.inner, what, given, **take)

    def write_parameters(self, values):
        """As Codec.write_parameters."""
        try:
            return super().write_parameters(values)
        except Exception as error:
            raise _fault(self.name, "returned values that are missing in its table", error) from error

    def read_parameters(self, reader, values, trace=None):
        """As Codec.read_parameters."""
        try:
            super().read_parameters(reader, values, trace)
        except TexfError:
            raise
        except Exception as error:
            raise _fault(self.name, "has a table that cannot be read", error) from error

    def check_options(self, options):
        """As Codec.check_options."""
        self._call("check_options", options)

    def check(self, values):
        """As Codec.check."""
        self._call("check", values)

    def describe(self, values):
        """As Codec.describe."""
        told = self._call("describe", values, take=_json_dict)
        if own := sorted(INSPECTED & told.keys()):
            raise _fault(self.name, "describes facts that every unit has", value=", ".join(own))
        return told

    def info_lines(self, group):
        """As Codec.info_lines."""
        return self._lines("info_lines", group)

    def seconds(self, options):
        """As Codec.seconds."""
        return self._number("seconds", float, options)

    def _lines(self, what, facts):
        """Lines of a method that may be a generator, so that it fails here and not where they are printed."""
        lines = self._call(what, facts, take=list)
        if not all(isinstance(line, str) for line in lines):
            raise _fault(self.name, f"does not return lines of text from {what}()")
        return lines

    def _number(self, what, kind, *given):
        number = self._call(what, *given, take=kind)
        if not 0 <= number < math.inf:
            raise _fault(self.name, f"returns a number out of range from {what}()", value=repr(number))
        return number


class PluginPlane(_Plugin, PlaneCodec):
    """A stranger's PlaneCodec; what it returns is checked. It is taken where it was asked for, never by suits()."""

    TOLD = (*_Plugin.TOLD, "has_levels")

    def enc(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, options: Settings) -> tuple[dict, np.ndarray]:
        """As PlaneCodec.enc."""
        made = self._call("enc", plane.copy(), support, options)
        if not (isinstance(made, tuple) and len(made) == 2 and isinstance(made[0], dict)):
            raise _fault(self.name, "does not return (values, decoded)")
        return _without(made[0], UNIT), _checked(self.name, made[1], np.uint8, plane.shape)

    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """As PlaneCodec.dec."""
        shape = (len(support.coarser(levels)), values["NumComponents"])
        return _checked(self.name, self._call("dec", values, support, levels, threads), np.uint8, shape)


class PluginJoint(_Plugin, JointCodec):
    """A stranger's JointCodec."""

    def enc(self, source: Source, options: Settings, report: Report) -> Joint:
        """As JointCodec.enc."""
        made = self._call("enc", source, options, report)
        if not isinstance(made, Joint) or not isinstance(made.values, dict):
            raise _fault(self.name, "does not return a Joint")
        try:
            choices = _json_dict(made.choices)
        except (TypeError, ValueError) as error:
            raise _fault(self.name, "returned choices that JSON cannot represent", error) from error
        evaluators = self._evaluators(made.evaluators, len(source.surfaces), source.groups)
        return Joint(_without(made.values, UNIT), evaluators, choices)

    def count_samples(self, values: dict, surfaces: list[LatticeMesh], position_bits: int) -> int:
        """As JointCodec.count_samples."""
        return self._number("count_samples", operator.index, values, surfaces, position_bits)

    def dec(self, values: dict, surfaces: list[LatticeMesh], position_bits: int, groups: tuple[Group, ...],
            options: DecodeOptions, report: Report) -> list[Evaluator]:
        """As JointCodec.dec."""
        made = self._call("dec", values, surfaces, position_bits, groups, options, report)
        return self._evaluators(made, len(surfaces), groups)

    def pack(self, evaluators: list) -> tuple[dict, dict]:
        """As JointCodec.pack."""
        return self._call("pack", [one.inner for one in evaluators], take=_packed)

    def unpack(self, facts: dict, arrays: dict, groups: tuple[Group, ...], fields: int) -> list[Evaluator]:
        """As JointCodec.unpack."""
        arrays = {name.removeprefix(ARRAY): array for name, array in arrays.items() if name.startswith(ARRAY)}
        return self._evaluators(self._call("unpack", facts, arrays, groups, fields), fields, groups)

    def result_lines(self, facts: dict) -> Iterator[str]:
        """As JointCodec.result_lines."""
        return iter(self._lines("result_lines", facts))

    def _evaluators(self, made, fields, groups):
        if not isinstance(made, list | tuple) or len(made) != fields:
            raise _fault(self.name, "does not return an evaluator for every field")
        return [_Evaluator(self, one, groups) for one in made]


def _packed(made):
    """(facts, arrays) of a stranger's pack() as an answer holds them. Raises TypeError, ValueError."""
    facts, arrays = made
    if any(not isinstance(array, np.ndarray) or array.dtype.hasobject for array in arrays.values()):
        raise TypeError("the arrays have an unsupported type")
    return _json_dict(facts), {ARRAY + name: array for name, array in arrays.items()}


def _without(values, names):
    return {name: value for name, value in values.items() if name not in names}


class _Evaluator:
    """A stranger's evaluator, its answers checked."""

    def __init__(self, codec, inner, groups):
        self.codec, self.inner, self.components = codec, inner, sum(group.components for group in groups)

    def values(self, support, threads):
        """See Evaluator."""
        return self._ask(np.uint8, (len(support), self.components), "values", support, threads)

    def query(self, cube, points, threads):
        """See Evaluator."""
        return self._ask(np.float32, (len(points), self.components), "query", cube, points, threads)

    def _ask(self, dtype, shape, what, *given):
        return _checked(self.codec.name, _asked(self.codec.name, self.inner, what, given), dtype, shape)
