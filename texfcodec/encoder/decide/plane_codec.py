"""Which codec a group's values are coded with, and how finely (encoder only)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...codecs import our_codecs
from ...codecs.base import Codec, Group
from ...scene.channels import COLOURS

if TYPE_CHECKING:
    from ...options import EncodeOptions

LEAST_QP, LAST_QP = 4, 51  # of a map: a step of one level, and of 228
QP_PER_DECIBEL = 6 / (20 * math.log10(2))  # a step twice as large is 6 QP


def codec_for(plane: np.ndarray, asked: Codec) -> Codec:
    """The codec for a plane float32 [N, C] in 0..255: one of ours that suits it before the one that was asked for."""
    return next((codec for codec in our_codecs() if not codec.joint and codec.suits(plane)), asked)


def with_qp_of(group: Group, options: EncodeOptions, weights: dict) -> EncodeOptions:
    """EncodeOptions with a channel group's QPs: at equal slopes of bytes and error of a shaded picture, a channel whose errors
    weigh w times those of base colour has 1 / w of its squared error. weights: of a Scene. The second channel of a group gets
    its own as an offset to the first's; components of one channel that is no colour have the same."""
    if options.qp is None or group.channels[0] in COLOURS:
        return options
    steps = [-10 * math.log10(weights.get(c.name, c.weight)) * QP_PER_DECIBEL for c in group.channels]
    qp = min(max(round(options.qp + steps[0]), LEAST_QP), LAST_QP)
    if group.channels[0].srgb:
        return replace(options, qp=qp)
    return replace(options, qp=qp, chroma_qp_offset=round(steps[-1] - steps[0]))

