"""What the page gets of an asset: typed arrays as a GPU takes them, decoded by the package (web/ holds no decoder)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..render.backdrop import is_plain
from ..render.camera import bounding_sphere
from ..render.environment import DAYLIGHT
from ..render.material_effects import ShadingTable
from ..scene.channels import PARAMETERS
from ..scene.effects import EFFECTS
from ..scene.scene import Scene
from .container import Blobs
from .field_buffers import pack_fields, resident_bytes
from .image_buffers import pack_images
from .light import light_tables, material_look
from .surface_buffers import pack_mesh, scene_corners, texf_corners

if TYPE_CHECKING:
    from ..texf import Texf


def pack(asset: Scene | Texf, name: str, size: int) -> bytes:
    """The container (container.py) of a Texf or a Scene. name: what the page calls it; size: of its file, in bytes."""
    blobs = Blobs()
    table = ShadingTable(asset.materials)
    centre, radius = bounding_sphere(asset.positions)
    sphere = centre, radius or 1.0
    corners = scene_corners(asset, table, sphere) if isinstance(asset, Scene) else texf_corners(asset, table, sphere)
    header = {
        "kind": "mesh" if isinstance(asset, Scene) else "stream", "name": name, "bytes": size, "faces": len(asset.faces),
        "centre": centre.tolist(), "radius": sphere[1], "plain": is_plain(asset),
        "warnings": list(asset.warnings) if isinstance(asset, Scene) else [],
        "mesh": pack_mesh(corners, blobs), "materials": _materials(asset, table),
        "light": _light(blobs) if table.is_lit else None,
        "effects": sorted(frozenset().union(*table.effects)), "defaults": _defaults(),
    }
    header |= pack_images(asset, blobs) if isinstance(asset, Scene) else pack_fields(asset, blobs)
    header["resident"] = resident_bytes(header)
    return blobs.joined(header)


def _materials(asset, table):
    return [{"name": m.name, "alpha_mode": m.alpha_mode, "alpha_cutoff": float(m.alpha_cutoff), "double_sided": m.double_sided,
             **material_look(table, number)} for number, m in enumerate(asset.materials)]


def _light(blobs):
    """The tables of shading as references."""
    return {name: blobs.add(value) if isinstance(value, np.ndarray) else value for name, value in light_tables(DAYLIGHT).items()}


def _defaults():
    """What `?effects=all` takes where an asset says nothing: every effect, and every parameter's default, but that what has no
    metal in it does not become one."""
    most = float(np.finfo(np.float32).max)
    return {"effects": [effect.name for effect in EFFECTS],
            "parameters": {p.name: [min(v, most) for v in p.default] for p in PARAMETERS} | {"metallic": [0.0]}}
