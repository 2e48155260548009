"""The page of what accuracy costs: claims first, then what a second buys, then the knobs."""

import math

from texfcodec.encoder.explain import BETTER, BUYS, DOMINATED, EQUAL, NOISE, SAVES
from tools.bench.accuracy_bench import IMAGE_SIZE, IMAGE_VIEWS, PROCESSOR, SMALL_K, SPENT, USUAL_K, WALL, reference_of
from tools.bench.accuracy_fronts import beaten_presets, steps_of, to_change
from tools.bench.accuracy_knobs import KNOBS, QP, STREAM, name_of
from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table, wrapped

SAID = {BETTER: "**better than the default**", BUYS: "buys bytes", SAVES: "saves time", DOMINATED: "no gain", EQUAL: "the same"}
CLOCKS = {WALL: "by the wall clock",
          PROCESSOR: f"in processor seconds, because the wall clock is not known to vary by {100 * NOISE:.0f} % at most"}
PICTURE = ("The green line is the front: no setting is both faster and smaller. Blue squares are the rate presets, grey crosses "
           f"what others beat, bars the fastest and slowest run. *default* is QP {QP} with all texels, or with K {USUAL_K} "
           f"({SMALL_K} where that is millions of voxels).")
CELLS = ("Seconds, bytes, dB, and in bold the bytes above the defaults' curve at equal quality; ~ marks what another value of "
         "the same knob dominates. An empty cell was not measured, or has no meaning for the asset.")


def page_of(assets, args, picture):
    """The whole page as Markdown. assets: [Asset]; args: of the command line; picture: path of the plot from the page."""
    lines = ["# What accuracy costs in time", "", _conditions_of(assets, args), "", _measures(assets), "",
             f"![bytes saved at equal quality against seconds, an asset a panel]({picture})", "", PICTURE, "",
             "## What one more second buys", "", *_steps(assets), "", "## To change", "", *_changes(assets), "",
             "## Presets", "", *_presets(assets), "", "## Knob by knob", "", CELLS, ""]
    for knob in KNOBS:
        lines += _knob(knob, assets, args.quick)
    return "\n".join(wrapped(lines)) + "\n"


def _conditions_of(assets, args):
    """A paragraph on what was measured, on which machine, and by which clock."""
    spreads = ", ".join(f"{asset.name} {100 * asset.spread:.0f} %" for asset in assets if math.isfinite(asset.spread))
    spread = f"the slowest run by the wall clock takes longer than the fastest by {spreads} (median over settings)"
    told = " or ".join(CLOCKS[clock] for clock in sorted({asset.clock for asset in assets}))
    many = f"{args.threads} thread{'s' * (args.threads != 1)}, {args.jobs} asset{'s' * (args.jobs != 1)} at a time"
    quick = " With `--quick`: few values, small references." if args.quick else ""
    names = ", ".join(asset.name for asset in assets)
    runs = f"the median of up to {args.repeats} runs (what has taken {SPENT:.0f} s is not repeated)"
    return (f"{names}; {many}, warm kernels; an encode without loading, {runs if args.repeats > 1 else 'once'}. "
            f"Seconds are told {told}: "
            f"{spread if spreads else 'there is one run of each, and no spread to be seen'}. Made by `make accuracy-time` "
            f"(tools/bench/accuracy_time.py), which writes this page for any assets, {made_on()}.{quick}")


def _measures(assets):
    """A paragraph on what the words mean."""
    shares = ", ".join(f"{asset.name} {100 * asset.geometry:.0f} %" for asset in assets)
    return (f"Bytes are those of the whole stream (geometry at QP {QP}: {shares}). *Bytes at equal quality* compares a setting "
            "with the curve that the defaults have over QP, at the setting's own 3D-PSNR of Y. A setting is dominated where "
            f"another is no worse and better in one thing, by more than {100 * NOISE:.0f} % of seconds, 0.1 % of bytes or "
            "0.01 dB.")


def _steps(assets):
    names = [asset.name for asset in assets]
    head = ["knob", "step", *names, "median", "a second more buys", "verdict"]
    rows = []
    for step in steps_of(assets):
        cells = [_trade(*step.trades[name][:2]) if name in step.trades else "" for name in names]
        bought = "" if step.bought is None else f"{step.bought:.1f} %"
        rows.append([step.knob.name, f"{name_of(step.knob.default)} to {name_of(step.value)}", *cells,
                     _trade(step.seconds, step.percent), bought, "hindsight" if step.knob.hindsight else SAID[step.verdict]])
    yield ("A step from the default, up or down: seconds, and bytes at equal quality. The verdict is what most assets say; "
           "*hindsight* is a value that the default may choose by itself, and pays for finding out.")
    yield ""
    yield from markdown_table(head, rows, 2)


def _trade(seconds, percent):
    return f"{seconds:+.2f} s, {percent:+.1f} %"


def _changes(assets):
    found = to_change(assets)
    if not found:
        return ["No preset and no default is dominated on any of these assets."]
    lines = []
    for what, names, asked, better in found:
        most = "most assets" if 2 * len(names) > asked else "some"
        lines.append(f"- **{what}** is dominated on {most}: {len(names)} of {asked} ({'; '.join(better)})")
    return lines


def _presets(assets):
    for asset in assets:
        beaten = beaten_presets(asset)
        rows = asset.rows.get("preset", [])
        told = [f"{row.name} {row.seconds[0]:.1f} s {row.measured.bytes:,} B {row.measured.psnr_y:.2f} dB"
                + (f" (beaten by {', '.join(beaten[row.value][:2])})" if beaten.get(row.value) else "") for row in rows]
        if told:
            yield f"- {asset.name}: {'; '.join(told)}"


def _knob(knob, assets, quick):
    """A table of one knob: a line per value, a column per asset."""
    mine = [asset for asset in assets if knob.name in asset.rows]
    if not mine:
        return []
    metric = knob.over == STREAM
    note = _note(knob, quick)
    values = [value for value in knob.values if any(row.value == value for asset in mine for row in asset.rows[knob.name])]
    rows = []
    for value in values:
        found = {asset.name: row for asset in mine for row in asset.rows[knob.name] if row.value == value}
        first = next(iter(found.values()))
        name = f"{first.name} (default)" if first.is_default else first.name
        rows.append([name, *(_cell(found[asset.name], metric) if asset.name in found else "" for asset in mine)])
    table = markdown_table([knob.name, *(asset.name for asset in mine)], rows)
    return [f"### {knob.name}", "", f"{knob.text[0].upper()}{knob.text[1:]}.{note}", "", *table, ""]


def _note(knob, quick):
    views, size, samples = reference_of(quick)
    if knob.name.startswith("views"):
        return f" Error against {views} views of {size} pixels, image PSNR of Y."
    if knob.name.startswith("samples"):
        return f" Root mean square error over seeds against {samples:,} samples, 3D-PSNR of Y."
    if knob.image and knob.name != "QP":
        return (f" Quality is image PSNR of Y over {IMAGE_VIEWS} views of {IMAGE_SIZE} pixels, because 3D-PSNR does not see "
                "where the surface has moved.")
    return ""


def _cell(row, metric):
    """Seconds with half their span, then the error of a metric, or bytes, dB and bytes at equal quality; ~ where dominated."""
    middle, least, most = row.seconds
    seconds = f"{middle:.2f} s" + (f" ±{(most - least) / 2:.2f}" if row.measured.runs > 1 else "")
    if metric:
        told = "lossless" if row.error is None else f"{row.error:.3f} dB"
    else:
        quality = "" if row.quality is None else f", {row.quality:.2f} dB"
        percent = "" if row.percent is None else f", **{row.percent:+.1f} %**"
        told = f"{row.measured.bytes:,} B{quality}{percent}"
    return f"{'~ ' if row.by else ''}{seconds}, {told}"


def csv_rows(assets):
    """Rows of points.csv, the head first: a row per value of a knob and asset."""
    yield ["asset", "knob", "value", "default", "home", "clock", "seconds", "least", "most", "processor_seconds", "wall_seconds",
           "runs", "bytes", "geometry", "psnr_y", "image_psnr_y", "percent_at_equal_quality", "error_db", "dominated_by"]
    for asset in assets:
        for name, rows in asset.rows.items():
            for row in rows:
                m = row.measured
                yield [asset.name, name, row.name, int(row.is_default), asset.place.home, asset.clock, *row.seconds,
                       m.seconds[PROCESSOR][0], m.seconds[WALL][0], m.runs, m.bytes or "", m.geometry or "",
                       *("" if q is None else q for q in (m.psnr_y, m.image_y, row.percent, row.error)), "; ".join(row.by)]
