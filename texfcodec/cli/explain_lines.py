"""--explain-time of texf-enc: its flags, and its output."""

from collections.abc import Callable, Iterator

import click

from .flags import number

TEXT = "Report where the time goes, and measure the cost and gain of neighbouring settings: about eight more encodes."
SAID = {"better": "better than requested", "buys": "saves bytes", "saves": "saves time", "dominated": "no gain",
        "equal": "no difference", None: "no curve to compare with"}


def explain_flags(option: Callable) -> Callable[[Callable], Callable]:
    """Return a decorator that adds --explain-time and --explain-seconds to a click command. option: decorator factory of an
    OptionGroup, in place of click.option."""
    seconds = number(0.1, 1e6, "As --explain-time, but try settings for S seconds.  [default: 6 encodes]")
    return lambda command: option("--explain-time", is_flag=True, help=TEXT)(
        option("--explain-seconds", metavar="S", **seconds)(command))


def seconds_to_explain(choices: dict, dry_run: bool) -> float | None:
    """Take --explain-time and --explain-seconds out of choices (all flags by name) and return the seconds for trying other
    settings: 0 for the default, None without either flag. dry_run: the flag --dry-run, which excludes both."""
    explains, seconds = choices.pop("explain_time"), choices.pop("explain_seconds")
    if dry_run and (explains or seconds):
        raise click.UsageError("--explain-time and --dry-run cannot be combined")
    return seconds or (0.0 if explains else None)


def explain_lines(explained: dict) -> Iterator[str]:
    """Yield lines for people from the dict of encoder.explain.explain_time: seconds by stage, then a table of the settings
    tried, with their time, bytes and PSNR."""
    total = sum(explained["stages"].values()) or 1.0
    shown = sorted(explained["stages"].items(), key=lambda stage: -stage[1])
    yield "time by stage: " + ", ".join(f"{name} {seconds:.2f} s ({100 * seconds / total:.0f} %)"
                                              for name, seconds in shown if seconds >= 0.01 * total)
    base = explained["base"]
    rows = [("change", "s", "processor s", "bytes", "dB", "bytes at equal dB", "saved per extra second", ""),
            ("as requested", *_measured(base), "", "", _dominated(base))]
    for row in explained["neighbours"]:
        if "reason" in row:
            rows.append((row["change"], *[""] * 6, row["reason"]))
            continue
        percent = "" if row["percent"] is None else f"{row['percent']:+.1f} %"
        bought = "" if row["per_second"] is None else f"{row['per_second']:.1f} %"
        rows.append((row["change"], *_measured(row), percent, bought, SAID[row["verdict"]] + _dominated(row)))
    widths = [max(len(row[i]) for row in rows) for i in range(7)]
    for row in rows:
        cells = [cell.rjust(width) if i else cell.ljust(width) for i, (cell, width) in enumerate(zip(row, widths, strict=False))]
        yield "  " + "  ".join([*cells, row[7]]).rstrip()
    yield (f"whole stream; PSNR of Y of {explained['views']} views in daylight; a warm run each; extra seconds are processor "
           "seconds")
    if explained["not_tried"]:
        settings = ", ".join(explained['not_tried'])
        yield f"not tried within {explained['budget']:.0f} s: {settings}; raise --explain-seconds to try them"


def _dominated(row):
    return f"; dominated by {' and '.join(name or 'the request' for name in row['by'][:2])}" if row.get("by") else ""


def _measured(row):
    from ..core.colour_error import in_decibels

    return f"{row['seconds']:.2f}", f"{row['processor_seconds']:.2f}", f"{row['bytes']}", in_decibels(row["psnr_y"])
