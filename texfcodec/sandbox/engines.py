"""Choice of the decoder for a stream: kernels in this process or a child's, or the WebAssembly sandbox."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ..codecs import codec_of
from ..core.kernel import PACKAGE, cache_folder
from ..errors import LimitError, SupportError
from ..options import DEFAULT_CODEC

if TYPE_CHECKING:
    from ..options import DecodeOptions
    from ..report import Report
    from ..texf import Texf

ENTRIES = ("field/voxelise.py", *codec_of(DEFAULT_CODEC).kernels)  # every usual encode and decode enters kernels of these


def decode_by_engine(data: bytes, options: DecodeOptions, report: Report) -> Texf:
    """Decode a stream as api.decode() does, in the engine that options choose: kernels here or in a child, or WebAssembly.

    Raises the errors of the engines, and TXF-U10 if the sandbox was requested and cannot decode the stream.
    """
    requested, sandboxed = options.engine == "wasm", takes_sandbox(options)
    if requested and not sandboxed:
        raise SupportError("TXF-U10", "the sandbox requires wasmtime, which is not installed: run pip install wasmtime")
    if sandboxed or options.isolate:
        from ..bitstream.stream import read_stream
        from .wasm import can_decode

        with report.stage("parse"):
            stream = read_stream(bytes(data), options.limits)
        if sandboxed and can_decode(stream):
            texf = _decode_in_sandbox(data, stream, options, report)
            if texf is not None:
                return texf
        elif requested:
            raise SupportError("TXF-U10", "the sandbox does not support the codec of this stream; omit --engine")
        if options.isolate:
            from .isolate import decode_isolated

            return decode_isolated(bytes(data), stream, options, report)
    from ..decoder import decode_stream

    return decode_stream(data, options, report)


def takes_sandbox(options: DecodeOptions) -> bool:
    """Return whether to try the WebAssembly sandbox first: with engine "wasm", and with "auto" if options.isolate is set or the
    kernels are not compiled yet."""
    from .wasm import is_here

    return is_here() and (options.engine == "wasm" or (options.engine == "auto" and (options.isolate or not kernels_compiled())))


def _decode_in_sandbox(data, stream, options, report):
    """The Texf; None if auto leaves a stream that needs too much memory to another engine."""
    from .wasm import decode_in_wasm

    try:
        return decode_in_wasm(bytes(data), stream, options, report)
    except LimitError as error:
        if options.engine == "wasm" or options.isolate or error.code != "TXF-L07":
            raise
        return None  # more than the 4 GiB that a module has at most, and no cap was requested


def kernels_compiled(entries: tuple[str, ...] = ENTRIES) -> bool:
    """Return whether the cache holds compiled kernels of all these files, for the current package and interpreter.

    entries: files relative to the package. Without the JIT, as in tests and for coverage, there is nothing to compile: True.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return True
    tag = f"py{sys.version_info.major}{sys.version_info.minor}"
    try:
        return all(any(cache_folder(PACKAGE / entry).glob(f"*/{Path(entry).stem}.*.{tag}*.nbi")) for entry in entries)
    except OSError:  # a cache that cannot be listed has nothing to give
        return False
