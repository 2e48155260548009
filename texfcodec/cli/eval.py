"""texf-eval: the error of a coded mesh against its source, in rendered views and at points of its surface."""

from functools import partial

import click

from ..api import decode
from ..core.colour_error import in_decibels
from ..io.formats import SUFFIXES
from ..metrics.perceptual import Lpips
from ..options import DecodeOptions
from ..precompile import ENCODING
from ..scene.scene import Scene
from .console import STYLE, run, run_facts, timing_line
from .flags import file_names, limit_flags, limits_of, number, option_flags, pose_flags, pose_of, report_flags
from .inputs import check_stdin_once, load_mesh, open_asset, open_carried, posed_meshes


@click.command("texf-eval", context_settings=STYLE)
@click.argument("source", metavar="SOURCE", shell_complete=file_names)
@click.argument("other", metavar="DECODED", shell_complete=file_names)
@click.option("--views", metavar="N", default=16, **number(1, 4096, "Number of views around the object.  [default: 16]"))
@click.option("--size", metavar="S", default=2048, **number(16, 8192, "Pixels per side of a view.  [default: 2048]"))
@click.option("--ssim/--no-ssim", default=True, help="Compute SSIM of the views.  [default: ssim]")
@click.option("--lpips", "weights", metavar="WEIGHTS", shell_complete=file_names,
              help="Compute LPIPS of the views. WEIGHTS is torchvision's AlexNet state dict (.pth). Requires texfcodec[lpips].")
@click.option("--shaded", is_flag=True, help="Also compute the PSNR of lit views with all material maps, the error of every "
                                             "channel, and the angles between shading normals (docs/design/shading.md).")
@click.option("--mipmaps", is_flag=True, help="Filter minified images and fields between two mip levels, as viewers do.")
@click.option("--no-3d", is_flag=True, help="Leave out the metrics of surface points: 3D-PSNR, D1, D2, Hausdorff.")
@pose_flags()
@limit_flags("texels", "image_pixels")
@option_flags(DecodeOptions, "threads")
@report_flags()
@click.pass_obj
def evaluate(console, source, other, weights, threads, as_json, quiet, **choices):
    """Compare DECODED, a .texf stream or a mesh (SUFFIXES), with its source mesh SOURCE. One of them may be "-": a stream or a
    mesh on stdin.

    Views are orthographic, with back faces culled. PSNR counts the pixels that both sides cover, as in the MPEG mesh metric.
    Union PSNR counts pixels that either side covers, on white; silhouette pixels are those that one side alone covers. 3D-PSNR
    compares points spread evenly over the source. D1 and D2 are PSNR of the distance between the surfaces, in full and along the
    source's normals. Each is the lower of both directions, 10 log10(3 peak^2 / error), where peak is the longest side of the
    source. The Hausdorff distance is the largest distance.

    Exit codes: 0 done, 1 command line, 2 input or output, 3 invalid stream, 4 internal, 5 not supported, 6 limit exceeded, 130
    interrupted.
    """
    options, pose = DecodeOptions(threads=threads or 0, limits=limits_of(choices)), pose_of(choices)
    check_stdin_once(source, other)
    lpips = weights and Lpips(weights)  # first of all: it is quick to fail
    console.note_first_run(ENCODING)
    with console.progress() as report:
        if pose is None:
            with report.stage("load"):
                scene = _named(load_mesh(source, limits=options.limits), source, report)
            facts = _measured(scene, _open(other, options, report), choices, lpips, options.threads, report)
        else:
            sides = (posed_meshes(path, pose, options.limits, report) for path in (source, other))
            facts = {"times": [{"time": time, **_measured(scene, posed, choices, lpips, options.threads, report)}
                               for time, scene, posed in zip(pose[0], *sides, strict=True)]}
    if not console.as_json:
        console.warnings(report)
    facts |= {name: value for name, value in run_facts(report).items() if name != "dropped"}
    console.result(facts, [*_lines(facts, other), timing_line(facts["seconds"], facts["peak_memory_bytes"])])


def _named(scene, path, report):
    report.warnings += [f"{path}: {text}" for text in scene.warnings]
    return scene


def _open(path, options, report):
    """Scene of a mesh, or Texf of a stream."""
    texf = open_carried(path, options, report)
    if texf is not None:
        return texf
    with report.stage("load"):
        asset = open_asset(path, not path.lower().endswith(SUFFIXES), options.limits)
    return decode(asset, options, report) if isinstance(asset, bytes) else _named(asset, path, report)


def _measured(scene, decoded, flags, lpips, threads, report):
    """Measures of the command, without time and warnings. flags: the values of the flags of measures."""
    from ..geometry.mesh import Mesh
    from ..metrics.psnr_3d import measure, measure_or_warn
    from ..metrics.shaded import compare_shaded
    from ..metrics.surface_distance import surface_distance
    from ..metrics.views import NEAREST_SAMPLES, ViewSettings, compare_views, mesh_psnr_3d

    views, size, mipmaps, is_mesh = flags["views"], flags["size"], flags["mipmaps"], isinstance(decoded, Scene)
    with report.stage("views"):
        facts = compare_views(scene, decoded, views, size, flags["ssim"], lpips, threads=threads,
                              settings=ViewSettings(mipmaps=mipmaps), on_view=lambda n, of: report.progress("views", n, of))
    facts |= {"mipmaps": mipmaps, "shaded": None, "psnr_3d": None, "surface": None}
    if flags["shaded"]:
        with report.stage("shaded"):
            facts["shaded"] = compare_shaded(scene, decoded, views, size, threads, mipmaps,
                                             on_view=lambda n, of: report.progress("shaded", n, of))
    if not flags["no_3d"]:
        at_points = mesh_psnr_3d if is_mesh else measure
        with report.stage("psnr_3d"):  # as many points as a mesh can be searched for
            facts["psnr_3d"] = measure_or_warn(lambda: at_points(scene, decoded, NEAREST_SAMPLES, threads), report)
        with report.stage("surface"):
            source, mesh = (Mesh(side.positions, side.faces) for side in (scene, decoded))
            facts["surface"] = surface_distance(source, mesh, threads=threads).report()
    return facts


def _lines(facts, other):
    if "times" in facts:
        for measured in facts["times"]:
            yield from _lines(measured, f"{other} at {measured['time']:g} s")
        return
    yield f"{other}: {facts['views']} views of {facts['size']} x {facts['size']}, {facts['pixels']} pixels compared"
    shown = {name: in_decibels(value, 3) for name, value in facts["psnr"].items()}
    yield f"PSNR: RGB {shown['rgb']}, Y {shown['y']}, U {shown['u']}, V {shown['v']}, YUV {shown['yuv']}"
    yield from _outline_lines(facts)
    if facts["shaded"]:
        yield from _shaded_lines(facts["shaded"])
    others = [f"{name.upper()} {facts[name]:.5f}" for name in ("ssim", "lpips") if facts[name] is not None]
    if others:
        yield ", ".join(others)
    points = facts["psnr_3d"]
    if points:
        shown = {name: in_decibels(points[name], 3) for name in ("y", "yuv611", "rgb")}
        yield f"3D-PSNR: Y {shown['y']}, YUV 6:1:1 {shown['yuv611']}, RGB {shown['rgb']} at {points['samples']} points"
    if facts["surface"]:
        yield from _surface_lines(facts["surface"])


def _outline_lines(facts):
    shown, outline = {name: in_decibels(value, 3) for name, value in facts["union_psnr"].items()}, facts["silhouette"]
    yield f"union PSNR, on white: RGB {shown['rgb']}, Y {shown['y']}, YUV {shown['yuv']}"
    yield (f"silhouettes: one side alone covers {outline['pixels']} pixels, {100 * outline['share']:.3f} % ({outline['lost']} "
           f"lost, {outline['gained']} gained)")


def _surface_lines(distance):
    d1, d2 = (in_decibels(distance[name]["psnr"], 3) for name in ("d1", "d2"))
    away = distance["hausdorff"]
    yield f"D1 {d1}, D2 {d2}; 10 log10(3 peak^2 / error), where peak is the longest side, {distance['peak']:.6g}"
    yield f"Hausdorff distance: {away['distance']:.6g}, {100 * away['share']:.4f} % of the diagonal"


def _shaded_lines(shaded):
    shown, union = ({name: in_decibels(value, 3) for name, value in shaded[kind].items()} for kind in ("psnr", "union_psnr"))
    yield f"shaded PSNR: RGB {shown['rgb']}, Y {shown['y']}, YUV {shown['yuv']}"
    yield f"shaded union PSNR, on white: RGB {union['rgb']}, Y {union['y']}, YUV {union['yuv']}"
    for name, error in shaded["channels"].items():
        words = {"dB": lambda e: in_decibels(e["psnr"]), "degrees": _angles,
                 "coverage": lambda e: f"{100 * e['lost']:.3f} % lost, {100 * e['gained']:.3f} % gained"}[error["unit"]](error)
        yield f"{name.replace('_', ' ')}: {words} at {error['samples']} points"
    if shaded["normals"]:
        yield f"shading normals: {_angles(shaded['normals']['with_map'])}"
        yield f"without normal maps: {_angles(shaded['normals']['without_map'])}"


def _angles(error):
    return f"median {error['median_degrees']:.2f}, 95 % {error['p95_degrees']:.2f}, 99 % {error['p99_degrees']:.2f} degrees"


evaluate.help = str(evaluate.help).replace("SUFFIXES", " ".join(SUFFIXES))


main = partial(run, evaluate)

if __name__ == "__main__":
    main()
