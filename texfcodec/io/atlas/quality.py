"""The xatlas parameterisation, run in a child process: its native code may crash, hang or eat memory on broken topology."""

import importlib.util
import io
import math
import os
import subprocess
import sys
import zipfile

import numpy as np

from ...core import cleanup

PADDING = 4  # texels between charts at the final size

_CHILD = "from texfcodec.io.atlas.quality import _child; _child()"


class QualityFailed(Exception):
    """xatlas gave no usable atlas; the message says why. Never leaves the asset room."""


def unwrap(points: np.ndarray, faces: np.ndarray, side: int, seconds: float) -> np.ndarray:
    """Parameterise with xatlas and fit the result into a square.

    points: float64 [V, 3] in the unit cube; faces: int64 [F, 3]; side: texels; seconds: time limit.
    Returns corner texel coordinates float64 [F, 3, 2] in [0, side]; raises QualityFailed.
    """
    flat, size = _run_child(points, faces, side, seconds)
    if flat.shape != (len(faces), 3, 2) or not np.isfinite(flat).all() or size.min() < 1:
        raise QualityFailed("xatlas returned a malformed atlas")
    if _collapsed_share(flat, points, faces) > 0.01:
        raise QualityFailed("xatlas collapsed part of the surface")
    return flat * (side / float(size.max()))


def _collapsed_share(flat, points, faces):
    """Share 0..1 of the surface that got (next to) no room in the atlas."""
    from .chart_packing import flat_areas  # here, so that the child process is spared numba

    corner, room = points[faces], flat_areas(flat)
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.sqrt((cross * cross).sum(1))
    total = area.sum()
    return float(area[room * total < 1e-4 * area * room.sum()].sum() / total) if total > 0 else 0.0


def _run_child(points, faces, side, seconds):
    """Hand the mesh to a child process through pipes; returns (corners float64 [F, 3, 2], size float64 [2])."""
    if importlib.util.find_spec("xatlas") is None:
        raise QualityFailed("xatlas is not installed (pip install xatlas)")
    request = io.BytesIO()
    np.savez(request, points=points.astype(np.float32), faces=faces.astype(np.uint32), side=side)
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    try:
        done = cleanup.run_child([sys.executable, "-c", _CHILD], request.getvalue(), seconds, environment)
        done.check_returncode()
        with np.load(io.BytesIO(done.stdout)) as reply:
            return reply["flat"].astype(np.float64), reply["size"].astype(np.float64)
    except subprocess.TimeoutExpired:
        raise QualityFailed(f"xatlas took more than {seconds:g} s") from None
    except subprocess.CalledProcessError as error:
        raise QualityFailed(f"xatlas ended with status {error.returncode}") from None
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise QualityFailed(f"xatlas could not be run ({type(error).__name__})") from None


def _child():
    """Entry point of the child process: an npz request on stdin, an npz reply on stdout."""
    replies, sys.stdout = sys.stdout.buffer, sys.stderr  # whatever xatlas prints must not reach the reply
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as request:
        points, faces, side = request["points"], request["faces"], int(request["side"])
    flat, size = _xatlas(points, faces, side)
    reply = io.BytesIO()
    np.savez(reply, flat=flat, size=size)
    replies.write(reply.getvalue())
    replies.flush()


def _xatlas(points, faces, side):
    """Corners float32 [F, 3, 2] in texels of xatlas's own canvas, and that canvas's size [2].

    The mesh is enlarged first: xatlas silently ignores faces below 1.2e-7 square units and edges below 1e-4. The canvas may
    exceed the resolution asked for (by up to 40 % in our measurements), so the padding allows for shrinking it.
    """
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(np.ascontiguousarray(points * np.float32(4096)), np.ascontiguousarray(faces))
    options = xatlas.PackOptions()
    options.padding = math.ceil(PADDING * 1.5)
    options.resolution = side
    atlas.generate(xatlas.ChartOptions(), options)
    original, indices, uv = atlas[0]
    size = np.array([atlas.width, atlas.height], np.float32)
    if atlas.atlas_count != 1 or not (original[indices] == faces).all():
        raise SystemExit(3)
    charts, _ = _chart_of_vertices(atlas, len(indices))
    return _lend_uv(uv * size, indices, faces, charts, points), size


def _chart_of_vertices(atlas, count):
    """Chart int64 [F] of every face, -1 for the ones xatlas ignored; and the number of charts."""
    chart = np.full(count, -1, np.int64)
    total = atlas.get_mesh_chart_count(0)
    for i in range(total):
        chart[np.asarray(atlas.get_mesh_chart(0, i).faces)] = i
    return chart, total


def _lend_uv(texels, indices, faces, charts, points):
    """Corners [F, 3, 2]; faces that xatlas ignored borrow coordinates, which is harmless only while they have no area."""
    flat = texels[indices]
    ignored = np.flatnonzero(charts < 0)
    corner = points[faces[ignored]].astype(np.float64)
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    if np.abs(cross).max(initial=0.0) > 1e-10:
        raise SystemExit(4)
    lent = np.zeros((int(faces.max()) + 1, 2), np.float32)
    lent[faces[charts >= 0].ravel()] = flat[charts >= 0].reshape(-1, 2)
    flat[ignored] = lent[faces[ignored, :1]]
    return flat
