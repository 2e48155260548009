"""Images that the surface shows through its UVs: candidates for fields over texels (encoder only)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Generic

import numpy as np

from ...bitstream.syntax import MAX_UV_ORIGIN
from ...field.extents import MAX_SIDE
from ...geometry.areas import face_areas
from ...geometry.draco import MAX_UV_BITS
from ...scene.fetch import CURVE_STEPS
from ...scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR
from ...scene.srgb import linear_to_srgb, srgb_to_linear
from ..faces import Faces
from .resample import resampled
from .texel_means import texel_means

if TYPE_CHECKING:
    from ...scene.scene import Material, Scene
    from ..faces import LatticeFaces, SourceSurface

PAINT_BITS = 2  # of UVs where vertex colours go into texels
FAR_BITS, FAR_WINDOW = 2, 1 << 16  # of UVs below the texel that far ones keep; texels around the median that are not far
MOST_SPREAD = 0.02  # of linear vertex colours within a texel, 0..1: more of it is faces that share texels and not colours


@dataclass(frozen=True)
class ImageGroup(Generic[Faces]):
    """Faces that share an image. faces: int64 [F] into the surface's; image: uint8 [H, W, 4]; wrap: (s, t); factor: float64 [4],
    linear; opaque: whether alpha counts as 255; uv: float64 [F, 3, 2] of their corners, in texels of the image; palette: whether
    it is one texel for each colour; nearest: whether its texels are squares of one colour (Texture.nearest); maps: uint8 [h, w,
    4] of further channels by name, with the same UVs, none larger; key: identity among groups; smaller: a cache of the image at
    other sizes, float32 [h, w, 4] by (width, height)."""

    faces: Faces
    image: np.ndarray
    wrap: tuple[int, int]
    factor: np.ndarray
    opaque: bool
    uv: np.ndarray
    palette: bool = False
    nearest: bool = False
    maps: dict[str, np.ndarray] = field(default_factory=dict)
    key: tuple = ()
    smaller: dict[tuple[int, int], np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the image."""
        return self.image.shape[1], self.image.shape[0]

    def values(self, texels: np.ndarray) -> np.ndarray:
        """Return texels of the image after multiplication by the factor, float32 [..., 4] in 0..255, colour sRGB-coded, straight
        alpha; whole numbers if the factor is 1. texels: uint8 [..., 4]."""
        out = np.empty(texels.shape, np.float32)
        for c in range(4):
            out[..., c] = self._curve(c)[texels[..., c]]
        return out

    def resampled(self, image: np.ndarray, weight: np.ndarray, size: tuple[int, int], wrap: tuple[int, int],
                  threads: int = 1) -> np.ndarray:
        """Return an image, uint8 [h, w, 4], at another size after multiplication by the group's factor; the other arguments and
        the result are as of resample.resampled. Constant alpha needs no fit."""
        values = self.values(image)
        if values[..., 3].min() == values[..., 3].max():
            out = np.full((size[1], size[0], 4), values[0, 0, 3], np.float32)
            out[..., :3] = resampled(values[..., :3], weight, size, wrap, threads)
            return out
        return resampled(values, weight, size, wrap, threads)

    def _curve(self, channel):
        """Return the value that each of the 256 coded values becomes, by the rule of scene.fetch."""
        coded, gain = np.arange(256) / 255, self.factor[channel]
        if channel == 3:
            return np.full(256, 255.0) if self.opaque else np.clip(255 * coded * gain, 0, 255)
        if gain == 1.0:
            return 255 * coded
        place = np.clip(srgb_to_linear(coded) * gain, 0, 1) * CURVE_STEPS
        return np.interp(place, np.arange(CURVE_STEPS + 1), linear_to_srgb(np.arange(CURVE_STEPS + 1) / CURVE_STEPS) * 255)


def brought_near(uv: np.ndarray, size: tuple[int, int], wrap: tuple[int, int]) -> np.ndarray:
    """Return UVs of faces moved near to each other, float64 [F, 3, 2] in texels of an image of `size` (width, height). If
    together they reach further than a unit of the stream has room for, faces far from the median are moved by whole periods of
    the image, which changes no picture because it repeats there. uv: float64 [F, 3, 2]; wrap: modes (s, t)."""
    out, sound = uv.copy(), np.isfinite(uv).all(axis=(1, 2))
    for axis in range(2) if sound.any() else ():
        low = uv[sound, :, axis].min(axis=1)
        if wrap[axis] == WRAP_CLAMP or np.ptp(uv[sound, :, axis]) < 1 << MAX_UV_BITS - FAR_BITS:
            continue
        period = size[axis] * (1 + (wrap[axis] == WRAP_MIRROR))
        middle = np.median(low)
        shift = np.where(np.abs(low - middle) >= FAR_WINDOW, np.round((low - middle) / period) * period, 0.0)
        out[sound, :, axis] -= (shift + np.round(middle / period) * period)[:, None]
    return out


def image_groups(scene: Scene, surface: SourceSurface) -> list[ImageGroup[LatticeFaces]]:
    """Return the ImageGroups of a surface, each a candidate for a field over texels: faces with the same images (by content),
    wrap modes, factor and use of alpha; one group for the faces of a material with vertex colours, these in its texels; and one
    palette for the faces of materials without an image.

    Some faces are in no group: those without any image whose vertices have colours, those of maps at face corners, those that
    share texels but not colours, those with UVs that are not finite or too far out, and those whose images differ in UVs or wrap
    modes.
    """
    groups: dict[tuple, list[tuple]] = {}
    painted: list[ImageGroup[LatticeFaces] | None] = []
    plain = _plain_faces(scene, surface)
    digests = [_digest(texture.image) for texture in scene.textures] if len(scene.textures) > 1 else [b""]  # one needs none
    for number in np.unique(surface.material):
        material, in_material = scene.materials[number], surface.material == number
        faces, used = np.flatnonzero(plain & in_material), textures_of(material)
        if not used or min(used.values()) < 0 or not _goes_together(scene, surface, material, np.flatnonzero(in_material)):
            continue
        opaque = material.alpha_mode == ALPHA_OPAQUE
        image = scene.textures[material.texture].image if material.texture >= 0 else None
        sees_through = not opaque or image is None or image[..., 3].min() == 255
        key = (tuple((name, digests[t]) for name, t in sorted(used.items())), tuple(scene.textures[min(used.values())].wrap),
               material.factor.tobytes(), not sees_through, material.texture >= 0 and scene.textures[material.texture].nearest)
        groups.setdefault(key, []).append((faces, material))
        if not plain[in_material].all():
            faces = np.flatnonzero(in_material & ~plain)
            painted.append(_painted(scene, surface, (faces, material), (*key, "painted", int(number))))
    candidates = [_group(scene, surface, parts, key) for key, parts in groups.items()]
    candidates += [*painted, _palette(scene, surface, plain)]
    return [group for group in candidates if group is not None and len(group.faces)]


def textures_of(material: Material) -> dict[str, int]:
    """Return the numbers of a material's textures by channel name, "" for the base colour."""
    return {**({"": material.texture} if material.texture >= 0 else {}), **material.maps}


def _goes_together(scene, surface, material, faces):
    """Return whether the images of a material can be one field: none too large, the same wrap modes and UVs."""
    textures = [scene.textures[t] for t in textures_of(material).values()]
    if any(max(t.image.shape[:2]) > MAX_SIDE or tuple(t.wrap) != tuple(textures[0].wrap) for t in textures):
        return False
    rows = surface.origin_face[faces]
    others = [scene.map_uv[name] for name in material.maps if name in scene.map_uv]
    return all(np.array_equal(uv[rows], scene.corner_uv[rows]) for uv in others)


def _palette(scene, surface, plain):
    """Return the group of the faces that show a material's factor alone, each at the centre of its material's texel; None without
    any."""
    flat = np.array([not textures_of(m) for m in scene.materials], bool)
    faces = np.flatnonzero(plain & flat[surface.material])
    used, number = np.unique(surface.material[faces], return_inverse=True)
    if not 0 < len(used) <= MAX_SIDE:
        return None
    colours = np.array([_shown(scene.materials[m]) for m in used], np.float64)
    unique, place = np.unique(np.rint(colours).astype(np.uint8), axis=0, return_inverse=True)
    uv = np.full((len(faces), 3, 2), 0.5)
    uv[:, :, 0] += place.reshape(-1)[number][:, None]
    return ImageGroup(faces, unique[None], (WRAP_CLAMP, WRAP_CLAMP), np.ones(4), False, uv, palette=True, key=("palette",))


def _shown(material):
    """Return the colour of a material without an image: RGBA in 0..255, colour sRGB-coded."""
    rgb = linear_to_srgb(np.clip(material.factor[:3], 0, 1)) * 255
    return [*rgb, 255.0 if material.alpha_mode == ALPHA_OPAQUE else float(np.clip(material.factor[3], 0, 1)) * 255]


def _group(scene, surface, parts, key):
    faces = np.sort(np.concatenate([rows for rows, _ in parts]))
    _, material = parts[0]
    maps = {name: scene.textures[t].image for name, t in material.maps.items()}
    image, factor = _leading_image(scene, material, maps)
    uv = scene.corner_uv[surface.origin_face[faces]] * np.array([image.shape[1], image.shape[0]], np.float64)
    uv = brought_near(uv, (image.shape[1], image.shape[0]), key[1])
    near = np.isfinite(uv).all(axis=(1, 2))
    if near.any():
        near &= (np.abs(uv - np.median(uv[near], axis=(0, 1))) < 1 << MAX_UV_BITS - 1).all(axis=(1, 2))
        near &= (np.abs(uv) < MAX_UV_ORIGIN / 2).all(axis=(1, 2))
    return ImageGroup(faces[near], image, key[1], factor, key[3], uv[near], nearest=key[4], maps=maps, key=key)


def _painted(scene, surface, part, key):
    """Return the group of faces with vertex colours, (int64 [F], their material): its image with the colours in its texels; None
    if faces of different colours share texels."""
    group = _group(scene, surface, [part], key)
    steps = np.floor(group.uv * (1 << PAINT_BITS) + 0.5).astype(np.int64)
    colour = scene.corner_color[surface.origin_face[group.faces]].astype(np.float64)
    area = face_areas(surface.lattice, surface.faces[group.faces])
    means = texel_means(steps, colour, area, PAINT_BITS, group.size, group.wrap)
    if not len(means.texel) or np.average(means.spread.max(axis=1), weights=means.area) > MOST_SPREAD**2:
        return None
    image = group.image.copy()
    flat, factor = image.reshape(-1, 4), group.factor * means.mean
    shown = srgb_to_linear(flat[means.texel, :3] / 255.0) * factor[:, :3]
    flat[means.texel, 3] = np.rint(np.clip(flat[means.texel, 3] * factor[:, 3], 0, 255))
    flat[means.texel, :3] = np.rint(linear_to_srgb(np.clip(shown, 0, 1)) * 255)
    return replace(group, image=image, factor=np.ones(4))


def _leading_image(scene, material, maps):
    """Return (base colour image uint8 [H, W, 4], its factor), not smaller than any of the maps; an image of a single colour if
    there is none."""
    sizes = [image.shape[:2] for image in maps.values()]
    if material.texture < 0:
        return np.broadcast_to(np.rint(_shown(material)).astype(np.uint8), (*np.max(sizes, axis=0).tolist(), 4)), np.ones(4)
    image = scene.textures[material.texture].image
    height, width = np.max([image.shape[:2], *sizes], axis=0).tolist()
    if (height, width) != image.shape[:2]:
        from PIL import Image

        image = np.asarray(Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR))
    return image, material.factor


def _plain_faces(scene, surface):
    """Return faces without vertex colours, or with white ones."""
    if scene.corner_color is None:
        return np.ones(len(surface.faces), bool)
    return (scene.corner_color[surface.origin_face] == 1).all(axis=(1, 2))


def _digest(image):
    total = hashlib.sha256(repr(image.shape).encode())
    total.update(np.ascontiguousarray(image).data)
    return total.digest()
