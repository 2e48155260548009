"""Faulty conformance vectors for refusals that a careful reader may leave out without a difference in any other vector, and for
the order of refusals inside a unit (9.2)."""

import zlib

import DracoPy
import numpy as np

from conformance.make.constant import painted as uniform
from conformance.make.faulty import (
    A,
    F,
    H,
    M,
    allowing,
    base_stream,
    flat_stream,
    framed,
    simple_stream,
    sliced_stream,
    spliced,
    with_draco,
    with_element,
    with_units,
    with_values,
)
from conformance.make.good import encoded, parsed, plane_keys, units_of, written
from conformance.make.materials import groups, over_voxels, painted
from conformance.make.materials_faulty import binary32
from conformance.make.misread import FURTHER, where_binary32_parts
from conformance.make.neural import QUICK, neural, of_zeros
from conformance.make.neural import ring as neural_ring
from conformance.make.normals import MARKED_BY_AREA, marked
from conformance.make.texels import Grid, Image, Patch, picture, ring, sheet, stream_of_parts
from texfcodec import decode
from texfcodec.bitstream.syntax import UNIT_METADATA
from texfcodec.codecs.neural.neural_syntax import LATENT_LEVEL
from texfcodec.scene.scene import Material

CRITICAL = 6  # the first reserved critical unit type
INVALID_UTF8 = {
    "overlong": ("a name with U+07FF in three bytes", b"\xe0\x9f\xbf"),
    "overlong_four": ("a name with U+FFFF in four bytes", b"\xf0\x8f\xbf\xbf"),
    "surrogate": ("a name with a surrogate", b"\xed\xa0\x80"),
    "above": ("a name with U+110000", b"\xf4\x90\x80\x80"),
}


def descriptors():
    """Clause 4.3."""
    base, large = base_stream(), np.array([1e301], "<f8").tobytes()
    (name,), origin = {m["material_name"].encode() for m in parsed(base).materials[:1]}, parsed(base).header["origin"]
    named = lambda raw: with_element(base, M, "materials[0].material_name", raw.ljust(len(name), b"x"))
    texts = [(f"name_{key}", title, "4.3", named(raw), "TXF-S06") for key, (title, raw) in INVALID_UTF8.items()]
    return [
        ("origin_1e301", "an origin of -1e301", "4.3",
         with_element(base, H, "origin", np.array([-1e301, *origin[1:]], "<f8").tobytes()), "TXF-S04"),
        ("side_1e301", "a side of 1e301", "4.3", with_element(base, H, "side", large), "TXF-S04"),
        *texts,
        ("name_ends_early", "a name that ends within a character", "4.3", named(name[:-1] + b"\xc3"), "TXF-S06"),
    ]


def units():
    """Clauses 5.2 and 5.8."""
    simple = simple_stream()
    unknown, last = framed(simple, CRITICAL, b"\x08", b"critical"), -7  # the last byte of the checksum before the end unit
    return [
        ("critical_crc", "a flipped bit in the checksum of a unit of type 6", "9.2",
         unknown[:last] + bytes([unknown[last] ^ 1]) + unknown[last + 1 :], "TXF-S03"),
        ("metadata_empty", "a metadata unit without a byte", "5.8",
         with_units(simple, lambda listed: listed.insert(-1, (UNIT_METADATA, b""))), "TXF-S02"),
    ]


def idle_materials():
    """Clauses 5.3.1, 5.10 and 5.11: what materials of no face ask for."""
    around = ring((8, 8))
    two = stream_of_parts([Grid(7)], [Patch(around.lattice, around.faces)], 2)
    refracting = over_voxels([painted(iridescence_ior=(1.4,))], groups(), 9)
    rule = lambda data, number: with_element(data, M, "materials[1].normal_rule", bytes([number]))
    return [
        ("marks_missing_idle", "a material of no face asks for marks, and there is no sharp edges unit", "5.10", rule(two, 3),
         "TXF-S11"),
        ("coded_missing_idle", "a material of no face asks for coded normals, and there is no such unit", "5.11",
         rule(marked(two, [(MARKED_BY_AREA, 180), (0, 45)]), 6), "TXF-S11"),
        ("group_of_idle", "a group holds a channel that a material of no face alone names", "5.3.1",
         over_voxels([Material("seen"), painted("roughness")], groups("roughness"), 9), "TXF-S14"),
        ("parameter_default_binary32", "a parameter that is its default, which binary32 rounds", "5.4.2",
         with_element(refracting, M, "materials[0].parameters[0].parameter_value", binary32(1.3)), "TXF-S04"),
    ]


def of_draco():
    """Clauses 5.6 and 5.6.2."""
    simple = simple_stream()
    mesh = DracoPy.decode(bytes(parsed(simple).geometry[0]["draco_data"]))
    surface = lambda kind: (mesh.points.astype(kind), mesh.faces)
    coded = lambda kind, **more: with_draco(simple, DracoPy.encode(*surface(kind), compression_level=10, **more))
    uv = [(0, 0), (99, 8), (90, 70), (0, 0), (90, 70), (3, 66)]
    of_sheet = lambda bits: stream_of_parts([Image(picture(9, 7))], [sheet(uv, bits=bits)])

    def of_type(data, before, after):
        """The stream whose Draco data name another attribute type, of data type and components."""
        draco_data = bytes(parsed(data).geometry[0]["draco_data"])
        assert draco_data.count(before) == 1
        return with_values(data, lambda stream: stream.geometry[0].update(draco_data=draco_data.replace(before, after)))

    return [
        ("draco_metadata", "metadata in Draco's data", "5.6", coded(np.uint32, create_metadata=True), "TXF-S20"),
        ("draco_int32", "positions of signed integers", "5.6", coded(np.int32), "TXF-S20"),
        ("texels_uv_tex_coord", "plain UVs of Draco's type TEX_COORD", "5.6.2",
         of_type(of_sheet(0), b"\4\6\2", b"\3\6\2"), "TXF-S20"),
        ("texels_uv_generic_floats", "quantised UVs of Draco's type GENERIC", "5.6.2",
         of_type(of_sheet(8), b"\3\x09\2", b"\4\x09\2"), "TXF-S20"),
        ("texels_uv_binary64", "a UV that is by more than a quarter off, in binary32 by less", "5.6.2",
         where_binary32_parts(*FURTHER), "TXF-S23"),
    ]


def slice_at_the_end():
    """A further slice, of no node and with no byte."""
    data = sliced_stream()
    stream, (field,) = parsed(data), decode(data).fields
    (unit,) = stream.attributes
    nodes = len(np.unique(plane_keys(unit, field.keys) >> 3 * (unit["Depth"] - unit["slice_level"])))
    unit["slice_step"].append(nodes - sum(unit["slice_step"]))
    unit["codewords"].append({"codeword_length": 0, "level_bytes": []})
    return with_values(data, lambda other: other.attributes[0].update(
        num_slices=unit["num_slices"] + 1, NumSlices=unit["NumSlices"] + 1, slice_step=unit["slice_step"],
        codewords=unit["codewords"]))


def one_beyond():
    """Numbers one beyond their range in streams that hold together with them."""
    none = single = encoded(uniform((0.5, 0.2, 0.05)), resolution=12, qp=46)
    crc = lambda values: zlib.crc32(bytes(values)).to_bytes(4, "little")
    plane = parsed(single).attributes[0]["plane_value"]
    for kind, name, of_none, of_single in ((F, "area_threshold", b"\xff\xff", b"\0\0"), (F, "keys_crc", crc([]), crc(8)),
                                           (A, "values_crc", crc([]), crc(plane)), (F, "num_keys", b"\0", b"\1")):
        none, single = with_element(none, kind, name, of_none), with_element(single, kind, name, of_single)
    above = over_voxels([painted("roughness")], groups("roughness"), 8, shifts={(0, 1): 4}, constants=((0, 1),))
    return [
        ("num_keys_none", "a field none of whose voxels has the area that they need", "5.5", none, "TXF-S04"),
        ("level_shift_above_root", "level_shift 4 on a grid of 8 voxels a side", "5.7", above, "TXF-S04"),
        ("resolution_0_one_key", "K = 0 with the key and the value of K = 1", "5.5",
         with_element(single, F, "resolution", b"\0\0"), "TXF-S04"),
    ]


def without_latents():
    """3DNTC of zeros, which answers 128 everywhere, with a number one below its range in streams that hold together with it."""
    grid, table = (neural(neural_ring(12), 41, [level], **QUICK) for level in ((6, 0, 77), (6, 5, 0)))
    none = parsed(of_zeros(grid, 6))
    none.attributes[0].update(latent_data=b"")
    none.attributes[0]["latent_levels"][0].update(num_latents=[0], latent_threshold=65535)
    with allowing(LATENT_LEVEL, "num_latents", low=0):
        empty = written(none)
    return [
        ("neural_no_level", "3DNTC: no level, and a network without latents", "5.7.4", of_zeros(grid, 6, levels=0), "TXF-S04"),
        ("neural_no_cell", "3DNTC: G = 0 of a hash table, whose codes move no value", "5.7.5",
         with_element(of_zeros(table, 6), A, "latent_levels[0].level_resolution", b"\0\0"), "TXF-S04"),
        ("neural_no_latent", "3DNTC: a grid none of whose voxels has the area that they need", "5.7.5", empty, "TXF-S04"),
    ]


def two_faults():
    """Clause 9.2, step 4: a unit with two faults, of which the one that stands first decides."""
    texels = stream_of_parts([Image(picture(9, 7))], [sheet([(0, 0), (99, 8), (90, 70), (0, 0), (90, 70), (3, 66)])])
    flat, plain = flat_stream(), over_voxels([Material("m")], groups(), 9)
    (material,) = [payload for kind, payload in units_of(plain) if kind == M]
    rule = len(material) - 4  # of normal_rule, normal_angle, material_channels, num_parameters
    both = lambda data, kind, first, second: spliced(spliced(data, kind, *first), kind, *second)
    return [
        ("width_before_wrap", "width 0 and wrap_s 3", "9.2", both(texels, F, (2, b"\0\0"), (6, b"\3")), "TXF-S04"),
        ("wrap_before_fraction", "wrap_t 3 and uv_fraction_bits 9", "9.2", both(texels, F, (7, b"\3"), (8, b"\x09")), "TXF-U09"),
        ("rule_before_angle", "normal_rule 7 and normal_angle 181", "9.2",
         both(plain, M, (rule, b"\7"), (rule + 1, b"\xb5")), "TXF-U09"),
        ("angle_before_parameters", "normal_angle 181 and num_parameters 28", "9.2",
         both(plain, M, (rule + 1, b"\xb5"), (rule + 3, b"\x1c")), "TXF-S04"),
        ("transform_before_qp", "colour_transform 2 and qp 64", "9.2", both(flat, A, (8, b"\2"), (9, b"\x40")), "TXF-U09"),
        ("qp_before_transform", "qp 64 and planar_transform 2", "9.2", both(texels, A, (9, b"\x40"), (21, b"\2")), "TXF-S04"),
    ]


def faulty():
    """All of them."""
    at_the_end = ("slice_at_the_end", "a slice that begins at the number of nodes of its level", "5.7.1", slice_at_the_end(),
                  "TXF-S12")
    return [*descriptors(), *units(), *idle_materials(), *of_draco(), at_the_end, *two_faults(), *one_beyond(),
            *without_latents()]
