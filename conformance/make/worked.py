"""Annex B of bitstream_spec.md: the first decisions of a range decoder on two vectors, as the naive decoder takes them."""

from contextlib import ExitStack
from unittest.mock import patch

from conformance.reference import attributes, decoder, mixing
from texfcodec.bitstream.stream import read_stream
from texfcodec.limits import Limits

DECISIONS = 20
KINDS = {"flag": "flag", "nonzero": "nonzero", "sign": "sign", "more": "magnitude"}


class _Enough(Exception):
    """There are as many decisions as are shown."""


def decisions(data):
    """[(kind, p in 2^-16 or None for a bypass, range, code, bit)] of the first DECISIONS bits of a stream's first codeword."""
    steps, kind = [], [""]
    split = attributes.RangeDecoder.split

    def watched(reader, bound, p=None):
        before = reader.range, reader.code
        steps.append((kind[0], p, *before, split(reader, bound)))
        if len(steps) == DECISIONS:
            raise _Enough
        return steps[-1][-1]

    def with_kind(name, method):
        def call(*arguments):
            kind[0] = f"{KINDS[name]} {arguments[-1]}" if name == "more" else KINDS[name]
            return method(*arguments)

        return call

    with ExitStack() as stack:
        adaptive = lambda reader, bound: watched(reader, bound, bound // (reader.range >> 16))
        stack.enter_context(patch.object(attributes.RangeDecoder, "split", adaptive))
        stack.enter_context(patch.object(attributes.RangeDecoder, "bypass", lambda reader: watched(reader, reader.range >> 1)))
        for bits in (attributes.DirectBits, mixing.MixedBits):
            for name in KINDS:
                stack.enter_context(patch.object(bits, name, with_kind(name, getattr(bits, name))))
        try:
            decoder.decode(data)
        except _Enough:
            pass
    return steps


def worked(data, models):
    """Markdown table of decisions() of a stream whose first attribute unit mixes so many models."""
    assert read_stream(data, Limits()).attributes[0]["num_models"] == models
    head = "| | bit of | p | range | code | bit |\n|---:|---|---:|---:|---:|---:|"
    rows = [f"| {n} | {kind} | {'bypass' if p is None else p} | {wide} | {code} | {bit} |"
            for n, (kind, p, wide, code, bit) in enumerate(decisions(data), 1)]
    return "\n".join([head, *rows])
