"""Flags of the command lines, derived from the tables of options.py and limits.py, which hold range, default and text."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import click

from .. import __version__
from ..codecs import our_codecs
from ..limits import Limits
from ..options import DEFAULT_CODEC, FINEST_POSITIONS, words_of

MOST_PIXELS = 8192  # a side of a picture
FIBONACCI = 16  # views of the image metric
_OTHER_FLAGS = {"max_error": "--near-lossless", "batch_out": "--out"}
_LIMIT_DIGITS = 18
_LIMIT_TEXT = {
    "file_bytes": "of the stream",
    "vertices": "of all geometry units",
    "faces": "of all geometry units",
    "voxels": "and referenced texels, all fields",
    "texels": "of an image of a field",
    "image_pixels": "of an image of a mesh file",
    "samples": "of the surface, which take time",
    "latents": "of a payload",
    "metadata_bytes": "",
    "isolate_bytes": "memory of --isolate",
    "isolate_seconds": "time of --isolate",
}


def flag_of(name: str) -> str:
    """Return the flag of a field of options or of a parameter: --texel-size of "texel_size", --out of "batch_out"."""
    return _OTHER_FLAGS.get(name, "--" + name.replace("_", "-"))


def number(low: float, high: float, text: str = "") -> dict[str, Any]:
    """Return the keywords type, callback and help of a click option whose value is a number in low..high: an integer, or a float
    if low is a float. text: its help."""

    def check(context, parameter, value):
        if value is not None and not low <= value <= high:
            raise click.BadParameter(f"{value} is outside {low}..{high}.")
        return value

    return {"type": type(low), "callback": check, "help": text}


def file_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list:
    """Complete a file name: a shell_complete callback that leaves the work to the shell. incomplete: the word typed so far."""
    from click.shell_completion import CompletionItem

    return [CompletionItem(incomplete, type="file")]


def option_flags(kind: type, *names: str, option: Callable = click.option) -> Callable[[Callable], Callable]:
    """Return a decorator that adds a flag for each named field of an options class. A flag that the user does not give has the
    value None, or False for a switch. kind: EncodeOptions or DecodeOptions; option: click.option, or that of an OptionGroup."""
    table = {named.name: named for named in fields(kind)}

    def decorate(function):
        for name in reversed(names):
            function = option(flag_of(name), name, **_keywords(table[name]))(function)
        return function

    return decorate


def _keywords(option):
    facts = option.metadata
    text = facts["text"] + _default_text(option)
    if "allowed" in facts:
        return {"type": click.Choice(list(words_of(option))), "metavar": facts["metavar"], "help": text}
    if "range" in facts:
        low, high = facts["range"]
        return {**number(low, high, text), "metavar": facts["metavar"]}
    if "switch" in facts:
        return {"is_flag": True, "help": text}
    return {"metavar": facts["metavar"], "help": text, "shell_complete": file_names}


def _default_text(option):
    if option.name == "codec":
        purposes = "; ".join(f"{codec.name} {codec.purpose}" for codec in our_codecs() if codec.chosen)
        return f" {purposes}.  [default: {option.default}]"
    if option.name == "position_bits":
        usual = {codec.name: codec.position_bits for codec in our_codecs() if codec.chosen}
        others = "".join(f"; {name} {bits}" for name, bits in usual.items() if name != DEFAULT_CODEC)
        return f"  [default: {usual[DEFAULT_CODEC]}, or up to {FINEST_POSITIONS} with texels{others}]"
    return "" if option.default is None or option.default is False else f"  [default: {option.default}]"


def pose_flags() -> Callable[[Callable], Callable]:
    """Return a decorator that adds --time and --animation to a click command, whose values pose_of() reads."""

    def check(context, parameter, given):
        words = [word for text in given for word in text.split(",")]
        try:
            times = tuple(float(word) for word in words)
        except ValueError:
            times = (math.nan,)
        if not all(map(math.isfinite, times)):
            raise click.BadParameter(f"{','.join(words)!r} must be finite numbers of seconds.")
        return times

    def decorate(function):
        function = click.option("--animation", metavar="NAME|N", help="Animation of --time.  [default: the first]")(function)
        return click.option("--time", "times", multiple=True, metavar="SECONDS", callback=check,
                            help="Pose glTF files as their animation does at a time; several, separated by commas, one after "
                                 "the other. Times outside of it give its first or last pose.")(function)

    return decorate


def pose_of(choices: dict) -> tuple[tuple[float, ...], str | None] | None:
    """Take the values of the flags of pose_flags() out of choices (all flags by name) and return them as (times, animation); None
    without --time. Raises click.UsageError for --animation alone."""
    times, animation = choices.pop("times"), choices.pop("animation")
    if animation is not None and not times:
        raise click.UsageError("--animation requires --time")
    return (times, animation) if times else None


def limit_flags(*names: str, option: Callable = click.option) -> Callable[[Callable], Callable]:
    """Return a decorator that adds --limit NAME=N for the named fields of Limits, whose values limits_of() reads. option:
    click.option, or that of an OptionGroup."""
    shown = [f"{name.replace('_', '-')}={getattr(Limits(), name)}" for name in names]
    lines = [f"{text:{max(map(len, shown))}}  {_LIMIT_TEXT[name]}".rstrip() for text, name in zip(shown, names, strict=True)]
    text = "Limit NAME to N; 0 for no limit. May be repeated.\n\n\b\n[default:\n" + "\n".join(lines) + "]"

    def check(context, parameter, given):
        for word in given:
            name, _, count = word.partition("=")
            if name.replace("-", "_") not in names:
                raise click.BadParameter(f"{name!r} is not a limit; choose {', '.join(names).replace('_', '-')}.")
            if not (count.isascii() and count.isdigit() and len(count) <= _LIMIT_DIGITS):
                raise click.BadParameter(f"{word!r} must be {name}=N with an integer N of at most {_LIMIT_DIGITS} digits.")
        return given

    return option("--limit", multiple=True, metavar="NAME=N", callback=check, help=text)


def limits_of(choices: dict) -> Limits:
    """Take the values of the flag of limit_flags() out of choices (all flags by name) and return them as Limits."""
    pairs = (word.split("=") for word in choices.pop("limit"))
    return Limits(**{name.replace("-", "_"): int(count) for name, count in pairs})


def report_flags(quiet: str = "Print only errors: no progress, warnings or summary.", *,
                 names_engine: bool = False) -> Callable[[Callable], Callable]:
    """Return a decorator that adds --json, --quiet and --version to a click command. quiet: help text of --quiet; names_engine:
    --version also prints the engine that decodes a stream first."""

    def show(context, parameter, given):
        if given:
            click.echo(f"{context.info_name} {__version__}" + (f"\nengine: {_engine_in_words()}" if names_engine else ""))
            context.exit()

    def decorate(function):
        function = click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=show,
                                help="Show the version and exit.")(function)
        function = click.option("--quiet", is_flag=True, help=quiet)(function)
        return click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, errors included.")(function)

    return decorate


def _engine_in_words():
    from ..options import DecodeOptions
    from ..sandbox import engines, native

    words = {"native": "native, the C++ library", "wasm": "wasm, until kernels are compiled", "numba": "numba, compiled kernels"}
    return words[engines.first_engine(DecodeOptions())] + (f"; {native.fault()}" if native.fault() else "")


def size_of(context: click.Context, parameter: click.Parameter, value: str) -> tuple[int, int]:
    """Return (width, height) in pixels of "N" or "WxH": callback of the option --size. Raises click.BadParameter."""
    parts = value.lower().split("x")
    if len(parts) > 2 or not all(p.isascii() and p.isdigit() and 1 <= int(p) <= MOST_PIXELS for p in parts):
        raise click.BadParameter(f"{value} is neither N nor WxH with sides in 1..{MOST_PIXELS}.")
    return int(parts[0]), int(parts[-1])


def direction_of(context: click.Context, parameter: click.Parameter, value: str) -> tuple[float, ...]:
    """Return the direction (x, y, z) from the object to the camera for the name of a view, "fibonacci:I" or "AZIMUTH,ELEVATION"
    in degrees: callback of the option --view. Raises click.BadParameter."""
    from ..render.camera import VIEWS, direction_of_angles, fibonacci_direction

    name, _, index = value.partition(":")
    if value in VIEWS:
        return VIEWS[value]
    if name == "fibonacci" and index.isascii() and index.isdigit() and int(index) < FIBONACCI:
        return tuple(fibonacci_direction(int(index), FIBONACCI))
    try:
        angles = [float(part) for part in value.split(",")]
    except ValueError:
        angles = []
    if len(angles) != 2 or not all(map(math.isfinite, angles)):
        raise click.BadParameter(f"{value} is not a view; choose {', '.join(VIEWS)}, fibonacci:0..{FIBONACCI - 1} or "
                                 "AZIMUTH,ELEVATION.")
    return tuple(direction_of_angles(*angles))
