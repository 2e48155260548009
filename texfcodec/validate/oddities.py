"""Oddities of a valid stream's elements: names, materials, header, fields."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ..bitstream.appearance import material_of
from ..bitstream.stream import Stream, cells_a_side
from ..bitstream.syntax import SUPPORT_TEXELS
from ..codecs import codec_of_unit
from ..codecs.base import PRIVATE_IDS
from ..scene.channels import ALPHA
from ..scene.effects import EFFECT_OF
from ..scene.scene import ALPHA_MASK, ALPHA_OPAQUE
from .listing import Oddity

SEPARATORS = "/\\"
UPWARDS = (".", "..")
FEW_TEXELS = 16  # an image that is asked for less than one in so many


def of_metadata(value: dict | None) -> Iterator[Oddity]:
    """Yield a warning (Oddity) if the metadata unit is not a JSON object. value: the object, None if it is none."""
    if value is None:
        yield Oddity("TXF-W02", "the metadata unit is not a JSON object", "5.8")


def of_materials(stream: Stream, geometry: bool) -> Iterator[Oddity]:
    """Yield findings (Oddity) on names, use and effects of the materials. geometry: whether all geometry units are readable."""
    for number, values in enumerate(stream.materials):
        yield from _of_name(values["material_name"], number)
        yield from _of_effects(values, number)
    names = Counter(values["material_name"] for values in stream.materials if values["material_name"])
    several = [name for name, count in names.items() if count > 1]
    if several:
        yield Oddity("TXF-W09", "several materials share a name", "5.4.1", value=several)
    if geometry and stream.geometry:
        idle = sorted(set(range(len(stream.materials))) - {unit["material_index"] for unit in stream.geometry})
        if idle:
            yield Oddity("TXF-W10", "materials without a geometry unit", "5.6", value=idle)


def _of_name(name, number):
    if not name.isprintable():
        yield Oddity("TXF-W07", f"the name of material {number} has control characters", "12", value=ascii(name))
    if any(separator in name for separator in SEPARATORS) or name in UPWARDS:
        yield Oddity("TXF-W08", f"the name of material {number} has a path separator or refers to a parent folder", "12",
                     value=ascii(name))


def _of_effects(values, number):
    material = material_of(values)
    unread = sorted(name for name in material.maps if name in EFFECT_OF and not EFFECT_OF[name].used(material))
    if unread:
        yield Oddity("TXF-W11", f"material {number} names channels that none of its effects reads", "5.4.1", value=unread)
    if material.alpha_mode == ALPHA_MASK and material.alpha_cutoff == 0:
        yield Oddity("TXF-W13", f"alpha_cutoff of material {number} has no effect", "5.4.1", value=0, allowed="1..65535")


def of_header(stream: Stream, materials: bool) -> Iterator[Oddity]:
    """Yield findings (Oddity) on the sequence header. materials: whether the materials of the stream are readable."""
    header = stream.header
    semantics = {semantic for group in header["channel_groups"] for semantic in group["group_semantics"]}
    opaque = all(values["alpha_mode"] == ALPHA_OPAQUE for values in stream.materials)
    if materials and ALPHA.semantic in semantics and opaque and stream.fields:
        yield Oddity("TXF-W12", "alpha is coded, but every material is opaque", "5.3.1")
    if header["num_geometry_units"] == 0:
        yield Oddity("TXF-W22", "the stream is an empty mesh", "5.3")
    elif header["side"] == 0:
        yield Oddity("TXF-W18", "all faces collapse to one point", "5.3", value=0)


def of_units(stream: Stream) -> Iterator[tuple[int, Oddity]]:
    """Yield (index, finding) for each geometry unit that repeats the field and material of an earlier one."""
    first: dict[tuple, int] = {}
    for number, unit in enumerate(stream.geometry):
        pair = (unit["field_index"], unit["material_index"])
        if first.setdefault(pair, number) != number:
            yield number, Oddity("TXF-W14", f"the unit repeats the field and material of geometry unit {first[pair]}", "5.6",
                                 value=list(pair))


def of_field(values: dict, count: int, position_bits: int) -> Iterator[Oddity]:
    """Yield findings (Oddity) on a field unit. values: its syntax elements; count: voxels or texels in its support."""
    if count == 1:
        yield Oddity("TXF-W19", "the field has a single value for its whole surface", "5.5", value=1)
    if values["support"] == SUPPORT_TEXELS:
        texels = values["width"] * values["height"]
        if count * FEW_TEXELS < texels:
            yield Oddity("TXF-W20", "the surface uses little of the image", "5.5", value=count, allowed=f"of {texels} texels")
    elif values["resolution"] > 1 << position_bits:
        yield Oddity("TXF-W23", "the field has more voxels per side than the position lattice has steps", "5.5",
                     value=values["resolution"],
                     allowed=f"<= {1 << position_bits}")


def of_attribute(values: dict, cells: int, stream: Stream) -> Iterator[Oddity]:
    """Yield findings (Oddity) on an attribute unit. values: its syntax elements; cells: cells that its plane has values of."""
    if values["level_shift"] and cells == 1 and cells_a_side(stream.fields[values["field_index"]]) > 1:
        yield Oddity("TXF-W21", "level_shift leaves a single cell", "5.7", values["offset"], values["level_shift"])
    if values["codec_id"] in PRIVATE_IDS:
        yield Oddity("TXF-W04", f"the unit is coded by the plug-in codec {codec_of_unit(values).name!r}", "5.7", values["offset"],
                     values["codec_id"])
