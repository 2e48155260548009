"""Codes marks of sharp edges, one bit each. The angle at the edge and the marks of its neighbours select the context (spec clause
8.4.2)."""

import numpy as np

from ..core.kernel import kernel
from ..geometry.edges import NUM_FOLDS
from .raht.entropy.range_coder import Coder, _dec_bit, _enc_bit, finish, new_contexts, new_decoder, new_encoder

MOST_SHARP, MOST_CODED = 2, 3  # of the edges at a vertex that count
_SHARP, _CODED = MOST_SHARP + 1, MOST_CODED + 1
NUM_CONTEXTS = NUM_FOLDS * _SHARP**2 * _CODED**2


@kernel
def _context(ends, fold, met, i):
    """Context of edge i. met: int64 [V, 2], number of edges coded so far at a vertex, and number of sharp edges among them."""
    a, b = ends[i, 0], ends[i, 1]
    sharp_a, sharp_b = min(met[a, 1], MOST_SHARP), min(met[b, 1], MOST_SHARP)
    coded_a, coded_b = min(met[a, 0], MOST_CODED), min(met[b, 0], MOST_CODED)
    sharp = min(sharp_a, sharp_b) * _SHARP + max(sharp_a, sharp_b)
    return (fold[i] * _SHARP * _SHARP + sharp) * _CODED * _CODED + min(coded_a, coded_b) * _CODED + max(coded_a, coded_b)


@kernel
def _meet(ends, met, i, bit):
    for k in range(2):
        met[ends[i, k], 0] += 1
        met[ends[i, k], 1] += bit


@kernel
def _enc_marks(coder, contexts, ends, fold, met, marks):
    """Codes marks uint8 [E] (spec 8.4.2). Every index comes from the encoder's own geometry."""
    for i in range(ends.shape[0]):
        _enc_bit(coder.state, coder.buffer, contexts, _context(ends, fold, met, i), np.int64(marks[i]))
        _meet(ends, met, i, np.int64(marks[i]))


@kernel
def _dec_marks(coder, contexts, ends, fold, met, marks):
    """Mirror of _enc_marks. All indices come from the geometry: ends are below the length of met, folds below NUM_FOLDS."""
    for i in range(ends.shape[0]):
        bit = _dec_bit(coder.state, coder.buffer, coder.end, contexts, _context(ends, fold, met, i))
        marks[i] = bit
        _meet(ends, met, i, bit)


def _scratch(ends):
    """(contexts, met) before the first edge."""
    return new_contexts(NUM_CONTEXTS), np.zeros((int(ends.max(initial=-1)) + 1, 2), np.int64)


def enc_marks(marks: np.ndarray, ends: np.ndarray, fold: np.ndarray) -> bytes:
    """Code a bit for each edge, whether it is sharp, as the bytes of one codeword. marks: bool [E]; ends: int64 [E, 2], welded
    vertices; fold: int64 [E], class of the angle at each edge, below NUM_FOLDS (geometry.edges)."""
    out = np.empty(2 * len(ends) + 16, np.uint8)
    contexts, met = _scratch(ends)
    coder = Coder(new_encoder(), out, 0)
    _enc_marks(coder, contexts, ends, fold, met, marks.astype(np.uint8))
    return finish(coder.state, out)


def dec_marks(data: bytes, ends: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Decode the codeword of enc_marks to marks bool [E]; ends and fold as there."""
    marks = np.empty(len(ends), np.uint8)
    contexts, met = _scratch(ends)
    buffer = np.frombuffer(bytes(data), np.uint8)
    _dec_marks(Coder(new_decoder(buffer, 0, len(buffer)), buffer, len(buffer)), contexts, ends, fold, met, marks)
    return marks.astype(bool)
