"""Jumps of colour at chart borders on the surface, as a viewer shows them: bilinear, at mip levels 0 to 4."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...scene.scene import WRAP_CLAMP, WRAP_MIRROR, Texture
from ...scene.srgb import linear_to_srgb, srgb_to_linear

LEVELS = 5
POINTS = 100_000  # most places compared
_LINEAR = srgb_to_linear(np.arange(256) / 255).astype(np.float32)


def measure_seams(positions: np.ndarray, faces: np.ndarray, corner_uv: np.ndarray, textures: Sequence[Texture],
                  face_image: np.ndarray) -> dict[str, Any]:
    """Measure how much colours jump across chart borders: edges that two faces share and that are at two places of the images.

    positions: any [V, 3], equal for vertices at the same point of the surface; faces: int64 [F, 3]; corner_uv: float64 [F, 3, 2];
    textures: images sRGB-coded, uint8 [H, W, 3 or 4]; face_image: int64 [F], index of each face's texture. Points are evenly
    spaced along the borders, a texel of level 0 apart, but at most POINTS. Levels are made as in viewers: halved by a box filter
    and looked up in linear light. A jump is the largest difference of R, G and B, in steps of 8-bit sRGB values.
    Returns {"border_edges": int, "points": int, "mean", "largest": jumps, a float for every mip level}.
    """
    sizes = np.array([texture.image.shape[1::-1] for texture in textures], np.int64).reshape(-1, 2)
    half, ends = border_edges(positions, np.asarray(faces, np.int64), np.asarray(corner_uv, np.float64), face_image)
    image, uv = _points_along(face_image[half // 3], ends, sizes)
    mean, largest = [0.0] * LEVELS, [0.0] * LEVELS
    if uv.shape[1]:
        jumps = [np.abs(a - b).max(axis=1) for a, b in _shown(textures, image, uv)]
        mean, largest = [round(float(j.mean()), 3) for j in jumps], [round(float(j.max()), 3) for j in jumps]
    return {"border_edges": half.shape[1], "points": uv.shape[1], "mean": mean, "largest": largest}


def border_edges(positions: np.ndarray, faces: np.ndarray, corner_uv: np.ndarray,
                 face_image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges that two faces share and that are at two places of the images: (half-edges of both sides, int64 [2, n],
    number 3 f + i from corner i of face f to the next; their UVs, float64 [2, n, 2, 2], the same vertex first on both sides). If
    more than two faces share an edge, each is paired with the next."""
    return split_edges(positions, faces, corner_uv, face_image)[:2]


def split_edges(positions: np.ndarray, faces: np.ndarray, corner_uv: np.ndarray,
                face_image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (the two results of border_edges(); the edges inside the charts, at which two faces meet in the image too: pairs of
    half-edges int64 [2, m], in any order)."""
    first, rank = _welded(positions)
    half = _shared_edges(first[faces])
    apart = _apart(half, first[faces.ravel()], corner_uv) | (face_image[half[0] // 3] != face_image[half[1] // 3])
    border, corner_rank = half[:, apart], rank[faces].ravel()
    start, end = corner_rank[border], corner_rank[_after(border)]
    order = np.lexsort((np.maximum(start, end)[0], np.minimum(start, end)[0]))
    border, backwards = border[:, order], (start > end)[:, order, None, None]
    uv = corner_uv.reshape(-1, 2)
    ends = np.stack([uv[border], uv[_after(border)]], axis=2)
    return border, np.where(backwards, ends[:, :, ::-1], ends), half[:, ~apart]


def _shared_edges(vertex):
    """All pairs of half-edges that share an edge of the surface, int64 [2, n]. vertex: int64 [F, 3], welded."""
    start, end = vertex.ravel(), np.roll(vertex, -1, axis=1).ravel()
    edge = np.minimum(start, end) << 32 | np.maximum(start, end)
    edge[start == end] = -1
    order = np.argsort(edge, kind="stable")  # quick, because neighbours in a mesh have neighbouring numbers
    edge = edge[order]
    shared = (edge[1:] == edge[:-1]) & (edge[1:] >= 0)
    return np.stack([order[:-1][shared], order[1:][shared]])


def _after(half):
    """The next half-edge of the same face."""
    return half + np.where(half % 3 == 2, -2, 1)


def _apart(half, vertex, corner_uv):
    """Return whether the ends of each pair of half-edges are at two places of the image, bool [n]. vertex: int64 [3 F]."""
    uv = np.ascontiguousarray(corner_uv).reshape(-1, 2).view(np.complex128)[:, 0]
    (left, right), (left_end, right_end) = half, _after(half)
    same = vertex[left] == vertex[right]
    apart = np.zeros(len(left), bool)
    for here, there in ((left, np.where(same, right, right_end)), (left_end, np.where(same, right_end, right))):
        off = uv[here] - uv[there]
        apart |= (np.abs(off.real) > 1e-9) | (np.abs(off.imag) > 1e-9)
    return apart


def _welded(positions):
    """(The first vertex at the position of each vertex, int64 [V]; the rank of the position by x, y and z, int64 [V])."""
    positions = np.asarray(positions)
    order = np.lexsort(positions.T[::-1])
    fresh = np.ones(len(order), bool)
    fresh[1:] = (positions[order[1:]] != positions[order[:-1]]).any(axis=1)
    first, rank = np.empty((2, len(order)), np.int64)
    rank[order] = np.cumsum(fresh) - 1
    first[order] = order[fresh][rank[order]]
    return first, rank


def _points_along(image, ends, sizes):
    """(images int64 [2, M], UVs float64 [2, M, 2]) of points along the borders, on both sides."""
    if not image.shape[1]:
        return image, np.zeros((2, 0, 2))
    length = np.linalg.norm((ends[:, :, 1] - ends[:, :, 0]) * sizes[image], axis=2).max(axis=0)
    total = np.cumsum(length)
    count = min(int(np.ceil(total[-1])), POINTS)
    place = (np.arange(count) + 0.5) * (total[-1] / max(count, 1))
    edge = np.minimum(np.searchsorted(total, place), len(total) - 1)
    share = np.clip((total[edge] - place) / np.maximum(length[edge], 1e-30), 0, 1)[:, None]
    return image[:, edge], ends[:, edge, 0] * share + ends[:, edge, 1] * (1 - share)


def _shown(textures, image, uv):
    """Yields the colours at the points on both sides, level by level: float32 [2, M, 3], sRGB-coded 0..255."""
    levels = [_LINEAR[texture.image[..., :3]] for texture in textures]
    for _ in range(LEVELS):
        out = np.zeros((*image.shape, 3), np.float32)
        for number, texture in enumerate(textures):
            here = image == number
            out[here] = _bilinear(levels[number], uv[here], texture.wrap)
        yield (255 * linear_to_srgb(out)).astype(np.float32)
        levels = [_halved(level) for level in levels]


def _halved(level):
    """The next mip level: means of 2 x 2 texels; a last row or column without a partner is left out, a side of 1 stays."""
    for axis in range(2):
        size = level.shape[axis]
        if size > 1:
            even, odd = (np.take(level, np.arange(k, size - size % 2, 2), axis) for k in range(2))
            level = (even + odd) * np.float32(0.5)
    return level


def _bilinear(level, uv, wrap):
    """Bilinear look-ups float32 [M, 3]. level: float32 [H, W, 3]; uv: float64 [M, 2]."""
    size = np.array(level.shape[1::-1])
    place = uv * size - 0.5
    low = np.floor(place).astype(np.int64)
    share = (place - low).astype(np.float32)
    x, y = ([_wrapped(low[:, k] + step, size[k], wrap[k]) for step in range(2)] for k in range(2))
    u, v = share[:, :1], share[:, 1:]
    upper, lower = (level[row, x[0]] * (1 - u) + level[row, x[1]] * u for row in y)
    return upper * (1 - v) + lower * v


def _wrapped(index, size, mode):
    if mode == WRAP_CLAMP:
        return np.clip(index, 0, size - 1)
    if mode == WRAP_MIRROR:
        index = index % (2 * size)
        return np.where(index < size, index, 2 * size - 1 - index)
    return index % size
