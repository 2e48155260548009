"""Maps and corners of a Scene for render/lighting.py."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.canonical import fit_cube
from ..geometry.shading_normals import corner_normals
from ..geometry.tangents import corner_tangents
from ..scene.channels import BY_NAME
from ..scene.fetch import pack_map, sampled_values
from ..scene.scene import Scene
from .tangent_frames import interpolate_corners
from .textures import MipScenes, Textures

if TYPE_CHECKING:
    from .camera import Camera

LATTICE_BITS = 20  # of positions where normals have to be made: the most that the rules take


class SceneMaps:
    """Values of a Scene's maps at points of its faces; channels that share images and UVs are sampled together."""

    def __init__(self, scene: Scene, mipmaps: bool = False) -> None:
        self.scene = scene
        self._mips = MipScenes(scene) if mipmaps else None
        self._textures: dict[tuple, Textures] = {}
        self._tangents: dict[int, np.ndarray] = {}

    @cached_property
    def corner_normal(self) -> np.ndarray:
        """Normals of face corners, float32 [F, 3, 3]: those of the file; without any, those of the faces if the format says so,
        else those of the usual rule."""
        scene = self.scene
        if scene.corner_normal is not None:
            return scene.corner_normal
        if scene.flat:
            corners = scene.positions[scene.faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            longest = np.abs(normal).max(axis=1, initial=0, keepdims=True)
            return np.repeat((normal / np.where(longest > 0, longest, 1)).astype(np.float32)[:, None], 3, axis=1)
        return corner_normals(fit_cube(scene.positions, LATTICE_BITS).to_lattice(scene.positions), scene.faces)

    def sampler(self, camera: Camera | None, deepest: float, wanted: Collection[str], filtering: bool) -> Callable:
        """Return the function (names, face, bary, depth) -> {channel: values float32 [M, C] in 0..255} of surface points; normals
        as x and y. wanted: channels that names may hold; deepest: upper bound of depth, which is along the camera's forward;
        camera: for mip levels, else None; filtering: not used."""
        for name in sorted(wanted):
            self._of(name).build(camera, deepest)
            if BY_NAME[name].unit == "degrees":
                self.corner_tangent(name)
        return lambda names, face, bary, depth: self._sampled(names, lambda textures: textures.sample(camera, face, bary, depth))

    def _sampled(self, names, sample):
        values = {}
        out = {}
        for name in sorted(names):
            textures = self._of(name)
            if id(textures) not in values:
                values[id(textures)] = sample(textures)
            out[name] = sampled_values(name, values[id(textures)])
        return out

    def _of(self, name):
        """The Textures of a channel."""
        scene, channel = self.scene, BY_NAME[name]
        image_keys = [(id(t.image), tuple(t.wrap)) for t in scene.textures]  # several textures may be one image
        images = tuple(image_keys[m.maps[name]] if m.maps.get(name, -1) >= 0 else None for m in scene.materials)
        at_corners = name if name in scene.corner_map else ""
        key = images, id(scene.map_uv.get(name, scene.corner_uv)), channel.columns == (3,), channel.srgb, at_corners
        if key not in self._textures:  # of threads that make one at the same time all take the first: levels are built in it
            self._textures.setdefault(key, Textures(scene, partial(_packed, name=name), self._mips, channel.srgb))
        return self._textures[key]

    def tangents(self, name: str, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """Return the tangents (x, y, z, sign of the bitangent) at points of faces, float32 [M, 4], along the UVs of a channel's
        map. name: "normal", "clearcoat_normal" or "anisotropy", which takes the tangents of "normal"."""
        return interpolate_corners(self.corner_tangent("normal" if name == "anisotropy" else name), face, bary)

    def corner_tangent(self, name: str) -> np.ndarray:
        """Return the tangents of face corners for a channel's map, float32 [F, 3, 4]: the file's if it has some, for any UVs of a
        map (glTF has one TANGENT for all), else derived from the map's UVs."""
        scene = self.scene
        uv, given = scene.map_uv.get(name, scene.corner_uv), scene.corner_tangent
        if id(uv) not in self._tangents:
            has = np.zeros(len(scene.faces), bool) if given is None else np.all(np.any(given, axis=2), axis=1)
            tangents = np.zeros((len(scene.faces), 3, 4), np.float32) if given is None else np.array(given, np.float32)
            if not has.all():
                tangents[~has] = corner_tangents(scene.positions, scene.faces[~has], uv[~has], self.corner_normal[~has])
            self._tangents[id(uv)] = tangents
        return self._tangents[id(uv)]


def _packed(scene, name):
    return pack_map(scene, name)
