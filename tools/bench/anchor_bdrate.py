"""BD-rate, speed and decoder memory of the attribute codec against G-PCC on voxel clouds whose anchor results are known.

python tools/bench/anchor_bdrate.py --clouds DIR [--effort fast|balanced|best] [--qp 22,28,34,40,46] [--json]

DIR holds pairs NAME.npz (xyz uint16 [N, 3], rgb uint8 [N, 3], area uint16 [N]) and NAME.json ({"K", "points_rd": [{"bytes",
"psnr_y", "psnr_yuv611", "psnr_rgb", "psnr_y_area"}]}). Every cloud is coded with geometry given, decoded, compared with the
encoder's reconstruction, and measured as the anchor was: chroma QP offset -1, error over points. Bytes are those of the attribute
unit's parameters and codewords. Speed and memory are those at QP 28; encoding includes the choice of tools. Memory is that of one
decode with 2 threads, in a process of its own: how far resident memory rises above what it was before, with warm kernels and the
input (keys and codewords) loaded, so that the input does not count and the decoded values do.

--json: one object on stdout, {"clouds": {NAME: {"bd_y", "bd_yuv611", "bd_rgb", "bd_y_area", "enc_mpts": {"1", "2"}, "dec_mpts":
{"1", "2"}, "peak_memory_bytes", "num_points", "points"}}, "mean": {the same without the last two}}. BD-rates are percent,
negative where this codec needs less; bd_yuv611 of a grey cloud is null and left out of the mean, as is memory where it cannot be
read (only Linux can).
"""

import argparse
import json
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.codecs.raht.attribute_coder import dec_attributes, enc_attributes
from texfcodec.codecs.raht.raht_syntax import RAHT
from texfcodec.codecs.raht.raht_values import coded_of, raht_values
from texfcodec.codecs.raht.tool_choice import EFFORTS, choose_tools
from texfcodec.codecs.raht.transform.colour import forward_colour, inverse_colour
from texfcodec.core.colour_error import ColourError, psnr_3d
from texfcodec.core.json_text import json_ready, json_text
from texfcodec.core.syntax_walk import write_structure
from texfcodec.field.extents import octree_depth
from texfcodec.field.morton import encode_morton
from texfcodec.metrics.bd_rate import bd_rate
from tools.proof.memory import RECORD, forget_peak, resident

CHROMA_OFFSET = -1
QPS = "22,28,34,40,46"
TIMED_QP, RUNS = 28, 3
WARM_VOXELS = 1 << 12
MEASURES = {"bd_y": "psnr_y", "bd_yuv611": "psnr_yuv611", "bd_rgb": "psnr_rgb", "bd_y_area": "psnr_y_area"}


@dataclass
class Cloud:
    """Voxels in Morton order. keys: int64 [N]; rgb: uint8 [N, 3]; area: uint16 [N]; resolution: K; anchor: its "points_rd"."""

    keys: np.ndarray
    rgb: np.ndarray
    area: np.ndarray
    resolution: int
    anchor: list

    @property
    def depth(self):
        return octree_depth(self.resolution)


def load_cloud(path):
    """The Cloud of NAME.npz and NAME.json; path: of the former."""
    arrays, anchor = np.load(path), json.loads(path.with_suffix(".json").read_text())
    keys = encode_morton(arrays["xyz"])
    order = np.argsort(keys)
    return Cloud(keys[order], arrays["rgb"][order], arrays["area"][order], anchor["K"], anchor["points_rd"])


def cloud_paths(folder):
    """The clouds of a folder, by name; ends the program where there are none."""
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise SystemExit(f"no NAME.npz in {folder}")
    return paths


def qps_of(qp):
    """QP of each component."""
    return [qp, *[max(qp + CHROMA_OFFSET, 0)] * 2]


def choose(cloud, qp, effort, threads):
    """The encoder's own choice for a cloud: (Tools, seconds it took)."""
    values, begin = forward_colour(cloud.rgb), time.perf_counter()
    return choose_tools(cloud.keys, cloud.depth, values, qps_of(qp), effort, threads), time.perf_counter() - begin


def code(cloud, qp, tools, threads):
    """One encode with the Tools given and one decode: (syntax values of the parameters and codewords, decoded rgb, seconds of
    encoding, seconds of decoding). Ends the program where decoder and encoder disagree."""
    values, begin = forward_colour(cloud.rgb), time.perf_counter()
    coded, means = enc_attributes(cloud.keys, cloud.depth, values, qps_of(qp), tools, threads)
    middle, fields = time.perf_counter(), raht_values(coded, True)
    start = time.perf_counter()
    decoded = decode(cloud.keys, cloud.depth, fields, threads)
    end = time.perf_counter()
    if not np.array_equal(decoded, means):
        raise SystemExit("the decoder's values differ from the encoder's reconstruction")
    return fields, inverse_colour(decoded), middle - begin, end - start


def decode(keys, depth, fields, threads):
    """Values int32 [N, 3] from the syntax values of raht_values."""
    coded, spans = coded_of(fields)
    return dec_attributes(keys, depth, coded, np.frombuffer(fields["codeword_data"], np.uint8), spans, depth, threads)


def rate_point(cloud, qp, tools):
    """One point of the rate curve: {"qp", "bytes"} and the anchor's PSNR values."""
    fields, decoded, *_ = code(cloud, qp, tools, 2)
    size = len(write_structure(RAHT, {**fields, "resolution": cloud.resolution, "NumComponents": 3}))
    weighted = ColourError()
    weighted.add(cloud.rgb, decoded, cloud.area)
    return {"qp": qp, "bytes": size, **psnr_3d(cloud.rgb, decoded), "psnr_y_area": weighted.result()["psnr_y"]}


def rate_difference(anchor, points, measure):
    """BD-rate of rate points against an anchor's in one of MEASURES."""
    key = MEASURES[measure]
    return bd_rate([p["bytes"] for p in anchor], [p[key] for p in anchor], [p["bytes"] for p in points], [p[key] for p in points])


def speeds(cloud, effort, threads):
    """Millions of points a second: (of choosing and encoding, of decoding), medians of RUNS."""
    seconds = []
    for _ in range(RUNS):
        tools, choosing = choose(cloud, TIMED_QP, effort, threads)
        _, _, encoding, decoding = code(cloud, TIMED_QP, tools, threads)
        seconds.append((choosing + encoding, decoding))
    return (len(cloud.keys) / np.median(seconds, axis=0) / 1e6).round(3).tolist()


def growth_of_decoding(warm, keys, depth, fields):
    """Bytes by which decoding lifts this process's resident memory; warm: keys, depth, fields of a small cloud, decoded first."""
    decode(*warm, 2)
    forget_peak()
    before = resident("VmRSS")
    decode(keys, depth, fields, 2)
    return max(0, resident("VmHWM") - before)


def decoder_memory(cloud, effort):
    """Peak memory of decoding in bytes, by growth_of_decoding in a fresh process; None where the system does not tell."""
    if not RECORD.exists():
        return None
    tools, _ = choose(cloud, TIMED_QP, effort, 2)
    fields, *_ = code(cloud, TIMED_QP, tools, 2)
    small = Cloud(cloud.keys[:WARM_VOXELS], cloud.rgb[:WARM_VOXELS], cloud.area[:WARM_VOXELS], cloud.resolution, [])
    warm_fields = code(small, TIMED_QP, tools, 2)[0] | {"filters": fields["filters"]}  # the same kernels, whatever was fitted
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(growth_of_decoding, (small.keys, cloud.depth, warm_fields), cloud.keys, cloud.depth, fields).result()


def run_cloud(path, effort, qps):
    """One cloud at all QPs: its entry in the tool's JSON."""
    cloud = load_cloud(path)
    points = [rate_point(cloud, qp, choose(cloud, qp, effort, 2)[0]) for qp in qps]
    grey = not (np.ptp(cloud.rgb, axis=1) > 0).any()
    row = {m: None if grey and m == "bd_yuv611" else rate_difference(cloud.anchor, points, m) for m in MEASURES}
    by_threads = {str(threads): speeds(cloud, effort, threads) for threads in (1, 2)}
    row |= {name: {t: s[i] for t, s in by_threads.items()} for i, name in enumerate(("enc_mpts", "dec_mpts"))}
    return row | {"peak_memory_bytes": decoder_memory(cloud, effort), "num_points": len(cloud.keys),
                  "points": [json_ready(p) for p in points]}


def mean_of(rows):
    """Means over the clouds, those without a value left out; None where none has one."""
    means = {}
    for key in (*MEASURES, "peak_memory_bytes"):
        there = [r[key] for r in rows if r[key] is not None]
        means[key] = float(np.mean(there)) if there else None
    for key in ("enc_mpts", "dec_mpts"):
        means[key] = {t: float(np.mean([r[key][t] for r in rows])) for t in ("1", "2")}
    return means


def described(name, row, points):
    """One line for people; points: of the cloud, or their mean number."""
    rates = " ".join(f"{k} {'-' if row[k] is None else format(row[k], '+.2f')}" for k in MEASURES)
    speed = " ".join(f"{k[:3]} {row[k]['1']:.2f}/{row[k]['2']:.2f}" for k in ("enc_mpts", "dec_mpts"))
    peak = row["peak_memory_bytes"]
    memory = "unknown" if peak is None else f"{peak / 2**20:.0f} MiB, {peak / points:.1f} bytes/point"
    return f"{name:24} {rates}  {speed} Mpoint/s (1/2 threads)  decoder memory {memory}"


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clouds", type=Path, required=True)
    parser.add_argument("--effort", default="balanced", choices=EFFORTS)
    parser.add_argument("--qp", default=QPS, help="must overlap the anchor's range of quality")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    clouds = {}
    for path in cloud_paths(args.clouds):
        clouds[path.stem] = row = run_cloud(path, args.effort, [int(q) for q in args.qp.split(",")])
        print(described(path.stem, row, row["num_points"]), file=sys.stderr)
    mean = mean_of(clouds.values())
    print(described("mean", mean, np.mean([r["num_points"] for r in clouds.values()])), file=sys.stderr)
    if args.json:
        print(json_text({"clouds": clouds, "mean": mean}))


if __name__ == "__main__":
    main()
