"""A choice of the encoder: its value and the measurements behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..errors import InputError

if TYPE_CHECKING:
    from ..report import Report

Value = TypeVar("Value")


@dataclass(frozen=True)
class Decision(Generic[Value]):
    """value: the choice; evidence: reasons and measurements, JSON-ready, for the report; warnings, dropped, remarks: sentences
    for people, as those of a Report."""

    value: Value
    evidence: Any
    warnings: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def record(decision: Decision[Value], report: Report, strict: bool = False) -> Decision[Value]:
    """Append the decision's warnings, dropped properties and remarks to the report, and return the decision. strict: whether a
    decision with warnings raises InputError TXF-I52."""
    report.warnings += decision.warnings
    report.dropped += decision.dropped
    report.remarks += decision.remarks
    if strict and decision.warnings:
        raise InputError("TXF-I52", "the mesh would lose something, and strict forbids it", warnings=report.warnings)
    return decision
