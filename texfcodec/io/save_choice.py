"""Choice of how a decoded stream is saved: choose() fills in what a request leaves open and refuses what cannot be had."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .formats import APPEARANCES, AUTO, IMAGE_FORMATS, SAVED_SUFFIXES, ImageFormat
from .gltf.packing import check_compression
from .images import check_image_format
from .mtl_maps import MTL_CHANNELS
from .saved_materials import SavedMaterials, saved_materials_of

if TYPE_CHECKING:
    from ..texf import Texf

IN_OBJ = (AUTO, "png", "jpeg")  # formats of images that readers of MTL take


@dataclass(frozen=True, kw_only=True)
class SaveOptions:
    """A request to save.

    Parameters
    ----------
    appearance : {"texture", "vertex", "voxels"}, optional
        Images, colours at vertices, or a point cloud of voxel centres; None leaves it open.
    texture_size : int, optional
        Side of the atlas in texels.
    atlas : {"auto", "quality", "fast"}
        Method of the atlas.
    texture_format : {"auto", "png", "jpeg", "webp", "avif", "ktx2"}
        Format of images; "auto" is JPEG if that costs hardly any quality, else PNG.
    texture_quality : int, optional
        1..100; None means the format's own.
    compress : {"none", "draco", "meshopt"}
        Compression of a glTF's meshes.
    stream : bytes, optional
        A .texf stream that a GLB or glTF carries as it is (docs/guide/TEXF_stream.md); the asset is its coarse level.
    """

    appearance: str | None = None
    texture_size: int | None = None
    atlas: str = "auto"
    texture_format: str = AUTO
    texture_quality: int | None = None
    compress: str = "none"
    stream: bytes | None = None

    @property
    def settles_images(self) -> bool:
        """True if the request has an option that only images have."""
        return self.texture_size is not None or self.atlas != "auto" or self.texture_format != AUTO


@dataclass(frozen=True, kw_only=True)
class SaveChoice:
    """Choice of how a stream is saved.

    Parameters
    ----------
    suffix : str
        Suffix of the main file, such as ".glb".
    appearance : {"texture", "vertex", "voxels"}
        The appearance that was chosen.
    options : SaveOptions
        The request.
    materials : SavedMaterials, optional
        Materials of a surface that is written with images, else None.
    sketched : bool
        Whether colours are at vertices because the format has no place for images.
    warnings, remarks : tuple of str
        Sentences on the choice.
    """

    suffix: str
    appearance: str
    options: SaveOptions
    materials: SavedMaterials | None = None
    sketched: bool = False
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def choose(texf: Texf | None, path: Path, options: SaveOptions) -> SaveChoice:
    """Choose how a stream is saved.

    Parameters
    ----------
    texf : Texf or None
        The decoded stream; None checks the request alone.
    path : Path
        The main file.
    options : SaveOptions
        The request.

    Returns
    -------
    SaveChoice
        Without texf it has no materials.

    Raises
    ------
    InputError
        TXF-O05 suffix, TXF-O06 appearance, TXF-O13 no voxels, TXF-O14 texture format, quality or compression, TXF-O18 a stream
        in another format.
    SupportError
        TXF-O15, a package is missing.
    """
    suffix, wanted = path.suffix.lower(), options.appearance
    if suffix not in SAVED_SUFFIXES:
        raise InputError("TXF-O05", "the suffix of the file name is unknown", value=path.suffix,
                         allowed=" ".join(SAVED_SUFFIXES))
    if wanted not in (None, *APPEARANCES):
        raise InputError("TXF-O06", "the appearance is unknown", value=wanted, allowed=" ".join(APPEARANCES))
    warnings: list[str] = []
    if suffix == ".ply" and wanted == "texture":
        warnings.append("PLY is written without textures: vertex colours are used instead")
    if wanted == "voxels" and texf is not None:
        warnings += _without_voxels(texf)
    sketched = suffix == ".ply" and wanted in (None, "texture")
    appearance = ("vertex" if suffix == ".ply" else "texture") if wanted is None else wanted
    _check_packing(suffix, appearance, options)
    settled = wanted is not None or options.settles_images
    materials, remarks = (None, ()) if texf is None else _saved_materials(texf, suffix, appearance, settled)
    return SaveChoice(suffix=suffix, appearance=appearance, options=options, materials=materials, sketched=sketched,
                      warnings=tuple(warnings), remarks=remarks)


def _saved_materials(texf: Texf, suffix: str, appearance: str, settled: bool) -> tuple[SavedMaterials | None, tuple[str, ...]]:
    """(Materials of a surface that is written with images, else None; remarks). settled: whether the request rules out colours at
    vertices in place of images."""
    if appearance != "texture" or suffix not in (".glb", ".gltf", ".obj"):
        return None, ()
    materials = saved_materials_of(texf, MTL_CHANNELS if suffix == ".obj" else None, suffix != ".obj" and not settled)
    if not materials.opaque or suffix == ".obj":
        return materials, ()
    names = f"{', '.join(materials.opaque[:5])}{' and others' * (len(materials.opaque) > 5)}"
    return materials, (f"alpha is 1 everywhere on {names}: written as opaque",)


def _check_packing(suffix: str, appearance: str, options: SaveOptions) -> None:
    """Refuse a texture format, compression or stream that does not fit the output: InputError TXF-O14, TXF-O18, SupportError
    TXF-O15."""
    if options.stream is not None and suffix not in (".glb", ".gltf"):
        raise InputError("TXF-O18", "only GLB and glTF can carry a stream", value=suffix, allowed=".glb .gltf")
    check_image_format(options.texture_format, options.texture_quality)
    check_compression(options.compress)
    gltf, chosen = suffix in (".glb", ".gltf"), options.texture_format not in (AUTO, "png")
    if options.compress != "none" and (not gltf or appearance == "voxels"):
        raise InputError("TXF-O14", "only meshes in GLB and glTF can be compressed", value=options.compress, suffix=suffix,
                         appearance=appearance)
    if chosen and (appearance != "texture" or suffix in (".ply", ".npz")):
        raise InputError("TXF-O14", "a texture format was requested, but no texture is written", value=options.texture_format,
                         suffix=suffix, appearance=appearance)
    if suffix == ".obj" and options.texture_format not in IN_OBJ:
        raise InputError("TXF-O14", "OBJ readers do not support textures of this format", value=options.texture_format,
                         allowed=" ".join(IN_OBJ))


def _without_voxels(texf: Texf) -> list[str]:
    """Warnings on the faces that appearance "voxels" leaves out. Raises InputError TXF-O13 if it would leave out all."""
    bare = [number for number, part in enumerate(texf.fields) if part.over_texels]
    if bare and len(bare) == len(texf.fields):
        raise InputError("TXF-O13", "every field of the stream is over texels: there are no voxels to write", value=len(bare))
    faces = int(np.isin(texf.face_field, bare).sum())
    return [f"{faces} of {len(texf.faces)} faces are over texels and have no voxels: they are not written"] if bare else []


def side_names(path: Path, choice: SaveChoice) -> list[str]:
    """Names of the side files, known before the work. An image that its format cannot hold gets the suffix of PNG later.

    Parameters
    ----------
    path : Path
        The main file.
    choice : SaveChoice
        How the stream is saved.

    Returns
    -------
    list of str
        File names without folder, images first.
    """
    stem = path.stem if choice.suffix == ".gltf" else without_blanks(path.stem)
    count = choice.materials.image_count if choice.materials is not None and choice.suffix != ".glb" else 0
    form = IMAGE_FORMATS["png" if choice.options.texture_format == AUTO else choice.options.texture_format]
    images = image_names(stem, [form] * count)
    if choice.suffix == ".gltf":
        return [*images, stem + ".bin"]
    return [*images, stem + ".mtl"] if images else []


def image_names(stem: str, forms: list[ImageFormat]) -> list[str]:
    """Name the images beside a mesh file.

    Parameters
    ----------
    stem : str
        Name of the mesh file without suffix.
    forms : list of ImageFormat
        Format of each image.

    Returns
    -------
    list of str
        Stem and suffix for a single image, else stem, number and suffix.
    """
    return [stem + ("" if len(forms) == 1 else f"_{number}") + form.suffix for number, form in enumerate(forms)]


def without_blanks(stem: str) -> str:
    """Replace blanks, at which readers of OBJ and MTL split names.

    Parameters
    ----------
    stem : str
        Name of a file without suffix.

    Returns
    -------
    str
        The words of the name, joined by underscores.
    """
    return "_".join(stem.split())
