"""A sheet of pictures: for every asset its source, its decoded streams at several rates, and a difference heat map.

    python tools/bench/pictures.py ASSET[@VIEW] ... --out SHEET.jpg [--rates r01,r03,r06] [--size 320]

One row an asset: the source, then each rate with its bytes (geometry left out) and the 3D-PSNR of Y, then how far the middle rate
is from the source, with the scale of texf-render --compare. VIEW is a name or AZIMUTH,ELEVATION in degrees. Rendered by
texfcodec's own renderer, 2 x 2 pixels averaged to one.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.api import decode, encode_to_result
from texfcodec.io.load import load
from texfcodec.metrics.psnr_3d import SourceSamples
from texfcodec.options import EncodeOptions
from texfcodec.render.backdrop import GREY
from texfcodec.render.camera import VIEWS, bounding_sphere, direction_of_angles, orthographic
from texfcodec.render.difference import compare, sheet
from texfcodec.render.shade import box_down, render_scene, render_texf

OVERSAMPLING, SAMPLES, QUALITY = 2, 300_000, 88


def row(path, view, rates, size):
    """Draw an asset, its streams at rates and a difference, uint8 [H, W, 3]. view: name or "azimuth,elevation" in degrees."""
    scene = load(path)
    direction = VIEWS[view] if view in VIEWS else direction_of_angles(*map(float, view.split(",")))
    camera = orthographic(direction, *bounding_sphere(scene.positions[np.unique(scene.faces)]), size * OVERSAMPLING)
    samples, source, seen, captions = SourceSamples(scene, SAMPLES, 1), render_scene(scene, camera), [], [f"source: {path.stem}"]
    for rate in rates:
        coded = encode_to_result(scene, EncodeOptions(rate=rate))
        texf = decode(coded.data)
        seen.append(render_texf(texf, camera))
        captions.append(f"{rate}: {coded.sizes['total'] - coded.sizes['geometry']:,} B, {samples.compare(texf)['y']:.1f} dB")
    middle = len(rates) // 2
    _, heat = compare(source, seen[middle], around=GREY)
    panels = [box_down(image, OVERSAMPLING) for image in (source.image(GREY), *(p.image(GREY) for p in seen), heat)]
    return sheet(panels, [*captions, f"difference of {rates[middle]}"], GREY)


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("assets", nargs="+", metavar="ASSET[@VIEW]")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rates", default="r01,r03,r06")
    parser.add_argument("--size", type=int, default=320)
    args = parser.parse_args(arguments)
    rows = []
    for asset in args.assets:
        path, _, view = asset.partition("@")
        rows.append(row(Path(path), view or "front", args.rates.split(","), args.size))
    Image.fromarray(np.concatenate(rows)).save(args.out, quality=QUALITY)


if __name__ == "__main__":
    main()
