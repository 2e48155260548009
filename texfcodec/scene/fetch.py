"""Colours and maps of the source at surface points: bilinear texture, wrap mode, and base colour with factor and vertex colour,
as in glTF."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..core.kernel import kernel
from .channels import BY_NAME
from .factors import FLAT
from .scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_REPEAT, Scene
from .srgb import linear_to_srgb, srgb_to_linear

CURVE_STEPS = 4096
BLOCK = 1 << 16


class PackedSource(NamedTuple):
    """Images on a surface as flat arrays for the kernels.

    Attributes
    ----------
    texels : uint8 [T, 4]
        Of all images.
    textures : int64 [n, 5]
        (offset, width, height, wrap s, wrap t) of each image.
    material_texture : int64 [m]
        Image of each material.
    factor : float64 [m, 4]
        Linear factor of each material.
    opaque : uint8 [m]
        Whether a material's alpha is ignored.
    face_material : int64 [F]
        Material of each face.
    corner_uv : float64 [F, 3, 2]
        UVs.
    corner_colour : float32 [F or 0, 3, 4]
        Vertex colours.
    to_linear, to_srgb : float64
        Both curves as tables.
    """

    texels: np.ndarray
    textures: np.ndarray
    material_texture: np.ndarray
    factor: np.ndarray
    opaque: np.ndarray
    face_material: np.ndarray
    corner_uv: np.ndarray
    corner_colour: np.ndarray
    to_linear: np.ndarray
    to_srgb: np.ndarray


UV_OF_SOURCE = PackedSource._fields.index("corner_uv")


def pack_source(scene: Scene, faces: np.ndarray | None = None) -> PackedSource:
    """Pack what the base colour of faces depends on (images, factors, UVs, vertex colours) into flat arrays.

    Parameters
    ----------
    scene : Scene
        The source.
    faces : int64 [F], optional
        Indices of the faces to keep; None for all.

    Returns
    -------
    PackedSource
        For sample_source().
    """
    colour = np.zeros((0, 3, 4), np.float32) if scene.corner_color is None else scene.corner_color[_rows(faces)]
    factor = np.array([m.factor for m in scene.materials], np.float64).reshape(-1, 4)
    opaque = np.array([m.alpha_mode == ALPHA_OPAQUE for m in scene.materials], np.uint8)
    return _pack(scene, faces, [m.texture for m in scene.materials], scene.corner_uv, (factor, opaque, colour))


def pack_map(scene: Scene, name: str, faces: np.ndarray | None = None) -> PackedSource:
    """Pack the images and UVs of a channel's map into flat arrays, as pack_source() does for base colour.

    Parameters
    ----------
    scene : Scene
        The source.
    name : str
        One of channels.MAPS.
    faces : int64 [F], optional
        Indices of the faces to keep; None for all.

    Returns
    -------
    PackedSource
        For sample_source(). Factors are not applied; values are 255 if a material has no map, or those of scene.corner_map. The
        channel's components are in its columns; a component in alpha is in the first column.
    """
    count, columns = len(scene.materials), map_columns(name)
    colour = np.zeros((0, 3, 4), np.float32)
    if name in scene.corner_map:
        values = scene.corner_map[name][_rows(faces)]
        colour = np.ones((len(values), 3, 4), np.float32)
        colour[..., columns] = values
    plain = np.ones((count, 4)), np.ones(count, np.uint8), colour
    packed = _pack(scene, faces, [m.maps.get(name, -1) for m in scene.materials], scene.map_uv.get(name, scene.corner_uv), plain,
                   BY_NAME[name].columns == (3,))
    if not len(colour) or BY_NAME[name].srgb:
        return packed
    return packed._replace(to_linear=np.arange(256) / 255, to_srgb=np.arange(CURVE_STEPS + 2) / CURVE_STEPS * 255)


def map_columns(name: str) -> list[int]:
    """Return which columns of sample_source(pack_map()) hold the components of a channel.

    Parameters
    ----------
    name : str
        One of channels.MAPS.

    Returns
    -------
    list of int
        0..3, one for each component.
    """
    columns = BY_NAME[name].columns
    return [0] if columns == (3,) else list(columns)


def values_of_map(name: str, texels: np.ndarray) -> np.ndarray:
    """Return a channel's values in texels of its image.

    Parameters
    ----------
    name : str
        One of channels.MAPS.
    texels : uint8 or float32 [..., 4]
        RGBA, 0..255.

    Returns
    -------
    float32 [..., C]
        0..255. Normals are scaled to length 1, and x and y of them are returned.
    """
    if BY_NAME[name].unit != "degrees":
        return np.ascontiguousarray(texels[..., list(BY_NAME[name].columns)], np.float32)
    vector = texels[..., :3].astype(np.float32) / FLAT - 1
    vector[..., 2] = np.maximum(vector[..., 2], 0)
    length = np.sqrt((vector * vector).sum(axis=-1, keepdims=True))
    vector = np.where(length > 1e-3, vector / np.maximum(length, 1e-3), np.array([0, 0, 1], np.float32))
    return np.ascontiguousarray((vector[..., :2] + 1) * FLAT, np.float32)


def sampled_values(name: str, sampled: np.ndarray) -> np.ndarray:
    """Return a channel's values in samples of its packed map.

    Parameters
    ----------
    name : str
        One of channels.MAPS.
    sampled : float32 [M, 4]
        sample_source() of the channel's pack_map().

    Returns
    -------
    float32 [M, C]
        As of values_of_map().
    """
    return values_of_map(name, sampled) if BY_NAME[name].unit == "degrees" else sampled[:, map_columns(name)]


def wrapped(line: np.ndarray, size: int, mode: int) -> np.ndarray:
    """Map any column or row number into an image by a wrap mode.

    Parameters
    ----------
    line : int64 [N]
        Numbers of columns or rows, also outside the image.
    size : int
        Columns or rows of the image.
    mode : int
        One of WRAP_*.

    Returns
    -------
    int64 [N]
        0..size - 1.
    """
    if mode == WRAP_CLAMP:
        return np.clip(line, 0, size - 1)
    if mode == WRAP_REPEAT:
        return line % size
    return np.minimum(line % (2 * size), 2 * size - 1 - line % (2 * size))


def _rows(faces):
    return slice(None) if faces is None else faces


def _pack(scene, faces, texture_of, corner_uv, plain, spread=False):
    """PackedSource of the materials' images.

    texture_of: index by material, -1 for none; plain: (factor, opaque, corner colours); spread: whether alpha replaces the other
    columns.
    """
    factor, opaque, colour = plain
    used = sorted({t for t in texture_of if t >= 0})
    images: dict[int, np.ndarray] = {}
    for t in used:
        image = scene.textures[t].image
        images.setdefault(id(image), np.repeat(image[..., 3:], 4, axis=2) if spread else image)
    offsets, total = {}, 0
    for key, image in images.items():
        offsets[key] = total
        total += image.shape[0] * image.shape[1]
    if len(images) == 1:
        texels = np.ascontiguousarray(next(iter(images.values()))).reshape(-1, 4)
    else:
        texels = np.concatenate([im.reshape(-1, 4) for im in images.values()]) if images else np.zeros((1, 4), np.uint8)
    table = np.zeros((max(len(scene.textures), 1), 5), np.int64)
    for t in used:
        texture = scene.textures[t]
        height, width = texture.image.shape[:2]
        table[t] = (offsets[id(texture.image)], width, height, *texture.wrap)
    return PackedSource(
        texels, table, np.array(texture_of, np.int64), factor, opaque,
        np.ascontiguousarray(scene.face_material[_rows(faces)], np.int64),
        np.ascontiguousarray(corner_uv[_rows(faces)], np.float64),
        np.ascontiguousarray(colour, np.float32),
        srgb_to_linear(np.arange(256) / 255),
        np.round(linear_to_srgb(np.arange(CURVE_STEPS + 2) / CURVE_STEPS) * 255, 6),
    )


@kernel
def _wrapped(i, size, mode):
    """Texel index of i under a wrap mode; size >= 1."""
    if 0 <= i < size:
        return i
    if mode == WRAP_CLAMP:
        return min(max(i, 0), size - 1)
    if mode == WRAP_REPEAT:
        return i % size
    i = i % (2 * size)
    return i if i < size else 2 * size - 1 - i


@kernel
def _texture_at(texels, table, t, u, v, out):
    """Bilinear texture value, 0..255 sRGB-coded, into out float64 [4]. The texel range is the table's own."""
    width, height = table[t, 1], table[t, 2]
    u, v = min(max(u, -1e6), 1e6) * width - 0.5, min(max(v, -1e6), 1e6) * height - 0.5
    x, y = np.int64(np.floor(u)), np.int64(np.floor(v))
    fu, fv = u - x, v - y
    x0, x1 = _wrapped(x, width, table[t, 3]), _wrapped(x + 1, width, table[t, 3])
    y0, y1 = _wrapped(y, height, table[t, 4]), _wrapped(y + 1, height, table[t, 4])
    a, b = table[t, 0] + y0 * width, table[t, 0] + y1 * width
    for c in range(4):
        top = texels[a + x0, c] * (1.0 - fu) + texels[a + x1, c] * fu
        low = texels[b + x0, c] * (1.0 - fu) + texels[b + x1, c] * fu
        out[c] = top * (1.0 - fv) + low * fv


@kernel
def _source_at(source, f, b0, b1, b2, out):
    """Source RGBA at barycentric (b0, b1, b2) of face f into out float64 [4]: 0..255, colour sRGB-coded, alpha straight."""
    texels, table, material_texture, factor, opaque, face_material, uv, colour, to_linear, to_srgb = source
    m = face_material[f]
    t = material_texture[m]
    if t >= 0:
        _texture_at(texels, table, t, b0 * uv[f, 0, 0] + b1 * uv[f, 1, 0] + b2 * uv[f, 2, 0],
                    b0 * uv[f, 0, 1] + b1 * uv[f, 1, 1] + b2 * uv[f, 2, 1], out)
    else:
        out[:] = 255.0
    for c in range(4):
        gain = factor[m, c]
        if colour.shape[0] > 0:
            gain *= b0 * colour[f, 0, c] + b1 * colour[f, 1, c] + b2 * colour[f, 2, c]
        if c == 3:
            out[c] = min(max(out[c] * gain, 0.0), 255.0)
        elif gain != 1.0:
            low = min(np.int64(out[c]), np.int64(254))
            linear = to_linear[low] + (to_linear[low + 1] - to_linear[low]) * (out[c] - low)
            place = min(max(linear * gain, 0.0), 1.0) * CURVE_STEPS
            i = np.int64(place)
            out[c] = to_srgb[i] + (to_srgb[i + 1] - to_srgb[i]) * (place - i)
    if opaque[m]:
        out[3] = 255.0


@kernel
def _sample(source, face_index, bary, rgba, out):
    """Source RGBA of points into out float32 [M, 4]. rgba: float64 [4], scratch space for one point."""
    for i in range(face_index.shape[0]):
        _source_at(source, face_index[i], bary[i, 0], bary[i, 1], bary[i, 2], rgba)
        for c in range(4):
            out[i, c] = np.float32(rgba[c])


def sample_source(source: tuple, face_index: np.ndarray, bary: np.ndarray, threads: int = 1) -> np.ndarray:
    """Sample a packed source, bilinearly, at points of faces.

    Parameters
    ----------
    source : PackedSource or tuple
        Of pack_source() or pack_map(), or its arrays.
    face_index : int64 [M]
        Below the source's face count.
    bary : float64 [M, 3]
        Barycentric coordinates.
    threads : int
        Most threads.

    Returns
    -------
    float32 [M, 4]
        RGBA, 0..255; of pack_source() sRGB-coded, of pack_map() the image's columns.

    Raises
    ------
    IndexError
        A face index is out of range.
    """
    packed = PackedSource(*source)  # one type, so that the kernel is compiled once
    if len(face_index) and (face_index.min() < 0 or face_index.max() >= len(packed.face_material)):
        raise IndexError("face index outside the source")
    out = np.empty((len(face_index), 4), np.float32)

    def sample_block(begin):
        part = slice(begin, begin + BLOCK)
        _sample(packed, face_index[part], bary[part], np.empty(4), out[part])

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(sample_block, range(0, len(face_index), BLOCK)))
    return out
