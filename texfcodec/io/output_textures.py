"""Images and UVs of a decoded mesh: fields over texels keep their own, fields over voxels share an atlas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..core.threads import in_order
from ..geometry.tangents import corner_tangents
from ..scene.channels import BASE_COLOUR, BY_NAME, NORMAL_MAPS, channel_over
from ..scene.scene import NEAREST_FIELDS, WRAP_CLAMP, Texture
from .atlas.bake import bake
from .atlas.maps import AtlasMaps
from .atlas.packed_images import packed_texel_image
from .atlas.texel_image import texel_image_and_uv
from .atlas.unwrap import check_arguments
from .saved_materials import SavedMaterials, names_in

if TYPE_CHECKING:
    from ..texf import Texf


@dataclass(kw_only=True)
class Textured:
    """A decoded mesh with images. corner_uv: float64 [F, 3, 2], v downwards (glTF), beyond 0..1 if an image wraps; textures: of
    each image, uint8 [H, W, 3] or [H, W, 4]; steps: quantiser step of each image's values in levels of 255, 0 for exact values,
    None if the stream does not state it; materials: of the faces; images: for each of materials.rows, index of the texture by
    channel name; corner_tangent: float32 [F, 3, 4], None without a normal map; warnings: sentences."""

    corner_uv: np.ndarray
    textures: list[Texture]
    steps: list[float | None]
    materials: SavedMaterials
    images: list[dict[str, int]]
    corner_tangent: np.ndarray | None
    warnings: list[str]

    @property
    def face_image(self) -> np.ndarray:
        """Index of the texture of each face's base colour, int64 [F]; -1 for faces without."""
        return np.array([images.get(BASE_COLOUR.name, -1) for images in self.images], np.int64)[self.materials.face_row]


def textured(texf: Texf, materials: SavedMaterials, texture_size: int | None = None, atlas: str = "auto") -> Textured:
    """Make the images and UVs of a decoded stream (Texf). materials: of saved_materials_of(); texture_size, atlas: as in bake(),
    for fields over voxels. Images of the atlas come first. UVs of faces without an image are 0. Raises InputError
    TXF-O10..O12."""
    check_arguments(texture_size, atlas)
    normal = None
    corner_uv, warnings, of_skin = np.zeros((len(texf.faces), 3, 2)), [], []
    textures: list[Texture] = []
    steps: list[float | None] = []
    if names_in(materials, NORMAL_MAPS):
        normal = texf.shading_normals()

    def images_of(skin):
        make = _of_atlas if skin.field is None else _of_texels
        return make(texf, materials, skin, normal, (texture_size, atlas))

    skin_images = in_order(images_of, materials.skins, texf.threads)
    for skin, (named_textures, uv, texts) in zip(materials.skins, skin_images, strict=True):
        faces = _faces_of(texf, materials, skin)
        corner_uv[faces] = uv
        of_skin.append({name: len(textures) + n for n, (names, _) in enumerate(named_textures) for name in names})
        textures += [texture for _, texture in named_textures]
        steps += [_step(texf, skin, faces, names) for names, _ in named_textures]
        warnings += texts
    if texf.fields and not any(skin.field is None for skin in materials.skins) and (texture_size is not None or atlas != "auto"):
        warnings.append("every field is over texels and keeps its image; texture size and atlas method are ignored")
    corner_uv[~materials.has_image] = 0
    images = [{name: of_skin[saved.skin][name] for name in saved.mapped} for saved in materials.rows]
    tangent = None if normal is None else corner_tangents(texf.positions, texf.faces, corner_uv, normal)
    return Textured(corner_uv=corner_uv, textures=textures, steps=steps, materials=materials, images=images,
                    corner_tangent=tangent, warnings=warnings)


def _step(texf, skin, faces, names):
    """The smallest step of the channels, named as in materials, in the faces' fields; None if no unit states a step."""
    fields = [texf.fields[number] for number in np.unique(texf.face_field[faces]).tolist()]
    known = [part.steps.get(channel_over(name, skin.field is not None).name) for part in fields for name in names]
    return min((step for step in known if step is not None), default=None)


def _faces_of(texf, materials, skin):
    """Faces of a Skin, int64 [n]: those of a field over texels, or those over voxels that have an image."""
    if skin.field is not None:
        return np.flatnonzero(texf.face_field == skin.field)
    over_texels = np.array([part.over_texels for part in texf.fields], bool)
    return np.flatnonzero(~over_texels[texf.face_field] & materials.has_image)


def _of_texels(texf, materials, skin, _, __):
    """([(channel names, Texture)], UVs float64 [F, 3, 2], warnings) of a field over texels."""
    image, uv, centres = texel_image_and_uv(texf, skin.field)
    wrap, squares = tuple(texf.fields[skin.field].support.wrap), texf.metadata.get(NEAREST_FIELDS)
    nearest = isinstance(squares, list) and skin.field in squares
    named_textures = [((BASE_COLOUR.name,), Texture(image, wrap, BASE_COLOUR.name, nearest=nearest))] * skin.has_base
    for packed in skin.packed:
        image = packed_texel_image(texf, skin.field, packed, centres)
        named_textures.append((packed, _packed_texture(image, wrap, packed, materials.apart)))
    return named_textures, uv, []


def _packed_texture(image, wrap, packed, apart):
    if apart and BY_NAME[packed[0]].components == 1:
        image = np.repeat(image[..., BY_NAME[packed[0]].columns], 3, axis=2)
    return Texture(image, wrap, "_".join(packed), any(BY_NAME[name].srgb for name in packed))


def _of_atlas(texf, materials, skin, normal, arguments):
    """Result of _of_texels() for the atlas that all fields over voxels share."""
    faces = _faces_of(texf, materials, skin)
    if not skin.has_base and not skin.packed:
        return [], np.zeros((len(faces), 3, 2)), []
    texture_size, atlas = arguments
    baked = bake(texf, texture_size, atlas, faces)
    image = baked.image if texf.has_alpha else np.ascontiguousarray(baked.image[..., :3])
    wrap = (WRAP_CLAMP, WRAP_CLAMP)
    named_textures = [((BASE_COLOUR.name,), Texture(image, wrap, BASE_COLOUR.name))] * skin.has_base
    if skin.packed:
        maps = AtlasMaps(texf, faces, baked, None if normal is None else normal[faces])
        named_textures += [(packed, _packed_texture(maps.image(packed), wrap, packed, materials.apart)) for packed in skin.packed]
    return named_textures, baked.atlas.corner_uv, baked.warnings
