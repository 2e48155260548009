"""The curves of results as one HTML file that loads nothing: a Plotly figure an asset, a measure at a time, a line per group."""

import html
import sys

from tools.bench.results import curve_points, grouped, measures_of, value_of

FIRST = "image PSNR Y"  # the measure that curves begin with


def write_page(path, rows, kind):
    """Write the HTML page of rate curves; return its bytes, 0 without plotly. rows: of results; kind: which bytes count."""
    try:
        from plotly.io import to_html
    except ImportError:
        print("no curves: plotly is not installed; pip install \"texfcodec[plots]\" brings it", file=sys.stderr)
        return 0
    parts = ['<!doctype html><meta charset="utf-8"><title>Rate points</title>']
    for asset in dict.fromkeys(row["asset"] for row in rows):
        figure = figure_of([row for row in rows if row["asset"] == asset], kind)
        parts += [f"<h2>{html.escape(asset)}</h2>", to_html(figure, full_html=False, include_plotlyjs=len(parts) == 1)]
    path.write_text("\n".join(parts), encoding="utf-8")
    return path.stat().st_size


def figure_of(rows, kind):
    """Return Plotly's data and layout of the rate curves of one asset's rows. kind: which bytes count."""
    measures, data = measures_of(rows), []
    first = FIRST if FIRST in measures else next(iter(measures), None)
    for measure in measures:
        for group, by_asset in grouped(rows).items():
            points = curve_points(next(iter(by_asset.values())), measure, kind)
            data.append({"type": "scatter", "mode": "lines+markers", "name": html.escape(group), "meta": measure,
                         "x": [rate for rate, _, _ in points], "y": [quality for _, quality, _ in points],
                         "text": [html.escape(f"{row['setting']}: {value_of(row, measure):.4f}") for _, _, row in points],
                         "visible": measure == first})
    buttons = [{"label": measure, "method": "update", "args": [{"visible": [trace["meta"] == measure for trace in data]}]}
               for measure in measures]
    menu = {"buttons": buttons, "active": measures.index(first) if first else 0, "x": 0, "xanchor": "left", "y": 1.15}
    return {"data": data, "layout": {"height": 480, "xaxis": {"type": "log", "title": {"text": f"{kind} bytes"}},
                                     "yaxis": {"title": {"text": "dB"}}, "updatemenus": [menu]}}
