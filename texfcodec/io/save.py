"""Saving a decoded stream as GLB, glTF, OBJ, PLY or NPZ: everything under a temporary name first, then renamed."""

from __future__ import annotations

import errno
import io
import os
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from urllib.parse import quote

import numpy as np

from ..core import cleanup
from ..core.threads import in_order
from ..errors import InputError
from .atlas.seams import measure_seams
from .automatic_image import automatic_image
from .formats import APPEARANCES, AUTO, IMAGE_FORMATS, SAVED_SUFFIXES, ImageFormat
from .gltf.packing import check_compression, packing_of
from .images import check_image_format, encode_image, format_for
from .looks import Looks, looks_of
from .lost_effects import IN_COLOURS, IN_MTL, lost_effects
from .mtl_maps import MAP_STATEMENTS, MTL_CHANNELS
from .own_files import own_sides
from .shared_images import with_shared_images

if TYPE_CHECKING:
    from ..texf import Texf

_IN_OBJ = (AUTO, "png", "jpeg")  # what readers of MTL take


@dataclass(kw_only=True)
class SaveOptions:
    """How a stream is written. appearance: "texture", "vertex" (colours at vertices), "voxels" (point cloud of voxel centres) or
    None; texture_size: side of the atlas in texels or None; atlas: "auto", "quality" or "fast"; texture_format: "auto" for JPEG
    where that costs hardly any quality and PNG elsewhere, "png", "jpeg", "webp", "avif" or "ktx2"; texture_quality: 1..100, or
    None for the format's own; compress: "none", "draco" or "meshopt"; stream: the bytes of a .texf stream, of which the asset is
    a coarse level, that a GLB or glTF carries as it is (docs/guide/TEXF_stream.md), or None."""

    appearance: str | None = None
    texture_size: int | None = None
    atlas: str = "auto"
    texture_format: str = AUTO
    texture_quality: int | None = None
    compress: str = "none"
    stream: bytes | None = None
    settled: bool = field(default=False, init=False)  # whether colours have to be where appearance says
    sketched: bool = field(default=False, init=False)  # whether they are at vertices because the format has no place for images


@dataclass
class _Told:
    """What save() has to tell. dropped: names of what the format cannot hold, each in a warning too; remarks: what changes no
    picture; carried: bytes of a stream and of all else; looks: of a surface that is written with images, known before these are
    made."""

    warnings: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    seams: dict | None = None
    carried: dict | None = None
    looks: Looks | None = None

    def result(self):
        """What save() returns, but for the files."""
        return {"warnings": self.warnings, "dropped": self.dropped, "remarks": self.remarks, "seams": self.seams,
                "carried": self.carried}

    def drop(self, form, names):
        """Names what a format cannot hold."""
        self.dropped += names
        self.warnings += [f"{form} cannot hold {name}: it is not written" for name in names]


def save(texf: Texf, path: str | PathLike, appearance: str | None = None, texture_size: int | None = None, atlas: str = "auto",
         overwrite: bool = False, inputs: Iterable[str | PathLike] = (), **options: Any) -> dict:
    """Write a decoded stream; the suffix of path chooses the format.

    texf: decoded stream (Texf). appearance: "texture", "vertex" (colours at vertices), "voxels" (point cloud of voxel centres);
    None means texture, but vertex for PLY, which has no texture, and for materials of a GLB or glTF whose field is shown as well
    by colours at vertices, see vertex_fit.py. With texture a field over texels keeps its image and its UVs,
    and all fields over voxels are baked into one atlas; an NPZ holds every decoded array, see npz_write.arrays().
    texture_size: side of the atlas in texels or None; atlas: "auto", "quality" or "fast"; fields over texels have no part in
    them. options: the rest of SaveOptions; texture_format is for textures, other than PNG and JPEG for glTF, and compress for
    glTF's meshes. Side files (.bin, .png, .mtl) take the name of path; several images are numbered from 0, the atlas first.
    overwrite: whether side files may replace what is there; path itself always may. inputs: paths that nothing may replace.
    Returns {"warnings": [one sentence each], "dropped": [names of what the format cannot hold, each in a warning too],
    "remarks": [sentences on what changes no picture], "files": [names written], "seams": measure_seams() of the atlas or None,
    "carried": {"stream": bytes of the stream that is carried, "fallback": bytes of all else that is written} or None}.
    Raises InputError: TXF-O01 no such directory, TXF-O02 not writable, TXF-O03 disk full, TXF-O04 other operating system error,
    TXF-O05 suffix, TXF-O06 appearance, TXF-O07 a file would replace an input, TXF-O08 a side file is there already, TXF-O10..O12
    atlas, TXF-O13 no voxels, TXF-O14 texture format, quality or compression, TXF-O18 a stream in another format; SupportError
    TXF-O15 a package is missing.
    After an error nothing half-written remains.
    """
    path = Path(path)
    asked = SaveOptions(appearance=appearance, texture_size=texture_size, atlas=atlas, **options)
    told = _Told()
    suffix = _checked(texf, path, asked, told)
    check_target(path, inputs)
    told.looks = _looks(texf, suffix, asked, told.remarks)
    check_sides(path.parent, _side_names(path, suffix, asked, told.looks), inputs, overwrite, own_sides(path))
    files = _WRITERS[suffix](texf, path, asked, told)
    write_all(path.parent, files, inputs, overwrite)
    return {"files": [name for name, _ in files]} | told.result()


def as_glb(texf: Texf, **options: Any) -> tuple[bytes, dict]:
    """The bytes of the GLB that save() would write, and what it would return without files: (bytes, {"warnings",
    "dropped", "remarks", "seams", "carried"}). options: SaveOptions."""
    return _in_one_piece(texf, ".glb", SaveOptions(**options))


def save_into(texf: Texf, file: BinaryIO, form: str | None = None, **options: Any) -> dict:
    """Writes what save() would, into a file object open for writing bytes.

    form: "glb", "ply", "npz" or "obj", or None for the suffix of the object's name. options: SaveOptions. Returns as save(),
    "files" being empty. Raises InputError, SupportError as save(); TXF-O05 also where the format has several files, as glTF and
    OBJ with textures do.
    """
    name = getattr(file, "name", None)
    suffix = "." + form.lower().removeprefix(".") if form else Path(name).suffix.lower() if isinstance(name, str) else ""
    if not suffix:
        raise InputError("TXF-O05", "a file object without a name requires a format, such as format='glb'",
                         allowed=" ".join(word[1:] for word in SAVED_SUFFIXES))
    data, told = _in_one_piece(texf, suffix, SaveOptions(**options))
    try:
        file.write(data)
    except (OSError, ValueError, TypeError, AttributeError) as error:  # it is closed, or open for text or reading
        raise InputError("TXF-O04", "the file object does not accept bytes", reason=str(error)[:200]) from error
    return {"files": []} | told


def _in_one_piece(texf, suffix, asked):
    """(bytes, what save() tells) of a format that needs no file beside it. Raises InputError TXF-O05
    for others."""
    path, told = Path("stream" + suffix), _Told()
    suffix = _checked(texf, path, asked, told)
    told.looks = _looks(texf, suffix, asked, told.remarks)
    if _side_names(path, suffix, asked, told.looks):
        raise InputError("TXF-O05", "this format writes several files, which requires a path", value=suffix,
                         allowed=".glb .ply .npz")
    ((_, pieces),) = _WRITERS[suffix](texf, path, asked, told)
    if callable(pieces):
        held = io.BytesIO()
        pieces(held)
        pieces = [held.getvalue()]
    return b"".join(pieces), told.result()


def _checked(texf, path, asked, told):
    """The suffix that save() was asked for. Checks what was asked, and sets an appearance that was left open."""
    suffix, appearance = path.suffix.lower(), asked.appearance
    if suffix not in SAVED_SUFFIXES:
        raise InputError("TXF-O05", "the suffix of the file name is unknown", value=path.suffix,
                         allowed=" ".join(SAVED_SUFFIXES))
    if appearance not in (None, *APPEARANCES):
        raise InputError("TXF-O06", "the appearance is unknown", value=appearance, allowed=" ".join(APPEARANCES))
    if suffix == ".ply" and appearance == "texture":
        told.warnings.append("PLY is written without textures: vertex colours are used instead")
    if appearance == "voxels" and texf is not None:
        _name_what_has_no_voxels(texf, told.warnings)
    asked.settled = appearance is not None or _settles_images(asked)
    asked.sketched = suffix == ".ply" and appearance in (None, "texture")
    asked.appearance = ("vertex" if suffix == ".ply" else "texture") if appearance is None else appearance
    _check_packing(suffix, asked)
    return suffix


def _looks(texf, suffix, asked, remarks):
    """Looks of a surface that is written with images where it needs any; None for what is written without."""
    if asked.appearance != "texture" or suffix not in (".glb", ".gltf", ".obj"):
        return None
    looks = looks_of(texf, MTL_CHANNELS if suffix == ".obj" else None, suffix != ".obj" and not asked.settled)
    if looks.opaque and suffix != ".obj":
        remarks.append(f"alpha is 1 everywhere on {', '.join(looks.opaque[:5])}{' and others' * (len(looks.opaque) > 5)}: "
                       "written as opaque")
    return looks


def _settles_images(asked):
    """Whether anything is said of images that only these can have."""
    return asked.texture_size is not None or asked.atlas != "auto" or asked.texture_format != AUTO


def check_choices(path: str | PathLike, **options: Any) -> None:
    """What save() can refuse of its options (SaveOptions) before anything is decoded: InputError TXF-O05, TXF-O06, TXF-O14
    and TXF-O18, SupportError TXF-O15."""
    _checked(None, Path(path), SaveOptions(**options), _Told())


def _check_packing(suffix, asked):
    """InputError TXF-O14, or SupportError TXF-O15, where texture format and compression do not fit what is written."""
    if asked.stream is not None and suffix not in (".glb", ".gltf"):
        raise InputError("TXF-O18", "only GLB and glTF can carry a stream", value=suffix, allowed=".glb .gltf")
    check_image_format(asked.texture_format, asked.texture_quality)
    check_compression(asked.compress)
    gltf, chosen = suffix in (".glb", ".gltf"), asked.texture_format not in (AUTO, "png")
    if asked.compress != "none" and (not gltf or asked.appearance == "voxels"):
        raise InputError("TXF-O14", "only meshes in GLB and glTF can be compressed", value=asked.compress, suffix=suffix,
                         appearance=asked.appearance)
    if chosen and (asked.appearance != "texture" or suffix in (".ply", ".npz")):
        raise InputError("TXF-O14", "a texture format was requested, but no texture is written", value=asked.texture_format,
                         suffix=suffix, appearance=asked.appearance)
    if suffix == ".obj" and asked.texture_format not in _IN_OBJ:
        raise InputError("TXF-O14", "OBJ readers do not support textures of this format", value=asked.texture_format,
                         allowed=" ".join(_IN_OBJ))


def _name_what_has_no_voxels(texf, warnings):
    """What appearance "voxels" leaves out: a warning, or InputError TXF-O13 where nothing would be left."""
    bare = [number for number, part in enumerate(texf.fields) if part.over_texels]
    if bare and len(bare) == len(texf.fields):
        raise InputError("TXF-O13", "every field of the stream is over texels: there are no voxels to write", value=len(bare))
    if bare:
        faces = int(np.isin(texf.face_field, bare).sum())
        warnings.append(f"{faces} of {len(texf.faces)} faces are over texels and have no voxels: they are not written")


def _side_names(path, suffix, asked, looks):
    """Names of the files that the writers put beside path, known before the work, but for images that have to be PNG."""
    stem = path.stem if suffix == ".gltf" else _without_blanks(path.stem)
    count = looks.image_count if looks is not None and suffix != ".glb" else 0
    images = _image_names(stem, [IMAGE_FORMATS["png" if asked.texture_format == AUTO else asked.texture_format]] * count)
    if suffix == ".gltf":
        return [*images, stem + ".bin"]
    return [*images, stem + ".mtl"] if images else []


def _image_names(stem, forms):
    """Names of the images, of these formats, that go with a mesh file of that stem."""
    return [stem + ("" if len(forms) == 1 else f"_{number}") + form.suffix for number, form in enumerate(forms)]


def _without_blanks(stem):
    """A name as readers of OBJ and MTL take it, which split names at blanks."""
    return "_".join(stem.split())


def _glb(texf, path, asked, told):
    from texfcodec.io.gltf import writer

    if asked.appearance == "texture":
        look, images = _textured(texf, asked, told)
        document = writer.textured(texf, look, images, packing_of(asked.compress))
    else:
        document = _without_texture(texf, asked)
    told.warnings += document.warnings
    _carry(document, asked)
    files = [(path.name, writer.glb(document))]
    told.carried = _counted(files, asked)
    return files


def _carry(document, asked):
    from .gltf.carried import write_carried

    if asked.stream is not None:
        write_carried(document, asked.stream)


def _counted(files, asked):
    """Bytes of the stream that files (name, pieces) carry and of all else in them, None where they carry none."""
    if asked.stream is None:
        return None
    total = sum(len(piece) for _, pieces in files for piece in pieces)
    return {"stream": len(asked.stream), "fallback": total - len(asked.stream)}


def _without_texture(texf, asked):
    from texfcodec.io.gltf import writer

    return writer.coloured(texf, packing_of(asked.compress)) if asked.appearance == "vertex" else writer.points(texf)


def _gltf(texf, path, asked, told):
    from texfcodec.io.gltf import writer

    files = []
    if asked.appearance == "texture":
        look, images = _textured(texf, asked, told)
        files += _image_files(path.stem, images)
        named: list[tuple[ImageFormat, str | bytes]]
        named = [(form, quote(name)) for (form, _), (name, _) in zip(images, files, strict=True)]
        document = writer.textured(texf, look, named, packing_of(asked.compress))
    else:
        document = _without_texture(texf, asked)
    told.warnings += document.warnings
    _carry(document, asked)
    main, buffer = writer.gltf(document, quote(path.stem + ".bin"))
    if buffer:
        files.append((path.stem + ".bin", buffer))
    files.append((path.name, main))
    told.carried = _counted(files, asked)
    return files


def _obj(texf, path, asked, told):
    from .mtl import write_mtl
    from .obj import write_obj_coloured, write_obj_points, write_obj_textured

    in_colours = asked.appearance != "texture" or len(texf.faces) == 0
    _name_losses(texf, told, "OBJ", asked.appearance, IN_COLOURS if in_colours else IN_MTL)
    if asked.appearance == "voxels":
        return [(path.name, write_obj_points(texf))]
    if in_colours:
        return [(path.name, write_obj_coloured(texf))]
    stem, (look, images) = _without_blanks(path.stem), _textured(texf, asked, told)
    files = _image_files(stem, images)
    extended = sorted({statement for maps in look.images for name in maps for statement in MAP_STATEMENTS.get(name, ())})
    if extended:
        told.remarks.append(f"some readers of MTL do not know {', '.join(extended)}, which hold maps of light")
    return [
        *files,
        (stem + ".mtl", write_mtl(texf, look, [name for name, _ in files], told.warnings)),
        (path.name, write_obj_textured(texf, look, stem + ".mtl")),
    ]


def _ply(texf, path, asked, told):
    from .ply import write_ply_points, write_ply_surface
    from .vertex_fit import NO_LESS, psnr_at_vertices

    _name_losses(texf, told, "PLY", asked.appearance, IN_COLOURS)
    if asked.appearance == "voxels":
        return [(path.name, write_ply_points(texf))]
    psnr = psnr_at_vertices(texf) if asked.sketched else None
    if psnr is not None and psnr < NO_LESS:
        told.drop("PLY", [f"the detail of images between vertices (their colours there show {psnr:.1f} dB)"])
    dropped: list[str] = []
    pieces = write_ply_surface(texf, dropped)
    told.drop("PLY", dropped)
    return [(path.name, pieces)]


def _npz(texf, path, asked, told):
    from .npz import arrays, lost_maps

    told.drop(f"NPZ of {asked.appearance}", lost_maps(texf, asked.appearance))
    held = arrays(texf, asked.appearance)
    return [(path.name, lambda file: np.savez(file, **held))]


_WRITERS = {".glb": _glb, ".gltf": _gltf, ".obj": _obj, ".ply": _ply, ".npz": _npz}


def _name_losses(texf, told, form, appearance, held):
    """Name what a format cannot hold and the stream has. held: effects that it can, of lost_effects.py."""
    told.drop(form, ["metadata"] * bool(texf.metadata))
    if appearance == "voxels":
        return
    told.drop(form, lost_effects(texf, held))
    if form == "OBJ" and appearance == "vertex" and texf.has_alpha:
        told.warnings.append("OBJ vertex colours have no alpha: it is not written")
    if len(texf.materials) > 1 and (form == "PLY" or appearance == "vertex"):
        told.warnings.append(f"{form} with vertex colours has no materials: the mesh becomes one surface")


def _textured(texf, asked, told):
    """(Textured, [(ImageFormat, bytes) of each of its textures]); tells of warnings and seams."""
    from .output_textures import textured

    look = textured(texf, told.looks, asked.texture_size, asked.atlas)
    told.warnings += look.warnings
    ours = np.array([one.skin >= 0 and look.looks.skins[one.skin].field is None for one in look.looks.looks], bool)
    shown = np.flatnonzero((look.face_image >= 0) & ours[look.looks.face_look])
    if len(shown):
        told.seams = measure_seams(texf.lattice_positions, texf.faces[shown], look.corner_uv[shown], look.textures,
                                   look.face_image[shown])
    look = with_shared_images(look, tints=told.looks is not None and not told.looks.apart)
    return look, _encoded(look, asked, told.warnings, texf.threads)


def _encoded(look, asked, warnings, threads):
    """[(ImageFormat, bytes)] of the textures of a Textured, several at a time."""
    wanted = None if asked.texture_format == AUTO else IMAGE_FORMATS[asked.texture_format]
    forms = [wanted and format_for(texture.image, wanted, warnings) for texture in look.textures]

    def one(number):
        texture, form = look.textures[number], forms[number]
        if form is None:
            return automatic_image(texture.image, look.steps[number], texture.srgb)
        quality = asked.texture_quality if form.quality is not None else None
        return form, encode_image(texture.image, form, quality, texture.srgb)

    at_once = 1 if asked.texture_format == "ktx2" else threads  # nobody says that its encoder may run twice at a time
    return list(in_order(one, range(len(forms)), at_once))


def _image_files(stem, images):
    """[(name, pieces)] of images (ImageFormat, bytes) beside a mesh file of that stem."""
    names = _image_names(stem, [form for form, _ in images])
    return [(name, [data]) for name, (_, data) in zip(names, images, strict=True)]


def check_target(path: Path, inputs: Iterable[str | PathLike] = ()) -> None:
    """Refuse hopeless paths before minutes of baking, and files that were read. inputs: paths."""
    try:
        if not path.parent.is_dir():
            raise InputError("TXF-O01", "the folder does not exist", path=str(path.parent))
        if path.is_dir() or not os.access(path.parent, os.W_OK):
            raise InputError("TXF-O02", "the output cannot be written", path=str(path))
    except OSError as error:  # a folder on the way that nobody may look into, or a disk that does not answer
        raise as_input_error(error, path) from error
    check_no_input(path, inputs)


def check_no_input(path: Path, inputs: Iterable[str | PathLike]) -> None:
    """InputError TXF-O07 where path is, by whatever spelling or link, one of the files that were read."""
    for read in inputs:
        try:
            same = os.path.samefile(path, read)
        except (OSError, ValueError):  # one of them is not there, so they are not the same
            same = False
        if same:
            raise InputError("TXF-O07", "the output would overwrite an input file", path=str(path), read=str(read))


def check_sides(folder: Path, names: Iterable[str], inputs: Iterable[str | PathLike], overwrite: bool,
                own: frozenset[str] = frozenset()) -> None:
    """Files that the user did not name: InputError TXF-O07 for one that was read, TXF-O08 for one that is there already. own:
    names of those that the output came with when it was written before, which may be replaced."""
    for name in names:
        check_no_input(folder / name, inputs)
        if not overwrite and name not in own and os.path.lexists(folder / name):
            raise InputError("TXF-O08", "a file beside the output already exists; --overwrite replaces it",
                             path=str(folder / name))


def write_all(folder: Path, files: list[tuple[str, Any]], inputs: Iterable[str | PathLike] = (), overwrite: bool = True) -> None:
    """Write all files under temporary names, then rename them in order (main file last); remove the temporaries on failure.

    files: [(name, pieces)], pieces being bytes-like items or a function of the open file. inputs: paths that no file may
    replace; overwrite: whether all but the last may replace what is there.
    """
    token = secrets.token_hex(4)
    names = [(folder / f".{name}.{token}.tmp", folder / name) for name, _ in files]
    try:
        for (temporary, _), (_, pieces) in zip(names, files, strict=True):
            with cleanup.new_file(temporary) as file:
                if callable(pieces):
                    pieces(file)
                else:
                    file.writelines(pieces)
        check_no_input(names[-1][1], inputs)
        check_sides(folder, [name for name, _ in files[:-1]], inputs, overwrite, own_sides(names[-1][1]))
        cleanup.rename_all(names)
    except OSError as error:
        raise as_input_error(error, names[-1][1]) from error
    finally:
        for temporary, _ in names:
            cleanup.remove(temporary)


def as_input_error(error: OSError, path: Path) -> InputError:
    """The InputError (TXF-O01 to O04) that an OSError while writing path, a Path, stands for."""
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return InputError("TXF-O01", "the folder does not exist", path=str(path.parent))
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.EISDIR):
        return InputError("TXF-O02", "the output cannot be written", path=str(path))
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return InputError("TXF-O03", "the disk is full", path=str(path))
    return InputError("TXF-O04", error.strerror or "the operating system rejected the file", path=str(path), errno=error.errno)
