"""What a fit's seconds buy: table and plot of 3DNTC jobs beside those of a rival.

A table per asset, BD-rates of the fits with equal steps against each group of rivals, resident bytes without geometry; and, if
matplotlib is there, beside the page neural_time.png: PSNR against seconds of fitting, a line per size, the package's default
budget marked. Seconds are those of design, sampling, fitting and refinement.
"""

from texfcodec.options import DEFAULT_STEPS
from tools.bench.differences import rate_difference
from tools.bench.plots import load_pyplot
from tools.bench.result_tables import markdown_table
from tools.bench.results import PSNRS, at, grouped, rate_of, read_results

FIT = ("facts", "fit")
STAGES = ("design", "samples", "fit", "refine")


def fits_of(rows):
    """Return the rows of 3DNTC fits, by size and then by steps."""
    return sorted((row for row in rows if at(row, FIT)), key=lambda row: (rate_of(row, "texture"), at(row, FIT)["asked_steps"]))


def seconds_of(row):
    """Return a row's seconds from the decoded geometry to the payload."""
    return sum(at(row, ("seconds", "encode", stage)) or 0 for stage in STAGES)


def table_of(rows):
    """Return the lines of a Markdown table: one row per fit or rival, with all PSNRS."""
    lines = []
    for row in rows:
        fit = at(row, FIT)
        spent = (f"{fit['steps']:,}", f"{seconds_of(row):.0f}") if fit else ("", "")
        quality = (f"{at(row, path):.2f}" for path in PSNRS.values())
        lines.append([row["setting"], f"{rate_of(row, 'texture'):,}", *spent, *quality])
    return markdown_table(["", "resident bytes", "steps", "fit, s", *PSNRS], lines)


def of_equal_steps(rows):
    """Return {steps: its fits, one of each size} for steps with at least two sizes; refined fits are left out."""
    by_steps = {}
    for row in fits_of(rows):
        if at(row, ("facts", "refinement", "kind")) != "render":
            by_steps.setdefault(at(row, FIT)["asked_steps"], {})[rate_of(row, "texture")] = row
    return {steps: list(by_steps[steps].values()) for steps in sorted(by_steps) if len(by_steps[steps]) > 1}


def differences(ours, rivals):
    """Return the lines of a Markdown table: BD-rates in percent of our fits, by steps, against each group of rivals."""
    lines = [[f"{steps:,}", group, *(_difference(rows, own_rows, measure) for measure in PSNRS)]
             for steps, own_rows in ours.items() for group, rows in rivals.items()]
    return markdown_table(["steps", "against", *PSNRS], lines, 2)


def _difference(rival, ours, measure):
    try:
        return f"{rate_difference(rival, ours, measure):.1f} %"
    except ValueError:  # no common range of quality, or a larger payload that so few steps make no better
        return "none"


def curves_of(rows):
    """Return {size: its fits by steps} for sizes with at least two."""
    sizes = {}
    for row in fits_of(rows):
        sizes.setdefault(row["setting"].split("_")[1], []).append(row)
    return {size: members for size, members in sizes.items() if len(members) > 1}


def plot(assets, path):
    """Write the plot of the assets with a curve to path."""
    drawn = {asset: curves for asset, rows in assets.items() if (curves := curves_of(rows))}
    pyplot = load_pyplot() if drawn else None
    if pyplot is None:
        return
    figure, axes = pyplot.subplots(1, len(drawn), figsize=(6 * len(drawn), 4), squeeze=False)
    for ax, (asset, sizes) in zip(axes[0], drawn.items(), strict=True):
        for size, members in sizes.items():
            seconds, psnr = [seconds_of(r) for r in members], [at(r, PSNRS["3D-PSNR Y"]) for r in members]
            (line,) = ax.plot(seconds, psnr, "o-", label=f"{int(size) // 1000} kB")
            chosen = [i for i, r in enumerate(members) if at(r, FIT)["asked_steps"] == DEFAULT_STEPS]
            ax.plot([seconds[i] for i in chosen], [psnr[i] for i in chosen], "s", ms=12, mfc="none", mec=line.get_color())
        ax.set(xscale="log", xlabel="seconds of fitting, two cores", ylabel="3D-PSNR Y, dB", title=f"{asset} (square: default)")
        ax.grid(alpha=0.3)
        ax.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def page(args):
    """Return the lines of the page; the plot goes beside args.out. args: of collect.py."""
    assets = {}
    for row in (row for folder in args.results for row in read_results(folder)):
        assets.setdefault(row["asset"], []).append(row)
    lines = []
    for asset, rows in assets.items():
        rivals = {g: by[asset] for g, by in grouped([r for r in rows if not at(r, FIT)]).items()}
        lines += [f"## {asset}", "", *table_of(fits_of(rows) + [r for side in rivals.values() for r in side]), ""]
        if rivals and of_equal_steps(rows):
            lines += ["BD-rate:", "", *differences(of_equal_steps(rows), rivals), ""]
    plot(assets, args.out.with_name("neural_time.png"))
    return lines
