"""Speed of the attribute codec beside TMC13's, on the same clouds, in one run on one machine.

python tools/bench/tmc13_speed.py --clouds DIR [--program tmc3] [--qp 28] [--runs 3]

DIR as for anchor_bdrate.py. TMC13 (built from the MPEG group's public sources: cmake, make) codes and decodes each cloud in one
thread; its times are those that its log gives for the attributes, processor time, summed over its slices. Ours is one thread at
each effort, encoding with the choice of tools. All take turns, run by run, and the fastest of each counts. Prints a Markdown
table of millions of points a second, and of bytes of the attributes at this QP.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.codecs.raht.tool_choice import EFFORTS
from texfcodec.field.morton import decode_morton
from tools.bench.anchor_bdrate import choose, cloud_paths, code, load_cloud
from tools.bench.methods.external import GEOMETRY, POINT, TRANSFORMS

TIME = re.compile(r"^colors processing time \(user\): ([\d.]+) s", re.MULTILINE)
SIZE = re.compile(r"^colors bitstream size (\d+) B", re.MULTILINE)


def write_ply(path, cloud):
    """The cloud as TMC13 reads it."""
    points = np.empty(len(cloud.keys), POINT)
    for axis, name in enumerate("xyz"):
        points[name] = decode_morton(cloud.keys)[:, axis]
    for column, name in enumerate(("red", "green", "blue")):
        points[name] = cloud.rgb[:, column]
    kinds = {"<f4": "float", "|u1": "uchar"}
    head = [f"property {kinds[POINT[name].str]} {name}" for name in POINT.names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *head, "end_header"]
    path.write_bytes("\n".join(lines).encode() + b"\n" + points.tobytes())


def called(program, *arguments):
    """(processor seconds of the attributes, their bytes) by the log of one run; ends the program where that has neither."""
    run = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if run.returncode or not TIME.search(run.stdout):
        raise SystemExit(f"{program} ends with {run.returncode}: {(run.stderr or run.stdout)[-500:]}")
    return sum(map(float, TIME.findall(run.stdout))), sum(map(int, SIZE.findall(run.stdout)))


def tmc13(program, folder, cloud, qp):
    """(seconds of encoding, of decoding, bytes) of one run each."""
    source, stream, back = (folder / name for name in ("cloud.ply", "cloud.bin", "back.ply"))
    write_ply(source, cloud)
    encoding, size = called(program, "--mode=0", *GEOMETRY, *TRANSFORMS["raht"], f"--qp={qp}", "--bitdepth=8",
                            "--attribute=color", f"--uncompressedDataPath={source}", f"--compressedStreamPath={stream}")
    decoding, _ = called(program, "--mode=1", f"--compressedStreamPath={stream}", f"--reconstructedDataPath={back}",
                         "--convertPlyColourspace=1")
    return encoding, decoding, size


def ours(cloud, qp, effort):
    """The same of one effort in one thread."""
    tools, choosing = choose(cloud, qp, effort, 1)
    fields, _, encoding, decoding = code(cloud, qp, tools, 1)
    return choosing + encoding, decoding, len(fields["codeword_data"])


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clouds", type=Path, required=True)
    parser.add_argument("--program", default="tmc3")
    parser.add_argument("--qp", type=int, default=28)
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args(arguments)
    names, speeds = ("TMC13", *EFFORTS), []
    print("| cloud | " + " | ".join(f"{name}: encode / decode, bytes" for name in names) + " |")
    print("|---" * (1 + len(names)) + "|")
    with tempfile.TemporaryDirectory() as folder:
        for path in cloud_paths(args.clouds):
            cloud, times = load_cloud(path), {name: [] for name in names}
            for _ in range(args.runs):
                times["TMC13"].append(tmc13(args.program, Path(folder), cloud, args.qp))
                for effort in EFFORTS:
                    times[effort].append(ours(cloud, args.qp, effort))
            rows = {name: np.min(times[name], axis=0) for name in names}
            speeds.append([len(cloud.keys) / 1e6 / rows[name][:2] for name in names])
            cells = [f"{e:.2f} / {d:.2f}, {rows[name][2]:,.0f}" for name, (e, d) in zip(names, speeds[-1], strict=True)]
            print(f"| {path.stem} | {' | '.join(cells)} |", flush=True)
    print("| mean | " + " | ".join(f"{e:.2f} / {d:.2f}" for e, d in np.mean(speeds, axis=0)) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
