"""Requests of the stages: each holds the options that its stage reads. No stage knows EncodeOptions itself (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeVar

from ..codecs import codec_of
from ..codecs.base import PlaneCodec
from .mesh.choice import MeshRequest
from .prepare.channel_weights import SIZES
from .prepare.stage import PrepareRequest
from .price import Lagrangian
from .supports.choice import SupportRequest
from .values.coder import Coder
from .values.stage import FillRequest

if TYPE_CHECKING:
    from ..options import EncodeOptions

Request = TypeVar("Request", PrepareRequest, SupportRequest, MeshRequest, FillRequest)


@dataclass(frozen=True, kw_only=True)
class Requests:
    """One request for each stage that depends on options, and the prices at their quality."""

    prepare: PrepareRequest
    support: SupportRequest
    price: Lagrangian
    mesh: MeshRequest
    fill: FillRequest

    @classmethod
    def of(cls, options: EncodeOptions, finer: frozenset[int] = frozenset()) -> Requests:
        """Return the requests of all stages for an encode with these options. finer: materials whose parts were too coarse in an
        earlier encode."""
        codec = codec_of(options.codec)
        settings = codec.settings(options)
        assert options.resolution is not None  # its __post_init__ fills it in
        price = Lagrangian(coder=Coder(codec, settings) if isinstance(codec, PlaneCodec) else None, qp=options.reckoned_qp,
                           max_error=options.max_error, resolution=options.resolution, effort=options.effort,
                           is_free=options.rate_is_free, is_fitted=options.may_fit, area_threshold=options.area_threshold,
                           threads=options.threads, limits=options.limits)
        return cls(prepare=_request(PrepareRequest, options, weight_size=SIZES[options.effort]),
                   support=_request(SupportRequest, options, is_joint=codec.joint, finer=finer),
                   price=price, mesh=_request(MeshRequest, options),
                   fill=_request(FillRequest, options, codec=codec, settings=settings))


def _request(kind: type[Request], options: EncodeOptions, **more: Any) -> Request:  # Any: by field
    """Return a request: options that have the names of its fields, and more."""
    return kind(**{field.name: getattr(options, field.name) for field in fields(kind) if field.name not in more}, **more)
