"""Which partition pays: candidates are tried without coding, and the gain is weighed at the quality the QP will leave."""

import numpy as np

from ..asset.sample import pack_source, sample_source
from ..quality.psnr import ColourError, decibels, sample_surface
from .grid import build_brick_map
from .partition import colour_pieces, find_contacts, folding_components
from .query import query_field
from .transfer import transfer
from .voxelise import voxelise

TRIAL_SAMPLES = 1 << 17
MIN_GAIN = 0.15  # dB at the coded quality; a further field costs about 150 bytes and 0.1 to 0.4 % more voxels


def coding_mse(qp):
    """Rough luma error that coding at this QP leaves, for weighing gains: 6.4 at QP 28 (40 dB), growing with step**1.5."""
    return 6.4 * 2.0 ** ((qp - 28) / 4)


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
            colour, _ = transfer(surface.lattice, surface.faces[mine], part, bits, resolution, keys, brick_map, threads=threads)
            got[asked] = query_field(points[asked], resolution, keys, brick_map, colour, threads)[0]
    error = ColourError()
    error.add(reference[:, :3], got, reference[:, 3] / 255)
    return error.mse()["y"]


def choose_fields(scene, surface, options, report):
    """Field number of every face, int64 [F]. Tries components, then also cut where they fold; takes what pays, and says why."""
    single = np.zeros(len(surface.faces), np.int64)
    if options.partition == "off" or len(surface.faces) < 2:
        report.facts["partition"] = {"fields": 1, "reason": "switched off" if len(surface.faces) > 1 else "one face"}
        return single
    contacts = find_contacts(surface.lattice, surface.faces, surface.cube.position_bits, options.resolution)
    folding = folding_components(contacts)
    candidates = [colour_pieces(contacts)] + ([colour_pieces(contacts, folding)] if len(folding) else [])
    candidates = [c for c in candidates if c.max() > 0]
    if not candidates:
        report.facts["partition"] = {"fields": 1, "reason": "no surfaces meet in a voxel"}
        return single
    best, best_mse = single, uncoded_mse(scene, surface, single, options)
    first_mse, floor = best_mse, coding_mse(options.qp)
    for candidate in candidates:
        mse = uncoded_mse(scene, surface, candidate, options)
        if decibels(mse + floor) - decibels(best_mse + floor) >= MIN_GAIN:
            best, best_mse = candidate, mse
    fields = int(best.max()) + 1
    report.facts["partition"] = {
        "fields": fields,
        "reason": "surfaces meet in voxels" if fields > 1 else "surfaces meet, but splitting them would not show",
        "uncoded_psnr_y": {"one_field": decibels(first_mse), "chosen": decibels(best_mse)},
    }
    return best
