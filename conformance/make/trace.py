"""What happens inside a decoder on its way through a stream, watched on the reference one."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from unittest.mock import patch

from conformance.reference import attributes, dct, decoder, following, mixing, neural, residual
from conformance.reference import filter as wiener

CLIPPING = (attributes, dct, wiener, following, mixing, neural, residual)


@dataclass
class Trace:
    """clipped: (module, bound) of every bound that a value was cut to; escapes: by module, the largest number after an escape;
    differences: the largest dequantised one; unread: bytes of codewords that were never read; empty: a point had no latents;
    counts: of coefficients of DCT blocks."""

    clipped: set = field(default_factory=set)
    escapes: int = 0
    differences: int = 0
    unread: int = 0
    empty: bool = False
    counts: set = field(default_factory=set)


def traced(data):
    """Trace of a decoding."""
    trace, readers = Trace(), []
    with ExitStack() as stack:
        for module in CLIPPING:
            stack.enter_context(patch.object(module, "clip", _watched_clip(module, trace)))
        for holder, name, after in (
            (attributes.RangeDecoder, "escape", lambda rest, *_: setattr(trace, "escapes", max(trace.escapes, rest))),
            (attributes.RangeDecoder, "__init__", lambda _, reader, *__: readers.append(reader)),
            (dct.DctBlock, "parse_count", lambda count, *_: trace.counts.add(count)),
            (attributes, "dequantise", lambda d, *_: setattr(trace, "differences", max(trace.differences, abs(d)))),
            (neural.LatentLevel, "latents", lambda rows, *_: setattr(trace, "empty", trace.empty or not any(rows))),
        ):
            stack.enter_context(patch.object(holder, name, _followed(getattr(holder, name), after)))
        decoder.decode(data)
    trace.unread = sum(max(0, len(reader.codeword) - reader.at) for reader in readers)
    return trace


def _followed(function, after):
    """The function, with a call of after(result, *arguments) behind it."""

    def call(*arguments, **named):
        result = function(*arguments, **named)
        after(result, *arguments)
        return result

    return call


def _watched_clip(module, trace):
    """A clip that notes which bound it has cut to."""
    place = module.__name__.rsplit(".", 1)[-1]

    def clip(low, high, value):
        if value < low or value > high:
            trace.clipped.add((place, low if value < low else high))
        return max(low, min(high, value))

    return clip
