"""Our streams against what a user would pick instead: GLB with Draco, and AVIF, WebP or JPEG images, at equal image PSNR.

python tools/bench/everyday.py curves ASSET --out FILE.json [--codecs avif,webp,jpeg] [--uv-bits 10,12,14] [--compact]
        [--threads N]
python tools/bench/everyday.py measure ASSET... [--rates r01,r02] [--support WORD] [--set name=value] [--out FILE.json]
        [--threads N]
python tools/bench/everyday.py compare --anchors DIR [--anchors DIR] --points PATH [--key NAME] [--measure y]
        [--interpolation pchip]

curves: the rivals of one asset, {"asset", "faces", "textures", "draco_bytes", "ceiling", "points": [{"codec", "scale", "quality",
"uv_bits", "image_bytes", "total_bytes", "y", "rgb", "yuv"}]}. total_bytes are Draco's (14 position bits, level 10, UVs of
uv_bits; one mesh per material or one of all, whichever is smaller) and those of every distinct base-colour image at 1 / scale of
its width and height. y, rgb, yuv: PSNR in dB over the 16 views of the metric at 1024 x 1024. Vertex colours travel with Draco as
linear integers: "colour_bits", or "quality" of the codec "draco" where there are no images. Factors and material names cost
nothing. --compact: without the curves that are nowhere the least.

measure: our points, {"asset", "settings", "points": [{"rate", "total", "geometry", "attributes", "y", "rgb", "yuv",
"encode_seconds"}]}, or such objects by asset where several are named. --set: any option of the encoder, by its name there.

compare: a Markdown table, BD-rate against the least bytes over all rival curves (rule: everyday_envelope.py), mean and median.
--points: what measure wrote, a file or a folder of them, or rows of rate_points.py (.jsonl: its group "TexF auto"); --key: the
name under which a record has our points. Points that are larger and not better than another of ours have an asterisk and are left
out of the BD-rate.
"""

import argparse
import os
import sys
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.core.json_text import json_text
from texfcodec.errors import TexfError
from texfcodec.io.load import load
from texfcodec.options import RATES
from tools.bench.everyday_envelope import INTERPOLATIONS, compacted, read_records, table
from tools.bench.everyday_points import measured_asset, setting_of

COMMON_RATES = "r01,r02,r03,r04,r05"


def write_json(value, path):
    """Writes a record, a point per line, to a file that is renamed when it is complete; to stdout where path is None."""
    text = json_text(value, separators=(",", ":")).replace('{"codec"', '\n{"codec"').replace('{"rate"', '\n{"rate"') + "\n"
    if path is None:
        print(text, end="")
        return
    part = path.with_name(f"{path.name}.part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def run_curves(args):
    """The command curves."""
    from tools.bench.everyday_rivals import CODECS, UV_BITS, curves

    names = args.codecs.split(",") if args.codecs else list(CODECS)
    if not set(names) <= set(CODECS):
        raise SystemExit(f"the codecs are {', '.join(CODECS)}, not {args.codecs}")
    uv_bits = tuple(int(bits) for bits in args.uv_bits.split(",")) if args.uv_bits else UV_BITS
    say = lambda p: print(f"{p['codec']} 1/{p['scale']} quality {p['quality']} UVs of {p['uv_bits']} bits: {p['total_bytes']} B "
                          f"{'exact' if p['y'] is None else format(p['y'], '.2f')} dB", file=sys.stderr)
    record = curves(load(str(args.asset)), args.asset.stem, {n: CODECS[n] for n in names}, uv_bits, args.threads, say)
    write_json(compacted(record) if args.compact else record, args.out)


def run_measure(args):
    """The command measure."""
    settings = dict(setting_of(text) for text in [*args.set, *([f"support={args.support}"] if args.support else [])])
    records = {}
    for path in args.asset:
        records[path.stem] = measured_asset(path, args.rates.split(","), settings, args.threads)
        for p in records[path.stem]["points"]:
            print(f"{path.stem} {p}", file=sys.stderr)
    write_json(records if len(args.asset) > 1 else records[args.asset[0].stem], args.out)


def run_compare(args):
    """The command compare."""
    rivals, ours = read_records(args.anchors, "codec"), read_records([args.points], "rate", args.key)
    if not set(rivals) & set(ours):
        raise SystemExit("no asset has both rival curves and points of ours")
    for name in sorted(set(ours) - set(rivals)):
        print(f"{name} has no rival curves", file=sys.stderr)
    print(table(rivals, ours, args.key, args.measure, args.interpolation), end="")


def parser_of():
    """The tool's argument parser."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    curves = commands.add_parser("curves", help="the rivals of one asset")
    curves.add_argument("asset", type=Path)
    curves.add_argument("--out", type=Path, required=True)
    curves.add_argument("--codecs", help="some of avif,webp,jpeg")
    curves.add_argument("--uv-bits", help="such as 10,12,14")
    curves.add_argument("--compact", action="store_true", help="leave out curves that are nowhere the least")
    curves.set_defaults(run=run_curves)
    measure = commands.add_parser("measure", help="our streams of assets")
    measure.add_argument("asset", type=Path, nargs="+")
    measure.add_argument("--rates", default=COMMON_RATES, help=f"some of {','.join(RATES)}")
    measure.add_argument("--support", help="as --set support=WORD")
    measure.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="an option of the encoder")
    measure.add_argument("--out", type=Path, help="file to write instead of stdout")
    measure.set_defaults(run=run_measure)
    for one in (curves, measure):
        one.add_argument("--threads", type=int, default=1)
    compare = commands.add_parser("compare", help="our points against the rival curves")
    compare.add_argument("--anchors", type=Path, action="append", required=True, help="folder of what curves wrote")
    compare.add_argument("--points", type=Path, required=True, help="file or folder of what measure wrote")
    compare.add_argument("--key", default="points")
    compare.add_argument("--measure", default="y", choices=("y", "rgb", "yuv"))
    compare.add_argument("--interpolation", default=INTERPOLATIONS[0], choices=INTERPOLATIONS)
    compare.set_defaults(run=run_compare)
    return parser


def main(arguments=None):
    """Command line of the tool."""
    args = parser_of().parse_args(arguments)
    try:
        args.run(args)
    except TexfError as error:
        raise SystemExit(f"{error.code}: {error}") from None


if __name__ == "__main__":
    main()
