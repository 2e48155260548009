"""Sizes and variants of a 3DNTC fit that users may request; no numba here."""

LATENT_INDICES = ("mixed", "surface", "hash")
FIT_ENGINES = ("auto", "numba", "torch")
# The paper's operating points of 3DNTC: latents a row, then one table a level: voxels of a grid of 2048 that a cell of latents
# spans, log2 of the rows.
POINTS = {
    "mpeg1": (16, ((6, 15), (12, 14))), "mpeg2": (16, ((6, 16), (12, 15))), "mpeg3": (20, ((6, 16), (12, 15))),
    "mpeg4": (16, ((4, 17), (8, 16))), "mpeg5": (20, ((4, 17), (8, 16))), "mpeg6": (24, ((4, 17), (8, 16))),
    "aom1": (16, ((6, 16), (12, 15))), "aom2": (24, ((6, 16), (12, 15))), "aom3": (32, ((6, 16), (12, 15))),
    "aom4": (24, ((6, 17), (12, 16))), "aom5": (32, ((6, 17), (12, 16))),
}
DEFAULT_POINT = "mpeg1"
DEFAULT_STEPS = 15_000  # the end of the bend: docs/design/neural.md
