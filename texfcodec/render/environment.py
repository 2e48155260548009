"""The light of shaded pictures: an analytic sky and a few directional lights, in linear radiance.

The sky's colour depends only on the height y of a direction (y is up, as in glTF): a Bezier curve of degree DEGREE over (1 + y) /
2 from the nadir to the zenith. A polynomial in y of that degree is a sum of as many Legendre polynomials. Averaging a sky with a
lobe that is symmetric about an axis multiplies each of them by a number of the lobe (Funk and Hecke). So the irradiance of every
normal is a polynomial again, exactly, and the radiance averaged with the lobe of GGX is a function of height and roughness alone:
a small table, exact at its nodes.

Lights are parallel. Each has an angular radius that widens highlights, so that they cover more than a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre

from .look_up import look_up

DEGREE = 8  # of the sky in the height: nine colours
HEIGHTS, ROUGHNESSES = 65, 33  # nodes of the prefiltered sky; the error between them: tests/render/test_environment.py
MIN_ALPHA = 2e-3  # GGX's alpha (roughness squared) of a perfect mirror


@dataclass(frozen=True, eq=False, kw_only=True)
class Light:
    """A directional light.

    Parameters
    ----------
    direction : float64 [3]
        Unit, towards the light.
    irradiance : float [3]
        Linear RGB, on a surface that faces it.
    radius : float
        Angular radius in radians.
    """

    direction: np.ndarray
    irradiance: np.ndarray
    radius: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Environment:
    """A sky whose colour depends on the height alone, and directional lights.

    Parameters
    ----------
    gradient : float64 [DEGREE + 1, 3]
        Linear RGB, the sky's control colours from the nadir to the zenith.
    lights : tuple of Light
        The lights.
    exposure : float
        Factor of the radiance before it is coded.
    """

    gradient: np.ndarray
    lights: tuple[Light, ...] = ()
    exposure: float = 1.0

    def radiance(self, direction: np.ndarray) -> np.ndarray:
        """Return the radiance of the sky in given directions, without the lights.

        Parameters
        ----------
        direction : float32 [3, M]
            Unit directions.

        Returns
        -------
        float32 [3, M]
            Linear RGB.
        """
        return _horner(self.powers, direction[1])

    def irradiance(self, normal: np.ndarray) -> np.ndarray:
        """Return the sky's irradiance over pi on surfaces with given normals, without the lights; exact.

        Parameters
        ----------
        normal : float32 [3, M]
            Unit normals.

        Returns
        -------
        float32 [3, M]
            Linear RGB.
        """
        return _horner(self.diffuse_powers, normal[1])

    def prefiltered(self, direction: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """Return the sky's radiance averaged with the lobe of GGX, as it is when seen straight on.

        Parameters
        ----------
        direction : float32 [3, M]
            Unit directions, about which the lobe lies.
        roughness : float32 [M]
            Of glTF, 0..1.

        Returns
        -------
        float32 [3, M]
            Linear RGB.
        """
        return look_up(self.prefiltered_table, 0.5 + 0.5 * direction[1], roughness)

    def build(self) -> None:
        """Builds the tables now, so that threads only read."""
        _ = self.powers, self.diffuse_powers, self.prefiltered_table

    @cached_property
    def _zonal(self):
        """Coefficients [DEGREE + 1, 3] of the sky in Legendre polynomials of the height, exact by Gauss's nodes."""
        nodes, weights = legendre.leggauss(DEGREE + 1)
        sky = _bernstein((1 + nodes) / 2) @ np.asarray(self.gradient, np.float64)
        basis = legendre.legvander(nodes, DEGREE)
        return (basis * weights[:, None]).T @ sky * (np.arange(DEGREE + 1) + 0.5)[:, None]

    @cached_property
    def powers(self) -> np.ndarray:
        """Coefficients float32 [DEGREE + 1, 3] of the sky's radiance in powers of the height."""
        return _in_powers(self._zonal)

    @cached_property
    def diffuse_powers(self) -> np.ndarray:
        """Coefficients float32 [DEGREE + 1, 3] of the sky's irradiance over pi in powers of the normal's height."""
        return _in_powers(self._zonal * cosine_lobe()[:, None])

    @cached_property
    def prefiltered_table(self) -> np.ndarray:
        """Table of prefiltered(), float32 [HEIGHTS, ROUGHNESSES, 3]."""
        basis = legendre.legvander(np.linspace(-1, 1, HEIGHTS), DEGREE)
        lobes = np.array([ggx_lobe(r * r) for r in np.linspace(0, 1, ROUGHNESSES)])
        return np.ascontiguousarray(np.einsum("hl,rl,lc->hrc", basis, lobes, self._zonal), np.float32)


def _bernstein(t):
    """The Bernstein polynomials [N, DEGREE + 1] at t in 0..1."""
    k = np.arange(DEGREE + 1)
    return np.array([math.comb(DEGREE, i) for i in k]) * t[:, None] ** k * (1 - t[:, None]) ** (DEGREE - k)


def _in_powers(coefficients):
    """Legendre coefficients [DEGREE + 1, 3] as coefficients of powers, float32."""
    return np.array([legendre.leg2poly(column) for column in coefficients.T], np.float32).T


def _horner(powers, y):
    out = np.empty((powers.shape[1], len(y)), np.float32)
    for channel, column in zip(out, powers.T, strict=True):
        channel[:] = column[-1]
        for value in column[-2::-1]:
            channel *= y
            channel += value
    return out


@lru_cache(maxsize=1)
def _gauss_nodes(count):
    return legendre.leggauss(count)


@lru_cache(maxsize=1)
def cosine_lobe() -> np.ndarray:
    """Factors float64 [DEGREE + 1] by which the mean over a hemisphere, weighted by the cosine, changes Legendre polynomials."""
    nodes, weights = legendre.leggauss(DEGREE + 1)
    x = (1 + nodes) / 2
    return 2 * (weights / 2 * x) @ legendre.legvander(x, DEGREE)


@lru_cache(maxsize=64)
def ggx_lobe(alpha: float) -> np.ndarray:
    """Return the lobe that GGX reflects when seen straight on, weighted by the light's cosine, as a series of Legendre
    polynomials.

    Parameters
    ----------
    alpha : float
        Roughness squared.

    Returns
    -------
    float64 [DEGREE + 1]
        Factors of the polynomials of degree 0, 1, ..., by which a sky's coefficients are multiplied.

    Notes
    -----
    With u uniform, cos^2 of the half vector is (1 - u) / (1 + (alpha^2 - 1) u), and the light is twice as far from the axis; u
    ends at 1 / (1 + alpha^2), where the light sinks below the surface.
    """
    square = max(alpha, MIN_ALPHA) ** 2
    nodes, weights = _gauss_nodes(200)
    z = (1 + nodes) / 2  # u = end * (1 - z^3) crowds the nodes where a narrow lobe is steep
    u, weights = (1 - z**3) / (1 + square), weights * z**2
    cosine = 2 * (1 - u) / (1 + (square - 1) * u) - 1
    weights = weights * np.maximum(cosine, 0)
    return weights @ legendre.legvander(cosine, DEGREE) / weights.sum()


def furnace(radiance: Sequence[float] = (1.0, 1.0, 1.0)) -> Environment:
    """Return the environment with the same radiance from everywhere and no light (white furnace test): a white surface that loses
    nothing is invisible in it.

    Parameters
    ----------
    radiance : float [3]
        Linear RGB.

    Returns
    -------
    Environment
        Without lights.
    """
    return Environment(gradient=np.tile(np.asarray(radiance, np.float64), (DEGREE + 1, 1)))


def _light(direction, colour, strength, radius):
    towards = np.asarray(direction, np.float64)
    irradiance = np.pi * strength * np.asarray(colour, np.float64)
    return Light(direction=towards / np.linalg.norm(towards), irradiance=irradiance, radius=radius)


_GROUND, _HORIZON, _ZENITH = np.array([0.16, 0.14, 0.12]), np.array([0.78, 0.80, 0.82]), np.array([0.24, 0.36, 0.62])
# Dim ground, a bright band at the horizon that mirrors show as an edge, blue above; a warm sun at the upper right, a cool fill
# light at the left and one from behind, so that none of the six usual views lies in the dark.
DAYLIGHT = Environment(
    gradient=np.array([_GROUND, _GROUND, _GROUND, _GROUND, _HORIZON, _HORIZON, 0.5 * (_HORIZON + _ZENITH), _ZENITH, _ZENITH]),
    lights=(_light((0.5, 0.8, 0.6), (1.0, 0.95, 0.86), 0.50, 0.06), _light((-0.75, 0.25, 0.45), (0.85, 0.92, 1.0), 0.14, 0.15),
            _light((-0.2, 0.4, -0.9), (1.0, 0.98, 0.95), 0.22, 0.10)),
)
