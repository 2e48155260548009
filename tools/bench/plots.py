"""Plots for pages of docs/, where matplotlib is installed."""

import sys


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


def logarithmic(panel, axis="x"):
    """Make an axis of a matplotlib panel logarithmic, labelled with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    panel.set(**{f"{axis}scale": "log"})
    ticks = getattr(panel, f"{axis}axis")
    ticks.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ticks.set_major_formatter("{x:g}")
    ticks.set_minor_formatter(NullFormatter())
