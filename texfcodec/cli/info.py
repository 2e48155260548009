"""texf-info: the syntax elements of a stream."""

from collections import Counter
from functools import partial

import click

from ..api import decode
from ..bitstream.inspect import inspect
from ..bitstream.syntax import SUPPORT_TEXELS
from ..codecs import codec_of
from ..core.json_text import json_text
from ..errors import LimitError
from ..limits import LEVELS, UNLIMITED, Limits
from ..options import DecodeOptions
from ..report import Report, plural
from ..scene.normal_rule import rule_of
from ..scene.scene import WRAP_NAMES
from .console import STYLE, run
from .effect_lines import counted
from .flags import file_names, limit_flags, limits_of, report_flags
from .inputs import read_streams


@click.command("texf-info", context_settings=STYLE)
@click.argument("file", metavar="FILE", shell_complete=file_names)
@click.option("--effects", is_flag=True, help="Decode everything, and list the bytes, decoding time and drawing time of each "
                                              "channel and effect.")
@click.option("--verify", is_flag=True, help="Decode everything and compare all checksums.")
@limit_flags("file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes")
@report_flags("Print nothing but errors.", names_engine=True)
@click.pass_obj
def info(console, file, as_json, quiet, effects, verify, **choices):
    """List every syntax element of the .texf FILE ("-": stdin), or of the streams that a GLB carries, with its offset and size.
    The values are not decoded.

    Exit codes: 0 valid, 1 command line, 2 input or output, 3 invalid stream, 5 not supported, 6 limit exceeded, 130
    interrupted.
    """
    limits = limits_of(choices)
    streams = read_streams(file, limits)
    every = []
    for data in streams:
        facts = inspect(data, limits)
        if verify:
            _verify(data, facts, limits)
        every.append(facts | (_effect_facts(data, facts, limits) if effects else {}))
    if len(every) == 1:
        return console.result(every[0], _lines(file, every[0]))
    lines = (line for number, facts in enumerate(every) for line in _lines(f"{file} stream {number}", facts))
    console.result({"streams": every}, lines)


def _verify(data, facts, limits):
    """Decodes everything within limits and within the bounds of the lowest level that holds it; level None: above all levels."""
    levels = [level for level in LEVELS if level >= (facts["level"] or max(LEVELS))]
    for level in [*levels, None]:
        try:
            decode(data, DecodeOptions(limits=_both(limits, LEVELS[level] if level else UNLIMITED)))
            break
        except LimitError:
            if level is None:
                raise
    facts |= {"level": level, "verified": True}


def _both(first, second):
    """Limits with the lower of two values for each."""
    pairs = ((name, getattr(first, name), getattr(second, name)) for name in Limits.__dataclass_fields__)
    return Limits(**{name: min(filter(None, values), default=0) for name, *values in pairs})


def _effect_facts(data, facts, limits):
    """Bytes and times of channels and effects: {"channels": one entry for each attribute unit, "drawing": of
    metrics.effect_times}."""
    from ..decoder import decode_stream
    from ..metrics.effect_times import effect_times

    report, options = Report(), DecodeOptions(limits=limits)
    texf = decode_stream(data, options, report)
    sizes = {(group["field_index"], group["group_index"]): group["bytes"] for group in facts["groups"]}
    numbers = {tuple(channel.name for channel in group.channels): number for number, group in enumerate(texf.groups)}
    channels = [entry | {"bytes": sizes[entry["field"], numbers[tuple(entry["channels"])]]} for entry in report.channels]
    drawing = effect_times(texf, threads=options.threads) if texf.fields and len(texf.faces) else None
    return {"channels": channels, "drawing": drawing}


def _effect_lines(facts):
    yield f"effects: {', '.join(facts['effects']) or 'none'}"
    for entry in facts["channels"]:
        names = " + ".join(entry["channels"])
        yield f"  field {entry['field']}, {names}: {entry['bytes']} bytes, decoded in {entry['decode_ms']:.0f} ms"
    drawing = facts["drawing"]
    if drawing:
        yield (f"a shaded picture of {drawing['size']} x {drawing['size']}: {drawing['picture_ms']:.0f} ms; without light "
               f"{drawing['unlit_ms']:.0f} ms")
        for name, milliseconds in drawing["without_ms"].items():
            yield f"  without {name.replace('_', ' ')}: {milliseconds:.0f} ms"


def _lines(file, facts):
    sizes, (counts, bits) = facts["bytes"], counted(facts)
    kinds = ", ".join(f"{kind} {sizes[kind]}" for kind in ("geometry", "attributes", "other"))
    yield f"{file}: {sizes['total']} bytes; {kinds}"
    mesh = plural(facts["vertices"], "vertex", "vertices") + ", " + plural(facts["faces"], "face", "faces")
    yield ", ".join(filter(None, (mesh, counts, f"{facts['position_bits']} bits", bits)))
    yield _level_in_words(facts)
    for field in facts["fields"]:
        yield f"field {field['field_index']}: {_field_in_words(field)}"
    yield from _normals_in_words(facts)
    for group in facts["groups"]:
        yield from codec_of(group["codec"]).info_lines(group)
    if "drawing" in facts:
        yield from _effect_lines(facts)
        return
    yield f"{'offset':>10} {'size':>9}  element"
    for unit in facts["units"]:
        yield f"{unit['offset']:>10} {unit['size']:>9}  {unit['name']}"
        for element in unit["elements"]:
            yield f"{element['offset']:>10} {element['size']:>9}    {element['name']} = {json_text(element['value'])}"
    if facts.get("verified"):
        yield "verified: OK"


def _level_in_words(facts):
    """Profile and level, with a note if decoding may raise the level."""
    known = "" if facts.get("verified") else " by its counts; --verify also checks its surface"
    return f"profile: {facts['profile'] or 'private'}, level: {facts['level'] or f'above {max(LEVELS)}'}{known}"


def _field_in_words(field):
    """The support of a field, from its syntax elements."""
    if field["support"] != SUPPORT_TEXELS:
        return f"K {field['resolution']}, {field['num_keys']} voxels"
    return (f"{field['num_keys']} texels of {field['width']} x {field['height']}, {WRAP_NAMES[field['wrap_s']]} x "
            f"{WRAP_NAMES[field['wrap_t']]}, UVs in 1/{1 << field['uv_fraction_bits']} texel")


def _normals_in_words(facts):
    """The derivation of shading normals, a line for every rule, and the marks that it needs."""
    rules = Counter(str(rule_of(m["normal_rule"], m["normal_angle"])) for m in facts["materials"] if m["normal_rule"] is not None)
    for rule, count in rules.items():
        yield f"normals of {count} material{'s' * (count != 1)}: {rule}"
    if facts["sharp_edges"]:
        yield f"marks of sharp edges: {facts['sharp_edges']['num_edges']} edges in {facts['sharp_edges']['bytes']} bytes"
    if facts["coded_normals"]:
        yield f"coded normals: {facts['coded_normals']['num_groups']} in {facts['coded_normals']['bytes']} bytes"


main = partial(run, info)

if __name__ == "__main__":
    main()
