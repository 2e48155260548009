"""texf-view: a page that shows a stream or a mesh, or two of them, in a browser; also as one file."""

import math
import threading
import webbrowser
from pathlib import Path
from typing import NoReturn

import click

from .. import __version__
from ..errors import TexfError
from . import interrupts
from .console import STYLE, check_output, run, seconds_of, timing_line, write_output
from .flags import direction_of, file_names, limit_flags, limits_of, number
from .inputs import CARRIED, carried_stream, check_stdin_once, checked_stream, files_of, open_asset, say_losses

MODES = ("single", "split", "difference", "side")
LINK = 7  # numbers of a camera that the page's link holds
PAGES = (".html", ".htm")
_SETTINGS = ("shaded", "mode", "layer")


def _camera_of(context, parameter, value):
    """{"link": text} of the seven numbers of a link, else {"direction": [x, y, z]}."""
    if value.count(",") != LINK - 1:
        return {"direction": [float(v) for v in direction_of(context, parameter, value)]}
    try:
        numbers = [float(part) for part in value.split(",")]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"{value} is not a camera; the page copies a camera as {LINK} numbers.")
    return {"link": ",".join(f"{v:.9g}" for v in numbers)}


@click.command("texf-view", context_settings=STYLE)
@click.argument("source", metavar="FILE.{texf,glb,gltf,obj,ply}", shell_complete=file_names)
@click.argument("other", metavar="[OTHER]", required=False, shell_complete=file_names)
@click.option("--export", metavar="PAGE.html", shell_complete=file_names,
              help="Write the page with its content as one file, which needs neither server nor network.")
@click.option("--camera", metavar="C", default="front", callback=_camera_of,
              help="Camera: front, back, left, right, top, bottom, fibonacci:I (one of 16 views), AZIMUTH,ELEVATION in "
                   "degrees, or the seven numbers that the page copies.  [default: front]")
@click.option("--perspective", metavar="FOV", **number(1.0, 170.0, "Perspective projection with a vertical field of view of "
                                                                   "FOV degrees, 1..170.  [default: orthographic]"))
@click.option("--shaded/--no-shaded", default=None,
              help="Draw with lighting and all material maps, or base colour alone (docs/design/shading.md).  [default: with "
                   "lighting where materials have any]")
@click.option("--mode", type=click.Choice(MODES),
              help="Compare two files with a slider between them, as their difference, or side by side.  [default: split; "
                   "single without OTHER]")
@click.option("--layer", metavar="NAME", help="Show a layer instead of the colour, by its name on the page, such as normals.")
@click.option("--port", metavar="N", default=0,
              **number(0, 65535, "Port of the page; 0 for any free port.  [default: 0]"))
@click.option("--no-browser", is_flag=True, help="Print the address of the page, but do not open a browser.")
@limit_flags("file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes", "isolate_bytes",
             "isolate_seconds", "image_pixels")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, errors included.")
@click.option("--quiet", is_flag=True, help="Print only errors and the address of the page.")
@click.version_option(__version__, message="%(prog)s %(version)s")
@click.pass_obj
def view(console, source, other, export, as_json, quiet, **choices):
    """Show a stream or mesh in a browser, or compare two of them, with three.js and without baking. The tool prints the address
    of the page and serves it to this machine alone, until Ctrl-C. Drop more files on the page to see them. The page decodes
    streams and reads GLB files in the browser's sandbox; a process with limited memory and time reads other meshes.

    FILE or OTHER may be "-": a stream or a mesh on stdin. With --export ("-": stdout, with the report on stderr) the page is not
    served. texf-render draws pictures into files.

    Exit codes: 0 done, 1 command line, 2 input or output, 3 invalid stream, 4 internal, 5 not supported, 6 limit exceeded, 130
    interrupted.
    """
    check_stdin_once(source, other)
    inputs = [name for name in (source, other) if name is not None]
    _check(console, other, export, choices, inputs)
    start = _start(choices, other)
    limits = limits_of(choices)
    with console.progress() as report:
        shown = _shown(limits, inputs, report)
        if export is not None:
            check_output(export, inputs)
            page = _page(shown, limits, start, report)
            with report.stage("save"):
                write_output(export, page, inputs)
    say_losses(console, report)
    facts = _facts(shown, report)
    if export is not None:
        facts |= {"files": [Path(export).name] if export != "-" else []}
        console.result(facts, [f"{export}: {len(page)} bytes", timing_line(facts["seconds"], facts["peak_memory_bytes"])])
    else:
        _serve(console, shown, start, choices, limits, facts)


def _check(console, other, export, choices, inputs):
    """Refuses what cannot be done before any work is."""
    if export == "-":
        console.stdout_is_taken()
    elif export is not None and not export.lower().endswith(PAGES):
        raise click.UsageError(f"{export} must end in {' or '.join(PAGES)}")
    if other is None and choices["mode"] not in (None, "single"):
        raise click.UsageError(f"--mode {choices['mode']} requires OTHER, a second file to compare")
    if choices["perspective"] is not None and "link" in choices["camera"]:
        raise click.UsageError("--perspective cannot be combined with the seven numbers of --camera, which contain a field of "
                               "view")
    if export is not None:
        check_output(export, inputs)


def _start(choices, other):
    """Take the page's first state out of the choices, JSON-ready."""
    camera, fov = choices.pop("camera"), choices.pop("perspective")
    settings = {name: choices.pop(name) for name in _SETTINGS}
    settings["mode"] = settings["mode"] or ("single" if other is None else "split")
    return {"camera": camera if "link" in camera else {**camera, "perspective": fov}, **settings}


def _shown(limits, inputs, report):
    """The inputs, in their order; adds the other files that were read to inputs."""
    from ..viewer.glb import glb_of_asset
    from ..viewer.server import Shown

    out = []
    for path in list(inputs):
        name = Path(path).name
        with report.stage("load"):
            asset = _sound_carried(path, limits, report) or open_asset(path, path.lower().endswith(".texf"), limits)
        inputs += files_of(path, None if isinstance(asset, bytes) else asset)
        if isinstance(asset, bytes):
            with report.stage("check"):
                report.warnings += checked_stream(asset, limits)
            out.append(Shown(name, len(asset), asset))
            continue
        report.warnings += asset.warnings
        report.dropped += asset.dropped
        with report.stage("pack"):
            out.append(Shown(name, sum(asset.files.values()), glb_of_asset(path, asset), asset.warnings))
    return out


def _sound_carried(path, limits, report):
    """The stream that a GLB carries, None where there is none that the page could decode."""
    data = None if path == "-" else carried_stream(path, limits)
    try:
        if data is not None:
            checked_stream(data, limits)
            report.remarks.append(CARRIED.format(path))
    except TexfError:  # the mesh beside it is shown, and its reader says why
        return None
    return data


def _page(shown, limits, start, report):
    """The bytes of the exported page."""
    from ..viewer.page import export_page

    with report.stage("export"):
        return export_page(shown, " and ".join(asset.name for asset in shown), start, __version__, limits=limits)


def _serve(console, shown, start, choices, limits, facts):
    """Serves the page until Ctrl-C, which is how it is meant to end: with 0."""
    from ..viewer.dropped import glb_of_dropped
    from ..viewer.server import ViewServer

    drop = lambda data, name: glb_of_dropped(data, name, limits)
    with ViewServer(shown, drop=drop, start=start, version=__version__, port=choices["port"], limits=limits) as server:
        interrupts.Talk.quiet, interrupts.Talk.closes = console.quiet or console.as_json, True
        if console.quiet and not console.as_json:
            click.echo(server.address)
        console.result({"address": server.address, **facts}, [server.address])
        if not console.as_json:
            console.note("press Ctrl-C to stop")
        if not choices["no_browser"] and not _open(server.address):
            console.note("warning: no browser could be started; open the address yourself")
        try:
            while not threading.Event().wait(1.0):
                pass
        except KeyboardInterrupt:  # where cli/interrupts.py is not at work
            pass
    if not console.as_json:
        console.note(interrupts.CLOSED)


def _open(address):
    """Return whether a browser with a window was started; one that runs in the terminal would take it over."""
    try:
        browser = webbrowser.get()
        return type(browser) is not webbrowser.GenericBrowser and browser.open(address)
    except (webbrowser.Error, OSError):
        return False


def _facts(shown, report):
    from ..report import peak_memory_bytes

    assets = [{"name": asset.name, "bytes": asset.size} for asset in shown]
    return {"assets": assets, "seconds": seconds_of(report), "peak_memory_bytes": peak_memory_bytes(),
            "warnings": report.warnings, "dropped": report.dropped, "remarks": report.remarks}


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run texf-view and exit. arguments: the words after its name, sys.argv by default."""
    run(view, arguments)


if __name__ == "__main__":
    main()
