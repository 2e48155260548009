"""Targets of the loaders: files of every format with something odd in them go by the front door, from a folder of their own."""

import atexit
import contextlib
import io
import json
import shutil
import struct
import tempfile
import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from format_files import KTX2_FILES, dae, ktx2, stl, stl_text
from mesh_files import RED_BLUE, SQUARE, SQUARE_UV, TWO, Builder, encoded, textured
from PIL import Image
from shapes import scene_of
from threemf_files import mesh, model, package

from fuzz.choices import Choices, edited
from fuzz.trees import bend_text, bend_tree
from texfcodec.io.images import read_image
from texfcodec.io.load import load
from texfcodec.io.parts import Notes
from texfcodec.limits import Limits

OBJ = """mtllib a.mtl
o thing
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0 0 0 1
v 0 1 0
v 0.5 0.5 1 255 0 0
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
usemtl m
f 1/1/1 2/2/1 3/3/1
f -4//1 3//1 -2//1
usemtl other
g group
s 1
f 1 2 3 4 5
f 1/1 2/2 \\
3/3
# the end
"""
MTL = """newmtl m
Kd 0.5 0.5 0.5
d 0.5
map_Kd -clamp on -s 2 2 1 -o 0.5 0 a.png
newmtl other
Kd 1 0 0
Tr 0.5
map_Kd none.png
illum 2
"""
PLY = """ply
format {form} 1.0
comment made here
comment TextureFile a.png
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property float s
property float t
element face 2
property list uchar int vertex_indices
property list uchar float texcoord
property int texnumber
element edge 1
property int a
end_header
"""
PLY_TEXT = """0 0 0 255 0 0 0 0
1 0 0 0 255 0 1 0
1 1 0 0 0 255 1 1
0 1 0.5 9 9 9 0 1
3 0 1 2 6 0 0 1 0 1 1 0
4 0 1 2 3 8 0 0 1 0 1 1 0 1 0
7
"""
OFF = """{head}OFF
# a comment
5 3 0
0 0 0{more}
1 0 0{more}
1 1 0{more}
0 1 0{more}
0.5 0.5 1{more}
3 0 1 2 255 0 0
4 0 1 2 3 0.5 0.5 0.5 1
3 2 3 4 7
"""
MOST_FACES = 1 << 14  # more than any input here can hold


@lru_cache(maxsize=1)
def folder() -> Path:
    """Where inputs stand, with the images and libraries that they may name; it goes with the process."""
    path = Path(tempfile.mkdtemp(prefix="texf-fuzz-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    (path / "a.png").write_bytes(encoded(RED_BLUE))
    (path / "t ex.png").write_bytes(encoded(RED_BLUE))
    (path / "a.mtl").write_text(MTL)
    return path


def _load(data, name, strict=False):
    """Loads bytes as a file of this name, and looks at the scene."""
    path = folder() / name
    path.write_bytes(data)
    _check(load(path, strict=strict))


def _check(scene):
    count = len(scene.faces)
    assert 0 < count < MOST_FACES and scene.faces.min() >= 0 and scene.faces.max() < len(scene.positions)
    assert np.isfinite(scene.positions).all() and np.isfinite(scene.corner_uv).all()
    assert scene.face_material.shape == (count,) and scene.face_material.max() < len(scene.materials)
    assert scene.face_material.min() >= 0 and all(material.texture < len(scene.textures) for material in scene.materials)
    assert scene.corner_color is None or np.isfinite(scene.corner_color).all()
    json.dumps(scene.metadata)
    assert all(isinstance(text, str) for text in (*scene.warnings, *scene.dropped, *scene.remarks))


# glTF


def _rich():
    """A Builder with what the reader knows: sparse and strided accessors, strips, morph targets, maps, extensions, cameras."""
    builder = textured(wrapS=33071, wrapT=33648)
    tree = builder.tree
    sparse = builder.add("accessors", {"count": 4, "type": "VEC3", "componentType": 5126, "sparse": {
        "count": 1, "indices": {"bufferView": builder.view(b"\1\0"), "componentType": 5123},
        "values": {"bufferView": builder.view(np.ones(3, "<f4").tobytes())}}})
    colours = builder.accessor(np.full((4, 4), 99, np.uint8), normalized=True)
    normals = builder.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    texture = tree["textures"].index({"source": 0, "sampler": 0})
    turned = {"KHR_texture_transform": {"offset": [0.1, 0], "rotation": 1, "scale": [2, 2]}}
    info = {"index": texture, "texCoord": 0, "extensions": turned}
    pbr = {"baseColorFactor": [1, 0.5, 0, 0.5], "metallicFactor": 0.5, "roughnessFactor": 0.2, "metallicRoughnessTexture": info}
    more = {"KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatTexture": info}, "KHR_materials_unlit": {},
            "KHR_materials_sheen": {"sheenColorFactor": [1, 0, 0], "sheenColorTexture": info},
            "KHR_materials_emissive_strength": {"emissiveStrength": 2}}
    material = builder.material(texture, pbr=pbr, normalTexture={**info, "scale": 0.5}, extensions=more, emissiveTexture=info,
                                occlusionTexture={**info, "strength": 0.5}, emissiveFactor=[1, 1, 1], alphaMode="MASK",
                                alphaCutoff=0.3, doubleSided=True)
    builder.primitive(uv=SQUARE_UV, material=material, attributes={"COLOR_0": colours, "NORMAL": normals},
                      targets=[{"POSITION": sparse}])
    builder.primitive(positions=SQUARE + 1, indices=np.arange(4, dtype=np.uint8), mode=5)
    builder.primitive(positions=SQUARE + 2, indices=None, mode=6)
    tree["meshes"][0]["weights"] = [0.5]
    tree["nodes"] += [{"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0, 1, 1], "scale": [-1, 1, 1], "children": [2]},
                      {"matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1], "mesh": 0, "camera": 0, "extras": {"a": 1}}]
    tree["scenes"][0]["nodes"] = [0, 1]
    tree |= {"cameras": [{"type": "perspective"}], "animations": [{"name": "walk"}], "extensionsUsed": ["KHR_texture_transform"]}
    return builder


@lru_cache(maxsize=1)
def _builders():
    """(tree, blob) of some files: plain, with every feature, with KTX2, with Draco."""
    import DracoPy

    packed = Builder()
    view = packed.view(DracoPy.encode(SQUARE, TWO.astype(np.uint32)))
    entry = packed.primitive(extensions={"KHR_draco_mesh_compression": {"bufferView": view, "attributes": {"POSITION": 0}}})
    entry["material"] = packed.material(pbr={"baseColorFactor": [1, 0, 0, 1]})
    packed.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    basis = Builder()
    image = basis.add("images", {"bufferView": basis.view(ktx2("UASTC")), "mimeType": "image/ktx2"})
    texture = basis.add("textures", {"extensions": {"KHR_texture_basisu": {"source": image}}})
    basis.primitive(uv=SQUARE_UV, material=basis.material(texture))
    return [(builder.tree, builder.blob) for builder in (_rich(), textured(), packed, basis)]


def _built(tree, blob):
    builder = Builder()
    builder.tree, builder.blob = tree, blob
    return builder


def gltf(data: bytes) -> None:
    """The JSON tree of a glTF with odd places, in a GLB or beside its buffer."""
    choices = Choices(data)
    tree, blob = choices.pick(_builders())
    for _ in range(choices.whole(0, 3)):
        tree = bend_tree(tree, choices)
    blob = edited(blob, choices) if choices.flag(4) else blob
    strict = choices.flag(4)
    if not isinstance(tree, dict) or choices.flag(4):
        (folder() / "a.bin").write_bytes(blob)
        whole = {**tree, "buffers": [{"uri": "a.bin", "byteLength": len(blob)}]} if isinstance(tree, dict) else tree
        return _load(json.dumps(whole).encode(), "a.gltf", strict)
    return _load(_built(tree, blob).glb(), "a.glb", strict)


def glb(data: bytes) -> None:
    """The container: chunks with lengths and types that lie, as a file and from stdin."""
    choices = Choices(data)
    if choices.flag(8):
        raw = b"glTF" + struct.pack("<II", 2, 12 + len(choices.data)) + choices.rest()
    else:
        raw = _built(*choices.pick(_builders())).glb()
        for _ in range(choices.whole(0, 3)):
            raw = raw[:12] + edited(raw[12:40], choices) + raw[40:] if choices.flag() else edited(raw, choices)
        raw = raw[:8] + struct.pack("<I", len(raw)) + raw[12:] if choices.flag() else raw
    _check(load(raw, choices.flag(4)))


# Text


def _lines(text, choices):
    """Text with up to three odd places, as bytes, sometimes in another encoding."""
    for _ in range(choices.whole(0, 3)):
        text = bend_text(text, choices)
    raw = text.encode("utf-8", "surrogatepass")
    if choices.flag(12):
        return (b"\xff\xfe" if choices.flag() else b"\xef\xbb\xbf") + text.encode("utf-16-le", "surrogatepass")
    return edited(raw, choices) if choices.flag(6) else raw


def obj(data: bytes) -> None:
    """An OBJ, its own library beside it."""
    choices = Choices(data)
    _load(_lines(OBJ, choices), "a.obj", choices.flag(4))


def mtl(data: bytes) -> None:
    """A material library that an OBJ names."""
    choices = Choices(data)
    (folder() / "b.mtl").write_bytes(_lines(MTL, choices))
    _load(OBJ.replace("a.mtl", "b.mtl").encode(), "b.obj", choices.flag(4))


def ply(data: bytes) -> None:
    """A PLY as text or in either byte order."""
    choices = Choices(data)
    form = choices.pick(("ascii", "binary_little_endian", "binary_big_endian"))
    head = PLY.format(form=form)
    body = PLY_TEXT.encode() if form == "ascii" else _binary_ply("<" if form == "binary_little_endian" else ">")
    if choices.flag():
        body = edited(body, choices) if form != "ascii" else _lines(PLY_TEXT, choices)
    _load(_lines(head, choices) + body, "a.ply", choices.flag(4))


def _binary_ply(order):
    out = b""
    for line in PLY_TEXT.splitlines()[:4]:
        words = line.split()
        out += struct.pack(order + "3f3B2f", *map(float, words[:3]), *map(int, words[3:6]), *map(float, words[6:]))
    for line in PLY_TEXT.splitlines()[4:6]:
        words = line.split()
        count, pairs = int(words[0]), int(words[1 + int(words[0])])
        corners, reals = map(int, words[1 : 1 + count]), map(float, words[2 + count : 2 + count + pairs])
        out += struct.pack(f"{order}B{count}iB{pairs}fi", count, *corners, pairs, *reals, 0)
    return out + struct.pack(order + "i", 7)


def stl_file(data: bytes) -> None:
    """An STL as text or bytes."""
    choices = Choices(data)
    if choices.flag():
        return _load(_lines(stl_text() if isinstance(stl_text(), str) else stl_text().decode(), choices), "a.stl")
    raw = stl(attributes=(choices.whole(0, 65535), choices.whole(0, 65535)),
              header=choices.pick((b"made here", b"solid of bytes", b"COLOR=\1\2\3\4 MATERIAL=")))
    for _ in range(choices.whole(0, 2)):
        raw = edited(raw, choices)
    if choices.flag():
        raw = raw[:80] + struct.pack("<I", abs(choices.number()) & 0xFFFFFFFF) + raw[84:]
    return _load(raw, "a.stl")


def off(data: bytes) -> None:
    """An OFF with or without colours, normals and UVs."""
    choices = Choices(data)
    head, more = choices.pick((("", ""), ("C", " 255 0 0 255"), ("N", " 0 0 1"), ("CN", " 0 0 1 1 0 0 1"), ("ST", " 0 1")))
    _load(_lines(OFF.format(head=head, more=more), choices), "a.off")


# XML


RICH_3MF = ('<m:colorgroup id="5"><m:color color="#FF0000"/><m:color color="#00FF0080"/></m:colorgroup><basematerials id="6">'
            '<base name="red" displaycolor="#FF0000"/><base name="clear" displaycolor="#00FF0040"/></basematerials>'
            '<m:texture2d id="7" path="/3D/a.png" contenttype="image/png" tilestyleu="mirror" filter="nearest"/>'
            '<m:texture2dgroup id="8" texid="7">'
            '<m:tex2coord u="0" v="0"/><m:tex2coord u="1" v="0"/><m:tex2coord u="1" v="1"/></m:texture2dgroup>')
GROUP_3MF = ('<object id="9"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
             '<component objectid="2" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/></components></object>')


def threemf(data: bytes) -> None:
    """A 3MF: its XML, and the archive around it."""
    choices = Choices(data)
    textured_object = mesh('pid="8" p1="0" p2="1" p3="2"', 'pid="5" p1="0" p2="1" p3="1"', attributes='pid="6" pindex="1"')
    text = model(RICH_3MF + textured_object + mesh('pid="6" p1="1"', key="2") + GROUP_3MF,
                 '<item objectid="9" transform="0 2 0 -2 0 0 0 0 2 0 0 5"/><item objectid="1"/>')
    for _ in range(choices.whole(0, 3)):
        text = bend_text(text, choices)
    raw = package(text.encode("utf-8", "replace"), **{"3D_slash_a_dot_png": encoded(RED_BLUE)})
    raw = edited(raw, choices) if choices.flag(4) else raw
    _load(raw, "a.3mf", choices.flag(4))


def dae_file(data: bytes) -> None:
    """A COLLADA document; without pycollada it is refused by its name."""
    choices = Choices(data)
    text = dae()
    for _ in range(choices.whole(0, 3)):
        text = bend_text(text, choices)
    _load(text.encode("utf-8", "replace"), "a.dae", choices.flag(4))


# Images


@lru_cache(maxsize=1)
def _images():
    from PIL import features

    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    deep, clear = Image.fromarray(pixels[..., 0].astype(np.uint16) << 8), np.dstack([pixels, pixels[..., :1]])
    found = [encoded(pixels, "PNG"), encoded(pixels[..., 0], "PNG"), encoded(deep, "PNG"), encoded(clear, "PNG"),
             encoded(pixels, "JPEG"), encoded(pixels, "JPEG", progressive=True), encoded(pixels, "BMP"), encoded(pixels, "GIF"),
             encoded(pixels, "TGA"), encoded(pixels, "TIFF"), encoded(pixels, "TIFF", compression="tiff_lzw")]
    found += [encoded(pixels, "WEBP"), encoded(pixels, "WEBP", lossless=True)] if features.check("webp") else []
    return found + [ktx2(kind) for kind in KTX2_FILES]


def image(data: bytes) -> None:
    """An image of any kind with bytes edited; a PNG with its checksums right again. The limit of pixels is lower than usual, so
    that what a few bytes may ask for is less than the harness calls too much."""
    choices = Choices(data)
    raw = choices.pick(_images())
    for _ in range(choices.whole(0, 3)):
        raw = edited(raw[:120], choices) + raw[120:] if choices.flag() else edited(raw, choices)
    if raw[:4] == b"\x89PNG" and choices.flag():
        raw = _checked_png(raw)
    pixels = read_image(raw, "an image", Notes(limits=Limits(image_pixels=1 << 22)), choices.flag())
    assert pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 4 and pixels.size


def _checked_png(raw):
    """A PNG whose chunks have right checksums."""
    out, at = io.BytesIO(), 8
    out.write(raw[:8])
    while at + 12 <= len(raw):
        length = int.from_bytes(raw[at : at + 4], "big")
        body = raw[at + 4 : at + 8 + length]
        out.write(raw[at : at + 4] + body + struct.pack(">I", zlib.crc32(body)))
        at += 12 + length
    return out.getvalue()


def scene(data: bytes) -> None:
    """A Scene object whose arrays do not fit together."""
    choices = Choices(data)
    made = scene_of(SQUARE, TWO, np.ones((4, 4)))
    for _ in range(choices.whole(0, 2)):
        name = choices.pick(("positions", "faces", "face_material", "corner_uv", "corner_color"))
        if isinstance(getattr(made, name), np.ndarray):
            setattr(made, name, _odd(getattr(made, name), choices))
    _check(load(made))


def _odd(array, choices):
    kind = choices.whole(0, 5)
    if kind == 0:
        return array[: choices.whole(0, 1)]
    if kind == 1:
        return array.reshape(-1)
    if kind == 2:
        return choices.pick((None, "a", [], 3, array.tolist()))
    if kind == 3:
        with contextlib.suppress(ValueError, TypeError):  # what is text already may be no number
            return array.astype(choices.pick((np.float64, np.int8, "U3", bool, np.complex64, object)))
        return array
    real = array.dtype.kind == "f"
    array = array.astype(np.float64) if real else array.copy()
    if array.size:
        place = choices.whole(0, array.size - 1)
        array.reshape(-1)[place] = choices.real() if real else max(-9, min(choices.number(), 9))
    return array
