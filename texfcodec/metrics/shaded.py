"""Errors of a decoded asset in light: pictures, channels, shading normals.

Pictures are those of the image metric (views.py) in the light of render/environment.py: the same orthographic cameras (so that
the direction to the eye is the same for all pixels of a view), the same pixels, the same pooling. Channels and normals are
compared at points spread evenly over the source: on the same face with the same barycentric coordinates, or at the points that
face_match.py finds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..core.colour_error import decibels
from ..geometry.areas import sample_surface
from ..render.depth_layers import opacity
from ..render.environment import DAYLIGHT
from ..render.lighting import Lighting
from ..scene.channels import BY_NAME, MAPS
from ..scene.fetch import pack_source, sample_source
from ..scene.scene import ALPHA_BLEND, ALPHA_MASK, Scene
from ..scene.srgb import linear_to_srgb
from ..texf import Texf
from .angular_error import angular_error
from .face_match import FaceMatch
from .views import SIZE, VIEWS, ViewSettings, compare_views

SAMPLES = 200_000
BLOCK = 1 << 16  # points asked at a time


def compare_shaded(reference: Scene, other: Scene | Texf, views: int = VIEWS, size: int = SIZE, threads: int = 1,
                   mipmaps: bool = False, on_view: Callable[[int, int], object] | None = None) -> dict:
    """Compare other with reference in light: pictures of views, and each channel that shading reads.

    Parameters
    ----------
    reference, other : Scene or Texf
        Source and decoded asset.
    views, size, threads, on_view
        As of compare_views().
    mipmaps : bool
        Sample minified maps as viewers do, see views.ViewSettings.

    Returns
    -------
    dict
        "psnr", "union_psnr": of shaded pictures, as of compare_views(); "views", "size", "pixels"; and the items that
        compare_channels() returns.

    Raises
    ------
    InputError
        TXF-I95 and TXF-I99.
    """
    seen = compare_views(reference, other, views, size, threads=threads, on_view=on_view,
                         settings=ViewSettings(environment=DAYLIGHT, mipmaps=mipmaps))
    shown = {name: seen[name] for name in ("psnr", "union_psnr", "views", "size", "pixels")}
    return shown | compare_channels(reference, other, threads=threads)


def compare_channels(reference: Scene, other: Scene | Texf, samples: int = SAMPLES, threads: int = 1) -> dict:
    """Return the errors of other channel by channel, at points of the reference's surface.

    Parameters
    ----------
    reference, other : Scene or Texf
        Source and decoded asset.
    samples : int
        Number of points.
    threads : int
        Most threads.

    Returns
    -------
    dict
        "channels": {name: {"unit", "samples", ...}}; "normals": {"without_map", "with_map"}, or None if no material is lit;
        "samples".

    Notes
    -----
    Compared are the channels that shading reads and that either side has a map of, at points whose material has that map on
    either side. Points that the reference does not show have weight 0. The units:
    "dB": "psnr" of final values, factor included, colour sRGB-coded; the peak is 1, or the reference's largest value if that is
    above 1; None if they are equal. Alpha of blended materials is such a channel.
    "degrees": as of angular_error(), between normals with the map.
    "coverage": points of masked materials that are visible in the reference alone, "lost", and in the other alone, "gained", as
    shares of those visible in the reference.
    """
    points = Points(reference, other, samples, threads)
    lights = Lighting(reference), Lighting(other)
    names = lights[0].table.wanted_channels() | lights[1].table.wanted_channels()
    channels = _alpha_errors(points)
    for channel in MAPS:
        if channel.name in names:
            rows = points.rows_of(channel.name, lights)
            if len(rows):
                ask = _degrees if channel.unit == "degrees" else _decibels
                channels[channel.name] = {"unit": channel.unit, **ask(points, lights, channel.name, rows)}
    lit = np.flatnonzero(points.weight * ~np.array([m.unlit for m in reference.materials], bool)[points.material])
    normals = None
    if len(lit):
        sides = [normals_at(points, lights, side, "normal", lit) for side in (0, 1)]
        normals = {name: angular_error(sides[0][k], sides[1][k], points.weight[lit])
                   for k, name in enumerate(("without_map", "with_map"))}
    return {"channels": channels, "normals": normals, "samples": len(points.weight)}


class Points:
    """Corresponding points of the reference, side 0, and the other asset, side 1.

    at: (face int64 [M], bary float64 [M, 3]) of each side; rgba: base colour and alpha float32
    [M, 4] of each side; material: int64 [M] of the reference; weight:
    float64 [M], visibility of each point in the reference.
    """

    def __init__(self, reference: Scene, other: Scene | Texf, samples: int, threads: int) -> None:
        self.sides, self.threads = (reference, other), threads
        sampled = sample_surface(reference.positions, reference.faces, samples)
        places = FaceMatch(reference, other, threads).find(*sampled)
        self.at = sampled, (places.face, places.bary)
        self.material = reference.face_material[self.at[0][0]]
        self.rgba = [_colours(side, at, threads) for side, at in zip(self.sides, self.at, strict=True)]
        self.weight = opacity(reference.materials, self.material, self.rgba[0][:, 3]).astype(np.float64)

    def rows_of(self, name: str, lights: tuple[Lighting, Lighting]) -> np.ndarray:
        """Return the indices of the visible points whose material has a map of the channel on either side. name: of the channel;
        lights: Lighting of each side."""
        has = np.zeros(len(self.weight), bool)
        for (face, _), light in zip(self.at, lights, strict=True):
            has |= np.array([name in m.maps for m in light.table.materials], bool)[light.face_material[face]]
        return np.flatnonzero(has & (self.weight > 0))


def _colours(side, at, threads):
    """Colour and alpha float32 [M, 4] of points."""
    face, bary = at
    if isinstance(side, Scene):
        return sample_source(pack_source(side), face, bary, threads)
    points = np.einsum("mk,mkc->mc", bary, side.positions[side.faces[face]])
    return side.query_by_field(points, side.face_field[face], face)


def _alpha_errors(points):
    """Coverage of masked materials and error of blended ones, under "alpha_mask" and "alpha"."""
    modes, out = np.array([m.alpha_mode for m in points.sides[0].materials])[points.material], {}
    ours, theirs = (rgba[:, 3].astype(np.float64) / 255 for rgba in points.rgba)
    blended, masked = np.flatnonzero(modes == ALPHA_BLEND), np.flatnonzero(modes == ALPHA_MASK)
    if len(blended):
        out["alpha"] = {"unit": "dB", "samples": len(blended), "psnr": _psnr(np.mean((ours - theirs)[blended] ** 2))}
    if len(masked):
        cutoff = np.array([m.alpha_cutoff for m in points.sides[0].materials])[points.material[masked]]
        seen, shown = (alpha[masked] >= cutoff for alpha in (ours, theirs))
        count = max(int(seen.sum()), 1)
        out["alpha_mask"] = {"unit": "coverage", "samples": len(masked), "lost": float((seen & ~shown).sum()) / count,
                             "gained": float((shown & ~seen).sum()) / count}
    return out


def _decibels(points, lights, name, rows):
    """PSNR of a channel."""
    squares, largest = 0.0, 1.0
    for begin in range(0, len(rows), BLOCK):
        part = rows[begin : begin + BLOCK]
        ours, theirs = (light.finals([name], face[part], bary[part])[name].astype(np.float64)
                        for light, (face, bary) in zip(lights, points.at, strict=True))
        if BY_NAME[name].srgb:
            ours, theirs = linear_to_srgb(ours), linear_to_srgb(theirs)
        largest = max(largest, float(ours.max()))
        squares += float(points.weight[part] @ ((ours - theirs) ** 2).mean(axis=1))
    return {"samples": len(rows), "psnr": _psnr(squares / points.weight[rows].sum() / largest**2)}


def _psnr(mse):
    return decibels(float(mse), 1.0) if mse else None


def _degrees(points, lights, name, rows):
    ours, theirs = (normals_at(points, lights, side, name, rows)[1] for side in (0, 1))
    return angular_error(ours, theirs, points.weight[rows])


def normals_at(points: Points, lights: tuple[Lighting, Lighting], side: int, name: str, rows: np.ndarray) -> list[np.ndarray]:
    """Return shading normals of one side, 0 or 1, without and with its normal map: [without, with], float [M, 3] each. lights: of
    each side; name: of the map's channel; rows: int64 [M], indices of the points."""
    face, bary = points.at[side]
    pairs = [lights[side].normals(name, face[rows[i : i + BLOCK]], bary[rows[i : i + BLOCK]]) for i in range(0, len(rows), BLOCK)]
    return [np.concatenate(parts) for parts in zip(*pairs, strict=True)]
