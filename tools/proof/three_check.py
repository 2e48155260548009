"""texf-eval --shaded against three.js: both renderers draw sources and decoded meshes from the same cameras in the same light.

python tools/proof/three_check.py ASSETS [--only NAME ...] [--rate R] [--pair SOURCE.glb DECODED.glb ...]
        [--light daylight|sky|lights]
                                   [--alike NAME ...] [--views N] [--size PIXELS] [--averaged N] [--mipmaps] [--pictures]
                                   [--out FOLDER] [--modules FOLDER]

ASSETS is a folder of GLB files, of which those in ASSETS_SHOWN are coded at the rate (into OUT, once) and decoded; --pair takes
files as they are instead. three.js, playwright-core and a Chromium are needed (three_page.mjs); --modules names a folder with
node_modules, else npm installs them into OUT. Materials, normals and tangents are three.js's own, as GLTFLoader makes them, but
for what --alike names ("all": all of it). A Markdown table goes to stdout: PSNR Y between source and decoded mesh in either
renderer, and between both renderers' pictures of either.
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

from texfcodec.core.colour_error import ColourError, decibels, in_decibels
from texfcodec.io.load import load
from texfcodec.metrics.views import Look, renderer
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.shade import box_down
from tools.proof.strangers.run import node_modules

PAGE = Path(__file__).with_suffix(".mjs")
ASSETS_SHOWN = ("damaged_helmet", "vintage_fan", "cat_webp", "waterbottle_pbr", "chess_board", "clearcoat_blend")
RATE, VIEWS, SIZE, AVERAGED = "r04", 4, 512, 2
SKY_SIZE = 1024, 512  # of the sky as a map; PMREMGenerator makes cubes of a quarter of its width
ALIKE = ("roughness", "occlusion", "diffuse", "bounces", "mirror", "coat", "colours", "frames")


@dataclass(frozen=True)
class Shown:
    """Pictures of one asset: uint8 [H, W, 3] over white for each view, and bool [H, W], where a pixel is covered."""

    images: list
    covered: list


def light_of(name):
    """The Environment that both renderers stand in: all of the daylight, its sky alone, or its lights alone. The lights have no
    radius, as those of three.js have none."""
    lights = tuple(replace(light, radius=0.0) for light in DAYLIGHT.lights)
    if name == "sky":
        return replace(DAYLIGHT, lights=())
    return replace(DAYLIGHT, lights=lights, gradient=DAYLIGHT.gradient * (name != "lights"))


def sky_map(environment, size=SKY_SIZE):
    """The sky as float32 [H, W, 4], linear RGBA by longitude and latitude, the nadir first; None where it is black."""
    if not environment.gradient.any():
        return None
    width, height = size
    up = np.sin(((np.arange(height) + 0.5) / height - 0.5) * np.pi)
    row = environment.radiance(np.stack([np.zeros(height), up, np.zeros(height)]))
    out = np.ones((height, width, 4), np.float32)
    out[..., :3] = np.maximum(row, 0).T[:, None]
    return out


def cameras_of(scene, views, size):
    """Cameras of compare_views() about a reference."""
    centre, radius = bounding_sphere(scene.positions)
    return [orthographic(fibonacci_direction(i, views), centre, radius, size) for i in range(views)]


def told_camera(camera):
    """A Camera as three_check.mjs takes it."""
    axes = {name: getattr(camera, name).tolist() for name in ("right", "up", "forward", "eye")}
    return axes | {"half": camera.half, "depth": camera.half}


def told_lights(environment):
    """Lights of an Environment as three_check.mjs takes them; three.js, too, counts irradiance."""
    return [{"direction": light.direction.tolist(), "colour": light.irradiance.tolist()} for light in environment.lights]


def told_sky(environment, folder):
    """The sky of an Environment as three_check.mjs takes it, its map in a file of the folder; None where it is black."""
    sky = sky_map(environment)
    if sky is None:
        return None
    sky.tofile(folder / "sky.f32")
    return {"width": SKY_SIZE[0], "height": SKY_SIZE[1], "file": "sky.f32"}


def ours(scene, cameras, look, averaged=1):
    """Shown by our renderer."""
    draw, out = renderer(scene, look), Shown([], [])
    for camera in cameras:
        picture = draw(camera)
        covered = np.zeros(camera.height * camera.width, bool)
        covered[picture.pixel] = True
        _add(out, picture.image(), covered.reshape(camera.height, camera.width), averaged)
    return out


def theirs(folder, name, views, size, averaged=1):
    """Shown by three.js, from what three_check.mjs wrote. size: of the drawn pictures."""
    out = Shown([], [])
    for view in range(views):
        raw = np.fromfile(folder / f"{name}-{view}.rgba", np.uint8).reshape(size, size, 4)[::-1]
        _add(out, raw[..., :3], raw[..., 3] > 0, averaged)
    return out


def _add(shown, image, covered, averaged):
    """Adds a view, `averaged` samples a side to a pixel, which counts as covered where all of them are."""
    if averaged > 1:
        blocks = covered.reshape(len(covered) // averaged, averaged, -1, averaged)
        image, covered = box_down(image, averaged), blocks.all(axis=(1, 3))
    shown.images.append(image)
    shown.covered.append(covered)


def agreement(one, other):
    """PSNR Y in dB of two Shown, pooled over the pixels of all views that both cover, and the share of those that either does."""
    error, either = ColourError(), 0
    for a, b, here, there in zip(one.images, other.images, one.covered, other.covered, strict=True):
        both = here & there
        either += int((here | there).sum())
        error.add(a[both], b[both])
    return decibels(error.mse()["y"], 255.0), error.samples / max(either, 1)


def draw_theirs(pairs, cameras, environment, args):
    """Draws pairs {name: (source, decoded)} with three.js into args.out; returns what three_check.mjs told."""
    modules = args.modules or node_modules(args.out)
    if modules is None or not shutil.which("node"):
        raise SystemExit("three.js cannot be had: node or npm is missing")
    work = args.out / "three"
    work.mkdir(parents=True, exist_ok=True)
    files = []
    for name, pair in pairs.items():
        for kind, path in zip(("source", "decoded"), pair, strict=True):
            shutil.copyfile(path, work / f"{name}-{kind}.glb")
            files.append({"name": f"{name}-{kind}", "path": f"{name}-{kind}.glb", "cameras": name})
    told = {name: [told_camera(one) for one in found] for name, found in cameras.items()}
    job = {"root": str(work.resolve()), "size": args.size * args.averaged, "filter": "mipmaps" if args.mipmaps else "linear",
           "alike": args.alike, "sky": told_sky(environment, work), "lights": told_lights(environment), "files": files,
           "cameras": told}
    (work / "job.json").write_text(json.dumps(job), encoding="utf-8")
    done = subprocess.run(["node", PAGE, work.resolve() / "job.json", work.resolve()], cwd=modules, env=os.environ)
    if done.returncode:
        raise SystemExit("the browser failed: no pictures")
    return json.loads((work / "told.json").read_text(encoding="utf-8"))


def coded(assets, args):
    """{name: (source, decoded)} of assets; what stands in the folder already is not coded again."""
    found = {}
    for name in assets:
        source, stream, mesh = args.assets / f"{name}.glb", args.out / f"{name}.texf", args.out / f"{name}.glb"
        found[name] = source, mesh
        if mesh.exists():
            continue
        for words in (["enc", "--quiet", "--rate", args.rate, source, stream], ["dec", "--quiet", stream, mesh]):
            subprocess.run([sys.executable, "-m", f"texfcodec.cli.{words[0]}", *words[1:]], check=True)
    return found


def sheet(folder, name, shown):
    """Keeps the views of one asset: side by side what the Shown of each name in `shown` has."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for view, row in enumerate(zip(*(one.images for one in shown.values()), strict=True)):
        Image.fromarray(np.hstack(row)).save(folder / f"{name}-{view}.png")


def row_of(name, scenes, cameras, environment, args):
    """A line of the table."""
    look = Look(environment=environment, mipmaps=args.mipmaps)
    shown, side = {}, args.size * args.averaged
    for kind, scene in zip(("source", "decoded"), scenes, strict=True):
        shown[f"ours-{kind}"] = ours(scene, cameras, look, args.averaged)
        shown[f"three-{kind}"] = theirs(args.out / "three", f"{name}-{kind}", args.views, side, args.averaged)
    if args.pictures:
        sheet(args.out / "pictures", name, shown)
    here, there = (agreement(shown[f"{kind}-source"], shown[f"{kind}-decoded"])[0] for kind in ("ours", "three"))
    both = [agreement(shown[f"ours-{kind}"], shown[f"three-{kind}"]) for kind in ("source", "decoded")]
    return (f"| {name} | {in_decibels(here)} | {in_decibels(there)} | {there - here:+.2f} | {in_decibels(both[0][0])} "
            f"| {in_decibels(both[1][0])} | {100 * both[0][1]:.1f} % |")


def arguments_of(words):
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("assets", type=Path, nargs="?")
    parser.add_argument("--only", action="append", metavar="NAME", help="an asset; repeatable")
    parser.add_argument("--pair", action="append", nargs=2, type=Path, default=[], metavar=("SOURCE.glb", "DECODED.glb"))
    parser.add_argument("--rate", default=RATE)
    parser.add_argument("--light", choices=("daylight", "sky", "lights"), default="daylight")
    parser.add_argument("--alike", action="append", default=[], choices=(*ALIKE, "all"),
                        help="what three.js is made to do as we do; repeatable")
    parser.add_argument("--views", type=int, default=VIEWS)
    parser.add_argument("--size", type=int, default=SIZE)
    parser.add_argument("--averaged", type=int, default=AVERAGED, metavar="N", help="samples a side that a pixel is the mean of")
    parser.add_argument("--mipmaps", action="store_true", help="both ask minified maps at mip levels; without it, neither does")
    parser.add_argument("--pictures", action="store_true", help="keep each view: source by ours and theirs, then decoded")
    parser.add_argument("--out", type=Path, default=Path("out/three"), metavar="FOLDER")
    parser.add_argument("--modules", type=Path, metavar="FOLDER", help="holds node_modules with three and playwright-core")
    args = parser.parse_args(words)
    args.alike = list(ALIKE) if "all" in args.alike else args.alike
    if not (args.assets or args.pair):
        parser.error("give a folder of assets, or pairs")
    return args


def main(arguments=None):
    """Command line of the tool."""
    args = arguments_of(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    pairs = {f"{n}-{pair[0].stem}": tuple(pair) for n, pair in enumerate(args.pair)}
    if args.assets:
        pairs |= coded(args.only or ASSETS_SHOWN, args)
    scenes = {name: [load(path) for path in pair] for name, pair in pairs.items()}
    cameras = {name: cameras_of(pair[0], args.views, args.size * args.averaged) for name, pair in scenes.items()}
    environment = light_of(args.light)
    told = draw_theirs(pairs, cameras, environment, args)
    print(f"three.js r{told['revision']}, {args.light}, alike: {' '.join(args.alike) or 'nothing'}, {args.views} views of "
          f"{args.size}, {args.averaged} x {args.averaged} samples\n")
    print("| asset | ours: source, decoded | three.js: source, decoded | three.js less ours | sources: ours, three.js "
          "| decoded: ours, three.js | covered by both |\n|---|---|---|---|---|---|---|")
    for name in pairs:
        print(row_of(name, scenes[name], cameras[name], environment, args), flush=True)


if __name__ == "__main__":
    main()
