"""Error of the voxels of a partition before any coding (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.colour_error import ColourError
from ...field.grid import build_brick_map
from ...field.query import query_field
from ...field.transfer import transfer
from ...field.voxelise import voxelise
from ...geometry.areas import sample_surface
from ...metrics.parts import alpha_mse
from ...scene.channels import needs_alpha
from ...scene.fetch import pack_source, sample_source

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Material, Scene

TRIAL_SAMPLES = 1 << 17


def uncoded_errors(scene: Scene, surface: Surface, face_field: np.ndarray, resolution: int, area_threshold: int,
                   threads: int) -> dict[str, float]:
    """Return mean squared errors {"y", "alpha"} of the uncoded fields against the source at TRIAL_SAMPLES surface points; "alpha"
    only if alpha is coded.

    surface: encoder's Surface; face_field: int64 [F], numbered from 0 without gaps.
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
    """Return whether a material in use is not opaque, so that the stream has a plane of alpha."""
    return needs_alpha([materials[m] for m in np.unique(surface.material)])
