"""The terms of glTF's materials, each a function of a ShadedSurface and an Environment.

Every result is float32, one column per point. Layers are in glTF's order: the base, sheen over it, emission, the clear coat over
all. Each layer reduces the light of those below by its own reflectance under a white sky, so that no stack of layers gives more
light than it gets. Occlusion darkens the sky's light, not that of the lights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .environment import Environment
from .lobes import (
    INV_PI,
    LEAST,
    MIN_CHARLIE,
    LightSums,
    charlie_integral,
    charlie_lights,
    dot,
    ggx_integral,
    ggx_lights,
    ggx_lights_stretched,
    ggx_lights_through,
    reflected,
)
from .shading_points import ShadedSurface, cross
from .thin_film import film_f0

Reflectance = np.ndarray | np.float32
DIELECTRIC = np.float32(0.04)  # reflectance seen straight on at ior 1.5
DISPERSION_SPREAD = np.float32(0.025)  # half the spread of ior over (ior - 1) at dispersion 1, an Abbe number of 20


@dataclass
class Gloss:
    """GGX lobe of points before Fresnel's law.

    lights: its light from the lights; sky: [3, m] prefiltered, occluded; a, b: [m], its reflectance under a white sky at
    Fresnel's two ends.
    """

    lights: LightSums
    sky: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def gain(self, f0: Reflectance) -> np.ndarray:
        """Return the factor on the lobe that adds the light of several bounces within the roughness (Turquin, Practical multiple
        scattering compensation for microfacet models, 2019)."""
        return 1 + f0 * (1 / (self.a + self.b) - 1)

    def albedo(self, f0: Reflectance, f90: Reflectance) -> np.ndarray:
        """Return the share of a white sky that the lobe reflects, [m] or [3, m], at most 1. f0, f90: as in light()."""
        return np.minimum(self.gain(f0) * (f0 * self.a + f90 * self.b), np.float32(1))

    def light(self, f0: Reflectance, f90: Reflectance) -> np.ndarray:
        """Return the reflected radiance [3, m]. f0, f90: reflectance straight on and at grazing angles, [3, m], [m] or one
        number."""
        seen = self.sky * (f0 * self.a + f90 * self.b) + f0 * self.lights.spec + f90 * self.lights.spec_edge
        return self.gain(f0) * seen


def occlusion(surface: ShadedSurface) -> None:
    """Set the share of the sky that reaches the points, from their occlusion channel.

    Parameters
    ----------
    surface : ShadedSurface
        m points; its sky_share is set.
    """
    surface.sky_share = surface.scalar("occlusion")


def gloss(surface: ShadedSurface, environment: Environment) -> Gloss:
    """Return the specular lobe of the base layer, symmetric about the mirror direction.

    Parameters
    ----------
    surface : ShadedSurface
        m points.
    environment : Environment
        Sky and lights.

    Returns
    -------
    Gloss
        The lobe; Gloss.light() applies f0 and f90 of Fresnel's law to it.
    """
    lights = ggx_lights(surface.normal, surface.view, surface.nv, surface.roughness**2, environment.lights)
    mirror = _leaning(reflected(surface.normal, surface.view, surface.cosine), surface.normal, surface.roughness)
    sky = environment.prefiltered(mirror, surface.roughness) * surface.sky_share
    return Gloss(lights, sky, *ggx_integral(surface.nv, surface.roughness))


def anisotropic_gloss(surface: ShadedSurface, environment: Environment) -> Gloss:
    """Return the specular lobe of the base layer, wider along a direction of the surface (KHR_materials_anisotropy).

    Parameters
    ----------
    surface, environment
        As of gloss().

    Returns
    -------
    Gloss
        Exact under the lights. Under the sky the symmetric lobe is used, about the mirror direction of a normal that is bent
        towards the plane across that direction.
    """
    strength, along, across = _stretch(surface)
    alpha = surface.roughness**2
    wide = alpha + (1 - alpha) * strength * strength
    lights = ggx_lights_stretched(surface.normal, surface.view, surface.nv, (along, across), (wide, alpha), environment.lights)
    plane = cross(cross(across, surface.view), across)
    keep = (1 - strength * (1 - surface.roughness)) ** 4
    bent = plane + (surface.normal - plane) * keep
    bent = bent / np.sqrt(np.maximum(dot(bent, bent), np.float32(1e-12)))
    mirror = _leaning(reflected(bent, surface.view, dot(bent, surface.view)), surface.normal, surface.roughness)
    sky = environment.prefiltered(mirror, surface.roughness) * surface.sky_share
    return Gloss(lights, sky, *ggx_integral(surface.nv, surface.roughness))


def _stretch(surface):
    """Strength [m] of the anisotropy, the direction [3, m] along which the lobe is wider, and the direction across.

    A map's direction without a length counts as the tangent.
    """
    coded, turn = surface.value("anisotropy"), surface.parameter("anisotropy_rotation")[0]
    x, y = 2 * coded[0] - 1, 2 * coded[1] - 1
    length = np.sqrt(x * x + y * y)
    is_direction = length > 1e-3
    x, y = (np.divide(part, length, out=np.full_like(length, instead), where=is_direction) for part, instead in ((x, 1), (y, 0)))
    x, y = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    t, b = surface.tangents()
    return coded[2], x * t + y * b, x * b - y * t


def _leaning(mirror, normal, roughness):
    """Mirror directions, bent towards the normal because a rough lobe loses its part below the horizon.

    They are not scaled to length 1, because the sky reads their height only.
    """
    return mirror + (normal - mirror) * (roughness * roughness)


def specular(surface: ShadedSurface) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflectance of dielectrics (KHR_materials_specular, KHR_materials_ior).

    Parameters
    ----------
    surface : ShadedSurface
        m points.

    Returns
    -------
    straight : float32 [3, m]
        Seen straight on.
    grazing : float32 [m]
        At grazing angles.
    """
    ior, strength = surface.parameter("ior")[0], surface.scalar("specular")
    straight = ((ior - 1) / (ior + 1)) ** 2
    return np.minimum(straight * surface.value("specular_colour"), np.float32(1)) * strength, strength


def iridescence(surface: ShadedSurface, f0: Reflectance) -> np.ndarray:
    """Return the reflectance straight on, mixed with that under a thin film (KHR_materials_iridescence).

    Parameters
    ----------
    surface : ShadedSurface
        m points.
    f0 : float32 [3, m]
        Without the film.

    Returns
    -------
    float32 [3, m]
        The mix.
    """
    least, most = (surface.parameter(f"iridescence_thickness_{end}")[0] for end in ("minimum", "maximum"))
    thickness = least + (most - least) * surface.scalar("iridescence_thickness")
    ior = np.maximum(surface.parameter("iridescence_ior")[0], np.float32(1))
    film = film_f0(surface.nv, np.broadcast_to(f0, surface.base.shape), ior, thickness)
    return f0 + (film - f0) * surface.scalar("iridescence")


def diffuse(surface: ShadedSurface, environment: Environment, lobe: Gloss, lost: np.ndarray) -> np.ndarray:
    """Return the light that a white diffuse surface gives under a dielectric interface.

    Parameters
    ----------
    surface, environment
        As of gloss().
    lobe : Gloss
        The specular lobe of the base layer, whose sums of the lights are used.
    lost : float32 [m]
        Share of a white sky that the interface reflects.

    Returns
    -------
    float32 [3, m]
        Radiance. glTF uses Fresnel's law at each half vector instead of lost, which gives more light than there is at steep
        views.
    """
    return (environment.irradiance(surface.normal) * surface.sky_share + lobe.lights.flat) * (1 - lost)


def diffuse_transmission(surface: ShadedSurface, environment: Environment, under: np.ndarray, lost: np.ndarray,
                         tint: np.ndarray | None) -> np.ndarray:
    """Return diffuse light, a share of which comes from behind (KHR_materials_diffuse_transmission).

    Parameters
    ----------
    surface, environment
        As of gloss().
    under : float32 [3, m]
        Diffuse light of the base.
    lost : float32 [m]
        Share of a white sky that is reflected before it enters.
    tint : float32 [3, m], optional
        Transmittance of the volume, see volume(); None for a thin sheet.

    Returns
    -------
    float32 [3, m]
        Radiance.
    """
    light = environment.irradiance(-surface.normal)
    for source in environment.lights:
        behind = np.maximum(-dot(surface.normal, source.direction.astype(np.float32)), np.float32(0)) * INV_PI
        light += behind * source.irradiance.astype(np.float32)[:, None]
    light *= (1 - lost) * surface.value("diffuse_transmission_colour")
    if tint is not None:
        light *= tint
    return under + (light - under) * surface.scalar("diffuse_transmission")


def transmission(surface: ShadedSurface, environment: Environment, under: np.ndarray, lost: np.ndarray, tint: np.ndarray | None,
                 disperses: bool) -> np.ndarray:
    """Return the light, a share of which is seen through the surface (KHR_materials_transmission): sky and lights only, never
    other surfaces.

    Parameters
    ----------
    surface, environment, under, lost
        As of diffuse_transmission().
    tint : float32 [3, m], optional
        Transmittance of the volume, see volume(). With it the sky is seen along the ray that is refracted at its entry, as if it
        left unbent; None for a thin sheet, which is seen through straight.
    disperses : bool
        Whether the refraction depends on the colour; see dispersed().

    Returns
    -------
    float32 [3, m]
        Radiance.
    """
    ior = np.maximum(surface.parameter("ior")[0], np.float32(1))
    roughness = surface.roughness * np.minimum(2 * ior - 2, np.float32(1))
    if tint is None:
        light = environment.prefiltered(-surface.view, roughness)
    elif disperses:
        light = dispersed(surface, environment, ior, roughness) * tint
    else:
        light = environment.prefiltered(_refracted(surface, ior), roughness) * tint
    behind = ggx_lights_through(surface.normal, surface.view, surface.nv, roughness**2, environment.lights)
    light += behind if tint is None else behind * tint
    light *= (1 - lost) * surface.base
    return under + (light - under) * surface.scalar("transmission")


def dispersed(surface: ShadedSurface, environment: Environment, ior: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """Return the light of the sky along rays that are refracted less in red and more in blue (KHR_materials_dispersion).

    Parameters
    ----------
    surface, environment
        As of gloss().
    ior, roughness : float32 [m]
        Index of refraction of the volume, and roughness of the transmitted lobe.

    Returns
    -------
    float32 [3, m]
        Radiance.
    """
    half = (ior - 1) * DISPERSION_SPREAD * surface.parameter("dispersion")[0]
    iors = (np.maximum(ior - half, np.float32(1)), ior, ior + half)
    return np.stack([environment.prefiltered(_refracted(surface, colour_ior), roughness)[c] for c, colour_ior in enumerate(iors)])


def _refracted(surface, ior):
    turn = 1 / ior
    inside = np.sqrt(np.maximum(1 - turn * turn * (1 - surface.nv * surface.nv), np.float32(0)))
    return (turn * surface.nv - inside) * surface.normal - turn * surface.view


def volume(surface: ShadedSurface) -> np.ndarray:
    """Return the transmittance of the volume along the normal, by Beer's law (KHR_materials_volume).

    Parameters
    ----------
    surface : ShadedSurface
        m points.

    Returns
    -------
    float32 [3, m]
        0..1.
    """
    distance = np.maximum(surface.parameter("attenuation_distance")[0], np.float32(1e-6))
    colour = np.clip(surface.parameter("attenuation_colour"), np.float32(1e-6), np.float32(1))
    return np.exp(np.log(colour) * np.minimum(surface.scalar("thickness") / distance, np.float32(1e4)))


def sheen(surface: ShadedSurface, environment: Environment, below: np.ndarray) -> np.ndarray:
    """Return the light of cloth fibres over the layers below (KHR_materials_sheen).

    Parameters
    ----------
    surface, environment
        As of gloss().
    below : float32 [3, m]
        Radiance of the layers below.

    Returns
    -------
    float32 [3, m]
        Radiance. The lobe is so wide that the sky counts with its mean about the normal.
    """
    colour = surface.value("sheen_colour")
    roughness = np.maximum(surface.scalar("sheen_roughness"), np.float32(MIN_CHARLIE))
    share = charlie_integral(surface.nv, roughness)
    sky = environment.irradiance(surface.normal) * (surface.sky_share * share)
    lights = charlie_lights(surface.normal, surface.view, surface.nv, roughness**2, environment.lights)
    return colour * (sky + lights) + below * (1 - colour.max(axis=0) * share)


def emission(surface: ShadedSurface, below: np.ndarray) -> np.ndarray:
    """Return the light of the layers below plus the surface's own (KHR_materials_emissive_strength).

    Parameters
    ----------
    surface : ShadedSurface
        m points.
    below : float32 [3, m]
        Radiance of the layers below.

    Returns
    -------
    float32 [3, m]
        Radiance.
    """
    return below + surface.value("emissive") * surface.parameter("emissive_strength")


def clearcoat(surface: ShadedSurface, environment: Environment, below: np.ndarray) -> np.ndarray:
    """Return the light of a clear layer of ior 1.5 over the layers below, with a normal of its own (KHR_materials_clearcoat).

    Parameters
    ----------
    surface, environment, below
        As of sheen().

    Returns
    -------
    float32 [3, m]
        Radiance.
    """
    strength, roughness, normal = surface.scalar("clearcoat"), surface.scalar("clearcoat_roughness"), surface.coat_normal()
    cosine = dot(normal, surface.view)
    nv = np.maximum(cosine, LEAST)
    lights = ggx_lights(normal, surface.view, nv, roughness**2, environment.lights)
    mirror = _leaning(reflected(normal, surface.view, cosine), normal, roughness)
    lobe = Gloss(lights, environment.prefiltered(mirror, roughness) * surface.sky_share, *ggx_integral(nv, roughness))
    share = strength * lobe.albedo(DIELECTRIC, np.float32(1))
    return below * (1 - share) + strength * lobe.light(DIELECTRIC, np.float32(1))
