"""Validation of a whole stream: the error for which the decoder refuses it, the errors behind that, and oddities.

The walk is the decoder's (spec 9.2), over its own functions, so that the first error is the decoder's. After an error it
continues with everything that does not need the faulty part; everything that needs it is listed as not checked, and gets no error
of its own.
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
    """All errors and oddities of a .texf stream.

    Parameters
    ----------
    data : bytes
        The stream.
    limits : Limits, optional
        As of decode().
    threads : int
        Most threads.
    report : Report, optional
        Receives seconds by stage.
    failure : TexfError, optional
        Error of a child that was to check Draco and the fields: then nothing is decoded here.

    Returns
    -------
    dict
        JSON-ready. "findings": each with the names of ROW, errors first, the decoder's error first among them; "counts": by
        severity; "left_out": by code, number of findings that are counted and not listed; "not_checked": units that were not
        checked because of an error elsewhere; "exit_code", "strict_exit_code": of texf-validate; "facts": those of inspect()
        without its units, None if the stream cannot be read.
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
