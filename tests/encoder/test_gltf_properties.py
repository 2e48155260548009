"""docs/guide/gltf_properties.md, row by row: files that have every property of glTF are coded and expanded, and compared."""

import io
import re
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from gltf_scenes import remembering, tree_of, with_tree
from gltf_whole import CODED, DRACO, EXTENDED, GLOSSY, IN_VARIANT, ON_POINTS, TRANSFORM, WITHOUT_UV, whole, without_the_unknown
from PIL import Image

import texfcodec
from texfcodec.encoder.container.encode import encode_document
from texfcodec.io.gltf.accessor import read_accessor
from texfcodec.io.gltf.document import open_document
from texfcodec.io.gltf.left_out import _EXTRAS_CARRIED as EXTRAS_CARRIED
from texfcodec.io.gltf.left_out import TABLE
from texfcodec.io.parts import Notes
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import BASE_COLOUR, MAPS, PARAMETERS, PBR

PAGE = Path(__file__).resolve().parents[2] / "docs" / "guide" / "gltf_properties.md"
OPTIONS = EncodeOptions(rate="r06", no_check=True, effort="fast", support="texels")
# The schema of glTF 2.0: properties of each object, besides extensions and extras, which all have.
SCHEMA = {
    "glTF": "asset scene scenes nodes meshes materials cameras animations skins textures images samplers accessors bufferViews "
            "buffers extensionsUsed extensionsRequired",
    "asset": "version minVersion generator copyright", "scene": "name nodes",
    "node": "name matrix translation rotation scale mesh children skin camera weights", "mesh": "name primitives weights",
    "skin": "joints skeleton inverseBindMatrices name", "animation": "name channels samplers",
    "animation.channel": "sampler target", "animation.channel.target": "node path",
    "animation.sampler": "input output interpolation", "camera": "type perspective orthographic name",
    "camera.perspective": "aspectRatio yfov zfar znear", "camera.orthographic": "xmag ymag zfar znear",
    "primitive": "attributes targets indices material mode",
    "material": "name alphaMode alphaCutoff doubleSided emissiveFactor pbrMetallicRoughness normalTexture occlusionTexture "
                "emissiveTexture",
    "pbrMetallicRoughness": "baseColorFactor metallicFactor roughnessFactor baseColorTexture metallicRoughnessTexture",
    "textureInfo": "index texCoord scale strength", "texture": "source sampler name", "image": "bufferView uri mimeType name",
    "sampler": "magFilter minFilter wrapS wrapT name",
    "accessor": "bufferView byteOffset componentType normalized count type max min sparse name",
    "accessor.sparse": "count indices values", "accessor.sparse.indices": "bufferView byteOffset componentType",
    "accessor.sparse.values": "bufferView byteOffset", "bufferView": "buffer byteOffset byteLength byteStride target name",
    "buffer": "byteLength uri name",
}
# Attributes, and the extensions that Khronos has ratified or several vendors share: their properties, those of parts among them.
OTHERS = {
    "attribute": "POSITION NORMAL TANGENT TEXCOORD_n COLOR_0 JOINTS_0 WEIGHTS_0 _HEAT", "morph": "POSITION NORMAL",
    "KHR_animation_pointer": "pointer", "KHR_node_visibility": "visible", "KHR_xmp_json_ld": "packets packet",
    "KHR_lights_punctual": "lights light color intensity type range spot innerConeAngle outerConeAngle name extras",
    "KHR_materials_variants": "variants mappings material name extras",
    "EXT_mesh_gpu_instancing": "TRANSLATION ROTATION SCALE _ID extras", "KHR_draco_mesh_compression": "bufferView attributes",
    "KHR_texture_transform": "offset rotation scale texCoord", "KHR_materials_unlit": "extras", "unknown": "everything",
    GLOSSY: "diffuseFactor diffuseTexture specularFactor glossinessFactor specularGlossinessTexture extras",
}
for _row in (*MAPS, *PARAMETERS):
    if _row.extension not in ("", PBR):
        _key = _row.slot if hasattr(_row, "slot") else _row.key
        _keys = OTHERS.get(_row.extension, "extras").split()
        OTHERS[_row.extension] = " ".join(dict.fromkeys([*_keys, *([] if "." in _key else [_key])]))
KINDS = {"glTF": "file", "asset": "asset", "scene": "scenes", "node": "nodes", "mesh": "meshes", "primitive": "primitives",
         "material": "materials", "textureInfo": "texture infos", "texture": "textures", "image": "images", "sampler": "samplers",
         "accessor": "accessors", "accessor.sparse": "sparse accessors", "bufferView": "bufferViews", "buffer": "buffers",
         "accessor.sparse.indices": "parts of sparse accessors", "accessor.sparse.values": "parts of sparse accessors"}


class Row(NamedTuple):
    """A property in the table. object, key: with what tells them from others, such as "image that is kept"; texf, glb: fates."""

    object: str
    key: str
    texf: str
    glb: str

    @property
    def name(self):
        return self.object.split()[0]

    @property
    def property(self):
        return self.key.split()[0]


def rows_of(text):
    """The Rows of a page."""
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in text.splitlines() if line.startswith("| ")]
    return [Row(entry[0], key, entry[2], entry[3].strip(" |")) for entry in cells if len(entry) == 4 and entry[0] != "object"
            for key in entry[1].split(", ")]


ROWS = rows_of(PAGE.read_text(encoding="utf-8"))


def missing(rows):
    """(object, property) of the schema without a row, or with two, and those of rows that no schema has."""
    listed = defaultdict(list)
    for row in rows:
        listed[row.object].append(row.key)
    schema = {name: {*keys.split(), "extras", "extensions"} for name, keys in SCHEMA.items()}
    schema |= {name: set(keys.split()) for name, keys in OTHERS.items()}
    wrong = [(name, "") for name in schema if name not in {row.name for row in rows}]
    for kind, keys in listed.items():
        properties = {key.split()[0] for key in keys}
        wanted = schema.get(kind.split()[0], set()) - ({"byteStride", "target"} if "image" in kind else set())
        wanted -= {"scale", "strength"} if kind == "textureInfo" else set()
        wrong += [(kind, key) for key in properties ^ wanted] + [(kind, key) for key in keys if keys.count(key) > 1]
    return wrong


def test_every_property_of_gltf_has_a_row_and_no_row_is_of_none():
    assert missing(ROWS) == []


def test_a_row_that_is_left_out_is_missed():
    for row in ROWS[::7]:
        others = [other for other in ROWS if (other.object, other.property) != (row.object, row.property)]
        assert missing(others), row


def test_what_a_texf_keeps_is_what_the_reader_says():
    """The column OUT.texf against TABLE of left_out.py and the tables of channels and parameters."""
    assert [row for row in ROWS if _expected(row) not in ("", row.texf)] == []


def _expected(row):
    """What becomes of a property in a .texf, "" where a row joins several."""
    if row.name in OTHERS:
        carried = {entry.extension for entry in (*MAPS, *PARAMETERS)} | {"KHR_materials_unlit", TRANSFORM}
        expected = "carried" if row.name in carried or row.key in ("diffuseFactor", "diffuseTexture") else "named"
        if row.name in ("attribute", "morph", DRACO):
            expected = {"attribute": "", "morph": "carried", DRACO: "layout"}[row.name]
        return expected
    if row.name not in KINDS and row.name != "pbrMetallicRoughness":
        return TABLE["file"]["animations"]
    kind = KINDS.get(row.name, "parts of materials")
    if row.property in ("extras", "extensions"):
        is_data = row.name in ("texture", "image", "sampler", "accessor", "bufferView", "buffer") or "sparse" in row.name
        return "" if is_data else "carried" if row.property == "extras" and kind in EXTRAS_CARRIED else "named"
    fate = TABLE[kind].get(row.property, "")
    return "" if fate.startswith(">") or " " in row.object and row.name != "textureInfo" else fate


class Pair(NamedTuple):
    """An object of a source and what it became. number: of both, in their arrays; owner: what tells them from others."""

    source: dict
    expanded: dict
    files: tuple
    number: tuple = (0, 0)
    owner: str = ""


@cache
def coded_files():
    """((source, expanded), (source, expanded)) of Documents: with an extension that nobody knows, and without it."""
    code, strange = remembering(), whole()
    pairs = []
    for source in (strange, with_tree(strange, without_the_unknown(tree_of(strange)))):
        report = texfcodec.Report()
        coded = encode_document(source, Path(), OPTIONS, report, code)
        pairs.append(tuple(open_document(data, Path(), Notes()) for data in (source, texfcodec.expand(coded.data))))
        assert report.dropped == report.warnings == []
        assert any("names and extras are left out" in remark for remark in report.remarks)
    return tuple(pairs)


def entries(files, kind):
    """Pairs of an array whose entries keep their numbers."""
    source, expanded = (file.root[kind] for file in files)
    assert len(source) == len(expanded)
    return [Pair(s, e, files, (n, n)) for n, (s, e) in enumerate(zip(source, expanded, strict=True))]


def parts(pairs, key, owner=""):
    """Pairs of a property that is an object, or of the entries of an array."""
    result = []
    for pair in pairs:
        values = pair.source.get(key, []), pair.expanded.get(key, [])
        values = tuple(value if isinstance(value, list) else [value] for value in values)
        result += [Pair(s, e, pair.files, (n, n), owner or pair.owner) for n, (s, e) in enumerate(zip(*values, strict=True))]
    return result


def referred(pairs, key, kind):
    """Pairs of what a property refers to by its number."""
    return [Pair(pair.files[0].root[kind][pair.source[key]], pair.files[1].root[kind][pair.expanded[key]], pair.files,
                 (pair.source[key], pair.expanded[key]), key) for pair in pairs if key in pair.source and key in pair.expanded]


def infos(pairs):
    """Pairs of textureInfo objects in Pairs of materials, at any depth."""
    result = []
    for pair in pairs:
        for key, value in pair.source.items():
            if isinstance(value, dict) and key != "extras" and key in pair.expanded:
                child = Pair(value, pair.expanded[key], pair.files, pair.number, key)
                result += [child] if key.endswith("Texture") else infos([child])
    return result


def of_extension(source, expanded, name, files, inside=False):
    """Pairs of all objects in an extension, wherever it stands."""
    if isinstance(source, list):
        pairs = zip(source, expanded, strict=True) if isinstance(expanded, list) and len(source) == len(expanded) else ()
        return [pair for s, e in pairs for pair in of_extension(s, e, name, files, inside)]
    if not isinstance(source, dict):
        return []
    found = [Pair(source, expanded if isinstance(expanded, dict) else {}, files)] if inside else []
    for key, value in source.items():
        other = expanded.get(key, {}) if isinstance(expanded, dict) else {}
        found += of_extension(value, other, name, files, inside or key == name)
    return found


def _primitives(files):
    return parts(entries(files, "meshes"), "primitives")


def _stored(files):
    """Pairs of the stored accessors of the primitive that has some."""
    primitive = parts(entries(files, "meshes")[1:2], "primitives")[0]
    names = [key for key in primitive.source["attributes"] if key[:3] in ("JOI", "WEI", "COL", "_HE") or key == "TEXCOORD_1"]
    attributes = [pair for name in names for pair in referred(parts([primitive], "attributes"), name, "accessors")]
    targets = [pair._replace(owner="targets") for key in ("POSITION", "NORMAL")
               for pair in referred(parts([primitive], "targets"), key, "accessors")]
    return attributes + targets


def _kept(files):
    """Pairs of accessors that nothing coded needs."""
    samplers = parts(entries(files, "animations"), "samplers")[1:]
    times = [pair._replace(owner="times") for pair in referred(samplers, "input", "accessors")]
    points = parts(_primitives(files)[3:4], "attributes")
    bind = referred(entries(files, "skins"), "inverseBindMatrices", "accessors")
    return times + bind + referred(samplers, "output", "accessors") + referred(points, "TEXCOORD_0", "accessors")


def _coded(files):
    """Pairs of accessors that a stream holds."""
    attributes = parts(_primitives(files)[:1], "attributes")
    pairs = [pair for name in ("POSITION", "NORMAL", "TANGENT") for pair in referred(attributes, name, "accessors")]
    uv = attributes[0].source["TEXCOORD_1"], attributes[0].expanded["TEXCOORD_0"]
    return [*pairs, Pair(files[0].root["accessors"][uv[0]], files[1].root["accessors"][uv[1]], files, uv)]


def _sparse(files):
    return parts([pair for pair in _kept(files) if "sparse" in pair.source], "sparse")


def _infos(files, is_kept):
    materials = entries(files, "materials")
    return infos([materials[n] for n in ((ON_POINTS, IN_VARIANT, WITHOUT_UV) if is_kept else (CODED, EXTENDED))])


def _textures(files, is_kept):
    return referred(_infos(files, is_kept), "index", "textures")


PAIRS = {
    "glTF": lambda files: [Pair(files[0].root, files[1].root, files)],
    "asset": lambda files: parts(PAIRS["glTF"](files), "asset"),
    **{f"{kind}": lambda files, kind=kind: entries(files, kind + ("es" if kind == "mesh" else "s"))
       for kind in ("scene", "node", "mesh", "skin", "animation", "camera", "material")},
    "animation.channel": lambda files: parts(entries(files, "animations"), "channels"),
    "animation.channel.target": lambda files: parts(PAIRS["animation.channel"](files), "target"),
    "animation.sampler": lambda files: parts(entries(files, "animations"), "samplers"),
    "camera.perspective": lambda files: parts(entries(files, "cameras"), "perspective"),
    "camera.orthographic": lambda files: parts(entries(files, "cameras"), "orthographic"),
    "primitive": _primitives, "attribute": _primitives, "morph target": _primitives,
    "pbrMetallicRoughness": lambda files: parts(entries(files, "materials"), PBR),
    "textureInfo of a coded image": lambda files: _infos(files, False),
    "textureInfo of a kept image": lambda files: _infos(files, True),
    "texture of a coded image": lambda files: _textures(files, False),
    "texture of a kept image": lambda files: _textures(files, True),
    "image that is coded": lambda files: referred(_textures(files, False), "source", "images"),
    "image that is kept": lambda files: referred(_textures(files, True), "source", "images"),
    "sampler of a coded image": lambda files: referred(_textures(files, False)[5:], "sampler", "samplers"),  # whose UVs stay
    "sampler of a kept image": lambda files: referred(_textures(files, True), "sampler", "samplers"),
    "accessor that is coded": _coded, "accessor that is stored": _stored, "accessor that is kept": _kept,
    "accessor.sparse of a kept accessor": _sparse,
    "accessor.sparse.indices of a kept accessor": lambda files: parts(_sparse(files), "indices"),
    "accessor.sparse.values of a kept accessor": lambda files: parts(_sparse(files), "values"),
    "bufferView of accessors": lambda files: referred(_coded(files) + _stored(files), "bufferView", "bufferViews"),
    "bufferView of a kept image": lambda files: referred(PAIRS["image that is kept"](files), "bufferView", "bufferViews"),
    "buffer": lambda files: [Pair(files[0].root["buffers"][n], files[1].root["buffers"][0], files) for n in range(2)],
}
# Which of an object's Pairs a row is about, by the words behind its property.
FILTERS = {
    "of triangles": lambda pair: pair.source.get("mode", 4) > 3,
    "of points and lines": lambda pair: pair.source.get("mode", 4) < 4,
    "of targets": lambda pair: pair.owner == "targets", "of attributes": lambda pair: pair.owner != "targets",
    "of times": lambda pair: pair.owner == "times",
    "of others": lambda pair: pair.owner != "times" and pair.files is coded_files()[1],
}


def pairs_of(row):
    """The Pairs of a row, of both files."""
    found = []
    for files in coded_files():
        if row.name.startswith(("KHR_", "EXT_")):
            roots = tuple(file.root for file in files)
            if "image" in row.object:
                roots = tuple([pair[n] for pair in _infos(files, "kept" in row.object)] for n in range(2))
            found += of_extension(*roots, row.name, files)
        else:
            found += PAIRS[row.object](files)
    wanted = FILTERS.get(row.key.partition(" ")[2], lambda pair: True)
    return [pair for pair in found if row.property in pair.source and wanted(pair)]


KEPT = [row for row in ROWS if row.name not in ("attribute", "morph", "unknown")]


@pytest.mark.parametrize("row", KEPT, ids=lambda row: f"{row.object} {row.key}")
def test_a_property_becomes_what_the_table_says(row):
    pairs, fate = pairs_of(row), re.split(r"[:,;]| if | where ", row.glb)[0]
    assert pairs, "the files have no such property"
    if fate == "new":
        assert row.object == "glTF" or any(pair.source[row.property] != pair.expanded.get(row.property) for pair in pairs) \
            or row.property in UNCHANGED_BY_CHANCE
    for pair in pairs:
        CHECKS[fate](row, pair)


# Of what is written anew, what may well be equal.
UNCHANGED_BY_CHANCE = ("mimeType", "buffer", "target", "count")


def _is_untouched(row, pair):
    before, after = pair.source[row.property], pair.expanded.get(row.property)
    if "the entries and their order" in row.glb:
        assert len(before) == len(after)
    elif row.glb.startswith("untouched: see its rows"):
        assert before.keys() == after.keys()
    elif row.property in ("extensionsUsed", "extensionsRequired"):
        assert [name for name in before if name != DRACO] == after
    elif row.property == "extensions" and isinstance(before, dict):
        kept = {name for name in before if name not in ((DRACO, TRANSFORM) if "coded" in row.object else (DRACO,))}
        assert kept == set(after or {})
    elif row.property.endswith("Texture"):
        assert {key: value for key, value in before.items() if key != "index"} == {
            key: value for key, value in after.items() if key != "index"}
    else:
        assert before == after


def _is_gone(row, pair):
    assert row.property not in pair.expanded


def _is_new(row, pair):
    """What is written anew has the type that the table says, the same faces, or entries that are the source's."""
    if row.object == "glTF":
        before, after = (tree_labels(owner[row.property]) for owner in (pair.source, pair.expanded))
        assert after <= before and (row.property == "buffers" or after)
    elif row.property in ("indices", "attributes", "targets"):
        if {"POSITION", "NORMAL"} <= pair.source["attributes"].keys():
            matching(*(centres(*at) for at in zip(pair.files, (pair.source, pair.expanded), strict=True)))
    elif row.name == "sampler":
        assert pair.expanded["minFilter"] == 9987
    elif row.property in ("componentType", "normalized"):
        assert pair.expanded["componentType"] == 5126 and "normalized" not in pair.expanded


def tree_labels(entries_of):
    return {entry["extras"]["of"] for entry in entries_of if "extras" in entry}


def _has_same_values(row, pair):
    key, (before, after) = row.property, pair.files
    kinds = ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT4")
    if row.name == "animation.sampler":
        times, values = ([read_accessor(file, owner[key], kinds) for key in ("input", "output")]
                         for file, owner in ((before, pair.source), (after, pair.expanded)))
        at = np.searchsorted(times[0][:, 0], values[0][:, 0])
        rows = len(times[1]) // len(times[0])
        assert np.array_equal(times[0][at], values[0])
        assert np.array_equal(times[1].reshape(len(times[0]), rows, -1)[at].reshape(values[1].shape), values[1])
    elif row.name == "accessor":
        assert np.array_equal(*(read_accessor(file, n, kinds) for file, n in zip(pair.files, pair.number, strict=True)))
    elif key in ("source", "sampler", "index"):
        kind = {"source": "images", "sampler": "samplers", "index": "textures"}[key]
        assert before.root[kind][pair.source[key]]["name"] == after.root[kind][pair.expanded[key]]["name"]
    elif key in ("indices", "values"):
        assert pair.source[key]["extras"] == pair.expanded[key]["extras"]
    elif key == "bufferView":
        assert bytes(before.view(pair.source[key])[0]) == bytes(after.view(pair.expanded[key])[0])
    else:
        assert np.array_equal(read_accessor(before, pair.source[key], kinds), read_accessor(after, pair.expanded[key], kinds))


def _is_coded(row, pair):
    """The slots of coded materials show the picture of the source at each face's centre."""
    for number, mesh in ((CODED, 0), (EXTENDED, 1)):
        owners = [_owner(file.root["materials"][number], row.name) for file in pair.files]
        if row.property in owners[0]:
            primitives = [file.root["meshes"][mesh]["primitives"][0] for file in pair.files]
            shown = [_shown(*at, row.property) for at in zip(pair.files, primitives, owners, strict=True)]
            order = matching(*(centres(*at) for at in zip(pair.files, primitives, strict=True)))
            assert np.abs(shown[0][order] - shown[1]).mean() < (12 if "ormal" in row.property else 6)


def _owner(material, name):
    """The object of a material that has the slots of a core object or an extension."""
    return material if name == "material" else material[name] if name == PBR else material.get("extensions", {}).get(name, {})


def _shown(file, primitive, owner, slot):
    """Values 0..255 of a slot's picture at the centre of each face, [F, C]."""
    info, channels = owner[slot], [channel for channel in (BASE_COLOUR, *MAPS) if channel.slot == slot]
    uv = of_faces(file, primitive, primitive["attributes"][f"TEXCOORD_{info.get('texCoord', 0)}"]).mean(axis=1)
    moved = info.get("extensions", {}).get(TRANSFORM)
    if moved:
        sine, cosine = np.sin(moved["rotation"]), np.cos(moved["rotation"])
        uv = uv * moved["scale"] @ np.array([[cosine, -sine], [sine, cosine]]) + moved["offset"]
    texture = file.root["textures"][info["index"]]
    sampler = file.root["samplers"][texture["sampler"]]
    picture = np.asarray(Image.open(io.BytesIO(bytes(file.image_bytes(texture["source"])))).convert("RGBA"), np.float64)
    wraps = (sampler["wrapS"], uv[:, 0], picture.shape[1]), (sampler["wrapT"], uv[:, 1], picture.shape[0])
    column, line = (np.clip((_wrapped(wrap, at) * size).astype(int), 0, size - 1) for wrap, at, size in wraps)
    columns = sorted({c for channel in channels for c in channel.columns})
    values = picture[line, column]
    if "ormal" in slot:
        return 127.5 + 127.5 * _in_space(file, primitive, unit(values[:, :3] / 127.5 - 1))
    return values[:, (2,) if slot == "anisotropyTexture" else columns]


def _in_space(file, primitive, normals):
    """Normals of a map in the mesh's space, if it has tangents."""
    if "TANGENT" not in primitive["attributes"]:
        return normals
    normal, tangent = (of_faces(file, primitive, primitive["attributes"][key]).mean(axis=1) for key in ("NORMAL", "TANGENT"))
    frame = tangent[:, :3], tangent[:, 3:] * np.cross(normal, tangent[:, :3]), normal
    return sum(normals[:, [k]] * axis for k, axis in enumerate(frame))


def _wrapped(wrap, at):
    return np.clip(at, 0, 1) if wrap == 33071 else 1 - np.abs(1 - at % 2) if wrap == 33648 else at % 1


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def of_faces(file, primitive, accessor):
    """Values of an accessor at the corners of a primitive's faces, float64 [F, 3, k]."""
    index = read_accessor(file, primitive["indices"], ("SCALAR",))[:, 0].astype(np.int64)
    if primitive.get("mode", 4) == 5:
        index = np.stack([index[:-2], index[1:-1], index[2:]], axis=1)
    values = read_accessor(file, accessor, ("SCALAR", "VEC2", "VEC3", "VEC4")).astype(np.float64)
    if values.max(initial=0) > 60000:
        values /= 65535  # of UVs in unsigned integers
    return values[index.reshape(-1, 3)]


def centres(file, primitive):
    return of_faces(file, primitive, primitive["attributes"]["POSITION"]).mean(axis=1)


def matching(source, expanded):
    """The source's face that each face is, of whose centres none is further than the rate's positions allow."""
    distance = np.linalg.norm(source[:, None] - expanded[None], axis=2)
    order = distance.argmin(axis=0)
    assert distance.min(axis=0).max() < 2e-3 and sorted(order) == list(range(len(source)))
    return order


CENTRED = {"NORMAL": 0.03, "TANGENT": 0.03, "POSITION": 2e-3}  # bounds of what is coded; stored values are equal


def attribute_errors(files, mesh, names, target=None):
    """Greatest difference at the centres of faces. names: of the attribute in the source and in the expanded file."""
    primitives = [file.root["meshes"][mesh]["primitives"][0] for file in files]
    order = matching(*(centres(*at) for at in zip(files, primitives, strict=True)))
    owners = [entry["attributes"] if target is None else entry["targets"][target] for entry in primitives]
    source, expanded = (of_faces(file, primitive, owner[name]).mean(axis=1)
                        for file, primitive, owner, name in zip(files, primitives, owners, names, strict=True))
    return float(np.abs(source[order] - expanded).max())


@pytest.mark.parametrize("row", [row for row in ROWS if row.name in ("attribute", "morph")], ids=str)
def test_an_attribute_becomes_what_the_table_says(row):
    for files in coded_files():
        if row.object == "morph target":
            errors = [attribute_errors(files, 1, (row.key, row.key), n) for n, target in enumerate(
                files[0].root["meshes"][1]["primitives"][0]["targets"]) if row.key in target]
        elif row.key == "TANGENT":
            entry = files[1].root["meshes"][0]["primitives"][0]
            normal, tangent = (of_faces(files[1], entry, entry["attributes"][key])[..., :3] for key in ("NORMAL", "TANGENT"))
            errors = [np.abs((normal * tangent).sum(axis=2)).max(), np.abs(np.linalg.norm(tangent, axis=2) - 1).max()]
        elif row.key == "TEXCOORD_n of no image":
            first, second = (file.root["meshes"][0]["primitives"][0]["attributes"] for file in files)
            errors = [len(second.keys() & {"TEXCOORD_0", "TEXCOORD_1"}) - len(first.keys() & {"TEXCOORD_0", "TEXCOORD_1"}) + 1]
        else:
            names = {"TEXCOORD_n of a kept image": ("TEXCOORD_1",) * 2}
            mesh = 1 if row.glb == "stored" else 0
            errors = [] if "of a coded" in row.key else [attribute_errors(files, mesh, names.get(row.key, (row.key,) * 2))]
            if "of a coded" in row.key:  # whose values the pictures' rows compare
                errors = [float("TEXCOORD_0" not in files[1].root["meshes"][0]["primitives"][0]["attributes"])]
        assert errors and max(errors) <= CENTRED.get(row.key, 1e-5)


def test_all_that_an_unknown_extension_may_refer_to_keeps_its_number():
    strange, known = coded_files()
    for kind in ("accessors", "textures", "images", "samplers"):
        before, after = (file.root[kind] for file in strange)
        assert [entry["name"] for entry in after[: len(before)]] == [entry["name"] for entry in before]
        assert len(known[1].root[kind]) < len(after)


CHECKS = {"untouched": _is_untouched, "gone": _is_gone, "new": _is_new, "same values": _has_same_values, "coded": _is_coded}
