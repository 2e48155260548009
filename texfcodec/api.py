"""The front door: what a program that uses texfcodec calls. Rooms are entered when they are needed: inspecting a stream loads no
kernel, decoding one no encoder."""

from __future__ import annotations

import time
from os import PathLike
from typing import TYPE_CHECKING

from .errors import InputError
from .options import DecodeOptions, EncodeOptions
from .report import Report

if TYPE_CHECKING:
    from .asset.scene import Scene
    from .limits import Limits

if TYPE_CHECKING:
    from .encoder import Encoded
    from .texf import Texf


def encode(mesh_or_path: object, options: EncodeOptions | None = None, report: Report | None = None) -> bytes:
    """Codes a textured mesh: as encode_to_result(), the .texf stream alone."""
    return encode_to_result(mesh_or_path, options, report).data


def encode_to_result(mesh_or_path: object, options: EncodeOptions | None = None, report: Report | None = None) -> Encoded:
    """Codes a textured mesh.

    mesh_or_path: path of a mesh file, a trimesh object or a Scene; report: Report that receives seconds by stage, warnings and
    dropped properties. Returns the stream with its byte counts, and what the encoder chose and why. Raises InputError,
    LimitError, SupportError.
    """
    from .asset.load.files import load

    options, report = options or EncodeOptions(), report or Report()
    with report.stage("load"):
        scene = load(mesh_or_path, strict=options.strict)
    report.warnings += scene.warnings
    report.dropped += scene.dropped
    report.remarks += scene.remarks
    refuse_losses(options, report)
    return encode_loaded(scene, options, report)


def refuse_losses(options: EncodeOptions, report: Report) -> None:
    """Raises InputError TXF-I52 where options are strict and something was reported that will look different: a warning or a
    dropped property. Remarks refuse nothing."""
    if options.strict and (report.warnings or report.dropped):
        raise InputError("TXF-I52", "something would be lost, and strict forbids it", warnings=report.warnings or None,
                         dropped=report.dropped or None)


def encode_loaded(scene: Scene, options: EncodeOptions, report: Report) -> Encoded:
    """Codes a Scene: at the rate that was asked for, or by search where a target was; checks and measures it as options say."""
    begin = time.perf_counter()
    if options.target_bytes is not None or options.target_psnr is not None:
        from .search import encode_to_target

        made = encode_to_target(scene, options, report)
    elif options.no_check:
        from .encoder import encode_scene

        made = encode_scene(scene, options, report)
    else:
        from .check import encode_checked

        made = encode_checked(scene, options, report)
    if not (options.no_check or made.check):
        from .check import check

        check(scene, made, options, report, time.perf_counter() - begin)
    if options.measure and made.psnr_3d is None:
        from .quality.measure import measure_or_warn

        with report.stage("measure"):
            made.psnr_3d = measure_or_warn(lambda: measure(scene, made, options.threads), report)
    refuse_losses(options, report)
    _say_if_larger(scene, made, report)
    return made


def _say_if_larger(scene, made, report):
    """Warns where a stream has more bytes than the files that its scene was read from; nothing looks different, so that strict
    does not refuse it."""
    source = sum(scene.files.values())
    if 0 < source < len(made.data):
        report.warnings.append(f"the stream, {len(made.data)} bytes, is larger than its source, {source} bytes")


def measure(scene: Scene, made: Encoded, threads: int = 1) -> dict:
    """3D-PSNR of a stream against the Scene it came from, in dB; see quality.measure.measure."""
    from .decoder import decode_stream
    from .quality.measure import measure as measured

    texf = decode_stream(made.data, DecodeOptions(threads=threads), Report())
    return measured(scene, texf, threads=threads, face_field=made.face_field)


def decode(data_or_path: bytes | bytearray | memoryview | str | PathLike, options: DecodeOptions | None = None,
           report: Report | None = None) -> Texf:
    """Decodes a .texf stream (spec clauses 5 to 8).

    data_or_path: the stream as bytes, or the path of a file; report: Report that receives seconds by stage and warnings. Raises
    InputError for a file that cannot be read or an argument of another kind, StreamError, LimitError or SupportError.
    """
    options, report = options or DecodeOptions(), report or Report()
    data = _bytes_of(data_or_path, options.limits)
    if options.isolate:
        from .isolate import decode_isolated

        return decode_isolated(data, options, report)
    from .decoder import decode_stream

    return decode_stream(data, options, report)


def inspect(data_or_path: bytes | bytearray | memoryview | str | PathLike, limits: Limits | None = None) -> dict:
    """What stands where in a .texf stream, JSON-ready; see bitstream.inspect. data_or_path: bytes, or the path of a file."""
    from .bitstream.inspect import inspect as inspected
    from .limits import Limits

    limits = limits or Limits()
    return inspected(_bytes_of(data_or_path, limits), limits)


def _bytes_of(data_or_path, limits):
    if isinstance(data_or_path, bytes | bytearray | memoryview):
        return bytes(data_or_path)
    if isinstance(data_or_path, str | PathLike):
        from .bitstream.file import read_stream_file

        return read_stream_file(data_or_path, limits)
    raise InputError("TXF-I05", "neither the bytes of a stream nor the path of a file", value=type(data_or_path).__name__)
