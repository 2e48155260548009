"""texf-validate: everything that is wrong or odd in a stream."""

from functools import partial

import click

from ..errors import EXIT_DIFFERS, EXIT_LIMIT, EXIT_OK, EXIT_STREAM, EXIT_SUPPORT
from ..options import DecodeOptions
from ..precompile import DECODING
from ..validate.listing import WORST_FIRST
from .console import STYLE, run
from .flags import file_names, limit_flags, limits_of, option_flags, report_flags
from .inputs import read_streams

_IN_A_WORD = {EXIT_OK: "valid", EXIT_DIFFERS: "valid, with warnings", EXIT_STREAM: "invalid", EXIT_SUPPORT: "not supported",
              EXIT_LIMIT: "limit exceeded"}


@click.command("texf-validate", context_settings=STYLE)
@click.argument("file", metavar="FILE", shell_complete=file_names)
@click.option("--strict", is_flag=True, help="Return exit code 7 if there are warnings but no errors.")
@option_flags(DecodeOptions, "isolate")
@limit_flags("file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes", "isolate_bytes",
             "isolate_seconds")
@option_flags(DecodeOptions, "threads")
@report_flags("Print no findings; return the exit code.")
@click.pass_obj
def validate(console, file, strict, as_json, quiet, **choices):
    """List every error, warning and note about the .texf FILE ("-": stdin), or about the streams that a GLB carries. The
    tool decodes as much as it can, compares all checksums, and continues after errors.

    For files from unknown sources, use --isolate and lower the limits.

    Exit codes, by the worst finding: 0 valid, 3 invalid, 5 not supported, 6 limit exceeded, 7 valid with warnings (--strict); 1
    command line, 2 input or output, 4 internal, 130 interrupted.
    """
    from ..validate.sandboxed import validate_isolated
    from ..validate.validate import validate as validated

    limits, isolate = limits_of(choices), choices.pop("isolate")
    options = DecodeOptions(**{name: value for name, value in choices.items() if value is not None}, limits=limits)
    streams = read_streams(file, limits)
    console.note_first_run(DECODING)
    with console.progress() as report:
        outcomes = [(validate_isolated if isolate else validated)(data, limits, options.threads, report) for data in streams]
    if not console.as_json:
        console.warnings(report)
    for outcome in outcomes:
        codes = {True: outcome.pop("strict_exit_code"), False: outcome.pop("exit_code")}
        outcome["exit_code"] = codes[strict]
    worst = max((outcome["exit_code"] for outcome in outcomes), key=[EXIT_OK, EXIT_DIFFERS, *reversed(WORST_FIRST)].index)
    if len(outcomes) == 1:
        console.result({**outcomes[0], "warnings": report.warnings}, _lines(outcomes[0], worst))
    else:
        lines = (f"stream {number}: {line}" for number, outcome in enumerate(outcomes)
                 for line in _lines(outcome, outcome["exit_code"]))
        console.result({"streams": outcomes, "exit_code": worst, "warnings": report.warnings}, lines)
    return worst


def _lines(outcome, code):
    for row in outcome["findings"]:
        yield _line(row)
    for finding, count in outcome["left_out"].items():
        yield f"... and {count} more of {finding}"
    if outcome["not_checked"]:
        yield "not checked because of the errors above: " + ", ".join(_names(outcome["not_checked"]))
    counts = ", ".join(f"{count} {name}{'s' * (count != 1)}" for name, count in outcome["counts"].items())
    yield f"{_IN_A_WORD[code]}: {counts}"


def _line(row):
    """A finding in one line: the fault, its place, and the remedy."""
    unit = None if row["unit"] is None else f"unit {row['unit']} ({row['unit_name']})"
    byte, clause = ((None if row[name] is None else f"{word} {row[name]}") for name, word in (("offset", "at byte"),
                                                                                             ("clause", "clause")))
    facts = ", ".join(f"{name} {row[name]}" for name in ("value", "allowed") if row[name] is not None)
    place = ", ".join(filter(None, (byte, unit, clause)))
    return f"{row['severity']} {row['code']}{' ' * bool(place)}{place}: {row['message']}" + (f" ({facts})" if facts else "") + \
        f"; {row['remedy']}"


def _names(units):
    """Units in words; consecutive units of one type are grouped."""
    runs: list[list] = []  # [name, first, last]
    for unit in units:
        if runs and runs[-1][0] == unit["unit_name"] and runs[-1][2] == unit["unit"] - 1:
            runs[-1][2] = unit["unit"]
        else:
            runs.append([unit["unit_name"], unit["unit"], unit["unit"]])
    for name, first, last in runs:
        yield f"unit {first} ({name})" if first == last else f"units {first} to {last} ({name})"


main = partial(run, validate)

if __name__ == "__main__":
    main()
