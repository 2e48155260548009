"""Parts, which every reader produces, and their assembly into a Scene, with the checks that every mesh passes."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import InputError, LimitError
from ..limits import Limits
from ..report import plural
from ..scene.scene import ALPHA_BLEND, ALPHA_OPAQUE, Material, Scene, Texture
from ..scene.srgb import srgb_to_linear
from .authored_normals import fill_normals
from .colour_range import clipped
from .corner_maps import fill_corner_maps
from .vertex_pools import VertexPools
from .visibility import name_invisible

MAX_FACES = 1 << 26  # instancing lets a small file ask for any number; beyond this no machine we know would follow
UV_OUTLIER = 1e6


class Notes:
    """Messages of a reader, each once and in order. Losses change the picture: warnings are sentences, dropped are names. Remarks
    are sentences on what changes no picture.

    strict: whether faults are errors; limits: of images and of a stream that a file carries; path: of the mesh's file, None
    without a name; folders: entries of each folder, kept by file_search.py; encoding: of the names in the mesh's text, if a file
    with such a name revealed it, else None."""

    def __init__(self, strict: bool = False, limits: Limits | None = None) -> None:
        self.strict, self.limits = strict, limits or Limits()
        self.path: Path | None = None
        self.folders: dict[Path, dict[str, list[str]]] = {}
        self.encoding: str | None = None
        self._warnings: dict[str, None] = {}
        self._dropped: dict[str, None] = {}
        self._remarks: dict[str, None] = {}

    def remark(self, sentence: str) -> None:
        """Record a sentence on something that changes no picture."""
        self._remarks[sentence] = None

    def warn(self, sentence: str) -> None:
        """Record a sentence on something that will look different."""
        self._warnings[sentence] = None

    def drop(self, name: str) -> None:
        """Record the name of something in the file that is not carried into the stream."""
        self._dropped[name] = None

    def lose(self, name: str, sentence: str) -> None:
        """Record a loss: the name of something missing, unread or guessed, and a warning that states what is shown instead."""
        self.drop(name)
        self.warn(sentence)

    def fault(self, code: str, message: str, name: str, **details: object) -> None:
        """Report a fault that the reader can repair: raise InputError of this code if strict, else record the message as a
        warning and the name as dropped. details: values for the error's report."""
        if self.strict:
            raise InputError(code, message, **details)
        self.lose(name, f"{message} ({code})")

    def check_pixels(self, count: int, name: str) -> None:
        """Raise LimitError TXF-I40 if an image has more pixels than limits allow. count: width * height; name: of the image."""
        if self.limits.image_pixels is not None and count > self.limits.image_pixels:
            raise self.too_many_pixels(count, name)

    def too_many_pixels(self, count: int | None, name: str) -> LimitError:
        """Return the error for an image with too many pixels. count: width * height, None if unknown; name: of the image."""
        return LimitError("TXF-I40", f"image '{name}' has more pixels than the limit allows", value=count,
                          allowed=self.limits.image_pixels)

    @property
    def warnings(self) -> list[str]:
        return list(self._warnings)

    @property
    def dropped(self) -> list[str]:
        return list(self._dropped)

    @property
    def remarks(self) -> list[str]:
        return list(self._remarks)


@dataclass
class Part:
    """Triangles of one vertex pool, in world space.

    positions: float [V, 3]; faces: integer [F, 3]; material: index, or integer [F];
    uv: float [V, 2] or [F, 3, 2] in glTF convention, or None; color: float32 linear RGBA [V, 4] or [F, 3, 4], or None;
    label: name in messages; map_uv: as uv, by channel name, for channels with other UVs; normal: float [V, 3] or [F, 3, 3] of any
    length, or None; tangent: float [V, 4] or [F, 3, 4], or None; influences: (joints, weights), each [V, J], of a skin that is
    not applied yet, or None; rows: int64 [V], index of each vertex in the file, for messages, or None if it is the same; maps:
    further channels by name (channels.CORNER_MAPS), float [V, C] or [F, 3, C], linear, 0..1.
    """

    positions: np.ndarray
    faces: np.ndarray
    material: object = 0
    uv: np.ndarray | None = None
    color: np.ndarray | None = None
    label: str = "mesh"
    map_uv: dict = field(default_factory=dict)
    normal: np.ndarray | None = None
    tangent: np.ndarray | None = None
    influences: tuple[np.ndarray, np.ndarray] | None = None
    rows: np.ndarray | None = None
    maps: dict = field(default_factory=dict)


def drop_alpha(color: np.ndarray | None, notes: Notes) -> None:
    """Record in notes that alpha is dropped if any is below 1, for formats that define no transparency. color: [..., 4] or
    None."""
    if color is not None and (color[..., 3] < 1).any():
        notes.drop("alpha of the colours (the format does not define transparency)")


def alpha_mode_of(factor: np.ndarray) -> int:
    """Alpha mode of a material in a format without alpha modes: it blends if its alpha is below 1. factor: base colour, [4]."""
    return ALPHA_BLEND if factor[3] < 1.0 else ALPHA_OPAQUE


def linear_rgba(coded: np.ndarray) -> np.ndarray:
    """Return colours as linear RGBA, float32 [..., 4], alpha unchanged, 1 if absent. coded: [..., 1..4], sRGB-coded in [0, 1]:
    grey, grey + alpha, RGB or RGBA."""
    coded = np.asarray(coded)
    out = np.ones(coded.shape[:-1] + (4,), np.float32)
    channels = coded.shape[-1]
    out[..., :3] = srgb_to_linear(coded[..., :3] if channels > 2 else coded[..., :1])
    if channels in (2, 4):
        out[..., 3] = np.clip(coded[..., -1], 0.0, 1.0)
    return out


def linearise_factors(factors: list[np.ndarray], exporter: str, where: str, notes: Notes) -> None:
    """Convert base colours of a format that does not define their coding to linear, in place. They are taken as sRGB-coded, as
    viewers do, unless Blender wrote them, whose colours are linear.

    factors: float64 [4] each; exporter: text that names the file's exporter; where: the file's kind, for the remark.
    """
    if "blender" in exporter.lower():
        if any(((0 < factor[:3]) & (factor[:3] < 1)).any() for factor in factors):
            notes.remark(f"colours of the {where} are read as linear, as Blender writes them; many viewers show them darker")
        return
    for factor in factors:
        factor[:3] = srgb_to_linear(np.clip(factor[:3], 0.0, 1.0))


def assemble(parts: list[Part], materials: list[Material], textures: list[Texture], notes: Notes,
             metadata: dict | None = None, pools: VertexPools | None = None) -> Scene:
    """Join Parts into a Scene, check indices and numbers, and remove vertices that no face uses.

    pools: the vertex pools that the Parts come from, to count unused vertices; None if each Part has all of its own vertices.
    Errors: TXF-I13 face index out of range, TXF-I14 NaN or infinite vertex in use, TXF-I15 no triangles,
    TXF-I18 NaN or infinite UV (strict only), LimitError TXF-I41 too many faces.
    """
    parts = [part for part in parts if len(part.faces)]
    count = sum(len(part.faces) for part in parts)
    if not count:
        raise no_triangles()
    check_face_count(count)
    scene = _empty_scene(count, parts, materials, textures, metadata)
    unused, broken = pools.unused() if pools is not None else (0, 0)
    points, row, base = [], 0, 0
    for part in parts:
        rows = slice(row, row + len(part.faces))
        kept, faces, left_out, left_out_broken = _used_vertices(part)
        np.add(faces, base, out=scene.faces[rows])
        _fill_attributes(scene, part, rows)
        points.append(kept)
        row, base = rows.stop, base + len(kept)
        if pools is None:
            unused, broken = unused + left_out, broken + left_out_broken
    scene.positions = np.concatenate(points)
    _fill_map_uv(scene, parts)
    _repair_uv(scene, notes)
    _repair_color(scene, notes)
    fill_corner_maps(scene, parts, notes)
    fill_normals(scene, parts, notes)
    _report_geometry(scene, unused, broken, notes)
    name_invisible(scene, notes)
    scene.warnings, scene.dropped, scene.remarks = notes.warnings, notes.dropped, notes.remarks
    return scene


def no_triangles(holds: str = "") -> InputError:
    """The error TXF-I15. holds: contents of the input, such as "800 points", or ""."""
    return InputError("TXF-I15", "the input has no triangles" + (f": it has {holds}" if holds else ""))


def check_face_count(count: int) -> None:
    """Raises LimitError TXF-I41 for more than MAX_FACES faces."""
    if count > MAX_FACES:
        raise LimitError("TXF-I41", "the input has too many faces", value=int(count), allowed=MAX_FACES)


def _empty_scene(count, parts, materials, textures, metadata):
    colored = any(part.color is not None for part in parts)
    return Scene(
        positions=np.zeros((0, 3)),
        faces=np.empty((count, 3), np.int64),
        face_material=np.empty(count, np.int64),
        corner_uv=np.zeros((count, 3, 2)),
        corner_color=np.ones((count, 3, 4), np.float32) if colored else None,
        materials=materials,
        textures=textures,
        metadata=metadata or {},
    )


def _used_vertices(part):
    """(used positions, faces into them, number of vertices left out, number of those that are not finite)."""
    points = np.asarray(part.positions, np.float64).reshape(-1, 3)
    faces = np.asarray(part.faces).astype(np.int64, copy=False)
    if faces.min() < 0 or faces.max() >= len(points):
        row = int(np.argmax(((faces < 0) | (faces >= len(points))).any(axis=1)))
        raise InputError("TXF-I13", f"a face of {part.label} refers to a vertex that does not exist",
                         face=row, value=faces[row].tolist(), vertices=len(points))
    used = np.zeros(len(points), bool)
    used[faces] = True
    broken = ~np.isfinite(points).all(axis=1)
    if (broken & used).any():
        first = int(np.argmax(broken & used))
        raise InputError("TXF-I14", f"vertices of {part.label} in use are NaN or infinite",
                         count=int((broken & used).sum()), first=first if part.rows is None else int(part.rows[first]))
    if used.all():
        return points, faces, 0, 0
    return points[used], (np.cumsum(used) - 1)[faces], int((~used).sum()), int(broken.sum())


def _fill_attributes(scene, part, rows):
    scene.face_material[rows] = part.material
    if part.uv is not None:
        scene.corner_uv[rows] = _at_corners(part.uv, part.faces)
    if part.color is not None:
        scene.corner_color[rows] = _at_corners(part.color, part.faces)


def _fill_map_uv(scene, parts):
    """Fill scene.map_uv for channels whose maps have other UVs than the material's on some face; other faces keep the
    material's."""
    row = 0
    for part in parts:
        rows = slice(row, row + len(part.faces))
        for name, uv in part.map_uv.items():
            if name not in scene.map_uv:
                scene.map_uv[name] = scene.corner_uv.copy()
            scene.map_uv[name][rows] = 0 if uv is None else _at_corners(uv, part.faces)
        row = rows.stop


def _at_corners(values, faces):
    return values[faces] if values.ndim == 2 else values


def _repair_uv(scene, notes):
    """Set UVs without a texture to zero, and broken UVs too, with a fault; far UVs stay, with a warning."""
    textured = np.array([max([material.texture, *material.maps.values()]) >= 0 for material in scene.materials], bool)
    for uv in (scene.corner_uv, *scene.map_uv.values()):
        if not textured.all():
            uv[~textured[scene.face_material]] = 0.0
        _repair_one_uv(uv, notes)


def _repair_one_uv(corner_uv, notes):
    low, high = corner_uv.min(), corner_uv.max()
    if not (np.isfinite(low) and np.isfinite(high)):
        bad = ~np.isfinite(corner_uv).all(axis=2)
        count = int(bad.sum())
        notes.fault("TXF-I18", plural(count, "face corner has", "face corners have") + " NaN or infinite UVs; (0, 0) is used "
                    "instead", "texture coordinates (NaN or infinite)", count=count)
        corner_uv[bad] = 0.0
        low, high = corner_uv.min(), corner_uv.max()
    if max(-low, high) > UV_OUTLIER:
        far = int((np.abs(corner_uv) > UV_OUTLIER).any(axis=2).sum())
        notes.warn(plural(far, "face corner has", "face corners have") + f" UVs beyond {UV_OUTLIER:.0e}; they are kept, but "
                   "sampling there is imprecise")


def _repair_color(scene, notes):
    """Clamp colours to [0, 1], with a remark (glTF 3.7.2.1); NaN becomes 1, a neutral factor, with a loss."""
    color = scene.corner_color
    if color is None:
        return
    bad = np.isnan(color)
    if bad.any():
        count = int(bad.any(axis=2).sum())
        notes.lose("colours of vertices (NaN)",
                   plural(count, "face corner has", "face corners have") + " NaN vertex colours; 1 is used instead")
        color[bad] = 1.0
    scene.corner_color = clipped(color, notes, "colours of vertices")


def _report_geometry(scene, unused, broken, notes):
    if unused:
        tail = f", {broken} of them NaN or infinite" if broken else ""
        notes.remark(plural(unused, "vertex that no face uses is", "vertices that no face uses are") + f" left out{tail}")
    a, b, c = scene.faces.T
    degenerate = int(((a == b) | (b == c) | (c == a)).sum())
    if degenerate:
        notes.remark(plural(degenerate, "face uses", "faces use") + " the same vertex twice (degenerate)")
