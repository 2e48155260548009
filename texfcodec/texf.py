"""The decoded asset: a mesh without UVs and the fields that colour it."""

from dataclasses import dataclass, field

import numpy as np

from .asset.scene import Material
from .errors import InputError
from .geometry.canonical import CanonicalCube
from .support.grid import BrickMap, build_brick_map
from .support.morton import decode_morton
from .support.query import query_field


@dataclass
class GeometryUnit:
    """lattice: int64 [V, 3]; faces: int64 [F, 3] into lattice."""

    field: int
    material: int
    lattice: np.ndarray
    faces: np.ndarray


@dataclass
class Field:
    """One voxel set with its attributes.

    resolution: K of the full field; level_shift: octree levels that were left out (a voxel here is 2**level_shift of the full
    ones a side); keys: int64 [N] ascending Morton keys; rgba: uint8 [N, 4], colour sRGB-coded, alpha straight.
    """

    resolution: int
    level_shift: int
    keys: np.ndarray
    rgba: np.ndarray
    _map: BrickMap | None = None
    _pyramid: object = None  # coarser levels, once render/levels.py was asked for them

    @property
    def size(self):
        """Voxels a side of the grid at hand."""
        return -(-self.resolution >> self.level_shift)

    @property
    def brick_map(self):
        if self._map is None:
            self._map = build_brick_map(self.keys)
        return self._map


@dataclass
class Texf:
    """What decode() returns. cube: the canonical cube; units, fields, materials: see their classes (materials keep alpha mode,
    cutoff, sidedness; their colour is in the fields); metadata: dict that travelled along."""

    cube: CanonicalCube
    units: list
    fields: list
    materials: list[Material]
    metadata: dict = field(default_factory=dict)
    has_alpha: bool = False
    threads: int = 1
    neural: list | None = None  # neural.payload.Tables by field: points then ask the network, not the voxels
    skipped: list = field(default_factory=list)

    def _joined(self, pick, empty):
        parts = [pick(u) for u in self.units]
        return np.concatenate(parts) if parts else empty

    @property
    def origin(self):
        return np.array(self.cube.origin)

    @property
    def side(self):
        return self.cube.side

    @property
    def position_bits(self):
        return self.cube.position_bits

    @property
    def resolution(self):
        """Largest grid resolution over the fields; 1 for an empty asset."""
        return max((f.size for f in self.fields), default=1)

    @property
    def lattice_positions(self):
        """int64 [V, 3], all units one after the other."""
        return self._joined(lambda u: u.lattice, np.zeros((0, 3), np.int64))

    @property
    def positions(self):
        """float64 [V, 3] in world space."""
        return self.cube.to_world(self.lattice_positions)

    @property
    def faces(self):
        """int64 [F, 3] into positions, in unit order."""
        starts = np.cumsum([0] + [len(u.lattice) for u in self.units])
        parts = [u.faces + s for u, s in zip(self.units, starts[:-1], strict=True)]
        return np.concatenate(parts) if parts else np.zeros((0, 3), np.int64)

    @property
    def face_material(self):
        return self._joined(lambda u: np.full(len(u.faces), u.material), np.zeros(0, np.int64))

    @property
    def face_field(self):
        return self._joined(lambda u: np.full(len(u.faces), u.field), np.zeros(0, np.int64))

    def query(self, points, face_index=None):
        """Colour of the field at surface points (spec clause 8.2; of a 3DNTC payload clause 11, exact to the bit).

        points: float64 [M, 3] world space; face_index: int64 [M] face that each point lies on, or None for the nearest face.
        Returns float32 [M, 4]: RGBA in 0..255, colour sRGB-coded, straight alpha.
        """
        points = np.asarray(points, np.float64).reshape(-1, 3)
        out = np.zeros((len(points), 4), np.float32)
        if len(points) == 0:
            return out
        if not np.isfinite(points).all():
            raise InputError("TXF-I71", "query points are not finite", value=int((~np.isfinite(points).all(axis=1)).sum()))
        if not self.fields:
            raise InputError("TXF-I70", "an empty asset has no colour to ask for")
        if len(self.fields) == 1:
            which = np.zeros(len(points), np.int64)
        else:
            which = self.face_field[self.nearest_face(points) if face_index is None else np.asarray(face_index)]
        return self.query_by_field(points, which)

    def query_by_field(self, points, which):
        """As query(), each point asking the field whose number stands in which, int64 [M]."""
        out = np.zeros((len(points), 4), np.float32)
        for i, part in enumerate(self.fields):
            chosen = slice(None) if len(self.fields) == 1 else np.flatnonzero(which == i)
            if self.neural:
                out[chosen] = self.query_network(i, points[chosen])
            elif len(self.fields) == 1 or len(chosen):
                grid = self.cube.to_grid(points[chosen], part.resolution) / (1 << part.level_shift)
                out[chosen] = query_field(grid, part.size, part.keys, part.brick_map, part.rgba, self.threads)[0]
        return out

    def query_network(self, number, points):
        """What the 3DNTC payload answers for field `number`: float32 [M, 4] in 0..255. points: float64 [M, 3], world."""
        from .codecs.neural.infer import POSITION_BITS, cube_positions, infer_rgba

        low, high = self.origin - self.side, self.origin + 2 * self.side  # further out is on the border anyway
        grid = self.cube.to_grid(np.clip(points, low, high), 1 << POSITION_BITS)
        return infer_rgba(cube_positions(grid), self.neural[number], self.threads)

    def nearest_face(self, points):
        """Index of the face nearest to each world point, int64 [M]."""
        import trimesh

        mesh = trimesh.Trimesh((self.positions - self.origin) / (self.side or 1.0), self.faces, process=False)
        return trimesh.proximity.closest_point(mesh, (points - self.origin) / (self.side or 1.0))[2]

    def voxels(self):
        """All active voxels: {"xyz": int32 [N, 3], "field": int32 [N], "rgba": uint8 [N, 4], "center": float64 [N, 3] world}."""
        xyz = [decode_morton(f.keys) for f in self.fields]
        center = [self._centers(f, v) for f, v in zip(self.fields, xyz, strict=True)]
        number = [np.full(len(v), i, np.int32) for i, v in enumerate(xyz)]
        return {
            "xyz": np.concatenate([np.zeros((0, 3), np.int32), *xyz]),
            "field": np.concatenate([np.zeros(0, np.int32), *number]),
            "rgba": np.concatenate([np.zeros((0, 4), np.uint8), *(f.rgba for f in self.fields)]),
            "center": np.concatenate([np.zeros((0, 3)), *center]),
        }

    def _centers(self, part, xyz):
        grid = (xyz + 0.5) * (1 << part.level_shift)
        return self.cube.to_world(grid * ((1 << self.position_bits) / part.resolution))

    def bake(self, texture_size=None, atlas="auto"):
        """A texture atlas with the field baked in; see asset.save.bake."""
        from .asset.save.bake import bake

        return bake(self, texture_size, atlas)

    def save(self, path, **options):
        """Writes .glb, .gltf, .obj, .ply or .npz; see asset.save.files."""
        from .asset.save.files import save

        return save(self, path, **options)
