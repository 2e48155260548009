"""Settings of a fit of 3DNTC (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class NeuralOptions:
    """Settings of a fit, as in EncodeOptions."""

    point: str | None
    resident_bytes: int | None
    latent_index: str
    transport: bool
    steps: int
    seed: int
    checkpoint: str | None
    fit_engine: str
    refine: str
    refine_iterations: int
    area_threshold: int
    threads: int
