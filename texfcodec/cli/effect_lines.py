"""Lines for texf-enc and texf-info: counts in a stream, the decision, reasons and cost of each channel, and losses."""

from collections.abc import Iterator

from ..core.colour_error import in_decibels
from ..report import plural

DECISIONS = ("coded", "constant", "absent")
NAMED = 3  # losses in the result line


def counted(facts: dict) -> tuple[str, str]:
    """Return ("9 voxels, 7 texels", "2.500 attribute bits per voxel or texel") for the facts of an encoded stream (its counts
    and bytes); the second is "" without values."""
    places = [name for name in ("voxels", "texels") if facts[name]]
    total, nouns = sum(facts[name] for name in places), " or ".join(name.removesuffix("s") for name in places)
    counts = ", ".join(plural(facts[name], name.removesuffix("s"), name) for name in places or ["voxels"])
    return counts, f"{8 * facts['bytes']['attributes'] / total:.3f} attribute bits per {nouns}" if total else ""


def decision_lines(decisions: list[dict], channels: list[dict]) -> Iterator[str]:
    """Yield a line for each channel that a material in use has: whether it is coded, why, and at what cost.

    decisions: "decisions" of encoder.prepare.materials, one dict per channel; channels: one dict with names, bytes and PSNR per
    coded group of channels, [] before coding.
    """
    for entry in decisions:
        name = entry["channel"]
        counts = ", ".join(f"{decision} in {entry[decision]}" if sum(entry[d] > 0 for d in DECISIONS) > 1 else decision
                           for decision in DECISIONS if entry[decision])
        coded = [group for group in channels if {name, f"{name}_object"} & set(group["channels"])]
        cost = f"; {_cost(name, coded)}" if coded else ""
        yield f"  {name}: {counts} ({'; '.join(entry['reasons'])}){cost}"


def _cost(name, coded):
    """Bytes, error and milliseconds of the groups that a channel is in."""
    together = {other for group in coded for other in group["channels"]} - {name, f"{name}_object"}
    joint = f" with {', '.join(sorted(together))}" if together else ""
    worst = [group["psnr"].get(name, group["psnr"].get(f"{name}_object")) for group in coded]
    errors = [value for value in worst if value is not None]
    size, seconds = sum(group["bytes"] for group in coded), sum(group["encode_ms"] for group in coded)
    return f"{size} bytes{joint}, {in_decibels(min(errors) if errors else None)}, {seconds:.0f} ms"


def losses_in_words(facts: dict) -> str:
    """Return the end of a result line: the first losses and the number of others, or of warnings. facts: of a report."""
    dropped, warnings = facts["dropped"], facts["warnings"]
    if dropped:
        more = f" and {len(dropped) - NAMED} more, listed above" if len(dropped) > NAMED else ""
        return f"; losses: {', '.join(dropped[:NAMED])}{more}"
    return f"; {plural(len(warnings), 'warning', 'warnings')} listed above" if warnings else "; no losses"
