"""Decoder of EXT_meshopt_compression, from the extension's text: attributes of version 0, triangles, index sequences, filters.

Every read is within bounds, so that an invalid view is an error and not a crash. Kernels return the number of bytes read, or -1.
"""

import numpy as np

from ...core.kernel import kernel

ATTRIBUTE_HEADS, TRIANGLE_HEADS, SEQUENCE_HEADS = (0xA0,), (0xE0, 0xE1), (0xD0, 0xD1)
_BLOCK_BYTES, _BLOCK_VERTICES, _GROUP = 8192, 256, 16
_LEAST_TAIL = 32  # bytes that end a stream of attributes
_CODES = 16  # bytes that end a stream of triangles
_SEQUENCE_TAIL = 4


def decode_attributes(packed: bytes, count: int, stride: int) -> np.ndarray | None:
    """Attributes uint8 [count, stride] of a stream; None if it is broken. stride: a multiple of 4, at most 256."""
    tail = max(stride, _LEAST_TAIL)
    if len(packed) < 1 + tail or packed[0] not in ATTRIBUTE_HEADS:
        return None
    out = np.zeros((count, stride), np.uint8)
    data, block = np.frombuffer(packed, np.uint8), min(_BLOCK_BYTES // stride & ~15, _BLOCK_VERTICES)
    read = _attributes(data[1 : len(data) - tail], data[len(data) - stride :], out, block)
    return out if read == len(packed) - 1 - tail else None


def decode_triangles(packed: bytes, count: int) -> np.ndarray | None:
    """Vertex indices uint32 [count] of a stream of triangles; None if it is broken. count: a multiple of 3."""
    if len(packed) < 1 + count // 3 + _CODES or packed[0] not in TRIANGLE_HEADS:
        return None
    data, out = np.frombuffer(packed, np.uint8), np.zeros(count, np.uint32)
    codes, rest = data[1 : 1 + count // 3], data[1 + count // 3 : len(data) - _CODES]
    read = _triangles(codes, rest, data[len(data) - _CODES :], 13 if packed[0] == 0xE1 else 15, out)
    return out if read == len(rest) else None


def decode_sequence(packed: bytes, count: int) -> np.ndarray | None:
    """Vertex indices uint32 [count] of a stream of indices; None if it is broken."""
    if len(packed) < 1 + count + _SEQUENCE_TAIL or packed[0] not in SEQUENCE_HEADS:
        return None
    data, out = np.frombuffer(packed, np.uint8)[1:-_SEQUENCE_TAIL], np.zeros(count, np.uint32)
    return out if _sequence(data, out) == len(data) else None


def unfilter(name: str, plain: np.ndarray) -> np.ndarray:
    """Attributes uint8 [count, stride] with one of the extension's filters undone. name: OCTAHEDRAL (stride 4 or 8), QUATERNION
    (8) or EXPONENTIAL (a multiple of 4)."""
    kind = {"OCTAHEDRAL": _octahedral, "QUATERNION": _quaternion, "EXPONENTIAL": _exponential}[name]
    with np.errstate(all="ignore"):
        return kind(plain)


def _octahedral(plain):
    """Unit vectors from stored x, y and the value of 1 at the stream's number of bits; the fourth component stays."""
    kind = np.int8 if plain.shape[1] == 4 else np.int16
    stored, most = plain.view(kind), np.float32(np.iinfo(kind).max)
    x, y, unit = (stored[:, k].astype(np.float32) for k in range(3))
    z = unit - np.abs(x) - np.abs(y)
    under = np.minimum(z, 0)
    x, y = (v + np.where(v >= 0, under, -under) for v in (x, y))
    length = np.sqrt(x * x + y * y + z * z)
    out = stored.copy()
    for k, value in enumerate((x, y, z)):
        out[:, k] = _rounded(np.where(length > 0, value * (most / length), 0), kind)
    return out.view(np.uint8)


def _quaternion(plain):
    """Unit quaternions from their three smaller components; two bits of the fourth stored value give the missing component."""
    stored = plain.view(np.int16)
    scale = np.float32(np.sqrt(0.5)) / (stored[:, 3].astype(np.int32) | 3).astype(np.float32)
    xyz = stored[:, :3].astype(np.float32) * scale[:, None]
    w = np.sqrt(np.maximum(0, 1 - (xyz * xyz).sum(axis=1, dtype=np.float32)))
    out, rows, first = np.empty_like(stored), np.arange(len(stored)), stored[:, 3] & 3
    for k, value in enumerate((w, *xyz.T)):
        out[rows, (first + k) & 3] = _rounded(value * np.float32(32767), np.int16)
    return out.view(np.uint8)


def _exponential(plain):
    """Floats from a signed mantissa of 24 bits and a signed exponent of 8 bits."""
    stored = plain.view(np.int32)
    return np.ldexp((stored << 8 >> 8).astype(np.float32), stored >> 24).astype(np.float32).view(np.uint8)


def _rounded(values, kind):
    """Values rounded to an integer type, halves away from zero as in the extension's text."""
    limits = np.iinfo(kind)
    return np.trunc(np.clip(np.nan_to_num(values) + np.where(values >= 0, 0.5, -0.5), limits.min, limits.max)).astype(kind)


@kernel
def _attributes(data, last, out, block):
    """Decode blocks of attributes to out, uint8 [count, stride]. data: uint8, bytes of the blocks; last: uint8 [stride],
    predictor of the first vertex; block: vertices in a block. Returns the number of bytes read, or -1."""
    at, count, stride = 0, out.shape[0], out.shape[1]
    for k0 in range(0, count, block):
        size = min(block, count - k0)
        groups = (size + _GROUP - 1) // _GROUP
        for column in range(stride):
            head, at = at, at + (groups + 3) // 4
            if at > data.shape[0]:
                return -1
            before = np.int64(last[column] if k0 == 0 else out[k0 - 1, column])
            for group in range(groups):
                mode = data[head + group // 4] >> 2 * (group % 4) & 3
                width = (0, 2, 4, 8)[mode]
                packed, at = at, at + 2 * width
                if at > data.shape[0]:
                    return -1
                for n in range(_GROUP):
                    value = np.int64(0)
                    if width == 8:
                        value = np.int64(data[packed + n])
                    elif width > 0:
                        bit = n * width
                        value = np.int64(data[packed + bit // 8]) >> 8 - width - bit % 8 & (1 << width) - 1
                        if value == (1 << width) - 1:
                            if at >= data.shape[0]:
                                return -1
                            value, at = np.int64(data[at]), at + 1
                    row = group * _GROUP + n
                    if row < size:
                        before = (before + (value >> 1 ^ -(value & 1))) & 255
                        out[k0 + row, column] = before
    return at


@kernel(allocates=True)
def _varint(data, at, out):
    """Decode a number with 7 bits in each byte, at most five bytes, to out int64 [1]. Returns the position after it, or -1."""
    value = np.int64(0)
    for n in range(5):
        if at >= data.shape[0]:
            return -1
        byte, at = np.int64(data[at]), at + 1
        value |= (byte & 127) << 7 * n
        if byte < 128:
            break
    out[0] = value & 0xFFFFFFFF
    return at


@kernel(allocates=True)
def _sequence(data, out):
    """Decode a sequence of indices to out, uint32 [count]. Returns the number of bytes read, or -1."""
    at, last, value = 0, np.zeros(2, np.int64), np.zeros(1, np.int64)
    for n in range(out.shape[0]):
        at = _varint(data, at, value)
        if at < 0:
            return -1
        which, v = value[0] & 1, value[0] >> 1
        last[which] = (last[which] + (v >> 1 ^ -(v & 1))) & 0xFFFFFFFF
        out[n] = last[which]
    return at


@kernel(allocates=True)
def _triangles(codes, data, table, most, out):
    """Decode triangles to out, uint32 [3 T]. codes: uint8 [T]; data: uint8, bytes that codes refer to; table: uint8 [16]; most:
    number of codes of recent vertices, 13 or 15. Returns the number of bytes read, or -1."""
    edges, vertices = np.zeros((16, 2), np.int64), np.zeros(16, np.int64)
    corner, code, value = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(1, np.int64)
    edge = vertex = following = last = at = 0
    for t in range(codes.shape[0]):
        high, low = codes[t] >> 4, codes[t] & 15
        if high < 15:
            corner[0], corner[1] = edges[edge - 1 - high & 15, 0], edges[edge - 1 - high & 15, 1]
            is_new = low == 0 or low >= most
            if low == 0:
                corner[2], following = following, following + 1
            elif low < most:
                corner[2] = vertices[vertex - 1 - low & 15]
            else:
                if low == 15:
                    at = _varint(data, at, value)
                    if at < 0:
                        return -1
                    last += value[0] >> 1 ^ -(value[0] & 1)
                else:
                    last += 2 * low - 27  # 13 is one back, 14 one on
                corner[2] = last
            vertices[vertex] = corner[2]
            vertex = (vertex + is_new) & 15
        else:
            code[0], aux = 0, table[low]
            if low >= 14:
                if at >= data.shape[0]:
                    return -1
                code[0], aux, at = 0 if low == 14 else 15, data[at], at + 1
                if aux == 0:
                    following = 0
            code[1], code[2] = aux >> 4, aux & 15
            for k in range(3):
                if code[k] == 0:
                    corner[k], following = following, following + 1
                elif code[k] < 15 or low < 14:
                    corner[k] = vertices[vertex - code[k] & 15]
            for k in range(3):
                if low >= 14 and code[k] == 15:
                    at = _varint(data, at, value)
                    if at < 0:
                        return -1
                    last += value[0] >> 1 ^ -(value[0] & 1)
                    corner[k] = last
            for k in range(3):
                vertices[vertex] = corner[k]
                vertex = (vertex + (code[k] == 0 or (low >= 14 and code[k] == 15))) & 15
            edges[edge, 0], edges[edge, 1] = corner[1], corner[0]
            edge = (edge + 1) & 15
        edges[edge, 0], edges[edge, 1] = corner[2], corner[1]
        edge = (edge + 1) & 15
        edges[edge, 0], edges[edge, 1] = corner[0], corner[2]
        edge = (edge + 1) & 15
        for k in range(3):
            out[3 * t + k] = corner[k] & 0xFFFFFFFF
    return at
