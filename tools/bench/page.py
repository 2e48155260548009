"""The page of results: one HTML file with its tables, curves (Plotly) and pictures in it, which loads nothing."""

import base64
import hashlib
import html
import re
import sys
from pathlib import Path

from texfcodec.core.json_text import json_text
from tools.bench.jobs import METRICS, read_json
from tools.bench.results import curve_points, grouped, measures_of, value_of

KINDS = {".webp": "image/webp", ".png": "image/png"}
NOTHING = "'none'"
FIRST = "image PSNR Y"  # the measure that curves begin with
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 90rem; margin: auto; padding: 1rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { padding: .15rem .6rem; border-bottom: 1px solid #ccc; text-align: right; white-space: nowrap }
.text { text-align: left }
.wide { overflow: auto; max-height: 40rem; display: flex; gap: .5rem }
figure { margin: 0; flex: none }
figcaption { font-size: 12px; max-width: 320px }
img { width: 320px }
nav a { margin-right: 1rem }"""
SCRIPT = """
for (const block of document.querySelectorAll("script.curves")) {
  const place = document.createElement("div"), { data, layout } = JSON.parse(block.textContent);
  block.after(place);
  Plotly.newPlot(place, data, layout, { responsive: true, displaylogo: false });
}"""


def write_page(path, blocks, rows, kind, pictures):
    """Writes the page; its size in bytes.

    blocks: of result_tables.report(); rows: measured and published ones; kind: the rate of the curves; pictures: folder of the
    jobs whose pictures are embedded, or None.
    """
    plotly, body = _plotly(), []
    known = pictures_of(pictures) if pictures else {}
    for tag, content in blocks:
        if tag == "asset":
            here = [row for row in rows if row["asset"] == content]
            body += [*([_curves(here, kind)] if plotly else []), *_pictures(here, known)]
        else:
            body.append(as_html(tag, content))
    page = _page_of("\n".join(body), [content for tag, content in blocks if tag == "h2"], [plotly, SCRIPT] if plotly else [])
    path.write_bytes(page)
    return len(page)


def _plotly():
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        print("no curves: plotly is not installed; pip install \"texfcodec[plots]\" brings it", file=sys.stderr)
        return ""
    return get_plotlyjs()


def _page_of(body, heads, scripts):
    """The whole page, UTF-8; the browser may run these scripts and nothing else."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" for script in scripts)
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {hashes or NOTHING}"
    links = "".join(f'<a href="#{anchor_of(head)}">{html.escape(head)}</a>' for head in heads)
    return "\n".join(["<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
                      f'<meta http-equiv="Content-Security-Policy" content="{policy}">', "<title>Rate points</title>",
                      f"<style>{STYLE}</style></head><body>", f"<nav>{links}</nav>", body,
                      *(f"<script>{script}</script>" for script in scripts), "</body></html>\n"]).encode()


def anchor_of(head):
    """The place of a heading in the page."""
    return hashlib.sha256(head.encode()).hexdigest()[:12]


def as_html(tag, content):
    """A block of a report as HTML."""
    if tag == "ul":
        return "<ul>" + "".join(f"<li>{_text(text)}</li>" for text in content) + "</ul>"
    if tag != "table":
        return f'<{tag} id="{anchor_of(content)}">{_text(content)}</{tag}>'
    head, lines, texts = (*content, 1)[:3]
    rows = [[("th" if line is head else "td", ' class="text"' if place < texts else "", _text(cell))
             for place, cell in enumerate(line)] for line in (head, *lines)]
    cells = ("".join(f"<{name}{style}>{text}</{name}>" for name, style, text in row) for row in rows)
    return '<div class="wide"><table>' + "\n".join(f"<tr>{row}</tr>" for row in cells) + "</table></div>"


def _text(value):
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", html.escape(str(value)))


def _curves(rows, kind):
    """Plotly's data and layout of one asset, in a block of JSON that the script reads: a measure at a time, a line per group."""
    measures, data, groups = measures_of(rows), [], grouped(rows)
    first = FIRST if FIRST in measures else next(iter(measures), None)
    for measure in measures:
        for number, (group, by_asset) in enumerate(groups.items()):
            points = curve_points(next(iter(by_asset.values())), measure, kind)
            told = [f"{row['setting']}: {value_of(row, measure):.4f}" for _, _, row in points]
            data.append({"type": "scatter", "mode": "lines+markers", "name": html.escape(group), "legendgroup": str(number),
                         "x": [rate for rate, _, _ in points], "y": [quality for _, quality, _ in points],
                         "text": list(map(html.escape, told)), "meta": measure, "visible": measure == first,
                         "line": {"dash": "dot" if any("published" in row for _, _, row in points) else "solid"}})
    buttons = [{"label": measure, "method": "update", "args": [{"visible": [trace["meta"] == measure for trace in data]}]}
               for measure in measures]
    layout = {"height": 480, "xaxis": {"type": "log", "title": {"text": f"{kind} bytes"}}, "yaxis": {"title": {"text": "dB"}},
              "updatemenus": [{"buttons": buttons, "active": measures.index(first) if first else 0, "x": 0, "xanchor": "left",
                               "y": 1.15}]}
    text = json_text({"data": data, "layout": layout})
    for sign in "&<>":  # the element cannot end inside
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return f'<script type="application/json" class="curves">{text}</script>'


def pictures_of(folder):
    """{(asset, group, setting): {file's name without ending: path}} of the jobs' pictures: picture_VIEW and source_VIEW."""
    found = {}
    for path in sorted(Path(folder).glob(f"*/*/{METRICS}")):
        row = read_json(path) or {}
        files = [file for file in sorted(path.parent.glob("*_[0-9]*")) if file.suffix in KINDS]
        found[row.get("asset"), row.get("group"), row.get("setting")] = {file.stem: file for file in files}
    return found


def _pictures(rows, known):
    """The pictures of one asset side by side, a strip for each view, equal ones once."""
    strips = {}
    for row in sorted(rows, key=lambda row: (row["group"], row["bytes"]["total"])):
        for name, file in known.get((row["asset"], row["group"], row["setting"]), {}).items():
            side, _, view = name.partition("_")
            uri = f"data:{KINDS[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode()}"
            caption = "source" if side == "source" else f"{row['group']}: {row['setting']}, {row['bytes']['total']:,} bytes"
            strips.setdefault(view, {}).setdefault(uri, caption)
    for view in sorted(strips):
        shown = sorted(strips[view].items(), key=lambda pair: pair[1] != "source")
        yield '<div class="wide">' + "\n".join(f'<figure><img src="{uri}" alt=""><figcaption>{html.escape(caption)}</figcaption>'
                                               "</figure>" for uri, caption in shown) + "</div>"
