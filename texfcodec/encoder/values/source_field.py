"""From geometry and source to a field for coding: active voxels, their threshold and their colours (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from hashlib import sha256
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import LimitError
from ...field.texels import TexelSupport
from ...field.transfer import texels_per_edge, transfer
from ...field.voxelise import SAMPLES_PER_EDGE, count_samples
from ...field.voxels import VoxelSupport, kept_voxels
from ...scene.channels import COLOURS
from ...scene.fetch import pack_source

if TYPE_CHECKING:
    from ...codecs.base import Source
    from ...limits import Limits
    from ..price import Lagrangian

# Two samples per texel along a voxel edge, but no more than this many, by effort; 3 saves 1.2 % of the bits over 2, 4 saves 2 %,
# 6 saves 2.2 % (basketball player)
TRANSFER_DENSITY = {"fast": 2, "balanced": 4}
# Where a surface fit follows: 2 saves 0.3 to 1 s and 0.7 % of the player's bytes, but costs house_mask over voxels 11 to 13 % at
# equal PSNR; 4 gains nothing
FITTED_DENSITY = 3


@dataclass(frozen=True)
class SourceField:
    """A field before coding. support: its voxels or texels; threshold: area threshold of its voxels; planes: float32 [N, C] in
    0..255 by channel name, colour sRGB-coded; shifts: by channel name, levels by which a plane is coarser than the support;
    texels_per_edge: texels of the textures along the edge of a voxel; exact: whether the values are so few that exact coding pays
    at any rate; nearest: whether texels are shown as squares; is_uniform: whether all of its surface shows a single colour, which
    its planes hold; qp_offset: of its values, to the rate's QP."""

    support: VoxelSupport | TexelSupport
    threshold: int
    planes: dict = field(default_factory=dict)
    shifts: dict = field(default_factory=dict)
    texels_per_edge: float = 0.0
    exact: bool = False
    is_uniform: bool = False
    nearest: bool = False
    qp_offset: int = 0

    @property
    def keys(self) -> np.ndarray:
        """int64 [N], ascending Morton keys."""
        return self.support.keys

    def with_planes(self, planes: dict, shifts: dict | None = None) -> SourceField:
        """Return the field with further planes, float32 [N, C] by channel name, which replace those of the same channel. shifts:
        by channel name, levels by which new planes are coarser than the support, if they differ from the field's."""
        return replace(self, planes={**self.planes, **planes}, shifts={**self.shifts, **(shifts or {})})


class FieldKey(NamedTuple):
    """Everything beside the scene that values of a field over voxels depend on, at any QP. step: name of the step that computes
    them; number: of the field; faces: digest of the sent surface and its fields; keys: digest of the voxels; resolution: K of
    all fields, by which textures were filtered."""

    step: str
    number: int
    faces: bytes
    keys: bytes
    resolution: int


def field_keys(step: str, source: Source, fields: list[SourceField], resolution: int) -> list[FieldKey]:
    """Return cache keys, by field over voxels, of the results of a step of filling them. step: its name; resolution: K of
    all."""
    faces = sha256(source.surface.digest + source.face_field.tobytes()).digest()
    return [FieldKey(step, number, faces, sha256(np.ascontiguousarray(part.keys).data).digest(), resolution)
            for number, part in enumerate(fields)]


def colour_planes(rgba: np.ndarray, source: Source) -> dict:
    """Split sampled colours into the planes of base colour and, if it is coded, alpha; return them by channel name. rgba:
    float32 [N, 4]."""
    coded = [channel for channel in source.channels if channel in COLOURS]
    return {channel.name: np.ascontiguousarray(rgba[:, list(channel.columns)]) for channel in coded}


def active_voxels(lattice: np.ndarray, faces: np.ndarray, position_bits: int, price: Lagrangian) -> SourceField:
    """Voxelise the decoded surface of a field at the K of price, and return the SourceField of its active voxels, without
    values. lattice: int64 [V, 3]; faces: int64 [F, 3]. Raises LimitError."""
    total, limits = count_samples(lattice, faces, position_bits, price.resolution), price.limits
    if limits.samples is not None and total > limits.samples:
        raise LimitError("TXF-L05", "the surface needs more samples than the limit allows", value=total, allowed=limits.samples)
    keys, threshold = kept_voxels((lattice, faces), position_bits, price.resolution, price.area_threshold, price.threads,
                                  limits.voxels)
    return SourceField(VoxelSupport(price.resolution, keys), threshold)


def check_voxels(fields: list[SourceField], limits: Limits) -> None:
    """Raise LimitError if SourceFields together have too many voxels."""
    voxels = sum(len(part.support) for part in fields)
    if limits.voxels is not None and voxels > limits.voxels:
        raise LimitError("TXF-L04", "the fields have more voxels than the limit allows", value=voxels, allowed=limits.voxels)


def transfer_density(per_edge: float, price: Lagrangian) -> int:
    """Return the number of samples that a transfer takes along the edge of a voxel. per_edge: number of texels there."""
    most = FITTED_DENSITY if price.is_fitted else TRANSFER_DENSITY[price.effort]
    return int(np.clip(np.ceil(2 * per_edge), SAMPLES_PER_EDGE, most))


def transferred(part: SourceField, source: Source, number: int, price: Lagrangian) -> SourceField:
    """Return a copy of a SourceField, number `number` of source, with colour and alpha transferred from the textures to its
    voxels."""
    surface, in_field = source.surface, source.face_field == number
    assert isinstance(part.support, VoxelSupport)
    bits, packed = surface.cube.position_bits, pack_source(source.scene, surface.origin_face[in_field])
    textured = (surface.lattice, surface.faces[in_field], packed, bits, part.support.resolution)
    per_edge = texels_per_edge(*textured)
    density = transfer_density(per_edge, price)
    rgba = np.column_stack(transfer(*textured, part.keys, part.support.brick_map, density, price.threads))
    return replace(part, texels_per_edge=per_edge).with_planes(colour_planes(rgba, source))


def uniform_field(part: SourceField, source: Source, colour: np.ndarray) -> SourceField:
    """Return a copy of a SourceField whose values are all a single colour, RGBA float32 [4]; nothing is sampled."""
    return replace(part, is_uniform=True).with_planes(colour_planes(np.tile(colour, (len(part.support), 1)), source))
