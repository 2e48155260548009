"""Transport form of the latents (spec clause 11.9): range-coded, and unpacked to the resident form before use."""

import numpy as np

from ...core.kernel import kernel
from ..raht.entropy.range_coder import _dec_bit, _enc_bit, finish, new_contexts, new_decoder, new_encoder

CODE_BITS = 4
CLASSES = 4  # of an earlier row's code: its two upper bits


@kernel
def _context(codes, row, k):
    """First of the 16 contexts of code [row, k]: by component and by the codes of the two rows before."""
    above = (np.int64(codes[row - 1, k]) + 8) >> 2 if row > 0 else 2
    before = (np.int64(codes[row - 2, k]) + 8) >> 2 if row > 1 else 2
    return ((k * CLASSES + above) * CLASSES + before) << CODE_BITS


@kernel
def _enc_codes(codes, state, out, contexts):
    """Codes int8 [N, F] in -8..7, most significant bit first; contexts: [F * 256, 3]."""
    for row in range(codes.shape[0]):
        for k in range(codes.shape[1]):
            first, node, symbol = _context(codes, row, k), np.int64(1), np.int64(codes[row, k]) + 8
            for b in range(CODE_BITS - 1, -1, -1):
                bit = (symbol >> b) & 1
                _enc_bit(state, out, contexts, first + node, bit)
                node = 2 * node + bit


@kernel
def _dec_codes(codes, state, data, contexts):
    """Mirror of _enc_codes; node stays in 1..15 and every context below F * 256."""
    for row in range(codes.shape[0]):
        for k in range(codes.shape[1]):
            first, node = _context(codes, row, k), np.int64(1)
            for _ in range(CODE_BITS):
                node = 2 * node + _dec_bit(state, data, data.shape[0], contexts, first + node)
            codes[row, k] = node - 24


def enc_transport(codes: np.ndarray) -> bytes:
    """Code latents as the bytes of one entropy-coded codeword. codes: int8 [N, F] in -8..7."""
    out, state = np.empty(codes.size + 64, np.uint8), new_encoder()
    _enc_codes(np.ascontiguousarray(codes), state, out, new_contexts(codes.shape[1] * CLASSES * CLASSES << CODE_BITS))
    return finish(state, out)


def dec_transport(data: bytes, rows: int, features: int) -> np.ndarray:
    """Decode the codeword of enc_transport to latents int8 [rows, features]; a short codeword reads as if zeros followed
    (7.6.2)."""
    codes, packed = np.empty((rows, features), np.int8), np.frombuffer(data, np.uint8)
    _dec_codes(codes, new_decoder(packed, 0, len(packed)), packed, new_contexts(features * CLASSES * CLASSES << CODE_BITS))
    return codes
