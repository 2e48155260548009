"""The attribute coder on the texels that a surface uses, against AVIF on the whole image.

python tools/bench/texel_coder.py ASSET.glb... [--effort balanced|best] [--qp 22,28,34,40] [--crop N] [--tools | --lossless]
    [--out FILE]

Of each asset the largest base-colour image is taken. Its used texels are those that bilinear interpolation can ask at any point
of a face; they are coded as voxels (x, y, 0). AVIF codes the whole image (Pillow, speed 6, 4:2:0). PSNR is that over the used
texels; bytes are those of the attribute unit's parameters and codewords, and of the AVIF file. Prints a Markdown table of
BD-rates, Y and RGB: as voxels (without what is for planar supports) and as texels.

--tools: a row per tool that is switched off, BD-rate against the complete set, positive: more bytes. --lossless: bytes of
max_error 0 against PNG and lossless WebP, of the whole image and of the image whose unused texels are black. --crop: only the
N x N window with the most used texels, for quick experiments.
"""

import argparse
import io
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.codecs.raht.attribute_coder import dec_attributes, enc_attributes
from texfcodec.codecs.raht.coefficients.residual import ResidualPlan
from texfcodec.codecs.raht.raht_syntax import RAHT
from texfcodec.codecs.raht.raht_values import coded_of, raht_values
from texfcodec.codecs.raht.tool_choice import CHROMA_OFFSETS, EFFORTS, choose_base, choose_tools
from texfcodec.codecs.raht.transform.colour import forward_colour, inverse_colour
from texfcodec.core.colour_error import psnr_3d
from texfcodec.core.kernel import kernel
from texfcodec.core.syntax_walk import write_structure
from texfcodec.field.extents import octree_depth
from texfcodec.field.morton import encode_morton
from texfcodec.field.texel_cover import span_in_band
from texfcodec.io.load import load
from texfcodec.metrics.bd_rate import bd_rate
from texfcodec.scene.scene import WRAP_CLAMP, WRAP_MIRROR, Scene

CHROMA_OFFSET = CHROMA_OFFSETS[True]  # the encoder's own
QPS = "22,28,34,40"
AVIF_QUALITIES = (5, 10, 20, 30, 40, 50, 60, 70, 80, 88, 94)
MEASURES = ("psnr_y", "psnr_rgb")
AS_VOXELS = {"planar": 0, "planar_transform": 0, "component_cross": 0, "dct_blocks": 0, "trade_off": EFFORTS["best"].trade_off}
COMPLETE = "complete set"
CHANGES = {
    COMPLETE: {}, "planar transform off": {"planar_transform": 0}, "DCT blocks off": {"dct_blocks": 0},
    "components do not follow": {"component_cross": 0},
    "lambda of voxels": {"trade_off": AS_VOXELS["trade_off"]}, "all of them off, contexts too": AS_VOXELS,
    "filter off": {"filters": 0}, "colour range off": {"colour_range": 0}, "direct contexts": {"models": 0},
}


@dataclass
class TexelImage:
    """An image and the texels of it that are used. image: uint8 [H, W, 3]; mask: bool [H, W]."""

    name: str
    image: np.ndarray
    mask: np.ndarray

    @property
    def size(self):
        """Resolution of a grid that holds the image."""
        return max(self.mask.shape)

    def texels(self):
        """The used texels: (keys int64 [N], rgb uint8 [N, 3]), in the order of the keys."""
        y, x = np.nonzero(self.mask)
        keys = encode_morton(np.stack([x, y, np.zeros_like(x)], axis=1))
        order = np.argsort(keys)
        return keys[order], self.image[y, x][order]

    def cropped(self, side):
        """The side x side window with the most used texels."""
        height, width = (max(1, n - side + 1) for n in self.mask.shape)
        places = [(y, x) for y in range(0, height, side // 4) for x in range(0, width, side // 4)]
        y, x = max(places, key=lambda p: self.mask[p[0] : p[0] + side, p[1] : p[1] + side].sum())
        return replace(self, image=self.image[y : y + side, x : x + side], mask=self.mask[y : y + side, x : x + side])


@kernel
def _wrapped(i, size, wrap):
    """Texel that an index outside the image stands for."""
    if wrap == WRAP_CLAMP:
        return min(max(i, 0), size - 1)
    if wrap == WRAP_MIRROR:
        i %= 2 * size
        return 2 * size - 1 - i if i >= size else i
    return i % size


@kernel(allocates=True)
def _mark(corners, wrap_s, wrap_t, mask):
    """Marks in mask uint8 [H, W] the texels less than one texel from a face in both directions. corners: float64 [F, 3, 2] in
    texels, texel i centred at i."""
    height, width = mask.shape
    for f in range(corners.shape[0]):
        ax, ay, bx, by, cx, cy = corners[f].ravel()
        top = np.int64(np.floor(min(ay, by, cy)))
        for j in range(top, np.int64(np.floor(max(ay, by, cy))) + 2):
            low, high = span_in_band(ax, ay, bx, by, cx, cy, j - 1.0, j + 1.0)
            if low > high:
                continue
            row = _wrapped(j, height, wrap_t)
            for i in range(np.int64(np.floor(low)), np.int64(np.floor(high)) + 2):
                mask[row, _wrapped(i, width, wrap_s)] = 1


def used_texels(scene: Scene, texture: int) -> np.ndarray:
    """Texels of a texture that bilinear interpolation asks anywhere on the surface: bool [H, W]."""
    image, wrap = scene.textures[texture].image, scene.textures[texture].wrap
    mask = np.zeros(image.shape[:2], np.uint8)
    own = np.isin(scene.face_material, [i for i, m in enumerate(scene.materials) if m.texture == texture])
    _mark(scene.corner_uv[own] * (image.shape[1], image.shape[0]) - 0.5, *wrap, mask)
    return mask.astype(bool)


def load_texels(path: Path) -> TexelImage:
    """The largest base-colour image of an asset and its used texels."""
    scene = load(path)
    used = {m.texture for m in scene.materials if m.texture >= 0}
    texture = max(sorted(used), key=lambda t: scene.textures[t].image.size)
    return TexelImage(path.stem, scene.textures[texture].image[:, :, :3].copy(), used_texels(scene, texture))


def qps_of(qp):
    """QP of each component."""
    return [qp, *[max(qp + CHROMA_OFFSET, 0)] * 2]


def unit_bytes(coded, size):
    """Bytes of an attribute unit's parameters and codewords."""
    return len(write_structure(RAHT, {**raht_values(coded, True), "resolution": size, "NumComponents": 3}))


def chosen_tools(texels, qp, effort, planar=True):
    """The encoder's own choice."""
    keys, rgb = texels.texels()
    return choose_tools(keys, octree_depth(texels.size), forward_colour(rgb), qps_of(qp), effort, 2, planar)


def rate_point(texels, qp, tools):
    """{"bytes", "psnr_y", "psnr_rgb", ...} of one encode. Ends the program where the decoder disagrees."""
    keys, rgb = texels.texels()
    depth = octree_depth(texels.size)
    coded, means = enc_attributes(keys, depth, forward_colour(rgb), qps_of(qp), tools, 2)
    again, spans = coded_of(raht_values(coded, True))
    decoded = dec_attributes(keys, depth, again, np.frombuffer(b"".join(coded.codewords), np.uint8), spans, depth, 2)
    if not np.array_equal(decoded, means):
        raise SystemExit("the decoder's values differ from the encoder's reconstruction")
    return {"bytes": unit_bytes(coded, texels.size), **psnr_3d(rgb, inverse_colour(means))}


def avif_point(texels, quality):
    """The same of AVIF on the whole image."""
    file = io.BytesIO()
    Image.fromarray(texels.image).save(file, "AVIF", quality=quality, speed=6, subsampling="4:2:0")
    decoded = np.array(Image.open(file).convert("RGB"))
    return {"bytes": len(file.getvalue()), **psnr_3d(texels.image[texels.mask], decoded[texels.mask])}


def rate_difference(anchor, points, measure):
    """BD-rate of rate points against others, percent."""
    return bd_rate([p["bytes"] for p in anchor], [p[measure] for p in anchor], [p["bytes"] for p in points],
                   [p[measure] for p in points])


def against_avif(texels, effort, qps):
    """Row of the table: [used share, BD-rate Y and RGB as voxels, the same as texels]."""
    anchor, row = [avif_point(texels, quality) for quality in AVIF_QUALITIES], [100 * texels.mask.mean()]
    for planar in (False, True):
        points = [rate_point(texels, qp, chosen_tools(texels, qp, effort, planar)) for qp in qps]
        row += [rate_difference(anchor, points, measure) for measure in MEASURES]
    return row


def tool_by_tool(texels, effort, qps):
    """{name of the change: [BD-rate Y, RGB]} against the complete set; the kernel stays as the complete set has chosen it."""
    chosen = {qp: chosen_tools(texels, qp, effort) for qp in qps}
    points = {name: [rate_point(texels, qp, replace(tools, **change)) for qp, tools in chosen.items()]
              for name, change in CHANGES.items()}
    return {name: [rate_difference(points[COMPLETE], p, m) for m in MEASURES] for name, p in points.items()}


def lossless_bytes(texels, effort):
    """Bytes: [ours, PNG, PNG with unused texels black, WebP, WebP with unused texels black]."""
    keys, rgb = texels.texels()
    field, plan = (keys, octree_depth(texels.size), forward_colour(rgb)), ResidualPlan(0, rgb, inverse_colour)
    qp, dct_blocks = choose_base(*field, qps_of, plan, effort, 2, True)
    coded, made = enc_attributes(*field, qp, choose_tools(*field, qp, effort, 2, True, dct_blocks), 2, plan)
    if not np.array_equal(made, rgb):
        raise SystemExit("the texels do not come back exactly")
    row = [unit_bytes(coded, texels.size)]
    for settings in ({"format": "PNG", "optimize": True}, {"format": "WEBP", "lossless": True, "quality": 100, "method": 6}):
        for image in (texels.image, texels.image * texels.mask[..., None]):
            file = io.BytesIO()
            Image.fromarray(image).save(file, **settings)
            row.append(len(file.getvalue()))
    return row


def avif_table(rows):
    """Markdown of {asset: against_avif}."""
    rows = {**rows, "mean": np.mean(list(rows.values()), axis=0)}
    lines = ["| asset | used texels, % | as voxels, Y / RGB, % | as texels, Y / RGB, % |", "|---|---|---|---|"]
    lines += [f"| {name} | {used:.0f} | {a:+.1f} / {b:+.1f} | {c:+.1f} / {d:+.1f} |" for name, (used, a, b, c, d) in rows.items()]
    return "\n".join(lines) + "\n"


def tools_table(rows):
    """Markdown of {asset: tool_by_tool}."""
    lines = ["| change | " + " | ".join(rows) + " | mean |", "|---" * (len(rows) + 2) + "|"]
    for change in CHANGES:
        figures = [row[change] for row in rows.values()]
        cells = [f"{y:+.2f} / {rgb:+.2f}" for y, rgb in [*figures, np.mean(figures, axis=0)]]
        lines.append(f"| {change} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def lossless_table(rows):
    """Markdown of {asset: lossless_bytes}."""
    lines = ["| asset | ours | PNG | PNG, unused black | WebP | WebP, unused black |", "|---" * 6 + "|"]
    return "\n".join([*lines, *(f"| {name} | " + " | ".join(f"{n:,}" for n in row) + " |" for name, row in rows.items())]) + "\n"


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("assets", nargs="+", type=Path)
    parser.add_argument("--effort", default="best", choices=EFFORTS)
    parser.add_argument("--qp", default=QPS)
    parser.add_argument("--crop", type=int)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--tools", action="store_true")
    kind.add_argument("--lossless", action="store_true")
    parser.add_argument("--out", type=Path, help="file to write instead of stdout")
    args = parser.parse_args(arguments)
    qps, rows = [int(q) for q in args.qp.split(",")], {}
    for path in args.assets:
        texels = load_texels(path)
        texels = texels.cropped(args.crop) if args.crop else texels
        if args.lossless:
            rows[texels.name] = lossless_bytes(texels, args.effort)
        else:
            rows[texels.name] = (tool_by_tool if args.tools else against_avif)(texels, args.effort, qps)
        print(texels.name, rows[texels.name], file=sys.stderr, flush=True)
    text = (lossless_table if args.lossless else tools_table if args.tools else avif_table)(rows)
    if args.out:
        args.out.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
