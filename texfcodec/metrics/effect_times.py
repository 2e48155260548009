"""Drawing time of each effect of a decoded stream: a picture with it and without it."""

from __future__ import annotations

import time
from dataclasses import replace

from ..render.camera import VIEWS, bounding_sphere, orthographic
from ..render.lighting import Lighting
from ..render.shade import render_texf
from ..scene.effects import EFFECTS, Effect, effects_mask, without
from ..texf import Texf

SIZE, RUNS = 512, 3


def effect_times(texf: Texf, size: int = SIZE, threads: int = 1) -> dict:
    """Measure how long a picture of a Texf takes with all shading effects, without light, and without each effect.

    Parameters
    ----------
    texf : Texf
        A decoded stream with faces and fields.
    size : int
        Side of the picture in pixels.
    threads : int
        Most threads.

    Returns
    -------
    dict
        "size"; "picture_ms": of a shaded picture from the front; "unlit_ms": of the same without light; "without_ms": {effect: of
        the shaded picture without it}, for effects that a material uses and that are not flags. Each is the fastest of RUNS.
    """
    centre, radius = bounding_sphere(texf.positions)
    camera = orthographic(VIEWS["front"], centre, radius, size)
    used = [effect for effect in EFFECTS if effect.mask & effects_mask(texf.materials) and effect.parameters]
    picture = _fastest(texf, camera, True, threads)
    dark = [effect for effect in used if effect.name != "lit"]
    without_ms = {effect.name: _fastest(_stripped(texf, effect), camera, True, threads) for effect in dark}
    return {"size": size, "picture_ms": picture, "unlit_ms": _fastest(texf, camera, False, threads), "without_ms": without_ms}


def _stripped(texf: Texf, effect: Effect) -> Texf:
    return replace(texf, materials=[without(m, effect) for m in texf.materials])


def _fastest(texf, camera, lit, threads):
    lighting, seconds = Lighting(texf) if lit else None, []
    render_texf(texf, camera, threads=threads, shaded=lighting)  # levels and tables are made once
    for _ in range(RUNS):
        begin = time.perf_counter()
        render_texf(texf, camera, threads=threads, shaded=lighting)
        seconds.append(time.perf_counter() - begin)
    return round(1000 * min(seconds), 1)
