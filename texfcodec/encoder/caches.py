"""Caches that encodes of one scene share: a cache for each stage, and for parts of a stage that take long (encoder only).

A search over the QP and the second try of the check encode one scene several times. A result that depends neither on the QP nor
on finer parts is computed once.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import TypeVar, cast

Result = TypeVar("Result")


class Cache:
    """Results by key. A key is a named tuple or a frozen dataclass with everything beside the scene that a result depends on."""

    def __init__(self) -> None:
        self._results: dict[Hashable, object] = {}

    def get(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Return the result of a key; if it is not there, call make() and keep its result."""
        if key not in self._results:
            self._results[key] = make()
        return cast(Result, self._results[key])


class NoCache(Cache):
    """A cache that keeps nothing."""

    def get(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """Call make() and return its result, which is not kept."""
        return make()


@dataclass(frozen=True, kw_only=True)
class Caches:
    """One cache for each stage, and for the parts of stages that several encodes share.

    prepared, supported: whole stages, by their requests; images: trial codings of an image, by quality; regions: sample regions,
    which are large; meshes: lattices, simplified meshes and their pictures; frames: fitted normal maps; fields: transferred and
    fitted values; units: coded values.
    """

    prepared: Cache = field(default_factory=NoCache)
    supported: Cache = field(default_factory=NoCache)
    images: Cache = field(default_factory=NoCache)
    regions: Cache = field(default_factory=NoCache)
    meshes: Cache = field(default_factory=Cache)  # two supports of one encode share it
    frames: Cache = field(default_factory=NoCache)
    fields: Cache = field(default_factory=NoCache)
    units: Cache = field(default_factory=NoCache)

    @classmethod
    def of_search(cls) -> Caches:
        """Return caches for encodes at different QPs: they keep no units and no frames, which would never be used again."""
        return cls(prepared=Cache(), supported=Cache(), images=Cache(), regions=Cache(), fields=Cache())

    @classmethod
    def of_second_try(cls) -> Caches:
        """Return caches for two encodes, the second of which is finer in some parts: they keep no regions, which are large and
        hardly used again."""
        return cls(prepared=Cache(), supported=Cache(), images=Cache(), frames=Cache(), fields=Cache(), units=Cache())
