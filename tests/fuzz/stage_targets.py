"""Targets of the stages inside: supports, the Draco substream, range coder, contexts, mixing."""

import numpy as np

from fuzz.choices import Choices, edited
from fuzz.seeds import SLOW, SMALL, vectors
from fuzz.syntax import traced
from texfcodec.bitstream.syntax import UNIT_GEOMETRY
from texfcodec.codecs.raht.entropy.contexts import CONTEXTS as DIRECT_CONTEXTS
from texfcodec.codecs.raht.entropy.contexts import MAX_PREFIX, UNARY, _dec_escape, _dec_magnitude, _enc_escape, _enc_magnitude
from texfcodec.codecs.raht.entropy.mixing import LIMIT, MAX_MODELS, _dec_mixed_bit, _enc_mixed_bit, new_chosen, new_model
from texfcodec.codecs.raht.entropy.range_coder import (
    CODE,
    FULL,
    POS,
    RANGE,
    TOP,
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
from texfcodec.core.syntax_walk import write_v
from texfcodec.field.texel_set import MAX_UV, count_rows, referenced_texels
from texfcodec.field.texels import TexelSupport, texels_are_sound
from texfcodec.field.voxelise import count_samples, voxelise
from texfcodec.field.voxels import VoxelSupport, keys_are_sound
from texfcodec.geometry.draco import UvCoding, counts_of, dec_geometry, dec_textured, enc_geometry, enc_textured

MOST_SYMBOLS = 30 if SLOW else 120
HEADER = 11  # bytes of Draco's header before the traversal


def _coordinates(choices, count, columns, bits):
    """Whole numbers below 2**bits, near a corner, on the border or anywhere: int64 [count, columns]."""
    most = (1 << bits) - 1
    one = lambda: choices.pick((0, most, most // 2, choices.whole(0, 9) & most)) if choices.flag(3) else choices.whole(0, most)
    return np.array([[one() for _ in range(columns)] for _ in range(count)], np.int64)


def _faces(choices, corners):
    count = choices.whole(1, 6)
    return np.frombuffer(choices.filled(3 * count), np.uint8).astype(np.int64).reshape(count, 3) % corners


def voxels(data: bytes) -> None:
    """Which voxels a few faces touch: sorted, in the grid, the same for two threads and for another order of faces (6)."""
    choices = Choices(data)
    bits, resolution = choices.whole(8, 20), choices.pick((1, 2, 3, 7, 8, 33, 100, 255, 1024, 8191, 8192))
    lattice = _coordinates(choices, choices.whole(3, 8), 3, bits)
    faces = _faces(choices, len(lattice))
    if count_samples(lattice, faces, bits, resolution) > SMALL.samples:
        return
    threshold, most = choices.pick((0, 0, 77, 65535)), choices.pick((None, 0, 1, 50))
    keys, weights = voxelise(lattice, faces, bits, resolution, threshold, 1, most)
    assert (weights >= threshold << 24).all() and (not len(keys) or keys_are_sound(keys, resolution))
    again, same = voxelise(lattice, np.roll(faces[::-1], 1, axis=1), bits, resolution, threshold, 2, most)
    assert (again == keys).all() and (same == weights).all()
    support = VoxelSupport(resolution, keys)
    for levels in range(choices.whole(0, 3)):
        assert len(keys) == 0 or keys_are_sound(support.coarser(levels).keys, support.coarser(levels).size)


def texels(data: bytes) -> None:
    """Which texels a few faces ask of an image (6.5)."""
    choices = Choices(data)
    bits, size = choices.whole(0, 8), (choices.pick((1, 2, 5, 16, 300, 16384)), choices.pick((1, 2, 5, 16, 300, 16384)))
    uv = _coordinates(choices, choices.whole(3, 8), 2, choices.pick((4, 10, 16, 26)))
    uv = uv - choices.pick((0, 100, MAX_UV - 1)) if choices.flag() else uv
    uv = np.clip(uv, 1 - MAX_UV, MAX_UV - 1)
    faces, wrap = _faces(choices, len(uv)), (choices.whole(0, 2), choices.whole(0, 2))
    if size[0] * size[1] > SMALL.texels or count_rows(uv, faces, bits) > SMALL.samples >> 4:
        return
    keys = referenced_texels(uv, faces, bits, size, wrap, choices.pick((None, None, 0, 40)))
    assert texels_are_sound(keys, size)
    again = referenced_texels(uv, np.roll(faces[::-1], 1, axis=1), bits, size, wrap)
    assert (again == keys).all()
    support = TexelSupport(keys=keys, width=size[0], height=size[1], wrap=wrap, fraction_bits=bits)
    places = np.array([[choices.real(), choices.real()] for _ in range(3)])
    values = np.full((len(keys), 3), 9, np.uint8)
    answers = support.query(np.nan_to_num(places), values)
    assert np.isin(answers, (0.0, 9.0)).all()


# The Draco substream


def _draco_seeds():
    """(bytes, vertices, faces, bits of positions, UvCoding or None) of what stands in vectors."""
    found = []
    for data in vectors():
        header: dict = {}
        for kind, payload, rows in traced(data):
            named = {name: value for name, _, _, value in rows}
            header = named if "position_bits" in named else header
            if kind == UNIT_GEOMETRY:
                begin = next(offset for name, offset, _, _ in rows if name == "draco_data")
                coding = UvCoding(named["uv_bits"], named.get("uv_range", 1)) if "uv_bits" in named else None
                found.append((payload[begin:], named["unit_vertices"], named["unit_faces"], header["position_bits"], coding))
    return found


SEEDS: list = []


def geometry(data: bytes) -> None:
    """The Draco wrapper: substreams drawn or from vectors, with bytes edited, counts that lie in one header or in both, and other
    attributes than were promised (5.6). Draco is native code: run this where a crash and a cap on memory cost one process."""
    choices = Choices(data)
    SEEDS.extend([] if SEEDS else _draco_seeds())
    if choices.flag(4):
        raw, vertices, faces, bits, coding = _drawn_draco(choices)
    else:
        raw, vertices, faces, bits, coding = choices.pick(SEEDS)
    for _ in range(choices.whole(0, 3)):
        raw = raw[:HEADER] + edited(raw[HEADER:], choices)
    if choices.flag(3):
        vertices, faces = abs(choices.number()) % (1 << 40), abs(choices.number()) % (1 << 40)
        after = raw[HEADER + 1 :]
        raw = raw[: HEADER + 1] + write_v(vertices) + write_v(faces) + after[choices.whole(1, 6) :]
    elif choices.flag():
        vertices, faces = counts_of(raw)
    if vertices > SMALL.vertices or faces > SMALL.faces:  # the header of the stream is held against the limits first
        vertices, faces = vertices % SMALL.vertices, faces % SMALL.faces
    if coding is None:
        lattice, triangles = dec_geometry(raw, vertices, faces, bits)
    else:
        lattice, triangles, uv = dec_textured(raw, vertices, faces, coding, bits)
        assert uv.shape == (len(lattice), 2) and uv.min() >= 0 and uv.max() < 1 << 20
    assert triangles.shape == (faces, 3) and triangles.min() >= 0 and triangles.max() < len(lattice)
    assert lattice.min() >= 0 and lattice.max() < 1 << bits


def _drawn_draco(choices):
    bits, count = choices.whole(8, 20), choices.whole(3, 9)
    lattice, faces = _coordinates(choices, count, 3, bits), _faces(choices, count)
    if choices.flag():
        uv = _coordinates(choices, count, 2, choices.pick((1, 6, 20)))
        raw, coding = enc_textured(lattice, faces, uv - uv.min(axis=0), bits)
        return raw, *counts_of(raw), bits, coding
    raw = enc_geometry(lattice, faces, bits)
    return raw, *counts_of(raw), bits, None


# Entropy coding


def _sound(state):
    return 0 <= state[CODE] < state[RANGE] and TOP <= state[RANGE] < 1 << 32


def range_coder(data: bytes) -> None:
    """Bits with and without contexts come back from any length of buffer; a decoder of any bytes keeps its bounds (7.6)."""
    choices = Choices(data)
    symbols = [(byte & 1, byte >> 1 & 3, byte >> 3) for byte in choices.take(choices.whole(0, MOST_SYMBOLS))]
    raw = choices.rest()
    out, state, contexts = np.empty(len(symbols) * 2 + 16, np.uint8), new_encoder(), new_contexts(4)
    for bit, ctx, kind in symbols:
        _enc_bypass(state, out, bit) if kind == 0 else _enc_bit(state, out, contexts, ctx, bit)
    word = np.frombuffer(finish(state, out), np.uint8)
    state, contexts = new_decoder(word, 0, len(word)), new_contexts(4)
    for bit, ctx, kind in symbols:
        found = _dec_bypass(state, word, len(word)) if kind == 0 else _dec_bit(state, word, len(word), contexts, ctx)
        assert found == bit and _sound(state)
    anything = np.frombuffer(raw, np.uint8)
    state = new_decoder(anything, 0, len(anything))
    for _, ctx, kind in symbols:
        _dec_bypass(state, anything, len(anything)) if kind == 0 else _dec_bit(state, anything, len(anything), contexts, ctx)
        assert _sound(state) and contexts[:, :2].min() >= 0 and contexts[:, :2].max() < 1 << 22
    small, state = np.empty(choices.whole(0, 3), np.uint8), new_encoder()
    for bit, ctx, _ in symbols:
        _enc_bit(state, small, contexts, ctx, bit)
    assert state[FULL] or state[POS] <= len(small)


def contexts(data: bytes) -> None:
    """Magnitudes and escapes come back; a prefix that never ends stops (7.5.4)."""
    choices = Choices(data)
    values = [choices.whole(1, choices.pick((3, 17, 300, (1 << 24) - 1))) * (-1 if choices.flag() else 1)
              for _ in range(choices.whole(0, MOST_SYMBOLS // 4))]
    places = [(choices.whole(0, 2), choices.whole(0, 6), choices.whole(0, 2)) for _ in values]
    out, state, table = np.empty(64 * len(values) + 16, np.uint8), new_encoder(), new_contexts(DIRECT_CONTEXTS)
    for value, place in zip(values, places, strict=True):
        _enc_magnitude(state, out, table, *place, abs(value), int(value < 0))
        _enc_escape(state, out, abs(value))
    word = np.frombuffer(finish(state, out), np.uint8)
    state, table = new_decoder(word, 0, len(word)), new_contexts(DIRECT_CONTEXTS)
    for value, place in zip(values, places, strict=True):
        assert _dec_magnitude(state, word, len(word), table, *place) == value
        assert _dec_escape(state, word, len(word)) == abs(value)
    anything = np.frombuffer(choices.rest(), np.uint8)
    state = new_decoder(anything, 0, len(anything))
    for place in places:
        assert 1 <= abs(_dec_magnitude(state, anything, len(anything), table, *place)) < (2 << MAX_PREFIX) + UNARY + 2
        assert 1 <= _dec_escape(state, anything, len(anything)) < 2 << MAX_PREFIX


def mixing(data: bytes) -> None:
    """Bits on which several models agree, or do not, come back; the weights stay within what int64 sums bear (7.6.4)."""
    choices = Choices(data)
    models, count = choices.whole(1, MAX_MODELS), choices.whole(0, MOST_SYMBOLS)
    rows = [(bytes(choices.filled(2)), choices.whole(0, 1)) for _ in range(count)]
    rows = rows * choices.pick((1, 1, 4)) if not SLOW else rows
    out, state = np.empty(2 * len(rows) + 16, np.uint8), new_encoder()
    model, chosen = new_model(16, 4, 3), new_chosen()
    for row, bit in rows:
        _choose(chosen, models, row)
        _enc_mixed_bit(Coder(state, out, 0), model, models, chosen, bit)
    word = np.frombuffer(finish(state, out), np.uint8)
    again, state = new_model(16, 4, 3), new_decoder(word, 0, len(word))
    for row, bit in rows:
        _choose(chosen, models, row)
        assert _dec_mixed_bit(Coder(state, word, len(word)), again, models, chosen) == bit and _sound(state)
    assert all((a == b).all() for a, b in zip(model, again, strict=True))
    assert abs(again.weights).max() * LIMIT * (MAX_MODELS + 1) < 1 << 62
    anything = np.frombuffer(choices.rest(), np.uint8)
    state = new_decoder(anything, 0, len(anything))
    for row, _ in rows:
        _choose(chosen, models, row)
        _dec_mixed_bit(Coder(state, anything, len(anything)), again, models, chosen)
        assert _sound(state)


def _choose(chosen, models, row):
    """Contexts and sets of the next bit."""
    for i in range(models):
        chosen.where[i] = (row[0] >> i & 1) + 2 * i
    chosen.sets[:] = row[1] & 1, 2 + (row[1] >> 1 & 1), row[1] % 3
