"""Which codec a group's values are coded with, and how finely (encoder only)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..codecs import our_codecs
from ..codecs.codec import Codec, Group

if TYPE_CHECKING:
    from ..options import EncodeOptions

QP_PER_DECIBEL = 6 / (20 * math.log10(2))  # a step twice as large is 6 QP


def codec_for(plane: np.ndarray, asked: Codec) -> Codec:
    """The codec for a plane float32 [N, C] in 0..255: one of ours that suits it before the one that was asked for."""
    return next((codec for codec in our_codecs() if not codec.joint and codec.suits(plane)), asked)


def with_qp_of(group: Group, options: EncodeOptions) -> EncodeOptions:
    """EncodeOptions with a channel group's QP: at equal slopes of bytes and error of a shaded picture, a channel whose errors
    weigh w times those of base colour has 1 / w of its squared error."""
    weight = max(channel.weight for channel in group.channels)
    offset = round(-10 * math.log10(weight) * QP_PER_DECIBEL)
    if options.qp is None or not offset:
        return options
    return replace(options, qp=min(max(options.qp + offset, 0), 63))

