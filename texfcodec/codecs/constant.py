"""A plane with a single value takes a few bytes and no time (codec_id 2, spec clause 5.7.6)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..core.syntax_table import Element, Structure
from .base import PlaneCodec

if TYPE_CHECKING:
    from ..field.texels import TexelSupport
    from ..field.voxels import VoxelSupport

CONSTANT = Structure("constant_parameters", "5.7.6", (Element("plane_value", "u8", count="NumComponents"),))
PROBE = 64  # values looked at before all of them are


class Constant(PlaneCodec):
    """One value for every voxel. The encoder selects it if all rounded values are equal."""

    id, name = 2, "constant"
    structures = (CONSTANT,)
    chosen = False

    def suits(self, plane: np.ndarray) -> bool:
        """See PlaneCodec.suits."""
        return all(bool((np.rint(part) == np.rint(plane[:1])).all()) for part in (plane[:: max(1, len(plane) // PROBE)], plane))

    def enc(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, options: object) -> tuple[dict, np.ndarray]:
        """See PlaneCodec.enc; the plane has to suit."""
        value = np.clip(np.rint(plane[0]), 0, 255).astype(np.uint8)
        return {"plane_value": value.tolist()}, np.tile(value, (len(plane), 1))

    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """See PlaneCodec.dec."""
        return np.tile(np.array(values["plane_value"], np.uint8), (len(support.coarser(levels)), 1))

    def describe(self, values: dict) -> dict:
        """The value."""
        return {"value": values["plane_value"]}

    def info_lines(self, group: dict) -> Iterator[str]:
        """See Codec.info_lines."""
        yield (f"field {group['field_index']}, group {group['group_index']} ({group['semantic']}): {group['bytes']} bytes, "
               f"constant {group['value']}")
