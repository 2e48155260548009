"""A sheet of pictures: for every asset its source, its decoded streams at several rates, and a difference heat map.

python tools/bench/pictures.py ASSET... --out SHEET.jpg [--rates r01,r03,r06] [--view front] [--size 320]

One row an asset: the source, then each rate with its bytes (geometry left out) and the 3D-PSNR of Y, then how far the middle rate
is from the source, with the scale of texf-render --compare. Rendered by texfcodec's own renderer, 2 x 2 pixels averaged to one.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.load import load
from texfcodec.metrics.psnr_3d import SourceSamples
from texfcodec.options import RATES, DecodeOptions, EncodeOptions, default_threads
from texfcodec.render.backdrop import GREY
from texfcodec.render.camera import VIEWS, bounding_sphere, direction_of_angles, orthographic
from texfcodec.render.difference import compare, sheet
from texfcodec.render.shade import box_down, render_scene, render_texf
from texfcodec.report import Report

OVERSAMPLING, SAMPLES, QUALITY = 2, 300_000, 88


def coded(scene, rate, samples, threads):
    """(Texf, caption) of one rate."""
    report = Report()
    made = encode_scene(scene, EncodeOptions(rate=rate, threads=threads), report)
    data, sizes = made.data, made.sizes
    texf = decode(data, DecodeOptions(threads=threads))
    psnr = samples.compare(texf)["y"]
    return texf, f"{rate}: {sizes['total'] - sizes['geometry']:,} B, {psnr:.1f} dB"


def row(path, rates, direction, size, threads):
    """The pictures of one asset, uint8 [H, W, 3]."""
    scene = load(path)
    samples = SourceSamples(scene, SAMPLES, threads)
    camera = orthographic(direction, *bounding_sphere(scene.positions[np.unique(scene.faces)]), size * OVERSAMPLING)
    source, streams = render_scene(scene, camera, threads=threads), [coded(scene, r, samples, threads) for r in rates]
    seen = [render_texf(texf, camera, threads=threads) for texf, _ in streams]
    middle = len(rates) // 2
    _, heat = compare(source, seen[middle], around=GREY)
    panels = [box_down(image, OVERSAMPLING) for image in (source.image(GREY), *(p.image(GREY) for p in seen), heat)]
    captions = [f"source: {path.stem}", *(caption for _, caption in streams), f"difference of {rates[middle]}"]
    return sheet(panels, captions, GREY)


def direction_of(view):
    """Direction to the camera of a named view or AZIMUTH,ELEVATION in degrees."""
    return VIEWS[view] if view in VIEWS else direction_of_angles(*(float(v) for v in view.split(",")))


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("assets", nargs="+", help="a mesh file; PATH@VIEW overrides --view for it")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rates", default="r01,r03,r06", help=f"of {', '.join(RATES)}")
    parser.add_argument("--view", default="front")
    parser.add_argument("--size", type=int, default=320)
    args = parser.parse_args(arguments)
    rows = []
    for asset in args.assets:
        path, _, view = asset.partition("@")
        rows.append(row(Path(path), args.rates.split(","), direction_of(view or args.view), args.size, default_threads()))
    Image.fromarray(np.concatenate(rows)).save(args.out, quality=QUALITY)


if __name__ == "__main__":
    main()
