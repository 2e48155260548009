"""Corners of faces as vertices of a GPU: one vertex for all corners that are alike."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..render.lit_scene import SceneMaps
from ..render.material_effects import ShadingTable
from ..scene.scene import Scene
from .container import Blobs

Sphere = tuple[np.ndarray, float]
SHORT = 32767


@dataclass
class Corners:
    """Of all faces in the order in which they are drawn. vertex: int64 [F, 3] into positions; positions: float32 [V, 3]
    from the centre in radii; others: float32 [F, 3, C] by name; parts: [first face, faces, field, material] of what is
    drawn at once."""

    vertex: np.ndarray
    positions: np.ndarray
    parts: list[list[int]]
    others: dict[str, np.ndarray] = field(default_factory=dict)


def scene_corners(scene: Scene, table: ShadingTable, sphere: Sphere) -> Corners:
    """Corners of a Scene, see uv_sets for its UVs; normals and tangents only where its materials are lit and ask for them.
    sphere: centre and radius that places are told in."""
    order, parts = _in_parts(np.zeros(len(scene.faces), np.int64), scene.face_material)
    maps, others = SceneMaps(scene), {}
    if table.is_lit and len(order):
        others["normal"] = maps.corner_normal[order]
        names = table.wanted_channels() & {"normal", "clearcoat_normal"}
        if _ask_tangents(table):
            others["tangent"] = maps.corner_tangent(min(names, default="normal", key=("normal", "clearcoat_normal").index))[order]
    for number, uv in enumerate(uv_sets(scene)):
        others[f"uv{number}"] = np.nan_to_num(uv[order], nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    if scene.corner_color is not None:
        others["colour"] = scene.corner_color[order]
    centre, radius = sphere
    positions = ((scene.positions - centre) / radius).astype(np.float32)
    return Corners(scene.faces[order], positions, parts, others)


def uv_sets(scene: Scene) -> list[np.ndarray]:
    """The UVs that maps of a Scene have, float64 [F, 3, 2] each, those of base colour first."""
    found = [scene.corner_uv]
    for uv in scene.map_uv.values():
        if not any(uv is one for one in found):
            found.append(uv)
    return found


def _ask_tangents(table):
    return bool(table.wanted_channels() & {"normal", "clearcoat_normal"}) or any("anisotropy" in e for e in table.effects)


def _in_parts(face_field, face_material):
    """(faces in drawing order, parts): the last come first, for where two are equally near the page shows the one that it draws
    last, and texf-render the first."""
    order = np.arange(len(face_field))[::-1]
    keys = np.stack([face_field[order], face_material[order]], axis=1)
    first = np.flatnonzero((np.diff(keys, axis=0, prepend=-1) != 0).any(axis=1))
    ends = np.append(first, len(order))[1:]
    return order, [[int(a), int(b - a), *map(int, keys[a])] for a, b in zip(first, ends, strict=True)]


def pack_mesh(corners: Corners, blobs: Blobs) -> dict[str, Any]:
    """The header's "mesh": references to vertices and triangles."""
    kinds = {"normal": _oct, "tangent": lambda rows: np.hstack([_oct(rows[:, :3]), _signs(rows[:, 3:])])}
    columns = {name: kinds.get(name, np.float32)(rows.reshape(3 * len(rows), rows.shape[-1]))
               for name, rows in corners.others.items()}
    vertex = corners.vertex.reshape(-1)
    keys = np.hstack([np.ascontiguousarray(vertex[:, None]).view(np.uint8)] +
                     [np.ascontiguousarray(c).view(np.uint8) for c in columns.values()])
    chosen, faces = _distinct(keys)
    return {
        "positions": blobs.add(corners.positions[vertex[chosen]]), "faces": blobs.add(faces.reshape(-1, 3), differences=True),
        "scale": 1.0, "offset": [0.0] * 3, "parts": corners.parts,
        "attributes": {name: blobs.add(rows[chosen].view(np.uint16) if rows.dtype == np.int16 else rows[chosen],
                                       differences=rows.dtype == np.int16) for name, rows in columns.items()},
    }


def _distinct(keys):
    """(first corner of every kind, in the order in which the faces meet them; kind of every corner as uint32)."""
    if not len(keys):
        return np.zeros(0, np.int64), np.zeros(0, np.uint32)
    rows = np.ascontiguousarray(keys).view(np.dtype((np.void, keys.shape[1]))).reshape(-1)
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.uint32)
    rank[order] = np.arange(len(order), dtype=np.uint32)
    return first[order], rank[which.reshape(-1)]


def _oct(rows):
    """Unit directions float32 [M, 3] as int16 [M, 2] on an octahedron; both the least where there is none."""
    rows = np.nan_to_num(np.asarray(rows, np.float64))
    size = np.abs(rows).sum(axis=1, keepdims=True)
    none = size[:, 0] < 1e-12
    x, y, z = (rows / np.where(size > 0, size, 1)).T
    folded = np.where(z < 0, (1 - np.abs([y, x])) * np.where(np.array([x, y]) < 0, -1.0, 1.0), [x, y])
    out = np.rint(folded.T * SHORT).astype(np.int16)
    out[(out <= -SHORT).all(axis=1)] = SHORT  # the same direction: both the least say that there is none
    out[none] = -SHORT
    return out


def _signs(column):
    """int16 [M, 2]: the sign of the bitangent, and nothing."""
    out = np.where(column < 0, -SHORT, SHORT).astype(np.int16)
    return np.hstack([out, np.zeros_like(out)])
