"""Keyframes of animations without those that interpolation gives anyway (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...io.gltf.accessor import read_accessor

if TYPE_CHECKING:
    from ...io.container.rewritten import Rewritten
    from ...io.gltf.document import Document

TOLERANCE = 1e-5  # of a quaternion's components, and of the range of other values
_WORTH = 200  # bytes: times of its own take an accessor in the text
_KINDS = ("SCALAR", "VEC2", "VEC3", "VEC4")


def reduce_keyframes(document: Document, out: Rewritten) -> int:
    """Leave out keyframes that are within TOLERANCE of the interpolation of those that stay.

    Parameters
    ----------
    document : Document
        The source.
    out : Rewritten
        Its copy, whose animation samplers change.

    Returns
    -------
    int
        Number of keyframes left out.
    """
    count = 0
    for number, animation in enumerate(document.entries("animations")):
        paths: dict[int, set] = {}
        for channel in animation.get("channels", []):
            paths.setdefault(channel.get("sampler"), set()).add(channel.get("target", {}).get("path"))
        for sampler, entry in enumerate(animation.get("samplers", [])):
            of_sampler = paths.get(sampler, {None})
            if len(of_sampler) == 1 and not of_sampler & {None, "weights", "pointer"}:
                count += _reduce(document, out, entry, out.root["animations"][number]["samplers"][sampler],
                                 of_sampler == {"rotation"})
    return count


def _reduce(document, out, entry, copy, is_rotation):
    """Reduce the keyframes of a sampler; return how many are left out."""
    times = read_accessor(document, entry.get("input"), ("SCALAR",))[:, 0]
    stored = read_accessor(document, entry.get("output"), _KINDS)
    mode = entry.get("interpolation", "LINEAR")
    if mode not in ("LINEAR", "STEP") or len(times) != len(stored) or len(times) < 3 \
            or {times.dtype, stored.dtype} != {np.dtype(np.float32)} \
            or not (np.isfinite(times).all() and np.isfinite(stored).all() and (np.diff(times) > 0).all()):
        return 0
    kept = kept_keys(times.astype(np.float64), stored.astype(np.float64), mode, is_rotation)
    if (len(times) - len(kept)) * stored.shape[1] * 4 < _WORTH:
        return 0
    number = out.add_accessor(times[kept, None].astype(np.float32), "SCALAR")
    out.root["accessors"][number] |= {"min": [float(times[kept[0]])], "max": [float(times[kept[-1]])]}
    copy["input"] = number
    copy["output"] = out.add_accessor(stored[kept], document.entry("accessors", entry["output"])["type"])
    for key in ("input", "output"):
        out.copy_labels(entry[key], copy[key])
    return len(times) - len(kept)


def kept_keys(times: np.ndarray, values: np.ndarray, mode: str, is_rotation: bool) -> np.ndarray:
    """Return the keyframes to keep.

    Parameters
    ----------
    times : float64 [N]
        Ascending.
    values : float64 [N, C]
        Quaternions if is_rotation.
    mode : {"LINEAR", "STEP"}
        Interpolation.
    is_rotation : bool
        Whether LINEAR is spherical.

    Returns
    -------
    int64 [K]
        Ascending, the first and the last among them.
    """
    tolerance = TOLERANCE * (1.0 if is_rotation else float(np.ptp(values, axis=0).max()))
    kept, last = [0], len(times) - 1
    while kept[-1] < last:
        begin, reach, step = kept[-1], kept[-1] + 1, 1
        while step and reach < last:  # gallop, then halve
            there = min(reach + step, last)
            if _fits(times, values, begin, there, mode, is_rotation, tolerance):
                reach, step = there, 2 * step
            else:
                step //= 2
        kept.append(reach)
    return np.array(kept)


def _fits(times, values, begin, end, mode, is_rotation, tolerance):
    """Return whether the keys between two are within the tolerance of the interpolation of these."""
    first, last, between = values[begin], values[end], values[begin + 1 : end]
    if mode == "STEP":
        return bool((np.abs(between - first) <= tolerance).all())
    share = ((times[begin + 1 : end] - times[begin]) / (times[end] - times[begin]))[:, None]
    if not is_rotation:
        return bool((np.abs(first + share * (last - first) - between) <= tolerance).all())
    cosine = float(first @ last)
    last, cosine = (-last, -cosine) if cosine < 0 else (last, cosine)
    angle = np.arccos(min(cosine, 1.0))
    if angle > 1.5:  # a wide turn keeps its keys: its plane is uncertain
        return False
    shown = first + share * (last - first) if angle < 1e-6 else \
        (np.sin((1 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)
    shown = shown * np.sign((shown * between).sum(axis=1, keepdims=True))
    return bool((np.abs(shown - between) <= tolerance).all())
