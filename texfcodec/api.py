"""The front door: what a program that uses texfcodec calls. Rooms are entered when they are needed: inspecting a stream loads no
kernel, decoding one no encoder."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias

from .errors import InputError, LossWarning
from .limits import UNLIMITED, Limits
from .options import DecodeOptions, EncodeOptions, options_of
from .report import SENTENCES, Report

if TYPE_CHECKING:
    import trimesh

    from .encoder.write import Encoded
    from .scene.scene import Scene
    from .texf import Texf

Stream: TypeAlias = "bytes | bytearray | memoryview | str | PathLike[str] | BinaryIO"
Mesh: TypeAlias = "Stream | trimesh.Trimesh | trimesh.Scene | Scene"


def encode(mesh: Mesh, options: EncodeOptions | Mapping[str, Any] | None = None, report: Report | None = None) -> bytes:
    """Codes a textured mesh.

    Parameters
    ----------
    mesh : str, PathLike, bytes, file object, trimesh.Trimesh, trimesh.Scene or Scene
        A path; the bytes of a mesh file, or a file object open for reading bytes, whose format is that of its name where it has
        one with a suffix, else told by the first bytes (GLB, glTF, PLY, STL, OFF, 3MF, COLLADA); or a mesh in memory.
    options : EncodeOptions or dict, optional
        Rate and all other settings; a dict holds fields of EncodeOptions by name.
    report : Report, optional
        Receives seconds by stage, and what the warnings say, as lists.

    Returns
    -------
    bytes
        The .texf stream. encode_to_result() returns what is known of it as well.

    Raises
    ------
    InputError
        The mesh, its files or an option are at fault; TXF-I52 where options are strict and something would be lost.
    LimitError, SupportError
        The mesh asks for more than options.limits; something it needs is not installed.
    Cancelled
        The report's on_progress returned False.

    Warns
    -----
    LossWarning
        Once for every warning, and for every property that is not coded.

    Notes
    -----
    The same mesh, options and version give the same bytes, whatever the threads and the machine.
    """
    encoded = _encoded(mesh, options, report)
    _warn_of_losses([*encoded.warnings, *map(_not_coded, encoded.dropped)])
    return encoded.data


def encode_to_result(mesh: Mesh, options: EncodeOptions | Mapping[str, Any] | None = None,
                     report: Report | None = None) -> Encoded:
    """Codes a textured mesh: as encode(), and tells what is known of the stream.

    Parameters
    ----------
    mesh, options, report
        As of encode().

    Returns
    -------
    Encoded
        data, the stream; its byte counts; what the encoder chose and why; warnings, dropped and remarks.

    Raises
    ------
    InputError, LimitError, SupportError, Cancelled
        As encode().

    Warns
    -----
    LossWarning
        As encode().
    """
    encoded = _encoded(mesh, options, report)
    _warn_of_losses([*encoded.warnings, *map(_not_coded, encoded.dropped)])
    return encoded


def _encoded(mesh, options, report):
    from .io.load import load

    options, report = options_of(EncodeOptions, options), report or Report()
    with report.stage("load"):
        scene = load(mesh, options.strict, options.limits)
    report.warnings += scene.warnings
    report.dropped += scene.dropped
    report.remarks += scene.remarks
    refuse_losses(options, report)
    return encode_loaded(scene, options, report)


def _not_coded(name):
    return f"not coded: {name}"


def _warn_of_losses(sentences):
    """Says each as a LossWarning at the line that called the caller of this."""
    for sentence in sentences:
        warnings.warn(sentence, LossWarning, stacklevel=3)


def refuse_losses(options: EncodeOptions, report: Report) -> None:
    """Raises InputError TXF-I52 where options are strict and something was reported that will look different: a warning or a
    dropped property. Remarks refuse nothing."""
    if options.strict and (report.warnings or report.dropped):
        raise InputError("TXF-I52", "the mesh would lose something, and strict forbids it", warnings=report.warnings or None,
                         dropped=report.dropped or None)


def encode_loaded(scene: Scene, options: EncodeOptions, report: Report) -> Encoded:
    """Codes a Scene: at the rate that was asked for, or by search where a target was; checks and measures it as options say. The
    sentences of the Scene are the caller's to report, and those of the result as well."""
    begin, known = time.perf_counter(), {name: len(getattr(report, name)) for name in SENTENCES}
    if options.target_bytes is not None or options.target_psnr is not None:
        from .encoder.search import encode_to_target

        encoded = encode_to_target(scene, options, report)
    elif options.no_check:
        from .encoder.encode import encode_scene

        encoded = encode_scene(scene, options, report)
    else:
        from .encoder.verify import encode_checked

        encoded = encode_checked(scene, options, report)
    if not (options.no_check or encoded.check):
        from .encoder.verify import check

        check(scene, encoded, options, report, time.perf_counter() - begin)
    if options.measure and encoded.psnr_3d is None:
        from .metrics.psnr_3d import measure_or_warn

        with report.stage("measure"):
            encoded.psnr_3d = measure_or_warn(lambda: measure(scene, encoded, options.threads), report)
    refuse_losses(options, report)
    _say_if_larger(scene, encoded, report)
    for name, count in known.items():  # the report may be of several encodes
        setattr(encoded, name, [*getattr(scene, name), *getattr(report, name)[count:]])
    return encoded


def _say_if_larger(scene, encoded, report):
    """Warns where a stream has more bytes than the files that its scene was read from; nothing looks different, so that strict
    does not refuse it."""
    source = sum(scene.files.values())
    if 0 < source < len(encoded.data):
        report.warnings.append(f"the stream ({len(encoded.data)} bytes) is larger than its source ({source} bytes)")


def measure(scene: Scene, encoded: Encoded, threads: int = 1) -> dict:
    """3D-PSNR of a stream against the Scene it came from, in dB; see metrics.psnr_3d.measure."""
    from .decoder import decode_stream
    from .metrics.psnr_3d import measure as measured

    texf = decode_stream(encoded.data, DecodeOptions(threads=threads, limits=UNLIMITED), Report())
    return measured(scene, texf, threads=threads)


def decode(stream: Stream, options: DecodeOptions | Mapping[str, Any] | None = None, report: Report | None = None) -> Texf:
    """Decodes a .texf stream (spec clauses 5 to 8).

    Parameters
    ----------
    stream : bytes-like, str, PathLike or file object
        The stream, the path of its file, or a file object open for reading bytes; or a GLB that carries a stream, in the same
        ways.
    options : DecodeOptions or dict, optional
        A dict holds fields of DecodeOptions by name.
    report : Report, optional
        Receives seconds by stage and warnings.

    Returns
    -------
    Texf
        The mesh, the fields that colour it, and its materials.

    Raises
    ------
    InputError
        The file cannot be read, or an argument is of another kind.
    StreamError, LimitError, SupportError
        The stream is invalid, asks for more than options.limits, or for what this version does not have.
    Cancelled
        The report's on_progress returned False.

    Notes
    -----
    Files from strangers: DecodeOptions(isolate=True), and lower limits. Decoded values are the same on every machine.
    """
    options, report = options_of(DecodeOptions, options), report or Report()
    data = _bytes_of(stream, options.limits)
    from .sandbox.engines import decode_by_engine

    return decode_by_engine(data, options, report)


def inspect(stream: Stream, limits: Limits | None = None) -> dict:
    """What stands where in a .texf stream, without decoding it.

    Parameters
    ----------
    stream : bytes-like, str, PathLike or file object
        As of decode().
    limits : Limits, optional
        On the size of the stream and of its metadata.

    Returns
    -------
    dict
        JSON-ready: units, their elements with offsets and values, fields, materials, channel groups, level; see
        bitstream.inspect.

    Raises
    ------
    InputError, StreamError, LimitError, SupportError
        As decode().
    """
    from .bitstream.inspect import inspect as inspected
    limits = limits or Limits()
    return inspected(_bytes_of(stream, limits), limits)


def _bytes_of(stream, limits):
    from .bitstream.file import read_stream_file, read_stream_object

    if isinstance(stream, bytes | bytearray | memoryview):
        data = bytes(stream)
    elif isinstance(stream, str | PathLike):
        data = read_stream_file(stream, limits)
    elif hasattr(stream, "read"):
        data = read_stream_object(stream, limits)
    else:
        raise InputError("TXF-I05", "expected the bytes of a stream or the path of a file", value=type(stream).__name__)
    if data[:4] != b"glTF":
        return data
    from .io.gltf.carried import stream_within

    return stream_within(data)
