"""Light of a surface point as glTF 2.0, appendix B, and its extensions write it: integrals by brute force, float64, one point."""

import math

import numpy as np

MIRROR = 2e-3  # the least alpha


def unit(vector):
    vector = np.asarray(vector, float)
    return vector / np.linalg.norm(vector)


def frame(n):
    """Two directions that stand on n and on each other."""
    side = unit(np.cross(n, (1.0, 0, 0) if abs(n[0]) < 0.7 else (0, 1.0, 0)))
    return side, np.cross(n, side)


def sky(gradient, directions):
    """De Casteljau's construction of the gradient at the height of directions [N, 3]: [N, 3]."""
    t = (1 + directions[:, 1:2]) / 2
    points = [np.broadcast_to(colour, (len(t), 3)) for colour in np.asarray(gradient, float)]
    while len(points) > 1:
        points = [(1 - t) * a + t * b for a, b in zip(points, points[1:], strict=False)]
    return points[0]


def hemisphere(n, rings=128):
    """Directions [N, 3] above n, each standing for the same share of the cosine: their mean times pi is the integral."""
    u, phi = np.meshgrid((np.arange(rings) + 0.5) / rings, (np.arange(2 * rings) + 0.5) / rings * np.pi)
    r, z = np.sqrt(u.ravel()), np.sqrt(1 - u.ravel())
    a, b = frame(n)
    return np.outer(r * np.cos(phi.ravel()), a) + np.outer(r * np.sin(phi.ravel()), b) + np.outer(z, n)


def half_vectors(n, alpha, rings=160):
    """Half vectors [N, 3] drawn from D(h) (n . h)."""
    u, phi = np.meshgrid((np.arange(rings) + 0.5) / rings, (np.arange(2 * rings) + 0.5) / rings * np.pi)
    theta = np.arctan(alpha * np.sqrt(u.ravel() / (1 - u.ravel())))
    a, b = frame(n)
    return (np.outer(np.sin(theta) * np.cos(phi.ravel()), a) + np.outer(np.sin(theta) * np.sin(phi.ravel()), b)
            + np.outer(np.cos(theta), n))


def ggx(nh, alpha):
    return alpha**2 / (math.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)


def visibility(nl, nv, alpha):
    """Smith's height-correlated masking over 4 nl nv."""
    lit = nl * np.sqrt(nv**2 * (1 - alpha**2) + alpha**2)
    return 0.5 / (lit + nv * np.sqrt(nl**2 * (1 - alpha**2) + alpha**2))


def schlick(f0, f90, vh):
    return f0 + (f90 - f0) * (1 - np.clip(vh, 0, 1))[..., None] ** 5


def microfacet(n, v, light, alpha):
    """D V of directions to the light [N, 3], and the cosines n . l and v . h."""
    half = light + v
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    nl, nv, nh = light @ n, n @ v, np.clip(half @ n, 0, 1)
    return np.where(nl > 0, ggx(nh, alpha) * visibility(np.maximum(nl, 1e-9), nv, alpha), 0), np.maximum(nl, 0), half @ v


def under_sky(n, v, alpha, radiance):
    """Integrals of microfacet light weighed with 1 - f and f: two [3]. radiance: directions [N, 3] -> [N, 3]."""
    alpha = max(alpha, MIRROR)
    half = half_vectors(n, alpha)
    vh = half @ v
    light = 2 * vh[:, None] * half - v
    value, nl, _ = microfacet(n, v, light, alpha)
    weight = np.where((nl > 0) & (vh > 0), value * nl * 4 * vh / (ggx(half @ n, alpha) * (half @ n)), 0)[:, None]
    edge = (1 - np.clip(vh, 0, 1))[:, None] ** 5
    seen = radiance(light) * weight
    return (seen * (1 - edge)).mean(axis=0), (seen * edge).mean(axis=0)


def white(directions):
    return np.ones((len(directions), 3))


def radiance(gradient, lights, n, v, base, metallic, roughness):
    """RGB radiance [3] of glTF's core material, with Turquin's gain for light that bounces on within the roughness.

    lights: (direction [3], irradiance [3], radius): their highlights are those of alpha^2 + (radius / 2)^2.
    """
    base, alpha = np.asarray(base, float), max(roughness**2, MIRROR)
    f0 = 0.04 + (base - 0.04) * metallic
    all_of_it = sum(under_sky(n, v, alpha, white))[0]
    gain = 1 + f0 * (1 / all_of_it - 1)
    mirrored = under_sky(n, v, alpha, lambda d: sky(gradient, d))
    total = gain * (f0 * mirrored[0] + mirrored[1])
    inside = (1 - metallic) * base * (1 - white_share(n, v, alpha))
    total += inside * sky(gradient, hemisphere(n)).mean(axis=0)
    for direction, irradiance, radius in lights:
        value, nl, vh = microfacet(n, v, np.asarray(direction)[None], math.sqrt(roughness**4 + max(radius / 2, MIRROR) ** 2))
        total += (gain * (value * nl)[0] * schlick(f0, 1, vh)[0] + inside / math.pi * nl[0]) * irradiance
    return total


def white_share(n, v, alpha):
    """What a dielectric interface reflects of a white sky, with its gain."""
    straight, edge = under_sky(n, v, alpha, white)
    return ((1 + 0.04 * (1 / (straight + edge) - 1)) * (0.04 * straight + edge))[0]
