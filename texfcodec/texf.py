"""The decoded asset: a mesh and the fields that colour it, over voxels or over the texels of its UVs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from .codecs.base import Evaluator, Group, JointCodec, split_groups
from .errors import InputError, LossWarning
from .field.on_face import texel_positions
from .field.texels import TexelSupport
from .field.voxels import VoxelSupport
from .geometry.canonical import CanonicalCube
from .report import plural
from .scene.channels import ALPHA, COLOURS, COLUMNS, FULL, Channel, join_planes
from .scene.scene import Material

if TYPE_CHECKING:
    from .geometry.corner_groups import CornerGroups
    from .io.atlas.bake import Baked
    from .io.atlas.unwrap import Atlas


@dataclass(repr=False)
class Field:
    """The decoded values of one field: a plane of values for each channel, in the cells (voxels or texels) of one support.

    Attributes
    ----------
    support : VoxelSupport or TexelSupport
        Cells that the values belong to.
    planes : dict of uint8 [N, C]
        By channel name. Colour is sRGB-coded, alpha is straight, and a map's values exclude the factor of its material.
    shifts : dict of int
        By channel name: number of levels by which a plane is coarser than the support; 0 for base colour and alpha.
    steps : dict of float
        By channel name, if the stream has it: the quantiser's step in levels of 255; 0 for exact values.
    """

    support: VoxelSupport | TexelSupport
    planes: dict[str, np.ndarray]
    shifts: dict[str, int] = field(default_factory=dict)
    steps: dict[str, float] = field(default_factory=dict)
    _pyramids: dict = field(default_factory=dict)  # coarser levels, once render/levels.py was asked for them

    @property
    def level_shift(self) -> int:
        """Number of omitted levels: a voxel or texel of this field is 2**level_shift full ones wide."""
        return self.support.level_shift

    @property
    def keys(self) -> np.ndarray:
        """int64 [N], ascending Morton keys."""
        return self.support.keys

    @property
    def over_texels(self) -> bool:
        """True if the values are over texels."""
        return self.support.planar

    def __repr__(self):
        return f"<Field over {self.support!r}, {' + '.join(self.planes)}>"

    def support_of(self, name: str) -> VoxelSupport | TexelSupport:
        """Return the cells that a channel's plane has values for, which may be coarser than the field's.

        Parameters
        ----------
        name : str
            Name of a channel.

        Returns
        -------
        VoxelSupport or TexelSupport
            Parallel to planes[name].
        """
        shift = self.shifts.get(name, 0)
        return self._coarser.setdefault(shift, self.support.coarser(shift)) if shift else self.support

    def joined(self, names: tuple[str, ...]) -> np.ndarray:
        """Return the planes of some channels side by side, so that one query answers for all: uint8 or float32 [N, C]."""
        if len(names) == 1:
            return self.planes[names[0]]
        if names not in self._joined:
            self._joined[names] = np.concatenate([self.planes[name] for name in names], axis=1)
        return self._joined[names]

    @cached_property
    def _joined(self) -> dict:
        return {}

    @cached_property
    def _coarser(self) -> dict:
        return {}

    @cached_property
    def rgba(self) -> np.ndarray:
        """uint8 [N, 4]: base colour and alpha for viewers; 255 for an absent channel."""
        return join_planes(self.planes, len(self.support))


@dataclass(kw_only=True, repr=False)
class Texf:
    """The decoded asset, as decode() returns it. Arrays over all units are concatenated at first access and cached;
    dataclasses.replace() makes a Texf of other units.

    Attributes
    ----------
    cube : CanonicalCube
        Maps lattice coordinates to world space.
    units : list of GeometryUnit
        One for each field and material.
    fields : list of Field
        Values, base colour included.
    materials : list of Material
        All else about the appearance of faces.
    metadata : dict
        Free-form JSON from the stream.
    groups : tuple of Group
        The coded channel groups.
    threads : int
        Threads for queries.
    codec, evaluators : JointCodec and list of Evaluator, optional
        Answer queries in place of the voxels, one evaluator for each field; None if each channel group has its own unit.
    skipped : list of dict
        Unknown ancillary units.
    sharp_edges : bool [E], optional
        Marks of edges (spec 8.4.2); None without marks.
    coded_normals : int16 [G, 3], optional
        Normals of the corner groups that have a coded one (spec 8.4.4).
    """

    cube: CanonicalCube
    units: list
    fields: list[Field]
    materials: list[Material]
    metadata: dict = field(default_factory=dict)
    groups: tuple[Group, ...] = ()
    threads: int = 1
    codec: JointCodec | None = None
    evaluators: list[Evaluator] | None = None
    skipped: list = field(default_factory=list)
    sharp_edges: np.ndarray | None = None
    coded_normals: np.ndarray | None = None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The coded channels."""
        return tuple(channel for group in self.groups for channel in group.channels)

    @property
    def has_alpha(self) -> bool:
        """True if alpha was coded."""
        return ALPHA in self.channels

    @cached_property
    def origin(self) -> np.ndarray:
        return np.array(self.cube.origin)

    @property
    def side(self) -> float:
        return self.cube.side

    @property
    def position_bits(self) -> int:
        return self.cube.position_bits

    @property
    def resolution(self) -> int:
        """Largest grid resolution of the fields over voxels; 1 if there is none."""
        return max((f.support.size for f in self.fields if isinstance(f.support, VoxelSupport)), default=1)

    @cached_property
    def lattice_positions(self) -> np.ndarray:
        """int64 [V, 3], concatenated in unit order."""
        return np.concatenate([np.zeros((0, 3), np.int64), *(u.lattice for u in self.units)])

    @cached_property
    def positions(self) -> np.ndarray:
        """float64 [V, 3] in world space."""
        return self.cube.to_world(self.lattice_positions)

    @cached_property
    def faces(self) -> np.ndarray:
        """int64 [F, 3] into positions, in unit order."""
        starts = np.cumsum([0] + [len(u.lattice) for u in self.units])
        parts = [u.faces + s for u, s in zip(self.units, starts[:-1], strict=True)]
        return np.concatenate([np.zeros((0, 3), np.int64), *parts])

    @cached_property
    def uv(self) -> np.ndarray:
        """float64 [V, 2], parallel to positions: UVs in texels of the field's full image; 0 if the field is over voxels."""
        parts = [np.zeros((len(u.lattice), 2)) if u.uv is None else u.uv / float(1 << self.fields[u.field].support.fraction_bits)
                 for u in self.units]
        return np.concatenate([np.zeros((0, 2)), *parts])

    @cached_property
    def face_material(self) -> np.ndarray:
        """int64 [F] into materials."""
        return np.concatenate([np.zeros(0, np.int64), *(np.full(len(u.faces), u.material) for u in self.units)])

    @cached_property
    def face_field(self) -> np.ndarray:
        """int64 [F] into fields."""
        return np.concatenate([np.zeros(0, np.int64), *(np.full(len(u.faces), u.field) for u in self.units)])

    def shading_normals(self) -> np.ndarray:
        """Normals of face corners by the rules of the materials (spec clause 8.4): float32 [F, 3, 3] of length 1."""
        from .geometry.shading_normals import corner_normals

        rules = [m.normals for m in self.materials]
        coded = None if self.coded_normals is None else (self.corner_groups(), self.coded_normals)
        return corner_normals(self.lattice_positions, self.faces, rules, self.face_material, self.sharp_edges, coded)

    def corner_groups(self) -> CornerGroups:
        """Groups of corners that share a coded normal (spec clause 8.4.3). It reads sharp_edges."""
        from .geometry.corner_groups import corner_groups

        sharp = np.zeros(0, bool) if self.sharp_edges is None else self.sharp_edges
        return corner_groups(self.lattice_positions, self.faces, [m.normals for m in self.materials], self.face_material, sharp)

    def query(self, points: np.ndarray, face_index: np.ndarray | None = None) -> np.ndarray:
        """Return the base colour and alpha of the asset at surface points.

        Parameters
        ----------
        points : float64 [M, 3]
            In world space.
        face_index : int64 [M], optional
            Face that each point lies on; None for the nearest.

        Returns
        -------
        float32 [M, 4]
            RGBA in 0..255, colour sRGB-coded, straight alpha.

        Raises
        ------
        InputError
            TXF-I70 for an empty asset, TXF-I71 for points that are not finite, TXF-I72 for arrays of other shapes.

        Notes
        -----
        Spec clause 8.2; where an evaluator answers, its own clause, exact to the bit.
        """
        points = _points(points)
        if len(points) == 0:
            return np.zeros((0, COLUMNS), np.float32)
        if not self.fields:
            raise InputError("TXF-I70", "an empty asset has no colour to query")
        if face_index is not None:
            face_index = _faces(face_index, len(points), len(self.faces))
        elif len(self.fields) > 1 or self.fields[0].over_texels:
            face_index = self.nearest_face(points)
        which = np.zeros(len(points), np.int64) if face_index is None else self.face_field[face_index]
        return self.query_by_field(points, which, face_index)

    def query_by_field(self, points: np.ndarray, which: np.ndarray, face_index: np.ndarray | None = None) -> np.ndarray:
        """Return the base colour and alpha at surface points, each from the field that the caller names.

        Parameters
        ----------
        points : float64 [M, 3]
            In world space.
        which : int64 [M]
            Number of the field that answers for each point.
        face_index : int64 [M], optional
            Face of each point. Fields over texels need it: a point is projected to the nearest position on its face.

        Returns
        -------
        float32 [M, 4]
            As query().
        """
        out = np.zeros((len(points), COLUMNS), np.float32)
        for i, part in enumerate(self.fields):
            chosen = np.flatnonzero(which == i) if len(self.fields) > 1 else ...
            if chosen is not ... and not len(chosen):
                continue
            if isinstance(part.support, TexelSupport):
                assert face_index is not None  # the caller's part
                out[chosen] = part.support.query(self._texels(points[chosen], face_index[chosen]), part.rgba, self.threads)
            else:
                out[chosen] = self.query_field(i, points[chosen])
        return out

    def _texels(self, points, face_index):
        """UVs in texels, float64 [M, 2], of world points on faces. The projection runs in lattice units, which have the same
        magnitude for every asset. If side is 0, every point is at lattice position 0 (8.2.2)."""
        lattice = (points - self.origin) / self.side * self.cube.last if self.side else np.zeros(points.shape)
        return texel_positions(lattice, self.lattice_positions.astype(np.float64), self.faces, self.uv, face_index)

    def query_field(self, number: int, points: np.ndarray) -> np.ndarray:
        """Return the base colour and alpha of one field over voxels at world points.

        Parameters
        ----------
        number : int
            Index into fields.
        points : float64 [M, 3]
            In world space.

        Returns
        -------
        float32 [M, 4]
            As query().
        """
        if self.evaluators:
            answers = split_groups(self.evaluators[number].query(self.cube, points, self.threads), self.groups)
            out = np.full((len(points), COLUMNS), FULL, np.float32)
            for channel in COLOURS:
                if channel.name in answers:
                    out[:, list(channel.columns)] = answers[channel.name]
            return out
        part = self.fields[number]
        assert isinstance(part.support, VoxelSupport)
        return part.support.query(self.cube, points, part.rgba, self.threads)

    def query_planes(self, number: int, names: Sequence[str], points: np.ndarray, face_index: np.ndarray) -> dict:
        """Return the values of some channels of one field at surface points.

        Parameters
        ----------
        number : int
            Index into fields.
        names : sequence of str
            Channels that the field has, by their names in scene.channels.
        points : float64 [M, 3]
            In world space.
        face_index : int64 [M]
            Face that each point lies on.

        Returns
        -------
        dict of float32 [M, C]
            By name, in 0..255; values of maps exclude the factors of materials.
        """
        part = self.fields[number]
        if self.evaluators:
            answers = split_groups(self.evaluators[number].query(self.cube, points, self.threads), self.groups)
            return {name: answers[name] for name in names}
        texel = self._texels(points, face_index) if part.over_texels else None
        if part.over_texels or any(part.shifts.get(name, 0) for name in names):
            return {name: self._ask(part.support_of(name), part.planes[name], points, texel) for name in names}
        values = self._ask(part.support, part.joined(tuple(names)), points, None)
        ends = np.cumsum([part.planes[name].shape[1] for name in names])
        return dict(zip(names, map(np.ascontiguousarray, np.split(values, ends[:-1], axis=1)), strict=True))

    def _ask(self, support, values, points, texel):
        if texel is not None:
            return support.query(texel, values, self.threads)
        return support.query(self.cube, points, values, self.threads)

    def nearest_face(self, points: np.ndarray) -> np.ndarray:
        """Return the index of the face nearest to each point.

        Parameters
        ----------
        points : float64 [M, 3]
            In world space.

        Returns
        -------
        int64 [M]
            Index into faces.

        Raises
        ------
        InputError
            TXF-I70 for an empty asset.
        """
        from .geometry.mesh import Mesh
        from .geometry.nearest_points import NearestPoints

        if not len(self.faces):
            raise InputError("TXF-I70", "an empty asset has no face to query")
        return NearestPoints(Mesh(self.positions, self.faces)).find(points, threads=self.threads).face

    def voxels(self, *, centers: bool = True) -> dict[str, np.ndarray]:
        """All active voxels of the fields over voxels: {"xyz": int32 [N, 3], "field": int32 [N], "rgba": uint8 [N, 4]}, and with
        centers {"center": float64 [N, 3] in world space}."""
        fields = [(i, f) for i, f in enumerate(self.fields) if not f.over_texels]
        xyz = [f.support.xyz() for f in self.fields if isinstance(f.support, VoxelSupport)]
        number = [np.full(len(v), i, np.int32) for (i, _), v in zip(fields, xyz, strict=True)]
        held = {
            "xyz": np.concatenate([np.zeros((0, 3), np.int32), *xyz]),
            "field": np.concatenate([np.zeros(0, np.int32), *number]),
            "rgba": np.concatenate([np.zeros((0, COLUMNS), np.uint8), *(f.rgba for _, f in fields)]),
        }
        if centers:
            held["center"] = np.concatenate([np.zeros((0, 3)), *(self._centers(f, v)
                                                                 for (_, f), v in zip(fields, xyz, strict=True))])
        return held

    def _centers(self, part, xyz):
        grid = (xyz + 0.5) * (1 << part.level_shift)
        return self.cube.to_world(grid * ((1 << self.position_bits) / part.support.resolution))

    def bake(self, texture_size: int | None = None, atlas: str | Atlas = "auto") -> Baked:
        """Bakes the fields over voxels into a texture atlas.

        Parameters
        ----------
        texture_size : int, optional
            Side of the atlas in texels; None derives it from the field.
        atlas : "auto", "quality", "fast" or Atlas
            Layout of the atlas; "quality" may take minutes.

        Returns
        -------
        Baked
            Image and UVs; see io.atlas.bake.

        Raises
        ------
        InputError
            TXF-O10 to TXF-O12.
        """
        from .io.atlas.bake import bake

        return bake(self, texture_size, atlas)

    def save(self, path: str | PathLike[str] | BinaryIO, *, format: str | None = None, **options: Any) -> dict:
        """Writes a mesh file for viewers.

        Parameters
        ----------
        path : str, PathLike or file object
            The suffix selects the format: .glb, .gltf, .obj, .ply or .npz. A file object, open for writing bytes, takes the
            single-file formats: glb, ply, npz, and obj without textures.
        format : str, optional
            Format of a file object without a suffix in its name, "glb" for example. For a path it must agree with the suffix.
        **options
            appearance ("texture", "vertex" or "voxels"), texture_size, atlas, texture_format, texture_quality, compress,
            overwrite, inputs, and stream, the bytes of a stream to embed in a GLB: see io.save.save().

        Returns
        -------
        dict
            {"warnings": sentences, "dropped": properties that the format cannot hold, "remarks": sentences on changes that no
            picture shows, "files": written file names, "seams": jumps of colour across atlas seams, or None, "carried": bytes of
            the stream and of all else, or None}.

        Raises
        ------
        InputError
            TXF-O01 to TXF-O18: the path, the format or an option. No partial file remains.
        SupportError
            TXF-O15: the texture format or compression needs a package.

        Warns
        -----
        LossWarning
            Once for every warning.
        """
        from .io.save import save, save_into

        if not isinstance(path, str | PathLike):
            report = save_into(self, path, format, **options)
        elif format and Path(path).suffix.lower() != "." + format.lower().removeprefix("."):
            raise InputError("TXF-O05", "the format differs from the suffix of the path", value=format, path=str(path))
        else:
            report = save(self, path, **options)
        for text in report["warnings"]:
            warnings.warn(text, LossWarning, stacklevel=2)
        return report

    def __repr__(self):
        sizes = plural(len(self.faces), "face", "faces") + ", " + plural(len(self.fields), "field", "fields")
        return (f"<Texf: {sizes}, {self.counted()}, "
                f"{' + '.join(c.name for c in self.channels)}>")

    def counted(self) -> str:
        """Counts of voxels and texels in words."""
        texels = sum(len(f.support) for f in self.fields if f.over_texels)
        voxels = sum(len(f.support) for f in self.fields) - texels
        parts = [plural(voxels, "voxel", "voxels") + f" at K {self.resolution}"] * (voxels > 0 or not texels)
        return " and ".join(parts + [plural(texels, "texel", "texels")] * (texels > 0))

    def _repr_png_(self):
        """A small picture for notebooks, PNG bytes; None for an empty asset."""
        from .render.thumbnail import thumbnail

        return thumbnail(self) if self.fields else None


def _points(points):
    try:
        points = np.asarray(points, np.float64)
        if points.size % 3 or (points.ndim != 1 and points.shape[-1] != 3):
            raise ValueError(f"shape {list(points.shape)}")
    except (TypeError, ValueError) as error:
        raise InputError("TXF-I72", "query points are not numbers [M, 3]", reason=str(error)[:200]) from None
    points = points.reshape(-1, 3)
    if not np.isfinite(points).all():
        raise InputError("TXF-I71", "query points are not finite", value=int((~np.isfinite(points).all(axis=1)).sum()))
    return points


def _faces(face_index, count, faces):
    index = np.asarray(face_index)
    if index.shape != (count,) or index.dtype.kind not in "iu":
        raise InputError("TXF-I72", "face_index must have an integer for each point", value=list(index.shape), allowed=[count])
    if index.size and (index.min() < 0 or index.max() >= faces):
        raise InputError("TXF-I72", "face_index refers to a face that does not exist", value=[int(index.min()), int(index.max())],
                         allowed=f"0..{faces - 1}")
    return index.astype(np.int64)
