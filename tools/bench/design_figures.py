"""Figures of docs/design: of the demo asset, a generated scan, and the table of materials.md.

python tools/bench/design_figures.py [NAME ...]     writes into docs/design/pictures; needs the extra texfcodec[plots]
"""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests")]

import texfcodec  # noqa: E402
from texfcodec.bitstream.inspect import inspect  # noqa: E402
from texfcodec.demo.asset import TRAY, make_sample  # noqa: E402
from texfcodec.io.load import load  # noqa: E402
from texfcodec.render.camera import bounding_sphere, direction_of_angles, orthographic  # noqa: E402
from texfcodec.render.environment import DAYLIGHT  # noqa: E402
from texfcodec.render.shade import box_down, render_scene, render_texf  # noqa: E402
from texfcodec.scene.scene import Material  # noqa: E402
from tools.bench.idea_picture import COARSE, cubes  # noqa: E402
from tools.bench.plots import load_pyplot  # noqa: E402

WIDTH, DPI = 5.2, 160  # inches, in which labels of 10 points are read in a narrow window as well
FOLDER = REPOSITORY / "docs" / "design" / "pictures"
COLOURS = ("#5577bb", "#d6823e", "#6a9a58", "#a3619e", "#8a8f96")
PALE, INK = "#d9dce1", "#1e2228"
ASSETS = {"damaged_helmet": "helmet", "cat_webp": "cat", "vintage_fan": "fan", "waterbottle_pbr": "bottle", "avocado": "avocado"}
CHANNELS = {"base_colour": "base colour", "normal": "normals", "roughness": "roughness, metallic", "occlusion": "occlusion",
            "emissive": "emission"}
ROW = re.compile(r"^\| (\w+) \| (\w+) \| \d+ coded[^|]*\| (\d+)", re.M)
SOURCE, R03 = make_sample(), texfcodec.EncodeOptions(rate="r03")


def format_figure(pyplot):
    """Draw the units of the demo asset's stream in their order, as wide as they have bytes."""
    report = inspect(texfcodec.encode(SOURCE, R03))
    figure, axes = pyplot.subplots(figsize=(WIDTH, 2.5), layout="constrained")
    kinds, left = {"geometry": COLOURS[0], "attribute": COLOURS[1]}, 0.0
    values = iter([f"{f['width']}×{f['height']}" if f["width"] else f"K {f['resolution']}" for f in report["fields"]])
    for unit in report["units"]:
        kind = next((name for name in kinds if name in unit["name"]), "other")
        width = unit["size"] / 1000
        axes.barh(0, width, 1, left, color=kinds.get(kind, COLOURS[4]), edgecolor="white", linewidth=0.8)
        label = next(values) if kind == "attribute" else ""
        if width > 8 and label:
            axes.text(left + width / 2, 0, f"{label}\n{width:.0f} kB", ha="center", va="center", color="white", fontsize=8)
        left += width
    sizes = report["bytes"]
    for at, height, side, text, colour in (
            (0, 0.6, "left", "meshes: UVs coded\nin one of two ways", COLOURS[0]),
            (left, 0.62, "right", "values: over voxels or texels,\ncontexts mixed or direct", COLOURS[1]),
            (0, -0.95, "left", f"header, {len(report['materials'])} materials, end: {sizes['other']} bytes", INK)):
        axes.text(at, height, text, ha=side, color=colour, fontsize=10)
    axes.set(ylim=(-1.1, 1.3), xlim=(0, left), yticks=[], xlabel="kB of the stream, in its order")
    return figure


def materials_figure(pyplot):
    """Draw the bytes by channel of materials.md's table."""
    rows = ROW.findall((REPOSITORY / "docs/design/materials.md").read_text(encoding="utf-8"))
    size = {(asset, channel): int(count) / 1000 for asset, channel, count in rows}
    figure, axes = pyplot.subplots(figsize=(WIDTH, 2.8), layout="constrained")
    left = np.zeros(len(ASSETS))
    for (channel, label), colour in zip(CHANNELS.items(), COLOURS, strict=True):
        widths = np.array([size.get((asset, channel), 0) for asset in ASSETS])
        axes.barh(list(ASSETS.values()), widths, 0.7, left, color=colour, label=label)
        left += widths
    axes.invert_yaxis()
    axes.set_xlabel("kB of values at r03")
    axes.legend(frameon=False, loc="lower right")
    return figure


def mesh_figure(pyplot):
    """Draw the edges of a generated scan and of the mesh that is sent of it."""
    from load.meshes import GENERATORS, glb_of

    source = load(glb_of(GENERATORS["scan with image"](20_000)))
    sent = texfcodec.decode(texfcodec.encode(source, texfcodec.EncodeOptions(rate="r01", effort="fast")))
    camera = orthographic(direction_of_angles(30, 20), *bounding_sphere(source.positions), 2)
    figure, panels = pyplot.subplots(1, 2, figsize=(WIDTH, 2.5), layout="constrained")
    for axes, mesh, name in zip(panels, (source, sent), ("source", "sent at r01"), strict=True):
        corners = (mesh.positions - source.positions.mean(axis=0))[mesh.faces]
        x, y = corners @ camera.right, corners @ camera.up
        front = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) > (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
        axes.triplot(x[front].ravel(), y[front].ravel(), np.arange(3 * front.sum()).reshape(-1, 3), color=COLOURS[0], lw=0.8)
        half = np.abs(x).max() * 0.2
        axes.set(xlim=(-half, half), ylim=(-half * 0.7, half * 0.7), xticks=[], yticks=[], aspect="equal")
        axes.set_title(f"{name}: {len(mesh.faces):,} faces", fontsize=11)
    return figure


def texels_figure(pyplot):
    """Draw an image with the texels that the surface shows, and the voxels that stand for the same surface."""
    texf = texfcodec.decode(texfcodec.encode(SOURCE, R03))
    image = SOURCE.textures[SOURCE.materials[TRAY].texture].image
    field = next(f for f in texf.fields if f.over_texels and (f.support.height, f.support.width) == image.shape[:2])
    shown, (column, row) = np.full((*image.shape[:2], 3), 217, np.uint8), field.support.xy().T
    shown[row, column] = field.rgba[:, :3]
    voxels = texfcodec.decode(texfcodec.encode(SOURCE, texfcodec.EncodeOptions(resolution=COARSE, qp=22, keep_mesh=True)))
    camera = orthographic(direction_of_angles(30, 50), *bounding_sphere(SOURCE.positions), 800)
    figure, panels = pyplot.subplots(1, 2, figsize=(WIDTH, 2.3), layout="constrained", width_ratios=(3, 2))
    share = len(column) / image[..., 0].size
    panels[0].imshow(shown)
    panels[0].set_title(f"{share:.0%} of an image's texels")
    panels[1].imshow(box_down(render_scene(cubes(voxels), camera).image(), 2)[40:360, 40:360])
    panels[1].set_title(f"{sum(len(f.support.keys) for f in voxels.fields):,} voxels")
    for axes in panels:
        axes.axis("off")
    return figure


def shading_figure(pyplot):
    """Draw the demo asset's base colour, and its shape in light with the normals of faces and with those of the rule."""
    clay = [Material(m.name, np.array([0.6, 0.58, 0.55, 1])) for m in SOURCE.materials]
    plain = replace(SOURCE, materials=clay, textures=[], corner_color=None, flat=True)
    camera = orthographic(direction_of_angles(20, 12), (0.085, 0.024, 0.085), 0.032, 720)
    ruled = texfcodec.decode(texfcodec.encode(replace(plain, flat=False), texfcodec.EncodeOptions(rate="r03", keep_mesh=True)))
    views = {"base colour": render_scene(SOURCE, camera), "normals of faces": render_scene(plain, camera, shaded=DAYLIGHT),
             "by the rule": render_texf(ruled, camera, shaded=DAYLIGHT)}
    figure, panels = pyplot.subplots(1, 3, figsize=(WIDTH, 2.0), layout="constrained")
    for axes, (name, view) in zip(panels, views.items(), strict=True):
        axes.imshow(box_down(view.image(), 2))
        axes.set_title(name, fontsize=10)
        axes.axis("off")
    return figure


FIGURES = {"format": format_figure, "materials": materials_figure, "mesh": mesh_figure, "shading": shading_figure,
           "texels": texels_figure}
PHOTOGRAPHS = ("shading", "texels")  # are written as JPEG


def main(names):
    """Write the named figures, all without names."""
    pyplot = load_pyplot()
    if pyplot is None:
        raise SystemExit(1)
    pyplot.rcParams.update({"text.color": INK, "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": PALE})
    for name in names or FIGURES:
        path = FOLDER / f"{name}{'.jpg' if name in PHOTOGRAPHS else '.png'}"
        FIGURES[name](pyplot).savefig(path, dpi=DPI, **({"pil_kwargs": {"quality": 70}} if name in PHOTOGRAPHS else {}))
        if name not in PHOTOGRAPHS:
            with Image.open(path) as picture:
                small = picture.convert("RGB").quantize(12, dither=Image.Dither.NONE)
            small.save(path, optimize=True)
        print(path.name, path.stat().st_size)


if __name__ == "__main__":
    main(sys.argv[1:])
