"""Clause 7.7 in plain Python: the filter over the means of the voxels."""

from itertools import product

from conformance.reference.scales import entries_reached, sixteenths
from conformance.reference.voxels import clip

LARGEST = 2**22
ROUGHNESS_ENTRIES = (4, 8, 16, 32)
DIRECTIONS = [d for d in product((-1, 0, 1), repeat=3) if any(d)]


def taps_by_bit(mask, coefficients, count):
    """Clause 5.7.3: bit of filter_mask -> its coefficients, `count` of them, for the bits that are set."""
    bits = [bit for bit in range(mask.bit_length()) if mask >> bit & 1]
    return {bit: coefficients[count * i : count * i + count] for i, bit in enumerate(bits)}


def filter_stage(means, mask, coefficients, steps, planar):
    """One stage: dict from voxel (x, y, z) to its list of means -> the dict of the filtered means. steps: by component."""
    taps = taps_by_bit(mask, coefficients, 5 if planar else 3)
    return {voxel: filter_voxel(means, voxel, taps, steps, planar) for voxel in means}


def planar_rings(means, voxel, c, limit):
    """Clause 7.11.3: the five sums of one component."""
    x, y, z = voxel
    ring = [0] * 5
    for dx, dy in product((-2, -1, 0, 1, 2), repeat=2):
        other, size = means.get((x + dx, y + dy, z)), sorted((abs(dx), abs(dy)))
        if other is None or size not in ([0, 1], [1, 1], [0, 2]):
            continue
        difference, tap = other[c] - means[voxel][c], [[0, 1], [1, 1], [0, 2]].index(size)
        ring[tap] += difference
        if tap < 2:
            ring[3 + tap] += clip(-limit, limit, difference)
    return ring


def filter_voxel(means, voxel, taps, steps, planar):
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
    class_ = entries_reached(ROUGHNESS_ENTRIES, sixteenths(spread // max(1, count), steps[0]))
    if planar:
        ring = [planar_rings(means, voxel, c, steps[c] >> 2) for c in range(len(own))]
    filtered = list(own)
    for c in range(len(own)):
        f = taps.get(class_ * len(own) + c)
        if f is not None:
            change = (sum(a * b for a, b in zip(f, ring[c], strict=True)) + 256) >> 9
            filtered[c] = clip(-LARGEST, LARGEST, own[c] + change)
    return filtered
