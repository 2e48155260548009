"""The results of the stages of an encode, in order: Prepared, Supported, Meshed, Shaded, Placed, Filled (encoder only).

encode.py calls the stages. Each result is frozen and holds the result that it was made from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ..scene.channels import COLOURS

if TYPE_CHECKING:
    import numpy as np

    from ..codecs.base import Source
    from ..scene.scene import Material, Scene
    from .decision import Decision
    from .faces import SentSurface, SourceSurface
    from .mesh.candidates import SentMesh
    from .place.part_fields import PartFields
    from .price import Lagrangian
    from .shading.normal_rules import Shading
    from .supports.choice import Supports
    from .supports.texel_plan import SentPlan
    from .values.source_field import SourceField
    from .values.stage import FillRequest


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """The scene as it has to be coded. scene: with the materials that are needed, and measured weights; materials: as the stream
    holds them; surface: on the reference lattice; colours: float32 [materials, 4], the single colour that each material shows,
    NaN if it varies (material_colours())."""

    scene: Scene
    materials: list[Material]
    surface: SourceSurface
    colours: np.ndarray
    evidence: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Supported:
    """Candidate supports, the first of least cost on the source's mesh. price: at the requested quality."""

    prepared: Prepared
    price: Lagrangian
    candidates: tuple[Decision[Supports], ...]


@dataclass(frozen=True, kw_only=True)
class Meshed:
    """The chosen supports, with their mesh. plans: of supports, on the sent mesh; price: at their K; usual: the source on the
    lattice of the chosen position bits; shown: the scene without detail that no voxel shows; partition: face fields on usual;
    mesh: the sent one; evidence: of supports, partition and mesh."""

    prepared: Prepared
    supports: Supports
    plans: list[SentPlan]
    price: Lagrangian
    usual: SourceSurface
    shown: Scene
    partition: Decision[PartFields]
    mesh: Decision[SentMesh]
    evidence: dict[str, Any]

    @property
    def gain(self) -> float:
        """Bytes that the mesh saves, less the extra bytes of the supports above the best."""
        return self.mesh.value.saved - self.supports.extra_bytes


@dataclass(frozen=True, kw_only=True)
class Shaded:
    """The shading of a mesh. plans: TexelPlans, whose normal maps suit the decoder's frames."""

    meshed: Meshed
    shading: Shading
    plans: list[SentPlan]
    evidence: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Placed:
    """The places of values. geometry: syntax values of the geometry units; source: the coded channels and fields, on the sent
    mesh; fields: SourceFields without colours over voxels, with them over texels; names: channels that each field over voxels has
    maps of."""

    shaded: Shaded
    geometry: list[dict]
    source: Source
    fields: list[SourceField]
    names: list[set[str]]


@dataclass(frozen=True, kw_only=True)
class Filled:
    """Everything that the stream holds but coded values; it does not depend on the QP except through the choice of supports.

    request: of the values; price: at the coded quality, at the chosen K; surface: the sent mesh; geometry, source: as of Placed;
    fields: SourceFields with values, without them if the codec reads the source itself; materials: as the stream holds them;
    resolution: K, None if no field is over voxels; evidence: of every choice by its name.
    """

    request: FillRequest
    price: Lagrangian
    surface: SentSurface
    geometry: list[dict]
    source: Source
    fields: list[SourceField]
    materials: list[Material]
    shading: Shading
    resolution: int | None
    evidence: dict[str, Any]

    @property
    def is_uniform(self) -> bool:
        """True if the only value is a single colour, so that the QP does not change the stream."""
        return all(part.is_uniform for part in self.fields) and all(group.channels[0] in COLOURS for group in self.source.groups)

    @property
    def qp(self) -> int | None:
        """QP of the values; None if an error bound sets it, or the codec has none."""
        return self.request.qp if self.price.coder is None else self.price.coder.qp

    def with_qp(self, qp: int) -> Filled:
        """Return a Filled that codes the same values at another QP. Supports, mesh and uncoded values stay."""
        return replace(self, price=replace(self.price, coder=self.price.planes.at(qp=qp)))

    def between(self, qp: float) -> Filled:
        """Return a Filled that codes the same values at a QP that need not be whole. A codec with whole QPs only takes the next
        finer one. The price of a byte is that of the rounded QP."""
        return replace(self, price=replace(self.price, qp=round(qp), coder=self.price.planes.between(qp)))
