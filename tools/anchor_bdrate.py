"""BD-rate of the attribute codec against G-PCC on voxel clouds whose anchor results are known.

python tools/anchor_bdrate.py --clouds DIR [--effort E] [--qp 22,28,34,40,46] [--json]

DIR holds pairs NAME.npz (xyz uint16 [N, 3], rgb uint8 [N, 3], area uint16 [N]) and NAME.json ({"K", "points_rd": [{"bytes",
"psnr_y", "psnr_yuv611", "psnr_rgb", "psnr_y_area"}]}). Every cloud is coded with geometry given, decoded, compared with the
encoder's reconstruction, and measured as the anchor was: chroma QP offset -1, error over points. Bytes are those of the attribute
unit's parameters and codewords.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from texfcodec.attribute.choice import choose_kernel
from texfcodec.attribute.codec import dec_attributes, enc_attributes
from texfcodec.attribute.colour import forward_colour, inverse_colour
from texfcodec.attribute.layout import octree_depth
from texfcodec.bitstream.syntax import CODECS
from texfcodec.bitstream.values import raht_values
from texfcodec.bitstream.walk import write_structure
from texfcodec.field.morton import encode_morton
from texfcodec.quality.bd_rate import bd_rate
from texfcodec.quality.psnr import ColourError, psnr_3d

CHROMA_OFFSET = -1
MEASURES = {"bd_y": "psnr_y", "bd_yuv611": "psnr_yuv611", "bd_rgb": "psnr_rgb", "bd_y_area": "psnr_y_area"}


def code(keys, rgb, resolution, qp, effort, threads):
    """One encode and decode: (bytes, decoded rgb, seconds of encoding, seconds of decoding)."""
    depth, values, qps = octree_depth(resolution), forward_colour(rgb), [qp, *[max(qp + CHROMA_OFFSET, 0)] * 2]
    begin = time.perf_counter()
    coded, means = enc_attributes(keys, depth, values, qps, choose_kernel(keys, depth, values, qps, effort), threads)
    middle = time.perf_counter()
    fields = raht_values(coded, True)
    size = len(write_structure(CODECS[0], {**fields, "resolution": resolution, "NumComponents": 3}))
    data = np.frombuffer(fields["codeword_data"], np.uint8)
    bounds = np.cumsum([0] + [len(c) for c in coded.codewords]).tolist()
    start = time.perf_counter()
    decoded = dec_attributes(keys, depth, coded, data, list(zip(bounds[:-1], bounds[1:], strict=True)), depth, threads)
    end = time.perf_counter()
    if not np.array_equal(decoded, means):
        raise SystemExit("the decoder's values differ from the encoder's reconstruction")
    return size, inverse_colour(decoded), middle - begin, end - start


def quality(rgb, decoded, area):
    """The anchor's PSNR values of one decoded cloud."""
    weighted = ColourError()
    weighted.add(rgb, decoded, area)
    return {**psnr_3d(rgb, decoded), "psnr_y_area": weighted.result()["psnr_y"]}


def run_cloud(path, effort, qps):
    """One cloud at all QPs: the measures of the tool's JSON and the rate points."""
    cloud, anchor = np.load(path), json.loads(path.with_suffix(".json").read_text())
    keys = encode_morton(cloud["xyz"])
    order = np.argsort(keys)
    keys, rgb, area = keys[order], cloud["rgb"][order], cloud["area"][order]
    points, speed = [], {"enc_mpts": {}, "dec_mpts": {}}
    for qp in qps:
        size, decoded, *_ = code(keys, rgb, anchor["K"], qp, effort, 2)
        points.append({"qp": qp, "bytes": size, **quality(rgb, decoded, area)})
    for threads in (1, 2):
        runs = [code(keys, rgb, anchor["K"], 28, effort, threads)[2:] for _ in range(3)]
        for name, seconds in zip(speed, np.median(runs, axis=0), strict=True):
            speed[name][str(threads)] = round(float(len(keys) / seconds / 1e6), 3)
    rates = [p["bytes"] for p in anchor["points_rd"]]
    result = {}
    for name, key in MEASURES.items():
        grey = name == "bd_yuv611" and not (np.ptp(rgb, axis=1) > 0).any()
        result[name] = None if grey else bd_rate(rates, [p[key] for p in anchor["points_rd"]], [p["bytes"] for p in points],
                                                 [p[key] for p in points])
    return {**result, **speed, "points": points}


def main():
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clouds", type=Path, required=True)
    parser.add_argument("--effort", default="balanced")
    parser.add_argument("--qp", default="22,28,34,40,46")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = {"clouds": {}}
    for path in sorted(args.clouds.glob("*.npz")):
        result["clouds"][path.stem] = row = run_cloud(path, args.effort, [int(q) for q in args.qp.split(",")])
        shown = " ".join(f"{k} {'-' if row[k] is None else format(row[k], '+.1f')}" for k in MEASURES)
        print(f"{path.stem:24} {shown}  enc {row['enc_mpts']} dec {row['dec_mpts']} Mpoint/s", file=sys.stderr)
    rows = result["clouds"].values()
    result["mean"] = {k: float(np.mean([r[k] for r in rows if r[k] is not None])) for k in MEASURES}
    print("mean " + " ".join(f"{k} {v:+.2f}" for k, v in result["mean"].items()), file=sys.stderr)
    if args.json:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
