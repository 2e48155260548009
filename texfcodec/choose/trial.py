"""Which partition pays: candidates are tried without coding, and the gain is weighed at the quality the QP will leave."""

from dataclasses import replace

import numpy as np

from ..asset.sample import pack_source, sample_source
from ..ground.colour_error import ColourError, decibels, sample_surface
from ..support.grid import build_brick_map
from ..support.query import query_field
from ..support.transfer import face_areas, transfer
from ..support.voxelise import voxelise
from .partition import colour_pieces, find_contacts, folding_components

TRIAL_SAMPLES = 1 << 17
SURE_GAIN = 1.0  # dB at half the resolution that settle the question
MIN_GAIN = 0.15  # dB at the coded quality; a further field costs about 150 bytes and 0.1 to 0.4 % more voxels


def coding_mse(qp):
    """Rough luma error that coding at this QP leaves, for weighing gains: 6.4 at QP 28 (40 dB), growing with step**1.5."""
    return 6.4 * 2.0 ** ((qp - 28) / 4)


def bounded_mse(max_error):
    """Error of values that are evenly spread over the bound, their rounding included."""
    return (2 * max_error + 1) ** 2 / 12


def uncoded_mse(scene, surface, face_field, options):
    """Luma error of the uncoded fields against the source at TRIAL_SAMPLES surface points.

    surface: encoder's Surface; face_field: int64 [F], numbered from 0 without gaps.
    """
    bits, resolution, threads = surface.cube.position_bits, options.resolution, options.threads
    face, bary = sample_surface(surface.lattice.astype(np.float64), surface.faces, TRIAL_SAMPLES)
    source = pack_source(scene, surface.origin_face)
    reference = sample_source(source, face, bary, threads)
    points = np.einsum("nc,ncd->nd", bary, surface.lattice[surface.faces[face]]) * (resolution / (1 << bits))
    got = np.zeros((len(points), 3), np.float32)
    for number in range(int(face_field.max()) + 1):
        mine = face_field == number
        keys, _ = voxelise(surface.lattice, surface.faces[mine], bits, resolution, options.area_threshold, threads)
        asked = np.flatnonzero(mine[face])
        if len(keys) and len(asked):
            brick_map = build_brick_map(keys)
            part = pack_source(scene, surface.origin_face[mine])
            colour, _ = transfer(surface.lattice, surface.faces[mine], part, bits, resolution, keys, brick_map, 1, threads)
            got[asked] = query_field(points[asked], resolution, keys, brick_map, colour, threads)[0]
    error = ColourError()
    error.add(reference[:, :3], got, np.maximum(reference[:, 3], 1) / 255)
    return error.mse()["y"]


class _Trials:
    """Weighs partitions of one surface against each other; an error once measured is kept."""

    def __init__(self, scene, surface, options):
        self.scene, self.surface, self.options, self.measured = scene, surface, options, {}

    def _mse(self, face_field, resolution):
        key = (face_field.tobytes(), resolution)
        if key not in self.measured:
            self.measured[key] = uncoded_mse(self.scene, self.surface, face_field, replace(self.options, resolution=resolution))
        return self.measured[key]

    def _gain(self, base, candidate, resolution):
        """Gain in dB, at the coded quality, of a candidate over base, and what the report says of it."""
        bound = self.options.max_error
        floor = coding_mse(self.options.reckoned_qp) if bound is None else bounded_mse(bound)
        before, after = self._mse(base, resolution), self._mse(candidate, resolution)
        gain = decibels(after + floor) - decibels(before + floor)
        told = {"psnr_y_before": decibels(before), "psnr_y_after": decibels(after)}
        return gain, {"resolution": resolution, "gain_db": gain, **told}

    def pays(self, base, candidate):
        """Whether a candidate gains MIN_GAIN over base. Half the resolution is asked first, in a quarter of the time: surfaces
        are nearer to each other there, so what does not pay there never does, and SURE_GAIN there needs no second look."""
        gain, told = self._gain(base, candidate, max(self.options.resolution // 2, 1))
        if MIN_GAIN <= gain < SURE_GAIN:
            gain, told = self._gain(base, candidate, self.options.resolution)
        return gain >= MIN_GAIN, told


def choose_fields(scene, surface, options, report):
    """Field number of every face, int64 [F], and what the report says of it. Tries components, then also cut where they fold;
    takes what pays."""
    best = np.zeros(len(surface.faces), np.int64)
    if options.partition == "off" or len(surface.faces) < 2:
        return best, {"fields": 1, "reason": "switched off" if len(surface.faces) > 1 else "one face"}
    if not face_areas(surface.lattice, surface.faces).any():
        return best, {"fields": 1, "reason": "the surface has no area"}
    contacts = find_contacts(surface.lattice, surface.faces, surface.cube.position_bits, options.resolution)
    folding = folding_components(contacts)
    trials, told, reason = _Trials(scene, surface, options), [], "no surfaces meet in a voxel"
    for split in [(), folding] if len(folding) else [()]:
        candidate = colour_pieces(contacts, split)
        if candidate.max() == best.max() == 0:
            continue
        pays, trial = trials.pays(best, candidate)
        told.append({"fields": int(candidate.max()) + 1, "folds_cut": len(split), **trial})
        if pays:
            best, reason = candidate, "surfaces meet in voxels"
        elif best.max() == 0:
            reason = "surfaces meet, but splitting them would not show"
    return best, {"fields": int(best.max()) + 1, "reason": reason, "trials": told}
