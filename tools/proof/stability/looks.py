"""Cases of what a renderer and a metric see: normals, tangents, SSIM."""

import numpy as np

from oracles import ssim as naive_ssim
from texfcodec.geometry.shading_normals import corner_normals
from texfcodec.geometry.tangents import corner_tangents, has_uv_area
from texfcodec.metrics.ssim import C1, ssim, ssim_gradient
from texfcodec.render.tangent_frames import deviated_normals, tangent_space_normals, usable_normals
from texfcodec.scene.normal_rule import AREA, JOINED, NormalRule
from tools.proof.stability.case import Case, Draws

GROUP = "Normals, tangents, similarity"
ODD = (0.0, -0.0, 1.0, np.nan, np.inf, -np.inf, 1e-45, 1e-30, 1e30, 3e38)


def pole(draw: Draws) -> tuple:
    """Positions, faces, UVs and normals of a fan around a pole: UVs that meet there in any way, or have no area; normals that are
    radial, zero or not finite; any scale."""
    count = draw.integer(3, 8)
    angle = np.arange(count) * 2 * np.pi / count
    height = draw.pick((0.0, 1.0, 1e-9, draw.real(0, 1)))
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    scale = draw.power(-25, 150)
    positions = np.concatenate([[[0, 0, height]], rim])
    faces = np.array([[0, 1 + i, 1 + (i + 1) % count] for i in range(count)])
    uv = np.array([[[(i + 0.5) / count, 0], [i / count, 1], [(i + 1) / count, 1]] for i in range(count)])
    normal = positions + [0, 0, 0.3]
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True))[faces].astype(np.float32)
    for _ in range(draw.integer(0, 3)):
        row, corner = draw.integer(0, count - 1), draw.integer(0, 2)
        what = draw.integer(0, 3)
        if what == 0:
            uv[row] = uv[row, 0]
        elif what == 1:
            uv[row, corner] = draw.pick(ODD), draw.pick(ODD)
        elif what == 2:
            normal[row, corner] = draw.pick(ODD)
        else:
            uv[row] *= draw.power(-30, 30)
    return positions * scale, faces, uv, normal


def frames_at_poles(draw: Draws) -> float:
    """How far a tangent is from length 1, or from being orthogonal to a normal of length 1; infinite with another sign than 1 and
    -1. A face whose UVs have no area has none."""
    positions, faces, uv, normal = pole(draw)
    got = corner_tangents(positions, faces, uv, normal).astype(np.float64)
    area = has_uv_area(uv)
    if not np.isfinite(got).all() or (np.abs(got[area, :, 3]) != 1).any() or got[~area].any():
        return np.inf
    if not area.any():
        return 0.0
    along, normal = got[area, :, :3], normal[area]
    length = np.linalg.norm(normal.astype(np.float64), axis=2)
    sound = np.abs(length - 1) < 1e-6
    across = np.abs(np.einsum("fck,fck->fc", along, np.where(sound[..., None], normal, 0).astype(np.float64)))
    return float(max(np.abs(np.linalg.norm(along, axis=2) - 1).max(), across.max()))


def normals_of_faces(draw: Draws) -> float:
    """Degrees between the normal of a flat face and the cross product of its edges in unlimited integers."""
    lattice = draw.integers((3, 3), 0, (1 << 20) - 1)
    if draw.pick((True, False)):  # a sliver
        lattice[2] = np.clip(lattice[0] + (lattice[1] - lattice[0]) // 2 + draw.integers((3,), -1, 1), 0, (1 << 20) - 1)
    u, v = (lattice[1] - lattice[0]).tolist(), (lattice[2] - lattice[0]).tolist()
    exact = [u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3] for i in range(3)]
    rule = NormalRule(JOINED, AREA, draw.pick((0, 45, 180)))
    got = corner_normals(lattice, np.array([[0, 1, 2]]), [rule])[0].astype(np.float64)
    if not any(exact):
        return 0.0 if np.array_equal(got, np.tile([0, 0, 1.0], (3, 1))) else np.inf
    largest = max(map(abs, exact))
    want = np.array([e / largest for e in exact])
    want /= np.linalg.norm(want)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(got, want), axis=1), got @ want)).max())


def broken_vectors(draw: Draws, columns: int) -> np.ndarray:
    """Vectors float32 [8, columns] of usual and of odd numbers."""
    usual = draw.generator().normal(size=(8, columns))
    odd = np.array([[draw.pick(ODD) if draw.pick((True, False, False)) else v for v in row] for row in usual])
    return odd.astype(np.float32)


def normals_of_anything(draw: Draws) -> float:
    """How far a normal that is shaded with is from length 1, whatever the mesh and its maps hold."""
    normal, geometric, tangent = broken_vectors(draw, 3), broken_vectors(draw, 3), broken_vectors(draw, 4)
    texel = np.array(draw.reals((8, 2), 0, 255), np.float32)
    with np.errstate(all="ignore"):
        made = (usable_normals(normal, geometric), deviated_normals(broken_vectors(draw, 3), normal, geometric),
                tangent_space_normals(texel, draw.pick(ODD), normal, tangent, geometric))
        length = np.linalg.norm(np.concatenate(made).astype(np.float64), axis=1)
    return float(np.abs(length - 1).max()) if np.isfinite(length).all() else np.inf


def flat_pictures(draw: Draws) -> float:
    """How far SSIM of two pictures of one colour each is from its formula, and with one of noise in place of a colour from the
    double-precision oracle; infinite where its slope is not finite."""
    size, kind = draw.integer(1, 14), draw.pick((np.uint8, np.float32, np.float64))
    one, two = draw.pick((0, 255, draw.integer(0, 255))), draw.pick((0, 255, draw.integer(0, 255)))
    a, b = (np.full((size, size, 1), v, kind) for v in (one, two))
    noisy = draw.pick((True, False))
    if noisy:
        b[..., 0] = draw.generator().integers(0, 256, (size, size))
        everywhere = [[True] * size] * size
        want = naive_ssim.ssim_mean([a[..., 0].tolist()], [b[..., 0].astype(float).tolist()], everywhere)
    else:
        want = (2 * one * two + C1) / (one**2 + two**2 + C1)
    _, slope = ssim_gradient(a.astype(np.float32), b.astype(np.float32))
    return abs(ssim(a, b) - want) if np.isfinite(slope).all() else np.inf


CASES = (
    Case("tangents at poles", GROUP,
         "fans around a pole at any height and scale; UVs without area, huge, tiny or not finite; normals of zero length or not "
         "finite",
         2e-07, "of length 1",
         "Tangents are made unit and orthogonal in binary64 after their largest component is brought to 1, and rounded once to "
         "binary32: each component is off by 2^-25, a vector by less than 2^-24.",
         frames_at_poles, 30),
    Case("normals of thin faces", GROUP,
         "faces and slivers of any shape on a lattice of 20 bits",
         0.0243, "degrees",
         "Products of the cross product are below 2^41 and exact in binary64. A unit normal is rounded to steps of 1/2048: off "
         "by at most sqrt(3) / 4096, 0.0242 degrees, of the half degree that 8.4 allows. A face without area is told (+z).",
         normals_of_faces, 40),
    Case("normals of anything", GROUP,
         "zero, infinite, huge and tiny normals, tangents, maps and scales",
         3e-07, "of length 1",
         "A vector without a direction makes way for the next: map, interpolated normal, face, +z. What is divided by its "
         "length in binary32 is off by a few parts in 2^24.",
         normals_of_anything, 30),
    Case("SSIM of flat pictures", GROUP,
         "one colour each or against noise, black and white among them, 1 to 14 pixels a side, three types",
         0.002, "of SSIM",
         "Moments about mid grey are below 2^14 and summed over 22 taps in binary32: variances are off by at most 0.03, which "
         "beside the constant C2 = 58.5 is 0.0005 each of two variances and twice the covariance.",
         flat_pictures, 12),
)
