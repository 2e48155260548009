"""The images that a game would ship for the maps of materials, for rivals that code images: packed as glTF packs them."""

from typing import NamedTuple

import numpy as np

from texfcodec.io.atlas.packed_images import with_z
from texfcodec.scene.channels import BY_NAME, PACKED_IMAGES
from texfcodec.scene.fetch import values_of_map

COLOUR, DATA, NORMAL = "colour", "data", "normal"


class PackedImage(NamedTuple):
    """An image and the channels in it. names: of the channels; image: uint8 [H, W, 4], 255 where no channel is; wrap: as of a
    Texture; kind: COLOUR if a channel is sRGB-coded, NORMAL for directions, else DATA."""

    names: tuple
    image: np.ndarray
    wrap: tuple
    kind: str


def pack_maps(scene):
    """Return the PackedImages of the maps that faces use, each once, and by material {channel: index of its image}.

    Channels of one glTF image share a packed image if their images have the same size. Raises ValueError for a map with own UVs.
    """
    if scene.map_uv:
        raise ValueError("maps with UVs of their own are not counted here")
    numbers, images, placed = {}, [], [{} for _ in scene.materials]
    for m in np.unique(scene.face_material):
        maps = {name: scene.textures[t] for name, t in scene.materials[m].maps.items()}
        for names in _together(maps):
            key = tuple((name, id(maps[name].image), tuple(maps[name].wrap)) for name in names)
            if key not in numbers:
                numbers[key] = len(images)
                images.append(_packed_image(names, maps))
            placed[m] |= dict.fromkeys(names, numbers[key])
    return images, placed


def _together(maps):
    """The names of each packed image of one material's maps, Textures by channel."""
    for packed in PACKED_IMAGES:
        alike = {}
        for name in packed:
            if name in maps:
                alike.setdefault((maps[name].image.shape, tuple(maps[name].wrap)), []).append(name)
        yield from map(tuple, alike.values())


def _packed_image(names, maps):
    first = maps[names[0]]
    image = np.full_like(first.image, 255)
    for name in names:
        columns = slice(0, 3) if BY_NAME[name].unit == "degrees" else list(BY_NAME[name].columns)  # z does not always follow
        image[..., columns] = maps[name].image[..., columns]
    kinds = {NORMAL if BY_NAME[name].unit == "degrees" else COLOUR if BY_NAME[name].srgb else DATA for name in names}
    return PackedImage(names, image, tuple(first.wrap), NORMAL if NORMAL in kinds else COLOUR if COLOUR in kinds else DATA)


def two_components(image):
    """Return a normal map uint8 [H, W, 4] as two-component formats take it: x in red, green and blue, y in alpha."""
    xy = np.rint(values_of_map("normal", image)).astype(np.uint8)
    return np.ascontiguousarray(xy[..., [0, 0, 0, 1]])


def three_components(image):
    """Return the normal map uint8 [H, W, 4] of one made by two_components(): z follows from x and y."""
    xyz = with_z(image.reshape(-1, 4)[:, [0, 3]].astype(np.float32)).reshape(*image.shape[:2], 3)
    return np.dstack([np.rint(xyz).astype(np.uint8), np.full(image.shape[:2], 255, np.uint8)])
