"""Iridescence: the effect of a film, thin as the wavelengths of light, on the reflectance of the surface under it.

The model of KHR_materials_iridescence: Airy's sum over reflections within the film, for red, green and blue at once (Belcour and
Barla, A practical extension to microfacet theory for the modeling of varying iridescence, 2017). The sum over wavelengths against
the sensitivities of the eye is a Fourier transform; these are Gaussians in wave number, so its value is closed.
"""

import numpy as np

from .lobes import fifth_power

# Gaussians of the CIE colour matching functions in wave number: amplitude, position (1/m), variance (1/m^2); two make X.
_GAUSSIANS = ((5.4856e-13, 1.6810e6, 4.3278e9), (9.7470e-14, 2.2399e6, 4.5282e9), (4.4201e-13, 1.7953e6, 9.3046e9),
              (5.2481e-13, 2.2084e6, 6.6121e9))
_WHITE = 1.0685e-7  # their integral
_TO_RGB = np.array([[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]])
ORDERS = 2  # terms of the sum beyond the mean; further ones are below what 8 bits show


def film_reflectance(cosine: np.ndarray, base: np.ndarray, ior: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Return the reflectance of a base under a thin film in air, by interference.

    Parameters
    ----------
    cosine : float32 [M]
        Between the normal and the direction to the eye.
    base : float32 [3, M]
        Reflectance of the bare base seen straight on, 0..1.
    ior : float32 [M]
        Of the film, at least 1.
    thickness : float32 [M]
        Nanometres. Below 0.03 nm the film fades away, as the extension specifies.

    Returns
    -------
    float32 [3, M]
        0..1.
    """
    fade = np.clip(thickness / np.float32(0.03), 0, 1)
    ior = 1 + (ior - 1) * fade * fade * (3 - 2 * fade)
    inside = np.sqrt(1 - (1 - cosine * cosine) / (ior * ior))
    outer_normal = ((ior - 1) / (ior + 1)) ** 2
    outer = outer_normal + (1 - outer_normal) * fifth_power(cosine)
    root = np.sqrt(np.clip(base, 0, np.float32(0.9999)))
    base_ior = (1 + root) / (1 - root)
    inner_normal = ((base_ior - ior) / (base_ior + ior)) ** 2
    inner = inner_normal + (1 - inner_normal) * fifth_power(inside)
    turned = np.where(base_ior < ior, np.float32(1), np.float32(-1))  # half a turn where the base is the denser one
    through = 1 - outer
    both = np.clip(outer * inner, np.float32(1e-5), np.float32(0.9999))
    mean = through * through * inner / (1 - both)
    out, term, root = outer + mean, mean - through, np.sqrt(both)
    path = 2 * ior * thickness * inside * np.float32(1e-9)
    for order in range(1, ORDERS + 1):
        term = term * root
        out = out + 2 * term * turned**order * _sensitivity(order * path)
    return np.clip(out, 0, 1).astype(np.float32)


def _sensitivity(path):
    """Real part of the Fourier transform of red, green and blue at differences of path [M], metres: [3, M]."""
    phase = np.float32(2 * np.pi) * path
    x, more, y, z = (np.float32(size * np.sqrt(2 * np.pi * var) / _WHITE) * np.cos(np.float32(at) * phase)
                     * np.exp(np.float32(-var) * phase * phase) for size, at, var in _GAUSSIANS)
    x += more
    return np.stack([np.float32(r) * x + np.float32(g) * y + np.float32(b) * z for r, g, b in _TO_RGB])


def film_f0(cosine: np.ndarray, base: np.ndarray, ior: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Return the reflectance straight on for which Schlick's law gives film_reflectance() at this view.

    Parameters
    ----------
    cosine, base, ior, thickness
        As of film_reflectance().

    Returns
    -------
    float32 [3, M]
        0..1.
    """
    edge = np.minimum(fifth_power(cosine), np.float32(0.95))
    return np.clip((film_reflectance(cosine, base, ior, thickness) - edge) / (1 - edge), 0, 1)
