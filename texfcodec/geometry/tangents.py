"""Tangents of face corners, for normal maps of files without tangents: MikkTSpace, as glTF requires, except in how it splits
groups.

A corner's tangent is the direction in which u grows, projected to the plane of its normal. It is averaged over the faces that
meet there with the same position, UV and normal, weighted by their angles. Mirrored charts are averaged separately.
"""

import numpy as np

from ..core.distinct import distinct

FLAT = 1e-30  # what is shorter, in world units or products of UVs, has no direction
MIX = np.int64(0x1E3779B97F4A7C15)  # an odd factor that spreads bits


def corner_tangents(positions: np.ndarray, faces: np.ndarray, corner_uv: np.ndarray, corner_normal: np.ndarray) -> np.ndarray:
    """Unit tangents float32 [F, 3, 4] of every face corner, orthogonal to its normal. The last column is the bitangent's sign s,
    1 or -1: the bitangent is s cross(normal, tangent) and points to where v falls, as v points down in glTF.

    positions: float64 [V, 3]; faces: int64 [F, 3]; corner_uv: float64 [F, 3, 2]; corner_normal: float32 [F, 3, 3], unit. Corners
    of faces whose UVs have no area, or are not finite, get zeros. If the directions at a corner cancel or are parallel to its
    normal, the tangent is an arbitrary direction orthogonal to the normal.
    """
    corners = _finite(positions)[faces]
    uv, normal = _finite(corner_uv), _unit(_finite(corner_normal).reshape(-1, 3))[0]
    along, sign = _face_tangents(corners, uv)
    flat, is_direction = _unit(_within(np.repeat(along, 3, axis=0), normal))
    weight = np.where(is_direction, _angles(corners, normal), 0)
    group = _groups(corners.reshape(-1, 3), uv.reshape(-1, 2), normal, np.repeat(sign, 3))
    total = np.stack([np.bincount(group, weight * flat[:, k]) for k in range(3)], axis=1) if len(group) else np.zeros((0, 3))
    tangent, is_direction = _unit(_within(total[group], normal))
    tangent[~is_direction] = _across(normal[~is_direction])
    handed = np.where(is_direction & (np.repeat(sign, 3) < 0), -1.0, 1.0)
    out = np.column_stack([tangent, handed]).astype(np.float32).reshape(-1, 3, 4)
    out[~has_uv_area(corner_uv)] = 0.0
    return out


def has_uv_area(corner_uv: np.ndarray) -> np.ndarray:
    """Return whether the triangle of each face's UVs has an area: bool [F]. corner_uv: [F, 3, 2], integers or reals. Exact for
    integers below 2**25."""
    with np.errstate(invalid="ignore", over="ignore"):
        u, v = corner_uv[:, 1] - corner_uv[:, 0], corner_uv[:, 2] - corner_uv[:, 0]
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.isfinite(area) & (area != 0)


def _finite(values):
    return np.nan_to_num(np.asarray(values, np.float64), nan=0.0, posinf=0.0, neginf=0.0)


def _face_tangents(corners, uv):
    """(directions [F, 3] in which u grows, unit or zero; sign [F] of the chart with v upwards: 1, -1, 0 without area)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (u1, v1), (u2, v2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    sign = np.sign(u2 * v1 - u1 * v2)
    along, is_direction = _unit((v2[:, None] * first - v1[:, None] * second) * -sign[:, None])
    return along, np.where(is_direction, sign, 0)


def _angles(corners, normal):
    """Angles [3 F] at the corners, between the edges projected to the plane of the normal."""
    normal = normal.reshape(-1, 3, 3)
    edges = [_unit(_within(np.roll(corners, -turn, axis=1) - corners, normal))[0] for turn in (1, 2)]
    return np.arccos(np.clip(np.einsum("fck,fck->fc", *edges), -1, 1)).ravel()


def _groups(*columns):
    """Group number int64 [N] of each row: rows of one group are equal in all columns."""
    bits = [(column + 0.0).view(np.int64) for column in np.column_stack(columns).T]  # one pattern for each value, 0 and -0 alike
    mixed = np.zeros(len(bits[0]), np.int64)
    for column in bits:
        mixed = (mixed ^ column) * MIX
        mixed ^= mixed >> 29
    group = distinct(mixed)[1]
    row = np.zeros(len(group), np.int64)
    row[group] = np.arange(len(group))
    if all((column[row[group]] == column).all() for column in bits):
        return group
    group[:] = 0  # two rows that differ are mixed alike
    for column in bits:
        group = distinct(group * (len(group) + 1) + distinct(column)[1])[1]
    return group


def _within(vectors, normal):
    """Components of vectors in the plane of the normals."""
    return vectors - np.sum(vectors * normal, axis=-1, keepdims=True) * normal


def _unit(vectors):
    """(vectors scaled to length 1, or 0 for those too short for a direction; whether each has a direction)."""
    largest = np.abs(vectors).max(axis=-1, keepdims=True)  # first, so that no square is out of range
    scaled = vectors / np.where(largest > FLAT, largest, 1)
    length = np.sqrt(np.sum(scaled * scaled, axis=-1, keepdims=True))
    is_direction = (largest > FLAT) & (length > 0)
    return np.where(is_direction, scaled / np.where(is_direction, length, 1), 0.0), is_direction[..., 0]


def _across(normal):
    """An arbitrary unit direction orthogonal to each normal [N, 3]; x for a normal of length 0."""
    axis = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    return _unit(_within(axis, normal))[0]
