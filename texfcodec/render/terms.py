"""The terms of glTF's materials, each a function of its own that takes a Surface and an Environment.

Every result is float32, one column per point. Layers lie on each other as glTF puts them: the base, sheen over it, emission, the
clear coat over all. What a layer keeps from those below is its own reflectance under a white sky, so that no stack of layers
gives more light than it gets. Occlusion darkens what comes from the sky, not the lights.
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
from .surface import Surface, cross
from .thin_film import film_f0

Reflectance = np.ndarray | np.float32
DIELECTRIC = np.float32(0.04)  # reflectance seen straight on at ior 1.5
DISPERSION_SPREAD = np.float32(0.025)  # half the spread of ior over (ior - 1) at dispersion 1, an Abbe number of 20


@dataclass
class Gloss:
    """A point's GGX lobe before Fresnel's law. lights: of the lights; sky: [3, m] prefiltered, occluded; a, b: [m], its
    reflectance under a white sky at Fresnel's two ends."""

    lights: LightSums
    sky: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def gain(self, f0: Reflectance) -> np.ndarray:
        """What light that bounces more than once within the roughness adds, as a factor (Turquin, Practical multiple scattering
        compensation for microfacet models, 2019)."""
        return 1 + f0 * (1 / (self.a + self.b) - 1)

    def albedo(self, f0: Reflectance, f90: Reflectance) -> np.ndarray:
        """Share of a white sky that is reflected, at most 1."""
        return np.minimum(self.gain(f0) * (f0 * self.a + f90 * self.b), np.float32(1))

    def light(self, f0: Reflectance, f90: Reflectance) -> np.ndarray:
        """Reflected radiance [3, m]. f0: [3, m], [m] or one; f90: [m] or one."""
        seen = self.sky * (f0 * self.a + f90 * self.b) + f0 * self.lights.spec + f90 * self.lights.spec_edge
        return self.gain(f0) * seen


def occlusion(surface: Surface) -> None:
    """Sets the share of the sky that reaches the points."""
    surface.sky_share = surface.scalar("occlusion")


def gloss(surface: Surface, environment: Environment) -> Gloss:
    """The base's lobe, round about the mirror direction."""
    lights = ggx_lights(surface.normal, surface.view, surface.nv, surface.roughness**2, environment.lights)
    mirror = _leaning(reflected(surface.normal, surface.view, surface.cosine), surface.normal, surface.roughness)
    sky = environment.prefiltered(mirror, surface.roughness) * surface.sky_share
    return Gloss(lights, sky, *ggx_integral(surface.nv, surface.roughness))


def anisotropic_gloss(surface: Surface, environment: Environment) -> Gloss:
    """The base's lobe, wider along a direction of the surface (KHR_materials_anisotropy): exact under the lights. Under the sky
    the round lobe is used, about the mirror direction of a normal that is bent towards the plane across that direction."""
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
    """Strength [m] of the anisotropy, the direction [3, m] along which the lobe is wider, and the one across. A map's direction
    without a length counts as the tangent."""
    coded, turn = surface.value("anisotropy"), surface.parameter("anisotropy_rotation")[0]
    x, y = 2 * coded[0] - 1, 2 * coded[1] - 1
    length = np.sqrt(x * x + y * y)
    is_direction = length > 1e-3
    x, y = (np.divide(part, length, out=np.full_like(length, instead), where=is_direction) for part, instead in ((x, 1), (y, 0)))
    x, y = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    t, b = surface.tangents()
    return coded[2], x * t + y * b, x * b - y * t


def _leaning(mirror, normal, roughness):
    """Mirror directions, drawn towards the normal by what a rough lobe loses below the horizon; not renewed in length, which the
    sky's height does not ask."""
    return mirror + (normal - mirror) * (roughness * roughness)


def specular(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance of what is no metal, straight on [3, m] and grazing [m] (KHR_materials_specular, KHR_materials_ior)."""
    ior, strength = surface.parameter("ior")[0], surface.scalar("specular")
    straight = ((ior - 1) / (ior + 1)) ** 2
    return np.minimum(straight * surface.value("specular_colour"), np.float32(1)) * strength, strength


def iridescence(surface: Surface, f0: Reflectance) -> np.ndarray:
    """Reflectance straight on [3, m], mixed with that under a thin film (KHR_materials_iridescence)."""
    least, most = (surface.parameter(f"iridescence_thickness_{end}")[0] for end in ("minimum", "maximum"))
    thickness = least + (most - least) * surface.scalar("iridescence_thickness")
    ior = np.maximum(surface.parameter("iridescence_ior")[0], np.float32(1))
    film = film_f0(surface.nv, np.broadcast_to(f0, surface.base.shape), ior, thickness)
    return f0 + (film - f0) * surface.scalar("iridescence")


def diffuse(surface: Surface, environment: Environment, lobe: Gloss, lost: np.ndarray) -> np.ndarray:
    """Light [3, m] that a white diffuse surface gives under a dielectric interface. lost: [m], what the interface reflects of a
    white sky. glTF takes Fresnel's law at each half vector for it, which gives more light than there is where views are steep."""
    return (environment.irradiance(surface.normal) * surface.sky_share + lobe.lights.flat) * (1 - lost)


def diffuse_transmission(surface: Surface, environment: Environment, under: np.ndarray, lost: np.ndarray,
                         tint: np.ndarray | None) -> np.ndarray:
    """Diffuse light [3, m] of which a share comes from behind (KHR_materials_diffuse_transmission). under: what the base gives
    back; lost: [m], reflected before it goes in; tint: [3, m] of the volume, or None."""
    light = environment.irradiance(-surface.normal)
    for source in environment.lights:
        behind = np.maximum(-dot(surface.normal, source.direction.astype(np.float32)), np.float32(0)) * INV_PI
        light += behind * source.irradiance.astype(np.float32)[:, None]
    light *= (1 - lost) * surface.value("diffuse_transmission_colour")
    if tint is not None:
        light *= tint
    return under + (light - under) * surface.scalar("diffuse_transmission")


def transmission(surface: Surface, environment: Environment, under: np.ndarray, lost: np.ndarray, tint: np.ndarray | None,
                 disperses: bool) -> np.ndarray:
    """Light [3, m] of which a share is seen through the surface (KHR_materials_transmission): the sky and the lights only, never
    other surfaces. tint: None for a thin sheet, which is looked through straight; else of the volume, and the sky is looked at
    along the ray that is refracted where it enters, as if it left unbent. lost: [m], reflected."""
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


def dispersed(surface: Surface, environment: Environment, ior: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """The sky [3, m] along rays that are refracted less in red and more in blue (KHR_materials_dispersion)."""
    half = (ior - 1) * DISPERSION_SPREAD * surface.parameter("dispersion")[0]
    iors = (np.maximum(ior - half, np.float32(1)), ior, ior + half)
    return np.stack([environment.prefiltered(_refracted(surface, colour_ior), roughness)[c] for c, colour_ior in enumerate(iors)])


def _refracted(surface, ior):
    turn = 1 / ior
    inside = np.sqrt(np.maximum(1 - turn * turn * (1 - surface.nv * surface.nv), np.float32(0)))
    return (turn * surface.nv - inside) * surface.normal - turn * surface.view


def volume(surface: Surface) -> np.ndarray:
    """What is left [3, m] of light after the thickness (KHR_materials_volume), along the normal: Beer's law."""
    distance = np.maximum(surface.parameter("attenuation_distance")[0], np.float32(1e-6))
    colour = np.clip(surface.parameter("attenuation_colour"), np.float32(1e-6), np.float32(1))
    return np.exp(np.log(colour) * np.minimum(surface.scalar("thickness") / distance, np.float32(1e4)))


def sheen(surface: Surface, environment: Environment, below: np.ndarray) -> np.ndarray:
    """Light [3, m] of cloth fibres over what is below (KHR_materials_sheen); its lobe is so wide that the sky counts with its
    mean about the normal."""
    colour = surface.value("sheen_colour")
    roughness = np.maximum(surface.scalar("sheen_roughness"), np.float32(MIN_CHARLIE))
    share = charlie_integral(surface.nv, roughness)
    sky = environment.irradiance(surface.normal) * (surface.sky_share * share)
    lights = charlie_lights(surface.normal, surface.view, surface.nv, roughness**2, environment.lights)
    return colour * (sky + lights) + below * (1 - colour.max(axis=0) * share)


def emission(surface: Surface, below: np.ndarray) -> np.ndarray:
    """What is below, and the surface's own light (KHR_materials_emissive_strength)."""
    return below + surface.value("emissive") * surface.parameter("emissive_strength")


def clearcoat(surface: Surface, environment: Environment, below: np.ndarray) -> np.ndarray:
    """Light [3, m] of a clear layer of ior 1.5 over what is below (KHR_materials_clearcoat), with a normal of its own."""
    strength, roughness, normal = surface.scalar("clearcoat"), surface.scalar("clearcoat_roughness"), surface.coat_normal()
    cosine = dot(normal, surface.view)
    nv = np.maximum(cosine, LEAST)
    lights = ggx_lights(normal, surface.view, nv, roughness**2, environment.lights)
    mirror = _leaning(reflected(normal, surface.view, cosine), normal, roughness)
    lobe = Gloss(lights, environment.prefiltered(mirror, roughness) * surface.sky_share, *ggx_integral(nv, roughness))
    share = strength * lobe.albedo(DIELECTRIC, np.float32(1))
    return below * (1 - share) + strength * lobe.light(DIELECTRIC, np.float32(1))
