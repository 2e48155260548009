"""How far two surfaces are apart: D1 between the meshes themselves, not between clouds of their points.

The error of one way is the mean of the squared distances from points spread evenly by area over one mesh to the nearest point of
the other mesh; D1 takes the worse of the two ways.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.areas import sample_surface
from ..geometry.mesh import Mesh, points_at
from ..geometry.nearest_points import NearestPoints

SAMPLES = 100_000


@dataclass(frozen=True, kw_only=True)
class SurfaceDistance:
    """to_source, from_source: mean squared distances from the mesh's points to the source and back; largest: the largest distance
    of all these points; side, diagonal: of the source's box."""

    to_source: float
    from_source: float
    largest: float
    side: float
    diagonal: float

    @property
    def d1_side(self) -> float:
        """PSNR in dB whose peak is the longest side of the box, the canonical cube's; infinite where the surfaces are equal."""
        return _psnr(self.side, max(self.to_source, self.from_source))

    @property
    def d1_diagonal(self) -> float:
        """PSNR in dB whose peak is the diagonal of the box."""
        return _psnr(self.diagonal, max(self.to_source, self.from_source))


def surface_distance(source: Mesh, mesh: Mesh, samples: int = SAMPLES, seed: int = 0) -> SurfaceDistance:
    """The distance between two meshes that have area. samples: points on each."""
    source, mesh = source.checked(), mesh.checked()
    ways = [_distances(mesh, source, samples, seed), _distances(source, mesh, samples, seed + 1)]
    box = source.positions[source.faces].reshape(-1, 3)
    extent = box.max(axis=0) - box.min(axis=0)
    to_source, from_source = (float(np.mean(way**2)) for way in ways)
    return SurfaceDistance(to_source=to_source, from_source=from_source, largest=float(max(way.max() for way in ways)),
                           side=float(extent.max()), diagonal=float(np.linalg.norm(extent)))


def _distances(start, end, samples, seed):
    face, bary = sample_surface(start.positions, start.faces, samples, seed)
    return NearestPoints(end).find(points_at(start, face, bary)).distance


def _psnr(peak, error):
    return float(10 * np.log10(peak * peak / error)) if error > 0 else float("inf")
