"""glTF scenes in which one property is all that matters: trees, skins, morph targets, variants, instances, extensions."""

import io
import json
import struct

import numpy as np
from mesh_files import SQUARE, SQUARE_UV, TWO, Builder
from PIL import Image

LIGHTS, VARIANTS, INSTANCES = "KHR_lights_punctual", "KHR_materials_variants", "EXT_mesh_gpu_instancing"


def checker(colour=(200, 40, 90), side=16):
    """A PNG of squares, bytes."""
    rows, columns = np.indices((side, side)) // 4
    image = np.where(((rows + columns) % 2)[..., None], colour, (30, 30, 60)).astype(np.uint8)
    out = io.BytesIO()
    Image.fromarray(image).save(out, "PNG")
    return out.getvalue()


def bumpy(count=6, height=0.2):
    """(positions [V, 3], UVs [V, 2], faces [F, 3]) of a square that is not flat."""
    u, v = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count), indexing="ij")
    positions = np.stack([u, height * np.sin(5 * u) * np.cos(4 * v), v], axis=2).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).reshape(-1, 1)
    faces = (corner + [0, 1, count, count, 1, count + 1]).reshape(-1, 3).astype(np.uint16)
    return positions, np.stack([u, v], axis=2).reshape(-1, 2).astype(np.float32), faces


def textured(builder, **more):
    """Add a material with an image of its own; return its number."""
    texture = builder.texture(checker(), **more)
    return builder.add("materials", {"name": f"material {texture}", "pbrMetallicRoughness": {
        "baseColorTexture": {"index": texture}, "metallicFactor": 0.25}})


def bumpy_mesh(builder, material, mesh=0, **more):
    """Add a bumpy square to a mesh; return its primitive."""
    positions, uv, faces = bumpy()
    return builder.primitive(positions, faces, uv, mesh=mesh, material=material, **more)


def tree(depth=500):
    """A chain of nodes, every tenth with a mesh, and names and extras on all."""
    b = Builder()
    bumpy_mesh(b, textured(b))
    b.tree["nodes"] = [{"name": f"node {n}", "translation": [0.25, 0.0, 0.125], "extras": {"number": n}} for n in range(depth)]
    for n in range(depth):
        b.tree["nodes"][n] |= ({"children": [n + 1]} if n + 1 < depth else {}) | ({"mesh": 0} if n % 10 == 0 else {})
    return b


def instances(count=100):
    """A mesh that many nodes show, at several scales and once mirrored."""
    b = Builder()
    bumpy_mesh(b, textured(b))
    b.tree["nodes"] = [{"mesh": 0, "translation": [float(n), 0, 0], "scale": [1 + n % 3, 1 + n % 3, (-1) ** n * (1 + n % 3)]}
                       for n in range(count)]
    b.tree["scenes"] = [{"nodes": list(range(count))}]
    return b


def spinning():
    """Two meshes, one turned by an animation with names and extras."""
    b = Builder()
    b.tree["meshes"] = [{"name": "base", "primitives": []}, {"name": "blade", "primitives": [], "extras": {"kept": True}}]
    bumpy_mesh(b, textured(b))
    bumpy_mesh(b, 0, mesh=1)
    b.tree["nodes"] = [{"mesh": 0, "children": [1]}, {"mesh": 1, "name": "turns", "translation": [0, 1, 0]}]
    times = b.accessor(np.linspace(0, 2, 5, dtype=np.float32), min=[0.0], max=[2.0])
    angle = np.linspace(0, np.pi, 5) / 2
    turns = b.accessor(np.stack([0 * angle, np.sin(angle), 0 * angle, np.cos(angle)], axis=1).astype(np.float32))
    b.tree["animations"] = [{"name": "spin", "extras": {"loop": 1}, "samplers": [{"input": times, "output": turns}],
                             "channels": [{"sampler": 0, "target": {"node": 1, "path": "rotation"}}]}]
    return b


def skinned():
    """Two skins, of which one has vertices at one position with other weights."""
    b = Builder()
    b.tree["meshes"] = [{"name": "arm", "primitives": []}, {"name": "leg", "primitives": []}]
    positions, uv, faces = bumpy()
    double = np.concatenate([positions, positions]), np.concatenate([uv, uv])
    halves = np.where(np.arange(len(faces))[:, None] % 2, faces, faces + len(positions)).astype(np.uint16)
    for mesh, (points, coords, triangles) in enumerate([(positions, uv, faces), (*double, halves)]):
        weight = (np.arange(len(points), dtype=np.float32)[:, None] % 7) / 7
        weights = np.concatenate([weight, 1 - weight, 0 * weight, 0 * weight], axis=1).astype(np.float32)
        joints = np.tile(np.array([0, 1, 0, 0], np.uint8), (len(points), 1))
        b.primitive(points, triangles, coords, mesh=mesh, material=textured(b),
                    attributes={"JOINTS_0": b.accessor(joints), "WEIGHTS_0": b.accessor(weights)})
    bind = b.add("accessors", {"bufferView": b.view(np.tile(np.eye(4, dtype=np.float32), (2, 1, 1)).tobytes()), "count": 2,
                               "type": "MAT4", "componentType": 5126})
    b.tree["skins"] = [{"joints": [2, 3], "inverseBindMatrices": bind, "name": "first"}, {"joints": [4, 5]}]
    b.tree["nodes"] = [{"mesh": 0, "skin": 0}, {"mesh": 1, "skin": 1}, {"children": [3], "name": "shoulder"},
                       {"translation": [0, 0.5, 0]}, {"children": [5], "rotation": [0, 0.6, 0, 0.8]}, {"scale": [1, 2, 1]}]
    b.tree["scenes"] = [{"nodes": [0, 1, 2, 4]}]
    return b


def morphing():
    """Morph targets, one sparse, with names and a weight that an animation changes."""
    b = Builder()
    positions, _, _ = bumpy()
    lifted = np.zeros_like(positions)
    lifted[3:5, 1] = 0.5
    where = b.view(np.array([3, 4], np.uint16).tobytes()), b.view(lifted[3:5].tobytes())
    sparse = b.add("accessors", {"count": len(positions), "type": "VEC3", "componentType": 5126, "min": [0.0, 0.0, 0.0],
                                 "max": [0.0, 0.5, 0.0], "sparse": {"count": 2, "indices": {
                                     "bufferView": where[0], "componentType": 5123}, "values": {"bufferView": where[1]}}})
    waved = (0.1 * np.sin(7 * positions)).astype(np.float32)
    dense = b.accessor(waved, min=waved.min(axis=0).tolist(), max=waved.max(axis=0).tolist())
    bumpy_mesh(b, textured(b), targets=[{"POSITION": sparse}, {"POSITION": dense}])
    b.tree["meshes"][0] |= {"weights": [0.5, 0.25], "extras": {"targetNames": ["lift", "wave"]}}
    times = b.accessor(np.array([0, 1], np.float32), min=[0.0], max=[1.0])
    weights = b.accessor(np.array([0, 0, 1, 0.5], np.float32))
    b.tree["animations"] = [{"samplers": [{"input": times, "output": weights}],
                             "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]}]
    return b


def variants():
    """Materials of variants, whose images and UVs the default does not need."""
    b = Builder()
    shown, other = textured(b), textured(b)
    b.tree["materials"][other]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 1
    uv = b.accessor(bumpy()[1] * np.float32(2))
    bumpy_mesh(b, shown, attributes={"TEXCOORD_1": uv}, extensions={VARIANTS: {"mappings": [
        {"material": shown, "variants": [0]}, {"material": other, "variants": [1]}]}})
    b.tree |= {"extensionsUsed": [VARIANTS], "extensions": {VARIANTS: {"variants": [{"name": "red"}, {"name": "blue"}]}}}
    return b


def lit():
    """Lights, cameras and two scenes, of which the second is the default."""
    b = Builder()
    bumpy_mesh(b, textured(b))
    b.tree |= {"extensionsUsed": [LIGHTS], "extensions": {LIGHTS: {"lights": [{"type": "point", "intensity": 30.0}]}},
               "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.01}}], "scene": 1}
    b.tree["nodes"] = [{"mesh": 0}, {"camera": 0, "translation": [0, 0, 4]}, {"extensions": {LIGHTS: {"light": 0}}}]
    b.tree["scenes"] = [{"name": "empty", "nodes": [1]}, {"nodes": [0, 1, 2], "extras": [1, 2]}]
    return b


def instanced_on_gpu():
    """EXT_mesh_gpu_instancing, required."""
    b = Builder()
    bumpy_mesh(b, textured(b))
    moved = b.accessor(np.random.default_rng(1).random((20, 3)).astype(np.float32) * 9)
    b.tree["nodes"][0]["extensions"] = {INSTANCES: {"attributes": {"TRANSLATION": moved}}}
    b.tree |= {"extensionsUsed": [INSTANCES], "extensionsRequired": [INSTANCES]}
    return b


def strange():
    """An extension that nobody knows and that refers to an accessor, attributes of an application, points, and an image that
    nothing shows."""
    b = Builder()
    positions = bumpy()[0]
    bumpy_mesh(b, textured(b), attributes={"_TEMPERATURE": b.accessor(np.arange(len(positions), dtype=np.float32)),
                                           "COLOR_0": b.accessor(np.full((len(positions), 3), 200, np.uint8), normalized=True)})
    b.primitive(SQUARE, None, mode=0)
    b.texture(checker((9, 9, 9)))
    b.tree |= {"extensionsUsed": ["ACME_curves"], "extensions": {"ACME_curves": {"table": b.accessor(np.arange(
        12, dtype=np.float32))}}, "extras": {"licence": "of our own"}}
    return b


def many_materials():
    """Maps, factors, texture transforms, alpha and unlit, and a plain material beside them."""
    b = Builder()
    for entry in ({"alphaMode": "MASK", "alphaCutoff": 0.25}, {"doubleSided": True, "emissiveFactor": [0.5, 0.25, 0]},
                  {"extensions": {"KHR_materials_unlit": {}}}):
        bumpy_mesh(b, textured(b))
        b.tree["materials"][-1] |= entry
    first = b.tree["materials"][0]
    first["pbrMetallicRoughness"] |= {"baseColorFactor": [0.5, 1.0, 0.25, 1.0],
                                      "metallicRoughnessTexture": {"index": b.texture(checker((0, 90, 20)))}}
    first |= {"normalTexture": {"index": b.texture(checker((120, 140, 250))), "scale": 0.5},
              "emissiveTexture": {"index": b.tree["materials"][1]["pbrMetallicRoughness"]["baseColorTexture"]["index"]}}
    b.tree["materials"][1]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
        "KHR_texture_transform": {"offset": [0.25, 0.5], "scale": [2, 2], "rotation": 0.3}}
    b.add("materials", {"name": "plain", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.8, 1.0]}})
    b.primitive(SQUARE, TWO, SQUARE_UV, material=3)
    b.tree["extensionsUsed"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    return b


SCENES = {scene.__name__: scene for scene in (tree, instances, spinning, skinned, morphing, variants, lit, instanced_on_gpu,
                                              strange, many_materials)}


def tree_of(data):
    """The JSON of a GLB."""
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def with_tree(data, root):
    """A GLB with another JSON."""
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + int.from_bytes(data[12:16], "little") :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def remembering():
    """The encoder of encode_document(), which codes equal scenes once."""
    known = {}

    def code(scene, options, report):
        from texfcodec.api import encode_loaded

        arrays = (scene.positions, scene.faces, scene.face_material, scene.corner_uv)
        materials = [(m.texture, m.maps, tuple(m.factor), m.parameters) for m in scene.materials]
        key = repr(([array.tobytes() for array in arrays], materials, [t.image.shape for t in scene.textures]))
        if key not in known:
            known[key] = encode_loaded(scene, options, report)
        return known[key]

    return code
