"""glTF animations: the nodes of a file in the pose of an animation at a time (glTF 2.0 sections 3.11 and C)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...decoder import decode_stream
from ...errors import InputError
from ...options import DecodeOptions
from ...report import Report
from ..container.expand import expand_bytes
from .accessor import read_accessor, read_floats
from .carried import read_carried
from .document import GLB_MAGIC, open_document
from .properties import integer, malformed, name_of, part, title
from .reader import check_required, scene_of_nodes

if TYPE_CHECKING:
    from ...limits import Limits
    from ...scene.scene import Scene
    from ..parts import Notes
    from .document import Document

POINTER = "KHR_animation_pointer"
_KINDS = {"translation": ("VEC3",), "rotation": ("VEC4",), "scale": ("VEC3",), "weights": ("SCALAR",)}  # by path
_MODES = ("LINEAR", "STEP", "CUBICSPLINE")
_NARROW = 1e-4  # radians: below it a linear interpolation of quaternions is exact in float32


def plain_glb(data: bytes, folder: Path, limits: Limits) -> bytes:
    """Return the bytes of a glTF file with its coded primitives expanded; other files as they are. Raises InputError TXF-I29 for
    other formats, and the errors of texfcodec.expand()."""
    if data[:4] != GLB_MAGIC and data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")[:1] != b"{":
        raise InputError("TXF-I29", "only a .glb or .gltf file has animations", value=data[:4].hex())
    options = DecodeOptions(limits=limits)
    return expand_bytes(data, folder, lambda stream: decode_stream(stream, options, Report()), "png")


def read_posed(data: bytes, folder: Path, notes: Notes, time: float, animation: str | None) -> Scene:
    """Return the Scene of a glTF file in the pose of an animation.

    Parameters
    ----------
    data : bytes
        A .glb or .gltf file without coded primitives.
    folder : Path
        Base of relative URIs.
    notes : Notes
        Gets the messages of the reader.
    time : float
        Seconds; before the first and after the last keyframe the pose is that of the keyframe.
    animation : str, optional
        Name or number; None for the first.

    Raises
    ------
    InputError
        TXF-I29 if the file has no such animation; else the errors of read_gltf().
    """
    document = open_document(data, folder, notes)
    check_required(document)
    pose(document, find_animation(document, animation), time)
    return scene_of_nodes(document, is_posed=True)


def find_animation(document: Document, animation: str | None) -> dict:
    """Return an animation of a file by its name or its number, the first for None. Raises InputError TXF-I29."""
    entries = [] if read_carried(document) else document.entries("animations")
    if not entries:
        raise InputError("TXF-I29", "the file has no animation", path=str(document.notes.path or "-"))
    if animation is None:
        return entries[0]
    numbers = [n for n, entry in enumerate(entries) if name_of(entry) == animation] or \
        [n for n in range(len(entries)) if str(n) == animation]
    if not numbers:
        raise InputError("TXF-I29", "the file has no such animation", value=animation[:80],
                         allowed=", ".join(title(entry, n) for n, entry in enumerate(entries[:20])))
    return entries[numbers[0]]


def pose(document: Document, animation: dict, time: float) -> None:
    """Set the transforms and morph weights of a file's nodes to those of an animation at a time in seconds.

    The document's nodes and meshes change and its animations go; a node with weights gets a mesh of its own. Channels of
    KHR_animation_pointer are named as not posed. Raises InputError TXF-I09 to I11 for animations that are malformed.
    """
    samplers = animation.get("samplers", [])
    for channel in animation.get("channels", []):
        target = part(channel, "target")
        path, number = target.get("path"), integer(channel, "sampler", low=0)
        if path == "pointer":
            pointer = part(part(target, "extensions"), POINTER).get("pointer")
            document.notes.warn(f"{POINTER}: {str(pointer)[:80]} is animated but not posed")
        elif path not in _KINDS or number >= len(samplers):
            raise malformed("a channel has no known path, or no sampler", value=str(path)[:20], sampler=number)
        elif "node" in target:
            node = document.entry("nodes", target["node"])
            if "matrix" in node:
                document.notes.warn(f"node {title(node, target['node'])} has a matrix, so its animation is not posed")
            else:
                node[path] = _value(document, samplers[number], path, time).tolist()
    _give_weights(document)
    document.entries("animations").clear()


def _give_weights(document):
    """Move the morph weights of nodes to meshes, of which a node with weights gets its own."""
    meshes = document.entries("meshes")
    for node in document.entries("nodes"):
        weights = node.pop("weights", None)
        if weights is not None and "mesh" in node:
            meshes.append(document.entry("meshes", node["mesh"]) | {"weights": weights})
            node["mesh"] = len(meshes) - 1


def _value(document, sampler, path, time):
    """Value of a sampler at a time, float64 [W]."""
    mode = sampler.get("interpolation", "LINEAR")
    times = read_accessor(document, sampler.get("input"), ("SCALAR",))[:, 0].astype(np.float64)
    values = np.asarray(read_floats(document, sampler.get("output"), _KINDS[path]), np.float64)
    rows = len(times) * (3 if mode == "CUBICSPLINE" else 1)  # in-tangent, value, out-tangent
    if mode not in _MODES or not np.isfinite(times).all() or not np.isfinite(values).all() or (np.diff(times) < 0).any():
        raise malformed("a sampler has an unknown interpolation, or keyframes that are NaN, infinite or not in order",
                        value=str(mode)[:20])
    if path == "weights" and len(values) % rows == 0:
        values = values.reshape(rows, -1)
    if len(values) != rows:
        raise malformed("a sampler has another number of values than of times", value=len(values), allowed=rows)
    return interpolated(times, values.reshape(len(times), -1, values.shape[1]), mode, float(np.float32(time)), path == "rotation")


def interpolated(times: np.ndarray, values: np.ndarray, mode: str, time: float, is_rotation: bool = False) -> np.ndarray:
    """Return the value between keyframes.

    Parameters
    ----------
    times : float64 [K]
        Ascending.
    values : float64 [K, 1, W] or [K, 3, W]
        Values; with mode "CUBICSPLINE" in-tangents, values and out-tangents.
    mode : {"LINEAR", "STEP", "CUBICSPLINE"}
        Interpolation.
    time : float
        Clamped to the times.
    is_rotation : bool
        Whether values are quaternions, whose LINEAR is spherical. A spline's quaternion is not normalised.

    Returns
    -------
    float64 [W]
        The value.
    """
    middle, last = values.shape[1] // 2, len(times) - 1
    key = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), last)
    first = values[key, middle]
    if mode == "STEP" or key == last or time <= times[key]:
        return first
    span, then = times[key + 1] - times[key], values[key + 1, middle]
    t = (time - times[key]) / span
    if mode == "CUBICSPLINE":
        return ((2 * t**3 - 3 * t**2 + 1) * first + span * (t**3 - 2 * t**2 + t) * values[key, 2]
                + (3 * t**2 - 2 * t**3) * then + span * (t**3 - t**2) * values[key + 1, 0])
    return _slerp(first, then, t) if is_rotation else (1 - t) * first + t * then


def _slerp(first, then, t):
    """Quaternion between two along the shorter arc."""
    cosine = float(first @ then)
    angle = np.arccos(min(abs(cosine), 1.0))
    then = -then if cosine < 0 else then
    if angle < _NARROW:
        return (1 - t) * first + t * then
    return (np.sin((1 - t) * angle) * first + np.sin(t * angle) * then) / np.sin(angle)
