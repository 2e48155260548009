"""Pictures: fragments get their colours, from the source's textures or from decoded fields.

A Texf stands in a later room, so that signatures here say Any.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..asset.sample import pack_source, sample_source
from ..ground.kernel import kernel
from .layers import composite, opacity, see_through
from .levels import pyramid_of
from .raster import Fragments, visible
from .triangles import set_up

if TYPE_CHECKING:
    from ..asset.scene import Scene
    from .camera import Camera

BLOCK = 1 << 16  # fragments shaded at a time


def box_down(image: np.ndarray, times: int) -> np.ndarray:
    """The picture at 1 / times of its size, each pixel the rounded mean of times x times coded values: uint8 [H, W, 3] ->
    uint8 [H // times, W // times, 3]."""
    height, width = image.shape[0] // times, image.shape[1] // times
    blocks = image[: height * times, : width * times].reshape(height, times, width, times, 3)
    return ((blocks.sum(axis=(1, 3), dtype=np.uint32) + times * times // 2) // (times * times)).astype(np.uint8)


@dataclass
class Picture:
    """What a camera saw, before rounding and without a background.

    width, height: pixels; pixel: int64 [M] ascending, row * width + column of the covered ones; colour: float32 [M, 3] RGB in
    0..255, sRGB-coded, straight; alpha: float32 [M], 0..1, below 1 only where nothing opaque stands behind what is seen through.
    """

    width: int
    height: int
    pixel: np.ndarray
    colour: np.ndarray
    alpha: np.ndarray

    def image(self, background: tuple[int, int, int] = (255, 255, 255)) -> np.ndarray:
        """uint8 [height, width, 3] over a background colour 0..255; what is not a number becomes 0."""
        out = np.empty((self.height * self.width, 3), np.uint8)
        out[:] = background
        _paint(self.pixel, self.colour, self.alpha, out)
        return out.reshape(self.height, self.width, 3)


def render_scene(scene: Scene, camera: Camera, cull: bool = True, threads: int = 1, source: tuple | None = None) -> Picture:
    """Picture of a Scene with its own textures (bilinear, as glTF defines them; no lighting).

    cull: leave out back faces of materials that are not double-sided; source: pack_source(scene), to use again for other views.
    Alpha: see layers.composite. A scene of which nothing is seen is an empty Picture.
    """
    source = pack_source(scene) if source is None else source
    triangles = set_up(camera, scene.positions, scene.faces, cull, _two_sided(scene.materials, scene.face_material))
    return _render(triangles, scene.materials, scene.face_material, threads,
                   lambda fragments: shade_source(source, fragments, threads))


def render_texf(texf: Any, camera: Camera, cull: bool = True, filtering: bool = True, threads: int = 1) -> Picture:
    """Picture of a decoded Texf; arguments as in render_scene() and shade_field(). A Texf without fields has no colour and is an
    empty Picture."""
    if not texf.fields:
        return Picture(camera.width, camera.height, np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    positions, faces, face_material = texf.positions, texf.faces, texf.face_material
    triangles = set_up(camera, positions, faces, cull, _two_sided(texf.materials, face_material))
    return _render(triangles, texf.materials, face_material, threads,
                   lambda fragments: shade_field(texf, camera, fragments, positions, faces, filtering, threads))


def shade_source(source: tuple, fragments: Fragments, threads: int = 1) -> np.ndarray:
    """Source colours float32 [M, 4] RGBA, 0..255. source: from pack_source; UVs that are not finite are read as 0."""
    if not np.isfinite(source[6]).all():
        source = (*source[:6], np.nan_to_num(source[6], nan=0.0, posinf=0.0, neginf=0.0), *source[7:])
    return sample_source(source, fragments.face, fragments.bary, threads)


def shade_field(texf: Any, camera: Camera, fragments: Fragments, positions: np.ndarray, faces: np.ndarray, filtering: bool = True,
                threads: int = 1) -> np.ndarray:
    """Field colours float32 [M, 4] RGBA, 0..255, each fragment asking the field of its face.

    positions: float64 [V, 3] world; faces: int64 [F, 3]: texf's own, or of the same faces in the same order. filtering: where a
    pixel is wider than a voxel, ask the coarser levels of the field around the pixel's width, mixed between the nearest two;
    elsewhere, and everywhere without filtering, this is exactly Texf.query at the fragments' points. Where two surfaces are
    closer than a coarse voxel, filtering mixes them, as lower levels of detail do.
    """
    out = np.zeros((len(fragments.face), 4), np.float32)
    positions, faces = np.ascontiguousarray(positions, np.float64), np.ascontiguousarray(faces, np.int64)
    if len(fragments.face) and (fragments.face.min() < 0 or fragments.face.max() >= len(faces)):
        raise IndexError("face index outside the mesh")
    which = texf.face_field[fragments.face] if len(texf.fields) > 1 else None
    deepest = fragments.depth.max(initial=0.0)
    for number, part in enumerate(texf.fields):
        chosen = np.arange(0) if which is None else np.flatnonzero(which == number)
        questions = _texel_questions if part.over_texels else _voxel_questions
        ask = questions(texf, number, camera, deepest if filtering else None, positions, faces)

        def one(begin, chosen=chosen, ask=ask):
            place = slice(begin, begin + BLOCK) if which is None else chosen[begin : begin + BLOCK]
            out[place] = ask(fragments.face[place], fragments.bary[place], fragments.depth[place])

        with ThreadPoolExecutor(max(threads, 1)) as pool:
            list(pool.map(one, range(0, len(out) if which is None else len(chosen), BLOCK)))
    return out


def _voxel_questions(texf, number, camera, deepest, positions, faces):
    """Function (face int64 [M], bary float64 [M, 3], depth float64 [M], at most deepest) -> float32 [M, 4] colour of a field over
    voxels. deepest: None without filtering."""
    part = texf.fields[number]
    pyramid, step = pyramid_of(part), 1 << part.level_shift
    width = 0.0 if deepest is None else camera.pixel * _voxels_per_unit(texf, part)
    _build(pyramid, 0.0 if deepest is None else width * (deepest if camera.perspective else 1.0))

    def finest(points, grid):
        return texf.query_field(number, points) if texf.evaluators else pyramid.level(0).query(grid)

    def ask(face, bary, depth):
        points = _surface_points(face, bary, positions, faces)
        grid = texf.cube.to_grid(points, part.support.resolution) / step
        wide = width * depth if camera.perspective else width
        if not np.any(wide > 1):
            return finest(points, grid)
        return _mixed(pyramid, lambda chosen: finest(points[chosen], grid[chosen]), grid, _fineness(wide, pyramid))

    return ask


def _texel_questions(texf, number, camera, deepest, positions, faces):
    """As _voxel_questions for a field over texels: how many texels a pixel covers differs from face to face."""
    part, uv = texf.fields[number], np.ascontiguousarray(texf.uv)
    pyramid = pyramid_of(part)
    pyramid.level(0).support.rank  # noqa: B018  built now, so that the threads only read
    density = np.zeros(len(faces)) if deepest is None else _texels_per_unit(positions, faces, uv) * camera.pixel
    density /= 1 << part.level_shift
    mine = texf.face_field == number
    _build(pyramid, 0.0 if deepest is None else density[mine].max(initial=0.0) * (deepest if camera.perspective else 1.0))

    def ask(face, bary, depth):
        texel = np.einsum("mk,mkc->mc", bary, uv[faces[face]])
        wide = density[face] * depth if camera.perspective else density[face]
        if not np.any(wide > 1):
            return pyramid.level(0).query(texel)
        return _mixed(pyramid, lambda chosen: pyramid.level(0).query(texel[chosen]), texel, _fineness(wide, pyramid))

    return ask


def _build(pyramid, widest):
    """Builds the levels that pixels of up to so many cells ask, before threads do."""
    if widest > 1:
        for number in range(min(int(np.log2(widest)) + 1, pyramid.last) + 1):
            support = pyramid.level(number).support
            if support.planar:
                support.rank  # noqa: B018


def _fineness(wide, pyramid):
    return np.minimum(np.log2(np.maximum(wide, 1)), pyramid.last)


def _mixed(pyramid, finest, places, fineness):
    """Colours mixed between the two levels around `fineness`, float64 scalar or [M]. finest: function of numbers of places ->
    answers of level 0; places: what Level.query takes, [M, ...]."""
    fineness = np.broadcast_to(fineness, len(places))
    out = np.zeros((len(places), 4), np.float32)
    for number in range(int(fineness.min()), int(np.ceil(fineness.max())) + 1):
        share = np.maximum(1 - np.abs(fineness - number), 0).astype(np.float32)
        chosen = np.flatnonzero(share)
        if len(chosen):
            level = pyramid.level(number).query(places[chosen]) if number else finest(chosen)
            out[chosen] += share[chosen, None] * level
    return out


def _texels_per_unit(positions, faces, uv):
    """Texels along one unit of length in the world, of every face: float64 [F]; 0 where a face has no area."""
    world, flat = (np.linalg.norm(np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]), axis=1)
                   for p in (positions, np.column_stack([uv, np.zeros(len(uv))])))
    return np.sqrt(np.divide(flat, world, out=np.zeros(len(faces)), where=world > 0))


def _voxels_per_unit(texf, part):
    """Voxels of the field along one unit of length in the world."""
    if texf.side == 0:
        return 0.0
    return float(texf.cube.to_grid(texf.origin + texf.side, part.support.resolution).max()) / texf.side / (1 << part.level_shift)


def _render(triangles, materials, face_material, threads, shade):
    """The Picture of ready triangles. shade: Fragments -> float32 [M, 4]. One pass where every face is opaque."""
    width, height = triangles.camera.width, triangles.camera.height
    if not see_through(materials, face_material):
        fragments = visible(triangles, threads)
        return Picture(width, height, fragments.pixel, shade(fragments)[:, :3], np.ones(len(fragments.pixel), np.float32))

    def layer(fragments):
        rgba = shade(fragments)
        return rgba[:, :3], opacity(materials, face_material[fragments.face], rgba[:, 3])

    return Picture(width, height, *composite(triangles, layer, threads))


def _two_sided(materials, face_material):
    return np.array([m.double_sided for m in materials], np.bool_)[face_material]


@kernel
def _surface_points(face, bary, positions, faces):
    """World points float64 [M, 3] of fragments. Bounds: shade_field has checked face against faces, set_up faces against
    positions."""
    out = np.empty((face.shape[0], 3))
    for i in range(face.shape[0]):
        a, b, c = faces[face[i], 0], faces[face[i], 1], faces[face[i], 2]
        for k in range(3):
            out[i, k] = bary[i, 0] * positions[a, k] + bary[i, 1] * positions[b, k] + bary[i, 2] * positions[c, k]
    return out


@kernel
def _paint(pixel, colour, alpha, image):
    """Writes colours over the background that stands in image, uint8 [height * width, 3]; pixels outside it are passed over."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or p >= image.shape[0]:
            continue
        for c in range(3):
            value = colour[i, c] * alpha[i] + image[p, c] * (np.float32(1) - alpha[i])
            image[p, c] = np.uint8(np.rint(min(max(value, 0.0), 255.0))) if value == value else 0
