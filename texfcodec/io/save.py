"""Saving a decoded stream as GLB, glTF, OBJ, PLY or NPZ: choose, build, write."""

from __future__ import annotations

import io
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ..errors import InputError
from .formats import SAVED_SUFFIXES
from .output_files import check_sides, check_target, write_all
from .own_files import own_sides
from .save_build import build
from .save_choice import SaveOptions, choose, side_names

if TYPE_CHECKING:
    from ..texf import Texf


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
    wanted = SaveOptions(appearance=appearance, texture_size=texture_size, atlas=atlas, **options)
    choose(None, path, wanted)  # what can be refused comes before the work
    check_target(path, inputs)
    choice = choose(texf, path, wanted)
    check_sides(path.parent, side_names(path, choice), inputs, overwrite, own_sides(path))
    files, report = build(texf, path, choice)
    write_all(path.parent, files, inputs, overwrite)
    return {"files": [name for name, _ in files]} | report.result()


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
    data, result = _in_one_piece(texf, suffix, SaveOptions(**options))
    try:
        file.write(data)
    except (OSError, ValueError, TypeError, AttributeError) as error:  # it is closed, or open for text or reading
        raise InputError("TXF-O04", "the file object does not accept bytes", reason=str(error)[:200]) from error
    return {"files": []} | result


def _in_one_piece(texf: Texf, suffix: str, options: SaveOptions) -> tuple[bytes, dict]:
    """(bytes, what save() returns but for files) of a format that needs no file beside it. Raises InputError TXF-O05 for
    others."""
    path = Path("stream" + suffix)
    choice = choose(texf, path, options)
    if side_names(path, choice):
        raise InputError("TXF-O05", "this format writes several files, which requires a path", value=choice.suffix,
                         allowed=".glb .ply .npz")
    ((_, pieces),), report = build(texf, path, choice)
    if callable(pieces):
        held = io.BytesIO()
        pieces(held)
        pieces = [held.getvalue()]
    return b"".join(pieces), report.result()


def check_choices(path: str | PathLike, **options: Any) -> None:
    """What save() can refuse of its options (SaveOptions) before anything is decoded: InputError TXF-O05, TXF-O06, TXF-O14
    and TXF-O18, SupportError TXF-O15."""
    choose(None, Path(path), SaveOptions(**options))
