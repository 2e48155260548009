"""Distance of two surfaces: D1, D2 and Hausdorff between the meshes themselves, not between clouds of their points.

The error of one way is the mean of the squared distances from points spread evenly by area over one mesh to the nearest point of
the other mesh; D1 takes the worse of the two ways. D2 takes the component of each distance along the source's normal. The
Hausdorff distance is the largest of either way, at these points and at the vertices. PSNR of D1 and D2 is 10 log10(3 peak^2 /
error), as in pc_error and mpeg-pcc-mmetric (mode pcc); the peak here is the longest side of the source's box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..core.colour_error import decibels
from ..core.json_text import json_ready
from ..geometry.areas import sample_surface, used_vertices
from ..geometry.mesh import Mesh, points_at
from ..geometry.nearest_points import NearestPoints

SAMPLES = 100_000


class Way(NamedTuple):
    """Distances from points of one mesh to the nearest points of another.

    Attributes
    ----------
    point, plane : float
        Mean squared distances (D1, D2): to the nearest point, and of that along the source's normal.
    largest : float
        The largest distance from these points and the vertices.
    """

    point: float
    plane: float
    largest: float


@dataclass(frozen=True, kw_only=True)
class SurfaceDistance:
    """Distances between a mesh and its source, in the meshes' units.

    Attributes
    ----------
    of_mesh, of_source : Way
        From points of the mesh to the source, and from points of the source to the mesh.
    side, diagonal : float
        Longest side and diagonal of the source's bounding box.
    """

    of_mesh: Way
    of_source: Way
    side: float
    diagonal: float

    @property
    def to_source(self) -> float:
        """Mean squared distance from the mesh's points to the source."""
        return self.of_mesh.point

    @property
    def from_source(self) -> float:
        """Mean squared distance from the source's points to the mesh."""
        return self.of_source.point

    @property
    def d1(self) -> float:
        """PSNR in dB by MPEG's definition, whose peak is the longest side of the box; infinite if the surfaces are equal."""
        return decibels(max(self.to_source, self.from_source) / 3, self.side)

    @property
    def d1_side(self) -> float:
        """d1 without the factor of 3, 4.77 dB less: the definition that the encoder's geometry figures use."""
        return decibels(max(self.to_source, self.from_source), self.side)

    @property
    def d2(self) -> float:
        """PSNR of distances along the source's normals; the rest as in d1."""
        return decibels(max(self.of_mesh.plane, self.of_source.plane) / 3, self.side)

    @property
    def largest(self) -> float:
        """The Hausdorff distance: the largest of either way, in the meshes' units."""
        return max(self.of_mesh.largest, self.of_source.largest)

    def report(self) -> dict:
        """JSON-ready: "d1", "d2": {"psnr", "to_source", "from_source": mean squared distances}, "peak": of both PSNR,
        "hausdorff": {"distance", "share": of the diagonal of the source's box, "to_source", "from_source"}."""
        ways = {"to_source": self.of_mesh, "from_source": self.of_source}
        return json_ready({
            "d1": {"psnr": self.d1, **{name: way.point for name, way in ways.items()}},
            "d2": {"psnr": self.d2, **{name: way.plane for name, way in ways.items()}}, "peak": self.side,
            "hausdorff": {"distance": self.largest, "share": self.largest / self.diagonal,
                          **{name: way.largest for name, way in ways.items()}}})


def surface_distance(source: Mesh, mesh: Mesh, samples: int = SAMPLES, seed: int = 0, threads: int = 1) -> SurfaceDistance:
    """Measure the distance between two meshes in both directions, at random points of each.

    Parameters
    ----------
    source, mesh : Mesh
        Each with a face that has area.
    samples : int
        Number of points on each.
    seed : int
        Of the random points.
    threads : int
        Most threads.

    Returns
    -------
    SurfaceDistance
        In the meshes' units.
    """
    source, mesh = source.checked(), mesh.checked()
    box = source.positions[source.faces].reshape(-1, 3)
    extent = box.max(axis=0) - box.min(axis=0)
    there = NearestPoints(source)
    face, bary = sample_surface(mesh.positions, mesh.faces, samples, seed)
    points = points_at(mesh, face, bary)
    nearest = there.find(points, threads=threads)
    of_mesh = _way(points - points_at(source, nearest.face, nearest.bary), there.normals(nearest.face),
                   _at_vertices(mesh, there, threads))
    face, bary = sample_surface(source.positions, source.faces, samples, seed + 1)
    points = points_at(source, face, bary)
    normals = there.normals(face)
    del there
    here = NearestPoints(mesh)
    nearest = here.find(points, threads=threads)
    of_source = _way(points - points_at(mesh, nearest.face, nearest.bary), normals, _at_vertices(source, here, threads))
    return SurfaceDistance(of_mesh=of_mesh, of_source=of_source, side=float(extent.max()), diagonal=float(np.linalg.norm(extent)))


def _at_vertices(start, end, threads):
    """The largest distance from a vertex to the other mesh."""
    used, _ = used_vertices(start.faces, len(start.positions))
    return float(end.find(start.positions[used], threads=threads).distance.max())


def _way(off, normals, at_vertices):
    """Way of the vectors from points to their nearest points.

    off: float64 [M, 3]; normals: of the source there, 0 if its face has no area: then the whole distance counts.
    """
    point = (off**2).sum(axis=1)
    plane = np.where(normals.any(axis=1), (off * normals).sum(axis=1) ** 2, point)
    return Way(float(point.mean()), float(plane.mean()), max(float(np.sqrt(point.max())), at_vertices))
