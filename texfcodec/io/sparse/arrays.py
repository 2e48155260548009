"""Named arrays -> Scene: a surface with voxels, with a function of points, or with values at its vertices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, LimitError
from ...options import default_threads
from ...report import plural
from ...scene.channels import ALPHA, BASE_COLOUR, BY_NAME
from ...scene.scene import ALPHA_BLEND, ALPHA_OPAQUE, Material
from ...scene.srgb import srgb_to_linear
from ..parts import Notes, Part, assemble, check_face_count
from .sampler import MOST_SIDE, PointFunction, SparseVoxels, channel_values
from .subdivide import subdivided

if TYPE_CHECKING:
    from ...scene.scene import Scene

VERTICES, FACES, VOXELS = ("vertices", "positions"), ("faces", "triangles"), ("voxels", "coord", "coords")
PLACE = ("resolution", "origin", "voxel_size")
MOST_FACES = 2_000_000  # to which faces are cut so that corners hold the voxels' detail
CLEAR = 0.95  # alpha below which a surface is seen through; generators' opaque surfaces waver above it
CLEAR_SHARE = 1e-3  # of the corners, from which on a material blends


def read_arrays(arrays: Mapping[str, Any], notes: Notes) -> Scene:
    """Return the Scene of named arrays; docs/guide/generated_mesh.md lists them.

    Parameters
    ----------
    arrays : mapping of str to array
        "vertices" [V, 3] and "faces" [F, 3], or "mesh", a trimesh.Trimesh. Further "voxels", int [N, 3], with "resolution" or
        "origin" and "voxel_size", and values [N, C] by channel name; or "values", a function of points float64 [n, 3] that
        returns such values; or values [V, C] at vertices. Arrays of numpy, or of anything with DLPack in the processor's memory.
    notes : Notes
        Receives what is left out or resampled.

    Raises
    ------
    InputError, LimitError
        TXF-I43 to I45, those of assemble(), and TXF-I41 for more voxels or vertices than the limits.
    """
    rest = dict(arrays)
    positions, faces = _surface(rest)
    place = {name: as_array(rest.pop(name), name) for name in PLACE if name in rest}
    xyz, function = _first(rest, VOXELS), rest.pop("values", None)
    named = {name: as_array(values, name) for name, values in rest.items()}
    if function is not None and (xyz is not None or not callable(function)):
        raise InputError("TXF-I45", "'values' is not a function of points, or there are voxels beside it")
    if function is not None:
        for name in named:
            notes.remark(f"array '{name[:60]}' is left out: a function of points gives the values")
        return _sampled(positions, faces, PointFunction(function, notes), np.full(3, np.inf), notes)
    if xyz is not None:
        voxels = read_voxels(as_array(xyz, "voxels"), named, place, notes)
        return _sampled(positions, faces, voxels, voxels.size, notes)
    values = channel_values(named, len(positions), notes, "vertices")
    if not values:
        notes.lose("the appearance (no values)", "the surface comes without voxels or values of its vertices; it is white")
    values = {name: np.where(np.isfinite(value), value, 1) for name, value in values.items()}
    return _scene(positions, faces, values, notes)


def as_array(values: Any, name: str) -> np.ndarray:
    """Return anything array-like as a numpy array, without a copy where DLPack allows it. Raises InputError TXF-I44."""
    try:
        if not isinstance(values, np.ndarray) and hasattr(values, "__dlpack__"):
            values = values.detach() if hasattr(values, "detach") else values  # torch hands out no tensor with a gradient
            return np.from_dlpack(values)
        array = np.asarray(values)
    except Exception as error:  # of a foreign library
        raise InputError("TXF-I44", f"'{name[:60]}' cannot be read as an array; move it to the processor's memory",
                         reason=f"{type(error).__name__}: {error}"[:200]) from error
    if array.dtype.kind not in "fiub":
        raise InputError("TXF-I44", f"'{name[:60]}' is not an array of numbers", value=str(array.dtype)[:40])
    return array


def _first(rest, names):
    """Take the first of several names out of a dict; None if it has none of them."""
    return next((rest.pop(name) for name in names if name in rest), None)


def _surface(rest):
    """(vertices float64 [V, 3], faces int64 [F, 3]), taken out of the named arrays. Raises InputError TXF-I43, TXF-I44."""
    mesh = rest.pop("mesh", None)
    points, faces = _first(rest, VERTICES), _first(rest, FACES)
    if mesh is not None and hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        points, faces = mesh.vertices, mesh.faces
    if points is None or faces is None:
        raise InputError("TXF-I43", "there is no surface: 'vertices' or 'faces' is missing", value=str(sorted(rest))[:120])
    points, faces = as_array(points, "vertices"), as_array(faces, "faces")
    is_mesh = points.ndim == 2 and points.shape[1] == 3 and faces.ndim == 2 and faces.shape[1] in (3, 4)
    if not is_mesh or faces.dtype.kind not in "iu":
        raise InputError("TXF-I44", "'vertices' is not [V, 3], or 'faces' not integers [F, 3] or [F, 4]",
                         value=f"{points.shape}, {faces.dtype} {faces.shape}"[:80])
    check_face_count(len(faces))
    faces = faces.astype(np.int64)
    if faces.shape[1] == 4:
        faces = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return np.asarray(points, np.float64), faces


def read_voxels(xyz: np.ndarray, named: Mapping[str, np.ndarray], place: Mapping[str, Any], notes: Notes) -> SparseVoxels:
    """Return the SparseVoxels of arrays. xyz: [N, 3]; named: values [N, C] by name; place: those of PLACE that are given; by
    default the grid covers -0.5..0.5. Voxels outside of the cube, or with a NaN, are left out. Raises InputError TXF-I44,
    LimitError TXF-I41."""
    if xyz.ndim != 2 or xyz.shape[1] != 3 or xyz.dtype.kind not in "iu" or not len(xyz):
        raise InputError("TXF-I44", "'voxels' is not an array of integers [N, 3]", value=f"{xyz.dtype} {xyz.shape}"[:80])
    if notes.limits.voxels is not None and len(xyz) > notes.limits.voxels:
        raise LimitError("TXF-I41", "the input has more voxels than the limit allows", value=len(xyz),
                         allowed=notes.limits.voxels)
    values = channel_values(named, len(xyz), notes, "voxels")
    if not values:
        raise InputError("TXF-I44", "the voxels have no values of a known channel", value=str(sorted(named))[:120])
    resolution, origin, size = grid_place(place)
    bad = ((xyz < 0) | (xyz >= min(resolution, MOST_SIDE))).any(axis=1)
    if bad.any():
        notes.fault("TXF-I44", plural(int(bad.sum()), "voxel is", "voxels are") + " outside the cube and left out",
                    "voxels outside the cube", count=int(bad.sum()))
    broken = ~np.all([np.isfinite(value).all(axis=1) for value in values.values()], axis=0)
    if broken.any():
        notes.fault("TXF-I44", plural(int(broken.sum()), "voxel has", "voxels have") + " NaN values and are left out",
                    "voxels (NaN)", count=int(broken.sum()))
    xyz, kept = xyz.astype(np.int64), ~(bad | broken)
    if not kept.any():
        raise InputError("TXF-I44", "no voxel is inside the cube with values that are numbers", allowed=resolution)
    first = np.sort(np.unique(xyz[kept], axis=0, return_index=True)[1]) if _repeats(xyz[kept]) else slice(None)
    if not isinstance(first, slice):
        notes.remark(f"{int(kept.sum()) - len(first)} voxels repeat others and are left out")
    return SparseVoxels(xyz[kept][first], {name: value[kept][first] for name, value in values.items()}, origin, size)


def _repeats(xyz):
    key = (xyz[:, 0] * MOST_SIDE + xyz[:, 1]) * MOST_SIDE + xyz[:, 2]
    key.sort()
    return bool((key[1:] == key[:-1]).any())


def grid_place(place: Mapping[str, Any]) -> tuple[int, np.ndarray, np.ndarray]:
    """Return (resolution, origin float64 [3], voxel size float64 [3]) of a grid. place: those of PLACE that are given. Raises
    InputError TXF-I44."""
    try:
        resolution = int(place["resolution"]) if "resolution" in place else None
        size = np.broadcast_to(np.asarray(place.get("voxel_size", 1 / max(resolution or 1, 1)), np.float64).reshape(-1), 3)
        origin = np.broadcast_to(np.asarray(place.get("origin", -0.5), np.float64).reshape(-1), 3)
    except (TypeError, ValueError, ArithmeticError, RuntimeWarning) as error:
        raise InputError("TXF-I44", "the place of the voxels is not a resolution, an origin and a voxel size",
                         reason=str(error)[:120]) from error
    if resolution is not None and not 0 < resolution <= MOST_SIDE:
        raise InputError("TXF-I44", "the resolution of the voxels is out of range", value=resolution, allowed=f"1..{MOST_SIDE}")
    if resolution is None and ("voxel_size" not in place or "origin" not in place):
        raise InputError("TXF-I44", "the place of the voxels is unknown: 'resolution', or 'origin' and 'voxel_size'")
    if not (np.isfinite(origin).all() and np.isfinite(size).all() and (size > 0).all()):
        raise InputError("TXF-I44", "the origin or size of the voxels is out of range",
                         value=str((origin.tolist(), size.tolist()))[:120])
    return resolution or MOST_SIDE, origin, size


def _sampled(positions, faces, sampler, size, notes):
    """Scene of a surface with values from a sampler. size: float64 [3], of a voxel; infinite where there are none."""
    threads = default_threads()
    if not np.isfinite(positions).all() or not len(faces) or faces.min() < 0 or faces.max() >= len(positions):
        return _scene(positions, faces, {}, notes)  # which names the fault
    values = sampler.at(positions, threads)
    remark = sampler.fit(positions) if isinstance(sampler, SparseVoxels) else ""
    names = list(values)

    def joined(points):
        given = sampler.at(np.ascontiguousarray(points), threads)
        return np.concatenate([given[name] for name in names], axis=1)

    if np.isfinite(size).all():
        count, together = len(faces), np.concatenate([values[name] for name in names], axis=1)
        positions, faces, together, ended = subdivided(positions, faces, together, joined, size, max(MOST_FACES, len(faces)))
        ends = np.cumsum([values[name].shape[1] for name in names])[:-1]
        values = dict(zip(names, np.split(together, ends, axis=1), strict=True))
        if len(faces) > count:
            remark += f"; {count} faces are cut into {len(faces)} to hold the voxels' detail"
        remark += f"; the limit of {MOST_FACES} faces leaves some of it out" if ended else ""
    if remark:
        notes.remark(remark)
    return _scene(positions, faces, values, notes)


def _scene(positions, faces, values, notes):
    """Scene of a surface with values at its vertices, float32 [V, C] by channel, as images hold them."""
    linear = {name: srgb_to_linear(value).astype(np.float32) if BY_NAME[name].srgb else value for name, value in values.items()}
    colour, alpha = linear.pop(BASE_COLOUR.name, None), linear.pop(ALPHA.name, None)
    mode = ALPHA_OPAQUE
    if alpha is not None:
        mode = ALPHA_BLEND if (alpha < CLEAR).mean() > CLEAR_SHARE else ALPHA_OPAQUE
        if mode == ALPHA_OPAQUE and (alpha < 1).any():
            notes.remark(f"alpha is left out: it is below {CLEAR} almost nowhere, and the surface is opaque")
    rgba = None
    if colour is not None or mode == ALPHA_BLEND:
        rgba = np.ones((len(positions), 4), np.float32)
        rgba[:, :3] = 1 if colour is None else colour
        rgba[:, 3] = alpha[:, 0] if mode == ALPHA_BLEND else 1
    part = Part(positions, faces, 0, None, rgba, "the surface", maps=linear)
    return assemble([part], [Material("surface", alpha_mode=mode, double_sided=True)], [], notes)
