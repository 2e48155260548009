"""Mesh objects in memory: trimesh meshes and scenes -> Scene, and the check of a caller's Scene.

This module uses attributes only and does not import trimesh.
"""

from typing import Any

import numpy as np

from ..errors import InputError
from ..scene.channels import BY_NAME, CORNER_MAPS, MAP_NAMES, PARAMETER_BY_NAME
from ..scene.scene import ALPHA_NAMES, ALPHA_OPAQUE, WRAP_REPEAT, Material, Scene
from .corner_maps import alpha_into, channel_named, vertex_maps
from .images import TextureShelf
from .parts import Notes, Part, assemble, linear_rgba

_PBR_DROPPED = ("metallicRoughnessTexture", "normalTexture", "occlusionTexture", "emissiveTexture")


def is_trimesh(thing: object) -> bool:
    """True for trimesh.Trimesh and trimesh.Scene, without importing trimesh."""
    return any(base.__module__.split(".")[0] == "trimesh" and base.__name__ in ("Trimesh", "Scene")
               for base in type(thing).__mro__)


def read_trimesh(thing: Any, notes: Notes) -> Scene:
    """Convert a trimesh.Trimesh or trimesh.Scene to a Scene. In trimesh v points upwards and colours are 8-bit sRGB."""
    shelf, materials, parts = TextureShelf(notes), [], []
    for label, mesh, matrix in _placed(thing, notes):
        materials.append(_material(mesh, shelf, notes, label))
        parts.append(_part(mesh, matrix, len(materials) - 1, label))
        _add_maps(parts[-1], mesh.vertex_attributes, notes, label)
        for name in mesh.face_attributes:
            notes.remark(f"attribute '{name}' of {label} is left out")
    names = [name for name in getattr(thing, "geometry", {})]
    return assemble(parts, materials, shelf.textures, notes, {"meshes": names} if names else {})


def _placed(thing, notes):
    """[(label, mesh, world matrix)] of all geometry with faces."""
    if not hasattr(thing, "geometry"):
        return [("the mesh", thing, np.eye(4))]
    meshes = []
    for node in thing.graph.nodes_geometry:
        matrix, name = thing.graph[node]
        mesh = thing.geometry[name]
        if hasattr(mesh, "faces"):
            meshes.append((f"mesh '{name}'", mesh, np.asarray(matrix, np.float64)))
        else:
            notes.lose(f"geometry '{name}' (not triangles)", f"geometry '{name}' is not made of triangles; it is left out")
    return meshes


def _part(mesh, matrix, material, label):
    faces = np.asarray(mesh.faces)
    points = np.asarray(mesh.vertices, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    uv, color = _uv(mesh), _color(mesh)
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, [0, 2, 1]]
    for values, count in ((uv, len(points)), (color, len(faces) if color is not None and color.ndim == 3 else len(points))):
        if values is not None and len(values) != count:
            raise InputError("TXF-I22", f"{label} has attributes of different counts", value=len(values), allowed=count)
    return Part(points, faces, material, uv, color, label)


def _add_maps(part, attributes, notes, label):
    """Fill in the channels among the vertex attributes of a trimesh; the rest is named."""
    named = {}
    for name, values in attributes.items():
        if channel_named(name):
            named[name] = np.asarray(values).reshape(len(values), -1)
        else:
            notes.remark(f"attribute '{name}' of {label} is left out")
    if any(len(values) != len(part.positions) for values in named.values()):
        raise InputError("TXF-I22", f"{label} has attributes of different counts")
    part.maps, alpha = vertex_maps(named, notes)
    part.color = alpha_into(part.color, alpha)


def _uv(mesh):
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or not len(uv):
        return None
    uv = np.array(uv, np.float64)[:, :2]
    uv[:, 1] = 1.0 - uv[:, 1]
    return uv


def _color(mesh):
    """float32 linear RGBA [V, 4] or [F, 3, 4]; None if the mesh has only a material or trimesh's default grey."""
    kind = getattr(mesh.visual, "kind", None)
    if kind == "vertex":
        return linear_rgba(np.asarray(mesh.visual.vertex_colors) / 255.0)
    if kind == "face":
        return np.repeat(linear_rgba(np.asarray(mesh.visual.face_colors) / 255.0)[:, None], 3, axis=1)
    return None


def _material(mesh, shelf, notes, label):
    """PBRMaterial or SimpleMaterial -> Material. trimesh stores 8-bit factors; those of a SimpleMaterial are sRGB-coded."""
    source = getattr(mesh.visual, "material", None)
    if source is None:
        return Material("default")
    name = str(getattr(source, "name", None) or "")
    image = getattr(source, "baseColorTexture", None) or getattr(source, "image", None)
    factor = getattr(source, "baseColorFactor", None) if hasattr(source, "baseColorTexture") else source.diffuse
    for key in _PBR_DROPPED:
        if getattr(source, key, None) is not None:
            notes.drop(f"{key} of material '{name}'")
    texture = -1
    if image is not None:
        texture = shelf.put(id(image), lambda: image, name or f"texture of {label}", (WRAP_REPEAT, WRAP_REPEAT))
    mode = getattr(source, "alphaMode", None)
    cutoff = getattr(source, "alphaCutoff", None)
    factor = _factor(factor)
    if not hasattr(source, "baseColorTexture"):
        factor = linear_rgba(factor).astype(np.float64)
    alpha_mode = ALPHA_NAMES.index(mode) if mode in ALPHA_NAMES else ALPHA_OPAQUE
    return Material(name, factor, texture, alpha_mode, 0.5 if cutoff is None else float(cutoff),
                    bool(getattr(source, "doubleSided", False)))


def _factor(factor):
    if factor is None:
        return np.ones(4)
    values = np.asarray(factor)
    values = values / 255.0 if values.dtype.kind in "ui" else values.astype(np.float64)
    return np.clip(np.append(values, 1.0)[:4], 0.0, 1.0)


def _check_maps(material, textures, corner_map):
    for name, index in material.maps.items():
        least = -1 if name in corner_map else 0
        if name not in MAP_NAMES or not isinstance(index, int | np.integer) or not least <= index < textures:
            raise InputError("TXF-I22", "a map of a Scene material has an unknown channel or an unknown texture",
                             value=f"{name!s:.40}: {index!s:.40}", material=material.name)


def _check_parameters(material):
    """Check that each parameter has the right number of values; a value may be infinite only if its default is."""
    for name, value in material.parameters.items():
        default = PARAMETER_BY_NAME[name].default if name in PARAMETER_BY_NAME else ()
        whole = isinstance(value, tuple | list) and len(value) == len(default) > 0
        if not whole or not all(isinstance(v, int | float | np.number) for v in value):
            raise InputError("TXF-I22", "a parameter of a Scene material is unknown, or has the wrong number of values",
                             value=f"{name!s:.40}: {value!s:.80}", material=material.name)
        if not np.isfinite(value).all() and tuple(value) != default:
            raise InputError("TXF-I14", "a parameter of a Scene material is NaN or infinite", value=name,
                             material=material.name)


def _check_arrays(scene):
    """Check that the arrays have the kinds of numbers that Scene requires; optional arrays may be None."""
    optional = ("corner_color", "corner_normal", "corner_tangent")
    named = {name: getattr(scene, name) for name in ("positions", "faces", "face_material", "corner_uv", *optional)}
    tables = {f"{table}[{name!s:.40}]": values for table in ("map_uv", "corner_map")
              for name, values in getattr(scene, table).items()}
    for name, values in (named | tables).items():
        kinds = "iu" if name in ("faces", "face_material") else "fiu"
        if values is None and name in optional:
            continue
        if not isinstance(values, np.ndarray) or values.dtype.kind not in kinds or not values.ndim:
            raise InputError("TXF-I22", f"Scene.{name} is not an array of {'integers' if kinds == 'iu' else 'numbers'}",
                             value=str(getattr(values, "dtype", type(values).__name__)))


def check_scene(scene: Scene) -> Scene:
    """Check that the arrays and materials of a Scene fit together, and return the same Scene. Raises InputError TXF-I13, TXF-I14,
    TXF-I15, TXF-I22."""
    _check_arrays(scene)
    count, points = len(scene.faces), len(scene.positions)
    shapes = {"positions": (points, 3), "faces": (count, 3), "face_material": (count,), "corner_uv": (count, 3, 2),
              "corner_color": (count, 3, 4), "corner_normal": (count, 3, 3), "corner_tangent": (count, 3, 4)}
    for name, shape in shapes.items():
        values = getattr(scene, name)
        if (values is not None or name not in ("corner_color", "corner_normal", "corner_tangent")) and np.shape(values) != shape:
            raise InputError("TXF-I22", f"Scene.{name} has the wrong shape", value=str(np.shape(values)), allowed=str(shape))
    if not count:
        raise InputError("TXF-I15", "the input has no triangles")
    if scene.faces.min() < 0 or scene.faces.max() >= points:
        raise InputError("TXF-I13", "a face of the Scene refers to a vertex that does not exist", vertices=points)
    if scene.face_material.min() < 0 or scene.face_material.max() >= len(scene.materials):
        raise InputError("TXF-I22", "a face of the Scene refers to a material that does not exist")
    if any(not -1 <= material.texture < len(scene.textures) for material in scene.materials):
        raise InputError("TXF-I22", "a material of the Scene refers to a texture that does not exist")
    for material in scene.materials:
        _check_maps(material, len(scene.textures), scene.corner_map)
        _check_parameters(material)
    for name, uv in scene.map_uv.items():
        if name not in MAP_NAMES or np.shape(uv) != (count, 3, 2):
            raise InputError("TXF-I22", "Scene.map_uv has an unknown channel or the wrong shape", value=str(name)[:40])
    for name, values in scene.corner_map.items():
        if name not in CORNER_MAPS or np.shape(values) != (count, 3, BY_NAME[name].components) or not np.isfinite(values).all():
            raise InputError("TXF-I22", "Scene.corner_map has an unknown channel, the wrong shape or values that are not finite",
                             value=str(name)[:40])
    if not all(np.isfinite(values).all() for values in (scene.positions, scene.corner_uv, *scene.map_uv.values())):
        raise InputError("TXF-I14", "positions or UVs of the Scene are NaN or infinite")
    factors = [material.factor for material in scene.materials]
    if not np.isfinite(factors).all() or not (scene.corner_color is None or np.isfinite(scene.corner_color).all()):
        raise InputError("TXF-I14", "colours or factors of the Scene are NaN or infinite")
    if not all(values is None or np.isfinite(values).all() for values in (scene.corner_normal, scene.corner_tangent)):
        raise InputError("TXF-I14", "normals or tangents of the Scene are NaN or infinite")
    return scene
