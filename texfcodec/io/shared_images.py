"""Images that several materials of a decoded stream can share: equal images, and tints of the same image. A file holds them once.

In a stream, base colour has its factor in the values, so that 18 tints of a texture are 18 fields. If images of base colour are
multiples of each other, channel by channel in linear light, a joint image and factors show the same. The joint image takes each
channel from the brightest image, so that no factor is above 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..scene.channels import BASE_COLOUR
from ..scene.srgb import linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    from ..scene.scene import Texture
    from .output_textures import Textured

EXACT = 1.0  # levels of RMS that rounding alone explains
# Of the quantiser's step, what all of an image and a block of it may be off. On 18 tints at r03 it is 0.1 and 0.74, no more than
# what coding did to each of them.
STEPS = 0.125, 0.9
BLOCK, THUMB = 8, 48  # texels a side of a block; about as many samples a side settle most pairs
_LUT = srgb_to_linear(np.arange(256) / 255.0)


def with_shared_images(mesh: Textured, tints: bool) -> Textured:
    """Return the Textured with equal images merged. tints: whether images of base colour that are multiples of each other also
    become a joint image and factors of their materials. The atlas of fields over voxels is not changed."""
    textures, into = list(mesh.textures), _first_equals(mesh.textures)
    factors: dict[int, np.ndarray] = {}  # by number of the image that is left out, or kept as the joint one
    for group in _tint_groups(mesh, [number for number in _colours_over_texels(mesh) if into[number] == number]) if tints else ():
        joint = _joint_image(textures, group)
        trial_factors = {number: _factor(joint, mesh, number) for number in group}
        fitting = {number: factor for number, factor in trial_factors.items() if factor is not None}
        if len(fitting) < 2:
            continue
        first = min(fitting)
        textures[first] = replace(textures[first], image=joint)
        factors |= fitting
        into = {number: first if kept in fitting else kept for number, kept in into.items()}
        factors |= {number: fitting[kept] for number, kept in _first_equals(mesh.textures).items() if kept in fitting}
    return _with(mesh, textures, into, factors)


def _first_equals(textures):
    """{number of a texture: number of the first texture that is equal}."""
    into: dict[int, int] = {}
    for number, texture in enumerate(textures):
        into[number] = next((n for n in range(number) if into[n] == n and _is_equal(textures[n], texture)), number)
    return into


def _with(mesh, textures, into, factors):
    """The Textured with images renumbered. into: {number of an image: number of the image in its place}; factors: of materials,
    by number of the image."""
    kept = sorted(set(into.values()))
    place = {number: kept.index(first) for number, first in into.items()}
    rows = []
    for saved, images in zip(mesh.materials.rows, mesh.images, strict=True):
        factor = factors.get(images.get(BASE_COLOUR.name, -1))
        if factor is not None:
            material = saved.material
            saved = replace(saved, material=replace(material, factor=material.factor * np.append(factor, 1.0)))
        rows.append(saved)
    images = [{name: place[number] for name, number in images.items()} for images in mesh.images]
    steps = [mesh.steps[number] for number in kept]
    return replace(mesh, textures=[textures[number] for number in kept], steps=steps, images=images,
                   materials=replace(mesh.materials, rows=rows))


def _is_equal(first: Texture, other: Texture) -> bool:
    """Return whether two textures are equal in image, coding, wrap and filter."""
    return _kind(first) == _kind(other) and np.array_equal(first.image, other.image)


def _kind(texture):
    return texture.wrap, texture.srgb, texture.nearest


def _colours_over_texels(mesh):
    """Numbers of the images of base colour that belong to fields over texels."""
    return sorted({images[BASE_COLOUR.name] for saved, images in zip(mesh.materials.rows, mesh.images, strict=True)
                   if BASE_COLOUR.name in images and mesh.materials.skins[saved.skin].field is not None})


def _tint_groups(mesh, numbers):
    """Groups of two or more images that are multiples of the group's first, according to samples."""
    groups: list[list[int]] = []
    thumbs = {number: _LUT[_thumb(mesh.textures[number].image)] for number in numbers}
    for number in numbers:
        texture = mesh.textures[number]
        for group in groups:
            first = mesh.textures[group[0]]
            if (_kind(first), first.image.shape) == (_kind(texture), texture.image.shape) and _are_multiples(
                    thumbs[group[0]], thumbs[number], 2 * _tolerances(mesh, number)[0] + 2):
                group.append(number)
                break
        else:
            groups.append([number])
    return [group for group in groups if len(group) > 1]


def _thumb(image):
    rows, columns = (slice(size // (2 * THUMB), None, max(1, size // THUMB)) for size in image.shape[:2])
    return image[rows, columns, :3]


def _are_multiples(first, other, tolerance):
    """Return whether each channel of two linear images, float64 [H, W, 3], is a multiple of the other image's. tolerance: RMS in
    levels."""
    for c in range(3):
        bright, dark = sorted((first[..., c], other[..., c]), key=np.mean, reverse=True)
        if _rms(_scaled(bright, _ratio(bright, dark)) - 255 * linear_to_srgb(dark)) > tolerance:
            return False
    return True


def _joint_image(textures, group):
    """The joint image of a group, uint8 [H, W, 3 or 4]: each channel is that of its brightest member."""
    members = [textures[number].image for number in group]
    joint = members[0].copy()
    for c in range(3):
        joint[..., c] = max((image[..., c] for image in members), key=lambda plane: _LUT[plane].mean())
    return joint


def _factor(joint, mesh, number):
    """The factor float64 [3] that turns the joint image into image `number`; None if no factor does."""
    image, factor = mesh.textures[number].image, np.ones(3)
    whole, block = _tolerances(mesh, number)
    if image.shape[2] == 4 and not np.array_equal(image[..., 3], joint[..., 3]):
        return None
    for c in range(3):
        light = _LUT[joint[..., c]]
        factor[c] = min(1.0, _ratio(light, _LUT[image[..., c]]))
        off = _scaled(light, factor[c]) - image[..., c]
        if _rms(off) > whole or _worst_block(off) > block:
            return None
    return factor


def _tolerances(mesh, number):
    """(largest RMS error of an image, largest of a block of it), in levels."""
    step = mesh.steps[number] or 0.0
    return max(EXACT, STEPS[0] * step), max(4 * EXACT, STEPS[1] * step)


def _ratio(bright, dark):
    """Least-squares factor from one linear plane to another."""
    return float((bright * dark).sum() / max((bright * bright).sum(), 1e-12))


def _scaled(light, factor):
    """A linear plane times a factor, as sRGB-coded levels."""
    return 255 * linear_to_srgb(light * factor)


def _rms(off):
    return float(np.sqrt(np.mean(off * off)))


def _worst_block(off):
    """The largest RMS of a block of a plane, float64 [H, W]."""
    rows, columns = (np.arange(0, size, BLOCK) for size in off.shape)
    sums = np.add.reduceat(np.add.reduceat(off * off, rows, axis=0), columns, axis=1)
    counts = np.outer(np.diff([*rows, off.shape[0]]), np.diff([*columns, off.shape[1]]))
    return float(np.sqrt((sums / counts).max()))
