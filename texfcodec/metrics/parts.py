"""Error of a decoded stream part by part: a part is the surface that has one material."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.colour_error import PEAK, colour_mse, decibels
from ..core.json_text import json_ready
from ..geometry.areas import relative_areas, sample_surface
from ..scene.scene import ALPHA_MASK, ALPHA_OPAQUE
from .psnr_3d import SourceSamples

if TYPE_CHECKING:
    from ..scene.scene import Material, Scene
    from ..texf import Texf

SAMPLES, LEAST_SAMPLES = 1 << 16, 512  # of the whole; of a part, so that small ones are seen
ROUNDING = 0.5  # levels of alpha that do not count as a change of side


def compare_parts(scene: Scene, texf: Texf, threads: int = 1) -> dict | None:
    """Return the colour errors of texf against its source scene, over the whole surface and for each material (a part).

    Parameters
    ----------
    scene : Scene
        The source.
    texf : Texf
        Its decoded stream.
    threads : int
        Most threads.

    Returns
    -------
    dict or None
        "y", "rgb": PSNR in dB over the whole surface, by area; "alpha": the same, if a material is not opaque; "parts":
        [{"material": its number, "name", "share": of the area, "y", "rgb"}]. A PSNR of None means no error. Parts that the source
        does not show are left out; None if it shows none.
    """
    areas = relative_areas(scene.positions, scene.faces)
    if not areas.sum() > 0:
        return None
    share = np.bincount(scene.face_material, areas / areas.sum(), len(scene.materials))
    samples = SourceSamples(scene, threads=threads, at=_points(scene, areas, share))
    got, weights = samples.answers(texf), samples.weights(texf)
    material, parts, total, shown = scene.face_material[samples.face], [], {"y": 0.0, "rgb": 0.0}, 0.0
    for number in np.unique(material):
        rows = np.flatnonzero(material == number)
        weight = None if weights is None else weights[rows]
        visible = 1.0 if weight is None else float(weight.mean())
        if not visible:
            continue
        mse = colour_mse(samples.colour[rows, :3], got[rows, :3], weight)
        total = {name: value + share[number] * visible * mse[name] for name, value in total.items()}
        shown += share[number] * visible
        parts.append({"material": int(number), "name": scene.materials[number].name or f"material {number}",
                      "share": round(float(share[number]), 6), **_psnr({name: mse[name] for name in ("y", "rgb")})})
    if not shown > 0:
        return None
    return _psnr({name: value / shown for name, value in total.items()} | _alpha(scene, samples, got)) | {"parts": parts}


def _psnr(mse):
    return json_ready({name: decibels(value) for name, value in mse.items()})


def _points(scene, areas, share):
    """(face int64 [M], bary float64 [M, 3]) of points spread evenly by area within each part; small parts get more than their
    share."""
    used = np.flatnonzero(share > 0)
    least = min(LEAST_SAMPLES, SAMPLES // len(used) + 1)
    drawn = []
    for number in used:
        faces = np.flatnonzero(scene.face_material == number)
        count = max(round(share[number] * SAMPLES), least)
        face, bary = sample_surface(scene.positions, scene.faces[faces], count, areas=areas[faces])
        drawn.append((faces[face], bary))
    return np.concatenate([face for face, _ in drawn]), np.concatenate([bary for _, bary in drawn])


def _alpha(scene, samples, got):
    """{"alpha": mean squared error} over points of materials that are not opaque, as the encoder counts it; {} without any."""
    material = scene.face_material[samples.face]
    rows = np.flatnonzero(np.array([m.alpha_mode != ALPHA_OPAQUE for m in scene.materials], bool)[material])
    if not len(rows):
        return {}
    return {"alpha": alpha_mse(samples.colour[rows, 3], got[rows, 3], material[rows], scene.materials)}


def alpha_mse(reference: np.ndarray, got: np.ndarray, material: np.ndarray, materials: list[Material]) -> float:
    """Return the mean squared error of alpha at points, as each material uses alpha.

    Parameters
    ----------
    reference, got : float32 [M]
        Alpha, 0..255.
    material : int64 [M]
        Indices into materials.
    materials : list of Material
        They say how alpha is used.

    Returns
    -------
    float
        In squared levels of 0..255. Under a mask only visibility counts: a point on the wrong side of the cutoff is PEAK off and
        any other is right.
    """
    cutoff = np.array([PEAK * m.alpha_cutoff for m in materials])[material]
    masked = np.array([m.alpha_mode == ALPHA_MASK for m in materials], bool)[material]
    off = np.abs(got.astype(np.float64) - reference)
    wrong = ((reference >= cutoff) != (got >= cutoff)) & (off > ROUNDING)
    return float((np.where(masked, PEAK * wrong, off) ** 2).mean())
