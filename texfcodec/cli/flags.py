"""Flags of the command lines, made from the tables of options.py and limits.py: range, default and text are said there."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import click

from ..codecs import our_codecs
from ..limits import Limits
from ..options import DEFAULT_CODEC, FINEST_POSITIONS, words_of

MOST_PIXELS = 8192  # a side of a picture
FIBONACCI = 16  # views of the image metric
_LIMIT_TEXT = {
    "file_bytes": "bytes of the stream",
    "vertices": "vertices over all geometry units",
    "faces": "faces over all geometry units",
    "voxels": "active voxels and referenced texels over all fields",
    "texels": "texels of an image of a field, referenced or not",
    "image_pixels": "pixels of an image of a mesh file",
    "samples": "surface samples and rows of texels, which take time",
    "latents": "latents of a payload",
    "metadata_bytes": "bytes of metadata",
    "isolate_bytes": "bytes of memory in the sandbox of --isolate",
    "isolate_seconds": "seconds in the sandbox of --isolate",
}


def number(low: float, high: float, text: str = "") -> dict[str, Any]:
    """Keywords of a click option that takes a whole number (or, with a float low, any number) in low..high."""

    def check(context, parameter, value):
        if value is not None and not low <= value <= high:
            raise click.BadParameter(f"{value} is outside {low}..{high}.")
        return value

    return {"type": type(low), "callback": check, "help": text}


def file_names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list:
    """For shell_complete of what names a file: the shell itself completes it."""
    from click.shell_completion import CompletionItem

    return [CompletionItem(incomplete, type="file")]


def option_flags(kind: type, *names: str) -> Callable[[Callable], Callable]:
    """Decorator: a flag for each of these fields of EncodeOptions or DecodeOptions; None, or False, where it is not given."""
    table = {option.name: option for option in fields(kind)}

    def decorate(function):
        for name in reversed(names):
            option = table[name]
            function = click.option("--" + name.replace("_", "-"), name, **_keywords(option))(function)
        return function

    return decorate


def _keywords(option):
    told = option.metadata
    text = _owner_of(option.name) + told["text"] + _default_text(option)
    if "allowed" in told:
        return {"type": click.Choice(list(words_of(option))), "metavar": told["metavar"], "help": text}
    if "range" in told:
        low, high = told["range"]
        return {**number(low, high, text), "metavar": told["metavar"]}
    if "switch" in told:
        return {"is_flag": True, "help": text}
    return {"metavar": told["metavar"], "help": text, "shell_complete": file_names}


def _owner_of(name):
    """The codec's name, put before the text of an option that only a codec other than the usual one reads."""
    owners = [codec.name for codec in our_codecs() if name in codec.options]
    return f"{owners[0]}: " if len(owners) == 1 and owners != [DEFAULT_CODEC] else ""


def _default_text(option):
    if option.name == "codec":
        purposes = "; ".join(f"{codec.name} {codec.purpose}" for codec in our_codecs() if codec.chosen)
        return f" {purposes}.  [default: {option.default}]"
    if option.name == "position_bits":
        usual = {codec.name: codec.position_bits for codec in our_codecs() if codec.chosen}
        others = "".join(f"; {name} {bits}" for name, bits in usual.items() if name != DEFAULT_CODEC)
        return f"  [default: {usual[DEFAULT_CODEC]}, or up to {FINEST_POSITIONS} with texels{others}]"
    return "" if option.default is None or option.default is False else f"  [default: {option.default}]"


def limit_flags(*names: str) -> Callable[[Callable], Callable]:
    """Decorator: a flag --max-NAME for each of these fields of Limits; read them back with limits_of."""

    def decorate(function):
        for name in reversed(names):
            default = getattr(Limits(), name)
            settings = number(0, 1 << 62, f"Maximum {_LIMIT_TEXT[name]}; 0 for no limit.  [default: {default}]")
            flag = "--max-" + name.replace("_", "-")
            function = click.option(flag, "max_" + name, default=default, metavar="N", **settings)(function)
        return function

    return decorate


def limits_of(choices: dict) -> Limits:
    """Takes the values of limit_flags out of the dict of choices and makes Limits of them."""
    return Limits(**{name[4:]: choices.pop(name) for name in list(choices) if name.startswith("max_")})


def size_of(context: click.Context, parameter: click.Parameter, value: str) -> tuple[int, int]:
    """(width, height) of N or WxH: callback of a --size in pixels."""
    parts = value.lower().split("x")
    if len(parts) > 2 or not all(p.isascii() and p.isdigit() and 1 <= int(p) <= MOST_PIXELS for p in parts):
        raise click.BadParameter(f"{value} is neither N nor WxH with sides in 1..{MOST_PIXELS}.")
    return int(parts[0]), int(parts[-1])


def direction_of(context: click.Context, parameter: click.Parameter, value: str) -> tuple[float, ...]:
    """Direction from the object to the camera of a view's name: callback of a --view."""
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
