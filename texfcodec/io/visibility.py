"""Visibility by alpha: materials that are entirely invisible, and exporters that write 0 for opaque."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..scene.scene import ALPHA_MASK, ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..scene.scene import Material, Scene
    from .parts import Notes

_FEW = 4096  # faces of the first look: one point of them that shows is enough, and nearly every material has it there
_BLOCK = 1 << 15  # faces looked at together
_POINTS = 1 << 22  # of the last look, which is taken only where no corner, edge or middle of any face shows
_COARSE = np.array([[1, 1, 1], [3, 0, 0], [0, 3, 0], [0, 0, 3], [1.5, 1.5, 0], [0, 1.5, 1.5], [1.5, 0, 1.5]]) / 3


def vanishes(alphas: list[float]) -> bool:
    """Return whether some material has alpha 0 and none has alpha 1, which no author means. alphas: of a file's materials."""
    return any(not alpha > 0 for alpha in alphas) and not any(alpha >= 1 for alpha in alphas)


def turn_where_all_vanish(materials: list[Material], where: str, notes: Notes) -> None:
    """Replace alpha by 1 - alpha in all materials if some alpha is 0 and no material is opaque. This is a guess and so a named
    loss, for formats whose exporters disagree on the meaning of the number.

    where: the file's name in the message.
    """
    if not vanishes([1.0 if material.alpha_mode == ALPHA_OPAQUE else float(material.factor[3]) for material in materials]):
        return
    for material in materials:
        material.factor[3] = 1.0 - material.factor[3]
        material.alpha_mode = material.alpha_mode if material.factor[3] < 1 else ALPHA_OPAQUE
    notes.lose(f"alpha in {where} (guessed)",
               f"no material of {where} is opaque and an alpha is 0; alpha is read as transparency, as some exporters write it")


def name_invisible(scene: Scene, notes: Notes) -> None:
    """Record a warning in notes for every material on faces of a scene that is invisible everywhere."""
    used = np.bincount(scene.face_material, minlength=len(scene.materials))
    for number, material in enumerate(scene.materials):
        if used[number] and material.alpha_mode != ALPHA_OPAQUE and not _shows(scene, number):
            called = f"material '{material.name}'" if material.name else f"material {number}"
            masked = material.alpha_mode == ALPHA_MASK
            why = f"below its cutoff of {material.alpha_cutoff:g}" if masked else "0"
            notes.warn(f"{called} is invisible: its alpha is {why} wherever the surface uses it")


def _shows(scene, number):
    """Return whether any point on the faces of material `number` is visible."""
    material, faces = scene.materials[number], np.flatnonzero(scene.face_material == number)
    least = material.alpha_cutoff if material.alpha_mode == ALPHA_MASK else np.nextafter(0, 1)
    image = None if material.texture < 0 else scene.textures[material.texture].image[..., 3]
    colour = None if scene.corner_color is None else scene.corner_color[faces, :, 3]
    bound = material.factor[3] * (1.0 if colour is None else colour.max()) * (1.0 if image is None else image.max() / 255.0)
    if bound < least or image is None:  # without an image a corner has the most
        return bound >= least
    return any(_most(scene, number, faces[part], points) >= least for part, points in _rounds(len(faces)))


def _rounds(count) -> Iterator[tuple[slice, np.ndarray]]:
    """Yields (faces, barycentric points [N, 3]) to test, cheapest first. count: number of faces."""
    yield slice(0, count, max(1, count // _FEW)), _COARSE
    for begin in range(0, count, _BLOCK):
        yield slice(begin, begin + _BLOCK), _COARSE
    steps = int(min(np.sqrt(2 * _POINTS / count), 1024))
    for row in range(steps + 1):
        i = np.arange(steps - row + 1)
        points = np.stack([np.full(len(i), row), i, steps - row - i], axis=1) / max(steps, 1)
        for begin in range(0, count, _BLOCK) if steps > 2 else ():
            yield slice(begin, begin + _BLOCK), points


def _most(scene, number, faces, points):
    """Largest alpha at barycentric points [N, 3] of faces [F]."""
    material = scene.materials[number]
    texture = scene.textures[material.texture]
    height, width = texture.image.shape[:2]
    uv = np.einsum("nk,fkc->fnc", points, scene.corner_uv[faces])
    x, y = (_texel(uv[..., axis], size, texture.wrap[axis]) for axis, size in ((0, width), (1, height)))
    alpha = texture.image[y, x, 3] / 255.0 * material.factor[3]
    if scene.corner_color is not None:
        alpha = alpha * np.einsum("nk,fk->fn", points, scene.corner_color[faces, :, 3])
    return alpha.max()


def _texel(at, size, wrap):
    """Column or row of the texel at each coordinate. at: UV along an axis; size: texels along it."""
    if wrap == WRAP_CLAMP:
        at = np.clip(at, 0.0, 1.0)
    elif wrap == WRAP_MIRROR:
        at = 1.0 - np.abs(at % 2.0 - 1.0)
    else:
        at = at % 1.0
    return np.minimum((at * size).astype(np.int64), size - 1)
