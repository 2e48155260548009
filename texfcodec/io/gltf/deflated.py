"""bufferViews that are stored deflated: TEXF_stream at a bufferView, docs/guide/TEXF_stream.md.

Rows of values change little from one to the next, so that the differences of their bytes, byte after byte of all rows, deflate to
less than the rows themselves.
"""

from __future__ import annotations

import zlib

import numpy as np

from ...errors import InputError, LimitError
from .properties import integer

MOST_BYTES = 1 << 30  # of all views of a file


def enc_view(data: bytes, row: int) -> bytes:
    """Deflate a bufferView.

    Parameters
    ----------
    data : bytes
        A multiple of `row` bytes.
    row : int
        Bytes of a row.

    Returns
    -------
    bytes
        zlib data.
    """
    rows = np.frombuffer(data, np.uint8).reshape(-1, row)
    return zlib.compress(np.diff(rows, axis=0, prepend=np.zeros((1, row), np.uint8)).T.tobytes(), 9)


def dec_view(packed: bytes | memoryview, entry: dict, view: dict, number: int, spent: int = 0) -> bytes:
    """Inflate a bufferView.

    Parameters
    ----------
    packed : bytes-like
        zlib data.
    entry, view : dict
        The extension's object, whose "row" is the bytes of a row, and the bufferView, whose byteLength is that of the result.
    number : int
        Of the bufferView.
    spent : int
        Bytes that other views of the file were inflated to.

    Returns
    -------
    bytes
        The view.

    Raises
    ------
    InputError
        TXF-I11 if the data is no zlib data of that length, TXF-I09 for other faults.
    LimitError
        TXF-I41 if all views have more than MOST_BYTES.
    """
    length, row = integer(view, "byteLength", low=1), integer(entry, "row", low=1)
    if length > MOST_BYTES - spent:
        raise LimitError("TXF-I41", f"bufferView {number} is too large", value=length, allowed=MOST_BYTES - spent)
    inflater = zlib.decompressobj()
    try:
        planes = inflater.decompress(bytes(packed), length + 1)
    except zlib.error as error:
        raise InputError("TXF-I11", f"bufferView {number} cannot be inflated", reason=str(error)[:100]) from None
    if len(planes) != length or length % row or not inflater.eof or inflater.unused_data:
        raise InputError("TXF-I11", f"bufferView {number} inflates to another length", value=len(planes), allowed=length)
    steps = np.frombuffer(planes, np.uint8).reshape(row, -1).T
    return np.cumsum(steps, axis=0, dtype=np.uint8).tobytes()
