"""Whether a decoder's tangent frames, which it makes of UVs, are those that the file's TANGENTs mean: where they are not, a
normal map points elsewhere, and that is said (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.areas import face_areas
from ...geometry.tangents import corner_tangents
from ...render.tangent_frames import interpolate_corners, tangent_space_normals
from ..decision import Decision
from ..shown_maps import NORMAL, Frames, turn_of, turned
from .normal_rules import ENOUGH, POINTS, quantiles, tolerance_of

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Scene
    from ..texel_field import TexelPlan
    from .normal_rules import Shading

SAMPLES = 20_000  # points, evenly by area
ELSEWHERE = 10.0  # degrees that nobody takes for the same normal


def judge_frames(scene: Scene, surface: Surface, shading: Shading, plans: list[TexelPlan], qp: float) -> Decision[None]:
    """Says how far the normals that light sees are off where a normal map lies over texels, the map itself being exact.

    Only where the file has TANGENTs, for others have the decoder's frames. plans: of the fields over texels; qp: of colours.
    """
    errors = _errors(scene, surface, shading, plans) if scene.corner_tangent is not None else np.zeros(0)
    if not len(errors):
        return Decision(None, {})
    degrees = [round(value, 3) for value in quantiles(errors, np.ones(len(errors)), POINTS)]
    share = round(float((errors > ELSEWHERE).mean()), 4)
    evidence = {"mapped_degrees": degrees, "mapped_elsewhere": share}
    allowed = max(tolerance_of(qp), 1.0)
    if degrees[0] <= ENOUGH[0] * allowed and degrees[1] <= ENOUGH[1] * allowed:
        return Decision(None, evidence)
    warning = (f"normal maps point elsewhere than the file's TANGENTs say: half of their surface is off by {degrees[0]} degrees "
               f"or more, a twentieth by {degrees[1]}, {100 * share:.2g} % by more than {ELSEWHERE:.0f}; TANGENTs by MikkTSpace "
               "of the same UVs cure it, and so does --support voxels")
    return Decision(None, evidence, warnings=(warning,))


def _errors(scene, surface, shading, plans):
    """Degrees at points of faces over texels with a normal map, float64 [N]."""
    mapped = np.array([NORMAL in material.maps and not material.unlit for material in scene.materials], bool)
    faces = [plan.group.faces[mapped[surface.material[plan.group.faces]]] for plan in plans if NORMAL in plan.group.maps]
    total = sum(map(len, faces))
    if not total:
        return np.zeros(0)
    frames, areas = Frames(scene, surface, shading), face_areas(surface.lattice, surface.faces)
    whole = sum(float(areas[part].sum()) for part in faces)
    return np.concatenate([_errors_of(frames, part, round(SAMPLES * float(areas[part].sum()) / max(whole, 1e-300)), areas)
                           for part in faces if len(part)])


def _errors_of(frames, faces, count, areas):
    """The same of the faces of one plan, at so many points."""
    rng = np.random.default_rng(0)
    edges = np.cumsum(areas[faces])
    at = faces[np.minimum(np.searchsorted(edges, (np.arange(count) + 0.5) / max(count, 1) * edges[-1]), len(faces) - 1)]
    bary = rng.dirichlet(np.ones(3), count)
    texel, scale = frames.texels(NORMAL, at, bary)
    turn = turn_of(frames.scene, frames.surface, faces)
    uv = frames.scene.map_uv.get(NORMAL, frames.scene.corner_uv)[frames.surface.origin_face[faces]]
    tangent = np.zeros((len(areas), 3, 4), np.float32)
    tangent[faces] = corner_tangents(frames.surface.lattice.astype(np.float64), frames.surface.faces[faces], uv,
                                     frames.rebuilt[faces])
    got = tangent_space_normals(turned(texel, turn), scale, interpolate_corners(frames.rebuilt, at, bary),
                                interpolate_corners(tangent, at, bary), frames.geometric[at])
    apart = np.linalg.norm(got.astype(np.float64) - frames.bent(NORMAL, at, bary), axis=1)
    return np.degrees(2 * np.arcsin(np.minimum(apart / 2, 1.0)))
