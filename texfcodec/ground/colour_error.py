"""Colour error at corresponding samples (3D-PSNR) and the surface points to take it at.

Colours are sRGB-coded RGB in 0..255, as floats; nothing is rounded or clipped. YUV is BT.709, full range. PSNR has peak 255;
it is float("inf") where the error is exactly zero, and `json_ready` writes that as null, which in_decibels() says as "exact".
"""

import math

import numpy as np

PEAK = 255.0
EXACT = "exact"  # the one word for a match without any error, where a PSNR is infinite; lossless is a way of coding
BLOCK = 1 << 16  # samples per step: 64 Ki rows of three doubles stay near the cache, whatever the total

# Rows Y, U, V for full-range BT.709; U and V lack their offset of 128, which cancels in every difference.
_KR, _KG, _KB = 0.2126, 0.7152, 0.0722
RGB_TO_YUV = np.array(
    [
        [_KR, _KG, _KB],
        [-_KR / (2 - 2 * _KB), -_KG / (2 - 2 * _KB), 0.5],
        [0.5, -_KG / (2 - 2 * _KR), -_KB / (2 - 2 * _KR)],
    ]
)


class ColourError:
    """Running colour error over any number of samples, in the memory of one block.

    add() as often as needed, then result(). The sums do not depend on how the samples were cut into calls, except in the last
    bits of the float64 sums.
    """

    def __init__(self):
        self.samples = 0
        self._weight = 0.0
        self._squares = np.zeros(6)  # y, u, v, r, g, b

    def add(self, ref, got, weights=None):
        """Take in ref, got: [N, 3] RGB in 0..255 (any real dtype); weights: [N] non-negative, or None for 1 each.

        Raises ValueError for shapes that do not agree and for values that are not finite.
        """
        ref, got = np.asarray(ref), np.asarray(got)
        if ref.ndim != 2 or ref.shape[1] != 3 or ref.shape != got.shape:
            raise ValueError(f"colours must both be [N, 3], not {list(ref.shape)} and {list(got.shape)}")
        if weights is not None:
            weights = np.asarray(weights, dtype=np.float64)
            if weights.shape != ref.shape[:1]:
                raise ValueError(f"weights must be [{len(ref)}], not {list(weights.shape)}")
            if not (np.isfinite(weights).all() and (weights >= 0).all()):
                raise ValueError("weights must be finite and not negative")
        for start in range(0, len(ref), BLOCK):
            part = slice(start, start + BLOCK)
            difference = got[part].astype(np.float64) - ref[part].astype(np.float64)
            squares = np.hstack([difference @ RGB_TO_YUV.T, difference]) ** 2
            if not np.isfinite(squares).all():
                raise ValueError(f"a colour among samples {start} to {start + len(difference) - 1} is not finite")
            w = np.ones(len(difference)) if weights is None else weights[part]
            self._squares += w @ squares
            self._weight += float(w.sum())
        self.samples += len(ref)

    def mse(self):
        """Weighted mean squared errors {"y", "u", "v", "rgb"}; rgb is the mean over samples and channels."""
        if self._weight <= 0:
            raise ValueError("no samples (or only samples of weight zero): there is no error to report")
        y, u, v, r, g, b = (self._squares / self._weight).tolist()
        return {"y": y, "u": u, "v": v, "rgb": (r + g + b) / 3}

    def result(self):
        """{"samples", "mse_y", "mse_u", "mse_v", "mse_rgb", "psnr_y", "psnr_u", "psnr_v", "psnr_yuv611", "psnr_rgb"}."""
        mse = self.mse()
        return {"samples": self.samples, **{f"mse_{k}": m for k, m in mse.items()}, **psnr_of_mse(mse)}


def colour_mse(ref, got, weights=None):
    """Mean squared errors {"y", "u", "v", "rgb"} of got against ref; arguments as in ColourError.add."""
    error = ColourError()
    error.add(ref, got, weights)
    return error.mse()


def psnr_3d(ref, got, weights=None):
    """PSNR in dB {"psnr_y", "psnr_u", "psnr_v", "psnr_yuv611", "psnr_rgb"} of got against ref at the same surface points."""
    return psnr_of_mse(colour_mse(ref, got, weights))


def psnr_of_mse(mse):
    """PSNR values of a colour_mse() dict; psnr_yuv611 is (6 Y + U + V) / 8 of the three values in dB, not of the errors."""
    y, u, v, rgb = (decibels(mse[k]) for k in ("y", "u", "v", "rgb"))
    return {"psnr_y": y, "psnr_u": u, "psnr_v": v, "psnr_yuv611": (6 * y + u + v) / 8, "psnr_rgb": rgb}


def decibels(mse, peak=PEAK):
    """10 log10(peak^2 / mse); inf for mse 0."""
    if not mse >= 0:
        raise ValueError(f"a mean squared error cannot be {mse}")
    return math.inf if mse == 0 else 10 * math.log10(peak * peak / mse)


def json_ready(result):
    """The dict with infinite values (exact) as None, because JSON has no infinity."""
    return {k: None if isinstance(v, float) and math.isinf(v) else v for k, v in result.items()}


def in_decibels(value, digits=2):
    """A PSNR of json_ready() for people: "34.20 dB", or EXACT for None."""
    return EXACT if value is None else f"{value:.{digits}f} dB"


def sample_surface(positions, faces, count, seed=0, areas=None):
    """Points spread evenly by area over a triangle mesh.

    positions: [V, 3] finite; faces: [F, 3] indices. Returns face_index int64 [count], ascending, and bary float64 [count, 3],
    non-negative, summing to 1 (to rounding), in the faces' corner order. One point falls into each of `count` equal strips of
    the cumulative area, so a face with the share s of all area gets floor(s count) - 1 to ceil(s count) + 1 points, and one
    without area gets none. areas: of relative_areas, where many calls are made. The same arguments give the same points.

    Raises ValueError for bad indices, corners that are not finite, and meshes without area.
    """
    positions, faces = np.asarray(positions, dtype=np.float64), np.asarray(faces)
    if count < 0:
        raise ValueError(f"count must not be negative, not {count}")
    if positions.ndim != 2 or positions.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"positions and faces must be [V, 3] and [F, 3], not {list(positions.shape)}, {list(faces.shape)}")
    if faces.dtype.kind not in "iu" or (len(faces) and not (faces.min() >= 0 and faces.max() < len(positions))):
        raise ValueError(f"faces must hold integers from 0 to {len(positions) - 1}")
    if count == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    cumulative = np.cumsum(relative_areas(positions, faces) if areas is None else areas)
    if not len(cumulative) or not cumulative[-1] > 0:
        raise ValueError("the mesh has no face with area to sample")
    rng = np.random.default_rng(seed)
    target = (np.arange(count) + rng.random(count)) * (cumulative[-1] / count)
    face_index = np.searchsorted(cumulative, target, side="right")  # "right" steps over faces whose area is zero
    last = np.searchsorted(cumulative, cumulative[-1], side="left")  # rounding may lift the last target to the total
    face_index = np.minimum(face_index, last).astype(np.int64)
    root, t = np.sqrt(rng.random(count)), rng.random(count)
    return face_index, np.stack([1 - root, root * (1 - t), root * t], axis=1)


def relative_areas(positions, faces):
    """Face areas float64 [F] in units of the squared largest extent, so that no scale (1e-300 to 1e300) over- or underflows."""
    corners = positions[faces].reshape(-1, 3)
    if not np.isfinite(corners).all():
        raise ValueError("positions must be finite")
    if not corners.any():
        return np.zeros(len(faces))
    corners = corners / np.abs(corners).max()  # first, so that the extent below is at most 2
    corners -= corners.min(axis=0)
    if not corners.any():
        return np.zeros(len(faces))
    a, b, c = np.moveaxis((corners / corners.max()).reshape(-1, 3, 3), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
