"""texf-dec: a .texf stream becomes a mesh file that viewers open."""

from functools import partial
from pathlib import Path

import click

from ..api import decode
from ..bitstream.file import read_stream_file
from ..errors import TexfError
from ..io.container.layout import open_scene_file
from ..io.formats import APPEARANCES, ATLAS_METHODS, COMPRESSIONS, SAVED_SUFFIXES, TEXTURE_FORMATS
from ..io.gltf.carried import stream_within
from ..io.save_choice import SaveOptions
from ..options import DecodeOptions
from ..precompile import DECODING
from ..report import plural
from .console import STYLE, check_output, run, run_facts, timing_line, write_output
from .flags import file_names, limit_flags, limits_of, number, option_flags, report_flags
from .scene_file import add_fallbacks_to_file, expand_scene_file

_SAVE_OPTIONS = ("appearance", "texture_size", "atlas", "texture_format", "texture_quality", "compress")
_FALLBACK_LOD = 3  # an eighth of the texels along a side, a 64th of the bytes of images
_STREAM = ".texf"


@click.command("texf-dec", context_settings=STYLE)
@click.argument("source", metavar="IN.texf", shell_complete=file_names)
@click.argument("out", metavar="OUT.{glb,gltf,obj,ply,npz,texf}", shell_complete=file_names)
@click.option("--overwrite", is_flag=True, help="Replace existing files beside OUT (.mtl, images, .bin). OUT itself is always "
                                                "replaced.")
@click.option("--appearance", type=click.Choice(APPEARANCES),
              help="Write textures, vertex colours, or the voxels as points.  [default: texture; vertex for .ply, and for "
                   "materials of a GLB or glTF that vertex colours show as well]")
@click.option("--texture-size", metavar="N", **number(1, 16384, "Texels per side of the atlas. Only fields over voxels need "
                                                                "an atlas; fields over texels keep their image and UVs.  "
                                                                "[default: by the field]"))
@click.option("--atlas", type=click.Choice(ATLAS_METHODS), default=ATLAS_METHODS[0],
              help="Charts of the atlas: quality has fewer seams, fast is for millions of faces.  [default: auto]")
@click.option("--texture-format", type=click.Choice(TEXTURE_FORMATS), default=TEXTURE_FORMATS[0],
              help="Format of images. auto chooses JPEG where it costs less than 0.2 dB, else PNG, which is exact. webp, avif "
                   "and ktx2 require GLB or glTF, and some viewers do not read them. ktx2 stays compressed on the GPU.  "
                   "[default: auto]")
@click.option("--texture-quality", metavar="Q", **number(1, 100, "Quality of jpeg, webp, avif and ktx2, 1..100.  [default: by "
                                                                 "the format]"))
@click.option("--compress", type=click.Choice(COMPRESSIONS), default=COMPRESSIONS[0],
              help="Compress the mesh of a GLB or glTF: KHR_draco_mesh_compression or EXT_meshopt_compression.  [default: none]")
@click.option("--carry-stream", is_flag=True, help="Embed the stream in the GLB or glTF, for viewers with the extension "
                                                   "TEXF_stream. Other viewers show a fallback mesh, decoded at --lod.  "
                                                   f"[default of --lod then: {_FALLBACK_LOD}]")
@click.option("--fallback-faces", metavar="N", **number(1, 1 << 31, "Maximum faces of the fallback mesh of --carry-stream; "
                                                                    "seams may need more.  [default: by the shape]"))
@option_flags(DecodeOptions, "lod", "isolate", "engine")
@limit_flags("file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes", "isolate_bytes",
             "isolate_seconds")
@option_flags(DecodeOptions, "threads")
@report_flags()
@click.pass_obj
def dec(console, source, out, overwrite, carry_stream, fallback_faces, as_json, quiet, **choices):
    """Decode IN.texf ("-": stdin) to a mesh file. The suffix of OUT chooses the format ("-": GLB on stdout, with the report on
    stderr). IN may be a GLB that carries a stream; OUT.texf then extracts it. IN may be a scene that texf-enc wrote as a GLB;
    OUT.glb is then an ordinary glTF, or with --carry-stream the scene with an ordinary mesh beside each coded one.

    For files from unknown sources, use --isolate and lower the limits.

    Exit codes: 0 done, 1 command line, 2 input or output, 3 invalid stream, 4 internal, 5 not supported, 6 limit exceeded, 130
    interrupted.
    """
    from ..io.save import check_choices
    from ..sandbox.engines import first_engine

    if out == "-":
        console.stdout_is_taken()
    elif not out.lower().endswith((*SAVED_SUFFIXES, _STREAM)):
        raise click.UsageError(f"{out} must end in one of {' '.join(SAVED_SUFFIXES)} {_STREAM}")
    limits = limits_of(choices)
    save_options = {name: choices.pop(name) for name in _SAVE_OPTIONS}
    if fallback_faces is not None and not carry_stream:
        raise click.UsageError("--fallback-faces requires --carry-stream")
    if carry_stream and choices["lod"] is None:
        choices["lod"] = _FALLBACK_LOD
    options = DecodeOptions(**{name: value for name, value in choices.items() if value is not None}, limits=limits)
    check_output(out, [source])
    takes_out = out.lower().endswith(_STREAM)
    if takes_out and carry_stream:
        raise click.UsageError("--carry-stream requires a GLB or glTF as OUT")
    if not takes_out:
        check_choices("stream.glb" if out == "-" else out, **save_options, stream=b"" if carry_stream else None)
    data = read_stream_file(source, limits)
    if open_scene_file(data) is not None:
        if out != "-" and not out.lower().endswith(".glb"):
            raise click.UsageError(f"{source} is a scene whose meshes are coded: OUT must end in .glb")
        texture_format = save_options.pop("texture_format")
        if SaveOptions(**save_options) != SaveOptions():
            raise click.UsageError(f"{source} is a scene whose meshes are coded: of the options for OUT, only --texture-format, "
                                   "--carry-stream and --fallback-faces apply")
        if carry_stream:
            return add_fallbacks_to_file(console, data, (source, out), options, (texture_format, fallback_faces))
        return expand_scene_file(console, data, source, out, options, texture_format)
    data = stream_within(data)
    compiles = first_engine(options) == "numba"
    if compiles:
        console.note_first_run(DECODING)
    stages = [*_stages(out, save_options["appearance"], compiles, partial(_over_voxels, data, limits))]
    if stages:
        from ..batch.compile_beside import compile_beside

        compile_beside(options.threads, *stages)
    with console.progress() as report:
        texf = decode(data, options, report)
        if carry_stream:
            with report.stage("simplify"):
                texf = _fallback(texf, fallback_faces)
        with report.stage("save"):
            if takes_out:
                saved = _take_out(data, source, out)
            else:
                saved = _save(texf, source, out, overwrite, save_options | {"stream": data if carry_stream else None})
    report.warnings += saved["warnings"]
    report.remarks += saved["remarks"]
    if not console.as_json:
        console.warnings(report)
    facts = _facts(data, texf, report, saved)
    console.result(facts, _lines(facts, out, texf.counted()))


def _stages(out, appearance, compiles, over_voxels):
    """Yield the stages of precompile.py whose kernels this run may need. over_voxels(): whether the stream has such fields."""
    if compiles:
        yield "decode"
    if appearance in (None, "texture") and not out.lower().endswith((".ply", ".npz", _STREAM)) and over_voxels():
        yield "save"


def _over_voxels(data, limits):
    """Return whether a field of the stream is over voxels, so that its faces need an atlas. decode() names what is damaged."""
    from ..bitstream.stream import read_stream
    from ..bitstream.syntax import SUPPORT_TEXELS

    try:
        return any(values["support"] != SUPPORT_TEXELS for values in read_stream(data, limits).fields)
    except TexfError:
        return False


def _fallback(texf, faces):
    """The Texf with at most so many faces, for viewers that do not know the stream."""
    from ..encoder.fallback import with_fewer_faces

    return with_fewer_faces(texf, faces)


def _take_out(data, source, out):
    """Writes the stream itself, which has been decoded without a fault; returns facts in the form of save()."""
    write_output(out, data, [] if source == "-" else [source])
    return {"warnings": [], "dropped": [], "remarks": [], "files": [Path(out).name], "seams": None, "carried": None}


def _save(texf, source, out, overwrite, save_options):
    """Writes OUT and the files beside it; returns the facts of save()."""
    from ..core import cleanup
    from ..io.save import as_glb, save

    if out == "-":
        data, losses = as_glb(texf, **save_options)
        write_output(out, data)
        return {"files": []} | losses
    cleanup.last_step()
    return save(texf, out, **save_options, overwrite=overwrite, inputs=[] if source == "-" else [source])


def _facts(data, texf, report, saved):
    values = {kind: sum(len(part.keys) for part in texf.fields if part.over_texels == kind) for kind in (False, True)}
    facts = run_facts(report)
    peaks = [p for p in (facts["peak_memory_bytes"], report.child_peak_memory_bytes) if p]
    return {"bytes": {"total": len(data)}, "resolution": texf.resolution, "voxels": values[False], "texels": values[True],
            "faces": sum(len(unit.faces) for unit in texf.units), "vertices": sum(len(unit.lattice) for unit in texf.units),
            "fields": len(texf.fields), **facts, "peak_memory_bytes": max(peaks, default=None),
            **{name: saved[name] for name in ("files", "seams", "carried", "dropped")}}


def _lines(facts, out, counted):
    sizes = plural(facts["faces"], "face", "faces"), plural(facts["vertices"], "vertex", "vertices")
    yield f"{out}: {', '.join(sizes)}, {counted} from {facts['bytes']['total']} bytes"
    if facts["carried"]:
        yield f"carries the stream ({facts['carried']['stream']} bytes) and a fallback ({facts['carried']['fallback']} bytes)"
    if facts["seams"] and facts["seams"]["border_edges"]:
        yield _seams_line(facts["seams"])
    yield timing_line(facts["seconds"], facts["peak_memory_bytes"])


def _seams_line(seams):
    mean, largest = (" ".join(f"{value:.1f}" for value in seams[name]) for name in ("mean", "largest"))
    return (f"colour steps across {seams['border_edges']} seam edges of the atlas, at mip levels 0 to 4: mean {mean}; largest "
            f"{largest} of 255")


main = partial(run, dec)

if __name__ == "__main__":
    main()
