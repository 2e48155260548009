"""The plot of what accuracy costs: for each asset, bytes saved at equal quality against seconds, the front drawn."""

import math

from tools.accuracy_knobs import AUTO, HOME, STREAM
from tools.plots import load_pyplot, logarithmic

LEFT_OUT = ("QP", "position bits", "near-lossless D", "3DNTC steps", "3DNTC size", "threads")  # on the curve, or judged otherwise
LOWEST = -60  # percent of bytes saved: settings further down are drawn at the edge, with an arrow
GREEN, GREY, BLUE = "#1b7f3b", "#9a9a9a", "#1f4e9c"


def shown(asset):
    """[(label, Row)] of what is drawn: settings at the asset's home and presets, each measured setting once."""
    found = {}
    for name, rows in asset.rows.items():
        for row in rows:
            over = row.knob.over
            if over == STREAM or name in LEFT_OUT or row.percent is None or over not in (AUTO, HOME, asset.place.home):
                continue
            key = id(row.measured)
            label = row.name if name == "preset" else "default" if row.is_default and over != AUTO else f"{name} {row.name}"
            if key not in found or label == "default":
                found[key] = (label, row)
    return list(found.values())


def front_of(points):
    """Indices of the points [(seconds, saved)] that no other beats, by seconds."""
    order, best, front = sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1])), -math.inf, []
    for i in order:
        if points[i][1] > best:
            best = points[i][1]
            front.append(i)
    return front


def draw(assets, path):
    """The plot of Assets as a PNG; a sentence on stderr where matplotlib is not installed."""
    pyplot = load_pyplot()
    if pyplot is None:
        return
    columns = min(len(assets), 2)
    lines = math.ceil(len(assets) / columns)
    figure, panels = pyplot.subplots(lines, columns, figsize=(7.2 * columns, 4.6 * lines), squeeze=False)
    for panel, asset in zip(panels.flat, assets, strict=False):
        _draw_asset(panel, asset)
    for panel in list(panels.flat)[len(assets):]:
        panel.set_visible(False)
    figure.suptitle("What more encoding time buys: higher is smaller, left is faster", fontsize=14, weight="bold")
    figure.tight_layout(rect=(0, 0, 1, 0.98))
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _draw_asset(panel, asset):
    drawn = shown(asset)
    points = [(row.seconds[0], max(-row.percent, LOWEST)) for _, row in drawn]
    front = front_of(points)
    panel.axhline(0, color=GREY, lw=0.8)
    panel.plot([points[i][0] for i in front], [points[i][1] for i in front], "-", color=GREEN, lw=2, zorder=1)
    for i, ((label, row), (x, y)) in enumerate(zip(drawn, points, strict=True)):
        preset = row.knob.name == "preset"
        colour = BLUE if preset else GREEN if i in front else GREY
        marker = "s" if preset else "o" if i in front else "x"
        marker = "v" if y == LOWEST else marker
        bars = [[x - row.seconds[1]], [row.seconds[2] - x]]
        panel.errorbar(x, y, xerr=bars, fmt=marker, color=colour, ms=9 if label == "default" else 6, capsize=2, lw=1)
    _label(panel, [(label, *point, i in front) for i, ((label, _), point) in enumerate(zip(drawn, points, strict=True))])
    clock = "processor seconds, one thread" if asset.clock == "processor" else "seconds"
    panel.set(title=f"{asset.name}: colours in {asset.place.home}", xlabel=f"encode, {clock}",
              ylabel="bytes saved at equal 3D-PSNR, %")
    logarithmic(panel)
    panel.margins(x=0.18, y=0.14)
    panel.grid(alpha=0.25)


def _label(panel, labels):
    """Names beside their points, those of the front and of the defaults in bold, moved apart where they would meet."""
    panel.figure.canvas.draw()
    place = panel.transData.transform
    taken = []
    for label, x, y, front in sorted(labels, key=lambda one: (not one[3], -one[2])):
        left, base = place((x, y))
        width, height = 5.6 * len(label), 12
        for dx, dy in ((7, 4), (7, -12), (-7 - width, 4), (-7 - width, -12), (7, 17), (7, -25), (7, 30), (-7 - width, 17)):
            box = (left + dx, base + dy, left + dx + width, base + dy + height)
            if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
                break
        taken.append(box)
        panel.annotate(label, (x, y), xytext=(dx, dy), textcoords="offset pixels", fontsize=8,
                       weight="bold" if front or label == "default" else "normal", color="black" if front else "#555555")
