"""The picture at the head of README.md: the demo asset, what .texf gives back, and Draco with AVIF in the same bytes.

python tools/bench/opening_picture.py OUT.jpg [RATE]

The rival is the closest in light of all that fit our bytes: UVs of 10 or 12 bits, images whole or halved, AVIF of speed 6 and
the better subsampling, at the highest quality that fits. Its bytes are those of Draco's mesh and of the images alone.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import texfcodec
from texfcodec.demo.asset import make_sample, write_or_explain
from texfcodec.metrics.views import KeptViews, ViewSettings
from texfcodec.render.camera import bounding_sphere, direction_of_angles, orthographic
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.shade import box_down, render_scene, render_texf
from tools.bench.ladders import Textured
from tools.bench.methods import image_codecs, uv

SIDE, GAP, TEXT, OVERSAMPLING = 400, 14, 116, 3  # pixels; TEXT: height of a panel's two lines
FAR, NEAR = (0.0, -0.03, 0.88), (0.25, -0.19, 0.2)  # of the bounding sphere's radius: right, up, and half of a picture
ANGLES, PAPER, INK, GREY = (30, 25), (238, 240, 243), (24, 28, 34), (84, 91, 100)


def main(path, rate="r02"):
    """Draw the picture at a rate and write it to path; print bytes and PSNR in light."""
    scene = make_sample()
    views = KeptViews(scene, 8, 512, ViewSettings(environment=DAYLIGHT))
    with tempfile.TemporaryDirectory() as folder:
        glb = Path(folder) / "source.glb"
        write_or_explain(glb)
        data = texfcodec.encode(scene, texfcodec.EncodeOptions(rate=rate))
        ours, source = texfcodec.decode(data), glb.stat().st_size
        closeness, size, rival, how = best_rival(scene, len(data), views, Path(folder))
    print(f".texf {rate} {len(data)} bytes {psnr(views, ours):.2f} dB; rival {size} bytes {closeness:.2f} dB, {how}")
    columns = [(scene, "Source, GLB", f"{source / 1000:,.0f} kB"),
               (ours, ".texf", f"{len(data) / 1000:.0f} kB, {psnr(views, ours):.1f} dB"),
               (rival, "Draco + AVIF", f"{size / 1000:.0f} kB, {closeness:.1f} dB")]
    sheet_of(columns, bounding_sphere(scene.positions)).save(path, quality=84, optimize=True, progressive=True)


def psnr(views, asset):
    """Return the PSNR of Y in light against KeptViews, in dB."""
    return views.compare(asset)["psnr"]["y"]


def best_rival(scene, most, views, folder):
    """Return (PSNR in light, bytes, Scene, options in words) of the closest rival within most bytes. folder: for its files."""
    candidates = []
    for bits in (10, 12):
        for scale in (1.0, 0.5):
            options = uv.DEFAULTS | {"codec": "avif6", "chroma": "best", "quality": 60, "colour_bits": 8, "uv_bits": bits,
                                     "scale": scale}
            textured, coded, quality = Textured(scene, options, folder), None, 0
            for step in (64, 32, 16, 8, 4, 2, 1):  # the highest quality whose bytes fit
                tried = [image_codecs.enc_image(image, "avif6", min(quality + step, 100), chroma)
                         for image, chroma in textured.images]
                if quality + step <= 100 and textured.size + sum(map(len, tried)) <= most:
                    coded, quality = tried, quality + step
            if coded:
                images = [image_codecs.dec_image(part, "avif6", *image.shape[1::-1])
                          for part, (image, _) in zip(coded, textured.images, strict=True)]
                asset = uv.scene_of(textured.layout, textured.mesh, images)
                candidates.append((psnr(views, asset), textured.size + sum(map(len, coded)), asset,
                              f"UVs of {bits} bits, images at {scale:g}, quality {quality}"))
    return max(candidates, key=lambda candidate: candidate[0])


def sheet_of(columns, sphere):
    """Return the picture. columns: [(Scene or Texf, title, line below)]; sphere: (centre, radius) of the source."""
    width = len(columns) * (SIDE + GAP) - GAP
    picture = Image.new("RGB", (width, 2 * SIDE + GAP + TEXT), PAPER)
    draw = ImageDraw.Draw(picture)
    for number, (asset, title, below) in enumerate(columns):
        left = number * (SIDE + GAP)
        for row, (right, up, half) in enumerate((FAR, NEAR)):
            picture.paste(Image.fromarray(drawn(asset, sphere, right, up, half)), (left, row * (SIDE + GAP)))
        for text, size, ink, top in ((title, 48, INK, 4), (below, 40, GREY, 60)):
            draw.text((left + SIDE / 2, 2 * SIDE + GAP + top), text, ink, ImageFont.load_default(size), "ma")
    return picture


def drawn(asset, sphere, right, up, half):
    """Return a picture in light, uint8 [SIDE, SIDE, 3]. sphere: (centre, radius); right, up, half: in radii."""
    direction, (centre, radius) = direction_of_angles(*ANGLES), sphere
    aim = orthographic(direction, centre, radius, SIDE)
    centre = np.asarray(centre) + radius * (right * aim.right + up * aim.up)
    camera = orthographic(direction, centre, half * radius, SIDE * OVERSAMPLING)
    render = render_texf if isinstance(asset, texfcodec.Texf) else render_scene
    return box_down(render(asset, camera, shaded=DAYLIGHT).image(PAPER), OVERSAMPLING)


if __name__ == "__main__":
    main(*sys.argv[1:])
