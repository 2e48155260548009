"""Materials of a decoded mesh for writing: which faces share images, which channels need images, and the factors of the rest."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.tangents import has_uv_area
from ..scene.channels import ALPHA, BASE_COLOUR, BY_NAME, NORMAL_MAPS, channel_over
from ..scene.factors import absorb
from ..scene.scene import ALPHA_BLEND, ALPHA_OPAQUE, Material
from ..scene.srgb import srgb_to_linear
from .atlas.packed_images import packed_images_of
from .vertex_colour_fit import VertexColours, fit_vertex_colours

if TYPE_CHECKING:
    from ..texf import Texf


@dataclass
class Skin:
    """Faces that share a set of images. field: number of their field, which is over texels; None for the atlas that all fields
    over voxels share. has_base: whether any material needs an image of the base colour; packed: channels of each other image."""

    field: int | None
    has_base: bool = False
    packed: list[tuple[str, ...]] = dataclass_field(default_factory=list)


@dataclass
class SavedMaterial:
    """A material as it is saved on one skin. number: of the stream's material; skin: index into SavedMaterials.skins, -1 without
    faces; material: its factors hold every channel that has a single value on its faces; mapped: names of the
    channels that need an image, base colour among them; colours: of its faces' corners, in order, if they replace an image."""

    number: int
    skin: int
    material: Material
    mapped: tuple[str, ...]
    colours: VertexColours | None = None


@dataclass
class SavedMaterials:
    """All saved materials of a mesh. rows: a material without faces is there once, without images; face_row: int64 [F] into rows;
    opaque: names of materials that are written as opaque, because no point of them is see-through; apart: whether every channel
    has its own image, grey for channels of one component."""

    skins: list[Skin]
    rows: list[SavedMaterial]
    face_row: np.ndarray
    opaque: list[str] = dataclass_field(default_factory=list)
    apart: bool = False

    @property
    def image_count(self) -> int:
        """Number of images that the skins need."""
        return sum(skin.has_base + len(skin.packed) for skin in self.skins)

    @property
    def has_image(self) -> np.ndarray:
        """Mask of the faces with an image, bool [F]."""
        return np.array([bool(saved.mapped) for saved in self.rows], bool)[self.face_row]


def saved_materials_of(texf: Texf, held: tuple[str, ...] | None = None, at_vertices: bool = False) -> SavedMaterials:
    """Decide which materials and images a decoded stream (Texf) is saved with; no image is made yet. held: names of the channels
    that the format has, each in its own image, or None for glTF; at_vertices: whether colours at vertices may replace an image
    that shows no more."""
    skins, face_skin = skins_of(texf)
    size = (max(len(texf.materials), 1), len(skins) + 1, 2)
    kind = np.ravel_multi_index((texf.face_material, face_skin, _says_nothing(texf).astype(np.int64)), size)
    count = np.bincount(kind, minlength=math.prod(size))
    kinds, face_row = np.flatnonzero(count), (np.cumsum(count > 0) - 1)[kind]
    rows = []
    for row, (number, skin, flat) in enumerate(np.column_stack(np.unravel_index(kinds, size)).tolist()):
        faces = np.flatnonzero(face_row == row)
        saved = _saved_material(texf, number, skin, skins[skin], faces, held)
        if flat:
            saved.mapped = tuple(name for name in saved.mapped if name not in NORMAL_MAPS)
        if at_vertices and skins[skin].field is None and saved.mapped == (BASE_COLOUR.name,):
            saved.colours = fit_vertex_colours(texf, faces)
            saved.mapped = saved.mapped if saved.colours is None else ()
        rows.append(saved)
        skins[skin].has_base |= BASE_COLOUR.name in saved.mapped
    for number, skin in enumerate(skins):
        wanted = {name for saved in rows if saved.skin == number for name in saved.mapped}
        skin.packed = packed_images_of(wanted) if held is None else [(name,) for name in held[1:] if name in wanted]
    idle = np.setdiff1d(np.arange(len(texf.materials)), texf.face_material)
    rows += [SavedMaterial(int(number), -1, texf.materials[number], ()) for number in idle]
    return SavedMaterials(skins, rows, face_row, _make_opaque(texf, rows, skins, face_row), apart=held is not None)


def _says_nothing(texf):
    """Return whether a normal map has no effect on a face, because its UVs give no tangent frame (spec 8.5.2), bool [F]. Viewers
    would invent a frame, so that such faces are written without the map."""
    mapped = np.array([bool(NORMAL_MAPS & m.maps.keys()) for m in texf.materials], bool)
    over_texels = np.array([part.over_texels for part in texf.fields], bool)
    if not len(texf.faces) or not mapped.any() or not over_texels.any():
        return np.zeros(len(texf.faces), bool)
    return mapped[texf.face_material] & over_texels[texf.face_field] & ~has_uv_area(texf.uv[texf.faces])


def _make_opaque(texf, rows, skins, face_row):
    """Make blended materials opaque if alpha is 255 on all their faces, because viewers draw blended faces last and unsorted.
    Returns the materials' names."""
    names = []
    for row, saved in enumerate(rows):
        if saved.skin >= 0 and saved.material.alpha_mode == ALPHA_BLEND and saved.material.factor[3] >= 1:
            alpha = _one_value(texf, skins[saved.skin], np.flatnonzero(face_row == row), ALPHA.name) if texf.has_alpha else [255]
            if alpha is not None and alpha[0] == 255:
                saved.material = replace(saved.material, alpha_mode=ALPHA_OPAQUE)
                names.append(saved.material.name or f"material {saved.number}")
    return names


def skins_of(texf: Texf) -> tuple[list[Skin], np.ndarray]:
    """(Skins, the atlas first; index of each face's skin, int64 [F])."""
    over_texels = np.array([part.over_texels for part in texf.fields], bool)
    skins = [Skin(None)] * bool((~over_texels).any() and len(texf.faces))
    of_field = np.zeros(len(texf.fields), np.int64)
    for number in np.flatnonzero(over_texels).tolist():
        of_field[number] = len(skins)
        skins.append(Skin(number))
    return skins, of_field[texf.face_field] if len(texf.faces) else np.zeros(0, np.int64)


def _saved_material(texf, number, skin, of, faces, held):
    """The SavedMaterial of a material's faces on a Skin, with the maps of the channels in held."""
    material = texf.materials[number]
    parameters, mapped = dict(material.parameters), []
    colour = _base_factor(texf, of, faces, material)
    if colour is None:
        mapped.append(BASE_COLOUR.name)
    for name in (name for name in BY_NAME if name in material.maps and (held is None or name in held)):
        value = _one_value(texf, of, faces, channel_over(name, of.field is not None).name)
        if value is None or not absorb(parameters, BY_NAME[name], value):
            mapped.append(name)
        if of.field is None and BY_NAME[name].over:
            parameters.pop(BY_NAME[name].parameter, None)  # it is in the values
    factor = np.ones(4) if colour is None else colour
    return SavedMaterial(number, skin, replace(material, factor=factor, parameters=parameters), tuple(mapped))


def _base_factor(texf, skin, faces, material):
    """Base colour as a linear factor, float64 [4], if it has a single value on all faces; else None."""
    colour, alpha = _one_value(texf, skin, faces, BASE_COLOUR.name), np.array([255.0])
    if texf.has_alpha and material.alpha_mode != ALPHA_OPAQUE:
        alpha = _one_value(texf, skin, faces, ALPHA.name)
    if colour is None or alpha is None:
        return None
    return np.concatenate([srgb_to_linear(colour / 255), alpha / 255])


def _one_value(texf, skin, faces, name):
    """The value of a channel of fields, float64 [C] in 0..255, if it has a single value on all faces; else None."""
    fields = np.unique(texf.face_field[faces]).tolist()
    if texf.evaluators:
        return None
    planes = [texf.fields[number].planes.get(name) for number in fields]
    if any(plane is None for plane in planes):
        return None
    first = planes[0][:1]
    if all((plane[:: max(1, len(plane) // 64)] == first).all() and (plane == first).all() for plane in planes):
        return first[0].astype(np.float64)
    if skin.field is None:
        return None
    uv = texf.uv[texf.faces[faces]].reshape(-1, 2)
    if np.ptp(uv, axis=0).any():
        return None
    part = texf.fields[skin.field]
    return part.support_of(name).query(uv[:1], part.planes[name])[0].astype(np.float64)


def names_in(materials: SavedMaterials, names: Iterable[str]) -> bool:
    """Return whether any of the materials has an image of any of these channels."""
    wanted = set(names)
    return any(wanted & set(saved.mapped) for saved in materials.rows)
