"""Bounds of 3DNTC: the ends of INT4 and binary16, its codes in both forms, and fits at any rate."""

from unittest.mock import patch

import numpy as np
import pytest
from bounds import Draws, Group

from conformance.reference.bits import Reader
from conformance.reference.neural import Neural, fixed_point
from conformance.reference.syntax import read_neural
from texfcodec.codecs.neural import fit as neural_fit
from texfcodec.codecs.neural.fit_samples import Samples
from texfcodec.codecs.neural.infer import fixed_weights, infer
from texfcodec.codecs.neural.neural_syntax import NEURAL
from texfcodec.codecs.neural.payload import Level, Payload, Tables, dec_codes, enc_codes, payload_values
from texfcodec.codecs.neural.transport import dec_transport, enc_transport
from texfcodec.core.syntax_walk import write_structure
from texfcodec.errors import InputError

case = Group("3DNTC")

LAST = (1 << 24) - 1
PARAMETERS = 27 << 10  # binary16 patterns without a sign whose magnitude is below 2^12
ENDS = (0, 1, 0x03FF, 0x0400, PARAMETERS - 1, 15 << 10, 9 << 10, (9 << 10) - 1)


@case("binary16 parameters", 0.5, "units of 2^-16", seeds=1, search=False)
def every_parameter(draw: Draws) -> float:
    """How far a parameter's fixed-point number is from its value, in units of 2^-16; infinite where it is not the oracle's.
    Stress: all 55,296 parameters that a stream may hold
    Bound: From 2^-6 on a parameter is a whole number of 2^-16; below, it is rounded to the nearest (11.6), to 0 from 2^-17
    down.
    """
    halves = np.arange(PARAMETERS, dtype=np.uint16)
    halves = np.concatenate([halves, halves | np.uint16(1 << 15)])
    fixed = fixed_weights(halves)
    if fixed.tolist() != [fixed_point(int(half)) for half in halves] or np.abs(fixed).max() >= 1 << 28:
        return np.inf
    return float(np.abs(fixed - halves.view(np.float16).astype(np.float64) * 65536).max())


def payload_at_the_ends(draw: Draws) -> Payload:
    """A payload with hashed levels whose parameters and codes are at the ends of their ranges, or any."""
    levels = tuple(Level(draw.pick((1, 2, 9, 8192)), draw.integer(1, 6), 0) for _ in range(draw.integer(1, 2)))
    hidden = tuple(draw.pick((1, 5, 8)) for _ in range(draw.integer(1, 2)))
    payload = Payload(draw.pick((2, 4, 10)), draw.integer(0, 2), draw.pick((1, 40, 16384)), hidden, levels, draw.pick((1, 3)))
    rng, kind = draw.generator(), draw.integer(0, 3)
    ends = np.array(ENDS, np.uint16)[rng.integers(0, len(ENDS), payload.parameters)]
    usual = (rng.normal(0, 0.5, payload.parameters)).astype("<f2").view("<u2")
    largest = np.full(payload.parameters, PARAMETERS - 1, np.uint16)
    sign = rng.integers(0, 2, payload.parameters).astype(np.uint16) << 15
    payload.halves = (ends | sign, usual, largest, largest | sign)[kind].astype("<u2")
    codes = rng.integers(-8, 8, (payload.rows, payload.features), np.int8)
    payload.codes = np.where(rng.random(codes.shape) < draw.unit(), np.int8(draw.pick((-8, 7))), codes)
    return payload


def oracle_of(payload: Payload, form: int) -> Neural:
    """The oracle of a payload of one field, read from its bytes."""
    known = {"num_fields": 1, "NumOutputs": payload.components}
    reader, unit = Reader(write_structure(NEURAL, payload_values(payload, form) | known)), {}
    read_neural(reader, unit, {"num_fields": 1, "channel_groups": [{"components": payload.components}]})
    return Neural(unit, [[] for _ in payload.levels])


@case("ends of INT4 and binary16", 0, "answers that differ", seeds=12)
def answers_at_the_ends(draw: Draws) -> float:
    """Answers that are not the oracle's.
    Stress: largest, least, subnormal and zero parameters, all codes at one end, positions at corners of the cube
    Bound: Parameters are below 2^28 as fixed point and activations cut at 2^24, so 304 products stay below 2^61 and the
    kernel is the clause (11.6, clause 10).
    """
    payload = payload_at_the_ends(draw)
    positions = np.array([[draw.pick((0, LAST, draw.integer(0, LAST))) for _ in range(3)] for _ in range(6)])
    oracle = oracle_of(payload, draw.pick((0, 1)))
    want = [oracle.answer(0, position) for position in positions.tolist()]
    return float((infer(positions, Tables(payload, 0, [None] * len(payload.levels))) != want).sum())


@case("codes of latents", 0, "codes that differ", seeds=12)
def codes_in_both_forms(draw: Draws) -> float:
    """Codes that come back otherwise from one of the two forms.
    Stress: codes of any part of -8 to 7 in the resident and the transport form
    Bound: Four bits a code, in two's complement or through the range coder (5.7.4, 11.9).
    """
    rows, features = draw.integer(1, 60), draw.pick((2, 8, 64))
    codes = draw.generator().integers(draw.integer(-8, 0), draw.integer(0, 7) + 1, (rows, features)).astype(np.int8)
    return float((dec_codes(enc_codes(codes), features) != codes).sum()
                 + (dec_transport(enc_transport(codes), rows, features) != codes).sum())


fits = Group("Fits of the encoder")


@fits("3DNTC fits at any rate", 0, "other ends", seeds=8)
def neural_fit_at_any_rate(draw: Draws) -> float:
    """1 where a fit ends in something else than a payload that a stream can hold or TXF-I58.
    Stress: rates of latents and network from 0.01 to 1e38, noise, one colour, no weight at all
    Bound: Latents are put back into the range of INT4 and parameters cut below 2^12 (5.7.4); a fit whose numbers are none any
    more ends as TXF-I58, before anything is written.
    """
    rng, count = draw.generator(), 512
    position = rng.integers(0, 1 << 24, (count, 3)).astype(np.int32)
    kind = draw.integer(0, 2)
    target = np.full((count, 3), draw.integer(0, 255)) if kind else rng.integers(0, 256, (count, 3))
    share = np.full((count, 3), 0 if kind == 2 else 255, np.uint8)
    samples = Samples(position, target.astype(np.uint8), share, np.zeros(count, np.int16))
    design = Payload(4, 1, 2, (8,), (Level(8, 6, 0),), 3)
    rates = {"LATENT_RATE": draw.power(-2, 38), "NETWORK_RATE": draw.power(-2, 38)}
    fit = neural_fit.Fit(design, [Tables(design, 0, [None])], samples, samples.taken(slice(0, 64)), draw.integer(0, 9), batch=128)
    with patch.multiple(neural_fit, **rates), np.errstate(all="ignore"):
        try:
            payload = fit.run(12)
        except InputError as error:
            return float(error.code != "TXF-I58")
    return float(((payload.halves >> 10 & 31) > 26).any() or not -8 <= payload.codes.min() <= payload.codes.max() <= 7)


@pytest.mark.parametrize("hard", [*case, *fits], ids=lambda hard: hard.name)
def test_no_trial_of_a_case_is_worse_than_its_bound(hard):
    worst = hard.worst()
    assert worst.value <= hard.bound, worst
