"""texf-view against texf-render: the same views of streams, networks at voxel centres, every shader, and what frames take.

python tools/proof/view_check.py ASSETS [--pictures FOLDER] [--only NAME ...] [--shaders] [--out FILE.md]

ASSETS is a folder of GLB files. Needs a Chromium (texfcodec/viewer/headless.py), which draws in software. Pictures are drawn at
three times the size and averaged on both sides: a graphics API places corners on a grid of 1/16 to 1/256 of a pixel, so that
pixels on edges may show another surface. --pictures keeps each view of the page beside texf-render's. Exit code 7: a target is
missed.
"""

import argparse
import io
import json
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import EXIT_DIFFERS
from texfcodec.io.load import load
from texfcodec.options import EncodeOptions
from texfcodec.render.camera import bounding_sphere, direction_of_angles, orthographic, perspective_around
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.material_effects import ShadingTable
from texfcodec.render.shade import box_down, render_texf
from texfcodec.viewer.headless import run_jobs

SIZE, AVERAGED = 512, 3  # pixels a side; samples a side that a pixel is the mean of
VIEWS = (((20.0, 15.0), None), ((-130.0, 30.0), 40.0))  # azimuth and elevation, field of view
TARGET, TOLERANCE = 45.0, 0.5  # dB; levels of 255 (clause 9)
CENTRES = 100_000
WHITE = (255, 255, 255)


@dataclass(frozen=True)
class Case:
    """An asset, what is special about it, options of the encoder, and whether it is looked at in light."""

    asset: str
    told: str
    options: dict = field(default_factory=dict)
    lit: bool = False


CASES = (
    Case("bball_0001", "voxels", {"rate": "r03", "support": "voxels"}),
    Case("cat_webp", "texels", {"support": "texels", "texel_size": 512, "rate": "r02"}),
    Case("bball_0001", "3DNTC", {"codec": "3dntc", "point": "mpeg1", "steps": 300, "fit_engine": "numba"}),
    Case("house_mask", "alpha mask", {"resolution": 512, "qp": 24}),
    Case("damaged_helmet", "PBR in light, texels", {"support": "texels", "texel_size": 1024, "rate": "r02"}, True),
    Case("waterbottle_pbr", "PBR in light, voxels", {"support": "voxels", "resolution": 512, "qp": 20}, True),
    Case("mp_room_lod3", "four fields", {"resolution": 512, "qp": 24}),
    Case("clearcoat_blend", "alpha blend, clear coat", {"resolution": 256, "qp": 24, "effects": "all"}, True),
)


def made(case, folder):
    """(the decoded Texf, its stream) of a case."""
    stream = encode_scene(load(folder / f"{case.asset}.glb"), EncodeOptions(**case.options)).data
    return decode(stream), stream


def cameras(texf):
    """[(job's camera, Camera)] of all views."""
    sphere, side = bounding_sphere(texf.positions), SIZE * AVERAGED
    found = []
    for angles, fov in VIEWS:
        direction = direction_of_angles(*angles)
        camera = orthographic(direction, *sphere, side) if fov is None else perspective_around(direction, *sphere, fov, side)
        found.append(({"direction": [float(v) for v in direction], "perspective": fov}, camera))
    return found


def agreement(texf, stream, lit, keep=None):
    """PSNR in dB of the page's pictures against texf-render's by view, over the pixels that that covers in
    full; and what a frame takes.
    keep: function of (number of the view, the two side by side)."""
    from PIL import Image

    seen = cameras(texf)
    look = {"shaded": lit, "size": [SIZE, SIZE]}
    jobs = [{"kind": "picture", "camera": told, "anti_alias": AVERAGED, "background": WHITE, **look} for told, _ in seen]
    timed = {"kind": "times", "camera": seen[0][0], "leave_out": used_effects(texf) if lit else [], **look}
    *pictures, times = run_jobs([stream], [*jobs, timed], seconds=600)
    found = []
    for number, (png, (_, camera)) in enumerate(zip(pictures, seen, strict=True)):
        drawn = render_texf(texf, camera, threads=2, shaded=DAYLIGHT if lit else None)
        covered = np.zeros((SIZE * AVERAGED) ** 2, bool)
        covered[drawn.pixel] = True
        covered = covered.reshape(SIZE, AVERAGED, SIZE, AVERAGED).all(axis=(1, 3))
        want, got = box_down(drawn.image(WHITE), AVERAGED), np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
        error = (want.astype(np.float64) - got)[covered] ** 2
        found.append(float(10 * np.log10(255**2 / error.mean())) if error.any() else np.inf)
        if keep:
            keep(number, np.hstack([got, want]))
    return found, json.loads(times)


def used_effects(texf):
    """Names of the effects of the materials that light is part of."""
    return sorted(frozenset().union(*ShadingTable(texf.materials).effects) - {"lit", "ior"})


def network_error(texf, stream):
    """The most, in levels of 255, by which the page's network is off the integers at voxel centres; how many were asked."""
    from texfcodec.codecs.neural.infer import infer, voxel_positions

    support, tables = texf.fields[0].support, texf.evaluators[0]
    xyz = support.xyz()
    xyz = xyz[np.random.default_rng(0).permutation(len(xyz))[:CENTRES]]
    positions = voxel_positions(xyz, support.resolution)
    want = infer(positions, tables).astype(np.float64) / 256
    job = {"kind": "network", "positions": positions.reshape(-1).tolist()}
    answers = run_jobs([stream], [job | {"output": n} for n in range(-(-want.shape[1] // 4))], seconds=600)
    got = np.hstack([np.frombuffer(one, "<f4").reshape(-1, 4) for one in answers])[:, : want.shape[1]]
    return float(np.abs(got - want).max()), len(positions)


def shaders(folder):
    """A row for every shader that the assets call for: (asset, support, effects, milliseconds to compile)."""
    rows = []
    for path in sorted(folder.glob("*.glb")):
        stream = encode_scene(load(path), EncodeOptions(resolution=64, effort="fast", effects="all")).data
        told = json.loads(run_jobs([stream], [{"kind": "compile", "shaded": True}], seconds=300)[0])
        rows += [(path.stem, one["kind"], " ".join(one["effects"]) or "unlit", one["milliseconds"]) for one in told]
        print(path.stem, len(told), flush=True, file=sys.stderr)
    return rows


def _report(args):
    lines, missed = ["| asset | what | PSNR, dB | frame, ms | stream, bytes |", "|---|---|---|---:|---:|"], False
    for number, case in enumerate(CASES):
        if args.only and case.told not in args.only and case.asset not in args.only:
            continue
        texf, stream = made(case, args.assets)
        keep = _keeper(args.pictures, number, case) if args.pictures else None
        begin = time.monotonic()
        psnr, times = agreement(texf, stream, case.lit, keep)
        without = "".join(f"; {name} {ms:.0f}" for name, ms in times["without"].items())
        lines.append(f"| {case.asset} | {case.told} | {' / '.join(f'{p:.1f}' for p in psnr)} | {times['frame']:.0f}{without} "
                     f"| {len(stream):,} |")
        print(lines[-1], f"{time.monotonic() - begin:.0f} s", flush=True, file=sys.stderr)
        missed |= min(psnr) < TARGET
        if texf.evaluators:
            error, count = network_error(texf, stream)
            lines.append(f"| {case.asset} | network at {count:,} voxel centres: at most {error:.3f} of 255 off | | | |")
            missed |= error > TOLERANCE
    return lines, missed


def _keeper(folder, number, case):
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    return lambda view, sheet: Image.fromarray(sheet).save(folder / f"{number}_{case.asset}_{view}.png")


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("assets", type=Path)
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    parser.add_argument("--only", action="append", metavar="NAME", help="an asset or what is special about it; repeatable")
    parser.add_argument("--shaders", action="store_true", help="compile every shader that the assets call for, nothing else")
    parser.add_argument("--out", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    if args.shaders:
        lines = ["| asset | field | effects | to compile, ms |", "|---|---|---|---:|"]
        lines += [f"| {asset} | {kind} | {effects} | {ms:.0f} |" for asset, kind, effects, ms in shaders(args.assets)]
        missed = False
    else:
        lines, missed = _report(args)
    text = "\n".join(lines) + "\n"
    sys.stdout.write(text)
    if args.out:
        args.out.write_text(text, encoding="utf-8")
    return EXIT_DIFFERS if missed else 0


if __name__ == "__main__":
    sys.exit(main())
