"""Choice of the decoder for a stream: the native library, kernels in this process or a child's, or the WebAssembly sandbox."""

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
    """Decode a stream as api.decode() does, in the engine that options choose: the native library, WebAssembly, or kernels here
    or in a child.

    Raises the errors of the engines, and TXF-U10 if the engine was requested and cannot decode the stream.
    """
    engine = first_engine(options)
    _check_request(options)
    _note_fault(options, report)
    if engine != "numba" or options.isolate:
        from ..bitstream.stream import read_stream
        from .answer import can_decode

        with report.stage("parse"):
            stream = read_stream(bytes(data), options.limits)
        if engine != "numba" and can_decode(stream):
            texf = _decode_in_native_code(engine, bytes(data), stream, options, report)
            if texf is not None:
                return texf
        elif options.engine == engine != "numba":
            raise SupportError("TXF-U10", f"the engine {engine} does not support the codec of this stream; omit --engine")
        if options.isolate:
            from .isolate import decode_isolated

            return decode_isolated(bytes(data), stream, options, report)
    from ..decoder import decode_stream

    return decode_stream(data, options, report)


def first_engine(options: DecodeOptions) -> str:
    """Return the engine to try first: that of options, else "wasm" for options.isolate, "native" if its library can be used,
    "wasm" as long as the kernels are not compiled, "numba"."""
    from . import native, wasm

    if options.engine != "auto":
        return options.engine
    if native.is_here() and not options.isolate:
        return "native"
    return "wasm" if wasm.is_here() and (options.isolate or not kernels_compiled()) else "numba"


def _check_request(options):
    """Raises TXF-U10 if the requested engine cannot be used."""
    from . import native, wasm

    if options.engine == "wasm" and not wasm.is_here():
        raise SupportError("TXF-U10", "the sandbox requires wasmtime, which is not installed: run pip install wasmtime")
    if options.engine == "native" and options.isolate:
        raise SupportError("TXF-U10", "the native library runs without isolation; omit --engine or --isolate")
    if options.engine == "native" and not native.is_here():
        raise SupportError("TXF-U10", native.fault() or "there is no native library: run make native in a clone")


def _note_fault(options, report):
    """Adds a remark on a native library that is there and cannot be used."""
    from .native import fault

    if options.engine == "auto" and not options.isolate and fault():
        report.remarks.append(f"{fault()}; another engine decodes")


def _decode_in_native_code(engine, data, stream, options, report):
    """The Texf; None if auto leaves a stream that needs too much memory for the sandbox to another engine."""
    from .native import decode_natively
    from .wasm import decode_in_wasm

    if engine == "native":
        return decode_natively(data, stream, options, report)
    try:
        return decode_in_wasm(data, stream, options, report)
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
