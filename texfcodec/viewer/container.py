"""Typed arrays and a JSON header as one run of bytes, which the page unpacks (web/data.js).

Magic "TXVW", the header's length as uint32, the header, zeros up to a multiple of 4, the arrays. Everything is little-endian.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from ..core.json_text import json_text

MAGIC = b"TXVW"
TYPES = {"uint8": "u8", "uint16": "u16", "uint32": "u32", "int16": "i16", "float16": "f16", "float32": "f32"}


class Blobs:
    """Collects arrays; what add() returns stands in the header for the array."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._at = 0

    def add(self, array: np.ndarray, differences: bool = False) -> dict[str, Any]:
        """A reference {"at", "type", "shape", "differences"} to a copy of an array of one of TYPES. differences: store an
        unsigned array's differences from row to row, or those of the patterns of binary16, folded so that small ones of either
        sign have small numbers, byte by byte: it is shorter once it is deflated."""
        array = np.ascontiguousarray(array)
        patterns = array.view(np.uint16) if array.dtype == np.float16 else array
        data = _differences(patterns) if differences else patterns.astype(patterns.dtype.newbyteorder("<"), copy=False).tobytes()
        told = {"at": self._at, "type": TYPES[array.dtype.name], "shape": list(array.shape), "differences": differences}
        padded = data + bytes(-len(data) % 4)
        self._parts.append(padded)
        self._at += len(padded)
        return told

    @property
    def size(self) -> int:
        """Bytes of all arrays."""
        return self._at

    def joined(self, header: dict[str, Any]) -> bytes:
        """The container."""
        text = json_text(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        return b"".join([MAGIC, struct.pack("<I", len(text)), text, *self._parts])


def _differences(array):
    """Rows minus the rows before, modulo the type's range, folded (0, -1, 1, -2, ...), the low bytes of all first."""
    rows = array.reshape(len(array), int(np.prod(array.shape[1:])))
    steps = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), rows.dtype))
    sign = steps >> (8 * array.itemsize - 1)
    folded = (steps << 1) ^ (np.zeros_like(steps) - sign)
    planes = np.ascontiguousarray(folded.T.reshape(-1)).astype(folded.dtype.newbyteorder("<")).view(np.uint8)
    return np.ascontiguousarray(planes.reshape(-1, array.itemsize).T).tobytes()


def parse(container: bytes) -> tuple[dict[str, Any], memoryview]:
    """(header, arrays) of a container. Raises ValueError where it is none."""
    if len(container) < 8 or container[:4] != MAGIC:
        raise ValueError("this is not a container of texf-view")
    length = struct.unpack_from("<I", container, 4)[0]
    return json.loads(container[8 : 8 + length]), memoryview(container)[8 + length :]
