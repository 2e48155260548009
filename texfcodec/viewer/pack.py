"""What the page gets of a mesh and of the light: typed arrays as a GPU takes them. Streams it decodes itself."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..render.backdrop import is_plain
from ..render.camera import bounding_sphere
from ..render.environment import DAYLIGHT
from ..render.material_effects import ShadingTable
from ..scene.scene import Scene
from .container import Blobs
from .image_buffers import pack_images
from .light import light_tables, material_look
from .surface_buffers import pack_mesh, scene_corners

TABLES = ("prefiltered", "ggx", "charlie")


def pack(scene: Scene, name: str, size: int) -> bytes:
    """The container (container.py) of a Scene. name: what the page calls it; size: of its files, in bytes."""
    blobs = Blobs()
    table = ShadingTable(scene.materials)
    centre, radius = bounding_sphere(scene.positions)
    sphere = centre, radius or 1.0
    header = {
        "kind": "mesh", "name": name, "bytes": size, "faces": len(scene.faces), "centre": centre.tolist(), "radius": sphere[1],
        "plain": is_plain(scene), "warnings": list(scene.warnings),
        "mesh": pack_mesh(scene_corners(scene, table, sphere), blobs), "materials": _materials(scene, table),
        **pack_images(scene, blobs),
    }
    header["resident"] = blobs.size
    return blobs.joined(header)


@lru_cache(maxsize=1)
def pack_light() -> bytes:
    """The container of what shading reads of the light (light.light_tables)."""
    blobs = Blobs()
    halves = lambda table: blobs.add(table.astype(np.float16), differences=True)  # 2**-11 is far below a level of 255
    return blobs.joined({name: halves(value) if name in TABLES else blobs.add(value) if isinstance(value, np.ndarray) else value
                         for name, value in light_tables(DAYLIGHT).items()})


def _materials(scene, table):
    return [{"name": m.name, "alpha_mode": m.alpha_mode, "alpha_cutoff": float(m.alpha_cutoff), "double_sided": m.double_sided,
             **material_look(table, number)} for number, m in enumerate(scene.materials)]
