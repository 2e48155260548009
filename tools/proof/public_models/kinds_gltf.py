"""glTF files in each of which one property is the only thing that shows, and the surface that all formats share."""

import io
import json
import struct
from dataclasses import dataclass, field

import numpy as np
from PIL import Image

SIDE = 13  # vertices a side of the patch
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


@dataclass(frozen=True)
class Kind:
    """A property of models that a codec could lose. files: {name: bytes} of a model with it, itself first; without: of one
    without it; like: the tool that shows it: "three.js", "assimp", or "construction", for which expected is a GLB that looks the
    same."""

    files: dict
    without: dict
    like: str = "three.js"
    expected: bytes = b""


def patch():
    """A bent patch without any symmetry: positions, normals, UVs (float32 (n, .), clear of the edges of a picture, where its
    repetition shows), faces (uint16 (m, 3))."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE)))
    x, y = 2 * u - 1, 1.4 * v - 0.5
    normals = np.stack([-0.8 * np.cos(2 * x), -0.6 * y, np.ones_like(x)], axis=1)
    positions = np.stack([x, y, 0.4 * np.sin(2 * x) + 0.3 * y * y], axis=1)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + SIDE + 1, corner + SIDE], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint16)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (positions.astype(np.float32), normals.astype(np.float32), np.stack([0.03 + 0.94 * u, 0.97 - 0.94 * v],
                                                                               1).astype(np.float32), faces)


POSITIONS, NORMALS, UVS, FACES = patch()
COLOURS = np.stack([UVS[:, 0], 0.2 + 0.6 * UVS[:, 1], 1 - UVS[:, 0]], axis=1).astype(np.float32)
ONES = np.ones((len(UVS), 1), np.float32)
ALONG = np.array([1.0, 0, 0]) - NORMALS[:, :1] * NORMALS  # the x axis, in the surface
TANGENTS = np.hstack([ALONG / np.linalg.norm(ALONG, axis=1, keepdims=True), ONES]).astype(np.float32)
RAMP = np.linspace(0, 255, 64)


def picture(form="PNG", mode="RGB", **options):
    """Return the bytes of a picture of 64 x 64 pixels with another colour in each corner. form: of Pillow; mode: also "L", "P",
    "RGBA" (half of it clear)."""
    x, y = np.meshgrid(RAMP, RAMP)
    pixels = np.stack([x, y, 255 - x], axis=2).round().astype(np.uint8)
    if mode == "RGBA":
        pixels = np.dstack([pixels, np.where(x < 128, 255, 40).astype(np.uint8)])
    image = Image.fromarray(pixels, mode if mode == "RGBA" else "RGB")
    if mode == "I;16":
        image = Image.fromarray((x * 257).astype(np.uint16))
    out = io.BytesIO()
    (image.convert(mode) if mode in ("L", "P", "LA") else image).save(out, form, **options)
    return out.getvalue()


def bumps(form="PNG", kind="normals"):
    """Return the bytes of a picture of waves. kind: "normals" for a normal map, "heights" for a bump map."""
    x, y = np.meshgrid(np.arange(64), np.arange(64))
    n = np.stack([0.6 * np.sin(x * np.pi / 8), 0.4 * np.sin(y * np.pi / 16), np.ones((64, 64))], axis=2)
    n = 0.5 * (n[..., :1] + n[..., 1:2]) if kind == "heights" else n / np.linalg.norm(n, axis=2, keepdims=True)
    out = io.BytesIO()
    Image.fromarray(np.round(127.5 + 127.5 * np.broadcast_to(n, (64, 64, 3))).astype(np.uint8)).save(out, form)
    return out.getvalue()


def turned(orientation):
    """Return the bytes of a JPEG with an EXIF orientation."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    return picture("JPEG", quality=95, exif=exif)


@dataclass(frozen=True)
class Texture:
    """A texture of a material. data, mime: of the image; sampler: of the glTF texture; extension: that names the image; uri: of
    an image file; info: entries of its use."""

    data: bytes
    mime: str = "image/png"
    info: dict = field(default_factory=dict)
    sampler: dict | None = None
    extension: str = ""
    uri: str = ""


class Gltf:
    """A glTF file under construction. tree: its JSON; blob: its binary chunk."""

    def __init__(self):
        self.blob = b""
        self.tree = {"asset": {"version": "2.0"},
                     "scene": 0,
                     "scenes": [{"nodes": [0]}],
                     "nodes": [{"mesh": 0}],
                     "meshes": [{"primitives": [{"attributes": {}}]}],
                     "accessors": [],
                     "bufferViews": []}

    def add(self, key, entry):
        self.tree.setdefault(key, []).append(entry)
        return len(self.tree[key]) - 1

    def view(self, data, **more):
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.blob += data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.blob) - len(data), "byteLength": len(data), **more})

    def accessor(self, array, normalized=False, **more):
        """Add an accessor of an array (n,) or (n, w) and return its index; rows are padded to four bytes, like vertices."""
        rows = array.reshape(len(array), -1)
        width = rows.shape[1]
        data = np.pad(rows.view(np.uint8), ((0, 0), (0, -rows.itemsize * width % 4))) if array.ndim > 1 else rows
        stride = {"byteStride": data.shape[1]} if array.ndim > 1 and data.shape[1] > rows.itemsize * width else {}
        limits = {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        entry = {"bufferView": self.view(data.tobytes(), **stride),
                 "count": len(rows),
                 "type": TYPES[width],
                 **limits,
                 **more,
                 "componentType": COMPONENTS[array.dtype.str[1:]]}
        return self.add("accessors", entry | ({"normalized": True} if normalized else {}))

    def resolved(self, item):
        """Add the Textures within a material and return it with their indices in place."""
        if isinstance(item, Texture):
            image = {"uri": item.uri} if item.uri else {"bufferView": self.view(item.data), "mimeType": item.mime}
            source = self.add("images", image)
            entry = {"extensions": {item.extension: {"source": source}}} if item.extension else {"source": source}
            entry |= {} if item.sampler is None else {"sampler": self.add("samplers", item.sampler)}
            return {"index": self.add("textures", entry), **item.info}
        return {key: self.resolved(value) for key, value in item.items()} if isinstance(item, dict) else item

    def glb(self):
        text = json.dumps({**self.tree, "buffers": [{"byteLength": len(self.blob)}]}).encode()
        text += b" " * (-len(text) % 4)
        blob = self.blob + b"\0" * (-len(self.blob) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def glb(material=None, attributes=None, edit=None, faces=FACES, positions=POSITIONS):
    """Return a GLB of the patch. material: of glTF, with Textures; attributes: {name: array, or (array, normalized)} beside
    POSITION (default: NORMAL and TEXCOORD_0); edit(Gltf): a last change; faces: None for a patch without indices."""
    g = Gltf()
    primitive = g.tree["meshes"][0]["primitives"][0]
    named = {"POSITION": positions, **({"NORMAL": NORMALS, "TEXCOORD_0": UVS} if attributes is None else attributes)}
    for name, value in named.items():
        primitive["attributes"][name] = g.accessor(*(value if isinstance(value, tuple) else (value,)))
    if faces is not None:
        primitive["indices"] = g.accessor(np.ascontiguousarray(faces).ravel())
    if material is not None:
        pbr = {"metallicFactor": 0, "roughnessFactor": 0.9} | material.get("pbrMetallicRoughness", {})
        primitive["material"] = g.add("materials", g.resolved({**material, "pbrMetallicRoughness": pbr}))
        used = sorted({name for item in _objects(g.tree) for name in item.get("extensions", {})})
        g.tree |= {"extensionsUsed": used} if used else {}
    if edit is not None:
        edit(g)
    return g.glb()


def _objects(item):
    if isinstance(item, dict):
        yield item
    for value in item.values() if isinstance(item, dict) else item if isinstance(item, list) else ():
        yield from _objects(value)


def base(**pbr):
    return {"pbrMetallicRoughness": pbr}


def coloured(texture=None, **more):
    """Return a glTF material with a base colour texture. more: its other entries."""
    return {**base(baseColorTexture=texture or Texture(picture())), **more}


def ext(name, **value):
    """Return a glTF entry with an extension. value: the entries of the extension."""
    return {"extensions": {name: value}}


def _materials():
    """{property: (material with, material without)}"""
    grey_factor = {"baseColorFactor": [0.3, 0.3, 0.3, 1]}
    plain, grey, red, metal = base(), base(**grey_factor), base(baseColorFactor=[1, 0, 0, 1]), base(metallicFactor=1.0)
    png, jpeg, webp = picture(), picture("JPEG", quality=95), picture("WEBP", lossless=True)
    clear, waves, dark = Texture(picture(mode="RGBA")), Texture(bumps()), picture(mode="L")
    dim, glossy = {**grey, "emissiveFactor": [0.1, 0.05, 0.02]}, base(**grey_factor, roughnessFactor=0.2)
    shiny, brushed = base(roughnessFactor=0.3), base(metallicFactor=1.0, roughnessFactor=0.4)
    moved = ext("KHR_texture_transform", offset=[0.3, 0.1], scale=[2, 1.5], rotation=0.6)
    of = lambda mode, **more: coloured(Texture(picture(mode=mode)), **more)
    as_jpeg = lambda data: coloured(Texture(data, "image/jpeg"))
    table = {
        "baseColorFactor": (base(baseColorFactor=[0.8, 0.2, 0.1, 1]), plain), "baseColorTexture PNG": (coloured(), plain),
        "baseColorTexture JPEG": (as_jpeg(jpeg), plain),
        "EXT_texture_webp": (coloured(Texture(webp, "image/webp", extension="EXT_texture_webp")), plain),
        "PNG grey": (of("L"), plain), "PNG grey with alpha": (of("LA"), plain), "PNG of 16 bits": (of("I;16"), plain),
        "PNG with a palette": (of("P"), plain), "PNG interlaced name of JPEG": (as_jpeg(png), plain),
        **{f"EXIF orientation {n}": (as_jpeg(turned(n)), as_jpeg(jpeg)) for n in (3, 6)},
        "factor times texture": (base(baseColorTexture=Texture(png), baseColorFactor=[0.2, 1, 0.4, 1]), coloured()),
        "wrap mirrored": _wrapped(33648), "wrap clamped": _wrapped(33071),
        "KHR_texture_transform": (coloured(Texture(png, info=moved)), coloured()),
        "doubleSided": ({**plain, "doubleSided": True}, plain),
        "alphaMode MASK": (coloured(clear, alphaMode="MASK"), coloured(clear)),
        "alphaCutoff": (coloured(clear, alphaMode="MASK", alphaCutoff=0.1), coloured(clear, alphaMode="MASK")),
        "alphaMode BLEND": (coloured(clear, alphaMode="BLEND"), coloured(clear)),
        "factor alpha": ({**base(baseColorFactor=[1, 0, 0, 0.3]), "alphaMode": "BLEND"}, red),
        "normalTexture": ({**plain, "normalTexture": waves}, plain),
        "normalTexture scale": ({**plain, "normalTexture": Texture(bumps(), info={"scale": 3})},
                                {**plain, "normalTexture": waves}),
        "metallicFactor": (base(metallicFactor=1.0, roughnessFactor=0.3), shiny),
        "roughnessFactor": (base(metallicFactor=1.0, roughnessFactor=0.05), metal),
        "metallicRoughnessTexture": (base(metallicRoughnessTexture=Texture(png), metallicFactor=1.0, roughnessFactor=1.0),
                                     base(metallicFactor=1.0, roughnessFactor=1.0)),
        "occlusionTexture": ({**plain, "occlusionTexture": Texture(dark)}, plain),
        "occlusionTexture strength": ({**plain, "occlusionTexture": Texture(dark, info={"strength": 0.2})},
                                      {**plain, "occlusionTexture": Texture(dark)}),
        "emissiveFactor": ({**grey, "emissiveFactor": [0.9, 0.1, 0.4]}, grey),
        "emissiveTexture": ({**grey, "emissiveTexture": Texture(png), "emissiveFactor": [1, 1, 1]}, grey)}
    effects = (("emissive_strength", dim, {"emissiveStrength": 8}), ("unlit", coloured(), {}),
               ("specular", grey, {"specularColorFactor": [9, 0, 0]}), ("ior", grey, {"ior": 3}),
               ("clearcoat", grey, {"clearcoatFactor": 1}),
               ("sheen", grey, {"sheenColorFactor": [1, 0, 1], "sheenRoughnessFactor": 0.5}),
               ("transmission", plain, {"transmissionFactor": 1}),
               ("iridescence", glossy, {"iridescenceFactor": 1, "iridescenceIor": 2.3}),
               ("anisotropy", brushed, {"anisotropyStrength": 1}))
    table |= {f"KHR_materials_{name}": ({**look, **ext(f"KHR_materials_{name}", **value)}, look) for name, look, value in effects}
    both = {"NORMAL": NORMALS, "TEXCOORD_0": UVS}
    framed = {**both, "TANGENT": TANGENTS}  # three.js makes up tangents that are longer along the shorter side
    pairs = {name: tuple(glb(material, framed if "normalTexture" in name else both) for material in row)
             for name, row in table.items()}
    sets, further = {**both, "TEXCOORD_1": np.ascontiguousarray(UVS[:, ::-1] * 2)}, {"texCoord": 1}
    uses = {"texCoord 1": further, "texCoord of KHR_texture_transform": ext("KHR_texture_transform", **further)}
    return pairs | {name: tuple(glb(coloured(Texture(png, info=use)), sets) for use in (info, {})) for name, info in uses.items()}


def _wrapped(mode):
    """A material with a picture 2.5 times across, by a wrap mode and repeated."""
    info = ext("KHR_texture_transform", scale=[2.5, 2.5])
    return tuple(coloured(Texture(picture(), info=info, sampler={"wrapS": of, "wrapT": of})) for of in (mode, 10497))


def _pair(edit=None, **changed):
    """(GLB with an edit or other arguments, the plain patch)"""
    return glb(**{"material": coloured(), "edit": edit} | changed), glb(coloured())


def _node(**entry):
    return _pair(lambda g: g.tree.update(nodes=[{"children": [1]}, {"mesh": 0, **entry}]))


def _surfaces():
    """{property: (GLB with, GLB without)} of attributes, indices, nodes and poses."""
    plain, tilted, soup = base(), (NORMALS + [0.9, 0.5, 0]).astype(np.float32), FACES.ravel()
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    both, rgba = {"NORMAL": NORMALS, "TEXCOORD_0": UVS}, np.hstack([COLOURS, 0.2 + 0.7 * UVS[:, :1]]).astype(np.float32)
    flipped, bumpy = TANGENTS * np.float32([1, 1, 1, -1]), {**plain, "normalTexture": Texture(bumps())}
    packed = lambda values, kind, top: (np.round(values * top).astype(kind), True)
    coded = lambda attributes, without=None, material=plain: (glb(material, {**both, **attributes}),
                                                              glb(material, {**both, **(without or {})}))
    twice = [{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [0.4, 1.5, 0]}]
    return {
        "NORMAL": coded({"NORMAL": tilted}),
        "no NORMAL": (glb(plain, {"TEXCOORD_0": UVS}), glb(plain, {**both, "NORMAL": tilted})),
        "NORMAL as bytes": coded({"NORMAL": packed(tilted, np.int8, 127)}),
        "TANGENT": coded({"TANGENT": flipped}, {"TANGENT": TANGENTS}, bumpy), "COLOR_0 float": coded({"COLOR_0": COLOURS}),
        "COLOR_0 u1": coded({"COLOR_0": packed(COLOURS, np.uint8, 255)}),
        "COLOR_0 u2": coded({"COLOR_0": packed(COLOURS, np.uint16, 65535)}),
        "COLOR_0 above one": coded({"COLOR_0": (COLOURS * 1.01).astype(np.float32)}),
        "COLOR_0 times texture": coded({"COLOR_0": COLOURS}, material=coloured()),
        "COLOR_0 alpha": coded({"COLOR_0": rgba}, {"COLOR_0": rgba[:, :3].copy()}, {**plain, "alphaMode": "BLEND"}),
        "TEXCOORD_0 as u2": coded({"TEXCOORD_0": packed(UVS[:, ::-1], np.uint16, 65535)}, material=coloured()),
        "POSITION as i2": _quantized(),
        "no indices": _pair(faces=None, positions=POSITIONS[soup],
                            attributes={"NORMAL": NORMALS[soup], "TEXCOORD_0": UVS[soup, ::-1].copy()}),
        "indices of 32 bits": _pair(faces=FACES.astype(np.uint32)[:200]),
        "indices of 8 bits": _pair(faces=FACES.astype(np.uint8)[:200]),
        "triangle strip": _strip(5, [SIDE * (i % 2) + i // 2 for i in range(2 * SIDE)]),
        "triangle fan": _strip(6, [0, 1, SIDE + 1, SIDE]), "sparse accessor": _pair(_sparse),
        "node translation and scale": _node(translation=[0.5, 0, 0], scale=[0.5, 2, 1]),
        "node rotation": _node(rotation=[0, 0.5, 0, 0.866]),
        "node matrix": _node(matrix=[0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0.5, 0, 0, 1]),
        "node mirrored": _node(scale=[-1, 1, 1]), "two nodes of one mesh": _pair(lambda g: g.tree.update(nodes=twice)),
        "EXT_mesh_gpu_instancing": _pair(_instanced), "scene of choice": _pair(_second_scene), "morph weights": _pair(_morphed),
        "skin pose": _pair(_skinned), "two primitives": _pair(_second_primitive),
        "default material": (glb(None), glb(base(baseColorFactor=[0.2, 0.2, 0.2, 1])))}


def _quantized():
    def edit(g):
        g.tree["nodes"] = [{"mesh": 0, "scale": [2, 2, 2]}]
        g.tree |= {"extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]}

    attributes = {"POSITION": (np.round(POSITIONS / 2 * 32767).astype(np.int16), True), "NORMAL": NORMALS, "TEXCOORD_0": UVS}
    return glb(coloured(), attributes, edit), glb(base(), attributes, edit)


def _strip(mode, indices):
    """(GLB whose vertices are those of a strip or a fan, GLB of them as triangles)"""
    used, numbers = np.unique(indices, return_inverse=True)
    rows = {"attributes": {"NORMAL": NORMALS[used], "TEXCOORD_0": UVS[used]}, "positions": POSITIONS[used]}
    edit = lambda g: g.tree["meshes"][0]["primitives"][0].update(mode=mode)
    return tuple(glb(coloured(), faces=numbers.astype(np.uint16), edit=how, **rows) for how in (edit, None))


def _sparse(g):
    accessor = g.tree["accessors"][g.tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
    rows = np.arange(0, len(UVS), 2, dtype=np.uint16)
    accessor["sparse"] = {"count": len(rows),
                          "indices": {"bufferView": g.view(rows.tobytes()), "componentType": 5123},
                          "values": {"bufferView": g.view(np.full((len(rows), 2), 0.1, np.float32).tobytes())}}


def _instanced(g):
    moves = g.accessor(np.float32([[0, 0, 0], [0.4, 1.6, 0], [2.2, 0, 0.3]]))
    g.tree["nodes"] = [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moves}}}}]
    g.tree |= {"extensionsUsed": ["EXT_mesh_gpu_instancing"]}


def _second_scene(g):
    g.tree |= {"nodes": [{"mesh": 0}, {"mesh": 0, "scale": [1, 0.3, 2]}], "scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}


def _morphed(g):
    moves = np.zeros_like(POSITIONS)
    moves[:, 2] = 1.5 * UVS[:, 0]
    g.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": g.accessor(moves)}]
    g.tree["meshes"][0]["weights"] = [0.8]


def _skinned(g):
    joints = g.accessor(np.tile(np.uint8([0, 1, 0, 0]), (len(UVS), 1)))
    weights = g.accessor(np.hstack([1 - UVS[:, :1], UVS[:, :1], 0 * ONES, 0 * ONES]).astype(np.float32))
    g.tree["meshes"][0]["primitives"][0]["attributes"] |= {"JOINTS_0": joints, "WEIGHTS_0": weights}
    g.tree |= {"nodes": [{"mesh": 0, "skin": 0}, {"children": [2]}, {"rotation": [0, 0.6, 0, 0.8], "translation": [0.3, 0.5, 0]}],
               "skins": [{"joints": [1, 2]}],
               "scenes": [{"nodes": [0, 1]}]}


def _second_primitive(g):
    first = g.tree["meshes"][0]["primitives"][0]
    moved = g.accessor((POSITIONS + np.float32([0.3, 1.5, 0])).astype(np.float32))
    red = g.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1], "metallicFactor": 0}})
    g.tree["meshes"][0]["primitives"].append({**first, "attributes": {**first["attributes"], "POSITION": moved}, "material": red})


def _gltf(data, **files):
    """A GLB as a .gltf file with a buffer beside it, and the files that its images name."""
    length = struct.unpack_from("<I", data, 12)[0]
    tree, blob = json.loads(data[20 : 20 + length]), data[28 + length :]
    tree["buffers"] = [{"byteLength": len(blob), "uri": "a%20b.bin"}]
    return {"model.gltf": json.dumps(tree).encode(), "a b.bin": blob, **files}


def _files():
    """{property: Kind} of what a .gltf file finds beside itself."""
    png = picture()
    kinds = {"image beside the file": "image.png", "image in a folder, percent-encoded": "maps/a%20b.png"}
    return {name: Kind(_gltf(glb(coloured(Texture(png, uri=uri)))) | {uri.replace("%20", " "): png}, _gltf(glb(base()))) for name,
            uri in kinds.items()}


def gltf_kinds():
    """{property: Kind}"""
    pairs = {**_materials(), **_surfaces()}
    return {name: Kind({"model.glb": with_it}, {"model.glb": without}) for name, (with_it, without) in pairs.items()} | _files()
