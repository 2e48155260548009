"""Codecs of other packages: what they are checked for, so that a fault in one is told as its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any

import numpy as np

from ..channels import COLUMNS, columns_of
from ..errors import SupportError, TexfError
from .codec import PRIVATE_IDS, Codec, Joint, JointCodec, PlaneCodec, Source

if TYPE_CHECKING:
    from ..report import Report
    from ..support.voxels import VoxelSupport


def welcome(point: EntryPoint, taken: Iterable[tuple[str, int]]) -> Codec:
    """The codec behind an entry point, wrapped so that its faults name it. taken: (name, id) of codecs that stand already.

    Raises SupportError where it cannot be loaded, is no codec, or claims an id that it may not have.
    """
    try:
        codec = point.load()()
    except Exception as error:
        raise _fault(point.name, "cannot be loaded", error) from error
    if not isinstance(codec, (PlaneCodec, JointCodec)) or getattr(codec, "name", None) != point.name or not codec.structures:
        raise SupportError("TXF-U08", f"the plug-in {point.value} does not give a codec of the name {point.name!r}",
                           value=point.name)
    owner = next((name for name, number in taken if number == codec.id), None)
    if owner is not None or codec.id not in PRIVATE_IDS:
        why = f"claims the id of {owner!r}" if owner else "claims an id outside the private range"
        raise SupportError("TXF-U08", f"the codec {point.name!r} of a plug-in {why}", value=codec.id,
                           allowed=f"{PRIVATE_IDS[0]}..{PRIVATE_IDS[-1]}")
    return GuestJoint(codec) if isinstance(codec, JointCodec) else GuestPlane(codec)


def _fault(name, what, error=None):
    reason = None if error is None else f"{type(error).__name__}: {error}"[:300]
    return SupportError("TXF-U08", f"the codec {name!r} of a plug-in {what}", reason=reason)


def _checked(name, got, dtype, shape):
    if not (isinstance(got, np.ndarray) and got.dtype == dtype and got.shape == shape):
        kind = f"{getattr(got, 'dtype', type(got).__name__)} {list(np.shape(got))}, not {np.dtype(dtype)} {list(shape)}"
        raise _fault(name, f"returns values of the wrong kind: {kind}")
    return got


class _Guest:
    """A stranger's codec: its errors become coded ones that name it."""

    TOLD: tuple[str, ...] = ("id", "name", "purpose", "structures", "options", "position_bits", "checksum_clause", "small")

    def __init__(self, inner):
        self.inner = inner
        for name in self.TOLD:
            setattr(self, name, getattr(inner, name))

    def _call(self, what, *given):
        try:
            return getattr(self.inner, what)(*given)
        except TexfError:
            raise
        except Exception as error:
            raise _fault(self.name, f"failed in {what}()", error) from error

    def check_options(self, options):
        """As Codec.check_options."""
        self._call("check_options", options)

    def check(self, values):
        """As Codec.check."""
        self._call("check", values)

    def describe(self, values):
        """As Codec.describe."""
        return self._call("describe", values)

    def info_lines(self, group):
        """As Codec.info_lines."""
        return self._call("info_lines", group)

    def seconds(self, options):
        """As Codec.seconds."""
        return self._call("seconds", options)


class GuestPlane(_Guest, PlaneCodec):
    """A stranger's PlaneCodec; what it returns is checked. It is taken where it was asked for, never by suits()."""

    TOLD = (*_Guest.TOLD, "has_levels")

    def enc(self, plane: np.ndarray, support: VoxelSupport, options: Any) -> tuple[dict, np.ndarray]:
        """As PlaneCodec.enc."""
        made = self._call("enc", plane, support, options)
        if not (isinstance(made, tuple) and len(made) == 2 and isinstance(made[0], dict)):
            raise _fault(self.name, "does not return (values, decoded)")
        return made[0], _checked(self.name, made[1], np.uint8, plane.shape)

    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """As PlaneCodec.dec."""
        shape = (len(support.coarser(levels)), values["NumComponents"])
        return _checked(self.name, self._call("dec", values, support, levels, threads), np.uint8, shape)


class GuestJoint(_Guest, JointCodec):
    """A stranger's JointCodec."""

    def enc(self, source: Source, options: Any, report: Report) -> Joint:
        """As JointCodec.enc."""
        made = self._call("enc", source, options, report)
        if not isinstance(made, Joint) or len(made.evaluators) != len(source.surfaces):
            raise _fault(self.name, "does not return a Joint with an evaluator for every field")
        return made._replace(evaluators=[_Evaluator(self, one, source.channels) for one in made.evaluators])

    def count_samples(self, values: dict, surfaces: list, position_bits: int) -> int:
        """As JointCodec.count_samples."""
        return self._call("count_samples", values, surfaces, position_bits)

    def dec(self, values: dict, surfaces: list, position_bits: int, channels: tuple, options: Any, report: Report) -> list:
        """As JointCodec.dec."""
        made = self._call("dec", values, surfaces, position_bits, channels, options, report)
        if len(made) != len(surfaces):
            raise _fault(self.name, "does not return an evaluator for every field")
        return [_Evaluator(self, one, channels) for one in made]

    def pack(self, evaluators: list) -> tuple[dict, dict]:
        """As JointCodec.pack."""
        return self._call("pack", [one.inner for one in evaluators])

    def unpack(self, facts: dict, arrays: dict, channels: tuple, fields: int) -> list:
        """As JointCodec.unpack."""
        return [_Evaluator(self, one, channels) for one in self._call("unpack", facts, arrays, channels, fields)]

    def result_lines(self, facts: dict) -> Iterator[str]:
        """As JointCodec.result_lines."""
        return self._call("result_lines", facts)


class _Evaluator:
    """A stranger's evaluator, its answers checked."""

    def __init__(self, codec, inner, channels):
        self.codec, self.inner, self.components = codec, inner, len(columns_of(channels))

    def values(self, support, threads):
        """As the evaluators of JointCodec."""
        return self._ask(np.uint8, (len(support), self.components), "values", support, threads)

    def query(self, cube, points, threads):
        """As the evaluators of JointCodec."""
        return self._ask(np.float32, (len(points), COLUMNS), "query", cube, points, threads)

    def _ask(self, dtype, shape, what, *given):
        try:
            got = getattr(self.inner, what)(*given)
        except TexfError:
            raise
        except Exception as error:
            raise _fault(self.codec.name, f"failed in {what}()", error) from error
        return _checked(self.codec.name, got, dtype, shape)
