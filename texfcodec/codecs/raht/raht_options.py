"""Settings of the codec of planes (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RahtOptions:
    """Settings of an encode; each as of EncodeOptions, but for these: qp_fraction: 0 to less than 1, of a QP, by which coding is
    coarser than at qp; is_rough: whether it is for an estimate, for which tools are hardly tried."""

    qp: int | None
    max_error: int | None
    chroma_qp_offset: int | None
    effort: str
    threads: int
    qp_fraction: float = 0.0
    is_rough: bool = False
