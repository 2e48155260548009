"""What accuracy costs in time, for every knob of accuracy_knobs.py: which settings others beat, and what one more second buys.

python tools/bench/accuracy_time.py [--assets FOLDER] --asset NAME... [--knob NAME...] [--quick] [--repeats 3] --out FOLDER

Each knob is turned against the package's defaults. An encode is timed in this process with warm kernels, loading left out; its
bytes are those of the whole stream; its quality is 3D-PSNR of Y, for position bits image PSNR of Y. Metrics are compared with a
reference of many more views or samples. Writes accuracy_time.md, accuracy_time.png (where matplotlib is installed), points.csv
and NAME.jsonl, a line per run: the same command goes on from there, and measures again what other code, another asset or another
number of threads has measured. --quick takes a few values, half the K and fewer samples, and is for trying. --jobs
runs so many assets at a time, each in a process of its own. --page FILE writes the page there as well, with its picture in
pictures/ beside it.

With one thread processor seconds are the encoder's own work, whatever else the machine does; claims are made from them where the
slowest run of a setting takes over 5 % longer by the wall clock than the fastest, in the median.
"""

import argparse
import csv
import sys
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.batch.children import Caps, Children
from texfcodec.errors import EXIT_IO
from texfcodec.io.load import load
from tools.bench.accuracy_bench import Bench, known_place, place_of, run_settings
from tools.bench.accuracy_fronts import asset_of
from tools.bench.accuracy_knobs import BY_NAME, KNOBS, curve_settings
from tools.bench.accuracy_page import csv_rows, page_of
from tools.bench.accuracy_plot import draw
from tools.bench.batch import only_run, resumable, warm_cache
from tools.bench.conditions import SAMPLE, find_assets
from tools.bench.jobs import code_of

SAMPLES, QUICK_SAMPLES = 1_000_000, 200_000
ASSETS = ("bball_0001", "cat_webp", "house_mask", "snapper_vcolor")  # a scan, fine images, masks, vertex colours
NEURAL_ASSETS = ("bball_0001", "sample")  # a fit takes minutes, whatever the asset


def settings_of(place, knobs, quick):
    """The settings of an asset, without doubles, the rate curves first."""
    overs = {place.curve(knob.over) for knob in knobs if knob.applies(place)} - {None}
    settings = []
    for over in sorted(overs, key=lambda over: over != place.home):
        settings += curve_settings(place, over, quick)
    return settings + [setting for knob in knobs for setting in knob.settings(place, quick).values()]


def measure(name, path, args):
    """Asset of one asset, measured as far as it is not yet."""
    cache, samples = args.out / f"{name}.jsonl", QUICK_SAMPLES if args.quick else SAMPLES
    conditions = {"asset": sha256(path.read_bytes()).hexdigest(), "code": code_of("texf", ()), "threads": args.threads,
                  "samples": samples}
    knobs = [BY_NAME[knob] for knob in args.knob] if args.knob else [knob for knob in KNOBS if not knob.asked]
    made = []

    def bench():  # not before there is something to measure
        if not made:
            made.append(Bench(load(path), place, samples, args.threads, args.quick))
        return made[0]

    place = known_place(cache, conditions, lambda: place_of(load(path), args.threads, name in NEURAL_ASSETS, args.quick))
    measured = run_settings(settings_of(place, knobs, args.quick), bench, cache, conditions, args.repeats)
    return asset_of(name, place, measured, args.quick)


def measure_beside(assets, arguments, args):
    """Measures all assets, args.jobs at a time, each by this command in a process of its own; names of those that failed."""
    children = Children()

    def one(name):
        given = [*arguments, "--asset", str(assets[name]), "--one"]
        with open(args.out / f"{name}.log", "wb") as log:
            return children.run([str(Path(__file__).resolve()), *given], log, log, Caps(args.threads))

    try:
        with ThreadPoolExecutor(args.jobs) as pool:
            return [name for name, code in zip(assets, pool.map(one, assets), strict=True) if code]
    except BaseException:
        children.stop()
        raise


def run(args):
    """The sweep of the command line; its exit code."""
    assets, missing = assets_of(args)
    if args.one:  # a child of measure_beside
        for name, path in assets.items():
            measure(name, path, args)
        return 0
    failed = []
    with only_run(args.out):
        warm_cache()
        if args.jobs > 1 and len(assets) > 1:
            failed = measure_beside(assets, repeated(args), args)
        measured = [measure(name, path, args) for name, path in assets.items() if name not in failed]
        if measured:
            write(measured, args)
    for name in missing:
        print(f"{name}: there is no such asset", file=sys.stderr)
    for name in failed:
        print(f"{name}: failed; see {args.out / name}.log", file=sys.stderr)
    return EXIT_IO if missing or failed or not measured else 0


def assets_of(args):
    """({name: path}, names that are not there): paths as they are, else names in args.assets; "sample" is made."""
    named = [name for name in args.asset if not Path(name).is_file()]
    found, missing = find_assets(named, [args.assets] if args.assets else [], args.out)
    paths = [found.get(name, Path(name)) for name in args.asset if name not in missing]
    return {SAMPLE if path == found.get(SAMPLE) else path.stem: path for path in paths}, missing


def repeated(args):
    """The arguments that a child needs beside its asset."""
    given = ["--out", str(args.out.resolve()), "--threads", str(args.threads), "--repeats", str(args.repeats)]
    return given + ["--quick"] * args.quick + (["--knob", *args.knob] if args.knob else [])


def write(assets, args):
    """The page, its picture and points.csv, and the page once more at args.page."""
    with open(args.out / "points.csv", "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(csv_rows(assets))
    for page in filter(None, (args.out / "accuracy_time.md", args.page)):
        picture = page.parent / ("pictures" if page == args.page else "") / "accuracy_time.png"
        picture.parent.mkdir(parents=True, exist_ok=True)
        draw(assets, picture)
        text = page_of(assets, args, picture.relative_to(page.parent).as_posix())
        page.write_text(text, encoding="utf-8")
        print(page)


def main(arguments=None):
    """Command line of the tool; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, metavar="FOLDER", help="where assets are that are given by name")
    parser.add_argument("--asset", nargs="+", default=list(ASSETS), metavar="NAME", help="a name, a path or \"sample\"")
    parser.add_argument("--knob", nargs="+", choices=sorted(BY_NAME), metavar="NAME", help=", ".join(BY_NAME))
    parser.add_argument("--quick", action="store_true", help="a few values, half the K, fewer samples, once")
    parser.add_argument("--repeats", type=int, metavar="N", help="runs of a setting  [default: 3, or 1 with --quick]")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="of every encode; 1 for processor seconds")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="assets at a time")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the page here too")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    args.repeats = args.repeats or (1 if args.quick else 3)
    return resumable(run, args)


if __name__ == "__main__":
    sys.exit(main())
