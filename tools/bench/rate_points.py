"""Rate points: every asset coded by every method at every setting and measured, a folder per job; may be stopped at any moment.

python tools/bench/rate_points.py CONDITIONS.toml --out DIR [--jobs N | --scheduler tcp://HOST:PORT] [--assets FOLDER]
        [--keep-old] [--limit-seconds S] [--memory-limit BYTES] [--asset NAME ...] [--evaluation KEY=VALUE ...]
        [--rows FILE.jsonl]
python tools/bench/rate_points.py [RECORD ...] --verify --out DIR --assets FOLDER [--asset NAME ...] [--neural] [--page FILE.md]

CONDITIONS.toml (see tools/conditions/):

    title = "what this is for"                        # optional
    assets = ["sample", "bball_0001", "meshes/a.obj"] # in FOLDER, else beside this file; "sample" is the package's own
    plugins = ["my_codec.py"]                         # optional: further methods, beside this file; see tools/bench/methods
    limit_seconds = 3600                              # optional: a job that takes longer is killed and has failed
    [evaluation]                                      # optional, as is each line
    samples = 1000000                                 # surface points of 3D-PSNR; 0: none
    seed = 0                                          # of these points
    views = 16                                        # rendered views; 0: no image measures
    size = 2048
    ssim = false
    maps = false                                      # errors of the maps of materials
    lit = false                                       # views in daylight, by all maps
    pictures = 0                                      # of the views, as many, of source and decoded, in the job's folder
    picture_size = 512
    [[settings]]                                      # any number of them
    name = "{effort}_{rate}"                          # a folder name
    group = "{effort}"                                # optional (the method): settings that form one curve
    method = "texf"                                   # optional
    assets = ["sample"]                               # optional: for these only
    effort = ["fast", "balanced"]                     # the rest goes to the method; a list makes a setting of each value, two
    rate = ["r01", "r02"]                             # lists one of each pair, and {NAME} stands for the value

A job is one asset at one setting in DIR/ASSET/SETTING: job.json (what was asked for, by which code), the method's own files
(ours: stream.texf), encode.json, log.txt (what the two processes said) and metrics.json, written last. The folder appears whole,
by rename, when its job has ended. Encoding and decoding run in fresh processes of their own, warmed up on a tiny mesh before
clock and memory count, with cores / N threads each. The same command does only what is not finished: jobs whose settings, asset
and code are those of their metrics.json stay as they are (--keep-old: of whatever code). Where the decoder's values are not those
of the encoder's reconstruction the job fails. A failed job stops no other and is tried again by the next run; assets that are not
there are named and passed over. missing.json in place of metrics.json is a row of its own, no failure: "missing", what is not
installed and how to get it, tried again by the next run; or "does not apply", the asset has nothing that the method could code.

With --scheduler the jobs run on a Dask cluster, by workers that have the same code; they see DIR, or results and assets are sent
to and fro (at most 1 GiB each). A worker's threads and memory limit are shared out among the jobs that it works at, as many as it
has threads, or N of them where it was started with --resources texf=N. What a lost worker had begun is begun again by others.

--verify makes the recorded points of ours again and compares bytes and values: of RECORD, or of all that tools/bench keeps
(verify.py). Its page says how many points have the same bytes, and which have not.

Exit code: 0 all jobs are finished, 1 the conditions are wrong, 2 the command line is, there is nothing to do, a disk is full or
the cluster cannot be reached, 7 a job failed or differs, 130 interrupted. Tables and plots are made by collect.py.
"""

import argparse
import sys
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.batch import resumable, run_conditions, run_verify
from tools.bench.results import unpack_rows
from tools.bench.steps import run_step


def main(arguments=None):
    """Run the tool; return its exit code. arguments: the words of its command line, sys.argv by default."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["--step"]:
        return run_step(*arguments[1:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", type=Path, nargs="*", metavar="CONDITIONS.toml", help="with --verify records")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="jobs at a time")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="run them on this Dask cluster")
    parser.add_argument("--assets", type=Path, metavar="FOLDER", help="where the assets are")
    parser.add_argument("--asset", action="append", default=[], metavar="NAME", help="of the file's assets this one; repeatable")
    parser.add_argument("--evaluation", action="append", default=[], metavar="KEY=VALUE",
                        help="in the place of a line of [evaluation], such as size=1024; repeatable")
    parser.add_argument("--keep-old", action="store_true", help="keep what other states of the code have finished")
    parser.add_argument("--limit-seconds", type=seconds, metavar="S", help="longest time of a job")
    parser.add_argument("--memory-limit", type=int, metavar="BYTES", help="most data that a process of a job may hold")
    parser.add_argument("--rows", type=Path, metavar="FILE.jsonl", help="begin with the jobs that collect.py --keep has kept "
                        "there, where DIR does not have them; with --keep-old, if code has changed since")
    parser.add_argument("--verify", action="store_true", help="make recorded points again and compare")
    parser.add_argument("--neural", action="store_true", help="with --verify 3DNTC payloads as well")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the page of --verify here too")
    args = parser.parse_args(arguments)
    if len(args.records) != 1 and not args.verify:
        parser.error("name one condition file")
    if args.rows:
        unpack_rows(args.rows, args.out)
    return resumable(run_verify if args.verify else run_conditions, args)


def seconds(text):
    """Parse the value of a flag: a number of seconds above 0. Raises ValueError, to which argparse adds the flag."""
    if not 0 < float(text) < float("inf"):
        raise ValueError(text)
    return float(text)


if __name__ == "__main__":
    sys.exit(main())
