"""Clause 7.7 in plain Python: the filter over the means of the voxels."""

from itertools import product

from naive.scales import entries_reached, sixteenths
from naive.voxels import clip

LARGEST = 2**22
ROUGHNESS_ENTRIES = (4, 8, 16, 32)
DIRECTIONS = [d for d in product((-1, 0, 1), repeat=3) if any(d)]


def taps_by_bit(mask, coefficients):
    """Clause 5.7.3: bit of filter_mask -> its three coefficients, for the bits that are set."""
    bits = [bit for bit in range(mask.bit_length()) if mask >> bit & 1]
    return {bit: coefficients[3 * i : 3 * i + 3] for i, bit in enumerate(bits)}


def filter_stage(means, mask, coefficients, luma_step):
    """One stage: dict from voxel (x, y, z) to its list of means -> the dict of the filtered means. luma_step: of component 0."""
    taps = taps_by_bit(mask, coefficients)
    return {voxel: filter_voxel(means, voxel, taps, luma_step) for voxel in means}


def filter_voxel(means, voxel, taps, luma_step):
    """Clause 7.7 for one voxel."""
    x, y, z = voxel
    own = means[voxel]
    ring = [[0, 0, 0] for _ in own]  # by component, of the neighbours across a face, an edge, a corner
    spread = count = 0
    for dx, dy, dz in DIRECTIONS:
        other = means.get((x + dx, y + dy, z + dz))
        if other is None:
            continue
        count += 1
        spread += abs(other[0] - own[0])
        for c in range(len(own)):
            ring[c][abs(dx) + abs(dy) + abs(dz) - 1] += other[c] - own[c]
    class_ = entries_reached(ROUGHNESS_ENTRIES, sixteenths(spread // max(1, count), luma_step))
    filtered = list(own)
    for c in range(len(own)):
        f = taps.get(class_ * len(own) + c)
        if f is not None:
            change = (sum(a * b for a, b in zip(f, ring[c], strict=True)) + 256) >> 9
            filtered[c] = clip(-LARGEST, LARGEST, own[c] + change)
    return filtered
