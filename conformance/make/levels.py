"""Checks on the way: CRC-32 of the means of every level of a RAHT unit, by both decoders, for whoever's values_crc is wrong."""

import zlib

import numpy as np

from conformance.make.good import parsed, plane_keys
from conformance.reference.attributes import decode_means
from conformance.reference.bits import units_of
from conformance.reference.syntax import read_stream
from texfcodec import decode
from texfcodec.codecs.raht import attribute_coder
from texfcodec.codecs.raht.raht_values import coded_of

RAHT_ID = 0


def level_checks(data):
    """{"field{i}_group{g}": [eight hexadecimal digits of each level, the root first]} of the RAHT units of a stream. Ends the
    program where the two decoders differ."""
    stream, fields = parsed(data), decode(data).fields
    plain = read_stream(units_of(data))["attributes"]
    out = {}
    for unit, other in zip(stream.attributes, plain, strict=True):
        if unit["codec_id"] == RAHT_ID:
            keys = plane_keys(unit, fields[unit["field_index"]].keys)
            name = f"field{unit['field_index']}_group{unit['group_index']}"
            ours = [_check(_our_means(unit, keys, level)) for level in range(unit["Depth"] + 1)]
            theirs = [_check(means) for means in decode_means(other, keys.tolist())[0]]
            if ours != theirs:
                differ = [a == b for a, b in zip(ours, theirs, strict=True)].index(False)
                raise SystemExit(f"{name}: the two decoders differ at level {differ}")
            out[name] = ours
    return out


def _our_means(unit, keys, level):
    coded, spans = coded_of(unit)
    data = np.frombuffer(bytes(unit["codeword_data"]), np.uint8)
    return attribute_coder.dec_attributes(keys, unit["Depth"], coded, data, spans, level)


def _check(means):
    return f"{zlib.crc32(np.array(means, '<i4').tobytes()):08x}"
