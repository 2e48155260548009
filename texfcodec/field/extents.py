"""Counts that follow from a grid's resolution, and the bound of an image. It loads no numba, so that texf-info starts quickly."""

MAX_SIDE = 1 << 14  # of an image, in texels


def octree_depth(resolution: int) -> int:
    """Return the depth D of the octree over a grid of K = resolution cells a side: ceil(log2 K) (spec clause 7.1)."""
    return int(resolution - 1).bit_length()
