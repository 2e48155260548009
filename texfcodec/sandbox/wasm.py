"""Decoding in a WebAssembly sandbox: the C++ decoder of native/, with capped memory and time, no child and no kernels to compile.

This process reads clauses 4 and 5 itself, in Python alone; Draco, supports and values (steps 6 and 7 of 9.2) are the sandbox's.
What it answers is checked as what a child answers is.
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

from ..bitstream.syntax import SUPPORT_TEXELS
from ..decoder import add_planes, appearance_of
from ..errors import LimitError, StreamError, TexfError
from ..field.texels import TexelSupport
from ..field.voxels import VoxelSupport
from ..geometry.geometry_unit import GeometryUnit
from ..texf import Field
from .isolate import answer_is_sound

if TYPE_CHECKING:
    from ..bitstream.stream import Stream
    from ..limits import Limits
    from ..options import DecodeOptions
    from ..report import Report
    from ..texf import Texf

MODULE = Path(__file__).with_name("texf.wasm")
POSITIONS, UVS, FACES, KEYS, VALUES, SHARP_EDGES, CODED_NORMALS = 2, 3, 4, 6, 7, 8, 9  # texf_array_kind of native/texf.h
LIMIT = 6  # the code of a refusal
KNOWN = (0, 2)  # codec_id of those that it has
LIMITS = ("file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes")
# How the sandbox's sentences begin, and the findings that say the same.
_FINDINGS = {
    "draco_data does not decode": "TXF-S22", "draco_data does not begin": "TXF-S20", "draco_data has a traversal": "TXF-S20",
    "the attributes of draco_data": "TXF-S20",
    "draco_data names": "TXF-S21", "draco_data decodes to": "TXF-S21", "draco_data has a": "TXF-S23", "a position": "TXF-S23",
    "a UV": "TXF-S23", "geometry_crc": "TXF-S24", "num_": "TXF-S30", "keys_crc": "TXF-S30", "a slice begins": "TXF-S12",
    "values_crc": "TXF-S32", "marks_crc": "TXF-S32", "normals_crc": "TXF-S32", "colour_transform": "TXF-S04",
    "samples": "TXF-L05", "touched voxels": "TXF-L04",
}


def can_decode(stream: Stream) -> bool:
    """Whether the sandbox has the stream's codecs: no private ones, and none that answers points."""
    return stream.joint is None and all(values["codec_id"] in KNOWN for values in stream.attributes)


def is_here() -> bool:
    """Whether wasmtime is installed; there are systems that it is not made for."""
    return importlib.util.find_spec("wasmtime") is not None


def decode_in_wasm(data: bytes, stream: Stream, options: DecodeOptions, report: Report) -> Texf:
    """As decode(), in a sandbox; with options.isolate it is capped by limits.isolate_bytes and limits.isolate_seconds.

    data: bytes; stream: what read_stream() makes of them. Raises what decode() raises, and TXF-S40, TXF-L07, TXF-L08.
    """
    limits = options.limits if options.isolate else replace(options.limits, isolate_bytes=None, isolate_seconds=None)
    with report.stage("sandbox"):
        sandbox = Sandbox(limits)
        sandbox.decode(data, options.lod)
    with report.stage("check"):
        return _texf(stream, sandbox, options, report)


class Sandbox:
    """An instance of the module, for one stream."""

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
        """Raises StreamError or LimitError."""
        values = [getattr(self.limits, name) or 0 for name in LIMITS]
        self.memory.write(self.store, struct.pack(f"<{len(values)}Q", *values), self._call("limits"))
        place = self._call("allocate", len(data) or 1)
        if place == 0:
            raise self._no_memory()
        self.memory.write(self.store, data, place)
        self._call("decode", place, len(data), lod)

    def array(self, kind: int, i: int = 0, j: int = 0, dtype: str = "u1") -> np.ndarray:
        """A copy of an array of native/texf.h, one-dimensional."""
        place, count = self._call("array", kind, i, j) & 0xFFFFFFFF, self._call("array_bytes") & 0xFFFFFFFF
        return np.frombuffer(bytes(self.memory.read(self.store, place, place + count)) if place else b"", dtype)

    def _no_variables(self, *places):
        for place in places:
            self.memory.write(self.store, bytes(4), place)
        return 0

    def _call(self, name, *arguments):
        """Calls an export; a stop of the program is the error that it says. A thread does the work, so that an interrupt can stop
        it."""
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
        code, place = self.exports["refusal_code"](self.store), self.exports["refusal_sentence"](self.store)
        if code == 0:
            return self._no_memory()
        said = bytes(self.memory.read(self.store, place, place + 256)).split(b"\0")[0].decode("utf-8", "replace")
        found = next((finding for start, finding in _FINDINGS.items() if said.startswith(start)), "TXF-S40")
        return (LimitError if code == LIMIT else StreamError)(found, said)


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
    """The module for this machine, half a second's work, once in a process."""
    import wasmtime

    return bytes(wasmtime.Module(_engine(), MODULE.read_bytes()).serialize())


def _texf(stream, sandbox, options, report):
    """The Texf of what the sandbox answers, every index checked."""
    texf = appearance_of(stream, options, report)
    try:
        for i, values in enumerate(stream.geometry):
            textured = values["Support"] == SUPPORT_TEXELS
            texf.units.append(GeometryUnit(
                values["field_index"], values["material_index"],
                sandbox.array(POSITIONS, i, dtype="<u4").astype(np.int64).reshape(-1, 3),
                sandbox.array(FACES, i, dtype="<u4").astype(np.int64).reshape(-1, 3),
                sandbox.array(UVS, i, dtype="<i4").astype(np.int64).reshape(-1, 2) if textured else None))
        for i, values in enumerate(stream.fields):
            keys = sandbox.array(KEYS, i, dtype="<i8").copy()
            texf.fields.append(Field(_support(values, keys, options.lod), {}))
        for values in stream.attributes:
            group = texf.groups[values["group_index"]]
            plane = sandbox.array(VALUES, values["field_index"], values["group_index"]).reshape(-1, group.components).copy()
            add_planes(texf.fields[values["field_index"]], group, values, plane)
        if stream.sharp_edges:
            texf.sharp_edges = sandbox.array(SHARP_EDGES).astype(bool)
        if stream.coded_normals:
            texf.coded_normals = sandbox.array(CODED_NORMALS, dtype="<i2").astype(np.int16).reshape(-1, 3)
        sound = answer_is_sound(texf, options.limits)
    except TexfError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise StreamError("TXF-S40", "the decoder returned an invalid result", reason=type(error).__name__) from error
    if not sound:
        raise StreamError("TXF-S40", "the decoder returned an index out of range")
    return texf


def _support(values, keys, lod):
    """The support at a level of detail whose keys these are. values: of the field unit."""
    if values["support"] == SUPPORT_TEXELS:
        whole = TexelSupport(keys=keys, width=values["width"], height=values["height"], wrap=(values["wrap_s"], values["wrap_t"]),
                             fraction_bits=values["uv_fraction_bits"])
        return replace(whole, level_shift=min(lod, whole.depth))
    support = VoxelSupport(values["resolution"], keys)
    return replace(support, level_shift=min(lod, support.depth))
