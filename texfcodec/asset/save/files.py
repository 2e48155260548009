"""Saving a decoded stream as GLB, glTF, OBJ, PLY or NPZ: everything under a temporary name first, then renamed.

A Texf stands in a later room, so that signatures here say Any.
"""

import errno
import io
import json
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

    texf: decoded stream (Texf). appearance: "texture" (an atlas is made and baked; NPZ: every decoded array), "vertex" (colours
    at vertices), "voxels" (point cloud of voxel centres); None means texture, but vertex for PLY, which has no texture.
    texture_size: side in texels or None; atlas: "auto", "quality" or "fast". Side files (.bin, .png, .mtl) take the name of path.
    overwrite: whether side files may replace what is there; path itself always may. inputs: paths that nothing may replace.
    Returns {"warnings": [one sentence each], "files": [names written]}.
    Raises InputError: TXF-O01 no such directory, TXF-O02 not writable, TXF-O03 disk full, TXF-O04 other operating system error,
    TXF-O05 suffix, TXF-O06 appearance, TXF-O07 a file would replace an input, TXF-O08 a side file is there already, TXF-O10..O12
    atlas. After an error nothing half-written remains.
    """
    path = Path(path)
    suffix, appearance, warnings = _checked(path, appearance)
    check_target(path, inputs)
    check_sides(path.parent, _side_names(texf, path, suffix, appearance), inputs, overwrite)
    files = _WRITERS[suffix](texf, path, appearance, (texture_size, atlas), warnings)
    write_all(path.parent, files, inputs, overwrite)
    return {"warnings": warnings, "files": [name for name, _ in files]}


def as_glb(texf: Any, appearance: str | None = None, texture_size: int | None = None,
           atlas: str = "auto") -> tuple[bytes, list[str]]:
    """The bytes of the GLB that save() would write, and its warnings: (bytes, [one sentence each])."""
    suffix, appearance, warnings = _checked(Path("stream.glb"), appearance)
    ((_, pieces),) = _WRITERS[suffix](texf, Path("stream.glb"), appearance, (texture_size, atlas), warnings)
    return b"".join(pieces), warnings


def _checked(path, appearance):
    """(suffix, appearance, warnings) of what save() was asked for."""
    suffix, warnings = path.suffix.lower(), []
    if suffix not in SUFFIXES:
        raise InputError("TXF-O05", "the file name must end in a known suffix", value=path.suffix, allowed=" ".join(SUFFIXES))
    if appearance not in (None, *APPEARANCES):
        raise InputError("TXF-O06", "appearance not known", value=appearance, allowed=" ".join(APPEARANCES))
    if suffix == ".ply" and appearance == "texture":
        warnings.append("PLY has no texture here: vertex colours are written")
    return suffix, ("vertex" if suffix == ".ply" else "texture") if appearance is None else appearance, warnings


def _side_names(texf, path, suffix, appearance):
    """Names of the files that the writers put beside path, known before the work."""
    textured = appearance == "texture" and len(texf.faces) > 0
    if suffix == ".gltf":
        return [path.stem + ".png"] * textured + [path.stem + ".bin"]
    if suffix == ".obj" and textured:
        return [_without_blanks(path.stem) + ".png", _without_blanks(path.stem) + ".mtl"]
    return []


def _without_blanks(stem):
    """A name as readers of OBJ and MTL take it, which split names at blanks."""
    return "_".join(stem.split())


def _glb(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import gltf_write

    if appearance == "texture":
        baked = _baked(texf, bake_options, warnings)
        document = gltf_write.textured(texf, baked, None, _png(texf, baked))
    else:
        document = gltf_write.coloured(texf) if appearance == "vertex" else gltf_write.points(texf)
    warnings += document.warnings
    return [(path.name, gltf_write.glb(document))]


def _gltf(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import gltf_write

    files = []
    if appearance == "texture":
        baked = _baked(texf, bake_options, warnings)
        if len(texf.faces):
            files.append((path.stem + ".png", [_png(texf, baked)]))
        document = gltf_write.textured(texf, baked, quote(path.stem + ".png"), None)
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
    baked = _baked(texf, bake_options, warnings)
    stem = _without_blanks(path.stem)
    return [
        (stem + ".png", [_png(texf, baked)]),
        (stem + ".mtl", ply_write.mtl(texf, stem + ".png")),
        (path.name, ply_write.obj_textured(texf, baked, stem + ".mtl")),
    ]


def _ply(texf, path, appearance, bake_options, warnings):
    from texfcodec.asset.save import ply_write

    _name_losses(texf, warnings, "PLY", appearance)
    return [(path.name, ply_write.ply_points(texf) if appearance == "voxels" else ply_write.ply_surface(texf))]


def _npz(texf, path, appearance, bake_options, warnings):
    from .appearance import vertex_colours
    from .bake import to_bytes

    header = {"origin": texf.origin, "side": texf.side, "position_bits": texf.position_bits, "resolution": texf.resolution}
    if appearance == "vertex":
        vertex, index, material, rgba = vertex_colours(texf, with_material=True)
        arrays = {"positions": texf.positions[vertex], "faces": index, "vertex_material": material, "rgba": to_bytes(rgba)}
    else:
        voxels = texf.voxels()
        arrays = {f"voxel_{name}": voxels[name] for name in ("xyz", "field", "rgba")}
        if appearance == "voxels":
            arrays["voxel_center"] = voxels["center"]
        else:
            arrays |= {"lattice_positions": texf.lattice_positions, "faces": texf.faces}
            arrays |= {"face_material": texf.face_material, "face_field": texf.face_field}
    arrays |= header | {"materials": json.dumps([_described(m) for m in texf.materials]), "metadata": json.dumps(texf.metadata)}
    return [(path.name, lambda file: np.savez(file, **arrays))]


_WRITERS = {".glb": _glb, ".gltf": _gltf, ".obj": _obj, ".ply": _ply, ".npz": _npz}


def _described(material):
    return {
        "name": material.name,
        "alpha_mode": int(material.alpha_mode),
        "alpha_cutoff": float(material.alpha_cutoff),
        "double_sided": bool(material.double_sided),
        "unlit": bool(material.unlit),
    }


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


def _baked(texf, bake_options, warnings):
    from .bake import bake

    baked = bake(texf, *bake_options)
    warnings += baked.warnings
    return baked


def _png(texf, baked):
    """The baked image as PNG bytes, without the alpha channel when the stream has none."""
    from PIL import Image

    out = io.BytesIO()
    image = baked.image if texf.has_alpha else np.ascontiguousarray(baked.image[..., :3])
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
