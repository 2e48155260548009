"""The vectors of conformance/container/: small glTF files with TEXF_stream at their primitives, and what they expand to.

    python -m conformance.make.containers --write | --check
"""

import base64
import json
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
from gltf_scenes import Builder, bumpy, textured, tree_of, with_tree
from run_containers import own, primitives_of

import texfcodec
from conformance.make.promise import promised

HOME = Path(__file__).resolve().parents[1] / "container"
NAME = "TEXF_stream"
LARGEST = 1 << 14
OPTIONS = {"rate": "r06", "no_check": True, "effort": "fast"}


# Files


def sheet(builder, material=None, mesh=0, count=3, **more):
    """Add a bumpy square to a mesh; return its primitive."""
    while len(builder.tree["meshes"]) <= mesh:
        builder.tree["nodes"].append({"mesh": builder.add("meshes", {"primitives": []})})
        builder.tree["scenes"][0]["nodes"].append(len(builder.tree["nodes"]) - 1)
    positions, uv, faces = bumpy(count)
    return builder.primitive(positions + np.float32(mesh), faces, uv, mesh=mesh, **more,
                             **({} if material is None else {"material": material}))


def plain():
    """A textured sheet."""
    b = Builder()
    sheet(b, textured(b))
    return b


def pair(**node):
    """Two sheets of one image. node: properties of the first one's node."""
    b = plain()
    b.tree["nodes"][0] |= node
    sheet(b, 0, mesh=1)
    return b


def weighted(count=3, doubled=False):
    """A sheet with joints and weights. doubled: whether every other face has vertices of its own at the same positions."""
    b = Builder()
    positions, uv, faces = bumpy(count)
    if doubled:
        faces = np.where(np.arange(len(faces))[:, None] % 2, faces, faces + len(positions)).astype(np.uint16)
        positions, uv = np.concatenate([positions, positions]), np.concatenate([uv, uv])
    weight = (np.arange(len(positions), dtype=np.float32)[:, None] % 7) / 8
    weights = np.concatenate([weight, 1 - weight, 0 * weight, 0 * weight], axis=1)
    joints = np.tile(np.array([0, 1, 0, 0], np.uint8), (len(positions), 1))
    b.primitive(positions, faces, uv, material=textured(b),
                attributes={"JOINTS_0": b.accessor(joints), "WEIGHTS_0": b.accessor(weights)})
    b.tree["nodes"] = [{"mesh": 0, "skin": 0}, {}, {"translation": [0, 1, 0]}]
    b.tree |= {"scenes": [{"nodes": [0, 1, 2]}], "skins": [{"joints": [1, 2]}]}
    return b


def morphing(sparse):
    """A sheet with a morph target."""
    b = Builder()
    moved = np.zeros_like(bumpy(3)[0])
    moved[4:6, 1] = 0.5
    entry = {"count": len(moved), "type": "VEC3", "componentType": 5126, "min": [0.0, 0.0, 0.0], "max": [0.0, 0.5, 0.0]}
    if sparse:
        entry["sparse"] = {"count": 2, "indices": {"bufferView": b.view(np.array([4, 5], np.uint16).tobytes()),
                                            "componentType": 5123},
                           "values": {"bufferView": b.view(moved[4:6].tobytes())}}
    else:
        entry["bufferView"] = b.view((moved + np.float32(0.25)).tobytes())
        entry |= {"min": [0.25] * 3, "max": [0.25, 0.75, 0.25]}
    sheet(b, textured(b), targets=[{"POSITION": b.add("accessors", entry)}])
    b.tree["meshes"][0]["weights"] = [0.5]
    return b


def with_attributes():
    """A sheet with attributes of an application and colours of bytes."""
    b = Builder()
    count = len(bumpy(3)[0])
    colours = np.arange(3 * count, dtype=np.uint8).reshape(-1, 3)
    sheet(b, textured(b), attributes={"_HEAT": b.accessor(np.arange(count, dtype=np.float32)),
                                      "COLOR_0": b.accessor(colours, normalized=True)})
    return b


def with_normals():
    """Two sheets, the first with smooth normals, under a node of three scales."""
    b = pair(scale=[1, 2, 4])
    normals = np.tile(np.float32([0.6, 0.8, 0]), (9, 1))
    b.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = b.accessor(normals)
    return b


def with_variant():
    """A sheet whose variant shows an image at the UV set 0, which stays."""
    b = Builder()
    shown, other = textured(b), textured(b)
    b.tree["materials"][shown]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 1
    sheet(b, shown, attributes={"TEXCOORD_1": b.accessor(bumpy(3)[1])}, extensions={"KHR_materials_variants": {"mappings": [
        {"material": other, "variants": [0]}]}})
    b.tree |= {"extensionsUsed": ["KHR_materials_variants"],
               "extensions": {"KHR_materials_variants": {"variants": [{"name": "other"}]}}}
    return b


def many_slots():
    """A sheet with four images."""
    b = plain()
    info = [{"index": b.tree["materials"][textured(b)]["pbrMetallicRoughness"]["baseColorTexture"]["index"]} for _ in range(3)]
    b.tree["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"] = info[0]
    b.tree["materials"][0] |= {"emissiveTexture": info[1], "emissiveFactor": [1, 1, 1], "occlusionTexture": info[2],
                               "alphaMode": "MASK"}
    return b


def beside(b):
    """A file with points beside its sheet, and an accessor that only an unknown extension refers to."""
    b.primitive(np.eye(3, dtype=np.float32), None, mode=0)
    b.tree |= {"extensionsUsed": ["ACME_curves"],
               "extensions": {"ACME_curves": {"table": b.accessor(np.arange(4, dtype=np.float32))}}}
    return b


def without_material(**material):
    """A sheet without an image. material: what its material is, if it has one."""
    b = Builder()
    sheet(b, b.add("materials", material) if material else None)
    return b


def coded(builder, **options):
    """The GLB with streams of a Builder."""
    return texfcodec.encode_gltf(builder.glb(), OPTIONS | options).data


def bent(data, bend):
    """A GLB with its JSON changed in place."""
    root = deepcopy(tree_of(data))
    bend(root)
    return with_tree(data, root)


def primitive(root, mesh=0):
    """A mesh's first primitive."""
    return root["meshes"][mesh]["primitives"][0]


def extension(root, mesh=0):
    """The extension of a mesh's first primitive."""
    return primitive(root, mesh)["extensions"][NAME]


def attribute(root, name):
    """The accessor of an attribute of the first primitive."""
    return root["accessors"][primitive(root)["attributes"][name]]


def deflated(root):
    """The first view that is stored deflated."""
    return next(view for view in root["bufferViews"] if NAME in view.get("extensions", {}))


def stream_view(root, number=0):
    """The bufferView of a stream."""
    return root["bufferViews"][root["extensions"][NAME]["streams"][number]]


# Changes


def _mirror(root):
    extension(root)["matrix"] = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1]
    box = attribute(root, "POSITION")
    low, high = box["min"][0], box["max"][0]
    box |= {"min": [2 - high, *box["min"][1:]], "max": [2 - low, *box["max"][1:]]}


def _join(root):
    """Make the units of two primitives those of one, the second first."""
    units = extension(root, 1)["units"] + extension(root)["units"]
    extension(root)["units"] = units
    for entry in root["accessors"]:
        entry["count"] *= 2
    root["accessors"][primitive(root)["attributes"]["POSITION"]] |= {"min": [0, -1, 0], "max": [2, 2, 2]}
    root["meshes"][1]["primitives"] = [{**primitive(root), "mode": 0, "attributes": {}}]
    del root["meshes"][1:], root["nodes"][1:]
    root["scenes"] = [{"nodes": [0]}]


def _leave_unit(root):
    del root["meshes"][1:], root["nodes"][1:]
    root["scenes"] = [{"nodes": [0]}]


def _transform(root):
    root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
        "KHR_texture_transform": {"scale": [3, 5], "offset": [0.25, 0.5]}}
    root["extensionsUsed"].append("KHR_texture_transform")


def in_data_uri(data):
    """The GLB with its stream in a buffer of its own, which is a data URI."""
    rest = data[28 + int.from_bytes(data[12:16], "little") :]

    def bend(root):
        view = stream_view(root)
        stream = rest[view.get("byteOffset", 0) :][: view["byteLength"]]
        uri = "data:application/octet-stream;base64," + base64.b64encode(stream).decode()
        root["buffers"].append({"byteLength": len(stream), "uri": uri})
        view |= {"buffer": 1, "byteOffset": 0}

    return bent(data, bend)


def with_splits(data, rows):
    """The GLB with other splits, uint32 [N, 2], in a data URI."""
    def bend(root):
        stored = np.array(rows, "<u4").tobytes()
        root["buffers"].append({"byteLength": len(stored), "uri": "data:;base64," + base64.b64encode(stored).decode()})
        root["bufferViews"].append({"buffer": len(root["buffers"]) - 1, "byteLength": len(stored)})
        root["accessors"].append({"bufferView": len(root["bufferViews"]) - 1, "count": len(rows), "type": "VEC2",
                                  "componentType": 5125})
        extension(root)["splits"] = len(root["accessors"]) - 1

    return bent(data, bend)


# Claims: what is in a good file, looked up in its JSON and its decoded streams.


def _primitives(file):
    primitives = [p for mesh in file.root["meshes"] for p in mesh["primitives"]]
    return [p["extensions"][NAME] | p for p in primitives if NAME in p.get("extensions", {})]


def _targets(file):
    numbers = [n for p in _primitives(file) for target in p.get("targets", ()) for n in target.values()]
    return [file.root["accessors"][n] for n in numbers]


CLAIMS = {
    "{} primitives": lambda file, count: len(_primitives(file)) == count,
    "{} streams": lambda file, count: len(file.streams) == count,
    "{} units in a primitive, not in order": lambda file, count: any(
        len(p["units"]) == count and p["units"] != sorted(p["units"]) for p in _primitives(file)),
    "a unit of no primitive": lambda file: sum(len(p["units"]) for p in _primitives(file)) < sum(
        len(texf.units) for texf in file.streams),
    "a matrix": lambda file: any(np.linalg.det(np.reshape(p["matrix"], (4, 4))) > 0 for p in _primitives(file) if "matrix" in p),
    "a matrix that mirrors": lambda file: any(np.linalg.det(np.reshape(p["matrix"], (4, 4))) < 0 for p in _primitives(file)),
    "splits": lambda file: any("splits" in p for p in _primitives(file)),
    "stored {}": lambda file, name: any("bufferView" in file.root["accessors"][p["attributes"][name]]
                                        for p in _primitives(file) if name in p["attributes"]),
    "a target": lambda file: any("bufferView" in entry for entry in _targets(file)),
    "a sparse target": lambda file: any("sparse" in entry for entry in _targets(file)),
    "a deflated view": lambda file: any(NAME in view.get("extensions", {}) for view in file.root["bufferViews"]),
    "UV set {} from the stream": lambda file, number: any(p.get("texCoord", 0) == number for p in _primitives(file)),
    "normals": lambda file: any("NORMAL" in p["attributes"] for p in _primitives(file)),
    "no material": lambda file: any("material" not in p for p in _primitives(file)),
    "a material without images": lambda file: "Texture" not in json.dumps(file.root["materials"]),
    "{} slots of one material": lambda file, count: json.dumps(file.root["materials"][0]).count("Texture") == count,
    "an image that stays": lambda file: len(file.root["images"]) > 0,
    "a void texture transform": lambda file: "KHR_texture_transform" in file.root["extensionsUsed"],
    "a field over voxels": lambda file: any(not field.over_texels for texf in file.streams for field in texf.fields),
    "points beside it": lambda file: any(p.get("mode") == 0 for mesh in file.root["meshes"] for p in mesh["primitives"]),
    "an extension that nobody knows": lambda file: "ACME_curves" in file.root["extensionsUsed"],
    "a stream in a data URI": lambda file: "uri" in file.root["buffers"][1],
}


class File:
    """A coded file. root: its JSON; streams: decoded."""

    def __init__(self, data):
        from texfcodec.io.container.layout import streams_of
        from texfcodec.io.gltf.document import open_document
        from texfcodec.io.parts import Notes

        self.root = tree_of(data)
        self.streams = [texfcodec.decode(stream) for stream in streams_of(open_document(data, Path(), Notes()))]


def _of_two_kinds():
    """A sheet with a stored attribute and one without, which have streams of their own."""
    b = with_attributes()
    sheet(b, textured(b), mesh=1)
    return b


SOURCES = {  # Builders by the name of the vector that is coded from them
    "one_primitive": plain, "one_stream": pair, "two_streams": _of_two_kinds, "normals": with_normals, "skinned": weighted,
    "matrix": lambda: pair(scale=[2, 3, 4], rotation=[0, 0.6, 0, 0.8], translation=[9, 8, 7]),
    "splits": lambda: weighted(4, doubled=True), "deflated": lambda: weighted(6),
    "target": lambda: morphing(sparse=False), "target_sparse": lambda: morphing(sparse=True),
    "attributes": with_attributes, "uv_set": with_variant, "no_material": without_material,
    "no_image": lambda: without_material(name="red", doubleSided=True), "slots": many_slots, "beside": lambda: beside(plain()),
}


def good():
    """Rows (name, claims, data)."""
    files = {name: coded(source()) for name, source in SOURCES.items()}
    rows = [
        ("one_primitive", [("{} primitives", 1), ("{} streams", 1)]),
        ("one_stream", [("{} primitives", 2), ("{} streams", 1)]),
        ("two_streams", [("{} primitives", 2), ("{} streams", 2)]),
        ("matrix", ["a matrix"]),
        ("normals", ["normals", "a matrix"]),
        ("skinned", [("stored {}", "JOINTS_0"), ("stored {}", "WEIGHTS_0")]),
        ("splits", ["splits", ("stored {}", "WEIGHTS_0")]),
        ("deflated", ["a deflated view"]),
        ("target", ["a target"]),
        ("target_sparse", ["a sparse target"]),
        ("attributes", [("stored {}", "_HEAT"), ("stored {}", "COLOR_0")]),
        ("uv_set", [("UV set {} from the stream", 1), ("stored {}", "TEXCOORD_0"), "an image that stays"]),
        ("no_material", ["no material"]),
        ("no_image", ["a material without images"]),
        ("slots", [("{} slots of one material", 4)]),
        ("beside", ["points beside it", "an extension that nobody knows"]),
    ]
    return [(name, claims, files[name]) for name, claims in rows] + [
        ("mirrored", ["a matrix that mirrors"], bent(files["one_primitive"], _mirror)),
        ("normals_mirrored", ["normals", "a matrix that mirrors"], bent(files["normals"], _mirror)),
        ("unit_order", [("{} units in a primitive, not in order", 2)], bent(files["one_stream"], _join)),
        ("unit_unused", ["a unit of no primitive"], bent(files["one_stream"], _leave_unit)),
        ("transform", ["a void texture transform"], bent(files["one_primitive"], _transform)),
        ("voxels", ["a field over voxels"], coded(plain(), support="voxels", resolution=16)),
        ("data_uri", ["a stream in a data URI"], in_data_uri(files["one_primitive"])),
    ]


def _stream_within(root):
    view = stream_view(root)
    root["extensions"][NAME]["streams"].append(len(root["bufferViews"]))
    root["bufferViews"].append(view | {"byteOffset": view["byteOffset"] + 1, "byteLength": view["byteLength"] - 2})


def faulty():
    """Rows (name, title, code, data)."""
    two, skin, doubled = (coded(SOURCES[name]()) for name in ("one_stream", "deflated", "splits"))
    invalid = "TXF-I09"
    bends = [
        ("stream_missing", "a stream that is not there", invalid, two, lambda r: extension(r).update(stream=7)),
        ("stream_negative", "a stream of a negative number", invalid, two, lambda r: extension(r).update(stream=-1)),
        ("stream_float", "a stream's number with a point", invalid, two, lambda r: extension(r).update(stream=0.5)),
        ("stream_view", "a stream's view that is not there", invalid, two, lambda r: r["extensions"][NAME].update(streams=[99])),
        ("stream_cut", "a stream without its last byte", "TXF-S02", two,
         lambda r: stream_view(r).update(byteLength=stream_view(r)["byteLength"] - 1)),
        ("stream_overlap", "a view that is two streams", invalid, two,
         lambda r: r["extensions"][NAME].update(streams=r["extensions"][NAME]["streams"] * 9)),
        ("stream_within", "a stream within another", invalid, two, _stream_within),
        ("streams_no_array", "streams that are no array", invalid, two, lambda r: r["extensions"][NAME].update(streams=0)),
        ("unit_missing", "a unit that is not there", invalid, two, lambda r: extension(r).update(units=[0, 2])),
        ("unit_twice", "a unit twice in a primitive", invalid, two, lambda r: extension(r).update(units=[0, 0])),
        ("unit_shared", "a unit of two primitives", invalid, two, lambda r: extension(r, 1).update(units=extension(r)["units"])),
        ("units_empty", "a primitive without units", invalid, two, lambda r: extension(r).update(units=[])),
        ("matrix_flat", "a matrix without inverse", invalid, two,
         lambda r: extension(r).update(matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1])),
        ("matrix_short", "a matrix of 15 numbers", invalid, two, lambda r: extension(r).update(matrix=[1] * 15)),
        ("matrix_huge", "a matrix that takes positions beyond binary32", invalid, two,
         lambda r: extension(r).update(matrix=[1e300, 0, 0, 0, 0, 1e300, 0, 0, 0, 0, 1e300, 0, 0, 0, 0, 1])),
        ("uv_negative", "a UV set of a negative number", invalid, two, lambda r: extension(r).update(texCoord=-1)),
        ("splits_missing", "splits that are not there", invalid, skin, lambda r: extension(r).update(splits=99)),
        ("splits_scalar", "splits that are no pairs", invalid, doubled,
         lambda r: r["accessors"][extension(r)["splits"]].update(type="SCALAR")),
        ("count_other", "stored attributes for fewer vertices", invalid, skin,
         lambda r: [attribute(r, name).update(count=3) for name in ("JOINTS_0", "WEIGHTS_0")]),
        ("counts_differ", "stored attributes of two counts", invalid, skin, lambda r: attribute(r, "JOINTS_0").update(count=3)),
        ("deflated_cut", "deflated data that ends early", "TXF-I11", skin,
         lambda r: deflated(r)["extensions"][NAME].update(byteLength=40)),
        ("deflated_more", "bytes behind deflated data", "TXF-I11", skin, lambda r: deflated(r)["extensions"][NAME].update(
            byteLength=deflated(r)["extensions"][NAME]["byteLength"] + 1)),
        ("deflated_length", "a deflated view of another length", "TXF-I11", skin,
         lambda r: deflated(r).update(byteLength=deflated(r)["byteLength"] - 16)),
        ("deflated_row", "rows of no bytes", invalid, skin, lambda r: deflated(r)["extensions"][NAME].update(row=0)),
    ]
    rows = [(name, title, code, bent(data, bend)) for name, title, code, data, bend in bends]
    return rows + [("splits_corner", "a split of a corner that is not there", "TXF-I11", with_splits(doubled, [[999, 16]])),
                   ("splits_vertex", "a split to a vertex that is not there", "TXF-I11", with_splits(doubled, [[0, 999]]))]


# Cases


def unkept(claims, data):
    """Return the claims that are not in a good file."""
    file = File(data)
    return [claim for claim in claims for key, *arguments in [[claim] if isinstance(claim, str) else claim]
            if not CLAIMS[key](file, *arguments)]


def expected(data):
    """Return the arrays of expected.json: of attributes that the coded file names, and of texture slots."""
    exit_code, plain_file, said = own(data)
    if exit_code:
        raise SystemExit(f"a good file is refused: {said}")
    named = [p for mesh in tree_of(data)["meshes"] for p in mesh["primitives"] if p.get("mode", 4) == 4]
    streams = [f"TEXCOORD_{p.get('extensions', {}).get(NAME, {}).get('texCoord', 0)}" for p in named]
    return [{name: [[float(f"{value:.8g}") for value in row] for row in values.tolist()] for name, values in arrays.items()
             if name != uv and (name in p["attributes"] or name.startswith("target ") or name.endswith("Texture"))}
            for arrays, p, uv in zip(primitives_of(plain_file), named, streams, strict=True)]


def title_of(claims):
    """Return the sentence of claims."""
    return ", ".join(key.format(*arguments) for key, *arguments in [[c] if isinstance(c, str) else c for c in claims])


def files():
    """Return {path below conformance/container: bytes}."""
    out = {}
    for name, claims, data in good():
        if missing := unkept(claims, data):
            raise SystemExit(f"{name}: {missing} are not in the file")
        out[name] = data, {"title": title_of(claims), "claims": claims, "primitives": expected(data)}
    for name, title, code, data in faulty():
        if not own(data)[2].startswith(code):
            raise SystemExit(f"{name}: {own(data)} instead of {code}")
        out[f"faulty_{name}"] = data, {"title": title, "code": code}
    large = [name for name, (data, _) in out.items() if len(data) > LARGEST]
    if large:
        raise SystemExit(f"{large} are too large")
    return {f"{name}/{file}": content for name, (data, case) in out.items()
            for file, content in (("in.glb", data), ("expected.json", (json.dumps(case) + "\n").encode()))}


def main():
    """Run the command of the module's description."""
    expected, old = files(), promised()
    there = {path.relative_to(HOME).as_posix(): path.read_bytes() for path in HOME.glob("*/*")}
    other = [name for name in sorted(there.keys() | expected.keys()) if there.get(name) != expected.get(name)]
    kept = {name: there[name] for name in other if f"container/{name.split('/')[0]}" in old and name in there}
    differing = [name for name in other if name not in kept]
    lines = [f"{name}: {'promised, and kept' if name in kept else 'differs'}" for name in other]
    print(*lines, f"{len(expected) // 2} vectors", sep="\n")
    if sys.argv[1:] == ["--write"]:
        for name in there.keys() - (expected | kept).keys():
            (HOME / name).unlink()
        for name, content in (expected | kept).items():
            (HOME / name).parent.mkdir(parents=True, exist_ok=True)
            (HOME / name).write_bytes(content)
    return 7 if differing and sys.argv[1:] == ["--check"] else 0


if __name__ == "__main__":
    sys.exit(main())
