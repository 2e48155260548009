"""glTF scenes that have every property of glTF 2.0 and of its ratified extensions, none of them at its default."""

import base64
import io

import DracoPy
import numpy as np
from gltf_scenes import INSTANCES, LIGHTS, VARIANTS, bumpy
from mesh_files import SQUARE, SQUARE_UV, TWO, Builder
from PIL import Image

from texfcodec.scene.channels import BASE_COLOUR, MAPS, PARAMETERS, PBR

DRACO = "KHR_draco_mesh_compression"
XMP, VISIBLE, POINTER, TRANSFORM = "KHR_xmp_json_ld", "KHR_node_visibility", "KHR_animation_pointer", "KHR_texture_transform"
ACME, GLOSSY, UNLIT = "ACME_wax", "KHR_materials_pbrSpecularGlossiness", "KHR_materials_unlit"
CODED, EXTENDED, ON_POINTS, IN_VARIANT, WITHOUT_UV, BARE = range(6)  # materials


def gradients(number, side=16):
    """A PNG of four smooth channels, which differ from number to number, bytes."""
    rows, columns = np.indices((side, side)) / (side - 1)
    waves = [0.5 + 0.4 * np.sin(1.5 * (rows * (c + 1) + columns * (4 - c)) / 2 + number + 1.7 * c) for c in range(4)]
    waves[2] = (1 + waves[2]) / 2  # a normal map's z
    out = io.BytesIO()
    Image.fromarray(np.rint(255 * np.stack(waves, axis=2)).astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


def labels(what):
    """Extras and an extension that nobody knows."""
    return {"extras": {"of": what}, "extensions": {ACME: {"of": what}}}


class _Whole(Builder):
    """A Builder whose entries have names, extras and extensions."""

    def add(self, kind, entry):
        number = super().add(kind, entry)
        if kind != "buffers":
            label = f"{kind} {number}"
            self.tree[kind][number] = {"name": label, **labels(label), **entry}
        return number

    def picture(self, number, in_text=False):
        """Add an image and a sampler; return the number of their texture. in_text: whether the image is a data URI."""
        data = gradients(number)
        text = "data:image/png;base64," + base64.b64encode(data).decode()
        place = {"uri": text} if in_text else {"bufferView": self.view(data)}
        image = self.add("images", {"mimeType": "image/png", **place})
        sampler = self.add("samplers", {"magFilter": 9729, "minFilter": 9986, "wrapS": 33071, "wrapT": 33648})
        return self.add("textures", {"source": image, "sampler": sampler})

    def info(self, in_text=False, **more):
        """A textureInfo with a picture of its own."""
        info = {"index": self.picture(len(self.tree.get("images", [])), in_text), **labels("info"), **more}
        return info | {"extensions": {ACME: {}, **info["extensions"]}}


def moved(texcoord):
    """A texture transform."""
    return {TRANSFORM: {"offset": [0.125, 0.25], "rotation": 0.3, "scale": [0.5, 0.75], "texCoord": texcoord}}


def _core(b):
    b.add("materials", {
        PBR: {"baseColorFactor": [0.5, 1, 0.75, 1], "metallicFactor": 0.25, "roughnessFactor": 0.75,
              "baseColorTexture": b.info(texCoord=1, extensions=moved(1)), "metallicRoughnessTexture": b.info(texCoord=1),
              "extras": {"of": "pbr"}, "extensions": {ACME: {}}},
        "normalTexture": b.info(texCoord=1, scale=0.5), "occlusionTexture": b.info(texCoord=1, strength=0.5),
        "emissiveTexture": b.info(in_text=True, texCoord=1), "emissiveFactor": [0.5, 0.25, 1],
        "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True})


def _extended(b):
    tables = {}
    for channel in MAPS:
        if channel.extension not in ("", PBR):
            tables.setdefault(channel.extension, {}).setdefault(channel.slot, b.info())
    for n, parameter in enumerate(PARAMETERS):
        if parameter.extension not in ("", PBR):
            slot, _, key = parameter.key.rpartition(".")
            table = tables.setdefault(parameter.extension, {})
            value = 0.25 + n / 64
            (table[slot] if slot else table)[key] = [value] * 3 if parameter.count > 1 else value
    for table in tables.values():
        table["extras"] = {"of": "table"}
    tables["KHR_materials_iridescence"] |= {"iridescenceThicknessMinimum": 150.0, "iridescenceThicknessMaximum": 300.0}
    b.add("materials", {PBR: {"baseColorTexture": b.info()}, "extensions": tables})


def _materials(b):
    _core(b)
    _extended(b)
    b.add("materials", {PBR: {"baseColorTexture": b.info()}, "extensions": {UNLIT: {"extras": {"of": "unlit"}}}})
    b.add("materials", {
        "normalTexture": b.info(texCoord=1, scale=0.5, extensions=moved(1)), "occlusionTexture": b.info(texCoord=1, strength=0.5),
        "extensions": {GLOSSY: {"diffuseFactor": [1, 0.5, 1, 1], "specularFactor": [0.5, 1, 1], "glossinessFactor": 0.5,
                                "diffuseTexture": b.info(texCoord=1), "extras": {"of": "glossy"},
                                "specularGlossinessTexture": b.info(texCoord=1)}}})
    b.add("materials", {PBR: {"baseColorTexture": b.info(in_text=True)}})
    b.add("materials", {PBR: {"baseColorFactor": [0.25, 0.5, 1, 1]}})


def _label(owner, what):
    """Give an object extras and the extension."""
    owner |= {"extras": {"of": what}, "extensions": {**owner.get("extensions", {}), ACME: {"of": what}}}


def _sparse(b, rows, values):
    """The 'sparse' of an accessor."""
    where = b.view(np.array(rows, np.uint16).tobytes()), b.view(np.asarray(values, np.float32).tobytes())
    return {"count": len(rows), **labels("sparse"),
            "indices": {"bufferView": where[0], "componentType": 5123, "byteOffset": 0, **labels("rows")},
            "values": {"bufferView": where[1], "byteOffset": 0, **labels("values")}}


def _meshes(b):
    points, uv, faces = bumpy()
    normals = np.tile(np.array([0.28, 0.96, 0], np.float32), (len(points), 1))
    tangents = np.tile(np.array([0.96, -0.28, 0, 1], np.float32), (len(points), 1))
    weight = (np.arange(len(points), dtype=np.float32)[:, None] % 7) / 7
    b.tree["meshes"] = []
    for _ in range(3):
        b.add("meshes", {"primitives": []})
    b.primitive(points, faces, uv[:, ::-1], material=CODED, attributes={
        "NORMAL": b.accessor(normals), "TANGENT": b.accessor(tangents),
        "TEXCOORD_1": b.accessor(np.rint(65535 * uv).astype(np.uint16), normalized=True, byteOffset=0)})
    b.tree["accessors"][b.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]] |= {
        "sparse": _sparse(b, [7], points[7:8]), "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    b.tree["bufferViews"][b.tree["accessors"][0]["bufferView"]] |= {"target": 34962, "byteStride": 12}
    # What no stream holds is stored: weights, colours, targets, an attribute of an application, the UVs of a variant
    variants = {VARIANTS: {"mappings": [{"material": IN_VARIANT, "variants": [1], "name": "m", "extras": {"of": "mapping"}}]}}
    dense = (0.1 * np.sin(7 * points)).astype(np.float32)
    bounds = {"min": dense.min(axis=0).tolist(), "max": dense.max(axis=0).tolist()}
    b.primitive(points, faces, uv, mesh=1, material=EXTENDED, extensions=variants, attributes={
        "JOINTS_0": b.accessor(np.tile(np.array([0, 1, 0, 0], np.uint8), (len(points), 1))),
        "WEIGHTS_0": b.accessor(np.concatenate([weight, 1 - weight, 0 * weight, 0 * weight], axis=1).astype(np.float32)),
        "COLOR_0": b.accessor(np.full((len(points), 4), 200, np.uint8), normalized=True),
        "TEXCOORD_1": b.accessor(2 * uv), "_HEAT": b.accessor(np.arange(len(points), dtype=np.float32), byteOffset=0, min=[0],
                                                              max=[len(points) - 1])},
        targets=[{"POSITION": b.add("accessors", {
            "count": len(points), "type": "VEC3", "componentType": 5126, "min": [0, 0, 0], "max": [0, 0.5, 0],
            "sparse": _sparse(b, [3, 4], [[0, 0.5, 0]] * 2)}), "NORMAL": b.accessor(0 * normals)},
                 {"POSITION": b.accessor(dense, **bounds)}])
    strip = np.array([0, 1, 3, 2], np.uint16)
    b.primitive(SQUARE, strip, SQUARE_UV, mesh=2, material=BARE, mode=5)
    b.primitive(SQUARE, None, SQUARE_UV, mesh=2, material=ON_POINTS, mode=0)
    b.tree["accessors"][-1] |= {"min": [0, 0], "max": [1, 1]}
    b.primitive(SQUARE + 2, strip, None, mesh=2, material=WITHOUT_UV, mode=5)
    packed = b.view(DracoPy.encode(SQUARE + 4, TWO.astype(np.uint32)))
    entries = [{"count": 4, "type": "VEC3", "componentType": 5126}, {"count": 6, "type": "SCALAR", "componentType": 5125}]
    place, indices = (b.add("accessors", entry) for entry in entries)
    b.tree["meshes"][2]["primitives"].append({
        "attributes": {"POSITION": place}, "indices": indices, "material": BARE,
        "extensions": {DRACO: {"bufferView": packed, "attributes": {"POSITION": 0}}}})
    for mesh in b.tree["meshes"]:
        for primitive in mesh["primitives"]:
            _label(primitive, "primitive")
    b.tree["meshes"][1] |= {"weights": [0.5, 0.25]}


def _nodes(b):
    rows = np.random.default_rng(1).random((4, 3)).astype(np.float32)
    turns = np.tile(np.array([0, 0, 0, 1], np.float32), (4, 1))
    many = {"attributes": {"TRANSLATION": b.accessor(9 * rows), "ROTATION": b.accessor(turns), "SCALE": b.accessor(1 + rows),
                           "_ID": b.accessor(np.arange(4, dtype=np.float32))}, "extras": {"of": "instances"}}
    extensions = {INSTANCES: many, VISIBLE: {"visible": False}, XMP: {"packet": 0}}
    b.tree["nodes"] = []
    b.add("nodes", {"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 2, 3, 1], "children": [2]})
    b.add("nodes", {"mesh": 1, "skin": 0, "weights": [0.25, 0.5]})
    b.add("nodes", {"camera": 0, "translation": [0, 1, 0], "rotation": [0, 0.6, 0, 0.8], "scale": [1, 2, 1]})
    b.add("nodes", {"camera": 1, "extensions": {LIGHTS: {"light": 0}}})
    b.add("nodes", {"mesh": 2, "extensions": extensions})
    b.tree["scenes"] = []
    b.add("scenes", {"nodes": [0]})
    b.add("scenes", {"nodes": [0, 1, 3, 4]})
    bind = b.accessor(np.tile(np.eye(4, dtype=np.float32).reshape(1, 16), (2, 1)).reshape(-1))
    b.tree["accessors"][bind] |= {"type": "MAT4", "count": 2}
    b.add("skins", {"joints": [2, 3], "inverseBindMatrices": bind, "skeleton": 2})
    b.add("cameras", {"type": "perspective", "perspective": {
        "yfov": 0.7, "znear": 0.01, "zfar": 9.0, "aspectRatio": 1.5, **labels("perspective")}})
    b.add("cameras", {"type": "orthographic", "orthographic": {
        "xmag": 2.0, "ymag": 3.0, "znear": 0.01, "zfar": 9.0, **labels("orthographic")}})


def _animations(b):
    times = np.linspace(0, 2, 60, dtype=np.float32)
    shared = b.accessor(times, min=[0.0], max=[2.0])
    straight = b.accessor(np.stack([times, 2 * times, 0 * times], axis=1))  # of which interpolation gives all keys but two
    bent = b.accessor(np.tile(np.array([0, 0, 255, 128, 0, 255], np.uint8), 20), normalized=True, byteOffset=0)
    replaced = _sparse(b, [7, 8], [[0, 1, 0, 1]] * 2)
    colours = b.accessor(np.random.default_rng(2).random((60, 4)).astype(np.float32), sparse=replaced)
    targets = [{"node": 2, "path": "translation"}, {"node": 1, "path": "weights"}, {"path": "pointer", "extensions": {
        POINTER: {"pointer": f"/materials/{BARE}/pbrMetallicRoughness/baseColorFactor"}}}]
    b.add("animations", {
        "samplers": [{"input": shared, "output": out, "interpolation": "LINEAR"} for out in (straight, bent, colours)],
        "channels": [{"sampler": n, "target": target} for n, target in enumerate(targets)]})
    b.tree["animations"][0]["samplers"][1]["interpolation"] = "STEP"
    for n in range(3):
        for key in ("samplers", "channels"):
            _label(b.tree["animations"][0][key][n], key)
        _label(targets[n], "target")


def whole():
    """A GLB whose scene has something of everything."""
    b = _Whole()
    _materials(b)
    _meshes(b)
    _nodes(b)
    _animations(b)
    b.add("images", {"bufferView": b.view(gradients(99)), "mimeType": "image/png"})  # that nothing shows
    light = {"type": "spot", "color": [1, 0.5, 0.25], "intensity": 3.0, "range": 9.0, "name": "lamp", "extras": {"of": "light"},
             "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}}
    used = [LIGHTS, VARIANTS, INSTANCES, XMP, VISIBLE, POINTER, TRANSFORM, GLOSSY, UNLIT, ACME, DRACO,
            *dict.fromkeys(row.extension for row in (BASE_COLOUR, *MAPS, *PARAMETERS) if row.extension not in ("", PBR))]
    b.tree["asset"] |= {"minVersion": "2.0", "copyright": "ours", **labels("asset")}
    b.tree["asset"]["extensions"][XMP] = {"packet": 0}
    b.tree |= {"scene": 1, "extras": {"of": "file"}, "extensionsUsed": used, "extensionsRequired": [INSTANCES, DRACO]}
    b.tree["extensions"] = {
        LIGHTS: {"lights": [light, {"type": "point"}]}, ACME: {"table": 0},
        VARIANTS: {"variants": [{"name": "red", "extras": {"of": "variant"}}, {"name": "blue"}]},
        XMP: {"packets": [{"@context": {"dc": "http://purl.org/dc/elements/1.1/"}, "dc:title": "whole"}]}}
    text = "data:application/octet-stream;base64,AAECAw=="
    b.add("bufferViews", {"buffer": 1, "byteLength": 4})
    return b.with_buffers([{"byteLength": len(b.blob), "name": "first", **labels("buffer")}, {"uri": text, "byteLength": 4}])


def without_the_unknown(tree):
    """A copy of a JSON tree without the extension that nobody knows."""
    if isinstance(tree, list):
        return [without_the_unknown(value) for value in tree if value != ACME]
    if not isinstance(tree, dict):
        return tree
    copy = {key: without_the_unknown(value) for key, value in tree.items() if key != ACME}
    return {key: value for key, value in copy.items() if key != "extensions" or value}
