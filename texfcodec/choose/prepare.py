"""From geometry and source to a field that can be coded: active voxels, their threshold and their colours (encoder only)."""

from dataclasses import dataclass

import numpy as np

from ..asset.sample import pack_source
from ..errors import LimitError
from ..support.grid import build_brick_map
from ..support.transfer import texels_per_edge, transfer
from ..support.voxelise import SAMPLES_PER_EDGE, count_samples, voxelise

# Two samples per texel along a voxel edge, but no more than this many, by effort; 3 saves 1.2 % of the bits over 2, 4 saves 2 %,
# 6 saves 2.2 % (basketball player)
TRANSFER_DENSITY = {"fast": 2, "balanced": 4, "best": 6}
FITTED_DENSITY = 2  # where a surface fit follows; 4 gains nothing then (BD-rate 0.0 to 0.1 % on two assets)
MOST_DROPPED = 0.1  # share of the surface that the area threshold may leave without a voxel of its own


@dataclass
class SourceField:
    """A field before coding. keys: int64 [N] ascending; threshold: the area threshold they were kept by; colour: float32 [N, 3]
    sRGB-coded 0..255; alpha: float32 [N] 0..255; texels_per_edge: how much finer
    than the voxels the textures are."""

    keys: np.ndarray
    threshold: int
    colour: np.ndarray
    alpha: np.ndarray
    texels_per_edge: float


def active_voxels(lattice, faces, position_bits, options):
    """Voxelises the decoded surface of one field: (keys int64 [N] ascending, area threshold). The configured threshold is taken
    unless it would leave more than MOST_DROPPED of the surface without voxels."""
    total = count_samples(lattice, faces, position_bits, options.resolution)
    if options.limits.samples is not None and total > options.limits.samples:
        raise LimitError("TXF-L05", "the surface needs more samples than the limit allows", value=total,
                         allowed=options.limits.samples)
    keys, weights = voxelise(lattice, faces, position_bits, options.resolution, 0, options.threads, options.limits.voxels)
    keep = weights >= options.area_threshold << 24
    if weights[~keep].sum(dtype=np.float64) > MOST_DROPPED * weights.sum(dtype=np.float64) or not keep.any():
        return keys, 0
    return keys[keep], options.area_threshold


def source_field(scene, surface, mine, decoded, options, report):
    """SourceField of the faces chosen by mine, bool [F]. decoded: (lattice, faces) as the decoder will have them."""
    bits = surface.cube.position_bits
    with report.stage("voxelise"):
        keys, threshold = active_voxels(*decoded, bits, options)
    with report.stage("transfer"):
        source = pack_source(scene, surface.origin_face[mine])
        textured = (surface.lattice, surface.faces[mine], source, bits, options.resolution)
        texels = texels_per_edge(*textured)
        most = FITTED_DENSITY if options.may_fit else TRANSFER_DENSITY[options.effort]
        density = int(np.clip(np.ceil(2 * texels), SAMPLES_PER_EDGE, most))
        colour, alpha = transfer(*textured, keys, build_brick_map(keys), density, options.threads)
    return SourceField(keys, threshold, colour, alpha, texels)
