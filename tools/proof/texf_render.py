"""TEXFLoader against texf-render: both draw streams from the same cameras, flat or in the same light.

python tools/proof/texf_render.py STREAM.texf ... [--light flat|daylight|sky|lights] [--views N] [--size PIXELS] [--least DB]
                                            [--samples N] [--pictures] [--out FOLDER] [--modules FOLDER]

three.js, playwright-core and a Chromium are needed (three_page.mjs); --modules names a folder with node_modules, else npm
installs them into OUT. A Markdown table goes to stdout: PSNR over the pixels of all views that both cover, as texf-eval takes
it. Exits 7 where a stream has less than --least. --samples says which of the two is nearer to a picture of N x N samples a pixel
by texf-render: where they differ in how they filter on a slope, that is the judge.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec import decode
from texfcodec.core.colour_error import ColourError, in_decibels
from texfcodec.metrics.views import Look
from tools.proof.strangers.run import node_modules
from tools.proof.three_check import PAGE, cameras_of, light_of, ours, sheet, theirs, told_camera, told_lights, told_sky

SOURCES = Path(__file__).resolve().parents[2] / "js" / "src"
VIEWS, SIZE, LEAST = 4, 1024, 45.0


def draw_theirs(streams, cameras, environment, args):
    """Draws streams {name: path} with three.js into args.out / "three"; returns what three_check.mjs told."""
    modules = args.modules or node_modules(args.out)
    if modules is None or not shutil.which("node"):
        raise SystemExit("three.js cannot be had: node or npm is missing")
    work = args.out / "three"
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(SOURCES, work / "js" / "src")
    for name, path in streams.items():
        shutil.copyfile(path, work / f"{name}.texf")
    job = {"root": str(work.resolve()), "size": args.size, "filter": "mipmaps", "alike": [], "flat": environment is None,
           "sky": environment and told_sky(environment, work), "lights": told_lights(environment) if environment else [],
           "files": [{"name": name, "path": f"{name}.texf", "cameras": name} for name in streams],
           "cameras": {name: [told_camera(one) for one in found] for name, found in cameras.items()}}
    (work / "job.json").write_text(json.dumps(job), encoding="utf-8")
    done = subprocess.run(["node", PAGE, work.resolve() / "job.json", work.resolve()], cwd=modules, env=os.environ)
    if done.returncode:
        raise SystemExit("the browser failed: no pictures")
    return json.loads((work / "told.json").read_text(encoding="utf-8"))


def agreement(one, other):
    """PSNR in dB of R, G and B together and of Y, over the pixels of all views that both Shown cover; the share of pixels covered
    by either that both cover; and the share that differs by more than 8 of 255."""
    error, either, far = ColourError(), 0, 0
    for a, b, here, there in zip(one.images, other.images, one.covered, other.covered, strict=True):
        both = here & there
        either += int((here | there).sum())
        far += int((np.abs(a[both].astype(np.int16) - b[both]).max(axis=1) > 8).sum())
        error.add(a[both], b[both])
    result = error.result()
    return result["psnr_rgb"], result["psnr_y"], error.samples / max(either, 1), far / max(error.samples, 1)


def arguments_of(words):
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("streams", type=Path, nargs="+", metavar="STREAM.texf")
    parser.add_argument("--light", choices=("flat", "daylight", "sky", "lights"), default="flat")
    parser.add_argument("--views", type=int, default=VIEWS)
    parser.add_argument("--size", type=int, default=SIZE)
    parser.add_argument("--least", type=float, default=LEAST, metavar="DB")
    parser.add_argument("--samples", type=int, metavar="N", help="both, too, against pictures of N x N samples a pixel")
    parser.add_argument("--pictures", action="store_true", help="keep each view: ours and theirs")
    parser.add_argument("--out", type=Path, default=Path("out/texf_render"), metavar="FOLDER")
    parser.add_argument("--modules", type=Path, metavar="FOLDER", help="holds node_modules with three and playwright-core")
    return parser.parse_args(words)


def main(arguments=None):
    """Command line of the tool."""
    args = arguments_of(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    streams = {path.stem: path for path in args.streams}
    assets = {name: decode(path) for name, path in streams.items()}
    cameras = {name: cameras_of(asset, args.views, args.size) for name, asset in assets.items()}
    environment = None if args.light == "flat" else light_of(args.light)
    told, missed = draw_theirs(streams, cameras, environment, args), 0
    print(f"three.js r{told['revision']}, {args.light}, {args.views} views of {args.size}\n")
    titles = ["stream", "PSNR RGB", "PSNR Y", "covered by both", "far off"]
    titles += [f"ours to {args.samples} x {args.samples} samples", "three.js to them"] if args.samples else []
    print(f"| {' | '.join(titles)} |\n|---|{'---:|' * (len(titles) - 1)}")
    for name, asset in assets.items():
        look = Look(environment=environment, mipmaps=True)
        here = ours(asset, cameras[name], look)
        there = theirs(args.out / "three", name, args.views, args.size)
        rgb, y, covered, far = agreement(here, there)
        missed += rgb < args.least
        if args.pictures:
            sheet(args.out / "pictures", name, {"ours": here, "theirs": there})
        more = ""
        if args.samples:
            fine = ours(asset, cameras_of(asset, args.views, args.size * args.samples), look, args.samples)
            more = "".join(f" {in_decibels(agreement(fine, one)[0])} |" for one in (here, there))
        print(f"| {name} | {in_decibels(rgb)} | {in_decibels(y)} | {100 * covered:.2f} % | {100 * far:.2f} % |{more}", flush=True)
    return 7 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
