"""Layers of one component: faces that are joined by welding although they look different and coincide (encoder only).

Two coincident sheets share every edge once equal positions are merged, so that neither components nor directions part them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.components import components
from ...scene.scene import ALPHA_OPAQUE, Material, Scene
from .contacts import MIN_FOLD

if TYPE_CHECKING:
    from ...geometry.surface import Surface


def _numbered(columns):
    """Return the number of every row among the distinct ones, int64 [N]. columns: list of arrays [N]."""
    order = np.lexsort(columns)
    new = np.zeros(len(order), np.int64)
    for column in columns:
        new[1:] |= column[order][1:] != column[order][:-1]
    out = np.empty(len(order), np.int64)
    out[order] = np.cumsum(new)
    return out


def corner_appearance(scene: Scene, picked: np.ndarray) -> np.ndarray:
    """Return a number for the appearance (material, UV, colour) of each corner, int64 [n, 3]; corners that look the same have
    the same number. picked: int64 [n], faces of the scene. UVs count if there is a texture."""
    material = scene.face_material[picked]
    textured = np.array([m.texture >= 0 for m in scene.materials], bool)[material]
    columns = [np.repeat(material, 3), *np.where(textured[:, None, None], scene.corner_uv[picked], 0).reshape(-1, 2).T]
    if scene.corner_color is not None:
        columns += list(scene.corner_color[picked].reshape(-1, 4).T)
    return _numbered(columns).reshape(-1, 3)


def layered_components(faces: np.ndarray, component: np.ndarray, material: np.ndarray, materials: list[Material]) -> np.ndarray:
    """Return a mask over components, bool, of those that may hold layers: with coincident faces, or with different materials of
    which at least one is not opaque. faces: int64 [F, 3] over welded vertices; component, material: int64 [F]."""
    count = int(component.max()) + 1
    corners = _numbered(list(np.sort(faces, axis=1).T))
    out = np.bincount(component, (np.bincount(corners) > 1)[corners], count) > MIN_FOLD * np.bincount(component, minlength=count)
    clear = np.array([m.alpha_mode != ALPHA_OPAQUE for m in materials], bool)[material]
    if clear.any():
        least, most = np.full(count, len(materials)), np.full(count, -1)
        np.minimum.at(least, component, material)
        np.maximum.at(most, component, material)
        out |= (np.bincount(component, clear, count) > 0) & (least != most)
    return out


def _joined(faces, appearance, material):
    """Return the number of the layer of every face, int64 [n]. Faces share a layer across an edge if they look alike at both its
    ends, or are the only two of their material there and run along it in opposite directions."""
    count, after = len(faces), [1, 2, 0]
    ends = np.stack([faces, faces[:, after]], -1).reshape(-1, 2)
    shown = np.stack([appearance, appearance[:, after]], -1).reshape(-1, 2)
    back = ends[:, 0] > ends[:, 1]
    ends[back], shown[back] = ends[back][:, ::-1], shown[back][:, ::-1]
    alike = _numbered([*ends.T, *shown.T])
    side = _numbered([*ends.T, np.repeat(material, 3)])
    plain = (np.bincount(side) == 2) & (np.bincount(side, back) == 1)
    owner = np.repeat(np.arange(count), 3)
    pick = plain[side]
    rows = np.concatenate([owner, owner[pick]])
    columns = count + np.concatenate([alike, alike.max() + 1 + side[pick]])
    return components(int(columns.max()) + 1, rows, columns)[:count]


def part_layers(scene: Scene, surface: Surface, component: np.ndarray) -> np.ndarray | None:
    """Return the component of every face, int64 [F], after components have been split into their layers: coincident sheets that
    welding joined although they look different. None if there are no layers. component: int64 [F], from face_components of the
    Surface."""
    layered = layered_components(surface.faces, component, surface.material, scene.materials)
    rows = np.flatnonzero(layered[component])
    if not len(rows):
        return None
    faces = surface.faces[rows]
    layer = _joined(faces, corner_appearance(scene, surface.origin_face[rows]), surface.material[rows])
    if layer.max() + 1 == len(np.unique(component[rows])):
        return None
    out = component.copy()
    out[rows] = int(component.max()) + 1 + layer
    return np.unique(out, return_inverse=True)[1].reshape(-1)
