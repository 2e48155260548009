"""Agreement of a decoder's tangent frames, which it derives from UVs, with those of the file's TANGENTs and normals (encoder
only).

If they differ, a normal map would point elsewhere: its texels are rotated into the decoder's frame, at no cost in bytes. Texels
that faces of different frames share, as the halves of a mirrored model do, cannot be right for all of them. They get the mean by
area, or the faces whose frame is far off become a field of their own, if the picture gains more than that costs. The remaining
error is reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...core.kernel import kernel
from ...field.texel_set import referenced_texels, shown_area
from ...geometry.areas import face_areas
from ...geometry.tangents import corner_tangents
from ...render.tangent_frames import tangent_space_normals
from ...scene.channels import NORMAL_MAPS
from ...scene.factors import FLAT
from ...scene.fetch import values_of_map, wrapped
from ..decision import Decision
from ..faces import SentFaces
from ..prepare.channel_weights import shown_of_radians
from ..supports.texel_means import texel_means
from ..supports.texel_plan import SentPlan
from ..values.shown_maps import NORMAL, Frames, frame_rotation
from .normal_rules import ENOUGH, POINTS, quantiles, tolerance_of

if TYPE_CHECKING:
    from ...scene.scene import Scene
    from ..caches import Cache
    from ..faces import SentSurface
    from ..price import Lagrangian
    from .normal_rules import Shading

SAMPLES = 20_000  # points, evenly by area
ELSEWHERE = 10.0  # degrees that nobody takes for the same normal
OFF = 0.05  # of a matrix between two frames, three degrees: faces from here on have their texels turned
FAR = 0.5  # of it: other hands, or turned by more than a fifth of a right angle: what cannot share texels with the others
CLIP = 30.0  # degrees: what is further off looks no worse
PARTS, FEW_TEXELS = 4, 8  # of each edge of a face whose corners need different things, if it covers more than so many texels
FRACTION_BITS = 4  # of UVs under which texels are rotated; faces are divided into parts before
CORNERS = np.eye(3)
BLOCK = 1 << 16  # faces at a time
LEAST_SHARE = 1e-4  # of the surface: fewer such faces are left alone
# What turning has to gain, in dB of the lit picture, and what as many texels again have to, which faces of other frames are given
# for themselves: 3.3 dB of the fan cost 40 % from r03 to r04.
LEAST_GAIN, DECIBELS_A_DOUBLING = 0.02, 6.0


@dataclass(frozen=True)
class _Mapped:
    """Faces of a plan with a normal map, and frames of their corners, columns along u, along v and outwards, of the source and of
    a decoder. faces: [N]; uv: float64 [N, 3, 2], texels of the group's image; area: float64 [N]; source,
    decoder: float32 [N, 3, 3, 3]."""

    plan: SentPlan
    faces: SentFaces
    uv: np.ndarray
    area: np.ndarray
    source: np.ndarray
    decoder: np.ndarray

    def between(self, faces: np.ndarray | slice = slice(None), bary: np.ndarray = CORNERS) -> np.ndarray:
        """Return the matrices that turn the source's tangent frame into the decoder's at points of some faces, float64 [N, P, 3,
        3]; the unit matrix if either frame is flat. bary: float64 [P, 3], the same for all faces."""
        source, decoder = (np.ascontiguousarray(axes[faces]) for axes in (self.source, self.decoder))
        out = np.empty((len(source), len(bary), 3, 3))
        _turns(source, decoder, np.ascontiguousarray(bary, np.float64), out)
        return out

    @cached_property
    def apart(self) -> np.ndarray:
        """Return the largest difference between the frames of each face, float64 [N]."""
        blocks = [self.between(slice(begin, begin + BLOCK)) for begin in range(0, len(self.faces), BLOCK)]
        return np.concatenate([np.sqrt(((block - np.eye(3)) ** 2).sum(axis=(2, 3))).max(axis=1) for block in blocks])

    def in_two(self, apart: np.ndarray) -> list[SentPlan]:
        """Return the plan as two plans: of the faces in apart, bool [N] over those with a normal map, and of all other faces."""
        group = self.plan.group
        chosen = np.isin(group.faces, self.faces[apart])
        return [replace(self.plan, group=replace(group, faces=SentFaces(group.faces[part]), uv=group.uv[part]))
                for part in (~chosen, chosen) if part.any()]


def fit_frames(scene: Scene, surface: SentSurface, shading: Shading, plans: list[SentPlan], price: Lagrangian,
               cache: Cache) -> Decision[list[SentPlan]]:
    """Return the Decision on plans whose normal maps are rotated from the frames of the file's TANGENTs into those of a decoder.
    A plan becomes two if that pays. The evidence has the remaining error of the normals that light sees, the maps themselves
    being exact.

    Only files with TANGENTs need it, because all others have the decoder's frames. shading: gives the decoder's normals; plans:
    TexelPlans; cache: of fitted plans.
    """
    if scene.corner_tangent is None or not any(NORMAL in plan.group.maps for plan in plans):
        return Decision(plans, {})
    frames, digest = Frames(scene, surface, partial(shading.corner_normals, surface)), surface.digest
    keys = [_FrameKey(price.qp, digest, shading.signature, plan.signature) for plan in plans]
    fitted = [cache.get(key, partial(_fitted, frames, plan, price)) for key, plan in zip(keys, plans, strict=True)]
    bent = [fit for fit in fitted if fit.area]
    flat = [plan for fit in fitted for plan in fit.plans]
    return _judged(flat, bent, price.qp) if bent else Decision(flat, {})


class _FrameKey(NamedTuple):
    """Everything beside the scene that fitting a plan to frames depends on."""

    qp: int
    surface: bytes
    shading: tuple
    plan: tuple


@dataclass(frozen=True)
class _Fitted:
    """The result of fitting a plan. errors: degrees at points float64 [M]; area: of the faces with a normal map; turned:
    texels."""

    plans: list[SentPlan]
    errors: np.ndarray = field(default_factory=lambda: np.zeros(0))
    area: float = 0.0
    turned: int = 0


def _fitted(frames, plan, price):
    """Return the _Fitted of a plan: unchanged, with rotated texels, or in two, so that faces off their frame share texels with no
    others."""
    mapped = _mapped(frames, plan)
    if mapped is None:
        return _Fitted([plan])
    best = _Fitted([mapped.plan], _errors(frames, [mapped], [mapped.plan]), float(mapped.area.sum()))
    shown = shown_of_radians(frames.scene.weights)
    error = lambda errors: shown * float((np.radians(np.minimum(errors, CLIP)) ** 2).mean())
    for least in (OFF, FAR):  # all together; then those that are far off for themselves
        apart = mapped.apart > least
        if not mapped.area[apart].sum() > LEAST_SHARE * best.area or price.gain(error(best.errors), 0.0) < LEAST_GAIN:
            break
        parts = [mapped] if least == OFF else [_mapped(frames, plan) for plan in mapped.in_two(apart)]
        if None in parts:
            break  # all that the map bends is apart already
        tried = [_turned(frames, part) for part in parts]
        errors = _errors(frames, parts, [plan for plan, _ in tried])
        more = sum(_texels(part.plan) for part in parts) / _texels(mapped.plan) - 1 if len(parts) > 1 else 0.0
        if price.gain(error(best.errors), error(errors)) > DECIBELS_A_DOUBLING * more + LEAST_GAIN:
            best = _Fitted([plan for plan, _ in tried], errors, best.area, sum(turned for _, turned in tried))
    return best


def _texels(plan):
    """Return the number of texels that the faces of a plan cover."""
    uv = plan.corner_uv().reshape(-1, 2)
    return len(referenced_texels(uv, np.arange(len(uv)).reshape(-1, 3), plan.fraction_bits, plan.size, plan.group.wrap))


def _judged(plans, bent, qp):
    """Return the Decision on plans. bent: _Fitted of those that have a normal map."""
    errors = np.concatenate([fit.errors for fit in bent])
    weight = np.concatenate([np.full(len(fit.errors), fit.area / len(fit.errors)) for fit in bent])
    degrees = [round(value, 3) for value in quantiles(errors, weight, POINTS)]
    share = round(float(np.average(errors > ELSEWHERE, weights=weight)), 4)
    evidence = {"mapped_degrees": degrees, "mapped_elsewhere": share, "turned_texels": sum(fit.turned for fit in bent),
                "split_fields": sum(len(fit.plans) > 1 for fit in bent)}
    allowed = max(tolerance_of(qp), 1.0)
    if degrees[0] <= ENOUGH[0] * allowed and degrees[1] <= ENOUGH[1] * allowed:
        return Decision(plans, evidence)
    warning = (f"normal maps differ in direction from the file's TANGENTs, by {degrees[0]} degrees or more on half of their "
               f"surface and {degrees[1]} on 5 % ({100 * share:.2g} % differ by more than {ELSEWHERE:.0f}); recompute the "
               "TANGENTs with MikkTSpace from the same UVs, or encode with --support voxels")
    return Decision(plans, evidence, warnings=(warning,))


def _mapped(frames, plan):
    """Return the _Mapped of a plan, None if no face of it is bent by a normal map."""
    scene, surface, group = frames.scene, frames.surface, plan.group
    bent = np.array([NORMAL in material.maps and not material.unlit for material in scene.materials], bool)
    chosen = bent[surface.material[group.faces]]
    if NORMAL not in group.maps or not chosen.any():
        return None
    faces, rebuilt = group.faces[chosen], frames.rebuilt[group.faces[chosen]]
    tangents = corner_tangents(surface.lattice.astype(np.float64), surface.faces[faces], plan.corner_uv()[chosen], rebuilt)
    decoder, rotation = _axes(tangents, rebuilt), frame_rotation(scene, surface, group.faces)
    if rotation is not None:
        decoder[..., :2] = decoder[..., :2] @ rotation.astype(np.float32)
    source = _axes(frames.tangent(NORMAL)[faces], frames.normal[faces])
    area = face_areas(surface.lattice, surface.faces[faces])
    return _Mapped(plan, faces, group.uv[chosen], area, source, decoder) if area.any() else None


@kernel
def _det(m):
    """Return the determinant of a matrix [3, 3]."""
    return (m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]) - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]))


@kernel
def _frame_at(axes, bary, hands, frame):
    """Fill frame [3, 3] with that of a point, as a shader interpolates it from the corners', [3, 3, 3]: directions and hands are
    interpolated, and normalised. hands: [3], signs of the corners' determinants."""
    hand = 0.0
    for k in (0, 2):
        square = 0.0
        for i in range(3):
            value = 0.0
            for c in range(3):
                value += bary[c] * axes[c, i, k]
            frame[i, k] = value
            square += value * value
        length = max(math.sqrt(square), 1e-12)
        for i in range(3):
            frame[i, k] /= length
    for c in range(3):
        hand += bary[c] * hands[c]
    side = -1.0 if hand < 0 else 1.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        frame[i, 1] = side * (frame[j, 2] * frame[k, 0] - frame[k, 2] * frame[j, 0])


@kernel(allocates=True)
def _turns(source, decoder, bary, out):
    """Fill out float64 [N, P, 3, 3] with the matrices that turn frames of the source into those of a decoder, both float32 [N, 3,
    3, 3], at points float64 [P, 3] of each face; the unit matrix if either frame is flat."""
    hands, a, b = np.empty((2, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(source.shape[0]):
        for c in range(3):
            hands[0, c], hands[1, c] = np.sign(_det(source[n, c])), np.sign(_det(decoder[n, c]))
        for p in range(bary.shape[0]):
            _frame_at(source[n], bary[p], hands[0], a)
            _frame_at(decoder[n], bary[p], hands[1], b)
            whole = _det(b)
            if abs(whole) <= OFF or abs(_det(a)) <= OFF:
                for i in range(3):
                    for j in range(3):
                        out[n, p, i, j] = 1.0 if i == j else 0.0
                continue
            for i in range(3):  # rows of the inverse of b are cross products of its columns
                j, k = (i + 1) % 3, (i + 2) % 3
                x = (b[1, j] * b[2, k] - b[2, j] * b[1, k]) / whole
                y = (b[2, j] * b[0, k] - b[0, j] * b[2, k]) / whole
                z = (b[0, j] * b[1, k] - b[1, j] * b[0, k]) / whole
                for column in range(3):
                    out[n, p, i, column] = x * a[0, column] + y * a[1, column] + z * a[2, column]


def _axes(tangent, normal):
    """Return frames [N, P, 3, 3] of tangents [N, P, 4] and normals [N, P, 3]."""
    along = tangent[..., :3]
    across = np.cross(normal, along) * np.where(tangent[..., 3:] < 0, np.float32(-1), np.float32(1))
    return np.stack([along, across, normal], axis=-1)


def _errors(frames, parts, plans):
    """Return degrees between the source's normals and those of a decoder, at SAMPLES points evenly over the faces of _Mapped
    parts, with the normal maps of their plans: float64 [N]."""
    counts = [SAMPLES * float(part.area.sum()) / sum(float(each.area.sum()) for each in parts) for part in parts]
    return np.concatenate([_errors_of(frames, part, plan, max(round(count), 1))
                           for part, plan, count in zip(parts, plans, counts, strict=True)])


def _errors_of(frames, mapped, plan, count):
    """Return the same of one part, at `count` points."""
    edges = np.cumsum(mapped.area)
    at = np.minimum(np.searchsorted(edges, (np.arange(count) + 0.5) / count * edges[-1]), len(edges) - 1)
    bary = np.random.default_rng(0).dirichlet(np.ones(3), count)
    faces = mapped.faces[at]
    texel, scale = _bilinear(plan.group, NORMAL, np.einsum("nc,ncd->nd", bary, mapped.uv[at])), frames.scale(NORMAL, faces)
    frame = np.einsum("nc,ncij->nij", bary, mapped.decoder[at]).astype(np.float32)
    hand = np.where(np.linalg.det(frame) < 0, np.float32(-1), np.float32(1))
    got = tangent_space_normals(texel, scale, frame[..., 2], np.column_stack([frame[..., 0], hand]), frames.geometric[faces])
    apart = np.linalg.norm(got.astype(np.float64) - frames.bent(NORMAL, faces, bary), axis=1)
    return np.degrees(2 * np.arcsin(np.minimum(apart / 2, 1.0)))


def _neighbours(place, size, wrap):
    """Return texels around places [N, 2], in texels of an image of `size`: (flat index int64 [N], weight float64 [N]) four
    times."""
    low = np.floor(place - 0.5)
    share = place - 0.5 - low
    columns, rows = ([wrapped(low[:, k].astype(np.int64) + step, size[k], wrap[k]) for step in (0, 1)] for k in (0, 1))
    for j, row in enumerate(rows):
        for i, column in enumerate(columns):
            yield row * size[0] + column, np.abs(1 - i - share[:, 0]) * np.abs(1 - j - share[:, 1])


def _bilinear(group, name, place):
    """Return x and y of a group's normal map, float32 [N, 2] in 0..255, at places [N, 2] in texels of the group's image."""
    image = group.maps[name]
    size = image.shape[1], image.shape[0]
    flat = image.reshape(-1, image.shape[2])
    return values_of_map(name, sum(weight[:, None] * flat[index] for index, weight in
                                   _neighbours(place * (np.array(size) / group.size), size, group.wrap)))


def _turned(frames, mapped):
    """Return (the plan with normal maps in the decoder's frame for faces whose frames differ, the number of changed texels)."""
    off = mapped.apart > OFF
    if not off.any():
        return mapped.plan, 0
    maps, group, changed = dict(mapped.plan.group.maps), mapped.plan.group, 0
    parts, others = _divided(mapped, np.flatnonzero(off)), (mapped.uv[~off], mapped.area[~off])
    for name in sorted(NORMAL_MAPS & set(maps)):
        image = maps[name].copy()
        size = image.shape[1], image.shape[0]
        texels, matrices = mean_matrices(parts, others, np.array(size) / group.size, size, group.wrap)
        scale = float(np.average(frames.scale(name, mapped.faces[off]), weights=mapped.area[off]))
        flat = image.reshape(-1, image.shape[2])
        flat[texels, :3] = rotate_normal_map(values_of_map(name, flat[texels]), matrices, scale)
        maps[name], changed = image, changed + len(texels)
    return replace(mapped.plan, group=replace(group, maps=maps)), changed


def _divided(mapped, faces):
    """Return (uv float64 [M, 3, 2], matrices between the frames of their corners [M, 3, 3, 3], area [M]) of some faces, the
    larger ones divided if their matrices change from corner to corner: frames turn over on the middle line of mirrored
    models."""
    between, (u, v) = mapped.between(faces), ((mapped.uv[faces, corner] - mapped.uv[faces, 0]).T for corner in (1, 2))
    bent = np.abs(between - between[:, :1]).max(axis=(1, 2, 3)) > OFF
    bent &= np.abs(u[0] * v[1] - u[1] * v[0]) / 2 > FEW_TEXELS
    even, uneven = faces[~bent], faces[bent]
    points = np.array([(i, j, PARTS - i - j) for i in range(PARTS + 1) for j in range(PARTS + 1 - i)]) / PARTS
    number = {tuple(np.rint(PARTS * point).astype(int)): k for k, point in enumerate(points)}
    corner = lambda i, j: number[i, j, PARTS - i - j]
    up = [(corner(i, j), corner(i + 1, j), corner(i, j + 1)) for i in range(PARTS) for j in range(PARTS - i)]
    down = [(corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)) for i in range(PARTS) for j in range(PARTS - 1 - i)]
    parts = np.array(up + down)
    uv = np.einsum("pc,ncd->npd", points, mapped.uv[uneven])[:, parts].reshape(-1, 3, 2)
    matrices = mapped.between(uneven, points)[:, parts].reshape(-1, 3, 3, 3)
    area = np.repeat(mapped.area[uneven] / len(parts), len(parts))
    return (np.concatenate([mapped.uv[even], uv]), np.concatenate([between[~bent], matrices]),
            np.concatenate([mapped.area[even], area]))


def mean_matrices(off: tuple[np.ndarray, np.ndarray, np.ndarray], others: tuple[np.ndarray, np.ndarray], scale: np.ndarray,
                  size: tuple[int, int], wrap: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each texel of a normal map that some faces show, the mean of the matrices that these faces need.

    Parameters
    ----------
    off : (float64 [N, 3, 2], float64 [N, 3, 3, 3], float64 [N])
        UVs of faces that need a rotation, the matrix of each of their corners, and their areas.
    others : (float64 [M, 3, 2], float64 [M])
        UVs and areas of the faces that need the unit matrix.
    scale : float64 [2]
        From UVs to texels of the image.
    size, wrap : (int, int)
        (width, height) of the image; its modes.

    Returns
    -------
    (int64 [T], float64 [T, 3, 3])
        Texels as flat indices into the image, and the mean, by area, of the matrices of all faces that show each; none if the
        image repeats too often (texel_means).
    """
    steps = [np.floor(uv * (scale * (1 << FRACTION_BITS)) + 0.5).astype(np.int64) for uv in (off[0], others[0])]
    means = texel_means(steps[0], off[1].reshape(-1, 3, 9), off[2], FRACTION_BITS, size, wrap)
    corners = steps[1].reshape(-1, 2)
    right = shown_area(corners, np.arange(len(corners)).reshape(-1, 3), FRACTION_BITS, size, wrap, others[1])
    share = (means.area / (means.area + right.reshape(-1)[means.texel]))[:, None]
    return means.texel, (share * means.mean + (1 - share) * np.eye(3).ravel()).reshape(-1, 3, 3)


def rotate_normal_map(texels: np.ndarray, matrices: np.ndarray, scale: float) -> np.ndarray:
    """Return the tangent-space normals of texels after a change of their frames.

    Parameters
    ----------
    texels : float32 [T, 2]
        x and y, 0..255; z follows from length 1.
    matrices : float64 [T, 3, 3]
        From the old frame into the new.
    scale : float
        Of the map, glTF's normalTexture.scale, which stays.

    Returns
    -------
    float64 [T, 3]
        Whole numbers in 0..255, of length 1 as directions. A normal that would point inwards lies in the plane.
    """
    xy = texels.astype(np.float64) / FLAT - 1
    normal = np.column_stack([scale * xy, np.sqrt(np.maximum(1 - (xy**2).sum(axis=1), 0.0))])
    normal = np.einsum("nij,nj->ni", matrices, normal)
    normal[:, 2] = np.maximum(normal[:, 2], 0.0)
    normal[:, :2] /= scale or 1.0
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    return np.clip(np.rint((normal + 1) * FLAT), 0, 255)
