"""The choice of the sent mesh: the source's at some number of position bits, or a smaller one that looks the same (encoder only).

Geometry is most of a scan's stream. A mesh of fewer faces, fitted to the source and put on the lattice as a whole, takes half the
bytes; its error in pictures adds to the error of coded colours. So the encoder takes the mesh with the least error plus bytes, a
byte counting as much as it buys in colours. The source's mesh is one of the candidates and stays unless another one is measured
to be better: an asset that somebody has simplified before gains nothing, and loses nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...core.threads import ahead, in_order
from ...geometry.areas import face_areas, sample_surface, used_vertices
from ...geometry.canonical import finer_cube
from ...geometry.mesh import Mesh, points_at
from ...geometry.nearest_points import NearestPoints
from ...geometry.surface import Surface, make_surface, place_mesh
from ...metrics.surface_distance import surface_distance
from ...options import FINEST_POSITIONS
from ...report import Step, no_step
from ..caches import Cache, NoCache
from ..decision import Decision
from ..faces import LatticeFaces, SentSurface, SourceFaces, SourceSurface, source_faces
from ..prepare.channel_weights import shown_of_radians
from ..supports.image_groups import brought_near
from ..values.unit_qp import has_few_colours
from .carried_uvs import SeamedMesh, carried_uvs
from .draco_bytes import draco_bytes
from .drawn_source import DrawnSource, FetchedNormals, draw_onto
from .joint_lattice import joint_lattice
from .picture_error import PictureComparison, PictureError
from .simplify import simplify
from .topology import seam_edges, sharp_edges
from .vertex_fit import MatchedLines, fit_vertices, own_fit

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...limits import Limits
    from ...scene.scene import Scene
    from ..price import Lagrangian
    from ..supports.texel_plan import SourcePlan
    from .simplify import Simplification
    from .vertex_fit import VertexFit

BYTES_A_BIT, LEAST_A_BIT = 3 / 8, 1 / 8  # of a vertex, for each bit of its three coordinates; in rows and planes
COARSEST_POSITIONS = 10  # bits: from here down small faces of dense scans fall together
MOST_A_BIT = 4.0  # times that a bit lessens an error at most; where layers lie close, which one is seen is a matter of luck
REFERENCE_BITS = 12  # bits of the lattice that the others' error is reckoned from
SHARES = tuple(2 ** (-number / 2) for number in range(11))  # of the source's faces; a point 25 % off costs 1 to 2 % of the bytes
SAME_UV = 1e-5  # differences from which on an edge is a seam
LARGE = 1 << 18  # faces: from here on fits and the tree of nearest points, 300 and 200 bytes a face, are computed when needed
FEWEST = 256  # faces: fewer take too few bytes to bother
TRIALS = {"fast": 3, "balanced": 5}  # by effort, that at the usual bits among them
EAGER = 0.85  # of the error that is reckoned: what is hoped for where nothing was looked at
# Of the error of colours: what the mesh may add, where colours take next to nothing and bytes would buy any error. The best
# points of three scans have 0.5 to 1.2 times as much.
MOST_MOVED = 1.2
MOST_LOST = 3e-3  # of the source's pixels: thin parts or holes that are gone or new, whatever they are worth
FIT_GAIN = 0.7  # of the distance before the vertices are fitted
SEVERAL = 0.8  # power of faces that bytes go with
SHARP, HARD = 60.0, 0.3  # degrees between faces, and difference of the file's normals, from which on an edge is kept as a line
FEW_TEXELS = 4096  # that are exact where they are of few colours; a grey terrain has few colours, and a million texels
FEW_POINTS, DISTANCE_POINTS = 5_000, 20_000  # of distances that are guessed with, and that the report has
# A mesh that is taken directly: trials, its distance from the source over the cube's side where the error that it may add is
# DIRECT_MOVED (as the search takes for a torus of a million faces at r03), and lattice steps along an edge.
DIRECT_TRIALS, DIRECT_AWAY, DIRECT_MOVED, STEPS_AN_EDGE = 3, 1.0e-4, 1.92, 32
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


@dataclass(frozen=True, kw_only=True)
class MeshRequest:
    """Fields of EncodeOptions that the choice of the mesh depends on."""

    position_bits: int
    position_bits_are_free: bool
    mesh_is_free: bool
    effort: str
    partition: str
    limits: Limits
    allow_empty: bool
    strict: bool


class _LatticeKey(NamedTuple):
    """Everything beside the scene that a lattice of the source, or pictures of it there, depend on."""

    kind: str
    position_bits: int


class _MeshesKey(NamedTuple):
    """Everything beside the scene that simplified meshes depend on."""

    position_bits: int
    carries: bool
    groups: bytes


class MeshChoice:
    """Choice of the mesh for one Scene. usual: its Surface at the usual position bits; mse: squared error of colours and maps,
    None if these take no bytes; cache: of meshes and their pictures, which depend on neither price nor mse."""

    def __init__(self, scene: Scene, usual: SourceSurface, price: Lagrangian, request: MeshRequest, mse: float | None,
                 cache: Cache) -> None:
        self.scene, self.usual, self.price, self.request, self.cache = scene, usual, price, request, cache
        self.most_moved = MOST_MOVED * (mse or 0.0)
        self.evidence: dict[str, Any] = {"reason": self._reason()}

    def _reason(self):
        """Return why the source's mesh is sent at the usual bits; "" if that needs a trial."""
        if not self.request.position_bits_are_free:
            return "position bits were requested"
        if self.price.max_error is not None:
            return "an error bound was requested"
        return "colours take no bytes, so there is no trade-off with geometry" if not self.most_moved else ""

    @property
    def is_direct(self) -> bool:
        """True if the mesh is chosen by direct() instead of the search: no image, and at least LARGE faces, as generators make
        them, whose smallest parts the search would keep at any price."""
        return not self.scene.textures and len(self.usual.faces) >= LARGE

    @cached_property
    def pictures(self) -> PictureComparison:
        """Pictures of the source, and of it on other surfaces."""
        return self.cache.get("pictures", lambda: PictureComparison(
            self.scene, self.usual, shown_of_radians(self.scene.weights), self.price.threads))

    def picture_error(self, surface: SourceSurface) -> PictureError:
        """Return the PictureError of the source on another lattice, the visible error of its rounded positions."""
        key = _LatticeKey("pictures", surface.cube.position_bits)
        return self.cache.get(key, lambda: self.pictures.of(surface, self.pictures.normals_of(surface)))

    def finer(self) -> SourceSurface:
        """Return the source at the position bits, from the usual ones on, that cost least."""
        if self.evidence["reason"] or self.is_direct:
            return self.usual
        usual, error, best = self.usual.cube.position_bits, self.picture_error(self.usual).error, self.usual
        if self.price.cost(LEAST_A_BIT * _count_used(self.usual), error / MOST_A_BIT) >= self.price.cost(0, error):
            return self.usual
        least, seen = self.price.cost(_geometry_bytes(best), error), usual
        for bits in range(usual + 1, FINEST_POSITIONS + 1):
            surface, hoped = self._on_lattice(bits), error / MOST_A_BIT ** (bits - seen)
            size = _geometry_bytes(surface)
            if self.price.cost(size, hoped) < least:
                own = self.picture_error(surface).error
                error, seen = min((error, seen), (own, bits), key=lambda known: known[0] * MOST_A_BIT ** known[1])
                cost = self.price.cost(size, own)
                best, least = (surface, cost) if cost < least else (best, least)
        if best is not self.usual:
            self.evidence |= {"reason": "the usual position bits change the picture", "position_bits": best.cube.position_bits}
        return best

    def _on_lattice(self, bits: int) -> SourceSurface:
        request = replace(self.request, position_bits=bits)
        return self.cache.get(_LatticeKey("lattice", bits), lambda: SourceSurface(make_surface(self.scene, request)))

    def smaller(self, surface: SourceSurface, group: np.ndarray, plans: list[SourcePlan],
                step: Step = no_step) -> Decision[SentMesh]:
        """Return the Decision on the sent mesh: the cheapest among the source's and simplified ones, at the usual position bits
        and fewer.

        surface: of finer(); group: int64 [F], a number for each of its faces: simplification keeps two groups apart; plans:
        TexelPlans, whose UVs go with the faces; flat colours, which are exact, keep every vertex in place.
        """
        usual = kept(self.scene, surface)
        if self._reason() or not self.request.mesh_is_free:
            return Decision(usual, {"reason": self._reason() or "the source's mesh was requested"})
        if any(_is_exact(plan) for plan in plans):
            return Decision(usual, {"reason": "flat colours over texels are exact, so every vertex stays in place"})
        if len(surface.faces) < FEWEST:
            return Decision(usual, self.evidence if surface is not self.usual else {"reason": "the mesh is too small to save "
                                                                                              "bytes"})
        meshes = self._meshes(surface, group, bool(plans))
        search = _Search(self, meshes, plans)
        if self.is_direct:
            return search.direct()
        best = search.best(step)
        sent = replace(meshes.trial(*best.place).sent, saved=search.at_usual.cost - best.cost)
        return Decision(sent, search.evidence(best, sent.surface))

    def _meshes(self, surface, group, carries):
        """Return the _Meshes of a surface and its groups, as smaller() has them. carries: whether they have UVs of their own:
        then only borders of groups count."""
        group = group * (int(surface.material.max(initial=0)) + 1) + surface.material
        borders = seam_edges(surface.faces, group)
        key = _MeshesKey(surface.cube.position_bits, carries, (borders if carries else group).tobytes())
        return self.cache.get(key, lambda: _Meshes(self, surface, group, borders, carries))


def _is_exact(plan):
    """Return whether the texels of a TexelPlan are so few, in flat colours, that they will be coded exactly."""
    return plan.group.palette or (plan.size[0] * plan.size[1] <= FEW_TEXELS and has_few_colours(plan.group.image.reshape(-1, 4)))


class _MeshTrial(NamedTuple):
    """A mesh that was tried. sent: None if no face has area; face: [G], face of the usual surface that each face comes from;
    moved: its PictureError."""

    sent: SentMesh | None
    face: LatticeFaces
    moved: PictureError


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    """The costs of a tried mesh. place: in shares and bits; faces: number; geometry: bytes; moved: PictureError; cost: at the
    price of a byte; refused: reason against it, or ""."""

    place: tuple[int, int]
    faces: int
    geometry: float
    moved: PictureError
    cost: float
    refused: str = ""

    @property
    def bits(self) -> int:
        """Bits of its positions."""
        return self.place[1]

    def row(self) -> dict:
        """Return the row of the report."""
        said = {"faces": self.faces, "position_bits": self.bits, "geometry_bytes": self.geometry, "cost": round(self.cost, 0),
                "mse": round(self.moved.mse, 3), "silhouette": round(self.moved.silhouette, 5), "lost": round(self.moved.lost, 6)}
        return said | ({"refused": self.refused} if self.refused else {})


class _Search:
    """Search for the cheapest of _Meshes, at the price of a byte. It predicts the cost of each number of faces and bits, and
    tries the most promising ones. plans: TexelPlans of the faces; usual: place in shares and bits of the source's mesh; tried: by
    place."""

    def __init__(self, choice: MeshChoice, meshes: _Meshes, plans: list[SourcePlan]) -> None:
        self.choice, self.meshes, self.price, self.plans = choice, meshes, choice.price, plans
        self.usual, self.tried = (0, meshes.usual.cube.position_bits), dict[tuple[int, int], _Candidate]()
        self._plan_of = np.full(len(meshes.usual.faces), -1)
        for number, plan in enumerate(plans):
            self._plan_of[plan.group.faces] = number

    @property
    def at_usual(self) -> _Candidate:
        """The source's mesh."""
        return self._candidate(*self.usual)

    def best(self, step: Step) -> _Candidate:
        """Return the cheapest candidate that is not refused. Each turn measures the candidate of least predicted cost; the
        search ends when that one has been measured before, or after TRIALS candidates."""
        self.meshes.begin()
        self._candidate(*self.usual)
        first = self._candidate(0, REFERENCE_BITS)
        reckoned = self._reckoned(first) if first.faces else {}
        most = TRIALS[self.choice.request.effort]
        while reckoned and len(self.tried) < most:
            step(len(self.tried), most)
            place = min(reckoned, key=lambda place: self._promise(reckoned, place))
            if place in self.tried:
                break
            self._candidate(*place)
        return self._least()

    def direct(self) -> Decision[SentMesh]:
        """Return the mesh of fewest faces whose distance from the source suits the error of colours, once pictures of the whole
        agree; else of twice the faces, DIRECT_TRIALS times; else the source's. Its lattice is as fine as its edges need. Small
        parts are left to the check of the stream: for the sake of a button a million faces would be sent."""
        meshes, side, away = self.meshes, self.meshes.usual.cube.side, self.meshes.distances
        most = DIRECT_AWAY * side * math.sqrt(self.choice.most_moved / DIRECT_MOVED)
        place = max((p for p in range(1, len(away)) if FIT_GAIN * away[p] <= most), default=0)
        while place > 0 and len(self.tried) < DIRECT_TRIALS:
            bits = math.ceil(math.log2(STEPS_AN_EDGE * side / max(meshes.edge_at(place), 1e-6 * side)))
            at = place, min(max(bits, COARSEST_POSITIONS), meshes.usual.cube.position_bits)
            candidate = self.tried[at] = self._measured(at)
            sent = meshes.trial(*at).sent
            if sent is not None and self._suits(candidate):
                evidence = {"reason": "the fewest faces that suit the error of colours", "position_bits": candidate.bits,
                            "faces": [len(meshes.usual.faces), candidate.faces],
                            "tried": [tried.row() for tried in self.tried.values()]}
                return Decision(sent, evidence)
            meshes.keep_only(at)
            place -= 2
        rows = [tried.row() for tried in self.tried.values()]
        return Decision(kept(self.choice.scene, meshes.usual), {"reason": "no mesh of fewer faces looks the same", "tried": rows})

    def _suits(self, candidate):
        """Return whether Draco can hold a mesh whose pictures, taken as a whole, change no more than they may."""
        is_alike = candidate.moved.mse <= self.choice.most_moved and candidate.moved.worst_lost <= MOST_LOST
        return is_alike and math.isfinite(candidate.geometry)

    def _least(self):
        allowed = (candidate for candidate in self.tried.values() if not candidate.refused)
        return min(allowed, key=lambda candidate: candidate.cost)

    def _candidate(self, place, bits):
        if (place, bits) not in self.tried:
            self.tried[place, bits] = self._measured((place, bits))
            self.meshes.keep_only(self._least().place)
        return self.tried[place, bits]

    def _measured(self, place):
        """Return the _Candidate at a place, refused if there is a reason against it."""
        sent, face, moved = self.meshes.trial(*place)
        if sent is None:
            return _Candidate(place=place, faces=0, geometry=0, moved=moved, cost=NOTHING, refused="no face is left")
        size = self._bytes(sent.surface, face, sent.scene.corner_uv[sent.surface.origin_face])
        refused = "" if place == self.usual else self._refused(moved) if math.isfinite(size) else "Draco cannot hold it"
        return _Candidate(place=place, faces=len(sent.surface.faces), geometry=size, moved=moved,
                          cost=self.price.cost(size, moved.error), refused=refused)

    def _bytes(self, surface: SentSurface, face: LatticeFaces, corner_uv: np.ndarray) -> float:
        """Return bytes of Draco for the faces over voxels, and for those of each plan and material with their UVs. face: face of
        the usual surface that each face comes from."""
        plan_of, bits, size = self._plan_of[face], surface.cube.position_bits, 0.0
        if (plan_of < 0).any():
            size += draco_bytes(surface.lattice, surface.faces[plan_of < 0], bits)
        unit = plan_of * (int(surface.material.max(initial=0)) + 1) + surface.material
        for faces in (np.flatnonzero(unit == number) for number in np.unique(unit[plan_of >= 0])):
            plan = self.plans[plan_of[faces[0]]]
            texels = brought_near(corner_uv[faces] * np.array(plan.size, np.float64), plan.size, plan.group.wrap)
            uv = np.floor(texels * (1 << plan.fraction_bits) + 0.5).astype(np.int64)
            size += draco_bytes(surface.lattice, surface.faces[faces], bits, uv)
        return size

    def _refused(self, moved):
        if not moved.mse <= self.choice.most_moved:
            return "the picture changes more than coding changes it"
        if not moved.worst_part <= max(self.choice.most_moved, self.price.coding_mse):
            return "a small part changes more than the rate promises"
        return "thin parts disappear" if moved.worst_lost > MOST_LOST else ""

    def _reckoned(self, here):
        """Return {place: (bytes, squared error)} predicted from one trial, here, and the distances of meshes that are not
        fitted."""
        usual, out, vertices = self.meshes.usual, {}, _count_used(self.meshes.usual)
        for place, away in enumerate(self.meshes.aways):
            share = SHARES[place]
            for bits in range(COARSEST_POSITIONS, usual.cube.position_bits + 1):
                size = here.geometry * share**SEVERAL + BYTES_A_BIT * vertices * share * (bits - REFERENCE_BITS)
                out[place, bits] = size, here.moved.error * np.hypot(away, 2.0 ** (REFERENCE_BITS - bits))
        return out

    def _promise(self, reckoned, place):
        """Return the cost of a candidate: measured, or predicted and then corrected by the measured candidates of as many faces,
        or else by all with fewer faces than the source."""
        if place in self.tried:
            return np.inf if self.tried[place].refused else self.tried[place].cost
        thin = (at for at, candidate in self.tried.items() if candidate.refused and candidate.moved.worst_lost > MOST_LOST)
        if any(place[0] >= at[0] and (at[0] > 0 or place[1] <= at[1]) for at in thin):
            return np.inf  # fewer faces, or fewer bits of all faces, lose at least the thin parts that another mesh does
        known = [at for at in self.tried if at[0] == place[0]] or [at for at in self.tried if at[0]] or [(0, REFERENCE_BITS)]
        got = np.array([(self.tried[at].geometry, self.tried[at].moved.error) for at in known])
        was = np.maximum([reckoned[at] for at in known], 1e-9)
        size, error = np.array(reckoned[place]) * (got / was).mean(axis=0) * (1.0, EAGER)
        return self.price.cost(size, error) if error <= self.choice.most_moved else np.inf

    def evidence(self, best: _Candidate, surface: Surface) -> dict:
        """Return the entry of the report on the tried meshes and the best one. surface: of the best mesh."""
        evidence = {"reason": "lowest cost in bytes and picture error", "faces": [len(self.meshes.usual.faces), best.faces],
                "position_bits": best.bits, "tried": [candidate.row() for candidate in self.tried.values()]}
        return evidence if best is self.at_usual else evidence | {"distance": self.meshes.distance(surface)}


class _Fit(NamedTuple):
    """fit: VertexFit; face: [G], face of the usual surface that each of its faces comes from; uvs: float64 [G, 3, 2] by names of
    map_uv, "" for corner_uv; empty if UVs are not carried."""

    fit: VertexFit
    face: LatticeFaces
    uvs: dict[str, np.ndarray]


class _Meshes:
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
        self._trials: dict[tuple[int, int], _MeshTrial] = {}
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

    def trial(self, place: int, bits: int) -> _MeshTrial:
        """Return the mesh with a share of the faces at some position bits. place: index of the share in SHARES."""
        if (place, bits) not in self._trials:
            self._trials[place, bits] = self._new_trial(place, bits)
        return self._trials[place, bits]

    def keep_only(self, place: tuple[int, int]) -> None:
        """Drop all trials but that at a place, (index into SHARES, bits). They are computed again when needed, except their
        pictures."""
        self._trials = {place: self.trial(*place)}

    def _new_trial(self, place: int, bits: int) -> _MeshTrial:
        if (place, bits) == (0, self.usual.cube.position_bits):
            moved, face = self.choice.picture_error(self.usual), LatticeFaces(np.arange(len(self.usual.faces)))
            return _MeshTrial(kept(self.scene, self.usual), face, moved)
        fit = self._fits.get(place, lambda: self._new_fit(place))
        cube = replace(self.usual.cube, position_bits=bits)
        surface = place_mesh(cube, joint_lattice(fit.fit, cube), fit.fit.mesh.faces, self.usual.material[fit.face])
        if not face_areas(surface.lattice, surface.faces).any():
            return _MeshTrial(None, fit.face, PictureError(NOTHING, 1.0, 1.0))
        face, there = LatticeFaces(fit.face[surface.origin_face]), {name: uv[surface.origin_face] for name, uv in fit.uvs.items()}
        del fit  # pictures of a large mesh need its room
        mesh, threads = Mesh(surface.cube.to_world(surface.lattice), surface.faces), self.choice.price.threads
        fetched = FetchedNormals(self.source, lambda: self._points, mesh, threads)
        sent = self._sent(surface, face, place > 0, there, fetched)
        return _MeshTrial(sent, face, self._moved.get((place, bits), lambda: self._moved_by(sent, fetched)))

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
        _ = self.begin(), self._points, self.choice.pictures.ready()  # what direct() needs, beside the simplification's thread
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
        nearest = self._points

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
    def _points(self) -> NearestPoints:
        return self._fits.get("points", lambda: NearestPoints(self.source))


def _count_used(surface):
    """Return the number of vertices that faces of a Surface have."""
    return len(used_vertices(surface.faces, len(surface.lattice))[0])


def _geometry_bytes(surface):
    return draco_bytes(surface.lattice, surface.faces, surface.cube.position_bits)
