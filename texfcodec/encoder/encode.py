"""Mesh to stream, on one page: the stages of an encode, one after the other (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..options import EncodeOptions
from ..report import Report
from .caches import Caches
from .mesh.choice import MeshRequest
from .mesh.stage import mesh
from .place.stage import place
from .prepare.stage import PrepareRequest, prepare
from .price import Lagrangian
from .shading.stage import shade
from .supports.choice import SupportRequest
from .supports.stage import support
from .values.stage import fill
from .write import Encoded, write

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .stages import Filled, Prepared, Supported


@dataclass(frozen=True, kw_only=True)
class _SupportedKey:
    """What candidate supports depend on beside the scene."""

    request: SupportRequest
    coder: tuple | None
    qp: int
    resolution: int


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """The stages of encodes of one scene. caches: what these share; by default nothing but meshes."""

    scene: Scene
    caches: Caches = field(default_factory=Caches)

    def prepared(self, options: EncodeOptions, report: Report) -> Prepared:
        """The first stage."""
        request = PrepareRequest.of(options)
        return self.caches.prepared.get(request, lambda: prepare(self.scene, request, report))

    def supported(self, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset()) -> Supported:
        """The first two stages. finer: materials that came out too coarse before."""
        before, request, price = self.prepared(options, report), SupportRequest.of(options, finer), Lagrangian.of(options)
        coder = None if price.coder is None else price.coder.signature
        key = _SupportedKey(request=request, coder=coder, qp=price.qp, resolution=price.resolution)
        return self.caches.supported.get(key, lambda: support(before, request, price, self.caches, report))

    def filled(self, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset(),
               budget: int | None = None) -> Filled:
        """All stages. finer: materials that came out too coarse before; budget: bytes of the stream.

        Raises InputError, LimitError, SupportError as encode(); OverBudget if geometry alone takes the budget.
        """
        supported = self.supported(options, report, finer)
        meshed = mesh(supported, MeshRequest.of(options), self.caches, report)
        shaded = shade(meshed, budget, self.caches.frames, report)
        placed = place(shaded, budget, report)
        return fill(placed, options, self.caches.fields, report)

    def encode(self, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset()) -> Encoded:
        """All stages, and the stream. Arguments and exceptions as of filled()."""
        return write(self.filled(options, report, finer), report, self.caches.units)


def encode_scene(scene: Scene, options: EncodeOptions | None = None, report: Report | None = None) -> Encoded:
    """Code a Scene. Raises InputError, LimitError, SupportError."""
    return Encoder(scene=scene).encode(options or EncodeOptions(), report or Report())
