"""texf-info: what stands where in a stream."""

import json
from collections import Counter
from typing import NoReturn

import click

from .. import __version__
from ..asset.normal_rule import rule_of
from ..asset.scene import WRAP_NAMES
from ..bitstream.file import read_stream_file
from ..bitstream.syntax import SUPPORT_TEXELS
from ..codecs import codec_of
from ..limits import Limits
from .console import STYLE, run
from .flags import file_names


@click.command("texf-info", context_settings=STYLE)
@click.argument("file", metavar="FILE", shell_complete=file_names)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, errors included.")
@click.option("--quiet", is_flag=True, help="No listing; only errors and the exit code.")
@click.option("--verify", is_flag=True, help="Decode everything and compare all checksums.")
@click.version_option(__version__, message="%(prog)s %(version)s")
@click.pass_obj
def info(console, file, as_json, quiet, verify):
    """Name every syntax element of the .texf FILE ("-": stdin) with its offset and size, without decoding it.

    Exit codes: 0 valid, 1 command line, 2 input or output, 3 invalid stream, 5 not supported, 6 over a limit, 130
    interrupted.
    """
    from ..bitstream.inspect import inspect

    data = read_stream_file(file, Limits())
    facts = inspect(data)
    if verify:
        from ..api import decode

        decode(data)
        facts["verified"] = True
    console.result(facts, _lines(file, facts))


def _lines(file, facts):
    sizes, places = facts["bytes"], [name for name in ("voxels", "texels") if facts[name]]
    total, one = sum(facts[name] for name in places), " or ".join(name.removesuffix("s") for name in places)
    bits = f", {8 * sizes['attributes'] / total:.3f} attribute bits per {one}" if total else ""
    counted = ", ".join(f"{facts[name]} {name}" for name in places or ["voxels"])
    kinds = ", ".join(f"{kind} {sizes[kind]}" for kind in ("geometry", "attributes", "other"))
    yield f"{file}: {sizes['total']} bytes; {kinds}"
    yield f"{facts['vertices']} vertices, {facts['faces']} faces, {counted}, {facts['position_bits']} bits{bits}"
    for field in facts["fields"]:
        yield f"field {field['field_index']}: {_field_in_words(field)}"
    yield from _normals_in_words(facts)
    for group in facts["groups"]:
        yield from codec_of(group["codec"]).info_lines(group)
    yield f"{'offset':>10} {'size':>9}  element"
    for unit in facts["units"]:
        yield f"{unit['offset']:>10} {unit['size']:>9}  {unit['name']}"
        for element in unit["elements"]:
            yield f"{element['offset']:>10} {element['size']:>9}    {element['name']} = {json.dumps(element['value'])}"
    if facts.get("verified"):
        yield "verified: OK"


def _field_in_words(field):
    """What a field is over, from its syntax elements."""
    if field["support"] != SUPPORT_TEXELS:
        return f"K {field['resolution']}, {field['num_keys']} voxels"
    return (f"{field['num_keys']} texels of {field['width']} x {field['height']}, {WRAP_NAMES[field['wrap_s']]} x "
            f"{WRAP_NAMES[field['wrap_t']]}, UVs in 1/{1 << field['uv_fraction_bits']} texel")


def _normals_in_words(facts):
    """How shading normals are made, a line for every rule, and the marks that it asks for."""
    rules = Counter(str(rule_of(m["normal_rule"], m["normal_angle"])) for m in facts["materials"] if m["normal_rule"] is not None)
    for rule, count in rules.items():
        yield f"normals of {count} material{'s' * (count != 1)}: {rule}"
    if facts["sharp_edges"]:
        yield f"marks of sharp edges: {facts['sharp_edges']['num_edges']} edges in {facts['sharp_edges']['bytes']} bytes"


def main(arguments: list[str] | None = None) -> NoReturn:
    """The entry point."""
    run(info, arguments)


if __name__ == "__main__":
    main()
