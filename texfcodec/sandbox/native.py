"""Decoding in the native library: the C++ decoder of native/ in this process, without kernels to compile.

`make native` and the wheels of some platforms put the library beside this file. It runs unconfined, so --isolate never takes it.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..options import default_threads
from .answer import LIMITS, REFUSAL, error_of, texf_of

if TYPE_CHECKING:
    from ..bitstream.stream import Stream
    from ..options import DecodeOptions
    from ..report import Report, Step
    from ..texf import Texf

LIBRARY = Path(__file__).with_name({"win32": "texf.dll", "darwin": "libtexf.dylib"}.get(sys.platform, "libtexf.so"))
INTERFACE = 1  # TEXF_INTERFACE of native/texf.h
STOPPED, NO_MEMORY = 130, 607  # TEXF_STOPPED; the finding TXF-L07
WAIT_SECONDS = 0.1  # between looks at the progress callback, and as long for a stopped decode to free its memory
_POINTER, _NUMBER, _SIZE = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_size_t
_SIGNATURES = {  # of native/texf.h: result, arguments
    "texf_set_stop": (None, (_POINTER,)),
    "texf_array": (_POINTER, (_POINTER, ctypes.c_int, _NUMBER, _NUMBER, _POINTER)),
    "texf_free": (None, (_POINTER,)),
    "texf_decode_threads": (ctypes.c_int, (ctypes.c_char_p, _SIZE, ctypes.c_int, _POINTER, ctypes.c_int, _POINTER, _POINTER)),
}


@lru_cache(maxsize=4)
def library(path: Path) -> ctypes.CDLL | str | None:
    """Load the native library. Return it, a sentence if it cannot be used, or None if there is none at the path."""
    if not path.exists():
        return None
    try:
        loaded = ctypes.CDLL(str(path))
        version = loaded.texf_version()
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(loaded, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:  # of another architecture, or cut short; without a function
        return f"the native library cannot be used: {str(error).replace(str(path), path.name)}"
    if version != INTERFACE:
        return f"the native library has version {version} of its interface instead of {INTERFACE}: run make native"
    return loaded


def is_here() -> bool:
    """Return whether the native library can be used."""
    return isinstance(library(LIBRARY), ctypes.CDLL)


def fault() -> str | None:
    """Return why the native library, which is there, cannot be used; None if it can, or if there is none."""
    loaded = library(LIBRARY)
    return loaded if isinstance(loaded, str) else None


def decode_natively(data: bytes, stream: Stream, options: DecodeOptions, report: Report) -> Texf:
    """Decode in the native library and return the Texf.

    data: the stream; stream: the same, parsed by read_stream(). Raises the errors of decode(), and MemoryError.
    """
    with report.stage("native") as step:
        decoded = NativeAnswer(library(LIBRARY))
        decoded.decode(data, options, step)
        return texf_of(stream, decoded, options, report, confined=False)


class NativeAnswer:
    """An Answer of the native library, loaded by library(). It frees its arrays when the last thread drops it."""

    def __init__(self, loaded: Any) -> None:  # a CDLL, or a stand-in of a test
        self.library, self.asset = loaded, _POINTER()
        self.stop, self.refusal = ctypes.c_int32(0), ctypes.create_string_buffer(REFUSAL.size)

    def __del__(self) -> None:
        if self.asset:
            self.library.texf_free(self.asset)

    def decode(self, data: bytes, options: DecodeOptions, step: Step) -> None:
        """Decode a stream; array() then gives its arrays. A thread does the work, so that an interrupt can stop it.

        step: called while it works; its error stops the work. Raises StreamError, LimitError, SupportError, MemoryError.
        """
        status: list[int] = []
        thread = threading.Thread(target=lambda: status.append(self._work(data, options)), daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                thread.join(WAIT_SECONDS)
                step(0, 1)
        except BaseException:
            self.stop.value = 1
            thread.join(WAIT_SECONDS)
            raise
        if status != [0]:
            raise self._error()

    def _work(self, data, options):
        limits = (ctypes.c_uint64 * len(LIMITS))(*(getattr(options.limits, name) or 0 for name in LIMITS))
        where = ctypes.byref(self.asset), self.refusal
        self.library.texf_set_stop(ctypes.byref(self.stop))
        threads = options.threads or default_threads()
        return self.library.texf_decode_threads(data, len(data), options.lod, limits, threads, *where)

    def _error(self):
        if REFUSAL.unpack(self.refusal.raw)[0] == NO_MEMORY:
            return MemoryError("the native library ran out of memory")
        return error_of(self.refusal.raw) or RuntimeError("the native library gave no answer")

    def array(self, kind: int, i: int = 0, j: int = 0, dtype: str = "u1") -> np.ndarray:
        """Return a copy of a decoded array; arguments as of Answer.array()."""
        count = _SIZE()
        place = self.library.texf_array(self.asset, kind, i, j, ctypes.byref(count))
        held: Any = (ctypes.c_char * count.value).from_address(place) if place else b""
        return np.frombuffer(held, dtype).copy()
