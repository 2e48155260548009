"""A decoded stream with fewer faces: the mesh that a GLB with an embedded stream shows to viewers that do not know the stream."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.draco import split_corners
from ..geometry.geometry_unit import GeometryUnit
from ..geometry.mesh import Mesh
from ..scene.normal_rule import JOINED, NormalRule
from .mesh.carried_uvs import SeamedMesh, carried_uvs
from .mesh.simplify import simplify
from .mesh.topology import seam_edges, sharp_edges

if TYPE_CHECKING:
    from ..texf import Texf

# Quadric error of a collapse, of areas and distances in halves of the longest side. It leaves 10 % of the faces of bball_0001,
# 0.001 of the side away (root of the mean square), and of damaged_helmet, which is full of seams, 47 %, 0.0005 away. Ten times as
# much leaves 6 and 33 %, 0.002 and 0.001 away. A share that is the same for both, an eighth, tears the helmet's visor out.
MOST_ERROR = 3e-7
SHARP = 60  # degrees between faces, from which on an edge is kept as a line, and a corner has normals of its own


def with_fewer_faces(texf: Texf, count: int | None = None) -> Texf:
    """Return a Texf with at most `count` faces, or as few as its borders, seams and sharp edges leave. If count is None, the
    mesh gets as few faces as look the same from afar. A Texf with no more faces is returned unchanged.

    The fields stay the same. Units over texels get UVs that keep images where they were. Coded normals and marks of sharp edges
    belong to the old faces: materials that are not flat get normals by the angle between faces.
    """
    if len(texf.faces) <= (count or 0):
        return texf
    lattice, welded = np.unique(texf.lattice_positions, axis=0, return_inverse=True)
    faces = welded.reshape(-1)[texf.faces]
    unit = np.repeat(np.arange(len(texf.units)), [len(u.faces) for u in texf.units])
    source = Mesh(lattice.astype(np.float64), faces)
    corner_uv = texf.uv[texf.faces]
    seams = np.concatenate([seam_edges(faces, unit), seam_edges(faces, corner=corner_uv)])
    order = simplify(source, np.concatenate([seams, sharp_edges(source, SHARP)]))
    if count is None:
        done = int(np.append(order.error > MOST_ERROR, True).argmax())  # collapses before the first that goes beyond
        count = int(order.remaining[done - 1]) if done else len(faces)
    some = order.at(count)
    if any(u.uv is not None for u in texf.units):
        simplified = SeamedMesh(some.mesh, some.edges(seams))
        corner_uv = carried_uvs(SeamedMesh(source, seams), corner_uv, simplified, some.face)
    placed = np.clip(np.rint(some.mesh.positions), 0, texf.cube.last).astype(np.int64)
    units = [_unit(texf, number, placed, some.mesh.faces[rows], corner_uv[rows] if u.uv is not None else None)
             for number, u in enumerate(texf.units) for rows in [unit[some.face] == number] if rows.any()]
    return replace(texf, units=units, materials=[_by_angle(m) for m in texf.materials], sharp_edges=None, coded_normals=None)


def _unit(texf, number, placed, faces, corner_uv):
    """Return the GeometryUnit of faces over placed vertices; corner_uv: in texels, None over voxels."""
    like = texf.units[number]
    if corner_uv is None:
        vertex, local = np.unique(faces, return_inverse=True)
        return GeometryUnit(like.field, like.material, placed[vertex], local.reshape(-1, 3))
    steps = np.rint(corner_uv * (1 << texf.fields[like.field].support.fraction_bits)).astype(np.int64)
    vertex, uv, local = split_corners(faces, steps)
    return GeometryUnit(like.field, like.material, placed[vertex], local, uv)


def _by_angle(material):
    rule = material.normals
    return material if rule.is_flat else replace(material, normals=NormalRule(JOINED, rule.weight, max(rule.angle, SHARP)))
