"""texf-render: a picture of a stream or a mesh, or of two of them and their difference."""

from functools import partial
from pathlib import Path

import click
import numpy as np

from ..core.colour_error import in_decibels
from ..options import DecodeOptions, default_threads
from ..precompile import DECODING
from .console import STYLE, check_output, run, run_facts, timing_line, write_output
from .flags import (
    direction_of,
    file_names,
    limit_flags,
    limits_of,
    number,
    option_flags,
    pose_flags,
    pose_of,
    report_flags,
    size_of,
)
from .inputs import check_stdin_once, load_asset, posed_assets, say_losses

WHITE = (255, 255, 255)
PLAIN = {"white": WHITE, "black": (0, 0, 0)}


def _background_of(context, parameter, value):
    """The background of a name or of three numbers."""
    parts = value.split(",")
    if value == "grey":
        from ..render.backdrop import GREY

        return GREY
    if value in PLAIN:
        return PLAIN[value]
    if len(parts) != 3 or not all(p.isascii() and p.isdigit() and int(p) <= 255 for p in parts):
        raise click.BadParameter(f"{value} is not a background; choose grey, white, black or r,g,b with numbers in 0..255.")
    return tuple(int(p) for p in parts)


@click.command("texf-render", context_settings=STYLE)
@click.argument("source", metavar="IN.{texf,glb,gltf,obj,ply}", shell_complete=file_names)
@click.argument("out", metavar="OUT.png", shell_complete=file_names)
@click.option("--view", metavar="V", default="front", callback=direction_of,
              help="Direction of the camera: front, back, left, right, top, bottom, fibonacci:I (one of 16 views), or "
                   "AZIMUTH,ELEVATION in degrees. front looks along -z with y up; azimuth 90 is the right side.  [default: "
                   "front]")
@click.option("--size", metavar="N|WxH", default="1024", callback=size_of, help="Size in pixels, 1..8192 per side.  [default: "
                                                                                "1024]")
@click.option("--perspective", metavar="FOV", **number(1.0, 170.0, "Perspective projection with a vertical field of view of "
                                                                   "FOV degrees, 1..170.  [default: orthographic]"))
@click.option("--anti-alias", metavar="N", default=1,
              **number(1, 8, "Render N times larger and average N x N pixels.  [default: 1]"))
@click.option("--no-filter", is_flag=True, help="Query fields of a stream at full resolution only, as the metrics do.")
@click.option("--shaded/--no-shaded", default=None,
              help="Draw with lighting and all material maps, or base colour alone (docs/design/shading.md).  [default: with "
                   "lighting where IN has few colours and would show only its outline]")
@click.option("--no-cull", is_flag=True, help="Draw back faces too.")
@click.option("--background", metavar="C", default="grey", callback=_background_of,
              help="Background: grey (lighter at the top), white, black or r,g,b in 0..255.  [default: grey]")
@click.option("--compare", metavar="OTHER", shell_complete=file_names,
              help="Draw a second stream or mesh beside the first, and a heat map of their difference.")
@pose_flags()
@limit_flags("texels", "image_pixels")
@option_flags(DecodeOptions, "threads")
@report_flags()
@click.pass_obj
def render(console, source, out, compare, as_json, quiet, **choices):
    """Draw a stream or mesh as OUT.png ("-": stdout, with the report on stderr). The picture shows base colour or, with
    --shaded, lit materials.

    IN or OTHER may be "-": a stream or a mesh on stdin. The camera shows the vertices of IN as large as they fit, and OTHER from
    the same place. PSNR counts the pixels that both cover, over white where --background is grey. Without --shaded it compares
    base colour. With several --time the pictures stand one below the other, from one place.

    Exit codes: 0 done, 1 command line, 2 input or output, 3 invalid stream, 4 internal, 5 not supported, 6 limit exceeded, 130
    interrupted.
    """
    check_stdin_once(source, compare)
    if out == "-":
        console.stdout_is_taken()
    elif not out.lower().endswith(".png"):
        raise click.UsageError(f"{out} must end in .png")
    inputs = [name for name in (source, compare) if name is not None]
    check_output(out, inputs)
    choices |= {"threads": choices["threads"] or default_threads(), "limits": limits_of(choices), "pose": pose_of(choices)}
    console.note_first_run(DECODING)
    from ..render.thumbnail import to_png

    with console.progress() as report:
        frames = _frames(source, compare, choices, inputs, report)
        image = np.concatenate([image for _, _, image in frames])
        check_output(out, inputs)
        with report.stage("save"):
            write_output(out, to_png(image), inputs)
    say_losses(console, report)
    facts = _facts(image, frames, choices, report) | {"files": [Path(out).name] if out != "-" else []}
    console.result(facts, _lines(facts, out))


def _frames(source, compare, choices, inputs, report):
    """[(Picture of the source, figures of compare() or None, image)] of each time; adds the input files to inputs."""
    first = _assets(source, choices, inputs, report)
    second = _assets(compare, choices, inputs, report) if compare is not None else [None] * len(first)
    camera, measured = _camera(first, choices), bool(choices["shaded"])
    if choices["shaded"] is None:
        from ..render.backdrop import is_nearly_uniform

        choices["shaded"] = is_nearly_uniform(first[0])
    frames = []
    for pair in zip(first, second, strict=True):
        picture = _draw(pair[0], camera, choices, report)
        if compare is None:
            frames.append((picture, None, _image(picture, choices)))
            continue
        shown, unlit = [picture, _draw(pair[1], camera, choices, report)], choices | {"shaded": measured}
        compared = shown if measured == choices["shaded"] else [_draw(asset, camera, unlit, report) for asset in pair]
        named = list(zip(pair, (source, compare), strict=True))
        frames.append((picture, *_compared(named, shown, compared, choices, report)))
    if not any(len(picture.pixel) for picture, _, _ in frames):
        report.warnings.append("the view shows no surface: the picture is empty")
    return frames


def _assets(path, choices, inputs, report):
    """Scene or Texf at path, in a list; with a pose the Scenes at its times."""
    options = DecodeOptions(threads=choices["threads"], limits=choices["limits"])
    return posed_assets(path, choices["pose"], options.limits, inputs, report) if choices["pose"] else \
        [load_asset(path, options, inputs, report)]


def _camera(assets, choices):
    from ..render.camera import framing

    size = tuple(side * choices["anti_alias"] for side in choices["size"])
    return framing(choices["view"], np.concatenate([asset.positions for asset in assets]), size, choices["perspective"])


def _draw(asset, camera, choices, report):
    """Picture of a Scene or a Texf."""
    from ..render.environment import DAYLIGHT
    from ..render.shade import render_scene, render_texf
    from ..scene.scene import Scene

    cull, threads, light = not choices["no_cull"], choices["threads"], DAYLIGHT if choices["shaded"] else None
    with report.stage("render"):
        if isinstance(asset, Scene):
            return render_scene(asset, camera, cull, threads, shaded=light)
        return render_texf(asset, camera, cull, not choices["no_filter"], threads, shaded=light)


def _image(picture, choices):
    from ..render.shade import box_down

    return box_down(picture.image(choices["background"]), choices["anti_alias"])


def _compared(named, shown, compared, choices, report):
    """Figures of compare(), and the sheet. named: (asset, path) of both; shown, compared: their Pictures."""
    from ..render.backdrop import GREY
    from ..render.difference import compare, names_of_halves, sheet
    from ..render.shade import box_down
    from ..scene.scene import Scene

    with report.stage("compare"):
        under = WHITE if choices["background"] == GREY else choices["background"]
        first, second = compared
        difference, heat = compare(first, second, under, choices["background"])
        panels = [*(_image(picture, choices) for picture in shown), box_down(heat, choices["anti_alias"])]
        halves = names_of_halves([(isinstance(asset, Scene), Path(path).name) for asset, path in named])
        return difference, sheet(panels, [*halves, "difference: RMS of R, G, B; teal: covered by one side "
                                              "only"], choices["background"])


def _facts(image, frames, choices, report):
    picture, pose = frames[0][0], choices["pose"]
    shown = [{"covered": len(picture.pixel), "compare": compared} for picture, compared, _ in frames]
    return {"width": image.shape[1], "height": image.shape[0], "direction": [round(float(v), 6) for v in choices["view"]],
            "perspective": choices["perspective"], "shaded": choices["shaded"], "pixels": picture.width * picture.height,
            "background": list(choices["background"]), **run_facts(report),
            **({"times": [{"time": time, **each} for time, each in zip(pose[0], shown, strict=True)]} if pose else shown[0])}


def _lines(facts, out):
    lit = ", with lighting" if facts["shaded"] else ""
    for shown in facts.get("times", [facts]):
        share, at = 100 * shown["covered"] / facts["pixels"], f" at {shown['time']:g} s" if "time" in shown else ""
        yield f"{out}{at}: {facts['width']} x {facts['height']} pixels, {share:.1f} % of the view covered{lit}"
        yield from _difference_lines(shown["compare"])
    yield timing_line(facts["seconds"], facts["peak_memory_bytes"])


def _difference_lines(difference):
    if difference and not difference["pixels_both"]:
        yield "no pixel is covered by both, so there is no PSNR"
    elif difference:
        shown = {name: in_decibels(difference[name]) for name in ("psnr_rgb", "psnr_y")}
        yield (f"PSNR over the {difference['pixels_both']} pixels that both cover: RGB {shown['psnr_rgb']}, Y {shown['psnr_y']}; "
               f"{difference['pixels_only_first']} only in the first, {difference['pixels_only_second']} only in the second")


main = partial(run, render)

if __name__ == "__main__":
    main()
