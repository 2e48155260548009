"""The files of a saved stream, each as pieces of bytes, with a report on what the format cannot hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from ..core.threads import in_order
from .atlas.seams import measure_seams
from .automatic_image import automatic_image
from .formats import AUTO, IMAGE_FORMATS, ImageFormat
from .gltf.packing import packing_of
from .images import encode_image, format_for
from .lost_effects import IN_COLOURS, IN_MTL, lost_effects
from .mtl_maps import MAP_STATEMENTS
from .save_choice import image_names, without_blanks
from .shared_images import with_shared_images

if TYPE_CHECKING:
    from ..texf import Texf
    from .gltf.writer import Document
    from .output_textures import Textured
    from .save_choice import SaveChoice

Files = list[tuple[str, Any]]  # name, and pieces: bytes-like items or a function of the open file
Images = list[tuple[ImageFormat, bytes]]


@dataclass(frozen=True, kw_only=True)
class SaveReport:
    """Report of save().

    Parameters
    ----------
    warnings : tuple of str
        Sentences on what will look different.
    dropped : tuple of str
        Names of what the format cannot hold; each is in a warning too.
    remarks : tuple of str
        Sentences on what changes no picture.
    seams : dict, optional
        measure_seams() of the atlas.
    carried : dict, optional
        Bytes of the carried stream ("stream") and of all else ("fallback").
    """

    warnings: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    seams: dict | None = None
    carried: dict | None = None

    def result(self) -> dict:
        """The result of save() without "files"."""
        return {"warnings": list(self.warnings), "dropped": list(self.dropped), "remarks": list(self.remarks),
                "seams": self.seams, "carried": self.carried}

    def warn(self, texts: Iterable[str]) -> SaveReport:
        """Return the report with more warnings. texts: sentences."""
        return replace(self, warnings=(*self.warnings, *texts))

    def drop(self, form: str, names: Iterable[str]) -> SaveReport:
        """Return the report with more dropped names, which a warning lists. form: the format, as warnings call it."""
        names = tuple(names)
        texts = (f"{form} cannot hold {name}: it is not written" for name in names)
        return replace(self.warn(texts), dropped=(*self.dropped, *names))


def build(texf: Texf, path: Path, choice: SaveChoice) -> tuple[Files, SaveReport]:
    """Build the files of a saved stream in memory.

    Parameters
    ----------
    texf : Texf
        The decoded stream.
    path : Path
        The main file, which gives all files their names.
    choice : SaveChoice
        How the stream is saved.

    Returns
    -------
    tuple of Files and SaveReport
        (name, pieces) of each file, the main file last; the report.

    Raises
    ------
    InputError
        TXF-O10 to O12, the atlas.
    """
    report = SaveReport(warnings=choice.warnings, remarks=choice.remarks)
    return _BUILDERS[choice.suffix](texf, path, choice, report)


def _glb(texf: Texf, path: Path, choice: SaveChoice, report: SaveReport) -> tuple[Files, SaveReport]:
    from .gltf import writer

    if choice.appearance == "texture":
        mesh, images, report = _textured(texf, choice, report)
        document = writer.textured(texf, mesh, [*images], packing_of(choice.options.compress))
    else:
        document = _without_texture(texf, choice)
    _carry(document, choice)
    files: Files = [(path.name, writer.glb(document))]
    return files, replace(report.warn(document.warnings), carried=_counted(files, choice))


def _carry(document: Document, choice: SaveChoice) -> None:
    from .gltf.carried import write_carried

    if choice.options.stream is not None:
        write_carried(document, choice.options.stream)


def _counted(files: Files, choice: SaveChoice) -> dict | None:
    """{"stream": bytes of the carried stream, "fallback": bytes of all else in the files}, or None without a stream."""
    stream = choice.options.stream
    if stream is None:
        return None
    total = sum(len(piece) for _, pieces in files for piece in pieces)
    return {"stream": len(stream), "fallback": total - len(stream)}


def _without_texture(texf: Texf, choice: SaveChoice) -> Document:
    from .gltf import writer

    if choice.appearance == "vertex":
        return writer.coloured(texf, packing_of(choice.options.compress))
    return writer.points(texf)


def _gltf(texf: Texf, path: Path, choice: SaveChoice, report: SaveReport) -> tuple[Files, SaveReport]:
    from .gltf import writer

    files: Files = []
    if choice.appearance == "texture":
        mesh, images, report = _textured(texf, choice, report)
        files += _image_files(path.stem, images)
        named: list[tuple[ImageFormat, str | bytes]]
        named = [(form, quote(name)) for (form, _), (name, _) in zip(images, files, strict=True)]
        document = writer.textured(texf, mesh, named, packing_of(choice.options.compress))
    else:
        document = _without_texture(texf, choice)
    _carry(document, choice)
    main, buffer = writer.gltf(document, quote(path.stem + ".bin"))
    if buffer:
        files.append((path.stem + ".bin", buffer))
    files.append((path.name, main))
    return files, replace(report.warn(document.warnings), carried=_counted(files, choice))


def _obj(texf: Texf, path: Path, choice: SaveChoice, report: SaveReport) -> tuple[Files, SaveReport]:
    from .mtl import write_mtl
    from .obj import write_obj_coloured, write_obj_points, write_obj_textured

    in_colours = choice.appearance != "texture" or len(texf.faces) == 0
    report = _name_losses(texf, report, "OBJ", choice.appearance, IN_COLOURS if in_colours else IN_MTL)
    if choice.appearance == "voxels":
        return [(path.name, write_obj_points(texf))], report
    if in_colours:
        return [(path.name, write_obj_coloured(texf))], report
    stem, (mesh, images, report) = without_blanks(path.stem), _textured(texf, choice, report)
    files = _image_files(stem, images)
    extended = sorted({statement for maps in mesh.images for name in maps for statement in MAP_STATEMENTS.get(name, ())})
    if extended:
        text = f"some readers of MTL do not know {', '.join(extended)}, which hold maps of light"
        report = replace(report, remarks=(*report.remarks, text))
    mtl, warnings = write_mtl(texf, mesh, [name for name, _ in files])
    main = write_obj_textured(texf, mesh, stem + ".mtl")
    return [*files, (stem + ".mtl", mtl), (path.name, main)], report.warn(warnings)


def _ply(texf: Texf, path: Path, choice: SaveChoice, report: SaveReport) -> tuple[Files, SaveReport]:
    from .ply import write_ply_points, write_ply_surface
    from .vertex_colour_fit import NO_LESS, psnr_at_vertices

    report = _name_losses(texf, report, "PLY", choice.appearance, IN_COLOURS)
    if choice.appearance == "voxels":
        return [(path.name, write_ply_points(texf))], report
    psnr = psnr_at_vertices(texf) if choice.sketched else None
    if psnr is not None and psnr < NO_LESS:
        report = report.drop("PLY", [f"the detail of images between vertices (their colours there show {psnr:.1f} dB)"])
    pieces, dropped = write_ply_surface(texf)
    return [(path.name, pieces)], report.drop("PLY", dropped)


def _npz(texf: Texf, path: Path, choice: SaveChoice, report: SaveReport) -> tuple[Files, SaveReport]:
    from .npz import arrays, lost_maps

    held = arrays(texf, choice.appearance)
    report = report.drop(f"NPZ of {choice.appearance}", lost_maps(texf, choice.appearance))
    return [(path.name, lambda file: np.savez(file, **held))], report


_BUILDERS: dict[str, Callable[..., tuple[Files, SaveReport]]]
_BUILDERS = {".glb": _glb, ".gltf": _gltf, ".obj": _obj, ".ply": _ply, ".npz": _npz}


def _name_losses(texf: Texf, report: SaveReport, form: str, appearance: str, held: frozenset) -> SaveReport:
    """The report with the losses of a format. held: effects that the format can hold, IN_MTL or IN_COLOURS."""
    report = report.drop(form, ["metadata"] * bool(texf.metadata))
    if appearance == "voxels":
        return report
    report = report.drop(form, lost_effects(texf, held))
    if form == "OBJ" and appearance == "vertex" and texf.has_alpha:
        report = report.warn(["OBJ vertex colours have no alpha: it is not written"])
    if len(texf.materials) > 1 and (form == "PLY" or appearance == "vertex"):
        report = report.warn([f"{form} with vertex colours has no materials: the mesh becomes one surface"])
    return report


def _textured(texf: Texf, choice: SaveChoice, report: SaveReport) -> tuple[Textured, Images, SaveReport]:
    """(Textured, its textures as image files, the report with the warnings and seams of both)."""
    from .output_textures import textured

    assert choice.materials is not None  # of what is written with images
    mesh = textured(texf, choice.materials, choice.options.texture_size, choice.options.atlas)
    report = report.warn(mesh.warnings)
    skins = [part.skin for part in mesh.materials.rows]
    ours = np.array([skin >= 0 and mesh.materials.skins[skin].field is None for skin in skins], bool)
    shown = np.flatnonzero((mesh.face_image >= 0) & ours[mesh.materials.face_row])
    if len(shown):
        seams = measure_seams(texf.lattice_positions, texf.faces[shown], mesh.corner_uv[shown], mesh.textures,
                              mesh.face_image[shown])
        report = replace(report, seams=seams)
    mesh = with_shared_images(mesh, tints=not choice.materials.apart)
    images, warnings = encoded_images(mesh, choice.options.texture_format, texf.threads, choice.options.texture_quality)
    return mesh, images, report.warn(warnings)


def encoded_images(mesh: Textured, texture_format: str, threads: int, quality: int | None = None) -> tuple[Images, list[str]]:
    """(textures of a Textured as image files, warnings). Several images are encoded at a time. texture_format, quality: as of
    SaveOptions."""
    wanted = None if texture_format == AUTO else IMAGE_FORMATS[texture_format]
    fitting = [(None, ()) if wanted is None else format_for(texture.image, wanted) for texture in mesh.textures]

    def encoded(number):
        texture, form = mesh.textures[number], fitting[number][0]
        if form is None:
            return automatic_image(texture.image, mesh.steps[number], texture.srgb)
        return form, encode_image(texture.image, form, None if form.quality is None else quality, texture.srgb)

    at_once = 1 if texture_format == "ktx2" else threads  # its encoder is not known to be safe twice at a time
    return list(in_order(encoded, range(len(fitting)), at_once)), [text for _, texts in fitting for text in texts]


def _image_files(stem: str, images: Images) -> Files:
    """(name, pieces) of images beside a mesh file. stem: name of the mesh file without suffix."""
    names = image_names(stem, [form for form, _ in images])
    return [(name, [data]) for name, (_, data) in zip(names, images, strict=True)]
