"""A codec of planes with its settings: it codes a candidate, or the final values, at one quality (encoder only)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...codecs import our_codecs
from ...scene.channels import ALPHA

if TYPE_CHECKING:
    from ...codecs.base import Group, PlaneCodec
    from ...field.texels import TexelSupport
    from ...field.voxels import VoxelSupport

LEAST_QP, LAST_QP = 4, 51  # of a map: a step of one level, and of 228
QP_PER_DECIBEL = 6 / (20 * math.log10(2))  # a step twice as large is 6 QP


@dataclass(frozen=True)
class Coder:
    """codec: of planes; settings: result of its settings() for a request, with "qp", "max_error" and "chroma_qp_offset"."""

    codec: PlaneCodec
    settings: Any  # each codec has a class of its own, a plug-in the EncodeOptions

    @property
    def signature(self) -> tuple:
        """Hashable key of the coder; the settings of a plug-in may not be hashable."""
        settings = self.settings
        return self.codec, settings.qp, settings.max_error, settings.chroma_qp_offset, repr(settings)

    @property
    def qp(self) -> int | None:
        """The QP; None if an error bound sets the quality."""
        return self.settings.qp

    def at(self, **quality: float | None) -> Coder:
        """Return the coder with other settings; quality: qp, max_error, chroma_qp_offset or further ones by name."""
        return replace(self, settings=replace(self.settings, **quality))

    @property
    def has_fractions(self) -> bool:
        """True if there are qualities between two QPs."""
        return hasattr(self.settings, "qp_fraction")

    def between(self, qp: float) -> Coder:
        """Return the coder at a QP that need not be whole; a codec with whole QPs only takes the next finer one."""
        whole = math.floor(qp)
        return self.at(qp=whole, qp_fraction=qp - whole) if self.has_fractions else self.at(qp=whole)

    def roughly(self) -> Coder:
        """Return the coder for an estimate, if its codec has a quicker one for that."""
        return self.at(is_rough=True) if hasattr(self.settings, "is_rough") else self

    def shifted(self, offset: int) -> Coder:
        """Return the coder with its QP shifted by an offset, within LEAST_QP..LAST_QP; unchanged if it has an error bound
        instead."""
        if self.qp is None:
            return self
        return self.at(qp=min(max(self.qp + offset, min(LEAST_QP, self.qp)), max(LAST_QP, self.qp)))

    def exactly(self) -> Coder:
        """Return the coder without any error."""
        return self.at(qp=None, max_error=0)

    def for_plane(self, plane: np.ndarray) -> Coder:
        """Return the coder for a plane float32 [N, C] in 0..255, with the codec that codec_for() chooses."""
        return replace(self, codec=codec_for(plane, self.codec))

    def for_group(self, group: Group, weights: Mapping[str, float]) -> Coder:
        """Return the coder with the QPs of a channel group. At equal slopes of bytes and error of a shaded picture, a channel
        whose errors weigh w times those of base colour has 1 / w of its squared error. weights: of a Scene. The QP of the second
        channel of a group is an offset to that of the first; components of a channel that is no colour share a QP. Alpha keeps
        the QP."""
        if self.qp is None or group.channels[0] is ALPHA:
            return self
        steps = [-10 * math.log10(weights.get(c.name, c.weight)) * QP_PER_DECIBEL for c in group.channels]
        qp = min(max(round(self.qp + steps[0]), min(LEAST_QP, self.qp)), max(LAST_QP, self.qp))
        if group.channels[0].srgb:
            return self.at(qp=qp)
        return self.at(qp=qp, chroma_qp_offset=round(steps[-1] - steps[0]))

    def code(self, plane: np.ndarray, support: VoxelSupport | TexelSupport) -> tuple[dict, np.ndarray]:
        """Code a plane, float32 [N, C] in 0..255, on the keys of a support. Return (syntax values of the codec's part of a unit,
        the plane as a decoder gets it), as PlaneCodec.enc does."""
        return self.codec.enc(plane, support, self.settings)

    def size(self, plane: np.ndarray, support: VoxelSupport | TexelSupport) -> tuple[int, np.ndarray]:
        """Code a plane, float32 [N, C] in 0..255, and return (bytes of the codec's part of a unit, the plane as a decoder gets
        it)."""
        values, decoded = self.code(plane, support)
        variables = {"NumComponents": plane.shape[1], "resolution": 1 << support.depth, "Planar": int(support.planar)}
        return len(self.codec.write_parameters({**values, **variables})), decoded


def codec_for(plane: np.ndarray, requested: PlaneCodec) -> PlaneCodec:
    """Return the codec for a plane float32 [N, C] in 0..255: the first built-in one that suits it, or else the requested one."""
    ours = (codec for codec in our_codecs() if not codec.joint and codec.suits(plane))
    return next(ours, requested)  # type: ignore[return-value]  # a codec that is not joint is one of planes
