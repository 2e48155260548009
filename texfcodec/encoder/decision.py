"""What a choice of the encoder is: a value, and what was measured for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..errors import InputError

if TYPE_CHECKING:
    from ..report import Report

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


def record(decision: Decision[Value], report: Report, strict: bool = False) -> Decision[Value]:
    """Append the decision's messages to the report and return it. Raises InputError TXF-I52 if strict and it has warnings."""
    report.warnings += decision.warnings
    report.dropped += decision.dropped
    report.remarks += decision.remarks
    if strict and decision.warnings:
        raise InputError("TXF-I52", "the mesh would lose something, and strict forbids it", warnings=report.warnings)
    return decision
