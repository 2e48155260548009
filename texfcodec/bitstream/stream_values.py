"""The values of all units of a stream in one plain structure (spec clause 5)."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..codecs import codec_of_unit


@dataclass
class Stream:
    """The content of a stream, as values by syntax element name: header, materials, one dict per field, geometry unit and
    attribute unit; metadata, sharp_edges and coded_normals or None. skipped: unknown ancillary units; vertices, faces: totals
    over all geometry units so far."""

    header: dict
    materials: list = field(default_factory=list)
    fields: list = field(default_factory=list)
    geometry: list = field(default_factory=list)
    attributes: list = field(default_factory=list)
    metadata: bytes | None = None
    skipped: list = field(default_factory=list)
    sharp_edges: dict | None = None
    coded_normals: dict | None = None
    vertices: int = 0
    faces: int = 0

    @property
    def joint(self) -> dict | None:
        """Values of the attribute unit that holds all fields and channel groups together (5.7); None if there is none."""
        return next((a for a in self.attributes if codec_of_unit(a).joint), None)
