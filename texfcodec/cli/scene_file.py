"""glTF scenes whose meshes are coded in streams, for texf-enc and texf-dec."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..api import encode_loaded, expand
from ..core.colour_error import in_decibels
from ..core.json_text import json_ready
from ..io.container.layout import streams_of
from ..io.gltf.document import open_document
from ..io.load import read_source
from ..io.opened import opened, recording
from ..io.parts import Notes
from ..report import plural
from .console import Console, check_output, run_facts, timing_line, write_output
from .effect_lines import losses_in_words
from .stream_facts import stream_facts

if TYPE_CHECKING:
    from ..options import DecodeOptions, EncodeOptions


def encode_scene_file(console: Console, source: str, out: str, options: EncodeOptions) -> None:
    """Code the meshes of a glTF file, write a GLB, and print the result."""
    from ..encoder.container.encode import encode_document

    with console.progress() as report, recording() as files:
        data, folder = read_source(source)
        opened(Path(source))
        encoded = encode_document(data, folder, options, report, encode_loaded)
        check_output(out, files)
        write_output(out, encoded.data, files)
    if not console.as_json:
        console.warnings(report)
    sizes = {"total": len(encoded.data), **encoded.sizes}
    streams = [json_ready(stream_facts(stream, options)) for stream in encoded.streams]
    source_bytes = sum(files.values())
    facts = {"bytes": sizes, "source": {"bytes": source_bytes, "files": len(files), "names": list(files)},
             "ratio": round(source_bytes / len(encoded.data), 3), "streams": streams, **run_facts(report)}
    console.result(facts, _lines(facts, out))


def _lines(facts: dict[str, Any], out: str) -> Iterator[str]:
    sizes, source = facts["bytes"], facts["source"]
    streams = plural(len(facts["streams"]), "stream", "streams")
    yield f"{out}: {sizes['total']} bytes; {streams} {sizes['streams']}, everything else {sizes['other']}{losses_in_words(facts)}"
    files = "" if source["files"] == 1 else f" in {source['files']} files"
    yield f"source: {source['bytes']} bytes{files}, {facts['ratio']:.3g} times the file"
    for number, stream in enumerate(facts["streams"]):
        checked = stream["check"]
        y = f", checked: Y {in_decibels(checked['y'])}" if checked and checked["visible"] else ""
        yield f"stream {number}: {stream['bytes']['total']} bytes, {plural(stream['faces'], 'face', 'faces')}{y}"
    yield timing_line(facts["seconds"], facts["peak_memory_bytes"])


def expand_scene_file(console: Console, data: bytes, source: str, out: str, options: DecodeOptions, texture_format: str) -> None:
    """Decode the streams of a glTF file, write an ordinary GLB, and print the result."""
    with console.progress() as report:
        glb = expand(data, options, report, texture_format)
        write_output(out, glb, [] if source == "-" else [source])
    if not console.as_json:
        console.warnings(report)
    facts = {"bytes": {"total": len(data)}, "files": [Path(out).name], "written": len(glb), **run_facts(report)}
    console.result(facts, _expanded_lines(facts, out))


def add_fallbacks_to_file(console: Console, data: bytes, paths: tuple[str, str], options: DecodeOptions,
                          wanted: tuple[str, int | None]) -> None:
    """Write a coded glTF file with a fallback beside each coded primitive, and print the result. paths: source, which may be "-",
    and out; wanted: format of images, and most faces."""
    from ..encoder.container.fallback import with_fallbacks
    from ..sandbox.engines import decode_by_engine

    (source, out), (texture_format, faces) = paths, wanted
    with console.progress() as report:
        document = open_document(data, Path(), Notes())
        glb = with_fallbacks(document, lambda stream: decode_by_engine(stream, options, report), report, faces, texture_format)
        write_output(out, glb, [] if source == "-" else [source])
    if not console.as_json:
        console.warnings(report)
    streams = sum(map(len, streams_of(document)))
    facts = {"bytes": {"total": len(data)}, "files": [Path(out).name], "written": len(glb),
             "carried": {"stream": streams, "fallback": len(glb) - len(data)}, **run_facts(report)}
    console.result(facts, _carried_lines(facts, out))


def _carried_lines(facts: dict[str, Any], out: str) -> Iterator[str]:
    carried = facts["carried"]
    yield f"{out}: {facts['written']} bytes, with streams ({carried['stream']} bytes) and fallbacks ({carried['fallback']} bytes)"
    yield timing_line(facts["seconds"], facts["peak_memory_bytes"])


def _expanded_lines(facts: dict[str, Any], out: str) -> Iterator[str]:
    yield f"{out}: {facts['written']} bytes from {facts['bytes']['total']}; an ordinary glTF"
    yield timing_line(facts["seconds"], facts["peak_memory_bytes"])
