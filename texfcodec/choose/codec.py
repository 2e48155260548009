"""Which codec a plane is coded with: the one that was asked for, but where another needs next to nothing (encoder only)."""

import numpy as np

from ..codecs import our_codecs
from ..codecs.codec import Codec


def codec_for(plane: np.ndarray, asked: Codec) -> Codec:
    """The codec for a plane float32 [N, C] in 0..255: one of ours that suits it before the one that was asked for."""
    return next((codec for codec in our_codecs() if not codec.joint and codec.suits(plane)), asked)
