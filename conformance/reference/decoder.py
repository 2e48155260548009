"""A whole decoder in plain Python, written from bitstream_spec.md and a Draco decoder alone: slow, and readable beside the text.

    python conformance/reference/decoder.py IN.texf OUT_DIR [--lod L] [--queries FILE]

writes the arrays of clause 9, the checksums of levels and the answers to queries, for conformance/run.py. Exit codes: 3 for an
invalid stream, 5 for one it does not support.
"""

import argparse
import struct
import sys
import zlib
from pathlib import Path

import DracoPy

if __package__ in (None, ""):  # run as a command: conformance.reference is found from here
    sys.path[0] = str(Path(__file__).resolve().parents[2])

from conformance.reference.attributes import decode_values
from conformance.reference.bits import Invalid, Unsupported, require, units_of
from conformance.reference.edges import decode_marks, marked_edges
from conformance.reference.neural import Neural, coarse_values, latent_keys
from conformance.reference.normals import decode_normals
from conformance.reference.syntax import CONSTANT, NEURAL, TEXELS, check_draco_start, read_stream
from conformance.reference.texels import referenced_texels, whole_number
from conformance.reference.voxels import active_voxels

FLOAT32, UINT32, POSITION, TEX_COORD, GENERIC = 9, 6, 0, 3, 4  # Draco's own numbers


def decode(data, lod=0, checks=None):
    """Stream bytes -> dict of header, materials, units (field, material, lattice, uv, faces), fields (its unit, levels left out,
    keys, bytes and level_shift by group) and neural: what answers any position of a field, None without 3DNTC. checks: a dict
    that gets the CRC-32 of the means of all levels of the RAHT units, by field and group, as far as they are decoded."""
    stream = read_stream(units_of(data))
    header, attributes = stream["header"], stream["attributes"]
    units = [decode_geometry(unit, header["position_bits"]) for unit in stream["geometry"]]
    marks = decode_marks(stream["sharp_edges"], units, stream["materials"]) if stream["sharp_edges"] else None
    normals = None
    if stream["coded_normals"]:
        edges = [edge for edge, _ in marked_edges(units, stream["materials"])]
        normals = decode_normals(stream["coded_normals"], list(zip(edges, marks, strict=True)), units, stream["materials"])
    triangles = [triangles_of_field(units, index) for index in range(len(stream["fields"]))]
    keys = [field_keys(field, index, units, header["position_bits"]) for index, field in enumerate(stream["fields"])]
    neural = None
    if [unit["codec_id"] for unit in attributes] == [NEURAL]:
        neural = Neural(attributes[0], latent_keys(attributes[0], triangles, header["position_bits"]))
        values = neural_values(neural, stream, keys, lod)
    else:
        values = [{} for _ in keys]
        for unit in attributes:
            place, of_unit = (unit["field_index"], unit["group_index"]), []
            if checks is not None and unit["codec_id"] != CONSTANT:
                checks[place] = of_unit
            values[place[0]][place[1]] = checked_values(unit, keys[place[0]], lod, of_unit)
    fields = []
    for index, field in enumerate(stream["fields"]):
        left_out = levels_left_out(field, lod)
        coarse = sorted({key >> 3 * left_out for key in keys[index]})
        shifts = {unit["group_index"]: unit["level_shift"] for unit in attributes if unit["field_index"] == index}
        fields.append({"resolution": -(-field["resolution"] >> left_out), "keys": coarse, "values": values[index],
                       "support": field["support"], "unit": field, "left_out": left_out, "shifts": shifts})
    return {"header": header, "materials": stream["materials"], "units": units, "fields": fields,
            "metadata": stream["metadata"], "neural": neural, "sharp_edges": marks, "coded_normals": normals}


def levels_left_out(field, lod):
    """Clause 8.3: L above D counts as D."""
    return min(lod, (field["resolution"] - 1).bit_length())


def triangles_of_field(units, index, of="lattice"):
    """Corner triples of lattice positions, or of UVs, of the faces of a field."""
    return [[unit[of][corner] for corner in face] for unit in units if unit["field"] == index for face in unit["faces"]]


def decode_geometry(unit, position_bits):
    """Clause 5.6: lattice positions, UVs and faces as lists of integer tuples."""
    check_draco_start(unit)
    try:
        mesh = DracoPy.decode(unit["draco_data"])
        found = {(a["attribute_type"], a["data_type"], a["num_components"]): a["data"].tolist() for a in mesh.attributes}
        faces = mesh.faces.tolist()
    except Exception as error:  # whatever the Draco decoder or a mesh without these parts raises
        raise Invalid(f"draco_data does not decode to a mesh: {error}") from error
    textured = unit["support"] == TEXELS
    uv_kind = (TEX_COORD, FLOAT32, 2) if unit.get("uv_bits") else (GENERIC, UINT32, 2)
    wanted = {(POSITION, UINT32, 3), uv_kind} if textured else {(POSITION, UINT32, 3)}
    require(set(found) == wanted and len(mesh.attributes) == len(wanted), f"the Draco attributes are {sorted(found)}")
    lattice = found[POSITION, UINT32, 3]
    most = 3 * unit["unit_faces"] if textured else unit["unit_vertices"]
    require(unit["unit_vertices"] <= len(lattice) <= most, "draco_data decodes to another number of vertices")
    require(len(faces) == unit["unit_faces"], "draco_data decodes to another number of faces")
    uv = decode_uv(unit, found[uv_kind]) if textured else None
    require(all(p < 1 << position_bits for vertex in lattice for p in vertex), "a position is not below 2^position_bits")
    require(geometry_crc(lattice, faces, uv) == unit["geometry_crc"], "the faces do not have the checksum geometry_crc")
    return {"field": unit["field_index"], "material": unit["material_index"], "lattice": lattice, "faces": faces, "uv": uv}


def geometry_crc(lattice, faces, uv):
    """Clause 5.6.3."""
    corners = [position + (uv[i] if uv else []) for i, position in enumerate(lattice)]
    rows = [min(sum((corners[face[(turn + i) % 3]] for i in range(3)), []) for turn in range(3)) for face in faces]
    return sum(zlib.crc32(b"".join(n.to_bytes(4, "little", signed=True) for n in row)) for row in rows) % 2**32


def decode_uv(unit, numbers):
    """Clause 5.6.2: UVs as pairs of integers."""
    if unit["uv_bits"] > 0:
        numbers = [[whole_number(v, unit["uv_bits"], unit["uv_range"]) for v in vertex] for vertex in numbers]
    require(all(n is not None and n < 2**20 for vertex in numbers for n in vertex), "a UV is out of range")
    return [[n + origin for n, origin in zip(vertex, unit["uv_origin"], strict=True)] for vertex in numbers]


def field_keys(field, index, units, position_bits):
    """Clauses 6.4 and 6.5, with the check of num_keys and keys_crc."""
    if field["support"] == TEXELS:
        keys = referenced_texels(triangles_of_field(units, index, "uv"), field)
    else:
        keys = active_voxels(triangles_of_field(units, index), position_bits, field["resolution"], field["area_threshold"])
    require(len(keys) == field["num_keys"], f"{len(keys)} voxels or texels are there, num_keys is {field['num_keys']}")
    require(zlib.crc32(struct.pack(f"<{len(keys)}Q", *keys)) == field["keys_crc"], "keys_crc does not match")
    return keys


def checked_values(unit, keys, lod, checks):
    """Clauses 5.7.6 and 7 on the cells of the plane, with the check of 7.10 where all its levels are decoded."""
    keys = sorted({key >> 3 * unit["level_shift"] for key in keys})
    lod = max(lod - unit["level_shift"], 0)
    if unit["codec_id"] == CONSTANT:
        values = unit["plane_value"] * len({key >> 3 * min(lod, unit["depth"]) for key in keys})
    else:
        values = decode_values(unit, keys, lod, checks)
    require(0 < min(lod, unit["depth"]) or zlib.crc32(values) == unit["values_crc"], "values_crc does not match")
    return values


def neural_values(neural, stream, keys, lod):
    """Clause 11.8, with the check of values_crc, and 8.3: by field and group, the values as bytes."""
    voxels = [neural.voxel_values(i, field["resolution"], keys[i]) for i, field in enumerate(stream["fields"])]
    crc = zlib.crc32(bytes(value for of_field in voxels for of_voxel in of_field for value in of_voxel))
    require(crc == stream["attributes"][0]["values_crc"], "values_crc does not match")
    values = []
    for i, field in enumerate(stream["fields"]):
        nodes, first, of_groups = coarse_values(keys[i], voxels[i], levels_left_out(field, lod)), 0, {}
        for number, group in enumerate(stream["header"]["channel_groups"]):
            last = first + group["components"]
            of_groups[number] = bytes(value for of_node in nodes for value in of_node[first:last])
            first = last
        values.append(of_groups)
    return values


def geometry_rows(units):
    """Clause 9: (field, material, corners) of all triangles, canonical and sorted."""
    rows = []
    for unit in units:
        for face in unit["faces"]:
            a, b, c = (unit["lattice"][corner] for corner in face)
            rows.append([unit["field"], unit["material"], *min(a + b + c, b + c + a, c + a + b)])
    return sorted(rows)


def uv_rows(units, index):
    """Clause 9: (field, material, corners with their UVs) of all triangles of a field over texels, canonical and sorted."""
    rows = []
    for unit in units:
        for face in unit["faces"] if unit["field"] == index else []:
            a, b, c = (unit["lattice"][corner] + unit["uv"][corner] for corner in face)
            rows.append([unit["field"], unit["material"], *min(a + b + c, b + c + a, c + a + b)])
    return sorted(rows)


def arrays(texf):
    """Clause 9: file name -> bytes, for every decoded array."""
    numbers = [number for row in geometry_rows(texf["units"]) for number in row]
    files = {"geometry": struct.pack(f"<{len(numbers)}q", *numbers)}
    if texf["sharp_edges"] is not None:
        files["sharp_edges"] = texf["sharp_edges"]
    if texf["coded_normals"] is not None:
        files["coded_normals"] = texf["coded_normals"]
    for i, field in enumerate(texf["fields"]):
        files[f"field{i}_keys"] = struct.pack(f"<{len(field['keys'])}q", *field["keys"])
        if field["support"] == TEXELS:
            corners = [number for row in uv_rows(texf["units"], i) for number in row]
            files[f"field{i}_uv"] = struct.pack(f"<{len(corners)}q", *corners)
        files |= {f"field{i}_group{g}_values": values for g, values in field["values"].items()}
    return files


def main():
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stream", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lod", type=int, default=0)
    parser.add_argument("--queries", type=Path)
    arguments = parser.parse_args()
    files, checks, refusal = {}, {}, None
    try:
        texf = decode(arguments.stream.read_bytes(), arguments.lod, checks)
        files = arrays(texf)
        if arguments.queries:
            from conformance.reference.queries import answer_files, read_queries  # it stands on this module

            files |= answer_files(texf, read_queries(arguments.queries.read_bytes()))
    except (Invalid, Unsupported) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        refusal = error
    files |= {f"field{i}_group{g}_levels": struct.pack(f"<{len(crcs)}I", *crcs) for (i, g), crcs in checks.items()}
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (arguments.folder / f"{name}.bin").write_bytes(content)
    return 0 if refusal is None else 3 if isinstance(refusal, Invalid) else 5


if __name__ == "__main__":
    sys.exit(main())
