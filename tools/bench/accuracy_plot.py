"""The plot of what accuracy costs: for each asset, bytes saved at equal quality against seconds, the front drawn."""

import math

from texfcodec.encoder.explain import EQUAL, verdict
from tools.bench.accuracy_knobs import AUTO, HOME, STREAM, encode_setting
from tools.bench.plots import load_pyplot, logarithmic

LEFT_OUT = ("QP", "position bits", "near-lossless D", "3DNTC steps", "3DNTC size", "threads")  # on the curve, or judged otherwise
LOWEST, SPAN = -40, 5  # percent saved: what is further down is drawn at the edge; what an axis shows each way at least
GREEN, GREY, BLUE = "#1b7f3b", "#9a9a9a", "#1f4e9c"


def shown(asset):
    """[(label, Row)] of what is drawn: settings at the asset's home and presets, each measured setting once."""
    found, base = {}, encode_setting(asset.place.base(HOME))
    for name, rows in asset.rows.items():
        for row in rows:
            over = row.knob.over
            left_out = name in LEFT_OUT or over == STREAM or row.knob.hindsight or row.percent is None
            if left_out or over not in (AUTO, HOME, asset.place.home):
                continue
            key, is_base = id(row.measured), row.measured.setting["options"] == base["options"]
            label = row.name if name.startswith("preset") else "default" if is_base else f"{name} {row.name}"
            if key not in found or label == "default":
                found[key] = (label, row)
    rest = [row for label, row in found.values() if label == "default"]
    return [(label, row) for label, row in found.values() if label == "default" or not any(_same(row, one) for one in rest)]


def _same(row, base):
    """Whether a Row would be drawn upon the defaults'."""
    return verdict(base.seconds[0], row.seconds[0], row.percent - base.percent) == EQUAL


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
    panel.set_title(f"{asset.name}: colours in {asset.place.home}")
    if not drawn:
        panel.text(0.5, 0.5, "nothing to compare at equal quality", ha="center", transform=panel.transAxes)
        return
    points = [(row.seconds[0], max(-row.percent, LOWEST)) for _, row in drawn]
    front = front_of(points)
    panel.axhline(0, color=GREY, lw=0.8)
    panel.plot([points[i][0] for i in front], [points[i][1] for i in front], "-", color=GREEN, lw=2, zorder=1)
    for i, ((label, row), (x, y)) in enumerate(zip(drawn, points, strict=True)):
        preset = row.knob.over == AUTO
        colour = BLUE if preset else GREEN if i in front else GREY
        marker = "s" if preset else "o" if i in front else "x"
        marker = "v" if y == LOWEST else marker
        bars = [[x - row.seconds[1]], [row.seconds[2] - x]]
        panel.errorbar(x, y, xerr=bars, fmt=marker, color=colour, ms=9 if label == "default" else 6, capsize=2, lw=1)
    clock = "processor seconds, one thread" if asset.clock == "processor" else "seconds"
    panel.set(xlabel=f"encode, {clock}", ylabel="bytes saved at equal 3D-PSNR, %")
    logarithmic(panel)
    panel.margins(x=0.18, y=0.14)
    low, high = panel.get_ylim()
    panel.set_ylim(min(low, -SPAN), max(high, SPAN))
    panel.grid(alpha=0.25)
    _label(panel, [(label, *point, i in front) for i, ((label, _), point) in enumerate(zip(drawn, points, strict=True))])


def _label(panel, labels):
    """Names beside their points, those of the front and of the defaults in bold, moved apart where they would meet."""
    panel.figure.canvas.draw()
    place = panel.transData.transform
    taken = []
    for label, x, y, front in sorted(labels, key=lambda one: (one[0] != "default", not one[3], -one[2])):
        left, base = place((x, y))
        width, height = 5.6 * len(label), 12
        for dx, dy in ((7, 4), (7, -12), (-7 - width, 4), (-7 - width, -12), (7, 17), (7, -25), (7, 30), (-7 - width, 17)):
            box = (left + dx, base + dy, left + dx + width, base + dy + height)
            if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
                break
        taken.append(box)
        panel.annotate(label, (x, y), xytext=(dx, dy), textcoords="offset pixels", fontsize=8,
                       bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.5},
                       weight="bold" if front or label == "default" else "normal", color="black" if front else "#555555")
