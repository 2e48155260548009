"""Reads a .texf file, at most as many bytes as the limit allows."""

from __future__ import annotations

import sys
from os import PathLike
from typing import TYPE_CHECKING, BinaryIO

from ..errors import InputError, LimitError

if TYPE_CHECKING:
    from ..limits import Limits


def read_stream_file(path: str | PathLike, limits: Limits, head: bytes = b"") -> bytes:
    """Read and return the bytes of a .texf file, or of stdin for "-". head: bytes that the caller has already read from stdin,
    with which the result begins. Raises InputError, LimitError."""
    most = -1 if limits.file_bytes is None else max(limits.file_bytes + 1 - len(head), 0)
    try:
        if path == "-":
            data = head + sys.stdin.buffer.read(most)
        else:
            with open(path, "rb") as file:
                data = file.read(most)
    except FileNotFoundError:
        raise InputError("TXF-I01", "the file does not exist", path=str(path)) from None
    except IsADirectoryError:
        raise InputError("TXF-I02", "the path is a directory", path=str(path)) from None
    except (OSError, ValueError) as error:
        raise InputError("TXF-I03", "the file cannot be read", path=str(path), reason=str(error)) from None
    return _within_limit(data, limits)


def read_stream_object(file: BinaryIO, limits: Limits) -> bytes:
    """Read and return the bytes of a .texf stream from a file object open for reading bytes. Raises InputError, LimitError."""
    try:
        data = file.read(-1 if limits.file_bytes is None else limits.file_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: it is closed
        raise InputError("TXF-I03", "the file object cannot be read", reason=str(error)[:200]) from None
    if not isinstance(data, bytes | bytearray | memoryview):
        raise InputError("TXF-I03", "the file object returns text, not bytes; open it with mode 'rb'", value=type(data).__name__)
    return _within_limit(bytes(data), limits)


def _within_limit(data, limits):
    if limits.file_bytes is not None and len(data) > limits.file_bytes:
        raise LimitError("TXF-L01", "the stream is larger than the limit", value=f"> {limits.file_bytes}",
                         allowed=limits.file_bytes)
    return data
