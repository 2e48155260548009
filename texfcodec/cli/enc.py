"""texf-enc: a textured mesh becomes a .texf stream."""

from functools import partial

import click
from click_option_group import OptionGroup

from ..api import encode_loaded, refuse_losses
from ..codecs import codec_of
from ..codecs.base import JointCodec
from ..core.colour_error import in_decibels
from ..errors import InputError
from ..io.formats import SUFFIXES
from ..options import DEFAULT_CODEC, EncodeOptions, strange_options
from ..precompile import ENCODING, warm_up
from ..report import plural
from .batch import batch_flags, batch_of, encode_batch
from .console import SIGNS, STYLE, check_output, is_device, run, run_facts, timing_line, write_output
from .effect_lines import counted, decision_lines, losses_in_words
from .explain_lines import explain_flags, explain_lines, seconds_to_explain
from .flags import file_names, flag_of, limit_flags, limits_of, option_flags, report_flags
from .inputs import load_mesh
from .scene_file import encode_scene_file
from .stream_facts import stream_facts

_SCENE = ".glb"
RATE, KEPT, EFFORT, CODEC, NEURAL, LIMITS, BATCH = (OptionGroup(name, help=text) for name, text in {
    "Rate": "Bytes or quality. K or QP alone takes the other from r04.",
    "What is kept": "",
    "Effort": "",
    "Codec": "",
    "3DNTC": "With --codec 3dntc, which fits a payload for the GPU.",
    "Limits": "",
    "Batch": "A whole catalogue, into the folder of --out.",
}.items())
COARSE = 3.5  # texels along a voxel edge from which on coarse voxels show; of 20 assets at K 1024 two are above, both below 28 dB

# Peak for a scan of 100,000 faces: fast 528 MB, balanced 688; for an image of 4096 texels a side 397 and 397.
_LESS_MEMORY = {"fast": ", which takes least", "balanced": "; effort fast takes up to a quarter less"}


def _warm_up(context, parameter, value):
    if value and not context.resilient_parsing:
        warm_up()
        click.echo("all kernels are compiled and cached")
        context.exit()


@click.command("texf-enc", context_settings=STYLE)
@click.argument("source", metavar="INPUT", required=False, shell_complete=file_names)
@click.argument("out", metavar="OUT.{texf,glb}", required=False, shell_complete=file_names)
@option_flags(EncodeOptions, "rate", "resolution", "qp", "target_bytes", "target_psnr", "target_psnr_of", "exact_rate",
              "lossless", "max_error", option=RATE.option)
@option_flags(EncodeOptions, "support", "texel_size", "effects", "position_bits", "keep_mesh", "keep_animations",
              "strict", option=KEPT.option)
@option_flags(EncodeOptions, "effort", "refine", "threads", "no_check", "measure", option=EFFORT.option)
@explain_flags(EFFORT.option)
@option_flags(EncodeOptions, "codec", option=CODEC.option)
@CODEC.option("--codec-option", "codec_options", metavar="NAME=VALUE", multiple=True,
              help="A setting of a plug-in's codec; may be repeated.")
@option_flags(EncodeOptions, "point", "resident_bytes", "steps", "seed", "latent_index", "transport", "checkpoint",
              option=NEURAL.option)
@limit_flags("vertices", "faces", "voxels", "samples", "metadata_bytes", "image_pixels", option=LIMITS.option)
@batch_flags(BATCH.option)
@click.option("--dry-run", is_flag=True, help="Load, estimate and report, but write nothing. OUT is optional.")
@click.option("--warmup", is_flag=True, is_eager=True, expose_value=False, callback=_warm_up,
              help="Compile all kernels before the first use, then exit.")
@report_flags()
@click.pass_obj
def enc(console, source, out, dry_run, as_json, quiet, **choices):
    """Encode the textured mesh INPUT (SUFFIXES; "-": any of these on stdin) as OUT.texf ("-": stdout, with the report on stderr).

    OUT.glb keeps a scene: INPUT is a glTF whose meshes and images are coded in streams, while nodes, skins, morph targets,
    animations, variants and everything else stay as they are.

    Set the rate with --rate, with --resolution and --qp, with --target-bytes or with --target-psnr. --lossless and
    --near-lossless bound the error of the coded colours instead; they do not affect the geometry.

    Without K, the encoder may keep the texels of an image, or choose fewer voxels than the rate has. It does so where bytes and
    picture error cost less. --support and --exact-rate prevent this.

    With --codec 3dntc, --point or --resident-bytes sets the size, and --steps the fitting time. K only sets the number of voxels
    that a decoder produces from the payload.

    A catalogue of --batch is a folder of meshes, a list of paths (one per line), a TOML file, or a tileset of 3D Tiles
    (.json). Of a tileset the glTF contents are coded, and all other files are copied. The TOML file has [[asset]] tables with
    path, out (a name that ends in .texf or .glb) and options, and [options] for all. chair.glb becomes chair.texf, or with
    --suffix .glb a scene. Assets that would get the same name take their whole names: chair.glb.texf and chair.stl.texf. An
    asset that has a stream keeps its name. Each asset adds a JSON line on stdout and in results.jsonl; with --json the totals
    come last. If an asset fails, the others continue. The same command again encodes what is unfinished or has changed.

    Exit codes: 0 done, 1 command line, 2 input or output, 4 internal, 5 not supported, 6 limit exceeded, 7 an asset of a batch
    failed, 130 interrupted.
    """
    from ..batch.compile_beside import compile_beside

    batch = batch_of(choices, source, out)
    explained = seconds_to_explain(choices, dry_run)
    if batch is not None and explained is not None:
        raise click.UsageError("--explain-time cannot be combined with --batch")
    options = _options(choices)
    if batch is not None:
        return encode_batch(console, batch, options.checkpoint, dry_run)
    if out is None and not dry_run:
        raise click.UsageError("Missing argument 'OUT.texf'")
    if out == "-":
        console.stdout_is_taken()
    if not dry_run:
        _check_output(out, source)
        console.note_first_run(ENCODING)
    if _is_scene(out) and explained is not None:
        raise click.UsageError("--explain-time cannot be combined with OUT.glb")
    if _is_scene(out) and not dry_run:
        return encode_scene_file(console, source, out, options)
    with console.progress() as report:
        scene = _load(source, options, report)
        if not dry_run:
            check_output(out, scene.files)
            compile_beside(options.threads, "encode")
        facts = _estimate(scene, options, report) if dry_run else _encode(scene, options, report, out, explained)
    if not (console.as_json or dry_run):
        console.warnings(report)
    facts |= run_facts(report)
    console.result(facts, _dry_lines(facts, source) if dry_run else _lines(facts, out))


def _options(choices):
    """EncodeOptions of the given flags; EncodeOptions has the defaults."""
    choices = {name: value for name, value in choices.items() if not (value is None or value is False)}
    _check_codec(choices)
    ways = {"--rate": "rate", "--resolution/--qp": "resolution qp", "--target-bytes": "target_bytes",
            "--target-psnr": "target_psnr"}
    chosen = [flag for flag, names in ways.items() if any(name in choices for name in names.split())]
    if len(chosen) > 1:
        raise click.UsageError(f"{' and '.join(chosen)} cannot be combined")
    limits = limits_of(choices)
    bounds = [name for name in ("lossless", "max_error") if name in choices]
    others = [name for name in ("qp", "target_bytes", "target_psnr") if name in choices]
    if bounds and len(bounds + others) > 1:
        raise InputError("TXF-I50", f"{' and '.join(map(flag_of, bounds + others))} cannot be combined")
    for word in choices["codec_options"]:
        if "=" not in word:
            raise click.UsageError(f"--codec-option takes NAME=VALUE, not {word!r}")
    choices["codec_options"] = dict(word.split("=", 1) for word in choices["codec_options"])
    return EncodeOptions(**choices, limits=limits)


def _check_codec(choices):
    """Refuses flags of a codec that was not chosen: they are a mistake that must not be ignored."""
    name = choices.get("codec", DEFAULT_CODEC)
    for option in sorted(strange_options(codec_of(name)) & choices.keys()):
        raise click.UsageError(f"{flag_of(option)} does not apply to --codec {name}")


def _check_output(out, source):
    check_output(out, [source])
    if out != "-" and not out.lower().endswith((".texf", _SCENE)) and not is_device(out):
        raise click.UsageError(f"{out} must end in .texf or {_SCENE}")
    if _is_scene(out) and not source.lower().endswith((".glb", ".gltf")):
        raise click.UsageError(f"{out} keeps a glTF scene: INPUT must be a .glb or .gltf; for other formats OUT is a .texf")


def _is_scene(out):
    return out is not None and out.lower().endswith(_SCENE)


def _load(source, options, report):
    with report.stage("load"):
        scene = load_mesh(source, options.strict, options.limits)
    report.warnings += scene.warnings
    report.dropped += scene.dropped
    report.remarks += scene.remarks
    refuse_losses(options, report)
    return scene


def _encode(scene, options, report, out, explained=None):
    """Encodes, measures if requested, and writes; returns facts about the stream. explained: as of seconds_to_explain."""
    try:
        encoded = encode_loaded(scene, options, report)
    except MemoryError as error:
        error.advice = f" at effort {options.effort}{_LESS_MEMORY[options.effort]}"  # type: ignore[attr-defined]
        raise
    more = {} if explained is None else {"explained": _explain(scene, options, encoded, report, explained)}
    facts = {**_sizes(scene, len(encoded.data)), **stream_facts(encoded, options), **more}
    write_output(out, encoded.data, scene.files)  # the last that may fail
    return facts


def _explain(scene, options, encoded, report, seconds):
    from ..encoder.explain import explain_time
    from ..metrics.psnr_3d import measure_or_warn

    stages = dict(report.seconds)
    with report.stage("explain"):
        return measure_or_warn(lambda: explain_time(scene, options, encoded, stages, seconds or None), report)


def _sizes(scene, total):
    """Bytes of the source's files, and their ratio to the stream. total: bytes of the stream, or None."""
    source = sum(scene.files.values())
    source_facts = {"bytes": source, "files": len(scene.files), "names": list(scene.files)}
    return {"source": source_facts, "ratio": total and round(source / total, 3)}


def _estimate(scene, options, report):
    """Facts of --dry-run: counts of the source, estimates of voxels and seconds, and the decisions of the first stage."""
    from dataclasses import replace

    from ..encoder.dry_run import estimate
    from ..encoder.prepare.stage import prepare
    from ..encoder.requests import Requests

    with report.stage("estimate"):
        voxels, seconds = estimate(scene, options)
    request = replace(Requests.of(options).prepare, weight_size=0)  # weights take a second
    return {**prepare(scene, request, report).evidence, "dry_run": True, "bytes": None, **_sizes(scene, None),
            "resolution": options.resolution, "qp": options.qp, "voxels": None,
            "faces": len(scene.faces), "vertices": len(scene.positions), "materials": len(scene.materials),
            "textures": len(scene.textures), "estimated": {"voxels": voxels, "seconds": seconds}, "psnr_3d": None,
            "support": options.support, "rate_is_free": options.rate_is_free and not codec_of(options.codec).joint}


def _lines(facts, out):
    sizes = facts["bytes"]
    yield from explain_lines(facts["explained"]) if facts.get("explained") else ()
    yield f"{out}: {sizes['total']} bytes; geometry {sizes['geometry']}, attributes {sizes['attributes']}, other {sizes['other']}"
    yield from _size_lines(facts)
    yield from _check_lines(facts)
    codec = codec_of(facts["codec"])
    if isinstance(codec, JointCodec):
        yield from codec.result_lines(facts)
        yield from _psnr_lines(facts)
        yield timing_line(facts["seconds"], facts["peak_memory_bytes"])
        return
    fields = plural(facts["fields"], "field", "fields")
    bound = "lossless" if facts["max_error"] == 0 else f"maximum error {facts['max_error']}"
    quality = bound if facts["max_error"] is not None else codec.name if facts["qp"] is None else f"QP {facts['qp']}"
    counts, bits = counted(facts)
    faces = plural(facts["faces"], "face", "faces")
    yield f"{_grid(facts['resolution'])}{quality}, {fields}, {counts}, {faces}" + (f"; {bits}" if bits else "")
    yield from _support_lines(facts["supports"])
    yield from _mesh_lines(facts["mesh"])
    yield from decision_lines(facts["effects"], facts["channels"])
    yield from _normal_lines(facts["normals"])
    if facts["texels_per_voxel_edge"] > COARSE:
        yield f"the textures are {facts['texels_per_voxel_edge']:.1f} times finer than the voxels: a larger K keeps more detail"
    yield from _psnr_lines(facts)
    yield from _refinement_lines(facts["refinement"]) if facts["voxels"] else ()
    for trial in facts.get("search", []):
        psnr = "" if trial["psnr_y"] is None else f", {trial['psnr_y']:.2f} dB ({trial['psnr_of']})"
        mesh = f"{plural(trial['faces'], 'face', 'faces')} at {trial['position_bits']} bits"
        yield (f"  tried {_grid(trial['resolution'])}QP {trial['qp']:.4g}, {mesh}: {trial['bytes']} bytes{psnr}, "
               f"{trial['seconds']:.1f} s")
    yield timing_line(facts["seconds"], facts["peak_memory_bytes"])


def _grid(resolution):
    """K, if anything is over voxels."""
    return "texels, " if resolution is None else f"K {resolution}, "


def _normal_lines(facts):
    """Yields the error of the shading normals, the bytes and gain of their unit, and the treatment of normal maps."""
    if "degrees" in facts:
        size, (half, most, _) = facts.get("marks_bytes", 0) + facts.get("normals_bytes", 0), facts["degrees"]
        rules = f"; {size} bytes of marks and residuals; rules alone: {facts['rule_degrees'][1]} degrees on 95 %" if size else ""
        yield f"shading normals within {half} degrees on half of the surface, {most} on 95 %{rules}"
    if facts.get("turned_texels") or facts.get("split_fields"):
        apart = "; faces with other tangent frames are in separate fields" if facts["split_fields"] else ""
        yield f"normal maps converted from the file's TANGENTs to decoder frames: {facts['turned_texels']} texels{apart}"


def _support_lines(supports):
    """Yields the encoder's own choices of supports and K."""
    groups = [group for group in supports["groups"] if supports["asked"] == "auto"]
    texels = [group for group in groups if group["chosen"] == "texels"]
    if texels:
        what = "images" if len(groups) > 1 else "image"
        yield f"{len(texels)} of {len(groups)} {what} over texels, which costs less; flat colours count as one image"
    *others, best = (row["resolution"] for row in supports.get("voxels", [{"resolution": 0}]))
    if others:
        worse = " or ".join(str(k) for k in sorted(others))
        yield f"K {best} costs less in bytes and error than K {worse}, by the encoder's estimate"


def _mesh_lines(sent):
    """Yields the choice of the mesh and its position bits, instead of the source's mesh at the usual bits."""
    if "tried" not in sent:
        if "position_bits" in sent:
            yield f"position bits: {sent['position_bits']}; fewer would lose more than they save"
        return
    usual, (before, after) = sent["tried"][0], sent["faces"]
    chosen = min((tried for tried in sent["tried"] if "refused" not in tried), key=lambda tried: tried["cost"])
    if chosen is not usual:
        saved = usual["geometry_bytes"] - chosen["geometry_bytes"]
        yield (f"{after} of {before} faces, {chosen['position_bits']} position bits: {saved} bytes fewer than the source's "
               "mesh takes (--keep-mesh)")


def _size_lines(facts):
    source, ratio = facts["source"], facts["ratio"]
    files = "" if source["files"] == 1 else f" in {source['files']} files"
    yield f"source: {source['bytes']} bytes{files}, {ratio:.3g} times the stream"


def _check_lines(facts):
    """Yields the line that compares the stream with its source, with the losses of reading."""
    check, lost = facts["check"], losses_in_words(facts)
    if check is None:
        yield from [f"not checked{lost}"] * bool(facts["dropped"])
        return
    if not check["visible"]:
        yield f"checked: no surface is visible{lost}"
        return
    y, rgb = (_as_read(check[name], facts) for name in ("y", "rgb"))
    alpha = f", alpha {in_decibels(check['alpha'])}" if "alpha" in check else ""
    lit = f", lit {in_decibels(check['lit'])}" if "lit" in check else ""
    outline = f", with outlines {in_decibels(check['outline'])}" if "outline" in check else ""
    worst = check["worst"]
    part = f"; worst part '{worst['name']}' RGB {in_decibels(worst['rgb'])}" if worst and len(check["parts"]) > 1 else ""
    yield f"checked: Y {y}, RGB {rgb}{alpha}{lit}{outline}{part}{lost}"


def _as_read(decibels, facts):
    """Returns a PSNR in words: a match is "exact", or "as read" if reading lost something."""
    return "as read" if decibels is None and facts["dropped"] else in_decibels(decibels)


def _psnr_lines(facts):
    if facts["psnr_3d"]:
        shown = {name: in_decibels(value) for name, value in facts["psnr_3d"].items()}
        yield f"3D-PSNR: Y {shown['y']}, YUV 6:1:1 {shown['yuv611']}, RGB {shown['rgb']}"


def _refinement_lines(refinement):
    kept = [f for f in refinement.get("fields", []) if f["kept"]]
    if kept:
        steps = ", ".join(f"{f['psnr_y_before']:.1f} to {f['psnr_y_after']:.1f}" for f in kept if f["psnr_y_after"])
        yield f"{refinement['kind']} on the surface, before coding: Y {steps} dB"
    elif refinement["asked"] != "off":
        yield f"no refinement: {refinement['reason'] or 'the fit was not closer than the transfer'}"


def _dry_lines(facts, source):
    size = facts["source"]["bytes"]
    counts = (plural(facts["vertices"], "vertex", "vertices"), plural(facts["faces"], "face", "faces"),
              plural(facts["materials"], "material", "materials"))
    yield f"{source}: {size} bytes, {', '.join(counts)}"
    guess = facts["estimated"]
    free = "; the encoder may choose texels or a smaller K if they take fewer bytes" if facts["rate_is_free"] else ""
    yield (f"K {facts['resolution']}: about {guess['voxels']} voxels and {guess['seconds']:.0f} s{free}; "
           "nothing was written")
    yield from decision_lines(facts["effects"], [])
    for name, sign in SIGNS.items():
        for text in facts[name]:
            yield f"{sign}: {text}"


enc.help = str(enc.help).replace("SUFFIXES", " ".join(SUFFIXES))


main = partial(run, enc)

if __name__ == "__main__":
    main()
