"""The attribute coder alone, on voxel clouds and on texels: against G-PCC, AVIF and lossless images, and tool by tool.

    python tools/bench/attributes.py anchor CLOUDS              BD-rate, speed and memory beside known results of an anchor
    python tools/bench/attributes.py tools CLOUDS | ASSET ...   what each tool is worth
    python tools/bench/attributes.py tmc13 CLOUDS               speed beside TMC13's, run by run in turns  [--program tmc3]
    python tools/bench/attributes.py avif ASSET ...             texels that a surface uses against AVIF on the whole image
    python tools/bench/attributes.py lossless ASSET ...         the same without loss against PNG and WebP

CLOUDS is a folder with NAME.npz (xyz uint16 [N, 3], rgb uint8 [N, 3], area uint16 [N]) and NAME.json ({"K", "points_rd":
[{"bytes", "psnr_y", "psnr_yuv611", "psnr_rgb", "psnr_y_area"}]}). Clouds are coded as voxels with chroma QP offset -1, as the
anchor was; of an ASSET the largest base-colour image, whose used texels are those that bilinear interpolation can ask at any
point of a face, with the encoder's own offset, as texels (x, y, 0). Each encode is decoded and compared. Bytes are those of the
attribute unit's parameters and codewords; PSNR is over the points, AVIF's over the used texels. --crop: only the N x N window
with the most used texels. --effort, --qp: of ours.

Prints Markdown; anchor prints JSON: {"clouds": {NAME: {"bd_y", "bd_yuv611", "bd_rgb", "bd_y_area" in percent, "enc_mpts" and
"dec_mpts" {"1", "2"} in millions of points a second by threads, "peak_memory_bytes", "num_points", "points"}}, "mean": {the
same without the last two}}. Speed and memory are those at QP 28; encoding includes the choice of tools. Memory is how far the
resident memory of one decode, in a process of its own with warm kernels and the input loaded, rises. bd_yuv611 of a grey cloud is
null and left out of the mean, as is memory where it cannot be read (only Linux can).
"""

import argparse
import io
import json
import multiprocessing
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
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
from texfcodec.core.colour_error import ColourError, psnr_3d
from texfcodec.core.json_text import json_ready, json_text
from texfcodec.core.syntax_walk import write_structure
from texfcodec.field.extents import octree_depth
from texfcodec.field.morton import decode_morton, encode_morton
from texfcodec.field.texel_set import referenced_texels
from texfcodec.io.load import load
from texfcodec.metrics.bd_rate import bd_rate
from tools.bench.methods.external import GEOMETRY, TRANSFORMS, write_ply
from tools.bench.result_tables import markdown_table
from tools.proof.memory import RECORD, forget_peak, resident

CLOUD_OFFSET, TEXEL_OFFSET = -1, CHROMA_OFFSETS[True]
CLOUD_QPS, TEXEL_QPS = "22,28,34,40,46", "22,28,34,40"
TIMED_QP, RUNS, WARM_POINTS = 28, 3, 1 << 12
AVIF_QUALITIES = (5, 10, 20, 30, 40, 50, 60, 70, 80, 88, 94)
MEASURES = {"bd_y": "psnr_y", "bd_yuv611": "psnr_yuv611", "bd_rgb": "psnr_rgb", "bd_y_area": "psnr_y_area"}
SPEEDS = "enc_mpts", "dec_mpts"
AS_VOXELS = {"planar": 0, "planar_transform": 0, "component_cross": 0, "dct_blocks": 0, "trade_off": EFFORTS["fast"].trade_off}
COMPLETE, CHOICE_OFF = "complete set", "kernel choice off"
CLOUD_CHANGES = {
    COMPLETE: {}, "mixing off": {"models": 0}, "2 models": {"models": 2}, "4 models": {"models": 4}, "6 models": {"models": 6},
    "8 models": {"models": 8}, "components do not follow": {"component_cross": 0}, "colour range off": {"colour_range": 0},
    "filter off": {"filters": 0}, "filter of 2 stages": {"filters": 2}, CHOICE_OFF: {}, "no RDO": {"trade_off": 1e-9}}
TEXEL_CHANGES = {
    COMPLETE: {}, "planar transform off": {"planar_transform": 0}, "DCT blocks off": {"dct_blocks": 0},
    "components do not follow": {"component_cross": 0}, "lambda of voxels": {"trade_off": AS_VOXELS["trade_off"]},
    "all of them off, contexts too": AS_VOXELS, "filter off": {"filters": 0}, "colour range off": {"colour_range": 0},
    "direct contexts": {"models": 0}}
TIME = re.compile(r"^colors processing time \(user\): ([\d.]+) s", re.MULTILINE)
SIZE = re.compile(r"^colors bitstream size (\d+) B", re.MULTILINE)


@dataclass
class Points:
    """Points to code, in Morton order. keys: int64 [N]; rgb: uint8 [N, 3]; resolution: of their grid; of a cloud, area: weights
    uint16 [N], anchor: its rate points "points_rd"; of texels, image: uint8 [H, W, 3], mask: bool [H, W], the used ones."""

    name: str
    keys: np.ndarray
    rgb: np.ndarray
    resolution: int
    area: np.ndarray | None = None
    anchor: list | None = None
    image: np.ndarray | None = None
    mask: np.ndarray | None = None

    @property
    def depth(self):
        return octree_depth(self.resolution)

    def qps(self, qp):
        """Return the QPs of the three colour components: qp, and qp with the offset of chroma."""
        return [qp, *[max(qp + (TEXEL_OFFSET if self.mask is not None else CLOUD_OFFSET), 0)] * 2]


def load_clouds(folder):
    """Yield the Points of each cloud NAME.npz in a folder, sorted by name. Ends the program if there is none."""
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise SystemExit(f"no NAME.npz in {folder}")
    for path in paths:
        arrays, anchor = np.load(path), json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        keys = encode_morton(arrays["xyz"])
        order = np.argsort(keys)
        yield Points(path.stem, keys[order], arrays["rgb"][order], anchor["K"], arrays["area"][order], anchor["points_rd"])


def load_texels(path, crop=None):
    """Return the used texels of an asset's largest base-colour image as Points. crop: as of texels_of()."""
    scene = load(path)
    number = max(sorted({m.texture for m in scene.materials} - {-1}), key=lambda t: scene.textures[t].image.size)
    texture = scene.textures[number]
    height, width = texture.image.shape[:2]
    own = np.isin(scene.face_material, [i for i, m in enumerate(scene.materials) if m.texture == number])
    steps = np.floor(scene.corner_uv[own] * (width, height) * 4 + 0.5).astype(np.int64).reshape(-1, 2)
    keys = referenced_texels(steps, np.arange(len(steps)).reshape(-1, 3), 2, (width, height), tuple(texture.wrap))
    x, y = decode_morton(keys)[:, :2].T
    mask = np.zeros((height, width), bool)
    mask[y, x] = True
    return texels_of(path.stem, texture.image[:, :, :3].copy(), mask, crop)


def texels_of(name, image, mask, crop=None):
    """Return the used texels of an image as Points. image: uint8 [H, W, 3]; mask: bool [H, W]; crop: take only the square window
    of that side with the most used texels."""
    if crop:
        height, width = (max(1, n - crop + 1) for n in mask.shape)
        places = [(y, x) for y in range(0, height, max(crop // 4, 1)) for x in range(0, width, max(crop // 4, 1))]
        y, x = max(places, key=lambda p: mask[p[0]: p[0] + crop, p[1]: p[1] + crop].sum())
        image, mask = image[y: y + crop, x: x + crop], mask[y: y + crop, x: x + crop]
    y, x = np.nonzero(mask)
    keys = encode_morton(np.stack([x, y, np.zeros_like(x)], axis=1))
    order = np.argsort(keys)
    return Points(name, keys[order], image[y, x][order], max(mask.shape), image=image, mask=mask)


def choose(points, qp, effort, threads=2, planar=None):
    """Choose coding tools as the encoder does; return (Tools, seconds). planar: whether as for texels, default: by points."""
    values, begin = forward_colour(points.rgb), time.perf_counter()
    planar = points.mask is not None if planar is None else planar
    return choose_tools(points.keys, points.depth, values, points.qps(qp), effort, threads, planar), time.perf_counter() - begin


def code(points, qp, tools, threads=2):
    """Encode points with the given Tools and decode them; return (syntax values, decoded rgb, seconds to encode, seconds to
    decode). Ends the program if decoder and encoder disagree."""
    values, begin = forward_colour(points.rgb), time.perf_counter()
    coded, means = enc_attributes(points.keys, points.depth, values, points.qps(qp), tools, threads)
    middle, fields = time.perf_counter(), raht_values(coded, True)
    start = time.perf_counter()
    decoded = decode(points.keys, points.depth, fields, threads)
    end = time.perf_counter()
    if not np.array_equal(decoded, means):
        raise SystemExit("the decoder's values differ from the encoder's reconstruction")
    return fields, inverse_colour(decoded), middle - begin, end - start


def decode(keys, depth, fields, threads):
    """Return decoded values int32 [N, 3]. keys: Morton keys; depth: of their octree; fields: syntax values of raht_values."""
    coded, spans = coded_of(fields)
    return dec_attributes(keys, depth, coded, np.frombuffer(fields["codeword_data"], np.uint8), spans, depth, threads)


def unit_bytes(points, fields):
    """Return the bytes of an attribute unit with these syntax values: parameters and codewords."""
    return len(write_structure(RAHT, {**fields, "resolution": points.resolution, "NumComponents": 3}))


def rate_point(points, qp, tools):
    """Code points at a QP; return {"qp", "bytes"} and PSNRs in dB, for a cloud also "psnr_y_area", weighted by area."""
    fields, decoded, *_ = code(points, qp, tools)
    out = {"qp": qp, "bytes": unit_bytes(points, fields), **psnr_3d(points.rgb, decoded)}
    if points.area is not None:
        weighted = ColourError()
        weighted.add(points.rgb, decoded, points.area)
        out["psnr_y_area"] = weighted.result()["psnr_y"]
    return out


def rate_difference(anchor, rows, key):
    """Return the BD-rate of rate points (rows) against others (anchor) in percent. key: name of the PSNR that is compared."""
    return bd_rate([p["bytes"] for p in anchor], [p[key] for p in anchor], [p["bytes"] for p in rows], [p[key] for p in rows])


# Speed and memory.


def seconds_per_point(points, effort, threads):
    """Return [seconds per point to choose tools and encode, to decode], medians of RUNS runs."""
    runs = []
    for _ in range(RUNS):
        tools, choosing = choose(points, TIMED_QP, effort, threads)
        _, _, encoding, decoding = code(points, TIMED_QP, tools, threads)
        runs.append((choosing + encoding, decoding))
    return np.median(runs, axis=0) / len(points.keys)


def growth_of_decoding(warm, keys, depth, fields):
    """Return the bytes by which decoding raises this process's peak memory. warm: (keys, depth, fields) to decode first."""
    decode(*warm, 2)
    forget_peak()
    before = resident("VmRSS")
    decode(keys, depth, fields, 2)
    return max(0, resident("VmHWM") - before)


def decoder_memory(points, effort):
    """Return the bytes of growth_of_decoding() for points, in a fresh process; None if the system does not report memory."""
    if not RECORD.exists():
        return None
    tools, _ = choose(points, TIMED_QP, effort)
    fields, *_ = code(points, TIMED_QP, tools)
    small = replace(points, keys=points.keys[:WARM_POINTS], rgb=points.rgb[:WARM_POINTS])
    warm = code(small, TIMED_QP, tools)[0] | {"filters": fields["filters"]}  # the same kernels, whatever was fitted
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(growth_of_decoding, (small.keys, points.depth, warm), points.keys, points.depth, fields).result()


# The commands.


def anchor(args):
    """Return [JSON text] that compares all clouds of a folder with their anchors: BD-rates, speed, memory. args: of main()."""
    clouds = {}
    for points in load_clouds(args.sources[0]):
        rows = [rate_point(points, qp, choose(points, qp, args.effort)[0]) for qp in args.qps(CLOUD_QPS)]
        grey = not (np.ptp(points.rgb, axis=1) > 0).any()
        row = {name: None if grey and name == "bd_yuv611" else rate_difference(points.anchor, rows, key)
               for name, key in MEASURES.items()}
        speed = {str(threads): (1e-6 / seconds_per_point(points, args.effort, threads)).round(3).tolist() for threads in (1, 2)}
        row |= {name: {threads: values[i] for threads, values in speed.items()} for i, name in enumerate(SPEEDS)}
        clouds[points.name] = row | {"peak_memory_bytes": decoder_memory(points, args.effort), "num_points": len(points.keys),
                                     "points": [json_ready(p) for p in rows]}
        print(points.name, row, file=sys.stderr, flush=True)
    mean = {}
    for key in (*MEASURES, "peak_memory_bytes"):
        there = [row[key] for row in clouds.values() if row[key] is not None]
        mean[key] = float(np.mean(there)) if there else None
    mean |= {key: {t: float(np.mean([row[key][t] for row in clouds.values()])) for t in ("1", "2")} for key in SPEEDS}
    return [json_text({"clouds": clouds, "mean": mean})]


def changes_at(effort, changes):
    """Return the names of changes {name: {field of Tools: value}} that alter an effort's tools, the complete set first."""
    tools = EFFORTS[effort]
    return [name for name, change in changes.items() if name in (COMPLETE, CHOICE_OFF) or replace(tools, **change) != tools]


def tools(args):
    """Return a Markdown table with a row per changed tool: BD-rates of Y and RGB against the complete set (positive: more bytes)
    by source, and their mean; for clouds also seconds per million points. The kernel stays as the complete set has chosen it."""
    is_clouds = args.sources[0].is_dir()
    changes = CLOUD_CHANGES if is_clouds else TEXEL_CHANGES
    changed_rows, names = {}, changes_at(args.effort, changes) if is_clouds else list(changes)
    for points in load_clouds(args.sources[0]) if is_clouds else (load_texels(path, args.crop) for path in args.sources):
        chosen = {qp: choose(points, qp, args.effort)[0] for qp in args.qps(CLOUD_QPS if is_clouds else TEXEL_QPS)}
        timed, complete = choose(points, TIMED_QP, args.effort), None
        for name in names:
            def changed(own, name=name):
                return EFFORTS[args.effort] if name == CHOICE_OFF else replace(own, **changes[name])

            rows = [rate_point(points, qp, changed(own)) for qp, own in chosen.items()]
            complete = complete or rows
            row = [rate_difference(complete, rows, key) for key in ("psnr_y", "psnr_rgb")]
            if is_clouds:
                runs = [code(points, TIMED_QP, changed(timed[0]))[2:] for _ in range(RUNS)]
                seconds = np.median(runs, axis=0) + [0 if name == CHOICE_OFF else timed[1], 0]
                row += (seconds / len(points.keys) * 1e6).tolist()
            changed_rows.setdefault(name, {})[points.name] = row
        print(points.name, "done", file=sys.stderr, flush=True)
    lines = []
    for name, rows in changed_rows.items():
        mean = np.mean(list(rows.values()), axis=0)
        rates = (f"{row[0]:+.2f} / {row[1]:+.2f}" for row in (*rows.values(), mean))
        lines.append([name, *rates, *(f"{s:.2f}" for s in mean[2:])])
    seconds = ["encode, s/Mpoint", "decode, s/Mpoint"] if is_clouds else []
    return markdown_table(["change, Y / RGB, %", *changed_rows[COMPLETE], "mean", *seconds], lines)


def tmc13(args):
    """Return a Markdown table of the speed of TMC13 and of each effort in one thread, in millions of points per second, choice
    of tools included. All take turns, the fastest run counts. TMC13's times are its log's for attributes, summed over slices."""
    names, speeds, lines = ("TMC13", *EFFORTS), [], []
    for points in load_clouds(args.sources[0]):
        times = {name: [] for name in names}
        for _ in range(RUNS):
            times["TMC13"].append(run_tmc13(args.program, points))
            for effort in EFFORTS:
                own, choosing = choose(points, TIMED_QP, effort, 1)
                fields, _, encoding, decoding = code(points, TIMED_QP, own, 1)
                times[effort].append((choosing + encoding, decoding, len(fields["codeword_data"])))
        best = {name: np.min(times[name], axis=0) for name in names}
        speeds.append([len(points.keys) / 1e6 / best[name][:2] for name in names])
        lines.append([points.name, *(f"{e:.2f} / {d:.2f}, {best[name][2]:,.0f}" for name, (e, d) in
                                     zip(names, speeds[-1], strict=True))])
    lines.append(["mean", *(f"{e:.2f} / {d:.2f}" for e, d in np.mean(speeds, axis=0))])
    return markdown_table(["cloud", *(f"{name}: encode / decode, bytes" for name in names)], lines)


def run_tmc13(program, points):
    """Code points with TMC13; return (processor seconds to encode, to decode, bytes). Ends the program if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        source, stream, back = (Path(folder) / name for name in ("cloud.ply", "cloud.bin", "back.ply"))
        write_ply(source, decode_morton(points.keys), points.rgb)
        words = ([*GEOMETRY, *TRANSFORMS["raht"], "--mode=0", f"--qp={TIMED_QP}", "--bitdepth=8", "--attribute=color",
                  f"--uncompressedDataPath={source}", f"--compressedStreamPath={stream}"],
                 ["--mode=1", f"--compressedStreamPath={stream}", f"--reconstructedDataPath={back}", "--convertPlyColourspace=1"])
        logs = []
        for given in words:
            run = subprocess.run([program, *given], capture_output=True, text=True, check=False)
            if run.returncode or not TIME.search(run.stdout):
                raise SystemExit(f"{program} ends with {run.returncode}: {(run.stderr or run.stdout)[-500:]}")
            logs.append(run.stdout)
    return *(sum(map(float, TIME.findall(log))) for log in logs), sum(map(int, SIZE.findall(logs[0])))


def avif(args):
    """Return a Markdown table of BD-rates against AVIF (Pillow, speed 6, 4:2:0) of the whole image, for texels coded as if
    voxels, without the tools for planar supports, and as texels."""
    rows = {}
    for points in (load_texels(path, args.crop) for path in args.sources):
        theirs, row = [avif_point(points, quality) for quality in AVIF_QUALITIES], [100 * points.mask.mean()]
        for planar in (False, True):
            ours = [rate_point(points, qp, choose(points, qp, args.effort, planar=planar)[0]) for qp in args.qps(TEXEL_QPS)]
            row += [rate_difference(theirs, ours, key) for key in ("psnr_y", "psnr_rgb")]
        rows[points.name] = row
    rows["mean"] = np.mean(list(rows.values()), axis=0)
    return markdown_table(["asset", "used texels, %", "as voxels, Y / RGB, %", "as texels, Y / RGB, %"],
                          [[name, f"{used:.0f}", f"{a:+.1f} / {b:+.1f}", f"{c:+.1f} / {d:+.1f}"]
                           for name, (used, a, b, c, d) in rows.items()])


def avif_point(points, quality):
    """Code the whole image as AVIF at a quality; return {"bytes", "psnr_y", "psnr_rgb", ...} over the used texels."""
    file = io.BytesIO()
    Image.fromarray(points.image).save(file, "AVIF", quality=quality, speed=6, subsampling="4:2:0")
    decoded = np.array(Image.open(file).convert("RGB"))
    return {"bytes": len(file.getvalue()), **psnr_3d(points.image[points.mask], decoded[points.mask])}


def lossless(args):
    """Return a Markdown table of lossless bytes: ours, PNG and WebP of the whole image, and both with unused texels black."""
    lines = []
    for points in (load_texels(path, args.crop) for path in args.sources):
        field, plan = (points.keys, points.depth, forward_colour(points.rgb)), ResidualPlan(0, points.rgb, inverse_colour)
        qp, dct_blocks = choose_base(*field, points.qps, plan, args.effort, 2, True)
        coded, back = enc_attributes(*field, qp, choose_tools(*field, qp, args.effort, 2, True, dct_blocks), 2, plan)
        if not np.array_equal(back, points.rgb):
            raise SystemExit("the texels do not come back exactly")
        sizes = [unit_bytes(points, raht_values(coded, True))]
        for how in ({"format": "PNG", "optimize": True}, {"format": "WEBP", "lossless": True, "quality": 100, "method": 6}):
            for image in (points.image, points.image * points.mask[..., None]):
                file = io.BytesIO()
                Image.fromarray(image).save(file, **how)
                sizes.append(len(file.getvalue()))
        lines.append([points.name, *(f"{size:,}" for size in sizes)])
    return markdown_table(["asset", "ours", "PNG", "PNG, unused black", "WebP", "WebP, unused black"], lines)


COMMANDS = {command.__name__: command for command in (anchor, tools, tmc13, avif, lossless)}


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=COMMANDS)
    parser.add_argument("sources", nargs="+", type=Path, metavar="CLOUDS | ASSET")
    parser.add_argument("--effort", default="balanced", choices=EFFORTS)
    parser.add_argument("--qp", help=f"default: {CLOUD_QPS}, of texels {TEXEL_QPS}; must overlap the anchor's range of quality")
    parser.add_argument("--crop", type=int, metavar="N")
    parser.add_argument("--program", default="tmc3", help="TMC13, from its public sources: make -C tools tmc13")
    args = parser.parse_args(arguments)
    args.qps = lambda usual: [int(q) for q in (args.qp or usual).split(",")]
    print("\n".join(COMMANDS[args.what](args)))


if __name__ == "__main__":
    main()
