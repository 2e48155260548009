"""Clause 5 in plain Python: every unit's payload to a dict whose keys are the syntax elements."""

import struct

from conformance.reference.bits import Reader, Unsupported, known, require
from conformance.reference.materials import check_appearance, check_material, needed_groups, read_channel_group, read_material

HEADER, MATERIALS, FIELD, GEOMETRY, ATTRIBUTE, END, METADATA, SHARP_EDGES, CODED_NORMALS = 0, 1, 2, 3, 4, 5, 128, 129, 130
VOXELS, TEXELS = 0, 1  # support
NEURAL, CONSTANT, PRIVATE = 1, 2, 192  # codec_id
DRACO_START = bytes.fromhex("445241434F020201010000")


def read_header(reader):
    """Clause 5.3."""
    header = {"version": reader.u8("version"), "position_bits": reader.u8("position_bits", 8, 20)}
    header["origin"] = [reader.f64("origin") for _ in range(3)]
    header["side"] = reader.f64("side", low=0)
    header["num_materials"] = reader.v("num_materials", high=65536)
    header["num_fields"] = reader.v("num_fields", high=256)
    header["num_geometry_units"] = reader.v("num_geometry_units", high=16777216)
    header["num_channel_groups"] = known("num_channel_groups", reader.u8("num_channel_groups", 1), 23)
    num_groups = reader.count_of("channel_groups", header["num_channel_groups"], 3)
    header["channel_groups"] = [read_channel_group(reader) for _ in range(num_groups)]
    semantics = [semantic for group in header["channel_groups"] for semantic in group["semantics"]]
    require(len(semantics) == len(set(semantics)), "two channels have the same group_semantics")
    for group in header["channel_groups"]:
        if group["components"] not in group["possible"]:
            raise Unsupported(f"{group['components']} components for the semantics {group['semantics']}")
    return header


def read_materials(reader, header):
    """Clause 5.4."""
    materials = [read_material(reader) for _ in range(reader.count_of("materials", header["num_materials"], 5))]
    for material in materials:
        check_material(material)
    return materials


def read_field(reader):
    """Clause 5.5."""
    field = {"field_index": reader.v("field_index"), "support": known("support", reader.u8("support"), 1)}
    if field["support"] == VOXELS:
        field |= {"resolution": reader.u16("resolution", 1, 8192), "area_threshold": reader.u16("area_threshold")}
    else:
        field |= {name: reader.u16(name, 1, 16384) for name in ("width", "height")}
        field |= {name: known(name, reader.u8(name), 2) for name in ("wrap_s", "wrap_t")}
        field |= {"uv_fraction_bits": reader.u8("uv_fraction_bits", 0, 8), "resolution": max(field["width"], field["height"])}
    field |= {"num_keys": reader.v("num_keys", 1, 2**28), "keys_crc": reader.u32("keys_crc")}
    require(field["support"] == VOXELS or field["num_keys"] <= field["width"] * field["height"], "num_keys is more than texels")
    return field


def read_geometry(reader, fields):
    """Clause 5.6; no more than the counts where the field is not there, which step 5 of 9.2 refuses."""
    unit = {"field_index": reader.v("field_index"), "material_index": reader.v("material_index"),
            "unit_vertices": reader.v("unit_vertices", low=3), "unit_faces": reader.v("unit_faces", low=1)}
    if unit["field_index"] >= len(fields):
        reader.rest()
        return unit
    unit["support"] = fields[unit["field_index"]]["support"]
    if unit["support"] == TEXELS:
        unit["uv_origin"] = [reader.i32("uv_origin", 1 - 2**25, 2**25 - 1) for _ in range(2)]
        unit["uv_bits"] = reader.u8("uv_bits", 0, 20)
        if unit["uv_bits"] > 0:
            unit["uv_range"] = reader.v("uv_range", 1, 2 ** unit["uv_bits"] - 1)
    unit["geometry_crc"] = reader.u32("geometry_crc")
    unit["draco_data"] = reader.rest()
    return unit


def check_draco_start(unit):
    """Clause 5.6: what can be said of draco_data without decoding it."""
    draco = Reader(unit["draco_data"])
    require(draco.take(11, "Draco header") == DRACO_START, "draco_data does not begin as 5.6 says")
    require(draco.u8("traversal type") in (0, 2), "Draco's traversal type is neither 0 nor 2")
    require(draco.v("Draco's vertex count") == unit["unit_vertices"], "draco_data names another number of vertices")
    require(draco.v("Draco's face count") == unit["unit_faces"], "draco_data names another number of faces")


def read_attribute(reader, header, fields):
    """Clause 5.7, with 5.7.1 to 5.7.6."""
    unit = {"field_index": reader.v("field_index", high=len(fields) - 1),
            "group_index": reader.u8("group_index", 0, header["num_channel_groups"] - 1),
            "codec_id": reader.u8("codec_id")}
    private = reader.utf8(reader.u8("codec_name_length", 1), "codec_name") if unit["codec_id"] >= PRIVATE else ""
    unit["level_shift"] = reader.u8("level_shift", 0, 13)
    unit["values_crc"] = reader.u32("values_crc")
    if unit["codec_id"] > CONSTANT:
        raise Unsupported(f"attribute codec {unit['codec_id']} {private}")
    group, resolution = header["channel_groups"][unit["group_index"]], fields[unit["field_index"]]["resolution"]
    most = 0 if unit["codec_id"] == NEURAL or {0, 1} & set(group["semantics"]) else (resolution - 1).bit_length()
    require(unit["level_shift"] <= most, f"level_shift is {unit['level_shift']}, at most {most}")
    unit["depth"] = (-(-resolution // 2 ** unit["level_shift"]) - 1).bit_length()
    if unit["codec_id"] == NEURAL:
        read_neural(reader, unit, header)
    elif unit["codec_id"] == CONSTANT:
        components = header["channel_groups"][unit["group_index"]]["components"]
        unit["plane_value"] = bytes(reader.u8("plane_value") for _ in range(components))
    else:
        read_raht(reader, unit, header, fields)
    return unit


def read_raht(reader, unit, header, fields):
    """Clause 5.7.1, with 5.7.2 and 5.7.3."""
    components = header["channel_groups"][unit["group_index"]]["components"]
    depth = unit["depth"]
    unit.update(components=components)
    unit["colour_transform"] = known("colour_transform", reader.u8("colour_transform"), 1)
    unit["qp"] = [reader.u8("qp", 0, 63) for _ in range(components)]
    unit["kernel"] = [reader.u8("kernel") for _ in range(7)]
    unit["colour_range"] = reader.u8("colour_range")
    unit["num_models"] = reader.u8("num_models", 0, 8)
    unit["planar"] = fields[unit["field_index"]]["support"]
    unit["planar_transform"] = known("planar_transform", reader.u8("planar_transform"), 1) if unit["planar"] > 0 else 0
    with_dct = unit["planar"] > 0 and unit["num_models"] > 0
    unit["dct_blocks"] = known("dct_blocks", reader.u8("dct_blocks"), 1) if with_dct else 0
    unit["component_cross"] = reader.u8("component_cross", 0, 16) if components > 1 else 0
    num_filters = reader.count_of("filters", reader.u8("num_filters", 0, 3), 2)
    unit["filters"] = [read_filter(reader, components, 5 if unit["planar"] else 3) for _ in range(num_filters)]
    unit["residual"] = reader.u8("residual", 0, 128 if depth > 0 else 0)
    unit["residual_cross"] = [reader.u8("residual_cross", 0, 16) for _ in range(components if unit["residual"] > 0 else 0)]
    unit["root_mean"] = [reader.i32("root_mean", -1048576, 1048576) for _ in range(components)]
    slice_level = unit["slice_level"] = reader.u8("slice_level", 0, min(12, max(0, depth - 1)))
    num_slices = reader.v("num_slices", 1, 64) if slice_level > 0 else 1
    unit["slice_first"] = [0]
    for _ in range(reader.count_of("slice_step", num_slices - 1, 1)):
        unit["slice_first"].append(unit["slice_first"][-1] + reader.v("slice_step", low=1))
    read_codewords(reader, unit, num_slices)
    require(components == 3 or unit["colour_transform"] == 0, "colour_transform without three components")
    require(unit["kernel"][0] >= 1, "kernel[0] is 0")


def read_filter(reader, components, taps):
    """Clause 5.7.3."""
    mask = reader.u16("filter_mask", 0, 32767)
    require(mask >> (5 * components) == 0, "filter_mask has a bit for a component that is not there")
    return {"mask": mask, "coefficients": [reader.i8("filter_coefficients") for _ in range(taps * mask.bit_count())]}


def read_codewords(reader, unit, num_slices):
    """Clause 5.7.2; level_bytes has no influence on decoding and is only passed over."""
    depth, slice_level = unit["depth"], unit["slice_level"]
    levels = [depth] if slice_level == 0 else [slice_level] + [depth - slice_level] * num_slices
    level_index = reader.u8("level_index", 0, 1)
    lengths = []
    levels = levels if depth > 0 else []
    reader.count_of("codewords", len(levels), 1)
    for num_levels in levels:
        lengths.append(reader.v("codeword_length"))
        for _ in range(num_levels * level_index):
            reader.v("level_bytes")
    unit["codewords"] = [reader.take(length, "codeword") for length in lengths]
    require(reader.ended(), "codeword_data is longer than its codewords")


def read_neural(reader, unit, header):
    """Clause 5.7.4: the elements and Widths; parameters are the numbers that 16 bits form."""
    unit["form"] = known("form", reader.u8("form"), 1)
    unit["num_features"] = reader.u8("num_features", 2, 64)
    require(unit["num_features"] % 2 == 0, "num_features is odd")
    unit["wave_octaves"] = reader.u8("wave_octaves", 0, 8)
    unit["first_wave"] = reader.u16("first_wave", 1, 16384)
    unit["hidden_width"] = [reader.u8("hidden_width", 1, 128) for _ in range(reader.u8("num_hidden", 1, 4))]
    num_levels = reader.count_of("latent_levels", reader.u8("num_levels", 1, 4), 5)
    unit["latent_levels"] = [read_latent_level(reader, header["num_fields"]) for _ in range(num_levels)]
    inputs = num_levels * unit["num_features"] + 6 * unit["wave_octaves"]
    widths = unit["widths"] = [inputs, *unit["hidden_width"], sum(group["components"] for group in header["channel_groups"])]
    count = sum((i + 1) * j for i, j in zip(widths, widths[1:], strict=False))
    unit["parameters"] = struct.unpack(f"<{count}H", reader.take(2 * count, "network_data"))
    largest = max(parameter & 32767 for parameter in unit["parameters"])
    require(largest >> 10 < 27, "a parameter is not finite and of magnitude below 2^12")  # exponent field 27 begins at 2^12
    unit["latent_data"] = reader.rest()


def read_latent_level(reader, num_fields):
    """Clause 5.7.5."""
    level = {
        "level_resolution": reader.u16("level_resolution", 1, 8192),
        "table_log2": reader.u8("table_log2", 0, 24),
        "latent_threshold": reader.u16("latent_threshold"),
    }
    num_counts = num_fields if level["table_log2"] == 0 else 0
    return level | {"num_latents": [reader.v("num_latents", low=1) for _ in range(num_counts)]}


def read_metadata(reader):
    """Clause 5.8; the JSON text is handed on unread, None: it is of another format."""
    known = reader.u8("metadata_format") == 0
    text = reader.rest()
    return text if known else None


def read_sharp_edges(reader):
    """Clause 5.10."""
    return {"num_edges": reader.v("num_edges", 1), "marks_crc": reader.u32("marks_crc"), "marks_data": reader.rest()}


def read_coded_normals(reader):
    """Clause 5.11."""
    return {"num_groups": reader.v("num_groups", 1), "normal_step": reader.u16("normal_step", 1, 4096),
            "normals_crc": reader.u32("normals_crc"), "residual_data": reader.rest()}


def filled(read, payload, *context):
    """The structure read from a payload, which it must fill."""
    reader = Reader(payload)
    structure = read(reader, *context)
    require(reader.ended(), f"{len(payload) - reader.at} bytes are left over in a unit")
    return structure


def read_stream(units):
    """Steps 4 and 5 of 9.2: all units of a stream as one dict."""
    stream = {"header": None, "materials": None, "fields": [], "geometry": [], "attributes": [], "metadata": None,
              "sharp_edges": None, "coded_normals": None, "skipped_units": []}
    header, fields = {}, stream["fields"]
    for unit_type, payload in units:
        if unit_type == HEADER:
            header = stream["header"] = filled(read_header, payload)
        elif unit_type == MATERIALS:
            stream["materials"] = filled(read_materials, payload, header)
        elif unit_type == FIELD:
            fields.append(filled(read_field, payload))
        elif unit_type == GEOMETRY:
            stream["geometry"].append(filled(read_geometry, payload, fields))
        elif unit_type == ATTRIBUTE:
            stream["attributes"].append(filled(read_attribute, payload, header, fields))
        elif unit_type == METADATA:
            stream["metadata"] = filled(read_metadata, payload)
        elif unit_type == SHARP_EDGES:
            stream["sharp_edges"] = filled(read_sharp_edges, payload)
        elif unit_type == CODED_NORMALS:
            stream["coded_normals"] = filled(read_coded_normals, payload)
        elif unit_type > CODED_NORMALS:
            stream["skipped_units"].append(unit_type)
    check_units(stream)
    return stream


def check_units(stream):
    """Step 5 of 9.2."""
    header, materials, fields = stream["header"], stream["materials"], stream["fields"]
    geometry, attributes = stream["geometry"], stream["attributes"]
    require(materials is not None, "there is no materials unit")
    for found, name, count in [(fields, "field", header["num_fields"]), (geometry, "geometry", header["num_geometry_units"])]:
        require(len(found) == count, f"{len(found)} {name} units where the header asks for {count}")
    require([field["field_index"] for field in fields] == list(range(len(fields))), "field_index does not count up from 0")
    require({unit["field_index"] for unit in geometry} == set(range(len(fields))), "fields and those of geometry units differ")
    require(all(unit["material_index"] < len(materials) for unit in geometry), "a geometry unit's material is not there")
    check_appearance(header, materials, fields, geometry)
    wanted = needed_groups(header, materials, fields, geometry)
    if any(unit["codec_id"] == NEURAL for unit in attributes):
        wanted = [(0, 0)]
        require(all(field["support"] == VOXELS for field in fields), "a 3DNTC unit in a stream with a field over texels")
    pairs = [(unit["field_index"], unit["group_index"]) for unit in attributes]
    require(pairs == wanted, "the attribute units are not those that the fields need, in order")
    for unit, rule, name in [("sharp_edges", 3, "sharp edges"), ("coded_normals", 6, "coded normals")]:
        needed = any(material["normal_rule"] >= rule for material in materials)
        require(needed == (stream[unit] is not None), f"a {name} unit without a rule that asks for it, or the other way round")
