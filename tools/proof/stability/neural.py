"""Cases of the evaluation of a 3DNTC payload: the ends of INT4 and binary16, and its codes in both forms."""

import numpy as np

from conformance.reference.bits import Reader
from conformance.reference.neural import Neural, fixed_point
from conformance.reference.syntax import read_neural
from texfcodec.codecs.neural.infer import fixed_weights, infer
from texfcodec.codecs.neural.neural_syntax import NEURAL
from texfcodec.codecs.neural.payload import Level, Payload, Tables, dec_codes, enc_codes, payload_values
from texfcodec.codecs.neural.transport import dec_transport, enc_transport
from texfcodec.core.syntax_walk import write_structure
from tools.proof.stability.case import Case, Draws

GROUP = "3DNTC"
LAST = (1 << 24) - 1
PARAMETERS = 27 << 10  # binary16 patterns without a sign whose magnitude is below 2^12
# 0, the subnormal numbers' ends, the least and the largest normal one, 1, and where rounding to 2^-16 begins
ENDS = (0, 1, 0x03FF, 0x0400, PARAMETERS - 1, 15 << 10, 9 << 10, (9 << 10) - 1)


def every_parameter(draw: Draws) -> float:
    """How far a parameter's fixed-point number is from its value, in units of 2^-16; infinite where it is not the oracle's."""
    halves = np.arange(PARAMETERS, dtype=np.uint16)
    halves = np.concatenate([halves, halves | np.uint16(1 << 15)])
    fixed = fixed_weights(halves)
    if fixed.tolist() != [fixed_point(int(half)) for half in halves]:
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


def answers_at_the_ends(draw: Draws) -> float:
    """Answers that are not the oracle's."""
    payload = payload_at_the_ends(draw)
    positions = np.array([[draw.pick((0, LAST, draw.integer(0, LAST))) for _ in range(3)] for _ in range(6)])
    oracle = oracle_of(payload, draw.pick((0, 1)))
    want = [oracle.answer(0, position) for position in positions.tolist()]
    return float((infer(positions, Tables(payload, 0, [None] * len(payload.levels))) != want).sum())


def codes_in_both_forms(draw: Draws) -> float:
    """Codes that come back otherwise from one of the two forms."""
    rows, features = draw.integer(1, 60), draw.pick((2, 8, 64))
    codes = draw.generator().integers(draw.integer(-8, 0), draw.integer(0, 7) + 1, (rows, features)).astype(np.int8)
    return float((dec_codes(enc_codes(codes), features) != codes).sum()
                 + (dec_transport(enc_transport(codes), rows, features) != codes).sum())


CASES = (
    Case("binary16 parameters", GROUP,
         "all 55,296 parameters that a stream may hold",
         0.5, "units of 2^-16",
         "From 2^-6 on a parameter is a whole number of 2^-16; below, it is rounded to the nearest (11.6), to 0 from 2^-17 "
         "down.",
         every_parameter, 1, False),
    Case("ends of INT4 and binary16", GROUP,
         "largest, least, subnormal and zero parameters, all codes at one end, positions at corners of the cube",
         0, "answers that differ",
         "Parameters are below 2^28 as fixed point and activations cut at 2^24, so 304 products stay below 2^61 and the kernel "
         "is the clause (11.6, clause 10).",
         answers_at_the_ends, 12),
    Case("codes of latents", GROUP,
         "codes of any part of -8 to 7 in the resident and the transport form",
         0, "codes that differ",
         "Four bits a code, in two's complement or through the range coder (5.7.4, 11.9).",
         codes_in_both_forms, 12),
)
