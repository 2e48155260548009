"""Writes the syntax tables of bitstream_spec.md from those of the package. With --check: exit 7 when they differ."""

import re
import sys
from pathlib import Path

from texfcodec.bitstream.syntax import structures
from texfcodec.ground.structure import Derived, Structure

SPEC = Path(__file__).resolve().parent.parent / "bitstream_spec.md"


def _row(element):
    if isinstance(element, Derived):
        return f"| {element.name} | | = {element.text} | | |"
    kind = f"structure {element.descriptor.clause}" if isinstance(element.descriptor, Structure) else f"`{element.descriptor}`"
    low, high = element.low, element.high
    span = "" if low is None and high is None else f"{low}..{'' if high is None else high}"
    return f"| {element.name} | {kind} | {span} | {element.count or ''} | {element.when[0] if element.when else ''} |"


def table_of(structure):
    """Markdown table of one structure."""
    head = "| element | descriptor | range | count | condition |\n|---|---|---|---|---|"
    return "\n".join([head, *(_row(e) for e in structure.elements)])


def with_tables(text):
    """The specification with every generated table renewed."""
    for structure in structures():
        pattern = rf"(<!-- table: {structure.name} -->\n).*?(<!-- end -->)"
        text, found = re.subn(pattern, lambda m, s=structure: f"{m[1]}{table_of(s)}\n{m[2]}", text, flags=re.S)
        if found != 1:
            raise SystemExit(f"{SPEC.name}: {found} places for the table of {structure.name}")
    return text


def main():
    """Renews the tables, or checks them."""
    old = SPEC.read_text(encoding="utf-8")
    new = with_tables(old)
    if "--check" in sys.argv[1:]:
        sys.exit(7 if new != old else 0)
    SPEC.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
