"""Inputs of the GPU fits, made where Draco is: python -m tools.gpu.prepare --assets FOLDER --out FOLDER

A full run draws 15 million samples an asset, which would not travel in 25 MB; so the surface that they are drawn from travels
(fit_samples.Source: lattice, faces, images), the design of each point, and the seeds. The machine with the GPU draws the same
samples with the same kernels. `--cpu-fit STEPS` fits with the CPU kernels too and writes what they reach to cpu_fits.json.
The files are pickles: read only those that you have written.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import texfcodec
from texfcodec import EncodeOptions
from texfcodec.codecs.neural import fit_payload
from texfcodec.codecs.neural.fit import BATCH, Fit
from texfcodec.codecs.neural.fit_samples import Samples, Source
from texfcodec.scene.channels import ALPHA

CASES = (("player", "bball_0001.glb", ("mpeg1", "mpeg6")), ("bottle", "waterbottle_pbr.glb", ("mpeg1",)))
POSITION_BITS = 18  # as in tools/conditions/materials.toml
SEED = 0  # samples take [SEED, 0], held-out points [SEED, 1], latents and weights SEED, batches [SEED, 1, epoch]
SMALL_SAMPLES = 1 << 14


class _Captured(Exception):
    """Ends an encode once the source of its fit is known."""


def capture(path: Path, points: tuple[str, ...], threads: int) -> dict[str, Any]:
    """What a fit needs of an asset: {"source": fit_samples.Source, "designs": (Payload, Tables, resident bytes) by point,
    "judged", "rgb": components}."""
    taken: dict[str, Any] = {}

    def take(source: Any, options: Any, report: Any) -> None:
        for point in points:
            components = sum(channel.components for channel in source.channels)
            wanted = EncodeOptions(codec="3dntc", point=point, position_bits=POSITION_BITS, threads=threads)
            bits = source.surface.cube.position_bits
            design = fit_payload.choose_design(source.surfaces, bits, components, wanted)  # type: ignore[arg-type]
            taken.setdefault("designs", {})[point] = (design.payload, design.tables, design.resident["total"])
        taken["source"] = _portable(Source(source, threads))
        raise _Captured

    kept, fit_payload.fit_payload = fit_payload.fit_payload, take  # type: ignore[assignment]
    try:
        texfcodec.encode(path, EncodeOptions(codec="3dntc", point=points[0], position_bits=POSITION_BITS, threads=threads))
    except _Captured:
        pass
    finally:
        fit_payload.fit_payload = kept
    places = fit_payload.components_of(taken["source"].channels)
    taken["judged"] = [c for channel, columns in places.items() if channel is not ALPHA for c in columns]
    taken["rgb"] = list(next(iter(places.values())))
    return taken


def _portable(source):
    """The source with nothing that does not pickle."""
    source.on_pictures = None
    if source._maps is not None:
        source._maps._rebuilt = partial(np.asarray, source._maps._frames.rebuilt)  # a lambda does not pickle
        del source._maps.__dict__["_frames"]
    return source


def write(taken: dict[str, Any], path: Path) -> None:
    """Write what capture() returned, deflated."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(zlib.compress(pickle.dumps(taken), 9))


def read(path: Path) -> dict[str, Any]:
    """Mirror of write()."""
    return pickle.loads(zlib.decompress(path.read_bytes()))


def draw(taken: dict[str, Any], steps: int, threads: int) -> tuple[Samples, Samples]:
    """Samples and held-out points as fit_payload() draws them for so many steps."""
    least = SMALL_SAMPLES if steps < 1000 else fit_payload.LEAST_SAMPLES
    wanted = int(np.clip(steps * BATCH // 8, least, fit_payload.MOST_SAMPLES))
    taken["source"].threads = threads
    held_out = fit_payload.HELD_OUT if steps >= 1000 else SMALL_SAMPLES
    return taken["source"].draw_busy(wanted, [SEED, 0]), taken["source"].draw(held_out, [SEED, 1])


def cpu_fit(taken: dict[str, Any], point: str, drawn: tuple[Samples, Samples], steps: int, threads: int,
            on_look: Callable[[Fit, int], object] = lambda fit, steps: None) -> dict[str, Any]:
    """Figures of a fit by the kernels of train.py. on_look: as of Fit.run."""
    design, tables, _ = taken["designs"][point]
    fit = Fit(design, tables, *drawn, SEED, threads, judged=taken["judged"])
    fit.run(steps, on_look)
    rgb = fit_payload.pooled_psnr(fit.errors(exact=True), taken["rgb"])
    return {"steps": fit.step, "batch": BATCH, "seconds": round(fit.seconds, 1), "threads": threads, "cores": os.cpu_count(),
            "psnr_db": round(fit.psnr(exact=True), 3), "psnr_rgb_db": round(rgb, 3), "log": fit.log}


def cases(assets: Path) -> Iterator[tuple[str, Path, tuple[str, ...]]]:
    """(name, path, points) of the cases whose file is there."""
    for name, file, points in CASES:
        if (assets / file).is_file():
            yield name, assets / file, points


def main() -> None:
    """Write the inputs, and what the CPU kernels reach if that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--cpu-fit", type=int, default=0, metavar="STEPS")
    given = parser.parse_args()
    for name, path, points in cases(given.assets):
        write(capture(path, points, given.threads), given.out / f"{name}.fit")
        print(name, (given.out / f"{name}.fit").stat().st_size, "bytes", flush=True)
    if given.cpu_fit:
        _fit_all(given)


def _fit_all(given):
    path = given.out / "cpu_fits.json"
    figures = json.loads(path.read_text()) if path.is_file() else {}
    for name, _, points in cases(given.assets):
        taken = read(given.out / f"{name}.fit")
        drawn = draw(taken, given.cpu_fit, given.threads)
        for point in points:
            key = f"{name}/{point}/{given.cpu_fit}"
            if key not in figures:
                figures[key] = cpu_fit(taken, point, drawn, given.cpu_fit, given.threads)
                path.write_text(json.dumps(figures, indent=1))
                print(key, {k: v for k, v in figures[key].items() if k != "log"}, flush=True)


if __name__ == "__main__":
    main()
