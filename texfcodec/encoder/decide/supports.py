"""Which parts of the surface become fields over texels, which over voxels, how fine both are, and how exact UVs: by what each
would cost at equal quality (encoder only).

The QP is the quality that was requested. A support that looks better at this QP may spend more bytes: bytes at equal quality are
those of the values times (error / error of the other) ** SLOPE, which is what coding at another QP would give, and the geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...codecs import codec_of
from ...errors import LimitError
from ...geometry.draco import enc_geometry, enc_textured, split_corners
from ...options import MOST_RESOLUTION
from ...report import Step, no_step
from ..decision import Decision
from ..estimates.image_measures import UNIT_BYTES
from ..estimates.probe import SLOPE, Probe
from ..texel_field import TexelPlan, covered_texels, most_fraction_bits
from .mesh import Price
from .one_colour import NOTHING_TO_PROBE, is_plain
from .spending import has_few_colours
from .texel_images import image_groups
from .uv_bits import fraction_bits

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...options import EncodeOptions
    from ...scene.scene import Scene
    from ..rd import RateDistortion
    from .texel_images import ImageGroup

LEAST_SIDE = 256  # images from this side on are tried smaller
LOST = 1.1  # how much error may grow by a smaller image or K: they lose detail, and no QP brings it back
BLURRED, MOST_TIMES = 4.0, 6.0  # voxels with so many times the error are no alternative, unless texels are so many times larger
CLEAR = 2.0  # times the bytes over texels: voxels that take more at the first K need not be tried at others
COARSE = 0.7  # texels per voxel edge under which a smaller K is tried, and no smaller image
USUAL_K = 64
SQUARE_BITS = 4  # of UVs, at least, where texels are squares: their sides move by a 32nd of a texel at most
FINER_K, FINER_BITS = 1.5, 2  # times K, and bits of UVs, for what came out too coarse
UV_BYTES_A_BIT = 2 / 8  # of a corner, for each bit of its two coordinates
LOSSLESS_FRACTION = 4
MOST_ROWS = 1 << 27  # of texels that the faces of an image go over, a few seconds; more than a million faces have elsewhere


@dataclass(frozen=True)
class Supports:
    """plans: TexelPlans; resolution: K of what is over voxels; price: what the error of a picture is worth in bytes of these
    values, None where nothing was probed or a bound on errors was asked for."""

    plans: list[TexelPlan]
    resolution: int
    price: Price | None = None


@dataclass(frozen=True)
class _Candidate:
    """An image group and what it would cost over texels and, where that was looked at, voxels. points: corners that differ in
    vertex or UV; finer: whether it came out too coarse before; goes: whether it was chosen; evidence: for the report."""

    plan: TexelPlan
    texels: Probe
    points: int
    finer: bool = False
    voxels: Probe | None = None
    goes: bool = False
    evidence: dict = field(default_factory=dict)

    def decided(self, over: str, reason: str, **more: Any) -> _Candidate:
        """The candidate with its choice, "texels" or "voxels", and why."""
        evidence = {**self.evidence, "texels": self.texels.evidence(), **more, "chosen": over, "reason": reason}
        return replace(self, goes=over == "texels", evidence=evidence)


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
    if reason:
        return Decision(Supports([], rd.resolution), evidence | {"reason": reason})
    if request.support != "texels" and is_plain(scene, colours, surface.material):
        return Decision(Supports([], _coarsest(rd, request)), evidence | {"reason": NOTHING_TO_PROBE})
    return _Choice(scene, surface, rd, request, finer).made(colours, evidence, step)


def reason_for_voxels(request: EncodeOptions) -> str:
    """Why nothing but voxels comes into question; "" where texels do."""
    if codec_of(request.codec).joint:
        return "the codec has no part in texels"
    if request.support == "texels" or request.rate_is_free:
        return ""
    return "asked for" if request.support == "voxels" else "K or an error bound was asked for, which are about voxels"


@dataclass(frozen=True)
class _Choice:
    """What every step of the choice looks at."""

    scene: Scene
    surface: Surface
    rd: RateDistortion
    request: EncodeOptions
    finer: frozenset[int]

    def made(self, colours: np.ndarray, evidence: dict, step: Step) -> Decision[Supports]:
        """The choice: each image by itself, then K and position bits for all together."""
        groups = [] if self.request.support == "voxels" else image_groups(self.scene, self.surface)
        candidates, rows, decided, total = [], [], [], 2 * len(groups) + 2  # the last two are the choices of all together
        for number, group in enumerate(groups, 1):
            row = {"faces": len(group.faces), "materials": np.unique(self.surface.material[group.faces]).tolist(),
                   "image": list(group.size)}
            try:
                candidates.append(self._candidate(group, row))
            except LimitError as error:  # voxels will do
                if self.request.support == "texels":
                    raise
                rows.append({**row, "chosen": "voxels", "reason": str(error)})
            step(number, total)
        for number, candidate in enumerate(candidates, len(groups)):
            step(number, total)
            decided.append(self._refined(self._decided(candidate)))
        chosen = [candidate for candidate in decided if candidate.goes]
        step(total - 1, total)
        resolution, voxels = self._resolution(chosen, colours)
        evidence |= {"groups": rows + [candidate.evidence for candidate in decided], **voxels}
        return Decision(Supports([candidate.plan for candidate in chosen], resolution, self._price(decided, resolution)),
                        evidence)

    def _candidate(self, group: ImageGroup, row: dict) -> _Candidate:
        """The _Candidate of an image group. row: what the report says of it before anything is tried. Raises LimitError."""
        plan = _plan(group, self._coded_size(group))
        keys = self._keys(plan)
        points = len(split_corners(self.surface.faces[group.faces], plan.corner_uv())[0])
        patch = self._patch(group)
        if patch is None:
            maps = {name: Probe(len(keys), 8.0, self.rd.least_mse) for name in group.maps}
            plan, texels = _with_bits(plan, LOSSLESS_FRACTION), Probe(len(keys), 24.0, self.rd.least_mse, maps=maps)
        else:
            texels = self.rd.texels(patch, plan, keys)
        finer = bool(self.finer & set(row["materials"]))
        return _Candidate(plan, texels, points, finer, evidence={**row, "size": list(plan.size)})

    def _patch(self, group):
        """The patch that a group's texels are probed on; None where nothing has to be."""
        if group.palette or self.rd.max_error is not None:
            return None
        return self.rd.patch(self.scene, self.surface, group.faces)

    def _decided(self, one):
        """A candidate with the choice whether it is smaller over texels, at equal quality."""
        group = one.plan.group
        if self.request.support == "texels":
            return replace(one, finer=False).decided("texels", "asked for")
        if group.nearest and has_few_colours(group.image.reshape(-1, 4)):
            return replace(one, finer=False).decided("texels", "texels are squares of few colours (sampler NEAREST)")
        if one.finer:
            return one.decided("texels", "it came out worse than the rate promises")
        patch = self.rd.patch(self.scene, self.surface, group.faces)
        if patch is None:
            return one.decided("voxels", "the surface has no area")
        plain, textured = _geometry_bytes(one.plan, self.surface)
        one = replace(one, texels=replace(one.texels, fixed=textured + UNIT_BYTES))
        clear = CLEAR * (one.texels.attributes + textured) - plain
        resolution, over_voxels = self._best_voxels(patch, one.texels, clear)
        one = replace(one, voxels=over_voxels)
        texels, voxels = one.texels.attributes + textured + UNIT_BYTES, over_voxels.bytes_at(one.texels) + plain
        blurred = over_voxels.lost(one.texels) > BLURRED and texels < MOST_TIMES * (over_voxels.attributes + plain)
        return one.decided("texels" if texels < voxels or blurred else "voxels", _reason(texels, voxels, blurred),
                           voxels={"resolution": resolution, **over_voxels.evidence()})

    def _refined(self, one):
        """A candidate, where it was chosen, at the size and with the bits of UVs that suit it."""
        patch = self._patch(one.plan.group) if one.goes else None
        if patch is None:
            return one
        plan, probe, evidence = one.plan, one.texels, one.evidence
        if patch.texels_per_edge(self.rd.resolution) >= COARSE and not plan.group.nearest and not one.finer:
            plan, probe = self._smallest(plan, probe, patch)
            evidence = evidence | {"size": list(plan.size), "texels": replace(probe, fixed=one.texels.fixed).evidence()}
        bits = fraction_bits(self.rd.rounded_uv(patch, plan, probe), probe, UV_BYTES_A_BIT * one.points, SLOPE)
        bits = max(bits, SQUARE_BITS) if plan.group.nearest else bits + FINER_BITS * one.finer
        return replace(one, plan=_with_bits(plan, bits), texels=probe, evidence=evidence)

    def _smallest(self, plan, probe, patch):
        """(plan, probe) at half the size again and again for as long as that is smaller at equal quality, and good enough."""
        first = probe.exact()
        while self.request.texel_size is None and min(plan.size) >= LEAST_SIDE and not (plan.size[0] | plan.size[1]) & 1:
            half = _plan(plan.group, (plan.size[0] // 2, plan.size[1] // 2))
            tried = self.rd.texels(patch, half, self._keys(half))
            if tried.exact().lost(first) > LOST or tried.bytes_at(probe) >= probe.attributes:
                break
            plan, probe = half, tried
        return plan, probe

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

    def _price(self, decided, resolution):
        """By what was probed of the supports that were chosen, or of voxels where no image was looked at; None where values take
        no bytes, or nobody asks."""
        probes = [one.texels if one.goes else one.voxels for one in decided]
        if not decided and self.request.mesh_is_free:
            patch = self.rd.patch(self.scene, self.surface, np.arange(len(self.surface.faces)))
            probes = [] if patch is None else [self.rd.voxels(patch, resolution, 2)]
        attributes = sum(probe.attributes for probe in probes if probe)
        if not attributes or self.rd.max_error is not None:
            return None
        mse = sum(probe.attributes * probe.mse for probe in probes if probe) / attributes
        return Price(of_error=max(SLOPE * attributes / mse, self.rd.least_price(self.surface)), mse=mse)

    def _best_voxels(self, patch, texels, clear):
        """(K, Probe): the K of the rate, or where texels are coarser than its voxels the one that takes the fewest bytes. texels:
        the Probe to match; clear: bytes of voxels that leave no doubt."""
        usual = self.rd.resolution
        per_edge = patch.texels_per_edge(usual)
        choices, probes = _resolutions(per_edge, usual), []
        for k in choices:
            probes.append(self.rd.voxels(patch, k, _density(per_edge * usual / k)))
            if probes[0].bytes_at(texels) > clear:
                break
        good = [i for i, probe in enumerate(probes) if probe.lost(probes[0]) <= LOST]
        best = min(good, key=lambda i: probes[i].bytes_at(probes[0]))
        return choices[best], probes[best]

    def _resolution(self, chosen, colours):
        """(K of what stays over voxels, evidence): the rate's, or a smaller one where it gives the same picture for less; a
        larger one where some of it is to be finer. chosen: _Candidates."""
        usual, free = self.rd.resolution, self.request.rate_is_free
        rest = np.ones(len(self.surface.faces), bool)
        for one in chosen:
            rest[one.plan.group.faces] = False
        if free and rest.any() and is_plain(self.scene, colours, self.surface.material[rest]):
            return _coarsest(self.rd, self.request), {"reason": "what stays over voxels is one colour: nothing to probe"}
        if self.finer & set(np.unique(self.surface.material[rest]).tolist()):
            return min(round(FINER_K * usual), MOST_RESOLUTION), {}
        patch = self.rd.patch(self.scene, self.surface, np.flatnonzero(rest)) if rest.any() else None
        if not free or patch is None or patch.texels_per_edge(usual) >= COARSE:
            return usual, {}
        probes = [(usual, self.rd.voxels(patch, usual, 2))]
        while probes[-1][0] > 2 * USUAL_K:
            k = _coarser(probes[-1][0])
            probe = self.rd.voxels(patch, k, 2)
            worse = probe.lost(probes[0][1]) > LOST
            if worse or probe.bytes_at(probes[0][1]) >= probes[-1][1].bytes_at(probes[0][1]):
                break
            probes.append((k, probe))
        return probes[-1][0], {"voxels": [{"resolution": k, **probe.evidence()} for k, probe in probes]}


def _plan(group, size):
    return TexelPlan(group, size, min(2, most_fraction_bits(size, group)))


def _with_bits(plan, bits):
    return replace(plan, fraction_bits=1 if plan.group.palette else min(bits, most_fraction_bits(plan.size, plan.group)))


def _reason(texels, voxels, blurred):
    if blurred and texels >= voxels:
        return "voxels of this rate are too coarse to show it"
    return f"{round(texels)} bytes over texels, {round(voxels)} over voxels of their quality"


def _resolutions(per_edge, usual):
    """Values of K to try, the rate's own only where the texels are not coarser. per_edge: texels along an edge of its voxels."""
    if per_edge >= COARSE:
        return [usual]
    return sorted({min(max(round(usual * per_edge * factor), USUAL_K), usual) for factor in (1.0, 1.5, 2.0)}, reverse=True)


def _density(per_edge):
    """Samples per voxel edge of a probe's transfer."""
    return int(np.clip(np.ceil(2 * per_edge), 2, 4))


def _geometry_bytes(plan, surface):
    """(bytes of the group's geometry alone, with its UVs), as one Draco unit."""
    faces, bits = surface.faces[plan.group.faces], surface.cube.position_bits
    used, local = np.unique(faces, return_inverse=True)
    plain = len(enc_geometry(surface.lattice[used], local.reshape(-1, 3), bits))
    uv = plan.corner_uv()
    vertex, uv, corners = split_corners(faces, uv - uv.min(axis=(0, 1)))
    return plain, len(enc_textured(surface.lattice[vertex], corners, uv, bits)[0])


def _coarser(resolution):
    return round(resolution / np.sqrt(2))


def _coarsest(rd, request):
    """The least K that is ever tried, which is fine enough for one colour."""
    k = rd.resolution
    while request.rate_is_free and k > 2 * USUAL_K:
        k = _coarser(k)
    return k


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
