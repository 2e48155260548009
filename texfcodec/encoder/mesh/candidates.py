"""Meshes that may be sent in place of the source's: with fewer faces, fitted to it and put on a lattice, and the errors of their
pictures (encoder only). choice.py takes one of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...core.threads import ahead, in_order
from ...geometry.areas import face_areas, sample_surface
from ...geometry.canonical import finer_cube
from ...geometry.mesh import Mesh, points_at
from ...geometry.nearest_points import NearestPoints
from ...geometry.surface import Surface, place_mesh
from ...metrics.surface_distance import surface_distance
from ..caches import Cache, NoCache
from ..faces import LatticeFaces, SentSurface, SourceFaces, SourceSurface, source_faces
from .carried_uvs import SeamedMesh, carried_uvs
from .drawn_source import DrawnSource, FetchedNormals, draw_onto
from .joint_lattice import joint_lattice
from .picture_error import PictureError
from .simplify import simplify
from .topology import seam_edges, sharp_edges
from .vertex_fit import MatchedLines, fit_vertices, own_fit

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...scene.scene import Scene
    from .choice import MeshChoice
    from .simplify import Simplification
    from .vertex_fit import VertexFit

REFERENCE_BITS = 12  # bits of the lattice that the others' error is reckoned from
SHARES = tuple(2 ** (-number / 2) for number in range(11))  # of the source's faces; a point 25 % off costs 1 to 2 % of the bytes
SAME_UV = 1e-5  # differences from which on an edge is a seam
LARGE = 1 << 18  # faces: from here on fits and the tree of nearest points, 300 and 200 bytes a face, are computed when needed
FEWEST = 256  # faces: fewer take too few bytes to bother
FIT_GAIN = 0.7  # of the distance before the vertices are fitted
SHARP, HARD = 60.0, 0.3  # degrees between faces, and difference of the file's normals, from which on an edge is kept as a line
FEW_POINTS, DISTANCE_POINTS = 5_000, 20_000  # of distances that are guessed with, and that the report has
NOTHING = 1e9  # the squared error of a mesh of which nothing is left


@dataclass(frozen=True, kw_only=True)
class SentMesh:
    """The mesh that is sent.

    scene: with the faces that are sent; surface: the same on its lattice; source_face: [G], the source face that each face was
    simplified from; source_on_mesh: the source's faces on that surface, or the surface itself; corner_places: places of their
    corners there, None if it is the surface; carries: whether its faces are fewer and have UVs of their own, so
    that they show the same as the scene; saved: bytes that it costs less than the source's mesh.
    """

    scene: Scene
    surface: SentSurface
    source_face: SourceFaces
    source_on_mesh: SourceSurface
    corner_places: DrawnSource | None = None
    carries: bool = False
    saved: float = 0.0

    def shown(self, scene: Scene) -> Scene:
        """Return the scene that the faces of source_on_mesh belong to: the given one or, if the sent faces have UVs of their
        own, that of this mesh with the given textures. scene: the source, some of whose textures may have changed."""
        return replace(self.scene, textures=scene.textures) if self.carries else scene

    def at_corners(self, corner: np.ndarray) -> np.ndarray:
        """Return values at the corners of source_on_mesh, float32 [F, 3, C], from values at the corners of the surface, float32
        [G, 3, C]."""
        return corner if self.corner_places is None else self.corner_places.from_corners(corner)


def kept(scene: Scene, surface: SourceSurface) -> SentMesh:
    """Return the source's own mesh on a lattice, without simplification, as a SentMesh."""
    return SentMesh(scene=scene, surface=SentSurface(surface), source_face=source_faces(surface), source_on_mesh=surface)


class MeshTrial(NamedTuple):
    """A mesh that was tried. sent: None if no face has area; face: [G], face of the usual surface that each face comes from;
    moved: its PictureError."""

    sent: SentMesh | None
    face: LatticeFaces
    moved: PictureError


class _Fit(NamedTuple):
    """fit: VertexFit; face: [G], face of the usual surface that each of its faces comes from; uvs: float64 [G, 3, 2] by names of
    map_uv, "" for corner_uv; empty if UVs are not carried."""

    fit: VertexFit
    face: LatticeFaces
    uvs: dict[str, np.ndarray]


class CandidateMeshes:
    """Meshes of one source with their PictureErrors, at any price of a byte. usual: its Surface; group: int64 [F] of its faces:
    two groups stay apart; borders: int64 [L, 2], edges between groups; carries: whether faces keep UVs of their own; shares: of
    its faces that smaller meshes may have."""

    def __init__(self, choice: MeshChoice, usual: SourceSurface, group: np.ndarray, borders: np.ndarray, carries: bool) -> None:
        self.scene, self.usual, self.choice = choice.scene, usual, choice
        self.group, self._borders, self._carries = group, borders, carries
        positions = np.zeros(self.usual.lattice.shape)
        positions[self.usual.faces] = self.scene.positions[self.scene.faces[self.usual.origin_face]]
        self.source = Mesh(positions, self.usual.faces)
        self.shares = SHARES[:1] if carries and self.scene.corner_color is not None else SHARES  # texels have vertices' colours
        self._trials: dict[tuple[int, int], MeshTrial] = {}
        self._moved = Cache()  # PictureErrors by place and bits
        keeps = len(usual.faces) <= LARGE or choice.is_direct
        self._fits = Cache() if keeps else NoCache()  # _Fits by place, NearestPoints of the source
        self._simplifying: Callable[[], Simplification] | None = None

    def begin(self) -> Callable[[], Simplification]:
        """Start the simplification in the background, beside trials that need no smaller mesh. Return a function that waits for
        its end."""
        if self._simplifying is None:
            self._simplifying = ahead(self._simplified_source, self.choice.price.threads)
        return self._simplifying

    @cached_property
    def _seams(self):
        """Edges at which UVs or groups of the faces change, int64 [L, 2]."""
        uvs = [uv[self.usual.origin_face] for uv in (self.scene.corner_uv, *self.scene.map_uv.values())]
        return np.concatenate([self._borders, seam_edges(self.usual.faces, corner=np.concatenate(uvs, axis=2), apart=SAME_UV)])

    @property
    def _simplification(self):
        return self.begin()()

    def _simplified_source(self):
        lines = [self._seams if self._carries else self._borders, sharp_edges(self.source, SHARP)]
        if self.scene.corner_normal is not None:
            lines.append(seam_edges(self.usual.faces, corner=self.scene.corner_normal[self.usual.origin_face], apart=HARD))
        return simplify(self.source, np.concatenate(lines))

    def trial(self, place: int, bits: int) -> MeshTrial:
        """Return the mesh with a share of the faces at some position bits. place: index of the share in SHARES."""
        if (place, bits) not in self._trials:
            self._trials[place, bits] = self._new_trial(place, bits)
        return self._trials[place, bits]

    def keep_only(self, place: tuple[int, int]) -> None:
        """Drop all trials but that at a place, (index into SHARES, bits). They are computed again when needed, except their
        pictures."""
        self._trials = {place: self.trial(*place)}

    def _new_trial(self, place: int, bits: int) -> MeshTrial:
        if (place, bits) == (0, self.usual.cube.position_bits):
            moved, face = self.choice.picture_error(self.usual), LatticeFaces(np.arange(len(self.usual.faces)))
            return MeshTrial(kept(self.scene, self.usual), face, moved)
        fit = self._fits.get(place, lambda: self._new_fit(place))
        cube = replace(self.usual.cube, position_bits=bits)
        surface = place_mesh(cube, joint_lattice(fit.fit, cube), fit.fit.mesh.faces, self.usual.material[fit.face])
        if not face_areas(surface.lattice, surface.faces).any():
            return MeshTrial(None, fit.face, PictureError(NOTHING, 1.0, 1.0))
        face, there = LatticeFaces(fit.face[surface.origin_face]), {name: uv[surface.origin_face] for name, uv in fit.uvs.items()}
        del fit  # pictures of a large mesh need its room
        mesh, threads = Mesh(surface.cube.to_world(surface.lattice), surface.faces), self.choice.price.threads
        fetched = FetchedNormals(self.source, lambda: self.points, mesh, threads)
        sent = self._sent(surface, face, place > 0, there, fetched)
        return MeshTrial(sent, face, self._moved.get((place, bits), lambda: self._moved_by(sent, fetched)))

    def _moved_by(self, sent: SentMesh, fetched: FetchedNormals) -> PictureError:
        """Return the PictureError of another mesh. fetched: FetchedNormals there."""
        pictures, wanted = self.choice.pictures, None
        normals = pictures.normals_of(sent.surface)
        if not sent.carries:
            return pictures.of(sent.source_on_mesh, sent.at_corners(normals))
        if sent.scene.corner_normal is not None and pictures.lit:
            wanted = fetched.of(pictures.normals[self.usual.origin_face])
        return pictures.of_mesh(sent.scene, sent.surface, normals, wanted, sent.source_face)

    @cached_property
    def aways(self) -> list[float]:
        """Distances of the meshes of each share from the source, before they are fitted: roots of mean squared distances,
        relative to the rounding of REFERENCE_BITS, which leaves all faces."""
        sent = self.trial(0, REFERENCE_BITS).sent
        assert sent is not None
        cube = sent.surface.cube
        rounding, *aways = self._distances_of([Mesh(cube.to_world(sent.surface.lattice), sent.surface.faces), *self._smaller])
        return [0.0, *(FIT_GAIN * away / max(rounding, 1e-9 * cube.side) for away in aways)]

    @property
    def distances(self) -> list[float]:
        """Roots of mean squared distances of the meshes of each share from the source before they are fitted, 0 for the first."""
        return [0.0, *self._distances_of(self._smaller)]

    def edge_at(self, place: int) -> float:
        """Return the length of an edge of the mesh of a share, for equilateral faces of its mean area."""
        area = float(face_areas(self.source.positions, self.source.faces).sum())
        return math.sqrt(4 / math.sqrt(3) * area / (self.shares[place] * len(self.source.faces)))

    @property
    def _smaller(self):
        """Meshes of the shares beyond the first, up to the last that simplification reaches."""
        meshes = []
        for share in self.shares[1:]:
            mesh = self._simplification.at(round(share * len(self.source.faces))).mesh
            if len(mesh.faces) < FEWEST or len(mesh.faces) > 1.2 * share * len(self.source.faces):
                break
            meshes.append(mesh)
        return meshes

    def _distances_of(self, meshes):
        nearest = self.points

        def away_of(mesh):
            face, bary = sample_surface(mesh.positions, mesh.faces, FEW_POINTS)
            return float(np.sqrt(np.square(nearest.find(points_at(mesh, face, bary)).distance).mean()))

        return list(in_order(away_of, meshes, self.choice.price.threads))

    def _new_fit(self, place: int) -> _Fit:
        """Return the _Fit of a share of the faces."""
        if place == 0:
            return _Fit(own_fit(self.source), LatticeFaces(np.arange(len(self.source.faces))), {})
        lines, threads = self._simplification.lines, self.choice.price.threads
        some = self._simplification.at(round(self.shares[place] * len(self.source.faces)))
        fit, uvs = fit_vertices(self.source, some.mesh, MatchedLines(lines, some.lines), rounds=1, threads=threads), {}
        if self._carries:
            source, fitted = SeamedMesh(self.source, self._seams), SeamedMesh(fit.mesh, some.edges(self._seams))
            rows = self.usual.origin_face
            for name, uv in {"": self.scene.corner_uv, **self.scene.map_uv}.items():
                uvs[name] = carried_uvs(source, uv[rows].astype(np.float64), fitted, some.face, threads)
        return _Fit(fit, LatticeFaces(some.face), uvs)

    def _sent(self, surface: Surface, face: LatticeFaces, simplified: bool, uvs: dict[str, np.ndarray],
              fetched: FetchedNormals) -> SentMesh:
        """Return a SentMesh. surface: on its lattice; face: face of the usual surface that each face comes from; uvs: of a _Fit;
        fetched: FetchedNormals there."""
        rows = source_faces(self.usual, face)
        if not simplified:
            return kept(self.scene, SourceSurface(replace(surface, origin_face=rows)))
        sent = SentSurface(replace(surface, origin_face=np.arange(len(face))))
        return self._simplified(sent, rows, self.group[face], uvs, fetched)

    def _simplified(self, surface: SentSurface, rows: SourceFaces, group: np.ndarray, uvs: dict[str, np.ndarray],
                    fetched: FetchedNormals) -> SentMesh:
        mesh, scene = Mesh(surface.cube.to_world(surface.lattice), surface.faces), self.scene
        normals = None
        if scene.corner_normal is not None and self.choice.pictures.is_flat:
            normals = self.choice.pictures.normals_of(surface)
        elif scene.corner_normal is not None:
            normals = fetched.of(scene.corner_normal[self.usual.origin_face])
        sent = replace(scene, positions=mesh.positions, faces=mesh.faces, face_material=scene.face_material[rows],
                       corner_uv=uvs.get("", scene.corner_uv[rows]),
                       map_uv={name: uvs.get(name, uv[rows]) for name, uv in scene.map_uv.items()},
                       corner_color=None if scene.corner_color is None else scene.corner_color[rows],
                       corner_map={name: values[rows] for name, values in scene.corner_map.items()},
                       corner_normal=normals, corner_tangent=None)
        if uvs:
            if scene.corner_tangent is not None:
                sent = replace(sent, corner_tangent=self._fetched_tangents(scene.corner_tangent, fetched, rows))
            return SentMesh(scene=sent, surface=surface, source_face=rows, source_on_mesh=SourceSurface(surface), carries=True)
        places = draw_onto(self.source, self.group, mesh, group, self.choice.price.threads)
        cube = finer_cube(surface.cube)
        drawn = replace(self.usual, cube=cube, lattice=cube.to_lattice(places.mesh.positions), faces=places.mesh.faces)
        return SentMesh(scene=sent, surface=surface, source_face=rows, source_on_mesh=drawn, corner_places=places)

    def _fetched_tangents(self, tangent: np.ndarray, fetched: FetchedNormals, rows: SourceFaces) -> np.ndarray:
        """Return the scene's tangents, float32 [F, 3, 4], at the corners of another mesh. Each face keeps its own side of the
        image."""
        way = fetched.of(np.ascontiguousarray(tangent[self.usual.origin_face][..., :3]))
        return np.concatenate([way, tangent[rows][..., 3:]], axis=2)

    def distance(self, surface: Surface) -> dict:
        """Return the D1, D2 and Hausdorff distances of a surface from the source, as SurfaceDistance.report()."""
        mesh = Mesh(surface.cube.to_world(surface.lattice), surface.faces)
        return surface_distance(self.source, mesh, samples=DISTANCE_POINTS, threads=self.choice.price.threads).report()

    @property
    def points(self) -> NearestPoints:
        """The tree of nearest points of the source."""
        return self._fits.get("points", lambda: NearestPoints(self.source))
