"""A decoded GLB against its source, from outside: both loaded again, their flat colours compared part by part, and what the
source holds beside the decoded file. python tools/proof/public_models/measure.py SOURCE DECODED.glb; one JSON object on stdout.

A part is what has a material of the source. Where it looks wrong by the nearest surface at all, the decoded surface of the same
material answers, and points at which the source contradicts itself (surfaces that lie in each other) do not count.
"""

import json
import math
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from texfcodec.core.colour_error import ColourError
from texfcodec.geometry.areas import relative_areas, sample_surface
from texfcodec.geometry.mesh import face_normals
from texfcodec.io.load import load
from texfcodec.metrics.views import MeshColours
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_MASK, ALPHA_OPAQUE
from tools.proof.public_models.holdings import unnamed_things

POINTS = 20_000  # of a part
PARTS = 40  # the largest of a scene
GOOD_ENOUGH = 40.0  # dB; above it nobody asks which surface answered
SAME = 6.0  # levels of 255 by which the source may differ from itself at a point that counts


def compare(source, mesh):
    """Compare two Scenes by material; return [{"material", "share", "points", "rgb", "y", "alpha", "ambiguous"}]. rgb, y: PSNR
    in dB, None if exact; points: that count; with 0, none being visible or reliable, rgb and y are missing; alpha: mean error
    0..1; share: of the area; ambiguous: share of points at which the source contradicts itself."""
    areas = relative_areas(source.positions, source.faces)
    by_material = np.bincount(source.face_material, areas, len(source.materials))
    total, parts = by_material.sum(), []

    @cache
    def colours(which, name):
        """MeshColours of the surfaces of a material's name in "mesh" or "source", of all where there is none."""
        scene = {"mesh": mesh, "source": source}[which]
        keep = np.isin(scene.face_material, [m for m, material in enumerate(scene.materials) if material.name == name])
        return MeshColours(scene if name is None or not keep.any() else _only(scene, keep))

    for m in np.argsort(-by_material)[:PARTS]:
        if by_material[m] > 0:
            result = _compare_part(source, int(m), colours)
            parts.append({"material": source.materials[m].name, "share": round(float(by_material[m] / total), 6), **result})
    return parts


def _only(scene, keep):
    """The scene with the faces of a mask."""
    colour = None if scene.corner_color is None else scene.corner_color[keep]
    return replace(scene, faces=scene.faces[keep], face_material=scene.face_material[keep], corner_uv=scene.corner_uv[keep],
                   corner_color=colour)


def _compare_part(source, m, colours):
    faces, material = np.flatnonzero(source.face_material == m), source.materials[m]
    rows, bary = sample_surface(source.positions, source.faces[faces], POINTS)
    corners = source.positions[source.faces[faces[rows]]]
    points, normals = np.einsum("mk,mkc->mc", bary, corners), face_normals(corners)
    wanted = sample_source(pack_source(source), faces[rows], bary)
    weights = _weights(material, wanted)
    result = _error(wanted, colours("mesh", None).query(points, normals), weights)
    if result.get("rgb", GOOD_ENOUGH) is None or result.get("rgb", GOOD_ENOUGH) >= GOOD_ENOUGH:
        return result | {"ambiguous": 0.0}
    itself = colours("source", material.name or None).query(points, normals)
    doubtful = np.abs(itself - wanted).max(axis=1) > SAME
    weights = np.where(doubtful, 0.0, weights)
    return _error(wanted, colours("mesh", material.name or None).query(points, normals), weights) | {
        "ambiguous": round(float(doubtful.mean()), 4)}


def _weights(material, wanted):
    """How much of a point is seen."""
    alpha = wanted[:, 3] / 255.0
    if material.alpha_mode == ALPHA_OPAQUE:
        return np.ones(len(wanted))
    return (alpha >= material.alpha_cutoff).astype(float) if material.alpha_mode == ALPHA_MASK else alpha.astype(float)


def _error(wanted, got, weights):
    counted = int(np.count_nonzero(weights))
    alpha = round(float(np.abs(wanted[:, 3] - got[:, 3]).mean()) / 255, 5)
    if not counted:
        return {"points": 0, "alpha": alpha}
    error = ColourError()
    error.add(wanted[:, :3], got[:, :3], weights)
    rgb, y = (None if value == math.inf else value for value in map(error.result().get, ("psnr_rgb", "psnr_y")))
    return {"points": counted, "rgb": rgb, "y": y, "alpha": alpha}


def measured(source, mesh):
    """Return the differences of two files, a source and a decoded mesh: parts (of compare()), faces, size, and what was lost."""
    scene, decoded = load(source), load(mesh)
    boxes = [np.ptp(side.positions[side.faces.ravel()], axis=0) for side in (scene, decoded)]
    size = float(np.abs(boxes[0] - boxes[1]).max() / max(boxes[0].max(), 1e-300))
    return {"parts": compare(scene, decoded), "faces": [len(scene.faces), len(decoded.faces)], "size": round(size, 5),
            "holds": unnamed_things(Path(source), Path(mesh))}


if __name__ == "__main__":
    print(json.dumps(measured(*sys.argv[1:]), allow_nan=False))
