"""The public functions of texfcodec. Rooms are imported on use: inspecting a stream loads no kernel, decoding one no encoder."""

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

    from .encoder.container.encode import EncodedContainer
    from .encoder.write import Encoded
    from .scene.scene import Scene
    from .texf import Texf

Stream: TypeAlias = "bytes | bytearray | memoryview | str | PathLike[str] | BinaryIO"
Mesh: TypeAlias = "Stream | trimesh.Trimesh | trimesh.Scene | Scene | Mapping[str, Any]"


def encode(mesh: Mesh, options: EncodeOptions | Mapping[str, Any] | None = None, report: Report | None = None) -> bytes:
    """Encodes a textured mesh.

    Parameters
    ----------
    mesh : str, PathLike, bytes, file object, trimesh.Trimesh, trimesh.Scene, Scene or dict
        A path; the bytes of a mesh file, or a file object open for reading bytes; or a mesh in memory, of which a dict holds
        arrays by name: a surface with voxels, with a function of points, or with values at vertices
        (docs/guide/generated_mesh.md). The format of a file object is that of its name's suffix, if it has one. Else, and for
        bytes, the first bytes decide (GLB, glTF, PLY, STL, OFF, 3MF, COLLADA).
    options : EncodeOptions or dict, optional
        Rate and all other settings; a dict holds fields of EncodeOptions by name.
    report : Report, optional
        Receives seconds by stage, and the sentences of the warnings, as lists.

    Returns
    -------
    bytes
        The .texf stream. encode_to_result() also returns facts about it.

    Raises
    ------
    InputError
        The mesh, its files or an option are at fault; TXF-I52 if options are strict and something would be lost.
    LimitError
        The mesh exceeds options.limits.
    SupportError
        A package that it needs is not installed.
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
    """Encodes a textured mesh as encode(), and returns facts about the stream with it.

    Parameters
    ----------
    mesh, options, report
        As of encode().

    Returns
    -------
    Encoded
        data, the stream; its byte counts; the encoder's decisions and their reasons; warnings, dropped and remarks.

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


def encode_gltf(mesh: Stream, options: EncodeOptions | Mapping[str, Any] | None = None,
                report: Report | None = None) -> EncodedContainer:
    """Encodes the meshes and images of a glTF file and keeps everything else in it.

    Parameters
    ----------
    mesh : bytes-like, str, PathLike or file object
        A .glb or .gltf file.
    options : EncodeOptions or dict, optional
        Of every stream.
    report : Report, optional
        As of encode().

    Returns
    -------
    EncodedContainer
        data, a GLB with the part-level form of TEXF_stream (docs/guide/TEXF_stream.md); its streams; warnings and remarks.
        expand() makes an ordinary GLB of it.

    Raises
    ------
    InputError, LimitError, SupportError, Cancelled
        As encode().

    Warns
    -----
    LossWarning
        As encode().
    """
    from .encoder.container.encode import encode_document
    from .io.load import read_source

    options, report = options_of(EncodeOptions, options), report or Report()
    data, folder = read_source(mesh)
    encoded = encode_document(data, folder, options, report, encode_loaded)
    _warn_of_losses([*encoded.warnings, *map(_not_coded, encoded.dropped)])
    return encoded


def expand(gltf: Stream, options: DecodeOptions | Mapping[str, Any] | None = None, report: Report | None = None,
           texture_format: str = "auto") -> bytes:
    """Decodes a glTF file whose meshes are coded in streams.

    Parameters
    ----------
    gltf : bytes-like, str, PathLike or file object
        The GLB of encode_gltf().
    options : DecodeOptions or dict, optional
        Of every stream.
    report : Report, optional
        As of decode().
    texture_format : {"auto", "png", "jpeg", "webp", "avif", "ktx2"}
        Format of images; "auto" is JPEG if that costs hardly any quality, else PNG.

    Returns
    -------
    bytes
        A GLB without the extension. Nodes, skins, animations and everything else that no stream holds are as in the source.

    Raises
    ------
    InputError, StreamError, LimitError, SupportError
        The file, or a stream in it, is at fault.
    """
    from .io.container.expand import expand_bytes
    from .io.load import read_source
    from .sandbox.engines import decode_by_engine

    options, report = options_of(DecodeOptions, options), report or Report()
    data, folder = read_source(gltf)
    return expand_bytes(data, folder, lambda stream: decode_by_engine(stream, options, report), texture_format)


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
    """Issues each sentence as a LossWarning at the line that called the caller of this function."""
    for sentence in sentences:
        warnings.warn(sentence, LossWarning, stacklevel=3)


def refuse_losses(options: EncodeOptions, report: Report) -> None:
    """Raise InputError if options are strict and an encode loses something visible.

    Parameters
    ----------
    options : EncodeOptions
        Its field strict says whether losses are refused.
    report : Report
        Report of the encode. Its warnings and dropped properties are losses, its remarks are not.

    Raises
    ------
    InputError
        TXF-I52 if options are strict and there is a loss.
    """
    if options.strict and (report.warnings or report.dropped):
        raise InputError("TXF-I52", "the mesh would lose something, and strict forbids it", warnings=report.warnings or None,
                         dropped=report.dropped or None)


def encode_loaded(scene: Scene, options: EncodeOptions, report: Report) -> Encoded:
    """Encodes a Scene, then checks and measures it as options say.

    Parameters
    ----------
    scene : Scene
        Its warnings, dropped and remarks are not added to the report.
    options : EncodeOptions
        A rate, or a target, for which the QP is searched.
    report : Report
        Receives seconds and sentences; no LossWarning is issued.

    Returns
    -------
    Encoded
        The stream and facts about it.

    Raises
    ------
    InputError, LimitError, SupportError, Cancelled
        As encode().
    """
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
    """Warns if a stream is larger than the files of its scene. Nothing looks different, so strict does not refuse it."""
    source = sum(scene.files.values())
    if 0 < source < len(encoded.data):
        report.warnings.append(f"the stream ({len(encoded.data)} bytes) is larger than its source ({source} bytes)")


def measure(scene: Scene, encoded: Encoded, threads: int = 1) -> dict:
    """3D-PSNR of a stream against its source; see metrics.psnr_3d.measure.

    Parameters
    ----------
    scene : Scene
        The source.
    encoded : Encoded
        Its stream, which is decoded.
    threads : int
        Most threads.

    Returns
    -------
    dict
        "y", "yuv611", "rgb" in dB, None means lossless; "samples": the number of surface points.

    Raises
    ------
    InputError
        TXF-I94 if no point is visible, TXF-I70 if the stream has no face.
    """
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
    StreamError
        The stream is invalid.
    LimitError
        The stream exceeds options.limits.
    SupportError
        The stream uses a feature that this version does not have.
    Cancelled
        The report's on_progress returned False.

    Notes
    -----
    For files from unknown sources use DecodeOptions(isolate=True) and lower limits. Decoded values are the same on every machine.
    """
    options, report = options_of(DecodeOptions, options), report or Report()
    data = _bytes_of(stream, options.limits)
    from .sandbox.engines import decode_by_engine

    return decode_by_engine(data, options, report)


def inspect(stream: Stream, limits: Limits | None = None) -> dict:
    """Lists the syntax elements of a .texf stream without decoding it.

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
