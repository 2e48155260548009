"""Charts by xatlas, run in child processes: its native code may crash, hang or exhaust memory on broken topology.

The time of xatlas grows faster than the number of faces (39,455 faces 6 s, 184,452 more than 150 s). So it gets parts of a few
thousand faces, several at a time. It packs each part on a canvas of a few texels, because a full canvas takes longer than the
charts; chart_packing.py packs all charts.
"""

import importlib.util
import io
import math
import os
import subprocess
import sys
import zipfile
from typing import Any

import numpy as np

from ...core import cleanup
from ...core.threads import in_order
from ...geometry.areas import face_areas
from ...geometry.mesh import face_normals

# Faces that xatlas gets at most at a time. A scan of 20,000 takes 1.3 s in place of 2.5, a can 1.1 for 2.5, a room of 184,204 4
# for more than 150; seams are 5 % shorter to 12 % longer on ten assets, 2 % longer in the median.
PART_FACES = 5000
EVEN = 0.4  # share of the faces that the smaller side of a cut has at least
DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1], [0, 1, 1], [0, 1, -1],
                       [1, 1, 1], [1, 1, -1], [1, -1, 1], [-1, 1, 1]], np.float64)
CANVAS = 64  # texels along the longest side of a part
PADDING = 4  # texels between charts at the final size, where xatlas packs them

_CHILD = "from texfcodec.io.atlas.quality import _child; _child()"


class QualityFailed(Exception):
    """xatlas gave no usable charts; the message says why. unwrap.py catches it."""


def chart_surface(points: np.ndarray, faces: np.ndarray, seconds: float, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Cut a surface into charts and flatten them with xatlas; charts are not packed yet.

    points: float64 [V, 3] in the unit cube; faces: int64 [F, 3]; seconds: time limit; threads: processes at a time, on which
    the result does not depend.
    Returns (flat float64 [F, 3, 2], chart int64 [F]): corners in their chart, whose area is that of its surface, and the chart
    of each face, 0..n-1. Raises QualityFailed.
    """
    parts = _parts(points, faces)
    shares = [parts[first :: max(threads, 1)] for first in range(min(max(threads, 1), len(parts)))]
    flat, chart, count = np.zeros((len(faces), 3, 2)), np.zeros(len(faces), np.int64), 0
    of_shares = in_order(lambda share: _of_share(points, faces, share, seconds), shares, threads)
    for share, share_charts in zip(shares, of_shares, strict=True):
        for part, (corners, numbers) in zip(share, share_charts, strict=True):
            flat[part], chart[part] = corners, numbers
    for part in parts:
        chart[part] += count
        count = int(chart[part].max()) + 1
    areas = face_areas(points, faces)
    flat = _levelled(flat, chart, points[faces], areas)
    if _collapsed_share(flat, areas) > 0.01:
        raise QualityFailed("xatlas collapsed part of the surface")
    return flat, chart


def _parts(points, faces):
    """Parts of the surface, cut in two by planes until none has more than PART_FACES: [face numbers int64 [n], ascending].

    A plane is placed to cut the shortest total edge length, so across a neck and not along a back. Edges are weighted by the
    cosine between their faces, because a sharp edge would be a chart border anyway.
    """
    from ...geometry.edges import shared_edges  # here, so that the child process is spared numba

    corner, edges = points[faces], shared_edges(faces)
    normal, twin = face_normals(corner), np.flatnonzero(edges.edge[1:] == edges.edge[:-1])
    first, second = edges.half[twin] // 3, edges.half[twin + 1] // 3
    away = np.diff(points[edges.ends[edges.edge[twin]]], axis=1)[:, 0]
    cosine = np.clip((normal[first] * normal[second]).sum(1), 0.0, 1.0)
    parts, waiting = [], [(np.arange(len(faces)), first, second, np.sqrt((away * away).sum(1)) * cosine)]
    while waiting:
        rows, first, second, length = waiting.pop()
        if len(rows) <= PART_FACES:
            parts.append(rows)
            continue
        side = _best_cut(corner[rows].mean(1), first, second, length)
        for half in (side, ~side):
            number, inside = np.cumsum(half) - 1, half[first] & half[second]
            waiting.append((rows[half], number[first[inside]], number[second[inside]], length[inside]))
    return parts


def _best_cut(centres, first, second, length):
    """Return whether each of n faces is on the first side of the best plane, bool [n]. first, second: faces at each edge, [E];
    length: cost of cutting each edge, [E]."""
    count, least, best = len(centres), np.inf, np.zeros(len(centres), bool)
    window = slice(int(count * EVEN), max(int(count * (1 - EVEN)), int(count * EVEN) + 1))
    for direction in DIRECTIONS:
        rank = np.empty(count, np.int64)
        rank[np.argsort(centres @ direction, kind="stable")] = np.arange(count)
        low, high = np.minimum(rank[first], rank[second]), np.maximum(rank[first], rank[second])
        parted = np.cumsum(np.bincount(low + 1, length, count + 1) - np.bincount(high + 1, length, count + 1))[window]
        if parted.min() < least:
            least, best = parted.min(), rank < window.start + parted.argmin()
    return best


def _of_share(points, faces, parts, seconds):
    """For each part: corners float64 [n, 3, 2] in some unit along each axis of a chart, and charts int64 [n]."""
    meshes = []
    for part in parts:
        used, corner = np.unique(faces[part], return_inverse=True)
        meshes.append((points[used], corner.reshape(-1, 3)))
    return [(flat, chart) for flat, chart, _ in run_xatlas(meshes, 0, seconds)]


def _lent(flat, chart, points, faces):
    """Corners and charts of a part. Faces that xatlas ignored take the place of a neighbour, which is harmless because they have
    no area; raises QualityFailed if any has."""
    ignored, taken = np.flatnonzero(chart < 0), np.flatnonzero(chart >= 0)
    if not len(ignored):
        return flat, chart
    corner = points[faces[ignored]]
    if np.abs(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])).max() > 1e-10:
        raise QualityFailed("xatlas ignored part of the surface")
    if not len(taken):
        return np.zeros_like(flat), np.zeros_like(chart)
    at = np.full(len(points), 3 * taken[0])  # of a vertex: a corner that has a place
    at[faces[taken].ravel()] = np.add.outer(3 * taken, np.arange(3)).ravel()
    lender = at[faces[ignored, 0]]
    flat[ignored], chart[ignored] = flat.reshape(-1, 1, 2)[lender], chart[lender // 3]
    return flat, chart


def _levelled(flat, chart, corners, areas):
    """Charts without the stretch of xatlas's packing, which widens each to whole texels along both axes.

    The mean extent of the surface along an axis gives that axis its length; this restores conformal charts, as most of xatlas's
    are. Then each chart gets the area of its surface.
    """
    (a, b), (u, v) = (np.moveaxis(side[:, 1:] - side[:, :1], 1, 0) for side in (corners, flat))
    along = np.stack([a * v[:, 1:] - b * u[:, 1:], b * u[:, :1] - a * v[:, :1]])
    reach = [np.bincount(chart, np.sqrt((way * way).sum(1))) for way in along]
    flat = flat * np.stack(reach, 1)[chart, None]
    filled, surface = np.bincount(chart, _flat_areas(flat)), np.bincount(chart, areas)
    return flat * np.sqrt(surface / np.where(filled > 0, filled, np.inf))[chart, None, None]


def _flat_areas(flat):
    from .chart_packing import flat_areas  # here for the same reason

    return flat_areas(flat)


def _collapsed_share(flat, areas):
    """Share of the surface, 0..1, that has almost no area in the atlas."""
    room, total = _flat_areas(flat), areas.sum()
    return float(areas[room * total < 1e-4 * areas * room.sum()].sum() / total) if total > 0 else 0.0


def run_xatlas(meshes: list, side: int, seconds: float) -> list:
    """Cut meshes into charts, and pack those of each mesh, with xatlas, in turn and in a single child process.

    meshes: [(points float64 [V, 3] in the unit cube, faces int64 [F, 3])]; side: of the square that the packing aims at, in
    texels, or 0 for a canvas as small as CANVAS; seconds: time limit.
    Returns for each mesh (corners float64 [F, 3, 2] in texels of its canvas, chart int64 [F], canvas float32 [2]). Faces without
    area that xatlas ignored have the place of a neighbour. Raises QualityFailed.
    """
    if importlib.util.find_spec("xatlas") is None:
        raise QualityFailed("xatlas is not installed (pip install xatlas)")
    request = io.BytesIO()
    named = {f"points{i}": points.astype(np.float32) for i, (points, _) in enumerate(meshes)}
    named |= {f"faces{i}": faces.astype(np.uint32) for i, (_, faces) in enumerate(meshes)}
    np.savez(request, side=side, count=len(meshes), **named)
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    try:
        done = cleanup.run_child([sys.executable, "-c", _CHILD], request.getvalue(), seconds, environment)
        done.check_returncode()
        with np.load(io.BytesIO(done.stdout)) as reply:
            charts = [tuple(reply[f"{name}{i}"] for name in ("flat", "chart", "size")) for i in range(len(meshes))]
    except subprocess.TimeoutExpired:
        raise QualityFailed(f"xatlas took more than {seconds:g} s") from None
    except subprocess.CalledProcessError as error:
        raise QualityFailed(f"xatlas ended with status {error.returncode}") from None
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise QualityFailed(f"xatlas could not be run ({type(error).__name__})") from None
    for (flat, chart, size), (_, faces) in zip(charts, meshes, strict=True):
        if flat.shape != (len(faces), 3, 2) or chart.shape != (len(faces),) or not np.isfinite(flat).all() or size.min() < 1:
            raise QualityFailed("xatlas returned malformed charts")
    return [(*_lent(flat.astype(np.float64), chart, *mesh), size)
            for (flat, chart, size), mesh in zip(charts, meshes, strict=True)]


def _child():
    """Entry point of the child process: an npz request on stdin, an npz reply on stdout."""
    replies, sys.stdout = sys.stdout.buffer, sys.stderr  # whatever xatlas prints must not reach the reply
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as request:
        named: dict[str, Any] = {}
        for i in range(int(request["count"])):
            arrays = _xatlas(request[f"points{i}"], request[f"faces{i}"], int(request["side"]))
            named |= zip((f"flat{i}", f"chart{i}", f"size{i}"), arrays, strict=True)
    reply = io.BytesIO()
    np.savez(reply, **named)
    replies.write(reply.getvalue())
    replies.flush()


def _xatlas(points, faces, side):
    """The result of run_xatlas() for a mesh, in float32; the chart of faces that xatlas ignored is -1.

    The mesh is enlarged first: xatlas silently ignores faces below 1.2e-7 square units and edges below 1e-4. Its canvas may
    exceed the requested resolution (by up to 40 % in our measurements), so the padding allows for shrinking it.
    """
    import xatlas

    points = points * np.float32(4096)
    options = xatlas.PackOptions()
    if side:
        options.padding, options.resolution = math.ceil(PADDING * 1.5), side
    else:
        options.texels_per_unit = CANVAS / max(float(np.ptp(points, axis=0).max(initial=0.0)), 1e-3)
    atlas = xatlas.Atlas()
    atlas.add_mesh(np.ascontiguousarray(points), np.ascontiguousarray(faces))
    atlas.generate(xatlas.ChartOptions(), options)
    original, indices, uv = atlas[0]
    size = np.array([atlas.width, atlas.height], np.float32)
    if atlas.atlas_count != 1 or not (original[indices] == faces).all():
        raise SystemExit(3)
    chart = np.full(len(faces), -1, np.int64)
    for number in range(atlas.get_mesh_chart_count(0)):
        chart[np.asarray(atlas.get_mesh_chart(0, number).faces)] = number
    return (uv * size)[indices], chart, size
