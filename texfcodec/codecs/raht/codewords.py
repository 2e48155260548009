"""Counts that follow from the octree depth and the slicing; no numba here, so that texf-info starts quickly (spec clause 5.7)."""


def codeword_count(depth: int, slice_level: int, slices: int) -> int:
    """Return the number of codewords of an attribute unit: none for a single voxel, else one for the trunk (levels above
    slice_level), if there is a trunk, and one per slice."""
    if depth == 0:
        return 0
    return 1 + slices if slice_level > 0 else 1


def level_count(depth: int, slice_level: int, index: int) -> int:
    """Return the number of octree levels that codeword `index` codes; the trunk, if there is one, is codeword 0."""
    if slice_level == 0:
        return depth
    return slice_level if index == 0 else depth - slice_level
