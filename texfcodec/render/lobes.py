"""Reflection of rough surfaces: microfacet lobes under directional lights, and their integrals under a sky.

Arrays are float32, [M] or [3, M], one column per point. n: unit normal, v: unit direction to the eye, nv: their cosine kept above
LEAST. GGX with the height-correlated masking of Smith and Fresnel's law after Schlick is the model of glTF 2.0, appendix B;
Charlie with the visibility of Neubelt and Pettineo is that of KHR_materials_sheen. Both are what the tables below integrate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .environment import MIN_ALPHA, Light
from .look_up import look_up

LEAST = np.float32(1e-3)  # cosine of the steepest view; steeper ones, and normals that face away, count as this
INV_PI = np.float32(1 / np.pi)
COSINES, ROUGHNESSES = 48, 32  # nodes of the tables; cosines stand at squares, close together where views are steep
SLICES = 48  # strata a side of the integrals behind each node


@dataclass
class LightSums:
    """Light from all lights at each point: reflected light is f0 * spec + f90 * spec_edge for any f0 and f90 of Fresnel's law.

    Attributes
    ----------
    spec, spec_edge : float32 [3, M]
        Of the lobe, with weights 1 - f and f, where f is Schlick's fifth power at the half vector.
    flat : float32 [3, M]
        Cosine over pi, unweighted.
    """

    spec: np.ndarray
    spec_edge: np.ndarray
    flat: np.ndarray


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the dot products of columns.

    Parameters
    ----------
    a : float32 [3, M]
        Vectors.
    b : float32 [3, M] or [3]
        Vectors, or one for all.

    Returns
    -------
    float32 [M]
        The products.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def reflected(n: np.ndarray, v: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Return the direction to the eye, mirrored at the normal.

    Parameters
    ----------
    n, v : float32 [3, M]
        Unit normals and directions to the eye.
    cosine : float32 [M]
        n . v, signed.

    Returns
    -------
    float32 [3, M]
        Unit directions.
    """
    return 2 * cosine * n - v


def fifth_power(cosine: np.ndarray) -> np.ndarray:
    """(1 - cosine)^5: Schlick's weight of the reflectance at grazing angles.

    Parameters
    ----------
    cosine : float32 [M]
        Clamped to 0..1.

    Returns
    -------
    float32 [M]
        0..1.
    """
    rest = 1 - np.minimum(np.maximum(cosine, np.float32(0)), np.float32(1))
    square = rest * rest
    return square * square * rest


def ggx_lights(n: np.ndarray, v: np.ndarray, nv: np.ndarray, alpha: np.ndarray, lights: Sequence[Light]) -> LightSums:
    """Sum the light of directional lights that a GGX surface reflects to the eye.

    Parameters
    ----------
    n, v, nv : float32 [3, M], [3, M], [M]
        Unit normals, unit directions to the eye, and their cosines, at least LEAST.
    alpha : float32 [M]
        Roughness squared.
    lights : sequence of Light
        The lights.

    Returns
    -------
    LightSums
        The sums, to be weighted with f0 and f90 of Fresnel's law.
    """
    signed = dot(n, v)

    def lobe(light, towards, nl, along):
        return _ggx(_widened(alpha, light), (signed + nl) / along, nl, nv)

    return _summed(n, v, lights, lobe)


def ggx_lights_through(n: np.ndarray, v: np.ndarray, nv: np.ndarray, alpha: np.ndarray, lights: Sequence[Light]) -> np.ndarray:
    """Sum the light that passes a thin sheet, rough on the eye's side, from behind: GGX of the lights mirrored to that side.

    Parameters
    ----------
    n, v, nv, alpha, lights
        As of ggx_lights().

    Returns
    -------
    float32 [3, M]
        Radiance without the loss by reflection (Fresnel's law).
    """
    out, signed = np.zeros((3, n.shape[1]), np.float32), dot(n, v)
    for light in lights:
        towards = light.direction.astype(np.float32)
        behind = -dot(n, towards)
        along = np.sqrt(np.maximum(2 + 2 * (dot(v, towards) + 2 * behind * signed), np.float32(1e-6)))
        nl = np.maximum(behind, np.float32(0))
        value = _ggx(_widened(alpha, light), (signed + nl) / along, nl, nv)
        for channel, colour in zip(out, light.irradiance.astype(np.float32), strict=True):
            channel += colour * value
    return out


def _widened(alpha, light):
    """alpha squared, widened by half the light's radius, because the half vector turns half as fast as the light."""
    return alpha * alpha + np.float32(max(light.radius / 2, MIN_ALPHA) ** 2)


def _ggx(square, nh, nl, nv):
    """Product of distribution, masking and the light's cosine.

    The masking's denominator is at least alpha nv; a lower bound prevents 0/0 if the light is below the surface.
    """
    nh = np.minimum(nh, np.float32(1))
    stretched = (1 - nh) * (1 + nh) + nh * nh * square
    seen = nl * np.sqrt(nv * nv * (1 - square) + square) + nv * np.sqrt(nl * nl * (1 - square) + square)
    return square * nl * (np.float32(0.5) * INV_PI) / (stretched * stretched * np.maximum(seen, np.float32(1e-7)))


def ggx_lights_stretched(n: np.ndarray, v: np.ndarray, nv: np.ndarray, tangents: Sequence[np.ndarray],
                         alphas: Sequence[np.ndarray], lights: Sequence[Light]) -> LightSums:
    """Sum the light that a GGX surface with different roughness along two tangents reflects; see ggx_lights().

    Parameters
    ----------
    n, v, nv, lights
        As of ggx_lights().
    tangents : two float32 [3, M]
        Unit directions, orthogonal to n and to each other.
    alphas : two float32 [M]
        Roughness squared along each.

    Returns
    -------
    LightSums
        The sums, to be weighted with f0 and f90 of Fresnel's law.
    """
    tv, bv = (dot(direction, v) for direction in tangents)

    def lobe(light, towards, nl, along):
        a, b = (np.sqrt(_widened(alpha, light)) for alpha in alphas)
        tl, bl = (dot(direction, towards) for direction in tangents)
        nh, th, bh = (dot(n, v) + nl) / along, (tv + tl) / along, (bv + bl) / along
        stretched = (th / a) ** 2 + (bh / b) ** 2 + nh * nh
        seen = nl * np.sqrt((a * tv) ** 2 + (b * bv) ** 2 + nv * nv) + nv * np.sqrt((a * tl) ** 2 + (b * bl) ** 2 + nl * nl)
        return nl * (np.float32(0.5) * INV_PI) / (a * b * stretched * stretched * np.maximum(seen, np.float32(1e-7)))

    return _summed(n, v, lights, lobe)


def _summed(n, v, lights, lobe):
    spec, spec_edge, flat = (np.zeros((3, n.shape[1]), np.float32) for _ in range(3))
    for light in lights:
        towards, colour = light.direction.astype(np.float32), light.irradiance.astype(np.float32)
        nl = np.maximum(dot(n, towards), np.float32(0))
        along = np.sqrt(np.maximum(2 + 2 * dot(v, towards), np.float32(1e-6)))  # of v + l: twice its cosine to either
        value = lobe(light, towards, nl, along)
        weight = value * fifth_power(along * np.float32(0.5))
        value -= weight
        for channel in range(3):
            spec[channel] += colour[channel] * value
            spec_edge[channel] += colour[channel] * weight
            flat[channel] += colour[channel] * INV_PI * nl
    return LightSums(spec, spec_edge, flat)


def charlie_lights(n: np.ndarray, v: np.ndarray, nv: np.ndarray, alpha: np.ndarray, lights: Sequence[Light]) -> np.ndarray:
    """Sum the light of directional lights that white cloth (Charlie's sheen lobe) reflects to the eye.

    Parameters
    ----------
    n, v, nv, lights
        As of ggx_lights().
    alpha : float32 [M]
        Roughness squared, at least MIN_CHARLIE squared.

    Returns
    -------
    float32 [3, M]
        Radiance.
    """
    out = np.zeros((3, n.shape[1]), np.float32)
    inverse = 1 / alpha
    for light in lights:
        towards = light.direction.astype(np.float32)
        nl = np.maximum(dot(n, towards), np.float32(0))
        along = np.sqrt(np.maximum(2 + 2 * dot(v, towards), np.float32(1e-6)))
        value = _charlie(np.minimum((dot(n, v) + nl) / along, np.float32(1)), inverse, nl, nv) * nl
        for channel, colour in zip(out, light.irradiance.astype(np.float32), strict=True):
            channel += colour * value
    return out


MIN_CHARLIE = 0.1  # sheen roughness below this counts as this: the lobe is a rim of less than a pixel


def _charlie(nh, inverse, nl, nv):
    sine = np.sqrt(np.maximum((1 - nh) * (1 + nh), 1e-8))
    return (2 + inverse) * sine**inverse / (2 * np.pi) / np.maximum(4 * (nl + nv - nl * nv), 1e-6)


def ggx_integral(nv: np.ndarray, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the two factors a, b of the reflectance of GGX under a white sky, f0 a + f90 b.

    Parameters
    ----------
    nv : float32 [M]
        Cosine between the normal and the direction to the eye.
    roughness : float32 [M]
        Of glTF, 0..1.

    Returns
    -------
    a, b : float32 [M]
        Factors of f0 and f90.
    """
    a, b = look_up(ggx_table(), np.sqrt(nv), roughness)
    return a, b


def charlie_integral(nv: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """Return the share of a white sky that white cloth (Charlie's sheen lobe) reflects.

    Parameters
    ----------
    nv, roughness
        As of ggx_integral().

    Returns
    -------
    float32 [M]
        At most 1.
    """
    return look_up(charlie_table(), np.sqrt(nv), roughness)[0]


def build_tables() -> None:
    """Builds the tables now, so that threads only read."""
    _ = ggx_table(), charlie_table()


@lru_cache(maxsize=1)
def ggx_table() -> np.ndarray:
    """Table of ggx_integral(), float32 [COSINES, ROUGHNESSES, 2].

    Half vectors are drawn from the distribution of visible normals as in Heitz (Sampling the GGX distribution of visible normals,
    2018): a disc, lifted on a half sphere, stretched. Weights are then the masking of the light alone, times Schlick's.
    """
    u, phi = _strata()
    side, up = np.sqrt(u) * np.cos(phi - np.pi / 2), np.sqrt(u) * np.sin(phi - np.pi / 2)
    alpha = np.maximum(np.linspace(0, 1, ROUGHNESSES) ** 2, MIN_ALPHA)[:, None]
    table = np.empty((COSINES, ROUGHNESSES, 2))
    for i, nv in enumerate(_node_cosines()):
        flat = np.sqrt(1 - nv * nv)
        length = np.hypot(alpha * flat, nv)
        x, z = alpha * flat / length, nv / length
        lifted = (1 - z) / 2 * np.sqrt(1 - side * side) + (1 + z) / 2 * up
        high = np.sqrt(np.maximum(1 - side * side - lifted * lifted, 0))
        half = alpha * (high * x - lifted * z), alpha * side, np.maximum(lifted * x + high * z, 0)
        length = np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
        vh, nh = (half[0] * flat + half[2] * nv) / length, half[2] / length
        cosine = 2 * vh * nh - nv
        nl = np.minimum(np.maximum(cosine, 1e-9), 1)
        eye, light = (0.5 * np.sqrt(1 + alpha**2 * (1 / (c * c) - 1)) + 0.5 for c in (nv, nl))  # 1 + Smith's lambda
        weight = np.where(cosine > 0, eye / (eye + light - 1), 0)
        edge = weight * fifth_power(vh)
        table[i] = np.stack([np.mean(weight - edge, axis=1), np.mean(edge, axis=1)], axis=1)
    return table.astype(np.float32)


@lru_cache(maxsize=1)
def charlie_table() -> np.ndarray:
    """Table of charlie_integral(), float32 [COSINES, ROUGHNESSES, 1].

    Strata cover the hemisphere of lights with squares as cosines, because the lobe lies at its rim.
    """
    t, phi = _strata()
    nl, sine = t * t, np.sqrt(1 - t**4)
    inverse = 1 / np.maximum(np.linspace(0, 1, ROUGHNESSES), MIN_CHARLIE)[:, None] ** 2
    table = np.empty((COSINES, ROUGHNESSES, 1))
    for i, nv in enumerate(_node_cosines()):
        along = np.sqrt(2 + 2 * (nv * nl + np.sqrt(1 - nv * nv) * sine * np.cos(phi)))
        nh = np.minimum((nv + nl) / along, 1)
        table[i, :, 0] = np.minimum(np.mean(_charlie(nh, inverse, nl, nv) * (4 * np.pi * t**3), axis=1), 1)
    return table.astype(np.float32)


def _strata():
    """Centres of even strata, as two rows: u in 0..1 and phi in 0..pi; the other half turn is their mirror image."""
    u, phi = np.meshgrid((np.arange(SLICES) + 0.5) / SLICES, (np.arange(SLICES // 2) + 0.5) / (SLICES // 2) * np.pi)
    return u.ravel(), phi.ravel()


def _node_cosines():
    return np.maximum(np.linspace(0, 1, COSINES) ** 2, float(LEAST))
