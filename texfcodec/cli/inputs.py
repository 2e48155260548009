"""Inputs of the tools: a mesh file, a stream, or "-" for stdin, whose first bytes decide its kind."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from ..api import decode
from ..bitstream.file import read_stream_file
from ..errors import InputError, SupportError, TexfError
from ..limits import Limits
from ..options import DecodeOptions
from ..report import Report, plural

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..texf import Texf
    from .console import Console

_GLB_MAGIC, _STREAM_MAGIC = b"glTF", b"\x89TXF"
CARRIED = "{}: the carried stream is read instead of its fallback"


def check_stdin_once(*paths: str | None) -> None:
    """Raise click.UsageError if more than one input path is "-". paths: those of the command line, None for an absent one."""
    if paths.count("-") > 1:
        raise click.UsageError("only one input may be - (stdin)")


def read_stream(path: str, limits: Limits) -> bytes:
    """Return the bytes of a .texf stream from a file, or from stdin for "-". A GLB that carries a stream gives that stream.

    Raises the errors of read_stream_file(), and TXF-I26 for a GLB without a stream.
    """
    from ..io.gltf.carried import stream_within

    return stream_within(read_stream_file(path, limits))


def read_streams(path: str, limits: Limits) -> list[bytes]:
    """The streams of a scene file of texf-enc, in order; of any other file, its only one, as read_stream()."""
    from ..io.container.layout import open_scene_file, streams_of
    from ..io.gltf.carried import stream_within

    data = read_stream_file(path, limits)
    document = open_scene_file(data)
    return [stream_within(data)] if document is None else streams_of(document)


def load_mesh(path: str, strict: bool = False, limits: Limits | None = None) -> Scene:
    """Return the Scene of a mesh file, or of a mesh on stdin for "-", which must be a format that needs no second file.

    strict, limits: as of io.load.load(). Raises its errors, and TXF-I05 if the first bytes on stdin belong to no known format.
    """
    from ..io.load import load

    return _stdin_mesh(_stdin(), strict, limits) if path == "-" else load(path, strict, limits)


def open_asset(path: str, is_stream: bool, limits: Limits | None = None) -> bytes | Scene:
    """Return the bytes of a stream or the Scene of a mesh. is_stream: what path names; for "-", stdin, the first bytes say."""
    limits = limits or Limits()
    if path == "-":
        head = _stdin(len(_STREAM_MAGIC))
        if head == _STREAM_MAGIC:
            return read_stream_file(path, limits, head)
        return _stdin_mesh(head + _stdin(), False, limits)
    return read_stream_file(path, limits) if is_stream else load_mesh(path, limits=limits)


def files_of(path: str, scene: Scene | None) -> list[str]:
    """Return the paths that were read for an input and that no output may replace: the files of a Scene, or path alone for a
    stream (scene None). "-" is left out."""
    return [name for name in (scene.files if scene is not None else [path]) if name != "-"]


def _stdin(most=-1):
    try:
        return sys.stdin.buffer.read(most)
    except OSError as error:
        raise InputError("TXF-I03", "the file cannot be read", path="-", reason=str(error)) from None


def _stdin_mesh(data, strict, limits):
    from ..io.load import load

    if not data:
        raise InputError("TXF-I04", "the file is empty", path="-")
    return load(data, strict, limits)


def carried_stream(path: str, limits: Limits) -> bytes | None:
    """Return the bytes of the stream that a GLB carries. None if path is no GLB or if no stream can be extracted."""
    try:
        with open(path, "rb") as file:
            if file.read(len(_GLB_MAGIC)) != _GLB_MAGIC:
                return None
        return read_stream(path, limits)
    except (OSError, ValueError, TexfError):
        return None


def open_carried(path: str, options: DecodeOptions, report: Report) -> Texf | None:
    """Decode the stream that a GLB carries and return its Texf. None if path is no GLB, or if its stream cannot be decoded, an
    error that load_mesh() then reports.

    report: gets seconds, warnings, and a remark that the stream is read instead of the GLB's own mesh.
    """
    data = carried_stream(path, options.limits)
    try:
        texf = None if data is None else _decoded(data, options, report)
    except TexfError:
        return None
    report.remarks += [CARRIED.format(path)] * (texf is not None)
    return texf


def _decoded(data, options, report):
    within = Report()  # its stages are parts of this one
    with report.stage("decode"):
        texf = decode(data, options, within)
    report.warnings += within.warnings
    return texf


def load_asset(path: str, options: DecodeOptions, inputs: list[str], report: Report) -> Scene | Texf:
    """Return the asset at path, to be drawn: the decoded Texf of a stream, or the Scene of a mesh.

    inputs: the names of the files read are appended; report: gets seconds, warnings, and the parts of a mesh that are not read.
    """
    texf = open_carried(path, options, report)
    if texf is not None:
        inputs.append(path)
        return texf
    with report.stage("load"):
        asset = open_asset(path, path.lower().endswith(".texf"), options.limits)
    inputs += files_of(path, None if isinstance(asset, bytes) else asset)
    if isinstance(asset, bytes):
        return _decoded(asset, options, report)
    report.warnings += asset.warnings
    report.dropped += asset.dropped
    return asset


def posed_meshes(path: str, pose: tuple[tuple[float, ...], str | None], limits: Limits, report: Report) -> Iterator[Scene]:
    """Yield the Scenes of a glTF file, or of one on stdin for "-", at times of an animation.

    pose: (times in seconds, animation), as of load_posed(), whose errors are raised; report: gets seconds, warnings, and what is
    not read, each once.
    """
    from ..io.load import load_posed

    scenes = load_posed(_stdin() if path == "-" else path, *pose, limits)
    for _ in pose[0]:
        with report.stage("load"):
            scene = next(scenes)
        report.warnings += [text for text in scene.warnings if text not in report.warnings]
        report.dropped += [name for name in scene.dropped if name not in report.dropped]
        yield scene


def posed_assets(path: str, pose: tuple[tuple[float, ...], str | None], limits: Limits, inputs: list[str],
                 report: Report) -> list[Scene]:
    """Return posed_meshes(), to be drawn. inputs: the names of the files read are appended."""
    scenes = list(posed_meshes(path, pose, limits, report))
    inputs += files_of(path, scenes[0])
    return scenes


def checked_stream(data: bytes, limits: Limits) -> list[str]:
    """Check a stream for the page of texf-view, all but its values, which the page decodes itself; return the warnings.

    Raises the errors of decode() for clauses 4 and 5, and TXF-U11 for plug-in codecs.
    """
    from ..bitstream.stream import read_stream
    from ..codecs.base import PRIVATE_IDS
    from ..decoder import appearance_of

    report, stream = Report(), read_stream(data, limits)
    appearance_of(stream, DecodeOptions(limits=limits), report)
    if any(values["codec_id"] in PRIVATE_IDS for values in stream.attributes):
        raise SupportError("TXF-U11", "the page does not support plug-in codecs; convert the stream to a GLB with texf-dec")
    return report.warnings


def say_losses(console: Console, report: Report) -> None:
    """Print a report's warnings and remarks one by one, and only the number of dropped properties; with --json nothing."""
    if not console.as_json:
        for text in report.remarks:
            console.note(f"note: {text}")
        for text in report.warnings:
            console.note(f"warning: {text}")
        if report.dropped:
            console.note(plural(len(report.dropped), "property is", "properties are") + " not read and not drawn; --json names "
                         "them")
