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
        """Return whether all rows of a plane are equal once rounded. plane: float32 [N, C]."""
        return all(bool((np.rint(part) == np.rint(plane[:1])).all()) for part in (plane[:: max(1, len(plane) // PROBE)], plane))

    def enc(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, options: object) -> tuple[dict, np.ndarray]:
        """Code a plane for which suits() is true: (the syntax value plane_value, decoded values uint8 [N, C])."""
        value = np.clip(np.rint(plane[0]), 0, 255).astype(np.uint8)
        return {"plane_value": value.tolist()}, np.tile(value, (len(plane), 1))

    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """Return the unit's value for every cell of support.coarser(levels), uint8 [n, C]."""
        return np.tile(np.array(values["plane_value"], np.uint8), (len(support.coarser(levels)), 1))

    def describe(self, values: dict) -> dict:
        """Return {"value": the components of the unit's value}, for inspect()."""
        return {"value": values["plane_value"]}

    def info_lines(self, group: dict) -> Iterator[str]:
        """Yield the line of texf-info: field, channel group, bytes and the value. group: an entry of inspect()'s groups."""
        yield (f"field {group['field_index']}, group {group['group_index']} ({group['semantic']}): {group['bytes']} bytes, "
               f"constant {group['value']}")
