"""Decoding in a WebAssembly sandbox: the C++ decoder of native/, with capped memory and time, without a child or kernels to
compile.

The sandbox decodes Draco, supports and values (steps 6 and 7 of 9.2); answer.py checks its arrays.
"""

from __future__ import annotations

import importlib.util
import struct
import threading
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import LimitError
from .answer import LIMITS, REFUSAL, error_of, texf_of

if TYPE_CHECKING:
    from ..bitstream.stream import Stream
    from ..limits import Limits
    from ..options import DecodeOptions
    from ..report import Report
    from ..texf import Texf

MODULE = Path(__file__).with_name("texf_simd.wasm")


def is_here() -> bool:
    """Return whether wasmtime is installed; it is not available for all systems."""
    return importlib.util.find_spec("wasmtime") is not None


def decode_in_wasm(data: bytes, stream: Stream, options: DecodeOptions, report: Report) -> Texf:
    """Decode in a WebAssembly sandbox and return the Texf. options.isolate caps it by limits.isolate_bytes and isolate_seconds.

    data: the stream; stream: the same, parsed by read_stream(). Raises the errors of decode(), and TXF-S40, TXF-L07, TXF-L08.
    """
    limits = options.limits if options.isolate else replace(options.limits, isolate_bytes=None, isolate_seconds=None)
    with report.stage("sandbox"):
        sandbox = Sandbox(limits)
        sandbox.decode(data, options.lod)
    with report.stage("check"):
        return texf_of(stream, sandbox, options, report)


class Sandbox:
    """An instance of the WebAssembly module, which decodes one stream; an Answer. limits: of the stream, its memory and time."""

    def __init__(self, limits: Limits) -> None:
        import wasmtime

        self.limits, self.engine = limits, _engine()  # of its own, so that what stops it stops no other
        module = wasmtime.Module.deserialize(self.engine, _compiled())
        self.store = wasmtime.Store(self.engine)
        self.store.set_limits(memory_size=limits.isolate_bytes or -1)
        self.store.set_epoch_deadline(1)
        i32 = wasmtime.ValType.i32()
        linker = wasmtime.Linker(self.engine)
        for name, count, work in (("fd_close", 1, _missing), ("fd_write", 4, _missing), ("environ_get", 2, _nothing),
                                  ("environ_sizes_get", 2, self._no_variables)):
            linker.define_func("wasi_snapshot_preview1", name, wasmtime.FuncType([i32] * count, [i32]), work)
        seek = [i32, wasmtime.ValType.i64(), i32, i32]
        linker.define_func("wasi_snapshot_preview1", "fd_seek", wasmtime.FuncType(seek, [i32]), _missing)
        linker.define_func("wasi_snapshot_preview1", "proc_exit", wasmtime.FuncType([i32], []), _nothing)
        try:
            self.exports: Any = linker.instantiate(self.store, module).exports(self.store)
        except wasmtime.WasmtimeError:  # not even its own first pages
            raise self._no_memory() from None
        self.memory: Any = self.exports["memory"]
        self._call("_initialize")

    def decode(self, data: bytes, lod: int) -> None:
        """Decode a stream; array() then gives its arrays. lod: levels to omit. Raises StreamError, LimitError, SupportError."""
        values = [getattr(self.limits, name) or 0 for name in LIMITS]
        self.memory.write(self.store, struct.pack(f"<{len(values)}Q", *values), self._call("limits"))
        place = self._call("allocate", len(data) or 1)
        if place == 0:
            raise self._no_memory()
        self.memory.write(self.store, data, place)
        self._call("decode", place, len(data), lod)

    def array(self, kind: int, i: int = 0, j: int = 0, dtype: str = "u1") -> np.ndarray:
        """Return a copy of a decoded array, read from the module's memory; arguments as of Answer.array()."""
        place, count = self._call("array", kind, i, j) & 0xFFFFFFFF, self._call("array_bytes") & 0xFFFFFFFF
        return np.frombuffer(self.memory.read(self.store, place, place + count) if place else bytearray(), dtype)

    def _no_variables(self, *places):
        for place in places:
            self.memory.write(self.store, bytes(4), place)
        return 0

    def _call(self, name, *arguments):
        """Calls an export and raises its error if the program stops. A thread does the work, so that an interrupt can stop it."""
        import wasmtime

        def work():
            try:
                done.append(self.exports[name](self.store, *arguments))
            except (wasmtime.Trap, wasmtime.WasmtimeError) as error:
                stopped.append(error)

        done: list = []
        stopped: list = []
        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        end = time.monotonic() + (self.limits.isolate_seconds or float("inf"))
        try:
            while thread.is_alive():
                thread.join(0.1)
                if time.monotonic() > end:
                    self.engine.increment_epoch()
        except BaseException:
            self.engine.increment_epoch()
            thread.join()
            raise
        if stopped:
            raise self._error(stopped[0])
        return done[0]

    def _no_memory(self):
        return LimitError("TXF-L07", "decoding needs more memory than the limit allows", allowed=self.limits.isolate_bytes)

    def _error(self, error):
        import wasmtime

        if getattr(error, "trap_code", None) == wasmtime.TrapCode.INTERRUPT:
            return LimitError("TXF-L08", "decoding took longer than the limit allows", allowed=self.limits.isolate_seconds)
        self.store.set_epoch_deadline(1 << 30)  # what is left to ask takes no time
        place = self.exports["refusal"](self.store)
        refusal = self.memory.read(self.store, place, place + REFUSAL.size)
        return error_of(bytes(refusal)) or self._no_memory()  # it may have stopped without a refusal


def _missing(*_):
    return 52  # no such function, as WASI says it


def _nothing(*_):
    return 0


def _engine():
    import wasmtime

    config = wasmtime.Config()
    config.epoch_interruption = True
    return wasmtime.Engine(config)


@lru_cache(maxsize=1)
def _compiled():
    """The module compiled for this machine, which takes half a second, once in a process."""
    import wasmtime

    return bytes(wasmtime.Module(_engine(), MODULE.read_bytes()).serialize())
