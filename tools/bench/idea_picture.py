"""A picture of the idea for README.md: the demo asset, the voxels that its surface touches, its stream, and what is decoded.

python tools/bench/idea_picture.py OUT.png
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import texfcodec
from texfcodec.demo.asset import make_sample
from texfcodec.render.camera import bounding_sphere, direction_of_angles, orthographic
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.shade import render_scene, render_texf
from texfcodec.scene.scene import Material

SIDE, GAP, COARSE = 360, 70, 72  # pixels; voxels a side in the picture of voxels, few enough to be seen
CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
                  (1, 5, 7), (1, 7, 3)])
INK, GREY = (30, 34, 40), (120, 126, 134)
PARTS = (("geometry", (86, 124, 190)), ("colours and maps", (214, 130, 62)), ("other", (150, 150, 150)))


def main(path):
    """Draw the picture of the codec's idea and write it to path."""
    scene = make_sample()
    encoded = texfcodec.encode_to_result(scene, texfcodec.EncodeOptions(rate="r03"))
    coarse = texfcodec.decode(texfcodec.encode(scene, texfcodec.EncodeOptions(resolution=COARSE, qp=22, keep_mesh=True)))
    camera = orthographic(direction_of_angles(30, 25), *bounding_sphere(scene.positions), 2 * SIDE)
    views = [(render_scene(scene, camera, shaded=DAYLIGHT), "a textured mesh", "1.6 MB as a GLB"),
             (render_scene(cubes(coarse), camera), "values where its surface is", "in voxels, or in an image's texels"),
             (None, "one stream", f"{len(encoded.data) / 1000:,.0f} kB"),
             (render_texf(texfcodec.decode(encoded.data), camera, shaded=DAYLIGHT), "decoded anywhere", "GLB, browser, GPU")]
    picture = Image.new("RGB", (4 * SIDE + 3 * GAP, SIDE + 76), "white")
    draw = ImageDraw.Draw(picture)
    for number, (view, title, below) in enumerate(views):
        left = number * (SIDE + GAP)
        if view is None:
            draw_stream(draw, left, encoded.sizes)
        else:
            picture.paste(Image.fromarray(view.image()).resize((SIDE, SIDE), Image.Resampling.LANCZOS), (left, 0))
        for text, size, ink, top in ((title, 23, INK, SIDE + 8), (below, 19, GREY, SIDE + 42)):
            draw.text((left + SIDE / 2, top), text, ink, ImageFont.load_default(size), "ma")
        if number:
            tip, y = left - GAP / 2 + 18, SIDE / 2
            draw.line((tip - 40, y, tip - 12, y), GREY, 6)
            draw.polygon([(tip, y), (tip - 16, y - 12), (tip - 16, y + 12)], GREY)
    picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)


def cubes(texf):
    """Return a Scene that shows the voxels of a Texf: a cube for each, in its colour."""
    side, faces, positions, colours = texf.side / COARSE, [], [], []
    for field in texf.fields:
        place = np.asarray(texf.origin) + field.support.xyz() * side
        faces.append(SIDES[None] + 8 * (np.arange(len(place)) + sum(map(len, positions)) // 8)[:, None, None])
        positions.append((place[:, None] + CUBE * side * 0.94).reshape(-1, 3))
        colours.append(np.repeat(field.rgba / 255, 12, axis=0))
    faces, colours = np.concatenate(faces).reshape(-1, 3), np.concatenate(colours)
    shade = np.tile(np.repeat([0.72, 0.95, 0.85, 0.62, 1.0, 0.8], 2), len(faces) // 12)[:, None]
    colours = np.column_stack([(colours[:, :3] * shade) ** 2.2, np.ones(len(colours))])
    return texfcodec.Scene(positions=np.concatenate(positions), faces=faces, face_material=np.zeros(len(faces), np.int64),
                           corner_uv=np.zeros((len(faces), 3, 2)), textures=[],
                           corner_color=np.repeat(colours[:, None], 3, 1).astype(np.float32), materials=[Material("voxels")])


def draw_stream(draw, left, sizes):
    """Draw a bar that shows how the bytes of a stream divide. draw: of PIL; left: x of its left end; sizes: bytes by name."""
    total, top = sum(sizes[key] for key in ("geometry", "attributes", "other")), 30
    for (name, ink), size in zip(PARTS, (sizes["geometry"], sizes["attributes"], sizes["other"]), strict=True):
        height = max(round(size / total * (SIDE - 60)), 3)
        draw.rectangle((left + SIDE / 2 - 45, top, left + SIDE / 2 + 45, top + height), fill=ink)
        if size / total > 0.1:
            text = f"{name}\n{size / 1000:.0f} kB"
            draw.text((left + SIDE / 2 + 58, top + height / 2), text, ink, ImageFont.load_default(17), "lm")
        top += height
    draw.rectangle((left + SIDE / 2 - 45, 30, left + SIDE / 2 + 45, SIDE - 30), outline=INK, width=2)


if __name__ == "__main__":
    main(sys.argv[1])
