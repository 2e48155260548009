"""Which partition pays: candidates are tried without coding, and the gain is weighed at the quality the QP will leave."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...core.colour_error import ColourError, decibels
from ...core.json_text import json_ready
from ...errors import InputError
from ...field.grid import build_brick_map
from ...field.query import query_field
from ...field.transfer import transfer
from ...field.voxelise import voxelise
from ...geometry.areas import face_areas, sample_surface
from ...metrics.parts import alpha_mse
from ...scene.channels import needs_alpha
from ...scene.fetch import pack_source, sample_source
from .depth_sheets import part_layers
from .one_colour import one_colour
from .partition import MAX_FIELDS, colour_pieces, face_components, find_contacts, folding_components

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...options import EncodeOptions
    from ...report import Report
    from ...scene.scene import Scene

TRIAL_SAMPLES = 1 << 17
SURE_GAIN = 1.0  # dB at half the resolution that settle the question
MIN_GAIN = 0.15  # dB at the coded quality; a further field costs about 150 bytes and 0.1 to 0.4 % more voxels
MANY_FIELDS = 256  # more than a stream may have: what alpha would be like without that bound
MOST_CANDIDATES = 4  # that _candidates() yields


def coding_mse(qp: int) -> float:
    """Rough luma error that coding at this QP leaves, for weighing gains: 6.4 at QP 28 (40 dB), growing with step**1.5."""
    return 6.4 * 2.0 ** ((qp - 28) / 4)


def bounded_mse(max_error: int) -> float:
    """Error of values that are evenly spread over the bound, their rounding included."""
    return (2 * max_error + 1) ** 2 / 12


def uncoded_errors(scene: Scene, surface: Surface, face_field: np.ndarray, options: EncodeOptions) -> dict[str, float]:
    """Mean squared errors {"y", "alpha"} of the uncoded fields against the source at TRIAL_SAMPLES surface points; "alpha" only
    where alpha is coded.

    surface: encoder's Surface; face_field: int64 [F], numbered from 0 without gaps.
    """
    bits, resolution, threads = surface.cube.position_bits, options.resolution, options.threads
    assert resolution is not None  # its __post_init__ fills it in
    face, bary = sample_surface(surface.lattice.astype(np.float64), surface.faces, TRIAL_SAMPLES)
    source = pack_source(scene, surface.origin_face)
    reference = sample_source(source, face, bary, threads)
    points = np.einsum("nc,ncd->nd", bary, surface.lattice[surface.faces[face]]) * (resolution / (1 << bits))
    planes = 4 if codes_alpha(scene, surface) else 3
    got = np.zeros((len(points), planes), np.float32)
    for number in range(int(face_field.max()) + 1):
        mine = face_field == number
        keys, _ = voxelise(surface.lattice, surface.faces[mine], bits, resolution, options.area_threshold, threads)
        asked = np.flatnonzero(mine[face])
        if len(keys) and len(asked):
            brick_map = build_brick_map(keys)
            part = pack_source(scene, surface.origin_face[mine])
            colour, alpha = transfer(surface.lattice, surface.faces[mine], part, bits, resolution, keys, brick_map, 1, threads)
            values = colour if planes == 3 else np.column_stack([colour, alpha.astype(np.float32)])
            got[asked] = query_field(points[asked], resolution, keys, brick_map, values, threads)[0]
    error = ColourError()
    error.add(reference[:, :3], got[:, :3], np.maximum(reference[:, 3], 1) / 255)
    out = {"y": error.mse()["y"]}
    if planes == 4:
        out["alpha"] = alpha_mse(reference[:, 3], got[:, 3], surface.material[face], scene.materials)
    return out


def codes_alpha(scene: Scene, surface: Surface) -> bool:
    """Whether a material in use is not opaque, so that the stream has a plane of alpha."""
    return needs_alpha([scene.materials[m] for m in np.unique(surface.material)])


class _Trials:
    """Weighs partitions of one surface against each other; an error once measured is kept."""

    def __init__(self, scene, surface, options):
        self.scene, self.surface, self.options, self.measured = scene, surface, options, {}
        self.quick = max(options.resolution // 2, 1)

    def _errors(self, face_field, resolution):
        key = (face_field.tobytes(), resolution)
        if key not in self.measured:
            options = replace(self.options, resolution=resolution)
            self.measured[key] = uncoded_errors(self.scene, self.surface, face_field, options)
        return self.measured[key]

    def _gain(self, base, candidate, resolution):
        """Gain in dB, at the coded quality, of a candidate over base: the sum over colour and, where it is coded, alpha. Then
        what the report says of it, and the part of alpha."""
        bound = self.options.max_error
        floor = coding_mse(self.options.reckoned_qp) if bound is None else bounded_mse(bound)
        before, after = self._errors(base, resolution), self._errors(candidate, resolution)
        gains = {k: decibels(after[k] + floor) - decibels(before[k] + floor) for k in before}
        told = {"resolution": resolution, "gain_db": sum(gains.values())}
        for k in before:
            told |= {f"psnr_{k}_before": decibels(before[k]), f"psnr_{k}_after": decibels(after[k])}
        return sum(gains.values()), json_ready(told), gains.get("alpha", 0.0)

    def pays(self, base, candidate):
        """Whether a candidate gains MIN_GAIN over base. Half the resolution is asked first, in a quarter of the time: surfaces
        are nearer to each other there, so what does not pay there never does, and SURE_GAIN there needs no second look."""
        gain, told, _ = self._gain(base, candidate, self.quick)
        if MIN_GAIN <= gain < SURE_GAIN:
            gain, told, _ = self._gain(base, candidate, self.options.resolution)
        return gain >= MIN_GAIN, told

    def mixes_alpha(self, best, others):
        """Whether one of the other partitions shows alpha by MIN_GAIN better than the best."""
        return any(all(self._gain(best, other, r)[2] >= MIN_GAIN for r in (self.quick, self.options.resolution))
                   for other in others)


def _candidates(scene, surface, options):
    """Yields (face_field, folding components cut, Contacts): components, those cut where they fold, then both with the layers of
    a component parted."""
    component = face_components(surface.faces)
    for parted in (component, part_layers(scene, surface, component)):
        if parted is None:
            continue
        contacts = find_contacts(surface.lattice, surface.faces, surface.cube.position_bits, options.resolution, parted)
        folding = folding_components(contacts)
        for split in [(), folding] if len(folding) else [()]:
            yield colour_pieces(contacts, split), split, contacts


def _unbounded(candidate, split, contacts):
    """The candidates to compare alpha with: this one and, where it has as many fields as there may be, one with more."""
    more = colour_pieces(contacts, split, MANY_FIELDS) if candidate.max() + 1 == MAX_FIELDS else candidate
    return [candidate] if more.max() == candidate.max() else [candidate, more]


def choose_fields(scene: Scene, surface: Surface, colours: np.ndarray, options: EncodeOptions,
                  report: Report) -> tuple[np.ndarray, dict]:
    """Field number of every face, int64 [F], and what the report says of it. Tries components, then also cut where they fold,
    then layers; takes what pays. Warns where surfaces of different alpha stay in one field (InputError TXF-I52 with strict).
    colours: of material_colours."""
    best, off, alpha = np.zeros(len(surface.faces), np.int64), options.partition == "off", codes_alpha(scene, surface)
    if len(surface.faces) < 2 or (off and not alpha):
        return best, {"fields": 1, "reason": "switched off" if len(surface.faces) > 1 else "one face"}
    if one_colour(colours, surface.material) is not None:
        return best, {"fields": 1, "reason": "one colour: nothing to part"}
    if not face_areas(surface.lattice, surface.faces).any():
        return best, {"fields": 1, "reason": "the surface has no area"}
    trials, told, apart = _Trials(scene, surface, options), [], []
    reason = "switched off" if off else "no surfaces meet in a voxel"
    for number, (candidate, split, contacts) in enumerate(_candidates(scene, surface, options), 1):
        report.progress("partition", number, MOST_CANDIDATES + 1)
        if alpha:
            apart += _unbounded(candidate, split, contacts)
        if off or np.array_equal(candidate, best):
            continue
        pays, trial = trials.pays(best, candidate)
        told.append({"fields": int(candidate.max()) + 1, "folds_cut": len(split), **trial})
        if pays:
            best, reason = candidate, "surfaces meet in voxels"
        elif best.max() == 0:
            reason = "surfaces meet, but splitting them would not show"
    if trials.mixes_alpha(best, apart):
        _tell_of_mixed_alpha(int(best.max()) + 1, options, report)
    return best, {"fields": int(best.max()) + 1, "reason": reason, "trials": told}


def _tell_of_mixed_alpha(fields, options, report):
    why = ("partition is off" if options.partition == "off" else f"there are no more than {MAX_FIELDS} fields"
           if fields == MAX_FIELDS else "parting them would cost more colour than it brings")
    sentence = f"surfaces of different alpha share voxels and stay in one field, so their alpha is mixed: {why}"
    if options.strict:
        raise InputError("TXF-I52", "something would be lost, and strict forbids it", warnings=[*report.warnings, sentence])
    report.warnings.append(sentence)
