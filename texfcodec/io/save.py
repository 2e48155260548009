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
    """Write a decoded stream to files; after an error nothing half-written remains.

    Parameters
    ----------
    texf : Texf
        The decoded stream.
    path : str or PathLike
        The main file. Its suffix chooses the format: .glb, .gltf, .obj, .ply or .npz. Side files (.bin, .png, .mtl) take its
        name; several images are numbered from 0, the atlas first.
    appearance : {"texture", "vertex", "voxels"}, optional
        "texture": fields over texels keep their images and UVs, and all fields over voxels are baked into one atlas. "vertex":
        colours at vertices. "voxels": a point cloud of voxel centres. None means "texture", but "vertex" for PLY, which has no
        textures, and for materials of a GLB or glTF if colours at vertices show their field as well as an image
        (vertex_colour_fit.py). An NPZ holds every decoded array (npz.arrays()).
    texture_size : int, optional
        Side of the atlas in texels. Fields over texels ignore it, and atlas too.
    atlas : {"auto", "quality", "fast"}
        Method of the atlas.
    overwrite : bool
        Whether side files may replace existing files. The main file always may.
    inputs : iterable of str or PathLike
        Files that no output may replace.
    **options
        The other fields of SaveOptions.

    Returns
    -------
    dict
        "files": names written; "warnings": sentences; "dropped": names of what the format cannot hold, each in a warning too;
        "remarks": sentences on what changes no picture; "seams": measure_seams() of the atlas, or None; "carried": None, or
        {"stream": bytes of the carried stream, "fallback": bytes of all else that is written}.

    Raises
    ------
    InputError
        TXF-O01 no such directory, TXF-O02 not writable, TXF-O03 disk full, TXF-O04 other operating system error, TXF-O05 suffix,
        TXF-O06 appearance, TXF-O07 a file would replace an input, TXF-O08 a side file exists already, TXF-O10 to O12 atlas,
        TXF-O13 no voxels, TXF-O14 texture format, quality or compression, TXF-O18 a stream in another format.
    SupportError
        TXF-O15, a package is missing.
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
    """Make the GLB that save() would write, in memory.

    Parameters
    ----------
    texf : Texf
        The decoded stream.
    **options
        Fields of SaveOptions.

    Returns
    -------
    tuple of bytes and dict
        The bytes of the GLB, and the result of save() without "files".

    Raises
    ------
    InputError, SupportError
        As save(), but for paths.
    """
    return _in_one_piece(texf, ".glb", SaveOptions(**options))


def save_into(texf: Texf, file: BinaryIO, form: str | None = None, **options: Any) -> dict:
    """Write what save() would write into a file object.

    Parameters
    ----------
    texf : Texf
        The decoded stream.
    file : BinaryIO
        A file object open for writing bytes.
    form : {"glb", "ply", "npz", "obj"}, optional
        The format; None means the suffix of the file object's name.
    **options
        Fields of SaveOptions.

    Returns
    -------
    dict
        As save(); "files" is empty.

    Raises
    ------
    InputError, SupportError
        As save(). TXF-O05 also if the format has several files, as glTF and OBJ with textures have; TXF-O04 if the object does
        not accept bytes.
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
    """(bytes, result of save() without "files") in a format without side files. Raises InputError TXF-O05 for other formats."""
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
    """Refuse options that save() would refuse for every stream.

    Parameters
    ----------
    path : str or PathLike
        The path that save() would get.
    **options
        Fields of SaveOptions.

    Raises
    ------
    InputError
        TXF-O05 suffix, TXF-O06 appearance, TXF-O14 texture format, quality or compression, TXF-O18 a stream in another format.
    SupportError
        TXF-O15, a package is missing.
    """
    choose(None, Path(path), SaveOptions(**options))
