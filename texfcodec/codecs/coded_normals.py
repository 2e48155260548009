"""Codes residuals of shading normals, two numbers for each group of corners. The sizes of the neighbours' residuals select the
contexts (spec clause 8.4.4)."""

from typing import NamedTuple

import numpy as np

from ..core.kernel import kernel
from ..geometry.corner_groups import CornerGroups
from .raht.entropy.range_coder import (
    Coder,
    _dec_bit,
    _dec_bypass,
    _enc_bit,
    _enc_bypass,
    finish,
    new_contexts,
    new_decoder,
    new_encoder,
)

LARGE, ALONE = 7, 8  # classes of neighbours: the largest, and of groups without any that are known
UNARY = 14  # of a magnitude, before an exponential code
MOST_PREFIX = 12  # of that code, so that a residual is below 2**14
_ZERO, _MORE, _OF_CLASS = 0, 3, 3 + UNARY  # places of a class's contexts
_PREFIX = (ALONE + 1) * _OF_CLASS
NUM_CONTEXTS = _PREFIX + MOST_PREFIX


class _Ring(NamedTuple):
    """Arrays of CornerGroups, int64. size: int64 [G], sizes of the residuals coded so far."""

    group: np.ndarray
    first: np.ndarray
    corner_of: np.ndarray
    size: np.ndarray


@kernel
def _class(ring, g):
    """Class of group g by the residuals of its neighbours before it: the other corners of the faces around it."""
    total, count = np.int64(0), np.int64(0)
    for i in range(ring.first[g], ring.first[g + 1]):
        corner = ring.corner_of[i]
        for turn in range(1, 3):
            other = ring.group[corner - corner % 3 + (corner + turn) % 3]
            if 0 <= other < g:
                total += ring.size[other]
                count += 1
    if count == 0:
        return np.int64(ALONE)
    mean, bits = 2 * total // count, np.int64(0)
    while mean > 0:
        mean >>= 1
        bits += 1
    return min(bits, np.int64(LARGE))


@kernel
def _enc_number(coder, contexts, base, zero, value):
    _enc_bit(coder.state, coder.buffer, contexts, base + zero, np.int64(value != 0))
    if value == 0:
        return
    _enc_bypass(coder.state, coder.buffer, np.int64(value < 0))
    rest = abs(value) - 1
    for i in range(UNARY):
        _enc_bit(coder.state, coder.buffer, contexts, base + _MORE + i, np.int64(rest > i))
        if rest <= i:
            return
    rest -= UNARY
    bits = np.int64(0)
    while bits < MOST_PREFIX and (rest + 1) >> (bits + 1) > 0:
        _enc_bit(coder.state, coder.buffer, contexts, _PREFIX + bits, np.int64(1))
        bits += 1
    if bits < MOST_PREFIX:
        _enc_bit(coder.state, coder.buffer, contexts, _PREFIX + bits, np.int64(0))
    for i in range(bits - 1, -1, -1):
        _enc_bypass(coder.state, coder.buffer, ((rest + 1) >> i) & 1)


@kernel
def _dec_number(coder, contexts, base, zero):
    """Mirror of _enc_number; below 2**14 in magnitude, for any bytes."""
    if _dec_bit(coder.state, coder.buffer, coder.end, contexts, base + zero) == 0:
        return np.int64(0)
    negative = _dec_bypass(coder.state, coder.buffer, coder.end)
    value = np.int64(1)
    while value <= UNARY and _dec_bit(coder.state, coder.buffer, coder.end, contexts, base + _MORE + value - 1) == 1:
        value += 1
    if value > UNARY:
        bits = np.int64(0)
        while bits < MOST_PREFIX and _dec_bit(coder.state, coder.buffer, coder.end, contexts, _PREFIX + bits) == 1:
            bits += 1
        rest = np.int64(1)
        for _ in range(bits):
            rest = 2 * rest + _dec_bypass(coder.state, coder.buffer, coder.end)
        value += rest - 1
    return -value if negative == 1 else value


@kernel
def _enc_residuals(coder, contexts, ring, residuals):
    """Codes residuals int64 [G, 2] (spec 8.4.4). Every index comes from the encoder's own geometry."""
    for g in range(residuals.shape[0]):
        base = _class(ring, g) * _OF_CLASS
        _enc_number(coder, contexts, base, 0, residuals[g, 0])
        _enc_number(coder, contexts, base, 2 if residuals[g, 0] != 0 else 1, residuals[g, 1])
        ring.size[g] = abs(residuals[g, 0]) + abs(residuals[g, 1])


@kernel
def _dec_residuals(coder, contexts, ring, residuals):
    """Mirror of _enc_residuals. All indices come from the geometry; sums of sizes stay below 2**15 times its corners."""
    for g in range(residuals.shape[0]):
        base = _class(ring, g) * _OF_CLASS
        residuals[g, 0] = _dec_number(coder, contexts, base, 0)
        residuals[g, 1] = _dec_number(coder, contexts, base, 2 if residuals[g, 0] != 0 else 1)
        ring.size[g] = abs(residuals[g, 0]) + abs(residuals[g, 1])


def _ring(groups):
    return _Ring(groups.group, groups.first, groups.corner_of, np.zeros(len(groups), np.int64))


def enc_residuals(residuals: np.ndarray, groups: CornerGroups) -> bytes:
    """Code the residuals of corner normals as the bytes of one codeword. residuals: int64 [G, 2] of magnitudes up to 8000, one
    row a group; groups: the CornerGroups, whose neighbourhood selects contexts."""
    out = np.empty(10 * len(groups) + 16, np.uint8)
    coder = Coder(new_encoder(), out, 0)
    _enc_residuals(coder, new_contexts(NUM_CONTEXTS), _ring(groups), np.ascontiguousarray(residuals, np.int64))
    return finish(coder.state, out)


def dec_residuals(data: bytes, groups: CornerGroups) -> np.ndarray:
    """Decode the codeword of enc_residuals to residuals int64 [G, 2]. groups: the same CornerGroups."""
    out, buffer = np.empty((len(groups), 2), np.int64), np.frombuffer(bytes(data), np.uint8)
    coder = Coder(new_decoder(buffer, 0, len(buffer)), buffer, len(buffer))
    _dec_residuals(coder, new_contexts(NUM_CONTEXTS), _ring(groups), out)
    return out
