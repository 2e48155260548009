"""Whole processes against their targets: wall time, peak memory, cold start, import.

    python bench/run.py [--runs 5] [--k4096] [ASSET]

ASSET: ../shared/assets/bball_0001.glb where it is, else the bundled sample (the time targets are meant for the former on two
cores). Prints a table and exits 7 when a target is missed.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
ASSET = REPOSITORY.parent / "shared" / "assets" / "bball_0001.glb"
EXIT_MISSED = 7
PEAK_BYTES, PEAK_4096_BYTES = 600e6, 4 * 2**30
# Of one asset and its stream: median seconds of a view from either, and of the stage refine
PICTURES = """
import statistics, sys, time
from texfcodec import EncodeOptions, Report, decode
from texfcodec.io.load import load
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.options import DecodeOptions, default_threads
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.shade import render_scene, render_texf
scene, threads = load(sys.argv[1]), default_threads()
texf = decode(open(sys.argv[2], "rb").read(), DecodeOptions(threads=threads))
cameras = [orthographic(fibonacci_direction(i, 16), *bounding_sphere(scene.positions), 2048) for i in range(int(sys.argv[3]))]
def median(draw):
    times = []
    for camera in cameras:
        begin = time.perf_counter()
        draw(camera)
        times.append(time.perf_counter() - begin)
    return statistics.median(times)
report = Report()
encode_scene(scene, EncodeOptions(rate="r03"), report)
print(median(lambda c: render_scene(scene, c, threads=threads)),
      median(lambda c: render_texf(texf, c, filtering=False, threads=threads)), report.seconds["refine"])
"""
IMPORT = "import time; t = time.perf_counter(); import texfcodec; print(time.perf_counter() - t)"


@dataclass
class Row:
    """One line of the table: what was measured, the value, the most it may be, and its unit ("s" or "MB")."""

    name: str
    value: float
    target: float
    unit: str

    @property
    def missed(self):
        return self.value > self.target

    def __str__(self):
        word = "MISSED" if self.missed else "ok"
        return f"{self.name:<44}{self.value:>10.2f} {self.unit:<3} target {self.target:>8.2f}  {word}"


def run_process(arguments, cache=None):
    """Runs this Python with the arguments: (wall seconds, peak resident bytes, standard output). Stops the bench on failure."""
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)} | ({"NUMBA_CACHE_DIR": str(cache)} if cache else {})
    with tempfile.TemporaryFile() as out:
        begin = time.perf_counter()
        child = subprocess.Popen([sys.executable, *map(str, arguments)], stdout=out, env=environment, cwd=REPOSITORY)
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.perf_counter() - begin
        child.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        text = out.read().decode()
    if child.returncode:
        raise SystemExit(f"{' '.join(map(str, arguments))} ended with {child.returncode}")
    return wall, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024), text


def enc_command(asset, stream, *rate):
    """Arguments of texf-enc."""
    return ["-m", "texfcodec.cli.enc", asset, stream, *(rate or ("--rate", "r03")), "--quiet"]


def dec_command(stream, cloud):
    """Arguments of texf-dec to the voxel point cloud."""
    return ["-m", "texfcodec.cli.dec", stream, cloud, "--appearance", "voxels", "--quiet"]


def warm_rows(asset, folder, runs):
    """Median wall and largest peak of texf-enc at r03 and texf-dec to voxels, kernels compiled."""
    stream, rows = folder / "warm.texf", []
    for name, command, target in (("texf-enc r03", enc_command(asset, stream), 4.0),
                                  ("texf-dec to voxel PLY", dec_command(stream, folder / "warm.ply"), 2.0)):
        run_process(command)
        walls, peaks, _ = zip(*(run_process(command) for _ in range(runs)), strict=True)
        rows.append(Row(f"{name}, wall, median of {runs}", statistics.median(walls), target, "s"))
        rows.append(Row(f"{name}, peak resident", max(peaks) / 1e6, PEAK_BYTES / 1e6, "MB"))
    return rows


def cold_rows(asset, folder):
    """First run after install: the compiled-code cache is empty."""
    stream, cache = folder / "cold.texf", folder / "cache"
    commands = (("texf-enc r03", enc_command(asset, stream)), ("then texf-dec", dec_command(stream, folder / "cold.ply")))
    return [Row(f"{name}, empty cache, wall", run_process(command, cache)[0], 40.0, "s") for name, command in commands]


def import_row(runs):
    """Seconds of `import texfcodec`, interpreter start not counted."""
    return Row(f"import texfcodec, median of {runs}",
               statistics.median(float(run_process(["-c", IMPORT])[2]) for _ in range(runs)), 0.3, "s")


def large_row(asset, folder):
    """Peak memory of an encode at K = 4096."""
    command = enc_command(asset, folder / "large.texf", "--resolution", "4096", "--qp", "28")
    return Row("texf-enc K 4096 QP 28, peak resident", run_process(command)[1] / 1e6, PEAK_4096_BYTES / 1e6, "MB")


def picture_rows(asset, folder, runs):
    """Medians of one 2048 x 2048 view from the textures and from the field, the surface fit, and texf-eval of 16 views."""
    stream = folder / "picture.texf"
    run_process(enc_command(asset, stream))
    run_process(["-c", PICTURES, asset, stream, "1"])
    view, field, fit = map(float, run_process(["-c", PICTURES, asset, stream, str(runs)])[2].split())
    rows = [Row("2048 x 2048 view from textures", view, 0.15, "s"), Row("2048 x 2048 view from the field", field, 0.4, "s"),
            Row("stage refine (surface fit) of texf-enc r03", fit, 5.0, "s")]
    for name, flag, target in (("PSNR", "--no-ssim", 12.0), ("PSNR and SSIM", "--ssim", 40.0)):
        command = ["-m", "texfcodec.cli.eval", asset, stream, flag, "--quiet"]
        rows.append(Row(f"texf-eval, 16 views, {name}, wall", run_process(command)[0], target, "s"))
    return rows


def make_sample_asset(folder):
    """The bundled sample as a file."""
    path = folder / "sample.glb"
    program = "import sys; from texfcodec.demo.asset import write_sample; write_sample(sys.argv[1])"
    run_process(["-c", program, path])
    return path


def main():
    """Measures, prints, judges."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("asset", nargs="?", type=Path, help="mesh to encode")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--k4096", action="store_true", help="also encode at K = 4096 and look at the memory")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        asset = options.asset or (ASSET if ASSET.exists() else make_sample_asset(folder))
        print(f"{asset.name}, {len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()} cores")
        rows = []
        for measured in (lambda: [import_row(options.runs)], lambda: cold_rows(asset, folder),
                         lambda: warm_rows(asset, folder, options.runs), lambda: picture_rows(asset, folder, options.runs),
                         lambda: [large_row(asset, folder)] if options.k4096 else []):
            for row in measured():
                rows.append(row)
                print(row, flush=True)
    sys.exit(EXIT_MISSED if any(row.missed for row in rows) else 0)


if __name__ == "__main__":
    main()
