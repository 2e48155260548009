"""Annex C of bitstream_spec.md: the tables of the specification, how long they are, and a checksum of each."""

import struct
import zlib

from conformance.reference import edges, mixing, scales

SQUASHED = range(-2816, 2817)
CONSTANTS = (
    ("8.4.2", "bounds of fold", edges.STEPS),
    ("7.3", "FalloffTable", scales.FALLOFF_TABLE),
    ("7.4.2", "step(qp), qp = 0..63", [scales.step(qp) for qp in range(64)]),
    ("7.5.1", "Class(e), e = 0..255", [scales.energy_class(e) for e in range(256)]),
    ("7.6.4", "Squash(x), x = -2816..2816", [mixing.squash(x) for x in SQUASHED]),
    ("7.6.4", "Stretch(v), v = 0..4095", mixing.STRETCH),
    ("7.6.4", "16 + 1536 // (16 + n), n = 0..1521", [16 + 1536 // (16 + n) for n in range(1522)]),
)


def constants():
    """Markdown table of CONSTANTS, in the order of their clauses."""
    head = "| clause | table | entries | CRC-32 |\n|---|---|---:|---|"
    check = lambda values: f"{zlib.crc32(struct.pack(f'<{len(values)}i', *values)):08x}"
    return "\n".join([head, *(f"| {clause} | {name} | {len(values)} | {check(values)} |" for clause, name, values in
                              sorted(CONSTANTS, key=lambda row: row[0]))])
