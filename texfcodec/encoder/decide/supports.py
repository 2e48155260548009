"""Which parts of the surface become fields over texels, which over voxels, how fine both are, and how exact UVs: by the least
bytes and error at the price of the rate (encoder only; rd.py).

Every image may go over its texels, at its own size or half of it, or over voxels of any K of a ladder. Neither what is tried
nor the price depends on what is taken elsewhere, so that a finer rate looks no worse.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...codecs import codec_of
from ...core.threads import in_order
from ...errors import LimitError
from ...geometry.draco import split_corners
from ...options import MOST_RESOLUTION
from ...report import Step, no_step
from ...scene.channels import BASE_COLOUR
from ..decision import Decision
from ..estimates.draco_bytes import draco_bytes
from ..estimates.probe import TEXEL_CELL, VOXEL_CELL, Probe
from ..estimates.usual_values import USUAL_K, texels_shown, usual_values
from ..texel_field import TexelPlan, covered_texels, most_fraction_bits
from .one_colour import NOTHING_TO_PROBE, is_plain
from .spending import has_few_colours
from .texel_images import image_groups

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...options import EncodeOptions
    from ...scene.scene import Scene
    from ..estimates.probe import Patch
    from ..rd import RateDistortion
    from .texel_images import ImageGroup

LEAST_SIDE, DETAILED = 256, 2048  # sides from which on half of an image is tried, and beyond which a quarter is
LADDER = (64, 128, 256, 512, 1024, 2048)  # values of K, up to the rate's: each is looked at in the same cubes of space
VOXEL_COST = 0.95  # of its texels, from which an image goes over voxels: in a near tie a file keeps what it has
MOST_SAVED = 0.5  # of the geometry's bytes: what a smaller mesh is hoped to save, with what its error costs
HALF_COST = 0.9  # of the whole image's, from which half of it is taken: probes of 24 places differ by as much
FINER_COST = 0.97  # of the next K's: a finer one takes four times as long
LEAST_CELL = 3  # log2 of such a cube's side, in voxels
CLEAR = 1.4  # times the cost over texels: voxels that cost more at the first K need not be tried at others; the best K costs
# at least 0.72 of it, on 30 images at four QPs where texels do not cost half of either
COARSE = 0.7  # texels along an edge of voxels of USUAL_K under which no smaller image is tried
COARSEST_K = 128  # for one colour
SQUARE_BITS = 4  # of UVs, at least, where texels are squares: their sides move by a 32nd of a texel at most
FINER_K, FINER_BITS = 1.5, 2  # times K, and bits of UVs, for what came out too coarse
MOST_ROUNDED = 0.25  # of the error of coding, that rounding UVs may add where the rate's promise is kept
UV_BYTES_A_BIT = 2 / 8  # of a corner, for each bit of its two coordinates
LOSSLESS_FRACTION = 4
UNIT_BYTES = 60  # of a further field
MOST_VOXELS = 1 << 24  # that a K of the choice may have, a minute of work; thousands of surfaces that overlap have more
MOST_ROWS = 1 << 27  # of texels that the faces of an image go over, a few seconds; more than a million faces have elsewhere


@dataclass(frozen=True)
class Supports:
    """plans: TexelPlans; resolution: K of what is over voxels; qp_offset: of its values to the rate's QP; values: as of
    RateDistortion; mse: squared error of colours and maps, None where these take no bytes; instead: all over voxels, where the
    mesh that may be sent then may make that cost less; behind: bytes that it costs more without; bytes: of all that was probed,
    its geometry included; attributes: bytes that colours and maps are likely to take, 0 where nothing was probed; colour_mse:
    squared error of colours and alpha alone, without a weight in light, None where mse is."""

    plans: list[TexelPlan]
    resolution: int
    qp_offset: int
    values: float
    mse: float | None = None
    instead: Decision[Supports] | None = None
    behind: float = 0.0
    bytes: float = 0.0
    attributes: float = 0.0
    colour_mse: float | None = None


@dataclass(frozen=True)
class _Candidate:
    """An image group and what it would cost over texels and, where that was looked at, voxels. finer: whether it came out too
    coarse before; voxels: the Probe at K resolution; behind: bytes that it costs more over voxels, on the source's mesh; goes:
    whether it was chosen; evidence: for the report."""

    plan: TexelPlan
    texels: Probe
    finer: bool = False
    voxels: Probe | None = None
    resolution: int = 0
    behind: float = 0.0
    goes: bool = False
    evidence: dict = field(default_factory=dict)

    def decided(self, over: str, reason: str, **more: Any) -> _Candidate:
        """The candidate with its choice, "texels" or "voxels", and why."""
        evidence = {**self.evidence, "texels": self.texels.evidence(), **more, "chosen": over, "reason": reason}
        return replace(self, goes=over == "texels", evidence=evidence)

    def over_voxels(self) -> _Candidate:
        """The candidate over voxels, for the sake of a smaller mesh."""
        reason = "voxels cost less with the smaller mesh that they allow" if self.goes else self.evidence["reason"]
        return replace(self, goes=False, evidence={**self.evidence, "chosen": "voxels", "reason": reason})


def choose_supports(scene: Scene, surface: Surface, rd: RateDistortion, request: EncodeOptions, colours: np.ndarray,
                    finer: frozenset[int] = frozenset(), step: Step = no_step) -> Decision[Supports]:
    """Supports for a surface on the usual lattice.

    Parameters
    ----------
    colours : float32 [materials, 4]
        Of material_colours().
    finer : frozenset of int
        Materials that came out too coarse: their images go over texels at full size, or their voxels get a larger K.
    step : function
        Of Report.stage().

    Raises
    ------
    InputError, LimitError
        The mesh or its texels are over a limit, and voxels are not an alternative.
    """
    evidence: dict[str, Any] = {"asked": request.support, "groups": []}
    reason = reason_for_voxels(request)
    if not reason and request.support != "texels" and is_plain(scene, colours, surface.material):
        reason, rd = NOTHING_TO_PROBE, replace(rd, resolution=_coarsest(rd, request))
    may_be_texels = not reason and request.support != "voxels"
    groups = rd.memo.get("groups", lambda: image_groups(scene, surface)) if may_be_texels else []
    rd = replace(rd, values=_usual_values(scene, surface, groups, colours))
    if reason:
        return Decision(Supports([], rd.resolution, 0, rd.values), evidence | {"reason": reason})
    return _Choice(scene, surface, rd, request, finer).made(groups, colours, evidence, step)


def reason_for_voxels(request: EncodeOptions) -> str:
    """Why nothing but voxels comes into question; "" where texels do."""
    if codec_of(request.codec).joint:
        return "the codec does not support texels"
    if request.support == "texels" or request.rate_is_free:
        return ""
    return "requested" if request.support == "voxels" else "K or an error bound was requested, which implies voxels"


@dataclass(frozen=True)
class _Choice:
    """What every step of the choice looks at."""

    scene: Scene
    surface: Surface
    rd: RateDistortion
    request: EncodeOptions
    finer: frozenset[int]

    def made(self, groups: list[ImageGroup], colours: np.ndarray, evidence: dict, step: Step) -> Decision[Supports]:
        """The choice: each image by itself, then K and position bits for all together. The promise of the rate is let go where
        it would take more bytes than the source's files."""
        supports = self._all(groups, colours, evidence, step)
        most = sum(self.scene.files.values())
        if not self.rd.has_promise or not most or supports.value.bytes <= most:
            return supports
        return replace(self, rd=replace(self.rd, has_promise=False))._all(groups, colours, evidence, step)

    def _all(self, groups, colours, evidence, step):
        found, total = [], len(groups) + 2  # the last two are the choices of all together
        with closing(in_order(self._of_group, list(enumerate(groups)), self.rd.threads)) as made:
            for one in made:
                found.append(one)
                step(len(found), total)
        decided = [one for one in found if isinstance(one, _Candidate)]
        rows = [one for one in found if not isinstance(one, _Candidate)]
        step(total - 1, total)
        supports = self._supports(decided, rows, colours, evidence)
        instead = [one for one in decided if one.voxels]
        behind, fixed = sum(max(one.behind, 0.0) for one in instead), sum(one.voxels.fixed for one in instead if one.voxels)
        is_open = supports.value.plans and len(instead) == len(groups) and self.request.mesh_is_free
        if is_open and behind < MOST_SAVED * fixed:
            other = self._supports([one.over_voxels() for one in instead], [], colours, evidence)
            return replace(supports, value=replace(supports.value, instead=other, behind=behind))
        return supports

    def _of_group(self, numbered):
        """The _Candidate of an image group, decided; what the report says of it where a limit leaves it voxels alone."""
        number, group = numbered
        row = {"faces": len(group.faces), "materials": np.unique(self.surface.material[group.faces]).tolist(),
               "image": list(group.size)}

        def made():
            patch = self.rd.patch(self.scene, self.surface, group.faces, texels_shown(group))
            return self._decided(self._candidate(group, row, patch), patch)

        key = "image", number, self.rd.planes.signature, self.rd.qp, self.rd.has_promise, bool(self.finer & set(row["materials"]))
        try:
            return self.rd.memo.get(key, made)
        except LimitError as error:
            if self.request.support == "texels":
                raise
            return {**row, "chosen": "voxels", "reason": str(error)}

    def _supports(self, decided, rows, colours, evidence):
        """Supports of _Candidates, with what the report says. rows: of other images."""
        resolution, rest, voxels = self._resolution(decided, colours)
        plans, offset = [one.plan for one in decided if one.goes], rest.qp_offset if rest else 0
        groups = rows + [one.evidence for one in decided]
        probes = [one.texels for one in decided if one.goes]
        probes += [rest] if rest else [one.voxels for one in decided if one.voxels and not one.goes]
        supports = Supports(plans, resolution, offset, self.rd.values, self._mse(probes), bytes=sum(p.bytes for p in probes),
                            attributes=sum(probe.attributes for probe in probes), colour_mse=self._colour_mse(probes))
        return Decision(supports, evidence | {"groups": groups, **voxels})

    def _candidate(self, group: ImageGroup, row: dict, patch: Patch | None) -> _Candidate:
        """The _Candidate of an image group, at the size and with the bits of UVs that cost the least. row: what the report says
        of it before anything is tried. Raises LimitError."""
        plan = _plan(group, self._coded_size(group))
        keys = self._keys(plan)
        finer = bool(self.finer & set(row["materials"]))
        if patch is None or group.palette or self.rd.max_error is not None:  # nothing has to be probed
            maps = {name: Probe(len(keys), 8.0, 0.0) for name in group.maps}
            plan, texels = _with_bits(plan, LOSSLESS_FRACTION), Probe(len(keys), 24.0, 0.0, maps=maps)
        else:
            points = len(split_corners(self.surface.faces[group.faces], plan.corner_uv())[0])
            plan, texels = self._best_size(plan, keys, patch, group.nearest or finer)
            plan, texels = self._best_bits(plan, texels, patch, UV_BYTES_A_BIT * points, finer)
        plan = replace(plan, qp_offset=min(texels.qp_offset, 0) if finer else texels.qp_offset)
        return _Candidate(plan, texels, finer, evidence={**row, "size": list(plan.size)})

    def _decided(self, one, patch):
        """A candidate with the choice whether it costs less over texels."""
        group = one.plan.group
        if self.request.support == "texels":
            return replace(one, finer=False).decided("texels", "requested")
        if group.nearest and has_few_colours(group.image.reshape(-1, 4)):
            return replace(one, finer=False).decided("texels", "the image has few colours and a NEAREST sampler")
        if one.finer:
            return one.decided("texels", "the first result was worse than the rate promises")
        if patch is None:
            return one.decided("voxels", "the surface has no area")
        plain, textured = _geometry_bytes(one.plan, self.surface)
        if not math.isfinite(textured):
            return one.decided("voxels", "Draco cannot hold its UVs")
        one = replace(one, texels=replace(one.texels, fixed=textured + UNIT_BYTES))
        texels = self._cost(one.texels, patch)
        resolution, tried = self._best_voxels(patch, plain, CLEAR * texels)
        one = replace(one, voxels=tried[resolution], resolution=resolution)
        voxels = self._cost(one.voxels, patch)
        one = replace(one, behind=self._behind(one.voxels, one.texels, patch, VOXEL_COST))
        row = self._rows(tried, resolution, patch)[-1]
        return one.decided("voxels" if one.behind < 0 else "texels", _reason(texels, voxels), voxels=row)

    def _cost(self, probe, patch):
        """Of a Probe of a patch, in bytes."""
        return self.rd.cost(probe.bytes, probe.error, patch.weight)

    def _behind(self, one, other, patch, share):
        """Bytes that a Probe of a patch costs more than a share of another, in light or in flat colours, where that is more: what
        a file has stays where they disagree. Without limit where the other alone keeps the promise of the rate."""
        if self.rd.keeps_promise(one, patch) != self.rd.keeps_promise(other, patch):
            return -math.inf if self.rd.keeps_promise(one, patch) else math.inf
        pairs = (one, other), (one.flat, other.flat)
        return max(self._cost(a, patch) - share * self._cost(b, patch) for a, b in pairs)

    def _best_size(self, plan, keys, patch, is_fixed):
        """(plan, Probe) of the plan's size, or of half of it where that costs clearly less; of a large image a quarter too."""
        probe = self.rd.texels(patch, plan, keys, TEXEL_CELL)
        if is_fixed or self.request.texel_size is not None or patch.texels_per_edge(USUAL_K) < COARSE:
            return plan, probe
        for halved in range(1, 3 if max(plan.size) > DETAILED else 2):
            width, height = plan.size
            if min(plan.size) < LEAST_SIDE or (width | height) & 1:
                break
            half = _plan(plan.group, (width // 2, height // 2))
            tried = self.rd.texels(patch, half, self._keys(half), TEXEL_CELL - halved)  # in the same places
            if self._behind(tried, probe, patch, HALF_COST) >= 0:
                break
            plan, probe = half, tried
        return plan, probe

    def _best_bits(self, plan, probe, patch, uv_bytes, finer):
        """(plan, Probe) with the bits of UVs below the texel that cost the least. uv_bytes: of each."""
        errors = self.rd.rounded_uv(patch, plan)
        bits = int(np.argmin([self.rd.cost(uv_bytes * k, error, patch.weight) for k, error in enumerate(errors)]))
        if self.rd.keeps_promise(probe, patch):
            bits = max(bits, next((k for k, error in enumerate(errors) if error <= MOST_ROUNDED * probe.mse), bits))
        plan = _with_bits(plan, max(bits, SQUARE_BITS) if plan.group.nearest else bits + FINER_BITS * finer)
        return plan, replace(probe, mse=probe.mse + errors[plan.fraction_bits])

    def _keys(self, plan):
        """Keys of the texels that a plan covers. Raises LimitError, where voxels would do even before the limit on samples."""
        uv = plan.corner_uv().reshape(-1, 2)
        corners, most = np.arange(len(uv)).reshape(-1, 3), self.rd.limits.samples
        if self.request.support == "auto":
            most = min(most or MOST_ROWS, MOST_ROWS)
        return covered_texels(plan, uv, corners, most, self.rd.limits.voxels)

    def _coded_size(self, group):
        longest, size = max(group.size), self.request.texel_size
        wanted = longest if size is None or group.palette else min(size, longest)
        return tuple(max(1, round(side * wanted / longest)) for side in group.size)

    def _mse(self, probes):
        """Supports.mse, of the Probes of what was chosen."""
        attributes = sum(probe.attributes for probe in probes)
        if not attributes:
            return None
        return max(sum(probe.attributes * probe.mse for probe in probes) / attributes, self.rd.coding_mse / 4)

    def _colour_mse(self, probes):
        """Supports.colour_mse, of the Probes of what was chosen."""
        attributes = sum(probe.attributes for probe in probes)
        weight = self.scene.weights.get(BASE_COLOUR.name, BASE_COLOUR.weight)
        return sum(probe.attributes * probe.mse for probe in probes) / attributes / weight if attributes and weight else None

    def _best_voxels(self, patch, fixed, most=np.inf):
        """(K, Probes by K): down or up the ladder, from where voxels have the rate's QP, for as long as they cost less. fixed:
        bytes of the geometry; most: cost from which on no other K is tried."""
        ladder, tried = self._ladder(patch), {}
        first = best = min(range(len(ladder)), key=lambda i: abs(self.rd.qp_offset(patch.voxels(ladder[i]), patch.weight)))

        def cost(place):
            k = ladder[place]
            if k not in tried:
                tried[k] = replace(self.rd.voxels(patch, k, max(VOXEL_CELL + place - first, LEAST_CELL)), fixed=fixed)
            return self._cost(tried[k], patch)

        for step in (-1, 1) if cost(first) <= most else ():
            while 0 <= best + step < len(ladder) and cost(best + step) < (FINER_COST if step > 0 else 1.0) * cost(best):
                best += step
        return ladder[best], tried

    def _ladder(self, patch):
        """Values of K that voxels of a patch may have."""
        most = min(self.rd.resolution, self._most_resolution(patch))
        return [k for k in LADDER if k <= most] or LADDER[:1]

    def _most_resolution(self, patch):
        """The finest K with no more than MOST_VOXELS of a patch, roughly; LADDER's coarsest at least. A surface without area
        has no patch, and sets no bound."""
        if patch is None:
            return MOST_RESOLUTION
        most = min(self.rd.limits.voxels or MOST_VOXELS, MOST_VOXELS)
        return max(int(USUAL_K * (most / max(patch.voxels(USUAL_K), 1)) ** 0.5), LADDER[0])

    def _rows(self, tried, chosen, patch):
        """What the report says of Probes by K, the chosen one last."""
        return [{"resolution": k, **tried[k].evidence(), "cost": round(self._cost(tried[k], patch))}
                for k in sorted(tried, key=lambda k: (k == chosen, k))]

    def _resolution(self, decided, colours):
        """(K of what stays over voxels, the Probe of that, None where it was not looked at, evidence). decided: _Candidates."""
        usual, free = self.rd.resolution, self.request.rate_is_free
        chosen = [one.plan.group.faces for one in decided if one.goes]
        rest = ~np.isin(np.arange(len(self.surface.faces)), np.concatenate([[-1], *chosen]))
        if free and rest.any() and is_plain(self.scene, colours, self.surface.material[rest]):
            return _coarsest(self.rd, self.request), None, {"reason": "the surface over voxels has one colour, so there is "
                                                                      "nothing to choose"}
        if self.finer & set(np.unique(self.surface.material[rest]).tolist()):
            patch = self.rd.patch(self.scene, self.surface, np.flatnonzero(rest))
            return min(round(FINER_K * usual), MOST_RESOLUTION, self._most_resolution(patch)), None, {}
        alone = [one for one in decided if not one.goes and len(one.plan.group.faces) == rest.sum() and one.voxels]
        if alone:
            return alone[0].resolution, alone[0].voxels, {}
        others = [one.plan.group for one in decided if not one.goes]
        texels = sum(map(texels_shown, others)) if sum(len(group.faces) for group in others) == rest.sum() else np.inf
        patch = self.rd.patch(self.scene, self.surface, np.flatnonzero(rest), texels) if rest.any() and free else None
        if patch is None:
            return usual, None, {}
        resolution, tried = self._best_voxels(patch, 0)
        return resolution, tried[resolution], {"voxels": self._rows(tried, resolution, patch)}


def _usual_values(scene, surface, groups, colours):
    """RateDistortion.values of a scene."""
    rest = ~np.isin(np.arange(len(surface.faces)), np.concatenate([[-1], *(group.faces for group in groups)]))
    return usual_values(surface, groups, rest & (not is_plain(scene, colours, surface.material[rest])))


def _plan(group, size):
    return TexelPlan(group, size, min(2, most_fraction_bits(size, group)))


def _with_bits(plan, bits):
    return replace(plan, fraction_bits=1 if plan.group.palette else min(bits, most_fraction_bits(plan.size, plan.group)))


def _reason(texels, voxels):
    return f"texels cost {round(texels)} bytes and voxels {round(voxels)}, errors included"


def _geometry_bytes(plan, surface):
    """(bytes of the group's geometry alone, with its UVs), as one Draco unit."""
    faces, bits = surface.faces[plan.group.faces], surface.cube.position_bits
    return draco_bytes(surface.lattice, faces, bits), draco_bytes(surface.lattice, faces, bits, plan.corner_uv())


def _coarsest(rd, request):
    """K for one colour."""
    return min(rd.resolution, COARSEST_K) if request.rate_is_free else rd.resolution


def moved_plans(plans: list[TexelPlan], scene: Scene, surface: Surface) -> list[TexelPlan]:
    """The plans on another lattice, where the same groups may have other faces."""
    out, groups = [], image_groups(scene, surface) if plans else []
    for plan in plans:
        same = next((g for g in groups if g.key == plan.group.key), None)
        if same is not None:
            size = same.size if same.palette else plan.size
            bits = min(plan.fraction_bits, most_fraction_bits(size, same))
            out.append(replace(plan, group=same, size=size, fraction_bits=bits))
    return out


def without_faces(surface: Surface, gone: np.ndarray) -> Surface:
    """A surface without some of its faces. gone: bool [F]."""
    if not gone.any():
        return surface
    return replace(surface, faces=surface.faces[~gone], origin_face=surface.origin_face[~gone], material=surface.material[~gone])
