"""Validation of a whole stream: what the decoder refuses it for, what else is wrong behind that, and what is odd.

The walk is the decoder's (spec 9.2), over its own functions, so that the first error is the one that the decoder raises. Behind
an error it goes on with what does not need the part at fault; what needs it is named as not checked, and gets no error of its
own.
"""

from __future__ import annotations

from ..bitstream.inspect import inspect
from ..errors import TexfError
from ..findings import ERROR
from ..limits import Limits
from ..options import DecodeOptions
from ..report import Report
from .contents import decode_contents
from .syntax_check import parse

ROW = {"code", "severity", "clause", "unit", "unit_type", "unit_name", "offset", "value", "allowed", "message", "remedy"}
OUTCOME = {"findings", "counts", "left_out", "not_checked", "exit_code", "strict_exit_code", "facts"}


def validate(data: bytes, limits: Limits | None = None, threads: int = 1, report: Report | None = None,
             failure: TexfError | None = None) -> dict:
    """Everything that is wrong or odd in a .texf stream.

    data: bytes; report: Report, which gets seconds by stage; failure: what became of whoever looked into Draco and the fields
    elsewhere: then nothing is decoded here. Returns a JSON-ready dict: "findings", each with the names of ROW, errors first, and
    first of them the one that the decoder raises; "counts" by severity; "left_out" by code, what is counted and not in findings;
    "not_checked": units that were not looked into because of an error elsewhere; "exit_code" and "strict_exit_code" of
    texf-validate; "facts": what inspect() says without its units, None where the stream cannot be read.
    """
    data, limits, report = bytes(data), limits or Limits(), report or Report()
    with report.stage("parse"):
        parsed = parse(data, limits)
        readable = not parsed.listing.rows[ERROR]
        facts = {k: v for k, v in inspect(data, limits).items() if k != "units"} if readable else None
    if failure is None:
        decode_contents(parsed, DecodeOptions(limits=limits, threads=threads), report)
    else:
        parsed.listing.error(failure)
    listing, units = parsed.listing, parsed.frames.units
    unchecked = [{"unit": n, "unit_type": units[n].type, "unit_name": units[n].name} for n in parsed.unchecked]
    return {"findings": listing.findings, "counts": listing.counts, "left_out": listing.left_out, "not_checked": unchecked,
            "exit_code": listing.exit_code(), "strict_exit_code": listing.exit_code(strict=True), "facts": facts}
