"""texf-eval --shaded and TEXFLoader against three.js: both renderers draw the same files from the same cameras in the same light.

python tools/proof/three_check.py [STREAM.texf ...] [--assets FOLDER [--only NAME ...] [--rate R]] [--pair SOURCE DECODED ...]
        [--light daylight|sky|lights|flat] [--alike NAME ...] [--views N] [--size PIXELS] [--averaged N] [--mipmaps]
        [--samples N] [--least DB] [--pictures] [--out FOLDER] [--modules FOLDER]

--assets names a folder of GLB files, of which those in ASSETS_SHOWN are coded at the rate (into OUT, once) and decoded; --pair
takes files as they are, GLB or .texf. three.js, playwright-core and a Chromium are needed (three_page.mjs); --modules names a
folder with node_modules, else npm installs them into OUT. Materials, normals and tangents are three.js's own, as its loaders make
them, but for what --alike names ("all": all of it). Markdown tables go to stdout. Of pairs: PSNR Y between source and decoded
mesh in either renderer, and between both renderers' pictures of either. Of streams: PSNR between the renderers over the pixels of
all views that both cover, and by --samples which of them is nearer to a picture of N x N samples a pixel by ours. Exits 7 where a
stream has less than --least.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec import decode
from texfcodec.core.colour_error import ColourError, in_decibels
from texfcodec.io.load import load
from texfcodec.metrics.views import ViewSettings, renderer
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.shade import box_down
from tools.proof.public_models.run import node_modules

PAGE, SOURCES = Path(__file__).with_suffix(".mjs"), Path(__file__).resolve().parents[2] / "js" / "src"
ASSETS_SHOWN = ("damaged_helmet", "vintage_fan", "cat_webp", "waterbottle_pbr", "chess_board", "clearcoat_blend")
SKY_SIZE = 1024, 512  # of the sky as a map; PMREMGenerator makes cubes of a quarter of its width
ALIKE = ("roughness", "occlusion", "diffuse", "bounces", "mirror", "coat", "colours", "frames")
PAIRS = ("asset", "ours: source, decoded", "three.js: source, decoded", "three.js less ours", "sources: ours, three.js",
         "decoded: ours, three.js", "covered by both")


@dataclass(frozen=True)
class Shown:
    """Pictures of one asset by view. images: uint8 [H, W, 3] over white; covered: masks bool [H, W] of the pixels it covers."""

    images: list
    covered: list

    def add(self, image, covered, averaged):
        """Add the picture of a view, reduced by blocks of averaged x averaged samples; a pixel is covered if all of them are."""
        if averaged > 1:
            blocks = covered.reshape(len(covered) // averaged, averaged, -1, averaged)
            image, covered = box_down(image, averaged), blocks.all(axis=(1, 3))
        self.images.append(image)
        self.covered.append(covered)


def light_of(name):
    """Return the Environment for both renderers by name: "daylight", its "sky" or its "lights" alone; None for "flat". Lights
    have no radius, as in three.js."""
    lights = tuple(replace(light, radius=0.0) for light in DAYLIGHT.lights)
    return {"flat": None, "sky": replace(DAYLIGHT, lights=()), "daylight": replace(DAYLIGHT, lights=lights),
            "lights": replace(DAYLIGHT, lights=lights, gradient=0 * DAYLIGHT.gradient)}[name]


def sky_map(environment, size=SKY_SIZE):
    """Return the sky as an image float32 [H, W, 4], linear RGBA by longitude and latitude, nadir first; None if it is black."""
    if environment is None or not environment.gradient.any():
        return None
    width, height = size
    up = np.sin(((np.arange(height) + 0.5) / height - 0.5) * np.pi)
    out = np.ones((height, width, 4), np.float32)
    out[..., :3] = np.maximum(environment.radiance(np.stack([np.zeros(height), up, np.zeros(height)])), 0).T[:, None]
    return out


def cameras_of(scene, views, size):
    """Return the cameras of compare_views() around a scene. views: their number; size: side of a picture in pixels."""
    centre, radius = bounding_sphere(scene.positions)
    return [orthographic(fibonacci_direction(i, views), centre, radius, size) for i in range(views)]


def camera_json(camera):
    """Return a Camera as JSON-ready dict for three_check.mjs."""
    axes = {name: getattr(camera, name).tolist() for name in ("right", "up", "forward", "eye")}
    return axes | {"half": camera.half, "depth": camera.half}


def lights_json(environment):
    """Return the lights of an Environment as JSON-ready list for three_check.mjs; three.js, too, takes irradiance."""
    lights = environment.lights if environment else ()
    return [{"direction": light.direction.tolist(), "colour": light.irradiance.tolist()} for light in lights]


def ours(scene, cameras, settings, averaged=1):
    """Draw a scene with texfcodec's renderer for each camera; return the Shown. averaged: samples a side per pixel."""
    draw, out = renderer(scene, settings), Shown([], [])
    for camera in cameras:
        picture = draw(camera)
        covered = np.zeros(camera.height * camera.width, bool)
        covered[picture.pixel] = True
        out.add(picture.image(), covered.reshape(camera.height, camera.width), averaged)
    return out


def theirs(folder, name, views, size, averaged=1):
    """Return the Shown of pictures that three_check.mjs has left in a folder. size: side in samples; averaged: as of ours()."""
    out = Shown([], [])
    for view in range(views):
        raw = np.fromfile(folder / f"{name}-{view}.rgba", np.uint8).reshape(size, size, 4)[::-1]
        out.add(raw[..., :3], raw[..., 3] > 0, averaged)
    return out


def agreement(first, other):
    """Compare two Shown over the pixels that both cover; return (PSNR of RGB in dB, of Y, share of the pixels covered by either
    that both cover, share that differs by more than 8 of 255)."""
    error, either, far = ColourError(), 0, 0
    for a, b, here, there in zip(first.images, other.images, first.covered, other.covered, strict=True):
        both = here & there
        either += int((here | there).sum())
        far += int((np.abs(a[both].astype(np.int16) - b[both]).max(axis=1) > 8).sum())
        error.add(a[both], b[both])
    result = error.result()
    return result["psnr_rgb"], result["psnr_y"], error.samples / max(either, 1), far / max(error.samples, 1)


def draw_theirs(subjects, cameras, environment, args):
    """Draw files with three.js into args.out / "three" and return the facts of three_check.mjs. subjects: {name: [path]};
    cameras: {name: [Camera]}."""
    modules = args.modules or node_modules(args.out)
    if modules is None or not shutil.which("node"):
        raise SystemExit("three.js cannot be had: node or npm is missing")
    work, files, sky = args.out / "three", [], sky_map(environment)
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(SOURCES, work / "js" / "src")
    for name, paths in subjects.items():
        for number, path in enumerate(paths):
            shutil.copyfile(path, work / f"{name}-{number}{path.suffix}")
            files.append({"name": f"{name}-{number}", "path": f"{name}-{number}{path.suffix}", "cameras": name})
    if sky is not None:
        sky.tofile(work / "sky.f32")
    job = {"root": str(work.resolve()), "size": args.size * args.averaged, "filter": "mipmaps" if args.mipmaps else "linear",
           "alike": args.alike, "flat": environment is None, "lights": lights_json(environment), "files": files,
           "sky": None if sky is None else {"width": SKY_SIZE[0], "height": SKY_SIZE[1], "file": "sky.f32"},
           "cameras": {name: [camera_json(camera) for camera in views] for name, views in cameras.items()}}
    (work / "job.json").write_text(json.dumps(job), encoding="utf-8")
    if subprocess.run(["node", PAGE, work.resolve() / "job.json", work.resolve()], cwd=modules, env=os.environ).returncode:
        raise SystemExit("the browser failed: no pictures")
    return json.loads((work / "facts.json").read_text(encoding="utf-8"))


def coded(names, args):
    """Encode and decode assets unless args.out has the results; return {name: (source path, decoded path)}."""
    paths = {name: (args.assets / f"{name}.glb", args.out / f"{name}.glb") for name in names}
    for source, mesh in paths.values():
        stream = mesh.with_suffix(".texf")
        if not mesh.exists():
            for words in (["enc", "--quiet", "--rate", args.rate, source, stream], ["dec", "--quiet", stream, mesh]):
                subprocess.run([sys.executable, "-m", f"texfcodec.cli.{words[0]}", *words[1:]], check=True)
    return paths


def keep(folder, name, shown):
    """Save a picture per view that shows the Shown of one asset side by side."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for view, row in enumerate(zip(*(picture.images for picture in shown), strict=True)):
        Image.fromarray(np.hstack(row)).save(folder / f"{name}-{view}.png")


def row_of(name, scenes, cameras, settings, args):
    """Return (cells of the table, PSNR RGB of ours against three.js) of a subject. scenes: [its Scene], or [source, decoded]."""
    here = [ours(scene, cameras, settings, args.averaged) for scene in scenes]
    there = [theirs(args.out / "three", f"{name}-{number}", args.views, args.size * args.averaged, args.averaged)
             for number in range(len(scenes))]
    if args.pictures:
        keep(args.out / "pictures", name, [shown for pair in zip(here, there, strict=True) for shown in pair])
    both = [agreement(*pair) for pair in zip(here, there, strict=True)]
    if len(scenes) == 2:
        source_psnr, decoded_psnr = (agreement(*side)[1] for side in (here, there))
        return [name, in_decibels(source_psnr), in_decibels(decoded_psnr), f"{decoded_psnr - source_psnr:+.2f}",
                *(in_decibels(y) for _, y, _, _ in both),
                f"{100 * both[0][2]:.1f} %"], both[0][0]
    ((rgb, y, covered, far),), more = both, []
    if args.samples:
        fine = ours(scenes[0], cameras_of(scenes[0], args.views, args.size * args.samples), settings, args.samples)
        more = [in_decibels(agreement(fine, sampled)[0]) for sampled in (here[0], there[0])]
    return [name, in_decibels(rgb), in_decibels(y), f"{100 * covered:.2f} %", f"{100 * far:.2f} %", *more], rgb


def arguments_of(words):
    """Parse the words of the command line and return the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streams", type=Path, nargs="*", metavar="STREAM.texf")
    parser.add_argument("--assets", type=Path, metavar="FOLDER")
    parser.add_argument("--only", action="append", metavar="NAME", help="an asset of the folder; repeatable")
    parser.add_argument("--pair", action="append", nargs=2, type=Path, default=[], metavar=("SOURCE", "DECODED"))
    parser.add_argument("--rate", default="r04")
    parser.add_argument("--light", choices=("daylight", "sky", "lights", "flat"), default="daylight", help="flat: streams alone")
    parser.add_argument("--alike", action="append", default=[], choices=(*ALIKE, "all"),
                        help="what three.js is made to do as we do; repeatable")
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--averaged", type=int, default=2, metavar="N", help="samples a side that a pixel is the mean of")
    parser.add_argument("--mipmaps", action="store_true", help="minified maps from mip levels, as always with streams")
    parser.add_argument("--samples", type=int, metavar="N", help="streams, too, against pictures of N x N samples a pixel")
    parser.add_argument("--least", type=float, default=0.0, metavar="DB", help="PSNR RGB that a stream must have")
    parser.add_argument("--pictures", action="store_true", help="keep each view: source by ours and theirs, then decoded")
    parser.add_argument("--out", type=Path, default=Path("out/three"), metavar="FOLDER")
    parser.add_argument("--modules", type=Path, metavar="FOLDER", help="holds node_modules with three and playwright-core")
    args = parser.parse_args(words)
    args.alike = list(ALIKE) if "all" in args.alike else args.alike
    args.mipmaps = args.mipmaps or bool(args.streams)
    if not (args.assets or args.pair or args.streams):
        parser.error("give streams, pairs, or a folder of assets")
    return args


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    args = arguments_of(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    subjects = {path.stem: (path,) for path in args.streams}
    subjects |= {f"{n}-{pair[0].stem}": tuple(pair) for n, pair in enumerate(args.pair)}
    subjects |= coded(args.only or ASSETS_SHOWN, args) if args.assets else {}
    scenes = {name: [(decode if path.suffix == ".texf" else load)(path) for path in paths] for name, paths in subjects.items()}
    cameras = {name: cameras_of(pair[0], args.views, args.size * args.averaged) for name, pair in scenes.items()}
    environment = light_of(args.light)
    answer, missed = draw_theirs(subjects, cameras, environment, args), False
    print(f"three.js r{answer['revision']}, {args.light}, alike: {' '.join(args.alike) or 'nothing'}, {args.views} views of "
          f"{args.size}, {args.averaged} x {args.averaged} samples")
    fine = [f"ours to {args.samples} x {args.samples} samples", "three.js to them"] if args.samples else []
    streams = ["stream", "PSNR RGB", "PSNR Y", "covered by both", "far off", *fine]
    for count, head in ((1, streams), (2, PAIRS)):
        names = [name for name, paths in subjects.items() if len(paths) == count]
        print(*([f"\n| {' | '.join(head)} |\n|---|{'---:|' * (len(head) - 1)}"] if names else []), sep="\n")
        for name in names:
            settings = ViewSettings(environment=environment, mipmaps=args.mipmaps)
            cells, rgb = row_of(name, scenes[name], cameras[name], settings, args)
            missed |= count == 1 and rgb < args.least
            print(f"| {' | '.join(cells)} |", flush=True)
    return 7 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
