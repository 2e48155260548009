"""The geometry units of a stream, and their decoded form (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...geometry.areas import used_vertices
from ...geometry.checksum import geometry_crc
from ...geometry.draco import counts_of, dec_geometry, dec_textured, enc_geometry, enc_textured, split_corners
from ...geometry.geometry_unit import GeometryUnit
from ...report import Step, no_step

if TYPE_CHECKING:
    from ..faces import SentSurface
    from ..supports.texel_plan import SentPlan


def geometry_bytes(geometry: list[dict]) -> int:
    """Return the total size, in bytes, of the Draco data of geometry units. geometry: their syntax values."""
    return sum(len(unit["draco_data"]) for unit in geometry)


def code_geometry(surface: SentSurface, face_field: np.ndarray, plans: dict[int, SentPlan],
                  step: Step = no_step) -> tuple[list[dict], list[GeometryUnit]]:
    """Code the faces of each field and material as a Draco unit. Return (syntax values, decoded GeometryUnits). face_field:
    int64 [F], field of each face; plans: the TexelPlan of each field over texels, by field number."""
    values, units = [], []
    corner_uv = {number: plan.corner_uv() for number, plan in plans.items()}
    groups = face_field * (int(surface.material.max(initial=0)) + 1) + surface.material
    used = np.unique(groups)
    for done, group in enumerate(used):
        step(done, len(used))
        rows = np.flatnonzero(groups == group)
        number, material = int(face_field[rows[0]]), int(surface.material[rows[0]])
        code = _code_textured if number in plans else _code_plain
        uv = corner_uv[number][np.searchsorted(plans[number].group.faces, rows)] if number in plans else None
        unit, decoded = code(surface, rows, uv)
        if len(decoded[1]) != len(rows):
            raise InputError("TXF-I62", "Draco changed the number of faces", value=len(decoded[1]), allowed=len(rows))
        values.append({"field_index": number, "material_index": material, "geometry_crc": geometry_crc(*decoded), **unit})
        units.append(GeometryUnit(number, material, *decoded))
    return values, units


def _code_plain(surface, rows, _):
    """Return (syntax values of a unit of positions, its decoded (lattice, faces))."""
    bits = surface.cube.position_bits
    used, local = used_vertices(surface.faces[rows], len(surface.lattice))
    data = enc_geometry(surface.lattice[used], local, bits)
    counts = counts_of(data)
    return {"unit_vertices": counts[0], "unit_faces": counts[1], "draco_data": data}, dec_geometry(data, *counts, bits)


def _code_textured(surface, rows, uv):
    """Return the same with UVs int64 [F, 3, 2]: the decoded part is (lattice, faces, uv)."""
    bits, origin = surface.cube.position_bits, uv.min(axis=(0, 1))
    vertex, uv, faces = split_corners(surface.faces[rows], uv - origin)
    data, coding = enc_textured(surface.lattice[vertex], faces, uv, bits)
    counts = counts_of(data)
    lattice, faces, decoded = dec_textured(data, *counts, coding, bits)
    values = {"unit_vertices": counts[0], "unit_faces": counts[1], "uv_origin": origin.tolist(), "uv_bits": coding.bits,
              "uv_range": coding.range, "draco_data": data}
    return values, (lattice, faces, decoded + origin)
