"""Plots of results, where matplotlib is installed."""

import sys

from bench.results import curve_of, grouped

PLOTTED = ("3D-PSNR Y", "image PSNR RGB")


def load_pyplot():
    """matplotlib's pyplot, which draws into files; None, and a sentence on stderr, where it is not installed."""
    try:
        import matplotlib
    except ImportError:
        print("no plots: matplotlib is not installed; pip install \"texfcodec[plots]\" brings it", file=sys.stderr)
        return None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def logarithmic(panel):
    """A logarithmic x axis that names plain numbers, some within a decade as well."""
    from matplotlib.ticker import LogLocator, NullFormatter

    panel.set_xscale("log")
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 4, 5, 6, 8)))
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter(NullFormatter())


def draw(rows, anchors, kind, out):
    """ASSET.png for each asset; False, and a sentence on stderr, where matplotlib is not installed."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    for asset in dict.fromkeys(r["asset"] for r in rows):
        figure, panels = pyplot.subplots(1, len(PLOTTED), figsize=(6 * len(PLOTTED), 4.5), squeeze=False)
        for panel, measure in zip(panels[0], PLOTTED, strict=True):
            _draw_panel(panel, asset, measure, kind, ((rows, "o-", ""), (anchors or [], "s--", " (anchor)")))
        figure.tight_layout()
        figure.savefig(out / f"{asset}.png", dpi=110)
        pyplot.close(figure)
    return True


def _draw_panel(panel, asset, measure, kind, sides):
    for rows, style, suffix in sides:
        for group, by_asset in grouped(rows).items():
            sizes, quality = curve_of(by_asset.get(asset, []), measure, kind)
            if sizes:
                panel.plot([size / 1000 for size in sizes], quality, style, label=group + suffix)
    panel.set(title=f"{asset}: {measure}", xlabel=f"{kind} bytes, thousands", ylabel="dB")
    logarithmic(panel)
    panel.grid(alpha=0.3)
    if panel.lines:
        panel.legend()
