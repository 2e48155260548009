"""Maps and corners of a decoded Texf for render/lighting.py."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.tangents import corner_tangents
from ..scene.channels import BY_NAME, channel_over
from ..scene.factors import neutral_values
from .field_sampler import FieldSampler
from .tangent_frames import interpolate_corners

if TYPE_CHECKING:
    from ..texf import Texf
    from .camera import Camera


class FieldMaps:
    """Values of a Texf's fields for channels of its materials.

    Normal maps have the name of the field's channel: x and y in tangent space over texels, a deviation in object space over
    voxels. A channel that a field lacks has neutral values.
    """

    def __init__(self, texf: Texf) -> None:
        self.texf = texf
        self.positions, self.faces, self.face_field = texf.positions, texf.faces, texf.face_field

    @cached_property
    def corner_normal(self) -> np.ndarray:
        """Normals of face corners, float32 [F, 3, 3], by the rules of the materials."""
        return self.texf.shading_normals()

    @cached_property
    def corner_tangent(self) -> np.ndarray:
        """Tangents of corners, float32 [F, 3, 4], of the UVs of fields over texels; 0 over voxels."""
        out = np.zeros((len(self.faces), 3, 4), np.float32)
        planar = np.array([part.over_texels for part in self.texf.fields], bool)[self.face_field]
        if planar.any():
            faces = self.faces[planar]
            out[planar] = corner_tangents(self.positions, faces, self.texf.uv[faces], self.corner_normal[planar])
        return out

    def tangents(self, name: str, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """Return the tangents (x, y, z, sign of the bitangent) at points of faces, float32 [M, 4]; 0 where the field is over
        voxels. name: not used, because all maps of a field have the same UVs."""
        return interpolate_corners(self.corner_tangent, face, bary)

    def sampler(self, camera: Camera | None, deepest: float, wanted: Collection[str], filtering: bool) -> Callable:
        """Return the function (names, face, bary, depth) -> {channel of the fields: values float32 [M, C] in 0..255} of surface
        points. wanted: channels that names may hold; deepest: upper bound of depth, which is along the camera's forward;
        filtering: whether values are averaged over pixels, else camera may be None."""
        sampler = FieldSampler(self.texf, camera, deepest if filtering else None, self.positions, self.faces)
        if any(BY_NAME[name].unit == "degrees" for name in wanted):
            _ = self.corner_tangent
        ready = [[(names, sampler.of_field(number, names)) for names in self._together(number, wanted)]
                 for number in range(len(self.texf.fields))]
        return lambda names, *at: self._sampled(names, ready, at)

    def _together(self, number, wanted):
        """Planes of a field that hold some of the wanted channels: tuples of names, each with one support."""
        part = self.texf.fields[number]
        names = sorted(channel_over(name, part.over_texels).name for name in wanted)
        there = [name for name in names if name in part.planes]
        shifts = sorted({part.shifts.get(name, 0) for name in there})
        return [tuple(name for name in there if part.shifts.get(name, 0) == shift) for shift in shifts]

    def _sampled(self, names, ready, at):
        face = at[0]
        out = {name: _neutral(name, len(face)) for name in names if BY_NAME[name].unit != "degrees"}
        which = self.face_field[face] if len(ready) > 1 else None
        for number, groups in enumerate(ready):
            if which is not None and not (which == number).any():
                continue
            rows = slice(None) if which is None else np.flatnonzero(which == number)
            for together, sample in groups:
                if names.isdisjoint(BY_NAME[key].material_name for key in together):
                    continue
                values, column = sample(*(part[rows] for part in at)), 0
                for key in together:
                    width = BY_NAME[key].components
                    if key not in out:
                        out[key] = _neutral(key, len(face))
                    out[key][rows] = values[:, column : column + width]
                    column += width
        return out


def _neutral(name, count):
    return np.tile(np.array(neutral_values(name), np.float32), (count, 1))
