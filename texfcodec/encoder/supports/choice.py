"""Choice of the parts of the surface that become fields over texels or over voxels, of their resolution, and of the precision of
UVs, by the least bytes and error at the price of the rate (encoder only; price.py).

Every image may go over its texels, at its own size or half of it, or over voxels of any K of a ladder. Neither the candidates nor
the price depend on choices elsewhere, so that a finer rate looks no worse.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...core.threads import in_order
from ...errors import LimitError
from ...geometry.draco import split_corners
from ...options import MOST_RESOLUTION
from ...report import Step, no_step
from ...scene.channels import BASE_COLOUR
from ..decision import Decision
from ..mesh.draco_bytes import draco_bytes
from ..prepare.uniform_colour import NOTHING_TO_PROBE, is_uniform
from ..values.unit_qp import has_few_colours
from .image_groups import image_groups
from .probe import TEXEL_CELL, VOXEL_CELL, TrialCoding
from .reference_density import REFERENCE_K, reference_values, texels_shown
from .texel_plan import SourcePlan, TexelPlan, covered_texels, most_fraction_bits, rounding_errors
from .trial import Trials

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Scene
    from ..caches import Caches
    from ..faces import LatticeFaces, SourceSurface
    from ..price import Lagrangian
    from ..stages import Prepared
    from .image_groups import ImageGroup
    from .probe import SampleRegion

LEAST_SIDE, DETAILED = 256, 2048  # sides from which on half of an image is tried, and beyond which a quarter is
LADDER = (64, 128, 256, 512, 1024, 2048)  # values of K, up to the rate's: each is looked at in the same cubes of space
VOXEL_COST = 0.95  # of its texels, from which an image goes over voxels: in a near tie a file keeps what it has
MOST_SAVED = 0.5  # of the geometry's bytes: what a smaller mesh is hoped to save, with what its error costs
HALF_COST = 0.9  # of the whole image's, from which half of it is taken: probes of 24 places differ by as much
FINER_COST = 0.97  # of the next K's: a finer one takes four times as long
LEAST_CELL = 3  # log2 of such a cube's side, in voxels
CLEAR = 1.4  # times the cost over texels: voxels that cost more at the first K need not be tried at others; the best K costs
# at least 0.72 of it, on 30 images at four QPs where texels do not cost half of either
COARSE = 0.7  # texels along an edge of voxels of REFERENCE_K under which no smaller image is tried
COARSEST_K = 128  # for one colour
SQUARE_BITS = 4  # of UVs, at least, where texels are squares: their sides move by a 32nd of a texel at most
FINER_K, FINER_BITS = 1.5, 2  # times K, and bits of UVs, for what came out too coarse
MOST_ROUNDED = 0.25  # of the error of coding, that rounding UVs may add where the rate's promise is kept
UV_BYTES_A_BIT = 2 / 8  # of a corner, for each bit of its two coordinates
LOSSLESS_FRACTION = 4
UNIT_BYTES = 60  # of a further field
MOST_VOXELS = 1 << 24  # that a K of the choice may have, a minute of work; thousands of surfaces that overlap have more
MOST_ROWS = 1 << 27  # of texels that the faces of an image go over, a few seconds; more than a million faces have elsewhere


@dataclass(frozen=True, kw_only=True)
class SupportRequest:
    """Fields of EncodeOptions that the choice of supports depends on, and finer: materials that were too coarse in an earlier
    encode."""

    support: str
    texel_size: int | None
    rate_is_free: bool
    mesh_is_free: bool
    is_joint: bool
    finer: frozenset[int] = frozenset()


@dataclass(frozen=True, kw_only=True)
class Supports:
    """A choice of supports: the images that go over texels, and K of the rest over voxels. plans: TexelPlans; resolution: K of
    the surface over voxels; qp_offset: of its values to the rate's QP; values: as of Lagrangian; mse: squared error of colours
    and maps, None if these take no bytes; extra_bytes: cost above that of the best supports on the source's mesh; bytes: of all
    supports that were tried, their geometry included; attributes: bytes that colours and maps are likely to take, 0 if nothing
    was tried; colour_mse: squared error of colours and alpha alone, without a weight in light, None if mse is."""

    plans: list[SourcePlan]
    resolution: int
    qp_offset: int
    values: float
    mse: float | None = None
    extra_bytes: float = 0.0
    bytes: float = 0.0
    attributes: float = 0.0
    colour_mse: float | None = None


class _ImageKey(NamedTuple):
    """Everything beside the scene that the trials of an image depend on."""

    number: int
    coder: tuple
    qp: int
    has_promise: bool
    finer: bool


@dataclass(frozen=True)
class _Candidate:
    """An image group and its costs over texels and, if they were tried, voxels. finer: whether it was too coarse in an earlier
    encode; voxels: the TrialCoding at K resolution; extra_bytes: additional cost over voxels, on the source's mesh; goes: whether
    it was chosen; evidence: for the report."""

    plan: SourcePlan
    texels: TrialCoding
    finer: bool = False
    voxels: TrialCoding | None = None
    resolution: int = 0
    extra_bytes: float = 0.0
    goes: bool = False
    evidence: dict = field(default_factory=dict)

    def decided(self, over: str, reason: str, **more: Any) -> _Candidate:
        """Return the candidate with its choice. over: "texels" or "voxels"; reason, more: entries for the report."""
        evidence = {**self.evidence, "texels": self.texels.evidence(), **more, "chosen": over, "reason": reason}
        return replace(self, goes=over == "texels", evidence=evidence)

    def over_voxels(self) -> _Candidate:
        """Return the candidate over voxels, for the sake of a smaller mesh."""
        reason = "voxels cost less with the smaller mesh that they allow" if self.goes else self.evidence["reason"]
        return replace(self, goes=False, evidence={**self.evidence, "chosen": "voxels", "reason": reason})


def choose_supports(prepared: Prepared, price: Lagrangian, request: SupportRequest, caches: Caches,
                    step: Step = no_step) -> tuple[Decision[Supports], ...]:
    """Return the candidate supports of a prepared scene: the parts of the surface that go over texels or voxels, and the
    resolutions.

    Parameters
    ----------
    price : Lagrangian
        Its values are replaced by those of the scene.
    caches : Caches
        Keeps trials of images, and sample regions.
    step : function
        Of Report.stage().

    Returns
    -------
    tuple of Decision of Supports
        First those of least cost on the source's mesh. Then all images over voxels, if the simplified mesh that this allows may
        cost less.

    Raises
    ------
    InputError, LimitError
        The mesh or its texels are over a limit, and voxels are not an alternative.
    """
    scene, surface, colours = prepared.scene, prepared.surface, prepared.colours
    evidence: dict[str, Any] = {"asked": request.support, "groups": []}
    reason = reason_for_voxels(request)
    if not reason and request.support != "texels" and is_uniform(scene.materials, colours, surface.material):
        reason, price = NOTHING_TO_PROBE, replace(price, resolution=_coarsest(price, request))
    may_be_texels = not reason and request.support != "voxels"
    groups = caches.images.get("groups", lambda: image_groups(scene, surface)) if may_be_texels else []
    rest = ~np.isin(np.arange(len(surface.faces)), np.concatenate([[-1], *(group.faces for group in groups)]))
    others = rest & (not is_uniform(scene.materials, colours, surface.material[rest]))
    price = replace(price, values=reference_values(surface, groups, others))
    if reason:
        supports = Supports(plans=[], resolution=price.resolution, qp_offset=0, values=price.values)
        return (Decision(supports, evidence | {"reason": reason}),)
    return _Choice(scene, surface, price, request, caches).candidates(groups, colours, evidence, step)


def reason_for_voxels(request: SupportRequest) -> str:
    """Return why only voxels are possible; "" if texels are possible."""
    if request.is_joint:
        return "the codec does not support texels"
    if request.support == "texels" or request.rate_is_free:
        return ""
    return "requested" if request.support == "voxels" else "K or an error bound was requested, which implies voxels"


@dataclass(frozen=True)
class _Choice:
    """The inputs of every step of the choice."""

    scene: Scene
    surface: SourceSurface
    price: Lagrangian
    request: SupportRequest
    caches: Caches

    @property
    def trials(self) -> Trials:
        """Trial codings at the prices of the choice."""
        return Trials(self.scene, self.surface, self.price, self.caches.regions)

    def candidates(self, groups: list[ImageGroup[LatticeFaces]], colours: np.ndarray, evidence: dict, step: Step) \
            -> tuple[Decision[Supports], ...]:
        """Return the candidate supports as choose_supports() does, chosen for each image by itself, then K and position bits for
        all together. The promise of the rate is dropped if it would take more bytes than the source's files. groups: the images;
        colours: of material_colours(); evidence: entries that the report begins with."""
        candidates = self._all(groups, colours, evidence, step)
        most = sum(self.scene.files.values())
        if not self.price.has_promise or not most or candidates[0].value.bytes <= most:
            return candidates
        return replace(self, price=replace(self.price, has_promise=False))._all(groups, colours, evidence, step)

    def _all(self, groups, colours, evidence, step):
        results, total = [], len(groups) + 2  # the last two are the choices of all together
        with closing(in_order(self._of_group, list(enumerate(groups)), self.price.threads)) as outcomes:
            for outcome in outcomes:
                results.append(outcome)
                step(len(results), total)
        decided = [outcome for outcome in results if isinstance(outcome, _Candidate)]
        rows = [outcome for outcome in results if not isinstance(outcome, _Candidate)]
        step(total - 1, total)
        best = self._supports(decided, rows, colours, evidence)
        probed = [candidate for candidate in decided if candidate.voxels]
        extra, fixed = sum(max(c.extra_bytes, 0.0) for c in probed), sum(c.voxels.fixed for c in probed if c.voxels)
        is_open = best.value.plans and len(probed) == len(groups) and self.request.mesh_is_free
        if not is_open or extra >= MOST_SAVED * fixed:
            return (best,)
        all_voxels = self._supports([candidate.over_voxels() for candidate in probed], [], colours, evidence)
        return best, replace(all_voxels, value=replace(all_voxels.value, extra_bytes=extra))

    def _of_group(self, numbered):
        """Return the decided _Candidate of an image group; a row of the report instead if a limit leaves voxels alone."""
        number, group = numbered
        row = {"faces": len(group.faces), "materials": np.unique(self.surface.material[group.faces]).tolist(),
               "image": list(group.size)}

        def decided():
            region = self.trials.region(group.faces, texels_shown(group))
            return self._decided(self._candidate(group, row, region), region)

        key = _ImageKey(number, self.price.planes.signature, self.price.qp, self.price.has_promise, self._is_finer(row))
        try:
            return self.caches.images.get(key, decided)
        except LimitError as error:
            if self.request.support == "texels":
                raise
            return {**row, "chosen": "voxels", "reason": str(error)}

    def _supports(self, decided, rows, colours, evidence):
        """Return the Decision on Supports of _Candidates. rows: rows of the report of other images."""
        resolution, rest, voxels = self._resolution(decided, colours)
        plans, offset = [candidate.plan for candidate in decided if candidate.goes], rest.qp_offset if rest else 0
        groups = rows + [candidate.evidence for candidate in decided]
        probes = [candidate.texels for candidate in decided if candidate.goes]
        probes += [rest] if rest else [candidate.voxels for candidate in decided if candidate.voxels and not candidate.goes]
        supports = Supports(plans=plans, resolution=resolution, qp_offset=offset, values=self.price.values,
                            mse=self._mse(probes), bytes=sum(p.bytes for p in probes),
                            attributes=sum(probe.attributes for probe in probes), colour_mse=self._colour_mse(probes))
        return Decision(supports, evidence | {"groups": groups, **voxels})

    def _is_finer(self, row):
        """Return whether a material of an image was too coarse in an earlier encode."""
        return bool(self.request.finer & set(row["materials"]))

    def _candidate(self, group: ImageGroup[LatticeFaces], row: dict, region: SampleRegion | None) -> _Candidate:
        """Return the _Candidate of an image group, at the size and with the bits of UVs that cost the least. row: of the report,
        before any trial. Raises LimitError."""
        plan = _plan(group, self._coded_size(group))
        keys = self._keys(plan)
        finer = self._is_finer(row)
        if region is None or group.palette or self.price.max_error is not None:  # nothing has to be probed
            maps = {name: TrialCoding(len(keys), 8.0, 0.0) for name in group.maps}
            plan, texels = _with_bits(plan, LOSSLESS_FRACTION), TrialCoding(len(keys), 24.0, 0.0, maps=maps)
        else:
            points = len(split_corners(self.surface.faces[group.faces], plan.corner_uv())[0])
            plan, texels = self._best_size(plan, keys, region, group.nearest or finer)
            plan, texels = self._best_bits(plan, texels, region, UV_BYTES_A_BIT * points, finer)
        plan = replace(plan, qp_offset=min(texels.qp_offset, 0) if finer else texels.qp_offset)
        return _Candidate(plan, texels, finer, evidence={**row, "size": list(plan.size)})

    def _decided(self, candidate, region):
        """Return a candidate with the choice of texels if they cost less."""
        group = candidate.plan.group
        if self.request.support == "texels":
            return replace(candidate, finer=False).decided("texels", "requested")
        if group.nearest and has_few_colours(group.image.reshape(-1, 4)):
            return replace(candidate, finer=False).decided("texels", "the image has few colours and a NEAREST sampler")
        if candidate.finer:
            return candidate.decided("texels", "the first result was worse than the rate promises")
        if region is None:
            return candidate.decided("voxels", "the surface has no area")
        faces, bits = self.surface.faces[group.faces], self.surface.cube.position_bits
        textured = draco_bytes(self.surface.lattice, faces, bits, candidate.plan.corner_uv())
        if not math.isfinite(textured):
            return candidate.decided("voxels", "Draco cannot hold its UVs")
        candidate = replace(candidate, texels=replace(candidate.texels, fixed=textured + UNIT_BYTES))
        texels = self._cost(candidate.texels, region)
        resolution, tried = self._best_voxels(region, draco_bytes(self.surface.lattice, faces, bits), CLEAR * texels)
        candidate = replace(candidate, voxels=tried[resolution], resolution=resolution)
        voxels = self._cost(candidate.voxels, region)
        candidate = replace(candidate, extra_bytes=self._extra_bytes(candidate.voxels, candidate.texels, region, VOXEL_COST))
        row = self._rows(tried, resolution, region)[-1]
        reason = f"texels cost {round(texels)} bytes and voxels {round(voxels)}, errors included"
        return candidate.decided("voxels" if candidate.extra_bytes < 0 else "texels", reason, voxels=row)

    def _cost(self, probe, region):
        """Return the cost of a TrialCoding of a region, in bytes."""
        return self.price.cost(probe.bytes, probe.error, region.weight)

    def _extra_bytes(self, trial, other, region, share):
        """Return the additional bytes that a TrialCoding of a region costs against a share of another, in light or in flat
        colours, whichever is more: if the two disagree, the support of the file stays. Infinite if the other alone keeps the
        promise of the rate."""
        if self.trials.keeps_promise(trial, region) != self.trials.keeps_promise(other, region):
            return -math.inf if self.trials.keeps_promise(trial, region) else math.inf
        pairs = (trial, other), (trial.flat, other.flat)
        return max(self._cost(a, region) - share * self._cost(b, region) for a, b in pairs)

    def _best_size(self, plan, keys, region, is_fixed):
        """Return (plan, TrialCoding) of the plan's size, or of half of it if that costs clearly less; of a large image a quarter
        too."""
        probe = self.trials.texels(region, plan, keys, TEXEL_CELL)
        if is_fixed or self.request.texel_size is not None or region.texels_per_edge(REFERENCE_K) < COARSE:
            return plan, probe
        for halved in range(1, 3 if max(plan.size) > DETAILED else 2):
            width, height = plan.size
            if min(plan.size) < LEAST_SIDE or (width | height) & 1:
                break
            half = _plan(plan.group, (width // 2, height // 2))
            most = HALF_COST * self._cost(probe, region)
            tried = self.trials.texels(region, half, self._keys(half), TEXEL_CELL - halved, most)  # in the same places
            if tried is None or self._extra_bytes(tried, probe, region, HALF_COST) >= 0:
                break
            plan, probe = half, tried
        return plan, probe

    def _best_bits(self, plan, probe, region, uv_bytes, finer):
        """Return (plan, TrialCoding) with the bits of UVs below the texel that cost the least. uv_bytes: of each number of
        bits."""
        errors = rounding_errors(region, plan)
        bits = int(np.argmin([self.price.cost(uv_bytes * k, error, region.weight) for k, error in enumerate(errors)]))
        if self.trials.keeps_promise(probe, region):
            bits = max(bits, next((k for k, error in enumerate(errors) if error <= MOST_ROUNDED * probe.mse), bits))
        plan = _with_bits(plan, max(bits, SQUARE_BITS) if plan.group.nearest else bits + FINER_BITS * finer)
        return plan, replace(probe, mse=probe.mse + errors[plan.fraction_bits])

    def _keys(self, plan):
        """Return keys of the texels that a plan covers. Raises LimitError; below the limit on samples already if voxels are an
        alternative."""
        uv = plan.corner_uv().reshape(-1, 2)
        corners, most = np.arange(len(uv)).reshape(-1, 3), self.price.limits.samples
        if self.request.support == "auto":
            most = min(most or MOST_ROWS, MOST_ROWS)
        return covered_texels(plan, uv, corners, most, self.price.limits.voxels)

    def _coded_size(self, group):
        longest, size = max(group.size), self.request.texel_size
        wanted = longest if size is None or group.palette else min(size, longest)
        return tuple(max(1, round(side * wanted / longest)) for side in group.size)

    def _mse(self, probes):
        """Return Supports.mse, of the TrialCodings of the chosen candidates."""
        attributes = sum(probe.attributes for probe in probes)
        if not attributes:
            return None
        return max(sum(probe.attributes * probe.mse for probe in probes) / attributes, self.price.coding_mse / 4)

    def _colour_mse(self, probes):
        """Return Supports.colour_mse, of the TrialCodings of the chosen candidates."""
        attributes = sum(probe.attributes for probe in probes)
        weight = self.scene.weights.get(BASE_COLOUR.name, BASE_COLOUR.weight)
        return sum(probe.attributes * probe.mse for probe in probes) / attributes / weight if attributes and weight else None

    def _best_voxels(self, region, fixed, most=np.inf):
        """Return (K, TrialCodings by K). The search goes down or up the ladder, from the K at which voxels have the rate's QP, as
        long as they cost less. fixed: bytes of the geometry; most: cost from which on no other K is tried."""
        most_k = min(self.price.resolution, self._most_resolution(region))
        ladder, tried = [k for k in LADDER if k <= most_k] or LADDER[:1], {}
        first = best = min(range(len(ladder)), key=lambda i: abs(self.price.qp_offset(region.voxels(ladder[i]), region.weight)))

        def cost(place):
            k = ladder[place]
            if k not in tried:
                tried[k] = replace(self.trials.voxels(region, k, max(VOXEL_CELL + place - first, LEAST_CELL)), fixed=fixed)
            return self._cost(tried[k], region)

        for step in (-1, 1) if cost(first) <= most else ():
            while 0 <= best + step < len(ladder) and cost(best + step) < (FINER_COST if step > 0 else 1.0) * cost(best):
                best += step
        return ladder[best], tried

    def _most_resolution(self, region):
        """Return the finest K with no more than MOST_VOXELS of a region, roughly; at least LADDER's coarsest. A surface without
        area has no region, and sets no bound."""
        if region is None:
            return MOST_RESOLUTION
        most = min(self.price.limits.voxels or MOST_VOXELS, MOST_VOXELS)
        return max(int(REFERENCE_K * (most / max(region.voxels(REFERENCE_K), 1)) ** 0.5), LADDER[0])

    def _rows(self, tried, chosen, region):
        """Return the rows of the report on TrialCodings by K, the chosen one last."""
        return [{"resolution": k, **tried[k].evidence(), "cost": round(self._cost(tried[k], region))}
                for k in sorted(tried, key=lambda k: (k == chosen, k))]

    def _resolution(self, decided, colours):
        """Return (K of the remaining surface over voxels, its TrialCoding, None if there was no trial, evidence). decided:
        _Candidates."""
        usual, free = self.price.resolution, self.request.rate_is_free
        chosen = [candidate.plan.group.faces for candidate in decided if candidate.goes]
        rest = ~np.isin(np.arange(len(self.surface.faces)), np.concatenate([[-1], *chosen]))
        if free and rest.any() and is_uniform(self.scene.materials, colours, self.surface.material[rest]):
            return _coarsest(self.price, self.request), None, {"reason": "the surface over voxels has one colour, so there is "
                                                                      "nothing to choose"}
        if self.request.finer & set(np.unique(self.surface.material[rest]).tolist()):
            region = self.trials.region(np.flatnonzero(rest))
            return min(round(FINER_K * usual), MOST_RESOLUTION, self._most_resolution(region)), None, {}
        staying = [candidate for candidate in decided if not candidate.goes]
        alone = [candidate for candidate in staying if len(candidate.plan.group.faces) == rest.sum() and candidate.voxels]
        if alone:
            return alone[0].resolution, alone[0].voxels, {}
        others = [candidate.plan.group for candidate in staying]
        texels = sum(map(texels_shown, others)) if sum(len(group.faces) for group in others) == rest.sum() else np.inf
        region = self.trials.region(np.flatnonzero(rest), texels) if rest.any() and free else None
        if region is None:
            return usual, None, {}
        resolution, tried = self._best_voxels(region, 0)
        return resolution, tried[resolution], {"voxels": self._rows(tried, resolution, region)}


def _plan(group, size):
    return TexelPlan(group, size, min(2, most_fraction_bits(size, group)))


def _with_bits(plan, bits):
    return replace(plan, fraction_bits=1 if plan.group.palette else min(bits, most_fraction_bits(plan.size, plan.group)))


def _coarsest(price, request):
    """Return K for a single colour."""
    return min(price.resolution, COARSEST_K) if request.rate_is_free else price.resolution


def moved_plans(plans: list[SourcePlan], scene: Scene, surface: SourceSurface) -> list[SourcePlan]:
    """Return the TexelPlans for another surface, that of the same scene on another lattice or of a simplified one. Their image
    groups may have other faces there; a plan whose group is missing there is dropped. scene, surface: the other ones."""
    out, groups = [], image_groups(scene, surface) if plans else []
    for plan in plans:
        same = next((g for g in groups if g.key == plan.group.key), None)
        if same is not None:
            size = same.size if same.palette else plan.size
            bits = min(plan.fraction_bits, most_fraction_bits(size, same))
            out.append(replace(plan, group=same, size=size, fraction_bits=bits))
    return out


def without_faces(surface: Surface, gone: np.ndarray) -> Surface:
    """Return a surface without some of its faces. gone: bool [F]."""
    if not gone.any():
        return surface
    return replace(surface, faces=surface.faces[~gone], origin_face=surface.origin_face[~gone], material=surface.material[~gone])
