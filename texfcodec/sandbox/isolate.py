"""Decoding in a child process with capped memory and time: for joint and private codecs, and for systems without wasmtime.

The parent never runs Draco or a kernel on the stream. The child's answer is arrays without pickles and JSON.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import errors
from ..errors import StreamError, TexfError
from ..limits import Limits
from ..options import DecodeOptions
from ..report import Report, peak_memory_bytes
from .answer import CODED_NORMALS, FACES, KEYS, POSITIONS, SHARP_EDGES, UVS, VALUES, texf_of
from .limited_process import FACTS, NO_CAP, child_folder, crash_of, read_facts, run_child, within_cap

if TYPE_CHECKING:
    from ..bitstream.stream import Stream
    from ..texf import Texf

ANSWER = "answer.npz"


def decode_isolated(data: bytes, stream: Stream, options: DecodeOptions, report: Report) -> Texf:
    """Decode in a child process and return the Texf. limits.isolate_bytes (of address space beyond the idle decoder's) and
    limits.isolate_seconds cap it.

    data: the stream; stream: the same, parsed by read_stream(); report: gets the child's seconds and peak memory, and a warning
    if the system has no cap on memory. Raises the errors of decode(), and TXF-S40, TXF-L07, TXF-L08, TXF-L15.
    """
    with child_folder() as folder, report.stage("isolate"):
        facts, arrays = _run_child(data, options, folder)
    report.warnings += [NO_CAP] * (not facts["capped"])
    report.seconds |= {f"child {name}": value for name, value in facts["seconds"].items()}
    report.child_peak_memory_bytes = facts["peak_memory_bytes"]
    return texf_of(stream, ChildAnswer(arrays), options, report, (facts["packed"], arrays))


class ChildAnswer:
    """The Answer of a child process. arrays: one-dimensional or not, by _name() of kind, i and j."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.arrays = arrays

    def array(self, kind: int, i: int = 0, j: int = 0, dtype: str = "u1") -> np.ndarray:
        """Return the array of a kind that the child has left, one-dimensional; arguments and errors as of Answer.array()."""
        values = self.arrays.get(_name(kind, i, j), np.zeros(0, dtype))
        if values.dtype != dtype:
            raise ValueError("kind of numbers")
        return np.ascontiguousarray(values).reshape(-1)


def _name(kind, i=0, j=0):
    return f"{kind} {i} {j}"


def _run_child(data, options, folder):
    """Starts the child, waits, and returns its answer (facts, arrays), or raises its error."""
    child = run_child("texfcodec.sandbox.isolate", data, asdict(options), options.limits, folder)
    try:
        facts = read_facts(folder)
        if "error" in facts:
            raise _error_of(facts["error"])
        with np.load(folder / ANSWER, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return {"capped": bool(facts["capped"]), "seconds": {str(k): float(v) for k, v in facts["seconds"].items()},
                "peak_memory_bytes": int(facts["peak_memory_bytes"]), "packed": dict(facts["packed"])}, arrays
    except TexfError:
        raise
    except Exception as error:  # no answer, or one that a broken child made up
        raise crash_of(child, options.limits) from error


def _error_of(facts):
    """The child's own error, in the class it names."""
    family = {name: getattr(errors, name) for name in ("InputError", "StreamError", "LimitError", "SupportError")}
    details = {str(k): v for k, v in facts["details"].items()}
    return family.get(facts["family"], StreamError)(str(facts["code"]), str(facts["message"]), **details)


def _child(folder, request):
    """The child's side: decodes stdin and leaves its answer in the folder."""
    from ..decoder import decode_stream

    limits = Limits(**request.pop("limits"))
    request["isolate"] = False
    data, report = sys.stdin.buffer.read(), Report()

    def decoded():
        packed, arrays = packed_answer(decode_stream(data, DecodeOptions(**request, limits=limits), report))
        np.savez(folder / ANSWER, **arrays)
        return packed

    try:
        packed, capped = within_cap(limits, decoded)
        facts = {"packed": packed, "capped": capped, "seconds": report.seconds, "peak_memory_bytes": peak_memory_bytes()}
    except TexfError as error:
        facts = {"error": {"family": type(error).__name__, "code": error.code, "message": error.message,
                           "details": error.details}}
    (folder / FACTS).write_text(json.dumps(facts), encoding="utf-8")


def packed_answer(texf: Texf) -> tuple[dict, dict]:
    """Return (facts, arrays by name) of a decoded Texf, from which texf_of() rebuilds it. facts: of a joint codec's pack()."""
    arrays: dict = {}
    for i, unit in enumerate(texf.units):
        arrays |= {_name(POSITIONS, i): unit.lattice.astype("<u4"), _name(FACES, i): unit.faces.astype("<u4")}
        if unit.uv is not None:
            arrays[_name(UVS, i)] = unit.uv.astype("<i4")
    for i, part in enumerate(texf.fields):
        arrays[_name(KEYS, i)] = part.keys.astype("<i8")
        arrays |= {_name(VALUES, i, j): group.join(part.planes) for j, group in enumerate(texf.groups)
                   if group.channels[0].name in part.planes}
    if texf.sharp_edges is not None:
        arrays[_name(SHARP_EDGES)] = texf.sharp_edges.astype("u1")
    if texf.coded_normals is not None:
        arrays[_name(CODED_NORMALS)] = texf.coded_normals.astype("<i2")
    if not texf.evaluators:
        return {}, arrays
    assert texf.codec is not None
    packed, others = texf.codec.pack(texf.evaluators)
    return packed, arrays | others


if __name__ == "__main__":
    _child(Path(sys.argv[1]), json.loads(sys.argv[2]))
