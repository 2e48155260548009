"""Which parts of the surface become fields over texels, which over voxels, how fine both are, and how exact positions and UVs: by
what each would cost at equal quality (encoder only).

The QP is the quality that was asked for. A support that looks better at this QP may spend more bytes: bytes at equal quality are
those of the values times (error / error of the other) ** SLOPE, which is what coding at another QP would give, and the geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...codecs import codec_of
from ...errors import LimitError
from ...geometry.areas import face_areas
from ...geometry.draco import enc_geometry, enc_textured, split_corners
from ...geometry.surface import make_surface
from ...options import FINEST_POSITIONS, MOST_RESOLUTION
from ...report import Step, no_step
from ..texel_field import TexelPlan, asked_by, most_fraction_bits
from .one_colour import NOTHING_TO_PROBE, is_plain, material_colours
from .position_error import rounding_mse
from .probe import SLOPE, Patch, Probe, probe_texels, probe_voxels
from .spending import has_few_colours
from .texel_images import image_groups
from .trial import coding_mse
from .uv_bits import fraction_bits

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...options import EncodeOptions
    from ...scene.scene import Scene

ENOUGH = 0.25  # of the usual error at a QP: smooth images that are closer to the source than that are close enough
LEAST_SIDE = 256  # images from this side on are tried smaller
LOST = 1.1  # how much error may grow by a smaller image or K: they lose detail, and no QP brings it back
BLURRED, MOST_TIMES = 4.0, 6.0  # voxels with so many times the error are no alternative, unless texels are so many times larger
CLEAR = 2.0  # times the bytes over texels: voxels that take more at the first K need not be tried at others
COARSE = 0.7  # texels per voxel edge under which a smaller K is tried, and no smaller image
USUAL_K = 64
SQUARE_BITS = 4  # of UVs, at least, where texels are squares: their sides move by a 32nd of a texel at most
FINER_K, FINER_BITS = 1.5, 2  # times K, and bits of UVs, for what came out too coarse
UV_BYTES_A_BIT = 2 / 8  # of a corner, for each bit of its two coordinates
UNIT_BYTES = 60  # of a further field
LOSSLESS_FRACTION = 4
MOST_ROWS = 1 << 27  # of texels that the faces of an image go over, a few seconds; more than a million faces have elsewhere


@dataclass
class Supports:
    """What was chosen. surface: on the lattice that was; plans: TexelPlans; resolution: K of the rest; told: for the report."""

    surface: Surface
    plans: list[TexelPlan]
    resolution: int
    told: dict[str, Any]


@dataclass
class _Candidate:
    """An image group and what it would cost over texels. points: corners that differ in vertex or UV; finer: whether it came out
    too coarse before."""

    plan: TexelPlan
    texels: Probe
    points: int
    finer: bool = False


def choose_supports(scene: Scene, surface: Surface, options: EncodeOptions, finer: frozenset[int] = frozenset(),
                    colours: np.ndarray | None = None, step: Step = no_step) -> Supports:
    """Supports for a surface on the usual lattice. finer: numbers of materials that came out too coarse: their images go over
    texels at full size, or their voxels get a larger K; colours: of material_colours, where they are known; step: of
    Report.stage(). Raises InputError, LimitError."""
    assert options.resolution is not None  # its __post_init__ fills it in
    told: dict[str, Any] = {"asked": options.support, "groups": []}
    reason = reason_for_voxels(options)
    if reason:
        return Supports(surface, [], options.resolution, told | {"reason": reason})
    colours = material_colours(scene, surface) if colours is None else colours
    if options.support != "texels" and is_plain(scene, colours, surface.material):
        return Supports(surface, [], _coarsest(options), told | {"reason": NOTHING_TO_PROBE})
    groups = [] if options.support == "voxels" else image_groups(scene, surface)
    found, chosen, total = [], [], 2 * len(groups) + 2  # the last two are the choices of all together
    for number, group in enumerate(groups, 1):
        found.append(_candidate(scene, surface, group, options, told["groups"]))
        step(number, total)
    for number, one in enumerate(found, len(groups)):
        step(number, total)
        if one and _goes_over_texels(one, scene, surface, options, told["groups"], finer):
            chosen.append(_refined(one, scene, surface, options, told["groups"][-1]))
    step(total - 2, total)
    bits = _position_bits(chosen, scene, surface, options)
    step(total - 1, total)
    resolution = _resolution(scene, surface, (chosen, colours), options, told, finer)
    plans = [c.plan for c in chosen]
    if bits != options.position_bits:
        told["position_bits"] = bits
        surface = make_surface(scene, replace(options, position_bits=bits))
        plans = _moved(plans, image_groups(scene, surface))
    return Supports(surface, plans, resolution, told)


def reason_for_voxels(options: EncodeOptions) -> str:
    """Why nothing but voxels comes into question; "" where texels do."""
    if codec_of(options.codec).joint:
        return "the codec has no part in texels"
    if options.support == "texels" or options.rate_is_free:
        return ""
    return "asked for" if options.support == "voxels" else "K or an error bound was asked for, which are about voxels"


def _candidate(scene, surface, group, options, told):
    """The _Candidate of an image group; None, and why in told, where its texels are over a limit and voxels will do."""
    plan = _plan(group, _coded_size(group, options))
    try:
        keys = _asked(plan, options)
    except LimitError as error:
        if options.support == "texels":
            raise
        told.append({**_named(group, surface), "chosen": "voxels", "reason": str(error)})
        return None
    points = len(split_corners(surface.faces[group.faces], plan.corner_uv())[0])
    patch = _patch(scene, surface, group.faces, options)
    if group.palette or patch is None or options.max_error is not None:
        maps = {name: Probe(len(keys), 8.0, _least_mse(options)) for name in group.maps}
        return _Candidate(_with_bits(plan, LOSSLESS_FRACTION), Probe(len(keys), 24.0, _least_mse(options), maps=maps), points)
    return _Candidate(plan, probe_texels(patch, plan, keys, options), points)


def _named(group, surface):
    """What the report says of an image group before anything was tried."""
    return {"faces": len(group.faces), "materials": np.unique(surface.material[group.faces]).tolist(), "image": list(group.size)}


def _refined(one, scene, surface, options, told):
    """A chosen candidate at the size and with the bits of UVs that suit it; told: its entry in the report."""
    plan, probe = one.plan, one.texels
    patch = None if plan.group.palette or options.max_error is not None else _patch(scene, surface, plan.group.faces, options)
    if patch is None:
        return one
    if patch.texels_per_edge(options.resolution) >= COARSE and not plan.group.nearest and not one.finer:
        plan, probe = _smallest(plan, probe, patch, options)
        told |= {"size": list(plan.size), "texels": replace(probe, fixed=one.texels.fixed).told()}
    bits = fraction_bits(patch, plan, probe, UV_BYTES_A_BIT * one.points, SLOPE)
    bits = max(bits, SQUARE_BITS) if plan.group.nearest else bits + FINER_BITS * one.finer
    return replace(one, plan=_with_bits(plan, bits), texels=probe)


def _plan(group, size):
    return TexelPlan(group, size, min(2, most_fraction_bits(size, group)))


def _smallest(plan, probe, patch, options):
    """(plan, probe) at half the size again and again for as long as that is smaller at equal quality, and good enough."""
    first = probe.exact()
    while options.texel_size is None and min(plan.size) >= LEAST_SIDE and not (plan.size[0] | plan.size[1]) & 1:
        half = _plan(plan.group, (plan.size[0] // 2, plan.size[1] // 2))
        tried = probe_texels(patch, half, _asked(half, options), options)
        if tried.exact().lost(first) > LOST or tried.bytes_at(probe) >= probe.attributes:
            break
        plan, probe = half, tried
    return plan, probe


def _asked(plan, options):
    """Keys of the texels that a plan asks. Raises LimitError, where voxels would do even before the limit on samples."""
    uv = plan.corner_uv().reshape(-1, 2)
    corners, most = np.arange(len(uv)).reshape(-1, 3), options.limits.samples
    if options.support == "auto":
        most = min(most or MOST_ROWS, MOST_ROWS)
    return asked_by(plan, uv, corners, most, options.limits.voxels)


def _coded_size(group, options):
    longest = max(group.size)
    wanted = longest if options.texel_size is None or group.palette else min(options.texel_size, longest)
    return tuple(max(1, round(side * wanted / longest)) for side in group.size)


def _with_bits(plan, bits):
    return replace(plan, fraction_bits=1 if plan.group.palette else min(bits, most_fraction_bits(plan.size, plan.group)))


def _cheapest(choices, probe, added, bytes_a_bit):
    """The number of bits at which values and coordinates take the fewest bytes at equal quality. added: error at so many bits."""
    mse = probe.mse
    return min(choices, key=lambda k: probe.attributes * (1 + added(k) / mse) ** SLOPE + bytes_a_bit * k)


def _position_bits(chosen, scene, surface, options):
    """Bits of positions: rounding them moves what is seen. Never fewer than usual."""
    usual, vertices = options.position_bits, len(np.unique(surface.faces))
    attributes = sum(one.texels.attributes for one in chosen)
    if not options.position_bits_are_free or not attributes or options.max_error is not None:
        return usual
    mse = sum(one.texels.attributes * one.texels.mse for one in chosen) / attributes
    whole = Probe(1, 8 * attributes, mse)
    moved = rounding_mse(scene, surface.cube, options.threads)
    return _cheapest(range(usual, FINEST_POSITIONS + 1), whole, lambda bits: moved / 2 ** (bits - usual), 3 / 8 * vertices)


def _goes_over_texels(one, scene, surface, options, told, finer):
    """Whether a candidate is smaller over texels, at equal quality; says why in told."""
    entry = {**_named(one.plan.group, surface), "size": list(one.plan.size), "texels": one.texels.told()}
    told.append(entry)
    if options.support == "texels":
        entry |= {"chosen": "texels", "reason": "asked for"}
        return True
    if one.plan.group.nearest and has_few_colours(one.plan.group.image.reshape(-1, 4)):
        entry |= {"chosen": "texels", "reason": "texels are squares of few colours (sampler NEAREST)"}
        return True
    one.finer = bool(finer & set(entry["materials"]))
    if one.finer:
        entry |= {"chosen": "texels", "reason": "it came out worse than the rate promises"}
        return True
    patch = _patch(scene, surface, one.plan.group.faces, options)
    if patch is None:
        entry |= {"chosen": "voxels", "reason": "the surface has no area"}
        return False
    plain, textured = _geometry_bytes(one.plan, surface)
    one.texels = replace(one.texels, fixed=textured + UNIT_BYTES)
    clear = CLEAR * (one.texels.attributes + textured) - plain
    resolution, over_voxels = _best_voxels(patch, (one.texels, clear), options)
    entry |= {"texels": one.texels.told(), "voxels": {"resolution": resolution, **over_voxels.told()}}
    texels, voxels = one.texels.attributes + textured + UNIT_BYTES, over_voxels.bytes_at(one.texels) + plain
    blurred = over_voxels.lost(one.texels) > BLURRED and texels < MOST_TIMES * (over_voxels.attributes + plain)
    entry |= {"chosen": "texels" if texels < voxels or blurred else "voxels", "reason": _reason(texels, voxels, blurred)}
    return texels < voxels or blurred


def _reason(texels, voxels, blurred):
    if blurred and texels >= voxels:
        return "voxels of this rate are too coarse to show it"
    return f"{round(texels)} bytes over texels, {round(voxels)} over voxels of their quality"


def _best_voxels(patch, clear, options):
    """(K, Probe): the K of the rate, or where texels are coarser than its voxels the one that takes the fewest bytes. clear:
    (the Probe to match, bytes of voxels that leave no doubt)."""
    per_edge = patch.texels_per_edge(options.resolution)
    choices, probes = _resolutions(per_edge, options.resolution), []
    for k in choices:
        probes.append(probe_voxels(patch, k, _density(per_edge * options.resolution / k), options))
        if probes[0].bytes_at(clear[0]) > clear[1]:
            break
    good = [i for i, probe in enumerate(probes) if probe.lost(probes[0]) <= LOST]
    best = min(good, key=lambda i: probes[i].bytes_at(probes[0]))
    return choices[best], probes[best]


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


def _resolution(scene, surface, known, options, told, finer):
    """K of what stays over voxels: the rate's, or a smaller one where it gives the same picture for less; a larger one where some
    of it is to be finer. known: (the chosen _Candidates, material_colours)."""
    chosen, colours = known
    rest = np.ones(len(surface.faces), bool)
    for one in chosen:
        rest[one.plan.group.faces] = False
    if options.rate_is_free and rest.any() and is_plain(scene, colours, surface.material[rest]):
        told["reason"] = "what stays over voxels is one colour: nothing to probe"
        return _coarsest(options)
    if finer & set(np.unique(surface.material[rest]).tolist()):
        return min(round(FINER_K * options.resolution), MOST_RESOLUTION)
    patch = _patch(scene, surface, np.flatnonzero(rest), options) if rest.any() else None
    if not options.rate_is_free or patch is None or patch.texels_per_edge(options.resolution) >= COARSE:
        return options.resolution
    probes = [(options.resolution, probe_voxels(patch, options.resolution, 2, options))]
    while probes[-1][0] > 2 * USUAL_K:
        k = _coarser(probes[-1][0])
        probe = probe_voxels(patch, k, 2, options)
        worse = probe.lost(probes[0][1]) > LOST
        if worse or probe.bytes_at(probes[0][1]) >= probes[-1][1].bytes_at(probes[0][1]):
            break
        probes.append((k, probe))
    told["voxels"] = [{"resolution": k, **probe.told()} for k, probe in probes]
    return probes[-1][0]


def _coarser(resolution):
    return round(resolution / np.sqrt(2))


def _coarsest(options):
    """The least K that is ever tried, which is fine enough for one colour."""
    k = options.resolution
    while options.rate_is_free and k > 2 * USUAL_K:
        k = _coarser(k)
    return k


def _patch(scene, surface, faces, options):
    if not face_areas(surface.lattice, surface.faces[faces]).any():
        return None
    return Patch(scene, surface, faces, _least_mse(options), options.threads)


def _least_mse(options):
    return ENOUGH * coding_mse(options.reckoned_qp)


def _moved(plans, groups):
    """The plans on another lattice, where the same groups may have other faces."""
    out = []
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
