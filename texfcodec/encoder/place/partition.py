"""The choice of the partition: candidates are compared without coding, by the bytes of their error and of their fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.colour_error import ColourError, decibels
from ...core.json_text import json_ready
from ...field.grid import build_brick_map
from ...field.query import query_field
from ...field.transfer import transfer
from ...field.voxelise import voxelise
from ...geometry.areas import face_areas, sample_surface
from ...geometry.edges import face_components
from ...metrics.parts import alpha_mse
from ...report import Step, no_step
from ...scene.channels import needs_alpha
from ...scene.fetch import pack_source, sample_source
from ..caches import Cache
from ..decision import Decision
from ..prepare.uniform_colour import uniform_colour
from .coincident_layers import part_layers
from .contacts import MAX_FIELDS, colour_pieces, find_contacts, folding_components

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Material, Scene
    from ..price import Lagrangian

FIELD_BYTES = 300  # of a further field: about 150 of its own, and as many for 0.1 to 0.4 % more voxels
SURE_TIMES = 6.0  # what fields cost that half the resolution settles the question
SHOWN_GAIN = 0.15  # dB of alpha at the coded quality from which its mixing is worth a warning
MANY_FIELDS = 256  # more than a stream may have: what alpha would be like without that bound
MOST_CANDIDATES = 4  # that _candidates() yields
TRIAL_SAMPLES = 1 << 17


def uncoded_errors(scene: Scene, surface: Surface, face_field: np.ndarray, resolution: int, area_threshold: int,
                   threads: int) -> dict[str, float]:
    """Return mean squared errors {"y", "alpha"} of uncoded fields against the source at TRIAL_SAMPLES surface points; "alpha"
    only if alpha is coded.

    surface: encoder's Surface; face_field: int64 [F], field of each face, numbered from 0 without gaps; resolution: K of the
    fields; area_threshold: as of EncodeOptions.
    """
    bits = surface.cube.position_bits
    face, bary = sample_surface(surface.lattice.astype(np.float64), surface.faces, TRIAL_SAMPLES)
    source = pack_source(scene, surface.origin_face)
    reference = sample_source(source, face, bary, threads)
    points = np.einsum("nc,ncd->nd", bary, surface.lattice[surface.faces[face]]) * (resolution / (1 << bits))
    planes = 4 if codes_alpha(scene.materials, surface) else 3
    got = np.zeros((len(points), planes), np.float32)
    for number in range(int(face_field.max()) + 1):
        in_field = face_field == number
        keys, _ = voxelise(surface.lattice, surface.faces[in_field], bits, resolution, area_threshold, threads)
        sampled = np.flatnonzero(in_field[face])
        if len(keys) and len(sampled):
            brick_map = build_brick_map(keys)
            part = pack_source(scene, surface.origin_face[in_field])
            colour, alpha = transfer(surface.lattice, surface.faces[in_field], part, bits, resolution, keys, brick_map, 1,
                                     threads)
            values = colour if planes == 3 else np.column_stack([colour, alpha.astype(np.float32)])
            got[sampled] = query_field(points[sampled], resolution, keys, brick_map, values, threads)[0]
    error = ColourError()
    error.add(reference[:, :3], got[:, :3], np.maximum(reference[:, 3], 1) / 255)
    out = {"y": error.mse()["y"]}
    if planes == 4:
        out["alpha"] = alpha_mse(reference[:, 3], got[:, 3], surface.material[face], scene.materials)
    return out


def codes_alpha(materials: list[Material], surface: Surface) -> bool:
    """Return whether some material that the surface uses is not opaque, so that the stream has a plane of alpha."""
    return needs_alpha([materials[m] for m in np.unique(surface.material)])


class _Trials:
    """Comparison of partitions of one surface; measured errors are kept."""

    def __init__(self, scene, surface, price):
        self.scene, self.surface, self.price, self.measured = scene, surface, price, Cache()
        self.quick = max(price.resolution // 2, 1)

    def _errors(self, face_field, resolution):
        return self.measured.get((face_field.tobytes(), resolution), lambda: uncoded_errors(
            self.scene, self.surface, face_field, resolution, self.price.area_threshold, self.price.threads))

    def _gains(self, base, candidate, resolution):
        """Return (bytes that the smaller error of a candidate is worth, dB of each channel at the coded quality, a row for the
        report)."""
        before, after = self._errors(base, resolution), self._errors(candidate, resolution)
        decibel = {k: self.price.gain(before[k], after[k]) for k in before}
        worth = self.price.cost(0, sum(before[k] - after[k] for k in before))
        evidence = {"resolution": resolution, "gain_db": sum(decibel.values()), "gain_bytes": round(worth)}
        for k in before:
            evidence |= {f"psnr_{k}_before": decibels(before[k]), f"psnr_{k}_after": decibels(after[k])}
        return worth, decibel, json_ready(evidence)

    def pays(self, base, candidate):
        """Return (whether a candidate partition saves more error than its further fields cost, row for the report). base,
        candidate: int64 [F], field of each face. Half the resolution comes first, in a quarter of the time: surfaces are nearer
        to each other there, so a loss there is a loss at all K, and a gain of SURE_TIMES, like effort fast, needs no second
        measurement."""
        fee = FIELD_BYTES * int(candidate.max() - base.max())
        worth, _, evidence = self._gains(base, candidate, self.quick)
        if fee < worth < SURE_TIMES * fee and self.price.effort != "fast":
            worth, _, evidence = self._gains(base, candidate, self.price.resolution)
        return worth > fee, evidence

    def mixes_alpha(self, best, others):
        """Return whether any of the other partitions, int64 [F] each, shows alpha better than the best by SHOWN_GAIN."""
        return any(all(self._gains(best, other, r)[1]["alpha"] >= SHOWN_GAIN for r in (self.quick, self.price.resolution))
                   for other in others)


def _candidates(scene, surface, resolution):
    """Yield (face_field, folding components cut, Contacts): components, those cut at folds, then both with the layers of a
    component parted."""
    component = face_components(surface.faces)
    for parted in (component, part_layers(scene, surface, component)):
        if parted is None:
            continue
        contacts = find_contacts(surface.lattice, surface.faces, surface.cube.position_bits, resolution, parted)
        folding = folding_components(contacts)
        for split in [folding[:0], folding] if len(folding) else [folding]:
            yield colour_pieces(contacts, split), split, contacts


def _unbounded(candidate, split, contacts):
    """Return the candidates to compare alpha with: this one and, if it has as many fields as allowed, another one with more."""
    more = colour_pieces(contacts, split, MANY_FIELDS) if candidate.max() + 1 == MAX_FIELDS else candidate
    return [candidate] if more.max() == candidate.max() else [candidate, more]


def choose_fields(scene: Scene, surface: Surface, colours: np.ndarray, price: Lagrangian, partition: str,
                  step: Step = no_step) -> Decision[np.ndarray]:
    """Return the Decision on the partition of a surface over voxels into fields: the field number of every face, int64 [F].
    Candidates are fields by component, then also cut where components fold onto themselves, then by coincident layers; each is
    taken if it costs less. Warns if surfaces of different alpha stay in one field. colours: of material_colours(); partition: as
    of EncodeOptions; step: of Report.stage()."""
    best, off, alpha = np.zeros(len(surface.faces), np.int64), partition == "off", codes_alpha(scene.materials, surface)
    reason = _reason_for_one(surface, colours, off, alpha)
    if reason:
        return Decision(best, {"fields": 1, "reason": reason})
    trials, evidence, apart = _Trials(scene, surface, price), [], []
    reason = "switched off" if off else "no surfaces meet in a voxel"
    for number, (candidate, split, contacts) in enumerate(_candidates(scene, surface, price.resolution), 1):
        step(number, MOST_CANDIDATES + 1)
        if alpha:
            apart += _unbounded(candidate, split, contacts)
        if off or np.array_equal(candidate, best):
            continue
        pays, trial = trials.pays(best, candidate)
        evidence.append({"fields": int(candidate.max()) + 1, "folds_cut": len(split), **trial})
        if pays:
            best, reason = candidate, "surfaces meet in voxels"
        elif best.max() == 0:
            reason = "surfaces meet in voxels, but splitting them would not be visible"
    fields = int(best.max()) + 1
    mixed = (_mixed_alpha(fields, off),) if trials.mixes_alpha(best, apart) else ()
    return Decision(best, {"fields": fields, "reason": reason, "trials": evidence}, warnings=mixed)


def _reason_for_one(surface, colours, off, alpha):
    """Return why one field is enough without a trial; "" if that needs a trial."""
    if len(surface.faces) < 2:
        return "the mesh has one face"
    if off and not alpha:
        return "switched off"
    if uniform_colour(colours, surface.material) is not None:
        return "the surface has one colour, so no split can help"
    return "" if face_areas(surface.lattice, surface.faces).any() else "the surface has no area"


def _mixed_alpha(fields, off):
    why = ("partition is off" if off else f"the number of fields is limited to {MAX_FIELDS}" if fields == MAX_FIELDS
           else "splitting them would cost more colour than it gains")
    return f"surfaces of different alpha share voxels, so their alpha is mixed: {why}"
