"""Compare a coded file with its source in Blender: names, transforms, materials, animation and a picture of each.

Run by a Python that has bpy and texfcodec's dependencies, after make -C tools add-ons:

    BLENDER_USER_RESOURCES=out/blender python tools/proof/doors/blender.py out/texf-blender.zip out/doors SOURCE CODED PLAIN ...

Files come in threes: the source, the file that the add-on opens, and what texf-dec made of it, which Blender opens by itself.
PSNR is over the pixels that either picture covers. Suns without a width and no bounces: a picture has no noise.
"""

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Vector

SIDE, SAMPLES, TOLERANCE = 384, 16, 1e-3
SUNS = [(50, 0, 30), (60, 0, 150), (70, 0, 270), (180, 0, 0)]  # degrees


def emptied() -> None:
    """Leave a scene with nothing in it; the add-on stays enabled."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.context.scene.render.fps = 24


def opened(path: Path) -> None:
    """Import a file by the operator that its suffix calls for."""
    (bpy.ops.import_scene.texf if path.suffix == ".texf" else bpy.ops.import_scene.gltf)(filepath=str(path.resolve()))
    bpy.context.view_layer.update()


def nodes_of(material: bpy.types.Material) -> list:
    """Return kinds, unlinked values and links of a material's nodes; images by their colour space."""
    values = lambda socket: [float(x) for x in socket] if hasattr(socket, "__len__") and not isinstance(socket, str) else socket
    tree = material.node_tree
    nodes = [[n.bl_idname, {s.name: values(s.default_value) for s in n.inputs if hasattr(s, "default_value") and not s.is_linked},
              n.image.colorspace_settings.name if getattr(n, "image", None) else None] for n in tree.nodes]
    links = [[x.from_node.bl_idname, x.from_socket.name, x.to_node.bl_idname, x.to_socket.name] for x in tree.links]
    return [sorted(nodes, key=str), sorted(links), material.use_backface_culling]


def curves() -> Iterator[tuple[str, list]]:
    """Yield (action and property, values at nine frames). Quaternions have unit length, as Blender applies them: it interpolates
    their components, so that the length depends on where the keys are."""
    for action in bpy.data.actions:
        for path in sorted({curve.data_path for curve in action.fcurves}):
            values = np.array([[curve.evaluate(t) for t in np.linspace(*action.frame_range, 9)]
                               for curve in action.fcurves if curve.data_path == path])
            if path.endswith("rotation_quaternion"):
                values /= np.linalg.norm(values, axis=0)
            yield f"{action.name}/{path}", values.tolist()


def facts() -> dict:
    """Return what of a scene shall be equal: {property: {name: value}}."""
    objects = bpy.context.scene.objects
    world = lambda o: [float(x) for row in o.matrix_world for x in row]
    bones = {f"{o.name}/{b.name}": [float(x) for row in b.matrix for x in row]
             for o in objects if o.type == "ARMATURE" for b in o.pose.bones}
    return {"objects": {o.name: [o.type, o.parent and o.parent.name, o.parent_bone] for o in objects},
            "meshes": {o.name: o.data.name for o in objects if o.data},
            "transforms": {o.name: world(o) for o in objects} | bones,
            "slots": {o.name: [s.material and s.material.name for s in o.material_slots] for o in objects},
            "materials": {m.name: nodes_of(m) for m in bpy.data.materials if m.use_nodes},
            "shape keys": {k.name: [b.name for b in k.key_blocks] for k in bpy.data.shape_keys},
            "groups": {o.name: [g.name for g in o.vertex_groups] for o in objects},
            "curves": dict(curves()),
            "variants": dict(enumerate(v.name for v in getattr(bpy.data.scenes[0], "gltf2_KHR_materials_variants_variants", ()))),
            "extras": {o.name: sorted(map(str, o.keys())) for o in objects}}


def frame_of(scene: bpy.types.Scene) -> int:
    """Return the frame in the middle of the actions, the first without any."""
    ranges = [action.frame_range for action in bpy.data.actions]
    return round(sum(ranges[0]) / 2) if ranges else scene.frame_start


def bounds() -> np.ndarray:
    """Return the lower and upper corner of all meshes as they are drawn, float64 [2, 3]."""
    graph, corners = bpy.context.evaluated_depsgraph_get(), []
    for o in bpy.context.scene.objects:
        if o.type == "MESH" and not o.hide_render and o.visible_get():
            corners += [o.matrix_world @ Vector(c) for c in o.evaluated_get(graph).bound_box]
    return np.array([np.min(corners, 0), np.max(corners, 0)])


def draw(path: Path, box: np.ndarray) -> np.ndarray:
    """Write a picture of the scene; return it, RGBA float32 [SIDE, SIDE, 4]. box: what the camera shows, as of bounds()."""
    scene, middle, radius = bpy.context.scene, box.mean(0), float(np.linalg.norm(box[1] - box[0])) / 2
    camera = bpy.data.objects.new("camera of the check", bpy.data.cameras.new("camera of the check"))
    camera.rotation_euler = Euler(map(math.radians, (68, 0, 32)))
    camera.location = Vector(middle) + camera.rotation_euler.to_matrix() @ Vector((0, 0, 4 * radius))
    camera.data.angle, camera.data.clip_start, camera.data.clip_end = 2 * math.asin(0.26), radius, 8 * radius
    scene.collection.objects.link(camera)
    for number, turn in enumerate(SUNS):
        sun = bpy.data.objects.new(f"sun {number}", bpy.data.lights.new(f"sun {number}", "SUN"))
        sun.rotation_euler, sun.data.energy, sun.data.angle = Euler(map(math.radians, turn)), 2, 0
        scene.collection.objects.link(sun)
    scene.camera, scene.render.engine, scene.render.film_transparent = camera, "CYCLES", True
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising, scene.cycles.seed = SAMPLES, 0, False, 1
    scene.cycles.transparent_max_bounces, scene.view_settings.view_transform = 16, "Standard"
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.threads_mode, scene.render.threads, scene.render.filepath = "FIXED", 1, str(path.resolve())
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path.resolve()), check_existing=False)
    return np.array(image.pixels[:], np.float32).reshape(SIDE, SIDE, 4)


def psnr(a: np.ndarray, b: np.ndarray) -> float | None:
    """PSNR in dB of two pictures over the pixels that either covers; None if they are equal there."""
    covered = (a[..., 3] > 0) | (b[..., 3] > 0)
    error = float(np.mean((a[covered][:, :3] - b[covered][:, :3]) ** 2))
    return round(-10 * math.log10(error), 2) if error else None


def seen(path: Path, picture: Path, box: np.ndarray | None) -> tuple[dict, np.ndarray, np.ndarray]:
    """Open a file; return its facts in the middle of its animation, its picture, and the bounds that the picture shows."""
    emptied()
    opened(path)
    bpy.context.scene.frame_set(frame_of(bpy.context.scene))
    scene, box = facts(), bounds() if box is None else box
    return scene, draw(picture, box), box


def alike(a: object, b: object) -> bool:
    """Return whether two facts are the same; numbers are if they differ by at most TOLERANCE of 1 or of their size."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(alike, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(alike(a[key], b[key]) for key in a)
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= TOLERANCE * max(1, abs(a))
    return a == b


def differences(a: dict, b: dict) -> dict:
    """Return {property: count of what both have alike, or the first three names that differ}."""
    differ = {p: [n for n in {**a[p], **b[p]} if not alike(a[p].get(n), b[p].get(n))] for p in a}
    return {p: sorted(names)[:3] if names else len(a[p]) for p, names in differ.items()}


def main(addon: str, out: str, *files: str) -> None:
    """Append a JSON line to rows.jsonl, beside the pictures, for each three files."""
    bpy.ops.extensions.package_install_files(filepath=str(Path(addon).resolve()), repo="user_default", enable_on_install=True)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    for source, coded, plain in zip(*[iter(map(Path, files))] * 3, strict=True):
        first, picture, box = seen(source, folder / f"{source.stem}.source.png", None)
        second, door, _ = seen(coded, folder / f"{source.stem}.door.png", box)
        _, stock, _ = seen(plain, folder / f"{source.stem}.plain.png", box)
        row = {"file": source.stem, "blender": bpy.app.version_string, "equal": differences(first, second),
               "psnr": psnr(picture, door), "psnr_plain": psnr(picture, stock), "psnr_door_plain": psnr(door, stock)}
        with (folder / "rows.jsonl").open("a", encoding="utf-8") as rows:
            rows.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
