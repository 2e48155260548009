"""Normal maps without UVs: a map becomes a deviation from the shading normals that a decoder derives (encoder only; spec clause
8.5); and values of all maps for codecs that sample the surface themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...geometry.tangents import corner_tangents
from ...render.tangent_frames import interpolate_corners, tangent_space_normals
from ...scene.channels import BY_NAME
from ...scene.factors import FLAT, factor_of
from ...scene.fetch import map_columns, pack_map, sample_source, values_of_map
from ..caches import Cache

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Scene
    from ..faces import SentFaces, SentSurface, SourceSurface

NORMAL = "normal"  # the channel
SAME_FRAME = 0.05  # of a matrix: three degrees, which averaging over vertices explains
ACROSS = 6  # steps over a face whose map is folded into its normals
LEAST_LENGTH = 1e-3  # of a sum of normals that has a direction


def rotate_xy(values: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
    """Return x and y of tangent-space normals after a rotation of their frame, float32 [N, 2] in 0..255. values: the same
    before; rotation: of frame_rotation(), None leaves them unchanged."""
    return values if rotation is None else ((values / FLAT - 1) @ rotation.T.astype(np.float32) + 1) * np.float32(FLAT)


def frame_rotation(scene: Scene, surface: Surface, faces: np.ndarray) -> np.ndarray | None:
    """Return the rotation from the frame of the source's own tangents to the frame of its UVs, which a decoder uses: an
    orthogonal matrix float64 [2, 2] for x and y of a normal map, the best one for the surface of faces, int64 [F]; None if they
    are the same, or nothing is known. They differ in files whose tangents were computed for v upwards, or before a texture
    transform."""
    if scene.corner_tangent is None or scene.corner_normal is None or not len(faces):
        return None
    rows = surface.origin_face[faces]
    tangent, normal = scene.corner_tangent[rows, 0].astype(np.float64), scene.corner_normal[rows, 0].astype(np.float64)
    corners = scene.positions[scene.faces[rows]]
    tangents = corner_tangents(corners.reshape(-1, 3), np.arange(3 * len(rows)).reshape(-1, 3), scene.corner_uv[rows],
                           np.repeat(normal[:, None], 3, axis=1).astype(np.float32))[:, 0].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    frames = [(t[:, :3], np.cross(normal, t[:, :3]) * np.sign(t[:, 3:])) for t in (tangents, tangent)]
    lies = np.array([[(area * (a * b).sum(axis=1)).sum() for b in frames[1]] for a in frames[0]])
    left, _, right = np.linalg.svd(lies)
    rotation = left @ right
    return None if np.abs(rotation - np.eye(2)).max() <= SAME_FRAME else rotation


class Frames:
    """Normals of a surface's corners, of the source and of a decoder; tangents for maps.

    normal, rebuilt: float32 [F, 3, 3], the latter computed by a function at first use; geometric: float32 [F, 3] of the faces.
    """

    def __init__(self, scene: Scene, surface: Surface, rebuilt: Callable[[], np.ndarray] | None) -> None:
        self.scene, self.surface, self._rebuilt = scene, surface, rebuilt
        self.normal = self.rebuilt if scene.corner_normal is None else scene.corner_normal[surface.origin_face]
        corners = surface.lattice[surface.faces].astype(np.float32)
        self.geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._tangents: dict[int, np.ndarray] = {}
        self._sources = Cache()

    @cached_property
    def rebuilt(self) -> np.ndarray:
        """Normals of the given function."""
        assert self._rebuilt is not None
        return self._rebuilt()

    def deviations(self, name: str, face: np.ndarray, bary: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return the differences between the source's normals with a normal map and the normals that a decoder derives, float32
        [M, 3] in 0..255, FLAT being 0. name: channel of the map; face: int64 [M] of the surface, of materials with the map;
        bary: float64 [M, 3], barycentric coordinates of the points."""
        bent, flat = self.bent(name, face, bary, threads), interpolate_corners(self.rebuilt, face, bary)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)
        return np.clip((bent - flat + 1) * FLAT, 0, 255).astype(np.float32)

    def bent(self, name: str, face: np.ndarray, bary: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return the source's shading normals at points after its normal map has bent them, float32 [M, 3] of length 1;
        arguments as in deviations()."""
        texel, scale = self.texels(name, face, bary, threads)
        tangent = interpolate_corners(self.tangent(name), face, bary)
        normal, geometric = interpolate_corners(self.normal, face, bary), self.geometric[face]
        return tangent_space_normals(texel, scale, normal, tangent, geometric)

    def texels(self, name: str, face: np.ndarray, bary: np.ndarray, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Return (x and y of a normal map at points, float32 [M, 2] in 0..255, and its scale, float32 [M]); arguments as in
        deviations()."""
        packed = self._sources.get(name, lambda: pack_map(self.scene, name, self.surface.origin_face))
        return values_of_map(name, sample_source(packed, face, bary, threads)), self.scale(name, face)

    def scale(self, name: str, face: np.ndarray) -> np.ndarray:
        """Return the scale (glTF normalTexture.scale) of the normal map of a channel `name` on faces int64 [M], float32 [M]."""
        scale = np.array([factor_of(m.parameters, BY_NAME[name].parameter)[0] for m in self.scene.materials], np.float32)
        return scale[self.surface.material[face]]

    def tangent(self, name: str) -> np.ndarray:
        """Return tangents of the corners for a normal map, float32 [F, 3, 4]: the file's TANGENTs, whichever UVs the map has, or
        else derived from its UVs. name: channel of the map."""
        rows, uv = self.surface.origin_face, self.scene.map_uv.get(name, self.scene.corner_uv)
        key = id(uv)
        if key not in self._tangents:
            scene, own = self.scene, self.scene.corner_tangent
            has = np.zeros(len(rows), bool) if own is None else _have_tangents(scene)[rows]
            tangents = np.zeros((len(rows), 3, 4), np.float32) if own is None else np.array(own[rows], np.float32)
            if not has.all():
                tangents[~has] = corner_tangents(self.surface.lattice.astype(np.float64), self.surface.faces[~has],
                                                 uv[rows][~has], self.normal[~has])
            self._tangents[key] = tangents
        return self._tangents[key]


def with_folded_normals(scene: Scene, surface: SentSurface, flat: SentFaces) -> Scene:
    """Return the scene with new shading normals on faces whose UVs have no area: the normals that their normal map gives in the
    frame of the file's TANGENTs. Such UVs give a decoder no frame, so the map has no effect there (spec 8.5.2).

    flat: the faces whose UVs have no area.
    """
    if scene.corner_tangent is None or scene.corner_normal is None:
        return scene
    mapped = np.array([NORMAL in material.maps for material in scene.materials], bool)[surface.material[flat]]
    faces = flat[mapped & _have_tangents(scene)[surface.origin_face[flat]]]
    if not len(faces):
        return scene
    normal = scene.corner_normal.copy()
    normal[surface.origin_face[faces]] = _best_corners(Frames(scene, surface, None), faces)
    return replace(scene, corner_normal=normal)


def _best_corners(frames, faces):
    """Return normals of the corners of faces, float32 [N, 3, 3], whose interpolation comes nearest to the surface with its normal
    map; the source's own if these come nearer."""
    steps = [(i, j, ACROSS - i - j) for i in range(ACROSS + 1) for j in range(ACROSS + 1 - i)]
    bary = (np.array(steps) + 1 / 3) / (ACROSS + 1)  # inside, since what a corner alone shows may be the padding of a chart
    at = np.repeat(faces, len(bary)), np.tile(bary, (len(faces), 1))
    bent = frames.bent(NORMAL, *at).reshape(len(faces), len(bary), 3)
    own, fitted = frames.normal[faces], np.einsum("cm,nmk->nck", np.linalg.pinv(bary), bent)
    length = np.linalg.norm(fitted, axis=2, keepdims=True)
    fitted = np.where(length > LEAST_LENGTH, fitted / np.maximum(length, LEAST_LENGTH), own)

    def error(corners):
        normals = np.einsum("mc,nck->nmk", bary, corners)
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), LEAST_LENGTH)
        return ((normals - bent) ** 2).sum(axis=(1, 2))

    return np.where((error(fitted) < error(own))[:, None, None], fitted, own).astype(np.float32)


def _have_tangents(scene):
    """Return whether the file has a TANGENT at every corner of a face, bool [F]."""
    return scene.corner_tangent.any(axis=2).all(axis=1)


class ShownMaps:
    """Values of maps at places on a surface: the `maps` of a codecs.base.Source. Arguments as those of Frames."""

    def __init__(self, scene: Scene, surface: SourceSurface, rebuilt: Callable[[], np.ndarray]) -> None:
        self.scene, self.surface, self._rebuilt = scene, surface, rebuilt
        self._packed = Cache()

    def __call__(self, name: str, face: np.ndarray, bary: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return values of a channel over voxels, float32 [M, C] in 0..255. name: in channels.CHANNELS; face: int64 [M] of the
        surface, of materials with the map; bary: float64 [M, 3]."""
        material_name = BY_NAME[name].material_name
        if material_name != name:
            return self._frames.deviations(material_name, face, bary, threads)
        packed = self._packed.get(name, lambda: pack_map(self.scene, name, self.surface.origin_face))
        return sample_source(packed, face, bary, threads)[:, map_columns(name)]

    @cached_property
    def _frames(self):
        return Frames(self.scene, self.surface, self._rebuilt)
