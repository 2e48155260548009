"""The last step of an encode: code the values and write everything as a stream. decoder.py is its mirror image (encoder only)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..bitstream.stream import Stream, write_stream
from ..bitstream.values import field_values, header_values, material_values, metadata_bytes
from ..core.json_text import json_ready
from ..report import Report, plural
from ..scene.scene import NEAREST_FIELDS
from .caches import Cache, NoCache
from .values.coding import coding_of

if TYPE_CHECKING:
    from ..geometry.surface import Surface
    from ..scene.scene import Scene
    from .stages import Filled
    from .values.source_field import SourceField

MANY_FACES, LARGE_SHARE = 1000, 0.1  # faces of a part, and share of them, that are no longer left out without a warning


@dataclass(kw_only=True, repr=False)
class Encoded:
    """A stream and its report.

    data: the stream; sizes: bytes as {"total", "geometry", "attributes", "other"}; counts: {"fields", "voxels", "texels",
    "faces", "vertices"}; face_field: int64 [F], field of every face of the scene, -1 if it was left out; choices: every choice
    of the encoder by its name, with its measurements, JSON-ready; resolution: K, None without voxels; qp: of the values, None if
    they have no QP; texels_per_voxel_edge: the most of any field; reconstruction_sha256: hash over keys and decoded values,
    field by field and channel by channel; psnr_3d: as metrics.psnr_3d, if it was measured; check: as verify.check_encoded, if
    the stream was checked; values: by field, decoded planes by channel name, until then; warnings, dropped: changes of the
    picture, and properties that are not coded, in sentences; remarks: notes that change no picture.
    """

    data: bytes
    sizes: dict
    counts: dict
    face_field: np.ndarray
    choices: dict
    resolution: int | None
    qp: int | None
    texels_per_voxel_edge: float
    reconstruction_sha256: str
    psnr_3d: dict | None = None
    check: dict | None = None
    values: list[dict[str, np.ndarray]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def __repr__(self):
        counts = ", ".join(f"{number} {name}" for name, number in self.counts.items())
        losses = len(self.warnings) + len(self.dropped)
        lost = f", {losses} loss{'es' * (losses != 1)}" if losses else ""
        return f"<Encoded: {len(self.data)} bytes, K {self.resolution}, QP {self.qp}, {counts}{lost}>"


def write(filled: Filled, report: Report, units: Cache | None = None) -> Encoded:
    """Code the values of a Filled, the result of all stages, at its quality and return the stream as an Encoded. units: cache of
    coded attribute units."""
    stream, fields = _without_values(filled, report), filled.fields
    coded = coding_of(filled.price).units(filled, stream, units or NoCache(), report)
    with report.stage("write"):
        data, sizes = write_stream(stream)
    scene, surface = filled.source.scene, filled.source.surface
    remarks, warnings = _collapsed(scene, surface)
    report.remarks += [text for text in remarks if text not in report.remarks]
    report.warnings += [text for text in warnings if text not in report.warnings]
    face_field = np.full(len(scene.faces), -1, np.int64)
    face_field[surface.origin_face] = filled.source.face_field
    texels = sum(len(part.support) for part in fields if part.support.planar)
    counts = {"fields": len(fields), "voxels": sum(len(part.support) for part in fields) - texels, "texels": texels,
              "faces": len(filled.surface.faces), "vertices": sum(unit["unit_vertices"] for unit in filled.geometry)}
    return Encoded(data=data, sizes={"total": len(data), **sizes}, counts=counts, face_field=face_field,
                   choices=json_ready(filled.evidence | coded.evidence), resolution=filled.resolution, qp=filled.qp,
                   reconstruction_sha256=_sha256(fields, coded.value), values=coded.value,
                   texels_per_voxel_edge=max((part.texels_per_edge for part in fields), default=0.0))


def _without_values(filled: Filled, report: Report) -> Stream:
    """Return the Stream of a Filled before its attribute units."""
    scene, source, shading = filled.source.scene, filled.source, filled.shading
    stream = Stream(header_values(filled.materials, filled.surface, filled.geometry, len(filled.fields), source.groups))
    stream.geometry = filled.geometry
    stream.materials = [material_values(m, rule) for m, rule in zip(filled.materials, shading.rules, strict=True)]
    stream.sharp_edges, stream.coded_normals = shading.sharp_edges, shading.coded_normals
    stream.fields = [field_values(i, part.support, part.threshold) for i, part in enumerate(filled.fields)]
    squares = [number for number, part in enumerate(filled.fields) if part.nearest]  # samplers, which the bitstream does not know
    metadata = scene.metadata | ({NEAREST_FIELDS: squares} if squares else {})
    stream.metadata = metadata_bytes(metadata, filled.price.limits, report)
    return stream


def _sha256(fields: list[SourceField], planes: list[dict[str, np.ndarray]]) -> str:
    """Hash over keys and decoded values, field by field and channel by channel."""
    total = hashlib.sha256()
    for part, by_name in zip(fields, planes, strict=True):
        for plane in by_name.values():
            total.update(np.ascontiguousarray(part.support.keys, "<i8").data)
            total.update(np.ascontiguousarray(plane).data)
    return total.hexdigest()


def _collapsed(scene: Scene, surface: Surface) -> tuple[list[str], list[str]]:
    """Return (remarks, warnings) on faces of the scene that fall together on the lattice; the loader reports those that name a
    vertex twice. A part that loses many faces is a warning, because a picture may show it."""
    a, b, c = scene.faces.T
    left = (a != b) & (b != c) & (c != a)
    left[surface.origin_face] = False
    count, parts = int(left.sum()), len(scene.materials)
    if not count:
        return [], []
    lost, whole = (np.bincount(scene.face_material[rows], minlength=parts) for rows in (left, slice(None)))
    worst = int(np.argmax(np.where(lost >= MANY_FACES, lost / np.maximum(whole, 1), 0.0)))
    bits = surface.cube.position_bits
    if lost[worst] >= max(MANY_FACES, LARGE_SHARE * whole[worst]):
        name = scene.materials[worst].name or str(worst)
        return [], [f"part '{name}' loses {lost[worst]} of its {whole[worst]} faces, without area at {bits} position bits"]
    share = 100 * count / len(scene.faces)
    return [plural(count, "face is", "faces are") + f" left out ({share:.2g} % of {len(scene.faces)}), without area at "
            f"{bits} position bits; more --position-bits may keep such faces"], []
