"""Properties of the objects in a glTF's JSON tree, checked as they are read."""

import math
from typing import Any

from ...errors import InputError


def malformed(what: str, **details: object) -> InputError:
    """Return the error for JSON that does not follow the glTF schema. what: the message; details: values beside it."""
    return InputError("TXF-I09", f"the glTF structure is malformed: {what}", **details)


def is_index(value: object) -> bool:
    """Return whether a JSON value is a non-negative integer; true and 1.0 are not."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def integer(entry: dict, key: str, default: int | None = None, low: int | None = None) -> int:
    """Return entry[key] as int, or default if it is absent; InputError if it is below low, or absent without a default."""
    value = entry.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or (low is not None and value < low):
        raise malformed(f"'{key}' is not a usable integer", value=str(value)[:40], low=low)
    return value


def numbers(entry: dict, key: str, default: float | tuple[float, ...]) -> Any:
    """Return entry[key], or default if it is absent, as a tuple of as many finite floats as default has, or as a float if default
    is a number."""
    value = entry.get(key, default)
    single = not isinstance(default, (tuple, list))
    items = [value] if single else value
    wanted = len(default) if isinstance(default, (tuple, list)) else 1
    if not isinstance(items, (tuple, list)) or len(items) != wanted or not all(_is_finite(item) for item in items):
        raise malformed(f"'{key}' is not {wanted} finite numbers", value=str(value)[:60])
    return float(value) if single else tuple(float(item) for item in items)


def _is_finite(value):
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def part(entry: dict, key: str) -> dict:
    """entry[key] as dict, {} if absent."""
    value = entry.get(key)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise malformed(f"'{key}' is not an object")
    return value


def extensions(entry: dict) -> dict:
    """The extensions object of an entry, {} if absent."""
    return part(entry, "extensions")


def name_of(entry: dict) -> str:
    """The entry's name, printable, or "". Lone surrogates, which JSON can hold, are replaced."""
    name = entry.get("name")
    return name.encode("utf-8", "replace").decode() if isinstance(name, str) else ""


def title(entry: dict, index: int) -> str:
    """Return how messages call an entry: by its name in quotes, the first 80 characters of it, or by its number, index."""
    return f"'{name_of(entry)[:80]}'" if name_of(entry) else str(index)
