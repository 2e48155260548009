"""Textures of a Scene for the GPU: whole images, and which map of which material asks which of them by which UVs."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..scene.channels import BY_NAME
from ..scene.scene import Scene
from .container import Blobs
from .surface_buffers import uv_sets


def pack_images(scene: Scene, blobs: Blobs) -> dict[str, Any]:
    """The header's "images" and, for each material, what it asks of them; the one "field" that a mesh counts as."""
    used = sorted({t for m in scene.materials for t in (m.texture, *m.maps.values()) if t >= 0})
    kept: dict[int, Any] = {}  # several textures may be one image
    images = []
    for number in used:
        image = scene.textures[number].image
        if id(image) not in kept:
            kept[id(image)] = blobs.add(image)
        images.append({"values": kept[id(image)], "wrap": list(scene.textures[number].wrap)})
    place = {texture: i for i, texture in enumerate(used)}
    sets = uv_sets(scene)
    maps = [_maps(scene, material, place, sets) for material in scene.materials]
    factors = [{"factor": np.asarray(m.factor, float).tolist()} for m in scene.materials]
    return {"channels": [], "payload": None, "images": images, "image_maps": maps, "factors": factors,
            "fields": [{"kind": "images", "count": 0}]}


def _maps(scene, material, place, sets):
    """{channel: [image, UV set, columns of the image]}."""
    out = {}
    if material.texture >= 0:
        out["base_colour"] = [place[material.texture], 0, [0, 1, 2, 3]]
    for name, texture in material.maps.items():
        if texture >= 0:
            uv = scene.map_uv.get(name, scene.corner_uv)
            number = next(i for i, one in enumerate(sets) if one is uv)
            out[name] = [place[texture], number, list(BY_NAME[name].columns)]
    return out
