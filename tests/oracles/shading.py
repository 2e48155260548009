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


def film(cosine, base, ior, nanometres):
    """RGB reflectance [3] of a base [3] under a film, Airy's whole sum for each wavelength, weighed by the CIE's matching
    functions in the fit of Wyman, Sloan and Shirley (2013). As in the extension, only what differs from the mean gets a
    colour."""
    wave = np.arange(380.0, 781.0)
    bell = lambda at, below, above: np.exp(-0.5 * ((wave - at) * np.where(wave < at, below, above)) ** 2)
    x = 1.056 * bell(599.8, 0.0264, 0.0323) + 0.362 * bell(442.0, 0.0624, 0.0374) - 0.065 * bell(501.1, 0.0490, 0.0382)
    y = 0.821 * bell(568.8, 0.0213, 0.0247) + 0.286 * bell(530.9, 0.0613, 0.0322)
    z = 1.217 * bell(437.0, 0.0845, 0.0278) + 0.681 * bell(459.0, 0.0385, 0.0725)
    matching = np.array([x, y, z])
    matching /= matching.sum(axis=1, keepdims=True)
    to_rgb = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    fresnel = lambda straight, c: straight + (1 - straight) * (1 - c) ** 5
    inside = math.sqrt(1 - (1 - cosine**2) / ior**2)
    outer, out = fresnel(((ior - 1) / (ior + 1)) ** 2, cosine), np.empty(3)
    for channel, reflectance in enumerate(base):
        below = (1 + math.sqrt(reflectance)) / (1 - math.sqrt(reflectance))
        inner = fresnel(((below - ior) / (below + ior)) ** 2, inside)
        phase = 2 * math.pi * 2 * ior * nanometres * inside / wave + math.pi + (math.pi if below < ior else 0)
        both = math.sqrt(outer * inner)
        mean = (1 - outer) ** 2 * inner / (1 - outer * inner)
        orders = sum(2 * both**m * np.cos(m * phase) for m in range(1, 60))
        out[channel] = outer + mean + (mean - (1 - outer)) * (to_rgb @ (matching @ orders))[channel]
    return np.clip(out, 0, 1)
