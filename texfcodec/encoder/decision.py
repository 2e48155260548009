"""What a choice of the encoder is: a value, and what was measured for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")


@dataclass(frozen=True)
class Decision(Generic[Value]):
    """value: what was chosen; evidence: why, JSON-ready, for the report; warnings, dropped, remarks: sentences for people, as
    those of a Report."""

    value: Value
    evidence: Any
    warnings: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
