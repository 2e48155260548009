"""Edges that a simplification keeps as lines: changes of material, field or UV, and sharp edges (encoder only). The
simplification finds borders and edges of more than two faces by itself."""

from __future__ import annotations

import numpy as np

from ...geometry.mesh import Mesh
from .topology import scaled_normals, side_pairs, turned_faces, undirected


def seam_edges(faces: np.ndarray, group: np.ndarray | None = None, corner: np.ndarray | None = None,
               apart: float = 0.0) -> np.ndarray:
    """Return edges between two faces of different groups, or at which values of their corners differ by more than `apart`, int64
    [L, 2]. faces: int64 [F, 3] over welded vertices; group: [F], of a material or a field; corner: [F, 3, C], UVs or normals."""
    ends, edge, count = undirected(faces)
    sides, edges = side_pairs(edge, count)
    seam = np.zeros(len(sides), bool)
    if group is not None:
        seam |= np.diff(np.asarray(group)[sides // 3], axis=1)[:, 0] != 0
    if corner is not None:
        held = np.asarray(corner).reshape(-1, np.shape(corner)[2])
        after = sides - sides % 3 + (sides + 1) % 3
        same = faces.ravel()[sides[:, 0]] == faces.ravel()[sides[:, 1]]  # both faces run along the edge the same way
        for first, second in ((sides, after), (after, sides)):
            other = np.where(same, first[:, 1], second[:, 1])
            seam |= (np.abs(held[first[:, 0]] - held[other]) > apart).any(axis=1)
    return ends[edges[seam]]


def sharp_edges(mesh: Mesh, degrees: float) -> np.ndarray:
    """Return edges between two faces whose normals are more than `degrees` apart, int64 [L, 2]. Faces without area and
    turned_faces() have no such edges: as lines they would never go."""
    ends, edge, count = undirected(mesh.faces)
    sides, edges = side_pairs(edge, count)
    normals, turned = scaled_normals(mesh.positions, mesh.faces), turned_faces(mesh.positions, mesh.faces)
    a, b = (normals[sides[:, k] // 3] for k in (0, 1))
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    sharp = (a * b).sum(axis=1) < np.cos(np.radians(degrees)) * lengths
    return ends[edges[sharp & ~turned[sides // 3].any(axis=1)]]
