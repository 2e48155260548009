"""Mesh to stream, on one page: the stages of an encode, one after the other (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..options import EncodeOptions
from ..report import Report
from .caches import Caches
from .mesh.stage import mesh
from .place.stage import place
from .prepare.stage import prepare
from .requests import Requests
from .shading.stage import shade
from .supports.stage import support
from .values.stage import fill
from .write import Encoded, write

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .stages import Filled, Supported
    from .supports.choice import SupportRequest


@dataclass(frozen=True, kw_only=True)
class _SupportedKey:
    """Everything beside the scene that candidate supports depend on."""

    request: SupportRequest
    coder: tuple | None
    qp: int
    resolution: int


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """The stages of encodes of one scene.

    Parameters
    ----------
    scene : Scene
        Source of all encodes.
    caches : Caches, optional
        Results that several encodes share; by default meshes only.
    """

    scene: Scene
    caches: Caches = field(default_factory=Caches)

    def supported(self, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset()) -> Supported:
        """Run the first two stages, prepare and supports, and return their result.

        Parameters
        ----------
        options : EncodeOptions
            The request.
        report : Report
            Receives seconds by stage, warnings and losses.
        finer : frozenset of int, optional
            Materials whose parts were too coarse in an earlier encode.

        Returns
        -------
        Supported
            Candidate supports.

        Raises
        ------
        InputError, LimitError
            The mesh or an option is at fault; the mesh is over a limit.
        """
        return self._supported(Requests.of(options, finer), report)

    def _supported(self, requests: Requests, report: Report) -> Supported:
        """Return the results of the first two stages."""
        prepared = self.caches.prepared.get(requests.prepare, lambda: prepare(self.scene, requests.prepare, report))
        request, price = requests.support, requests.price
        coder = None if price.coder is None else price.coder.signature
        key = _SupportedKey(request=request, coder=coder, qp=price.qp, resolution=price.resolution)
        return self.caches.supported.get(key, lambda: support(prepared, request, price, self.caches, report))

    def filled(self, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset(),
               budget: int | None = None) -> Filled:
        """Run all six stages and return the last result, in which no value is coded yet.

        Parameters
        ----------
        options, report, finer
            As of supported().
        budget : int, optional
            Bytes that the stream may have.

        Returns
        -------
        Filled
            All that the stream holds but coded values.

        Raises
        ------
        InputError, LimitError, SupportError
            As of encode().
        OverBudget
            The geometry alone takes the budget.
        """
        requests = Requests.of(options, finer)
        supported = self._supported(requests, report)
        meshed = mesh(supported, requests.mesh, self.caches, report)
        shaded = shade(meshed, budget, self.caches.frames, report)
        placed = place(shaded, budget, report)
        return fill(placed, requests.fill, self.caches.fields, report)

    def encode(self, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset()) -> Encoded:
        """Run all stages and write the stream.

        Parameters
        ----------
        options, report, finer
            As of supported().

        Returns
        -------
        Encoded
            The stream and its report.

        Raises
        ------
        InputError, LimitError, SupportError
            The mesh or an option is at fault; the mesh is over a limit; something that it needs is not installed.
        """
        return write(self.filled(options, report, finer), report, self.caches.units)


def encode_scene(scene: Scene, options: EncodeOptions | None = None, report: Report | None = None) -> Encoded:
    """Encode a scene once, with the given options: without a search for a target and without the check of the stream.

    Parameters
    ----------
    scene : Scene
        The source.
    options : EncodeOptions, optional
        Rate and all other settings.
    report : Report, optional
        Receives seconds by stage, warnings and losses.

    Returns
    -------
    Encoded
        The stream and its report.

    Raises
    ------
    InputError, LimitError, SupportError
        As of Encoder.encode().
    """
    return Encoder(scene=scene).encode(options or EncodeOptions(), report or Report())
