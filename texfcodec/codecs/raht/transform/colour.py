"""Colour transform of the attribute codec: BT.709 full-range Y'CbCr in fixed point (spec clause 7.8)."""

import numpy as np

from ....core.kernel import kernel
from .quantise import VALUE_FRACTION

# 2**16 times 1.5748, 0.187324, 0.468124, 1.8556
CR_TO_R, CB_TO_G, CR_TO_G, CB_TO_B = 103206, 12276, 30679, 121608
_FORWARD = ((0.2126, 0.7152, 0.0722), (-0.2126 / 1.8556, -0.7152 / 1.8556, 0.5), (0.5, -0.7152 / 1.5748, -0.0722 / 1.5748))


def forward_colour(rgb: np.ndarray) -> np.ndarray:
    """Convert RGB to Y, Cb, Cr (BT.709), int32 [N, 3] with 12 fractional bits, at the encoder. rgb: [N, 3] in 0..255.

    It works element by element, without a matrix product: no linear-algebra library may determine the last bit of a stream.
    """
    r, g, b = np.asarray(rgb, np.float64).T
    out = np.empty((len(r), 3), np.int32)
    for c, (wr, wg, wb) in enumerate(_FORWARD):
        out[:, c] = np.rint((wr * r + wg * g + wb * b) * (1 << VALUE_FRACTION))
    return out


@kernel
def _inverse_colour(means, rgb):
    """Fills rgb uint8 [N, 3]. means: int32 [N, 3]."""
    shift = VALUE_FRACTION + 16
    for i in range(means.shape[0]):
        y, cb, cr = (np.int64(means[i, 0]) << 16) + (1 << (shift - 1)), np.int64(means[i, 1]), np.int64(means[i, 2])
        rgb[i, 0] = min(max((y + CR_TO_R * cr) >> shift, 0), 255)
        rgb[i, 1] = min(max((y - CB_TO_G * cb - CR_TO_G * cr) >> shift, 0), 255)
        rgb[i, 2] = min(max((y + CB_TO_B * cb) >> shift, 0), 255)


def inverse_colour(means: np.ndarray) -> np.ndarray:
    """Convert decoded Y, Cb, Cr to RGB at the decoder (spec 7.8.2), rounded and clipped to uint8 [N, 3]. means: int32 [N, 3], 12
    fractional bits."""
    rgb = np.empty(means.shape, np.uint8)
    _inverse_colour(means, rgb)
    return rgb


def forward_plain(values: np.ndarray) -> np.ndarray:
    """Convert values without a colour transform (TRANSFORM_NONE) to int32 with 12 fractional bits, at the encoder. values: [N,
    C] in 0..255."""
    return np.asarray(values).astype(np.int32) << VALUE_FRACTION


def inverse_plain(means: np.ndarray) -> np.ndarray:
    """Round and clip decoded values without a colour transform (TRANSFORM_NONE) to uint8 [N, C], at the decoder. means: int32
    [N, C], 12 fractional bits."""
    return np.clip((means + (1 << (VALUE_FRACTION - 1))) >> VALUE_FRACTION, 0, 255).astype(np.uint8)
