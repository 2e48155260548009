"""Writes the generated blocks of the documents: tables and examples of bitstream_spec.md, the list of findings of
docs/guide/errors.md and the effects of docs/design/materials.md. With --check: exit 7 when they differ."""

import math
import re
import sys
from pathlib import Path

from conformance.make.constants import constants
from conformance.make.spec_example import example
from conformance.make.worked import worked
from texfcodec.bitstream.syntax import structures
from texfcodec.core.syntax_table import Derived, Structure
from texfcodec.findings import FINDINGS
from texfcodec.limits import LEVELS
from texfcodec.scene.channels import BY_NAME, CHANNELS, COLOURS, PARAMETERS
from texfcodec.scene.effects import EFFECTS

REPOSITORY = Path(__file__).resolve().parents[2]
SPEC = REPOSITORY / "bitstream_spec.md"
ERRORS, MATERIALS = (REPOSITORY / "docs" / name for name in ("guide/errors.md", "design/materials.md"))
EXAMPLE, MIXED, DIRECT = "uncommon/point_triangle", "uncommon/planar_mixed", "uncommon/planar_direct"


def _row(element):
    if isinstance(element, Derived):
        return f"| {element.name} | | = {element.text} | | |"
    kind = f"structure {element.descriptor.clause}" if isinstance(element.descriptor, Structure) else f"`{element.descriptor}`"
    low, high = element.low, element.high
    span = "" if low is None and high is None else f"{low}..{'' if high is None else high}{'+' if element.registry else ''}"
    return f"| {element.name} | {kind} | {span} | {element.count or ''} | {element.when[0] if element.when else ''} |"


def table_of(structure):
    """Markdown table of one structure."""
    head = "| element | descriptor | range | count | condition |\n|---|---|---|---|---|"
    return "\n".join([head, *(_row(e) for e in structure.elements)])


def _place(extension, key):
    """Where glTF has something; what stands in the material itself has no extension."""
    return ".".join(filter(None, [extension, key]))


def _values_are(channel):
    """What a channel's values are, in the words of 8.4.2."""
    if channel.unit == "degrees":
        return "tangent x, y" if channel.over == "texels" else "deviation x, y, z"
    return "sRGB colour" if channel.srgb else "linear" if channel.components == 1 else "direction x, y, and strength"


def channels():
    """Markdown table of the channels."""
    head = "| number | channel | components | values | over | named by bit | factor | in glTF |\n" + "|---" * 8 + "|"
    rows = []
    for c in CHANNELS:
        bit = "" if c in COLOURS else BY_NAME[c.material_name].semantic
        place = f"{_place(c.extension, c.slot)} {''.join('RGBA'[n] for n in c.columns)}"
        rows.append(f"| {c.semantic} | {c.name} | {c.components} | {_values_are(c)} | {c.over or 'both'} | {bit} | {c.parameter} "
                    f"| {place} |")
    return "\n".join([head, *rows])


def effects():
    """Markdown table of the effects."""
    head = "| effect | needed where the material is |\n|---|---|"
    return "\n".join([head, *(f"| {e.name} | {e.used.text} |" for e in EFFECTS)])


def parameters():
    """Markdown table of the parameters."""
    head = "| number | parameter | values | default | in glTF |\n|---|---|---|---|---|"
    shown = lambda p: "infinity" if p.default == (math.inf,) else ", ".join(f"{v:g}" for v in p.default)
    rows = [f"| {p.number} | {p.name} | {p.count} | {shown(p)} | {_place(p.extension, p.key)} |" for p in PARAMETERS]
    return "\n".join([head, *rows])


def levels():
    """Markdown table of the levels."""
    names = {"file_bytes": "bytes of the stream", "vertices": "vertices", "faces": "faces", "voxels": "voxels and texels",
             "texels": "texels of an image", "samples": "samples", "latents": "latents", "metadata_bytes": "bytes of metadata"}
    power = lambda count: f"2^{count.bit_length() - 1}"
    rows = [f"| {text} | " + " | ".join(power(getattr(bounds, name)) for bounds in LEVELS.values()) + " |"
            for name, text in names.items()]
    return "\n".join(["| at most | " + " | ".join(f"level {n}" for n in LEVELS) + " |", "|---" * (1 + len(LEVELS)) + "|", *rows])


def all_findings():
    """Markdown table of all codes, with the exit code of the tools, clauses of the specification and what to do."""
    head = "| code | exit | clause | what is wrong | what to do |\n|---|---|---|---|---|"
    rows = ((f.code, f.exit_code, ", ".join(f.clauses), f.text, f.remedy) for f in FINDINGS)
    return "\n".join([head, *(f"| {' | '.join(map(str, row))} |" for row in rows)])


def with_block(text, mark, block, name):
    """The text with the block between `<!-- mark -->` and the next `<!-- end -->` renewed; name: of the document."""
    pattern = rf"(<!-- {mark} -->\n).*?(<!-- end -->)"
    text, count = re.subn(pattern, lambda m: f"{m[1]}{block}\n{m[2]}", text, flags=re.S)
    if count != 1:
        raise SystemExit(f"{name}: {count} places for {mark}")
    return text


def with_tables(text):
    """The specification with every generated block renewed."""
    for structure in structures():
        text = with_block(text, f"table: {structure.name}", table_of(structure), SPEC.name)
    stream, mixed, direct = ((REPOSITORY / "conformance" / name / "in.texf").read_bytes() for name in (EXAMPLE, MIXED, DIRECT))
    for mark, block in (("channels", channels()), ("parameters", parameters()), ("levels", levels()),
                        ("example", example(stream)), ("decisions: mixed", worked(mixed, 8)),
                        ("decisions: direct", worked(direct, 0)), ("constants", constants())):
        text = with_block(text, mark, block, SPEC.name)
    return text


def with_effects(text):
    """The page on materials with its table of effects renewed."""
    return with_block(text, "effects", effects(), MATERIALS.name)


def with_findings(text):
    """The guide's page on errors with its list of codes renewed."""
    return with_block(text, "findings: all", all_findings(), ERRORS.name)


def main():
    """Renews the blocks, or checks them."""
    stale = False
    for path, renewed in ((SPEC, with_tables), (ERRORS, with_findings), (MATERIALS, with_effects)):
        old = path.read_text(encoding="utf-8")
        new = renewed(old)
        stale |= new != old
        if "--check" not in sys.argv[1:]:
            path.write_text(new, encoding="utf-8")
    sys.exit(7 if stale and "--check" in sys.argv[1:] else 0)


if __name__ == "__main__":
    main()
