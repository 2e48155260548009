"""Saving a decoded stream as GLB, glTF, OBJ, PLY or NPZ: everything under a temporary name first, then renamed.

A Texf stands in a later room, so that signatures here say Any.
"""

import errno
import io
import os
import secrets
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...errors import InputError
from ...ground import unfinished

APPEARANCES = ("texture", "vertex", "voxels")
SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".npz")


def save(texf: Any, path: str | PathLike, appearance: str | None = None, texture_size: int | None = None, atlas: str = "auto",
         overwrite: bool = False, inputs: Iterable[str | PathLike] = ()) -> dict:
    """Write a decoded stream; the suffix of path chooses the format.

    texf: decoded stream (Texf). appearance: "texture", "vertex" (colours at vertices), "voxels" (point cloud of voxel centres);
    None means texture, but vertex for PLY, which has no texture. With texture a field over texels keeps its image and its UVs,
    and all fields over voxels are baked into one atlas; an NPZ holds every decoded array, see npz_write.arrays().
    texture_size: side of the atlas in texels or None; atlas: "auto", "quality" or "fast"; fields over texels have no part in
    them. Side files (.bin, .png, .mtl) take the name of path; several images are numbered from 0, the atlas first.
    overwrite: whether side files may replace what is there; path itself always may. inputs: paths that nothing may replace.
    Returns {"warnings": [one sentence each], "files": [names written]}.
    Raises InputError: TXF-O01 no such directory, TXF-O02 not writable, TXF-O03 disk full, TXF-O04 other operating system error,
    TXF-O05 suffix, TXF-O06 appearance, TXF-O07 a file would replace an input, TXF-O08 a side file is there already, TXF-O10..O12
    atlas, TXF-O13 no voxels. After an error nothing half-written remains.
    """
    path = Path(path)
    suffix, appearance, warnings = _checked(texf, path, appearance)
    check_target(path, inputs)
    check_sides(path.parent, _side_names(texf, path, suffix, appearance), inputs, overwrite)
    files = _WRITERS[suffix](texf, path, appearance, (texture_size, atlas), warnings)
    write_all(path.parent, files, inputs, overwrite)
    return {"warnings": warnings, "files": [name for name, _ in files]}


def as_glb(texf: Any, appearance: str | None = None, texture_size: int | None = None,
           atlas: str = "auto") -> tuple[bytes, list[str]]:
    """The bytes of the GLB that save() would write, and its warnings: (bytes, [one sentence each])."""
    suffix, appearance, warnings = _checked(texf, Path("stream.glb"), appearance)
    ((_, pieces),) = _WRITERS[suffix](texf, Path("stream.glb"), appearance, (texture_size, atlas), warnings)
    return b"".join(pieces), warnings


def _checked(texf, path, appearance):
    """(suffix, appearance, warnings) of what save() was asked for."""
    suffix, warnings = path.suffix.lower(), []
    if suffix not in SUFFIXES:
        raise InputError("TXF-O05", "the file name must end in a known suffix", value=path.suffix, allowed=" ".join(SUFFIXES))
    if appearance not in (None, *APPEARANCES):
        raise InputError("TXF-O06", "appearance not known", value=appearance, allowed=" ".join(APPEARANCES))
    if suffix == ".ply" and appearance == "texture":
        warnings.append("PLY has no texture here: vertex colours are written")
    if appearance == "voxels":
        _name_what_has_no_voxels(texf, warnings)
    return suffix, ("vertex" if suffix == ".ply" else "texture") if appearance is None else appearance, warnings


def _name_what_has_no_voxels(texf, warnings):
    """What appearance "voxels" leaves out: a warning, or InputError TXF-O13 where nothing would be left."""
    bare = [number for number, part in enumerate(texf.fields) if part.over_texels]
    if bare and len(bare) == len(texf.fields):
        raise InputError("TXF-O13", "every field of the stream is over texels: there are no voxels to write", value=len(bare))
    if bare:
        faces = int(np.isin(texf.face_field, bare).sum())
        warnings.append(f"{faces} of {len(texf.faces)} faces have their colours in texels and no voxels: they are not written")


def _side_names(texf, path, suffix, appearance):
    """Names of the files that the writers put beside path, known before the work."""
    if suffix == ".gltf":
        return [*_image_names(texf, path.stem, appearance), path.stem + ".bin"]
    images = _image_names(texf, _without_blanks(path.stem), appearance) if suffix == ".obj" else []
    return [*images, _without_blanks(path.stem) + ".mtl"] if images else []


def _image_names(texf, stem, appearance):
    """Names of the images that go with a mesh file of that stem."""
    from .textures import image_count

    count = image_count(texf) if appearance == "texture" else 0
    return [stem + ".png"] if count == 1 else [f"{stem}_{number}.png" for number in range(count)]


def _without_blanks(stem):
    """A name as readers of OBJ and MTL take it, which split names at blanks."""
    return "_".join(stem.split())


def _glb(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import gltf_write

    if appearance == "texture":
        look = _textured(texf, bake_options, warnings)
        document = gltf_write.textured(texf, look, [_png(t.image) for t in look.textures])
    else:
        document = gltf_write.coloured(texf) if appearance == "vertex" else gltf_write.points(texf)
    warnings += document.warnings
    return [(path.name, gltf_write.glb(document))]


def _gltf(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import gltf_write

    files = []
    if appearance == "texture":
        look, names = _textured(texf, bake_options, warnings), _image_names(texf, path.stem, appearance)
        files += _image_files(look, names)
        document = gltf_write.textured(texf, look, [quote(name) for name in names])
    else:
        document = gltf_write.coloured(texf) if appearance == "vertex" else gltf_write.points(texf)
    warnings += document.warnings
    main, buffer = gltf_write.gltf(document, quote(path.stem + ".bin"))
    if buffer:
        files.append((path.stem + ".bin", buffer))
    return [*files, (path.name, main)]


def _obj(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import ply_write

    _name_losses(texf, warnings, "OBJ", appearance)
    if appearance == "voxels":
        return [(path.name, ply_write.obj_points(texf))]
    if appearance == "vertex" or len(texf.faces) == 0:
        return [(path.name, ply_write.obj_coloured(texf))]
    stem, look = _without_blanks(path.stem), _textured(texf, bake_options, warnings)
    names = _image_names(texf, stem, appearance)
    return [
        *_image_files(look, names),
        (stem + ".mtl", ply_write.mtl(texf, look, names, warnings)),
        (path.name, ply_write.obj_textured(texf, look, stem + ".mtl")),
    ]


def _ply(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import ply_write

    _name_losses(texf, warnings, "PLY", appearance)
    return [(path.name, ply_write.ply_points(texf) if appearance == "voxels" else ply_write.ply_surface(texf))]


def _npz(texf, path, appearance, bake_options, warnings):
    from .npz_write import arrays

    held = arrays(texf, appearance)
    return [(path.name, lambda file: np.savez(file, **held))]


_WRITERS = {".glb": _glb, ".gltf": _gltf, ".obj": _obj, ".ply": _ply, ".npz": _npz}


def _name_losses(texf, warnings, form, appearance):
    """Name what a format cannot hold and the stream has."""
    if texf.metadata:
        warnings.append(f"{form} cannot hold metadata: it is not written")
    if appearance == "voxels":
        return
    if any(m.unlit or m.double_sided or m.alpha_mode for m in texf.materials):
        warnings.append(f"{form} cannot hold alpha mode, double-sided and unlit flags: they are not written")
    if form == "OBJ" and appearance == "vertex" and texf.has_alpha:
        warnings.append("OBJ vertex colours have no alpha: it is not written")
    if len(texf.materials) > 1 and (form == "PLY" or appearance == "vertex"):
        warnings.append(f"{form} with vertex colours has no materials: the mesh becomes one surface")


def _textured(texf, bake_options, warnings):
    from .textures import textured

    look = textured(texf, *bake_options)
    warnings += look.warnings
    return look


def _image_files(look, names):
    return [(name, [_png(texture.image)]) for name, texture in zip(names, look.textures, strict=True)]


def _png(image):
    """An image, uint8 [H, W, 3] or [H, W, 4], as PNG bytes."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, "PNG", compress_level=3)
    return out.getvalue()


def check_target(path: Path, inputs: Iterable[str | PathLike] = ()) -> None:
    """Refuse hopeless paths before minutes of baking, and files that were read. inputs: paths."""
    if not path.parent.is_dir():
        raise InputError("TXF-O01", "no such directory", path=str(path.parent))
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise InputError("TXF-O02", "cannot write there", path=str(path))
    check_no_input(path, inputs)


def check_no_input(path: Path, inputs: Iterable[str | PathLike]) -> None:
    """InputError TXF-O07 where path is, by whatever spelling or link, one of the files that were read."""
    for read in inputs:
        try:
            same = os.path.samefile(path, read)
        except (OSError, ValueError):  # one of them is not there, so they are not the same
            same = False
        if same:
            raise InputError("TXF-O07", "the output would replace a file that was read", path=str(path), read=str(read))


def check_sides(folder: Path, names: Iterable[str], inputs: Iterable[str | PathLike], overwrite: bool) -> None:
    """Files that the user did not name: InputError TXF-O07 for one that was read, TXF-O08 for one that is there already."""
    for name in names:
        check_no_input(folder / name, inputs)
        if not overwrite and os.path.lexists(folder / name):
            raise InputError("TXF-O08", "a file beside the output is there already and was not named; --overwrite replaces it",
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
            with unfinished.new_file(temporary) as file:
                if callable(pieces):
                    pieces(file)
                else:
                    file.writelines(pieces)
        check_no_input(names[-1][1], inputs)
        check_sides(folder, [name for name, _ in files[:-1]], inputs, overwrite)
        unfinished.rename_all(names)
    except OSError as error:
        raise as_input_error(error, names[-1][1]) from error
    finally:
        for temporary, _ in names:
            unfinished.remove(temporary)


def as_input_error(error: OSError, path: Path) -> InputError:
    """The InputError (TXF-O01 to O04) that an OSError while writing path, a Path, stands for."""
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return InputError("TXF-O01", "no such directory", path=str(path.parent))
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.EISDIR):
        return InputError("TXF-O02", "cannot write there", path=str(path))
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return InputError("TXF-O03", "no room left on the disk", path=str(path))
    return InputError("TXF-O04", error.strerror or "the operating system refused the file", path=str(path), errno=error.errno)
