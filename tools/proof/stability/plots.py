"""Pictures of docs/reports/stability.md, where matplotlib is installed."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from tools.bench.plots import load_pyplot
from tools.proof.stability import floats, lattice, transform
from tools.proof.stability.case import Draws

SCALES, RUNS, BLOCKS = range(-289, 150, 3), 200, 600


def draw_scales(panel: object) -> None:
    """Error of positions against the scale of the mesh, at the origin and away from it."""
    for away, name in ((0, "at the origin"), (1e6, "1e6 extents away"), (1e12, "1e12 extents away")):
        worst = []
        for exponent in SCALES:
            rng, scale = np.random.default_rng(exponent + 1000), 10.0**exponent
            unit = np.concatenate([[[0] * 3, [1] * 3], rng.random((20, 3))])
            offset = min(scale * away, 0.8 * lattice.MAX_COORDINATE)
            worst.append(lattice.rounding_of(unit * scale + offset, 20))
        panel.plot(list(SCALES), worst, ".", markersize=3, label=name)
    panel.axhline(1, color="black", linewidth=0.8)
    panel.set(xlabel="scale, power of ten", ylabel="half lattice steps and an ulp", ylim=(0.6, 1.05))


def draw_levels(panel: object) -> None:
    """The largest error of fixed point after each level."""
    for total, children, name in ((transform.REACHABLE, transform.rebuilt, "kernels, 2^28 voxels"),
                                  (transform.BEYOND, transform.in_plain_integers, "clause, 2^40 voxels")):
        runs = [transform.levels_down(Draws(np.random.default_rng(i)), total, children) for i in range(RUNS)]
        panel.plot(range(1, transform.LEVELS + 1), np.max(runs, axis=0), "o-", markersize=3, label=name)
    levels = np.array([1, transform.LEVELS])
    panel.plot(levels, transform.ULPS_A_LEVEL * levels, color="black", linewidth=0.8, label="bound")
    panel.set(xlabel="level", ylabel="ulps of 1/4096 level")


def draw_ties(panel: object) -> None:
    """How near to a tie coefficients come, and how far the encoder's floats are off."""
    ties, errors = [], []
    for i in range(BLOCKS):
        scaled, exact, _, _ = floats.scaled_block(Draws(np.random.default_rng(i)))
        for node, (value, _) in exact.items():
            ties.append(float(abs(value % 1) - Decimal("0.5")))
            errors.append(float(abs(Decimal(float(scaled[node])) - value)))
    bins = np.arange(-18, 0.5, 0.5)
    for values, name in ((errors, "error of the floats"), (ties, "distance from a tie")):
        panel.hist(np.log10(np.maximum(np.abs(values), 1e-18)), bins, alpha=0.6, label=name)
    panel.set(xlabel="power of ten of a step", ylabel="coefficients", yscale="log")


# By file: the group that it belongs to, what is said of it, and what draws it
PICTURES = {
    "stability_scale.png": (lattice.GROUP, f"Worst of 22 positions on 20 bits at each of {len(SCALES)} scales: nothing depends "
                            "on the scale."),
    "stability_levels.png": (transform.GROUP, f"The furthest child of {RUNS} chains of random blocks, by level."),
    "stability_ties.png": (floats.GROUP, f"Coefficients of {BLOCKS} random blocks: how far the floats are off, and how far the "
                           "nearest tie is."),
}
DRAWN_BY = dict(zip(PICTURES, (draw_scales, draw_levels, draw_ties), strict=True))


def draw(folder: Path) -> list[str]:
    """Draws all pictures into a folder; their files, none where matplotlib is not installed."""
    pyplot = load_pyplot()
    if pyplot is None:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    for file, draw_panel in DRAWN_BY.items():
        figure, panel = pyplot.subplots(figsize=(6, 3))
        draw_panel(panel)
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
        figure.tight_layout()
        figure.savefig(folder / file, dpi=80)
        pyplot.close(figure)
    return list(PICTURES)
