"""Texture atlases for decoded meshes: fields over voxels have no UVs, so that an image needs a new parameterisation."""

import math
from dataclasses import dataclass, field

import numpy as np

from ...errors import InputError
from ..formats import ATLAS_METHODS

MIN_SIZE, DEFAULT_MAX_SIZE, MAX_SIZE = 256, 4096, 8192
QUALITY_FACES = 100_000  # "auto" uses xatlas up to here; 20,000 take 2.3 s of the processor, slivers 17
_QUALITY_SECONDS = {"auto": 30.0, "quality": 1800.0}
# Texels around a chart, and the least scale that they are worth. 4 in place of 2: jumps across borders at mip levels 2 and 3 fall
# by a third to a half, for 0.5 dB of 48 between atlas and field (bball_0001 and waterbottle_pbr).
_PADDINGS = ((5, 0.8), (4, 0.8), (2, 0.5), (1, 0.0))
_FILL = 0.55  # share of the atlas that charts usually cover, both methods


@dataclass
class Atlas:
    """Places of faces in a square image. corner_uv: float64 [F, 3, 2] in [0, 1], v downwards (glTF); width, height: texels;
    method: "quality" or "fast".

    utilisation: share of the image covered by faces, 0..1; warnings: one sentence each.
    """

    corner_uv: np.ndarray
    width: int
    height: int
    method: str
    utilisation: float
    warnings: list = field(default_factory=list)


def make_atlas(positions: np.ndarray, faces: np.ndarray, texture_size: int | None = None, method: str = "auto",
               resolution: int | None = None, groups: np.ndarray | None = None, threads: int = 1) -> Atlas:
    """Unwrap any triangle mesh, however broken, into one square image.

    positions: float64 [V, 3], any unit; faces: int64 [F, 3]; texture_size: side in texels, or None for the power of two
    (256..4096) that gives about one texel per voxel edge; resolution: voxels along the longest side of the mesh (K; 1024 if
    None); method: one of ATLAS_METHODS; groups: int64 [F] or None, faces of different groups never share a chart ("fast" only);
    threads: processes of xatlas at a time, on which the atlas does not depend.
    Returns Atlas. Raises InputError TXF-O10 (arguments), TXF-O11 (mesh), TXF-O12 (more charts than any atlas can hold).
    """
    positions, faces = _checked_mesh(positions, faces)
    check_arguments(texture_size, method)
    points = _unit_points(positions, faces)
    side = int(texture_size or default_size(points, faces, resolution or 1024))
    if len(faces) == 0:
        return Atlas(np.zeros((0, 3, 2)), side, side, "fast", 0.0)
    warnings: list[str] = []
    groups = np.zeros(len(faces), np.int64) if groups is None else np.ascontiguousarray(groups, np.int64)
    charts = None
    if method == "quality" or (method == "auto" and len(faces) <= QUALITY_FACES):
        charts = _quality(points, faces, _QUALITY_SECONDS[method], threads, warnings)
    flat, roomy = _packed(points, faces, groups, side, charts)
    if roomy != side:
        warnings.append(f"{side} texels per side cannot hold the charts of the mesh; the atlas has {roomy}")
    return _finished(flat, roomy, "fast" if charts is None else "quality", warnings)


def check_arguments(texture_size: int | None, method: str) -> None:
    """Raises InputError TXF-O10 for a texture size or a method that make_atlas() does not accept."""
    if method not in ATLAS_METHODS or (texture_size is not None and not 16 <= texture_size <= MAX_SIZE):
        raise InputError("TXF-O10", "the atlas method or texture size is unknown", method=method, texture_size=texture_size)


def default_size(points: np.ndarray, faces: np.ndarray, resolution: int) -> int:
    """Return the side of an atlas in texels: the power of two in 256..4096 with about one texel per voxel edge (0.8 or more,
    unless capped).

    points: float64 [V, 3] scaled so that the longest side of their box is 1; resolution: voxels along that side.
    """
    side = resolution * math.sqrt(_surface(points, faces) / _FILL)
    power = math.ceil(math.log2(max(0.8 * side, 1.0)))
    return min(max(1 << power, MIN_SIZE), DEFAULT_MAX_SIZE)


def _checked_mesh(positions, faces):
    """Contiguous float64 positions and int64 faces. Raises InputError TXF-O11 for invalid indices or coordinates."""
    positions = np.ascontiguousarray(positions, np.float64).reshape(-1, 3)
    faces = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(positions)):
        raise InputError("TXF-O11", "face index outside the vertex list", allowed=f"0..{len(positions) - 1}")
    if not np.isfinite(positions).all():
        raise InputError("TXF-O11", "coordinates must be finite")
    return positions, faces


def _unit_points(positions, faces):
    """Used positions moved and scaled into the unit cube, safe from 1e-300 to 1e300; unused positions become 0."""
    points = np.zeros_like(positions)
    if len(faces) == 0:
        return points
    used = np.zeros(len(positions), bool)
    used[faces] = True
    low, high = positions[used].min(0), positions[used].max(0)
    half = float((high * 0.5 - low * 0.5).max()) if np.isfinite(high).all() else 0.0  # the whole may be too much for a float
    if half > 0:
        points[used] = (positions[used] * 0.5 - low * 0.5) / half
    return points


def _surface(points, faces):
    corner = points[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return float(np.sqrt((cross * cross).sum(1)).sum() * 0.5)


def _quality(points, faces, seconds, threads, warnings):
    """Flat corners and charts from xatlas, or None with the reason appended to warnings."""
    from .quality import QualityFailed, chart_surface

    try:
        return chart_surface(points, faces, seconds, threads)
    except QualityFailed as reason:
        warnings.append(f"{reason}; the fast atlas is used instead")
        return None


def _packed(points, faces, groups, side, charts):
    """(corners in texels, side); the side grows if the padding of many small charts needs it. charts: (flat corners, chart of
    each face), or None for fast charts, which depend on the side."""
    from .chart_packing import pack_charts, upright
    from .charts import grow_charts

    while side <= MAX_SIZE:
        density = side * min(math.sqrt(_FILL / max(_surface(points, faces), 1e-12)), 1e3)
        if charts is None:
            flat, chart, extent = grow_charts(points * density, faces, groups, 0.75 * side)
        else:
            chart = charts[1]
            flat, extent = upright(charts[0] * density, chart, int(chart.max()) + 1)
        for padding, least in _PADDINGS:
            placed, scale = pack_charts(flat, chart, extent, side, padding)
            if placed is not None and scale > least:
                return placed, side
        side = min(side * 2, MAX_SIZE) if side < MAX_SIZE else MAX_SIZE + 1
    raise InputError(
        "TXF-O12", "the mesh has too many separate pieces for one atlas; use --appearance vertex or voxels", faces=len(faces)
    )


def _finished(flat, side, method, warnings):
    from .chart_packing import flat_areas

    uv = np.clip(flat / side, 0.0, 1.0)
    return Atlas(uv, side, side, method, float(flat_areas(flat).sum()) / (side * side), warnings)
