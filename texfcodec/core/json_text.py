"""Writes the JSON of every report. JSON has no infinity and no NaN, and strict readers refuse a document that contains one. Only
this module writes such numbers, as null."""

import json
import math
from collections.abc import Mapping
from typing import Any


def json_ready(value: Any) -> Any:
    """Return a copy of value that json.dumps accepts, converted at any depth.

    Infinite numbers (PSNR of exact values) and NaN become None. Numbers and arrays of numpy become Python's, mappings become
    dicts with text keys, other sequences and sets become lists, and anything else becomes its str(). Any: the union of all these
    types.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key if isinstance(key, str) else str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [json_ready(item) for item in value]
    if hasattr(value, "tolist"):  # of numpy, which need not be imported for this
        return json_ready(value.tolist())
    return str(value)


def json_text(value: Any, **layout: Any) -> str:
    """JSON text of json_ready(value). layout: keywords of json.dumps, such as indent."""
    return json.dumps(json_ready(value), allow_nan=False, **layout)
