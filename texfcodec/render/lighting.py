"""Shading of fragments of a Scene or a Texf: maps, normals and views for render/material.py."""

from __future__ import annotations

from collections.abc import Collection
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..core.threads import over_blocks
from ..geometry.mesh import face_normals
from ..scene.channels import BY_NAME
from ..scene.factors import FLAT, linear_values, neutral_values
from ..scene.scene import Scene
from .environment import DAYLIGHT, Environment
from .field_sampler import surface_points
from .lit_field import FieldMaps
from .lit_scene import SceneMaps
from .lobes import build_tables
from .material import expose, shade
from .material_effects import ShadingTable
from .shading_points import ShadingPoints
from .tangent_frames import deviated_normals, interpolate_corners, tangent_space_normals, towards_viewer

if TYPE_CHECKING:
    from ..texf import Texf
    from .camera import Camera
    from .raster import Fragments

BLOCK = 1 << 15  # fragments at a time


def _disturbed(sample, channel, most):
    """A sampler whose values of a channel are off by up to `most` levels, always the same for the same fragments."""

    def disturbed(names, face, bary, depth):
        sampled = sample(names, face, bary, depth)
        if channel in sampled and len(face):
            random = np.random.default_rng([len(face), int(face[0])])
            off = random.uniform(-most, most, sampled[channel].shape).astype(np.float32)
            sampled[channel] = np.clip(sampled[channel] + off, 0, 255)
        return sampled

    return disturbed


class Lighting:
    """Lighting of one asset, for any number of pictures.

    Parameters
    ----------
    asset : Scene or Texf
        Only the channels that the materials of a run of fragments use are sampled; an asset without a lit material costs nothing.
    environment : Environment
        Sky and lights.
    mipmaps : bool
        Whether a Scene's maps are sampled at mip levels (render/textures.py).
    table : ShadingTable, optional
        That of the asset's materials, to use again for another asset with the same.
    """

    def __init__(self, asset: Scene | Texf, environment: Environment = DAYLIGHT, mipmaps: bool = False,
                 table: ShadingTable | None = None) -> None:
        self.environment = environment
        self.maps: SceneMaps | FieldMaps = SceneMaps(asset, mipmaps) if isinstance(asset, Scene) else FieldMaps(asset)
        self.table = table or ShadingTable(asset.materials)
        self.positions, self.faces = np.ascontiguousarray(asset.positions), np.ascontiguousarray(asset.faces)
        self.face_material = asset.face_material
        self._lit = np.array(["lit" in effects for effects in self.table.effects], bool)
        self._mapped = {name: np.array([name in m.maps for m in self.table.materials], bool)
                        for name in self.table.wanted_channels()}

    @cached_property
    def geometric(self) -> np.ndarray:
        """Normals of the faces, float32 [F, 3], of length 1, or 0 if a face has no area."""
        return face_normals(self.positions[self.faces]).astype(np.float32)

    def coded(self, camera: Camera, fragments: Fragments, rgba: np.ndarray, filtering: bool = True,
              threads: int = 1, noise: tuple[str, float] | None = None) -> np.ndarray:
        """Return the colours of fragments in light.

        Parameters
        ----------
        camera : Camera
            The camera.
        fragments : Fragments
            M visible points.
        rgba : float32 [M, 4]
            Their base colour and alpha, 0..255; unlit materials keep it.
        filtering : bool
            As of render_texf().
        threads : int
            Most threads; the result does not depend on it.
        noise : (str, float), optional
            A channel's name and an amplitude on 0..255: uniform random errors up to it are added to the channel, as by coding.

        Returns
        -------
        float32 [M, 3]
            0..255, sRGB-coded.
        """
        out = np.array(rgba[:, :3], np.float32)
        material = self.face_material[fragments.face]
        seen = np.bincount(material, minlength=len(self._lit)) > 0
        if not (seen & self._lit).any():
            return out
        wanted = self.table.wanted_channels(np.flatnonzero(seen))
        self.environment.build()
        build_tables()
        _ = self.geometric, self.maps.corner_normal
        sample = self.maps.sampler(camera, fragments.depth.max(initial=0.0), wanted, filtering)
        rows = None if self._lit[seen].all() else np.flatnonzero(self._lit[material])

        def light_block(begin):
            part = slice(begin, begin + BLOCK) if rows is None else rows[begin : begin + BLOCK]
            at = fragments.face[part], fragments.bary[part], fragments.depth[part]
            points = self._points(camera, sample if noise is None else _disturbed(sample, *noise), at, out[part])
            out[part] = expose(shade(points, self.table, self.environment), self.environment.exposure)

        over_blocks(light_block, len(out) if rows is None else len(rows), BLOCK, threads)
        return out

    def _points(self, camera, sample, at, colour):
        """Points of fragments (face, bary, depth) and their base colour."""
        face, bary, _ = at
        material = self.face_material[face]
        numbers = np.flatnonzero(np.bincount(material, minlength=len(self._lit)))
        wanted = self.table.wanted_channels(numbers)
        effects = frozenset().union(*(self.table.effects[number] for number in numbers))
        sampled = sample(wanted, *at)
        values = {name: self._final(name, sampled[name], material) for name in wanted if BY_NAME[name].unit != "degrees"}
        values["base_colour"] = linear_values("base_colour", colour)
        view = self._view(camera, face, bary)
        geometric, plain = self.geometric[face], interpolate_corners(self.maps.corner_normal, face, bary)
        turned = lambda name: towards_viewer(self._bent(name, sampled, at, plain), geometric, view)
        normal, coat = turned("normal"), None
        if "clearcoat" in effects and not wanted.isdisjoint(("normal", "clearcoat_normal")):
            coat = turned("clearcoat_normal")
        tangent = self.maps.tangents("anisotropy", face, bary) if "anisotropy" in effects else None
        return ShadingPoints(material=material, normal=normal, view=view, values=values, tangent=tangent, coat_normal=coat)

    def _final(self, name, values, material):
        """Final values of a channel; a material without the map has the neutral value."""
        mapped = self._mapped[name]
        if not mapped.all():
            values[~mapped[material]] = neutral_values(name)
        return self.table.final(name, material, linear_values(name, values))

    def _bent(self, name, sampled, at, plain):
        """Normals [m, 3]: plain ones, turned by the maps of channel `name`, in tangent or object space, if there are any."""
        face, bary, _ = at
        out = plain
        for key in (name, f"{name}_object"):
            if key not in sampled:
                continue
            rows = np.flatnonzero(self._mapped[name][self.face_material[face]])
            if not len(rows):
                continue
            out = plain.copy() if out is plain else out
            material, where = self.face_material[face[rows]], (face[rows], bary[rows])
            base, geometric, values = out[rows], self.geometric[face[rows]], sampled[key][rows]
            if key == name:
                scale = self.table.values[BY_NAME[name].parameter][material, 0]
                out[rows] = tangent_space_normals(values, scale, base, self.maps.tangents(name, *where), geometric)
            else:
                out[rows] = deviated_normals(values / np.float32(FLAT) - 1, base, geometric)
        return out

    def _view(self, camera, face, bary):
        """Vectors from the points towards the eye, float32 [m, 3], of any length: to its position if perspective, else against
        the line of sight."""
        if not camera.perspective:
            return np.broadcast_to(-camera.forward.astype(np.float32), (len(face), 3))
        away = camera.eye - surface_points(face, bary, self.positions, self.faces)
        return (away / (np.abs(away).max(initial=0.0) or 1.0)).astype(np.float32)  # which binary32 holds, in any world


    def normals(self, name: str, face: np.ndarray, bary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return shading normals of surface points in the world, without and with a normal map.

        Parameters
        ----------
        name : str
            "normal" or "clearcoat_normal".
        face : int64 [M]
            Faces.
        bary : float64 [M, 3]
            Barycentric coordinates.

        Returns
        -------
        without_map, with_map : float32 [M, 3]
            Unit normals.
        """
        plain, at = interpolate_corners(self.maps.corner_normal, face, bary), (face, bary, np.zeros(len(face)))
        wanted = self.table.wanted_channels() & {name}
        return plain, self._bent(name, self.maps.sampler(None, 0.0, wanted, False)(wanted, *at), at, plain)

    def finals(self, names: Collection[str], face: np.ndarray, bary: np.ndarray) -> dict[str, np.ndarray]:
        """Return the values that shading uses of channels at surface points: map times factor, or the factor without a map.

        Parameters
        ----------
        names : iterable of str
            Of channels that are not normals.
        face : int64 [M]
            Faces.
        bary : float64 [M, 3]
            Barycentric coordinates.

        Returns
        -------
        dict of str to float32 [M, C]
            Values of each channel by its name; colours are linear.
        """
        material, mapped = self.face_material[face], frozenset(names) & self.table.wanted_channels()
        sampled = self.maps.sampler(None, 0.0, mapped, False)(mapped, face, bary, np.zeros(len(face)))
        return {name: self._final(name, sampled[name], material) if name in mapped else self.table.constant(name, material)
                for name in names}
