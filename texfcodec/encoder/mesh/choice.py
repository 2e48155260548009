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

from ...geometry.areas import used_vertices
from ...geometry.surface import Surface, make_surface
from ...options import FINEST_POSITIONS
from ...report import Step, no_step
from ..caches import Cache
from ..decision import Decision
from ..faces import LatticeFaces, SentSurface, SourceSurface
from ..prepare.channel_weights import shown_of_radians
from ..supports.image_groups import brought_near
from ..values.unit_qp import has_few_colours
from .candidates import FEWEST, FIT_GAIN, LARGE, NOTHING, REFERENCE_BITS, SHARES, CandidateMeshes, SentMesh, kept
from .draco_bytes import draco_bytes
from .picture_error import PictureComparison, PictureError
from .topology import seam_edges

if TYPE_CHECKING:
    from ...limits import Limits
    from ...scene.scene import Scene
    from ..price import Lagrangian
    from ..supports.texel_plan import SourcePlan

BYTES_A_BIT, LEAST_A_BIT = 3 / 8, 1 / 8  # of a vertex, for each bit of its three coordinates; in rows and planes
COARSEST_POSITIONS = 10  # bits: from here down small faces of dense scans fall together
MOST_A_BIT = 4.0  # times that a bit lessens an error at most; where layers lie close, which one is seen is a matter of luck
TRIALS = {"fast": 3, "balanced": 5}  # by effort, that at the usual bits among them
EAGER = 0.85  # of the error that is reckoned: what is hoped for where nothing was looked at
# Of the error of colours: what the mesh may add, where colours take next to nothing and bytes would buy any error. The best
# points of three scans have 0.5 to 1.2 times as much.
MOST_MOVED = 1.2
MOST_LOST = 3e-3  # of the source's pixels: thin parts or holes that are gone or new, whatever they are worth
SEVERAL = 0.8  # power of faces that bytes go with
FEW_TEXELS = 4096  # that are exact where they are of few colours; a grey terrain has few colours, and a million texels
# A mesh that is taken directly: trials, its distance from the source over the cube's side where the error that it may add is
# DIRECT_MOVED (as the search takes for a torus of a million faces at r03), and lattice steps along an edge.
DIRECT_TRIALS, DIRECT_AWAY, DIRECT_MOVED, STEPS_AN_EDGE = 3, 1.0e-4, 1.92, 32


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
        """Return the CandidateMeshes of a surface and its groups, as smaller() has them. carries: whether they have UVs of their
        own: then only borders of groups count."""
        group = group * (int(surface.material.max(initial=0)) + 1) + surface.material
        borders = seam_edges(surface.faces, group)
        key = _MeshesKey(surface.cube.position_bits, carries, (borders if carries else group).tobytes())
        return self.cache.get(key, lambda: CandidateMeshes(self, surface, group, borders, carries))


def _is_exact(plan):
    """Return whether the texels of a TexelPlan are so few, in flat colours, that they will be coded exactly."""
    return plan.group.palette or (plan.size[0] * plan.size[1] <= FEW_TEXELS and has_few_colours(plan.group.image.reshape(-1, 4)))


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
    """Search for the cheapest of CandidateMeshes, at the price of a byte. It predicts the cost of each number of faces and bits,
    and tries the most promising ones. plans: TexelPlans of the faces; usual: place in shares and bits of the source's mesh;
    tried: by place."""

    def __init__(self, choice: MeshChoice, meshes: CandidateMeshes, plans: list[SourcePlan]) -> None:
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
        meshes, side = self.meshes, self.meshes.usual.cube.side
        meshes.begin()  # one thread, beside which the tree of points and the source's pictures are computed
        self.choice.pictures.ready()
        _, away = meshes.points, meshes.distances
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


def _count_used(surface):
    """Return the number of vertices that faces of a Surface have."""
    return len(used_vertices(surface.faces, len(surface.lattice))[0])


def _geometry_bytes(surface):
    return draco_bytes(surface.lattice, surface.faces, surface.cube.position_bits)
