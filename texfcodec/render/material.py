"""Lit colours of surface points: glTF's metallic-roughness model with the effects that each material uses, and their sRGB coding.

Points are processed in groups whose materials use the same effects. A group computes only the terms of its effects; effects that
no material in view uses are never computed.
"""

from __future__ import annotations

import numpy as np

from ..core.threads import over_blocks
from ..scene.srgb import linear_to_srgb
from . import terms
from .environment import Environment
from .lobes import build_tables
from .material_effects import TERMS, ShadingTable
from .shading_points import ShadedSurface, ShadingPoints

BLOCK = 1 << 14  # points at a time: the columns of one term stay in the cache


def shade(points: ShadingPoints, table: ShadingTable, environment: Environment, threads: int = 1) -> np.ndarray:
    """Return the radiance of surface points towards the eye.

    Parameters
    ----------
    points : ShadingPoints
        M surface points.
    table : ShadingTable
        Their materials.
    environment : Environment
        Sky and lights.
    threads : int
        Most threads; the result does not depend on it.

    Returns
    -------
    float32 [M, 3]
        Linear RGB, finite and not negative. Unlit materials have their base colour divided by the environment's exposure, so that
        expose() restores it.

    Raises
    ------
    IndexError
        A material is not in the table.
    """
    material = points.material
    if len(material) and (material.min() < 0 or material.max() >= len(table.effects)):
        raise IndexError("material index outside the table")
    out = np.empty((len(material), 3), np.float32)
    if table.is_lit:
        environment.build()
        build_tables()
    called = [tuple(sorted(effects & TERMS)) for effects in table.effects]
    kinds = sorted(set(called))
    kind_of = np.array([kinds.index(names) for names in called], np.int64)
    which = kind_of[material] if len(kinds) > 1 else None
    for number, kind in enumerate(kinds):
        members = None if which is None else np.flatnonzero(which == number)

        def shade_block(begin, kind=frozenset(kind), members=members):
            chosen = slice(begin, begin + BLOCK) if members is None else members[begin : begin + BLOCK]
            out[chosen] = _radiance(ShadedSurface(points, table, chosen), kind, environment).T

        over_blocks(shade_block, len(material) if members is None else len(members), BLOCK, threads)
    return out


def expose(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Convert radiance to sRGB-coded colours: multiply by the exposure, clamp at 1, code.

    Parameters
    ----------
    radiance : float32 [M, 3]
        Linear RGB; NaN counts as 0.
    exposure : float
        Factor.

    Returns
    -------
    float32 [M, 3]
        0..255. There is no film curve, so that a difference of pictures is a difference of light.
    """
    out = np.empty(radiance.shape, np.float32)
    for begin in range(0, len(radiance), BLOCK):
        part = slice(begin, begin + BLOCK)
        light = np.fmin(np.fmax(radiance[part] * np.float32(exposure), np.float32(0)), np.float32(1))
        out[part] = 255 * linear_to_srgb(light)
    return out


def _radiance(surface, effects, environment):
    """Radiance [3, m] of points with the same effects."""
    if "lit" not in effects:
        return surface.base / np.float32(environment.exposure)
    surface.stand()
    if "occlusion" in effects:
        terms.occlusion(surface)
    total = _base(surface, effects, environment)
    if "sheen" in effects:
        total = terms.sheen(surface, environment, total)
    if "emission" in effects:
        total = terms.emission(surface, total)
    if "clearcoat" in effects:
        total = terms.clearcoat(surface, environment, total)
    return total


def _base(surface, effects, environment):
    """Radiance of the base layer, a mix of metal and dielectric. If all points are of one kind, only that is computed."""
    straight, f90 = terms.specular(surface) if effects & {"specular", "ior"} else (terms.DIELECTRIC, np.float32(1))
    coloured = (lambda f0: terms.iridescence(surface, f0)) if "iridescence" in effects else (lambda f0: f0)
    lobe = terms.anisotropic_gloss(surface, environment) if "anisotropy" in effects else terms.gloss(surface, environment)
    total, metallic = np.zeros_like(surface.base), surface.metallic
    if (metallic > 0).any():
        total += metallic * lobe.light(coloured(surface.base), np.float32(1))
    if (metallic < 1).any():
        straight = coloured(straight)
        lost = lobe.albedo(straight.max(axis=0) if straight.ndim else straight, f90)
        under = surface.base * terms.diffuse(surface, environment, lobe, lost)
        if not effects.isdisjoint(("transmission", "diffuse_transmission")):
            under = _from_behind(surface, effects, environment, under, lost)
        total += (1 - metallic) * (under + lobe.light(straight, f90))
    return total


def _from_behind(surface, effects, environment, under, lost):
    tint = terms.volume(surface) if "volume" in effects else None
    if "diffuse_transmission" in effects:
        under = terms.diffuse_transmission(surface, environment, under, lost, tint)
    if "transmission" in effects:
        under = terms.transmission(surface, environment, under, lost, tint, "dispersion" in effects)
    return under
