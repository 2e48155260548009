"""Settings of the codec of planes (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RahtOptions:
    """Settings of an encode, as in EncodeOptions. In addition, qp_fraction: 0 to less than 1, the fraction of a QP by which
    coding is coarser than at qp; is_rough: the encode is only for an estimate, so hardly any tools are tried."""

    qp: int | None
    max_error: int | None
    chroma_qp_offset: int | None
    effort: str
    threads: int
    qp_fraction: float = 0.0
    is_rough: bool = False
