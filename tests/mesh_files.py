"""What the loader's tests are made of: a glTF file grown piece by piece, encoded images, one way to load bytes, and what
stands in a GLB that was saved."""

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from texfcodec.errors import TexfError
from texfcodec.io.load import load

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
SQUARE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
TWO = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Builder:
    """A glTF file grown piece by piece; `tree` is its JSON, free to bend."""

    def __init__(self):
        self.blob = b""
        self.tree = {"asset": {"version": "2.0", "generator": "test"}, "scene": 0, "scenes": [{"nodes": [0]}],
                     "nodes": [{"mesh": 0, "name": "node"}], "meshes": [{"name": "mesh", "primitives": []}]}

    def add(self, kind, entry):
        self.tree.setdefault(kind, []).append(entry)
        return len(self.tree[kind]) - 1

    def view(self, data, **more):
        self.blob += b"\0" * (-len(self.blob) % 4)
        offset = len(self.blob)
        self.blob += bytes(data)
        return self.add("bufferViews", {"buffer": 0, "byteOffset": offset, "byteLength": len(data), **more})

    def accessor(self, array, **more):
        array = np.ascontiguousarray(array)
        width = 1 if array.ndim == 1 else array.shape[1]
        return self.add("accessors", {"bufferView": self.view(array.tobytes()), "count": len(array), "type": TYPES[width],
                                      "componentType": COMPONENTS[array.dtype.str[1:]], **more})

    def primitive(self, positions=SQUARE, indices=TWO, uv=None, mesh=0, attributes=None, **more):
        found = {"POSITION": self.accessor(positions), **(attributes or {})}
        if uv is not None:
            found["TEXCOORD_0"] = self.accessor(uv)
        entry = {"attributes": found, **more}
        if indices is not None:
            entry["indices"] = self.accessor(np.asarray(indices).reshape(-1))
        self.tree["meshes"][mesh]["primitives"].append(entry)
        return entry

    def texture(self, data, **sampler):
        image = self.add("images", {"bufferView": self.view(data), "mimeType": "image/png"})
        entry = {"source": image}
        if sampler:
            entry["sampler"] = self.add("samplers", sampler)
        return self.add("textures", entry)

    def material(self, texture=None, info=None, **more):
        pbr = {} if texture is None else {"baseColorTexture": {"index": texture, **(info or {})}}
        return self.add("materials", {"name": "m", "pbrMetallicRoughness": {**pbr, **more.pop("pbr", {})}, **more})

    def glb(self):
        return self.with_buffers([{"byteLength": len(self.blob)}] if self.blob else [])

    def with_buffers(self, buffers):
        """The GLB whose JSON names these buffers; the blob is the first one's."""
        text = json.dumps({**self.tree, "buffers": buffers} if buffers else self.tree).encode()
        text += b" " * (-len(text) % 4)
        blob = self.blob + b"\0" * (-len(self.blob) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def encoded(pixels, form="PNG", mode=None, **options):
    out = io.BytesIO()
    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(np.asarray(pixels, np.uint8), mode)
    image.save(out, form, **options)
    return out.getvalue()


RED_BLUE = np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8)


def textured(**sampler):
    """A Builder with one textured square."""
    builder = Builder()
    builder.primitive(uv=SQUARE_UV, material=builder.material(builder.texture(encoded(RED_BLUE), **sampler)))
    return builder


def load_bytes(folder, source, name="a.glb", **options):
    """Builder, bytes or text -> Scene, by way of a file in the folder."""
    data = source.glb() if isinstance(source, Builder) else source
    (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    return load(folder / name, **options)


def facing(scene):
    """Twice the vector area of each face, float64 [F, 3]."""
    a, b, c = (scene.positions[scene.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def refusal(folder, source, name="a.glb", **options):
    """The TexfError that loading ends in."""
    with pytest.raises(TexfError) as caught:
        load_bytes(folder, source, name, **options)
    return caught.value


def read_glb(path):
    """(JSON dict, binary chunk) after checking the container's own numbers."""
    data = Path(path).read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sIIII", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), 0x4E4F534A) and length % 4 == 0
    document, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    if rest:
        size, kind = struct.unpack_from("<II", rest)
        assert kind == 0x004E4942 and size == len(rest) - 8 == document["buffers"][0]["byteLength"]
    return document, rest[8:]


def accessor(document, binary, number):
    item = document["accessors"][number]
    view = document["bufferViews"][item["bufferView"]]
    assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= len(binary)
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[item["type"]]
    kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[item["componentType"]]
    values = np.frombuffer(binary, kind, item["count"] * width, view["byteOffset"]).reshape(-1, width)
    if "min" in item:
        assert np.array_equal(values.min(0), item["min"]) and np.array_equal(values.max(0), item["max"])
    return values


def outcome(path, data):
    """Scene or TexfError; anything else is a failure of the test."""
    path.write_bytes(data)
    try:
        return load(path)
    except TexfError as error:
        return error
