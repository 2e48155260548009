"""What each tool of the attribute codec is worth: every cloud coded with the complete set and with one tool changed at a time.

python tools/bench/attribute_tools.py --clouds DIR [--effort fast|balanced|best] [--qp 22,28,34,40,46] [--out FILE]

DIR as for anchor_bdrate.py. Prints a Markdown table, a row per change: BD-rate against the complete set in RGB and Y, mean over
the clouds (positive: more bytes), and seconds per million points of encoding and decoding at QP 28 with 2 threads, median of 3,
mean over the clouds. Encoding includes the choice of kernel and colour range, which is made once per cloud and QP with the
complete set and kept under every change but its own. Changes that are none at the effort asked for have no row.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.codecs.raht.tool_choice import EFFORTS
from tools.bench.anchor_bdrate import QPS, RUNS, TIMED_QP, choose, cloud_paths, code, load_cloud, rate_difference, rate_point

COMPLETE, CHOICE_OFF = "complete set", "kernel choice off"
CHANGES = {
    COMPLETE: {}, "mixing off": {"models": 0}, "2 models": {"models": 2}, "4 models": {"models": 4}, "6 models": {"models": 6},
    "8 models": {"models": 8}, "components do not follow": {"component_cross": 0},
    "colour range off": {"colour_range": 0}, "filter off": {"filters": 0}, "filter of 2 stages": {"filters": 2}, CHOICE_OFF: {},
    "no RDO": {"trade_off": 1e-9},
}
MEASURES = ("bd_rgb", "bd_y")


def changes_at(effort):
    """Names of CHANGES that change something at an effort, the complete set first."""
    tools = EFFORTS[effort]
    return [name for name, change in CHANGES.items()
            if name in (COMPLETE, CHOICE_OFF) or replace(tools, **change) != tools]


def changed(name, chosen, effort):
    """Tools under a change; chosen: the encoder's choice of the complete set."""
    return EFFORTS[effort] if name == CHOICE_OFF else replace(chosen, **CHANGES[name])


def seconds_per_million(cloud, tools, choosing):
    """Medians of RUNS: [encoding, decoding]; choosing: seconds that encoding takes besides."""
    runs = [code(cloud, TIMED_QP, tools, 2)[2:] for _ in range(RUNS)]
    return (np.median(runs, axis=0) + [choosing, 0]) / len(cloud.keys) * 1e6


def run_cloud(cloud, effort, qps):
    """{name of the change: [BD-rate RGB, BD-rate Y, seconds of encoding, of decoding]} of one cloud."""
    chosen = {qp: choose(cloud, qp, effort, 2)[0] for qp in qps}
    timed = [choose(cloud, TIMED_QP, effort, 2) for _ in range(RUNS)]
    choosing, result, complete = np.median([seconds for _, seconds in timed]), {}, None
    for name in changes_at(effort):
        points = [rate_point(cloud, qp, changed(name, tools, effort)) for qp, tools in chosen.items()]
        complete = complete or points
        seconds = seconds_per_million(cloud, changed(name, timed[0][0], effort), 0 if name == CHOICE_OFF else choosing)
        result[name] = [*(rate_difference(complete, points, m) for m in MEASURES), *seconds]
    return result


def table(results):
    """Markdown of the means over run_cloud's results."""
    lines = ["| tool change | BD-rate RGB, % | BD-rate Y, % | encode, s/Mpoint | decode, s/Mpoint |", "|---|---|---|---|---|"]
    for name in results[0]:
        rgb, y, encode, decode = np.mean([r[name] for r in results], axis=0)
        rates = "0 | 0" if name == COMPLETE else f"{rgb:+.2f} | {y:+.2f}"
        lines.append(f"| {name} | {rates} | {encode:.2f} | {decode:.2f} |")
    return "\n".join(lines) + "\n"


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clouds", type=Path, required=True)
    parser.add_argument("--effort", default="balanced", choices=EFFORTS)
    parser.add_argument("--qp", default=QPS)
    parser.add_argument("--out", type=Path, help="file to write instead of stdout")
    args = parser.parse_args(arguments)
    results = []
    for path in cloud_paths(args.clouds):
        results.append(run_cloud(load_cloud(path), args.effort, [int(q) for q in args.qp.split(",")]))
        print(f"{path.stem} done", file=sys.stderr)
    if args.out:
        args.out.write_text(table(results), encoding="utf-8")
    else:
        print(table(results), end="")


if __name__ == "__main__":
    main()
