"""Counts that follow from a grid's resolution; no numba here, so that texf-info stays quick."""


def octree_depth(resolution: int) -> int:
    """Depth D of the octree over a grid of resolution K: ceil(log2 K) (spec clause 7.1)."""
    return int(resolution - 1).bit_length()
