"""Loading: a path or a mesh object becomes a Scene, or one error with a code.

| code | class | meaning |
|---|---|---|
| TXF-I01 | InputError | the path does not exist |
| TXF-I02 | InputError | the path is a directory |
| TXF-I03 | InputError | the file cannot be read |
| TXF-I04 | InputError | the file is empty |
| TXF-I05 | InputError | the suffix names no supported format, or the object is of no supported type |
| TXF-I06 | InputError | the file does not start as its suffix promises |
| TXF-I07 | InputError | the GLB container is truncated or broken |
| TXF-I08 | InputError | the glTF text is not JSON |
| TXF-I09 | InputError | the glTF structure is malformed: wrong type, missing property, reference to nothing |
| TXF-I10 | InputError | a buffer is missing, unreadable or too short |
| TXF-I11 | InputError | an accessor or bufferView leaves its buffer |
| TXF-I12 | InputError | Draco or meshopt data is broken |
| TXF-I13 | InputError | a face names a vertex that does not exist |
| TXF-I14 | InputError | a vertex in use is NaN or infinite |
| TXF-I15 | InputError | there are no triangles |
| TXF-I16 | InputError | a texture or material file is missing (warning unless strict) |
| TXF-I17 | InputError | an image cannot be decoded (warning unless strict) |
| TXF-I18 | InputError | NaN or infinite UVs (warning unless strict) |
| TXF-I19 | InputError | the node graph is not a tree |
| TXF-I20 | InputError | OBJ or MTL syntax |
| TXF-I21 | InputError | PLY syntax, or a PLY file that ends early |
| TXF-I22 | InputError | a mesh object whose arrays do not fit together |
| TXF-I23 | InputError | STL or OFF syntax, or a file that ends early |
| TXF-I24 | InputError | 3MF or DAE: not the archive or XML it should be, or a reference to nothing |
| TXF-I30 | SupportError | meshopt compression without the package meshoptimizer, or with an unknown filter |
| TXF-I31 | SupportError | the file requires an unknown extension |
| TXF-I32 | SupportError | a base colour texture without a readable source (e.g. DDS), or KTX2 without opengl-basisu |
| TXF-I33 | SupportError | glTF version other than 2 |
| TXF-I34 | SupportError | Draco data, but DracoPy is not installed |
| TXF-I35 | SupportError | COLLADA, but pycollada is not installed |
| TXF-I40 | LimitError | an image beyond Pillow's pixel limit |
| TXF-I41 | LimitError | too many faces or elements, or not enough memory |
"""

import os
from importlib import import_module
from pathlib import Path

import numpy as np

from ...errors import InputError, LimitError
from ..scene import Scene
from .formats import SUFFIXES, format_of
from .magic import as_utf8, check_start, what_it_is
from .parts import Notes

# What Python and numpy raise when a number or a reference of a damaged file is used; the readers check what they can
# name better, this catches the rest so that no traceback reaches a user.
_DAMAGE = (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError, RecursionError)


def load(source, strict=False):
    """A mesh file or mesh object -> Scene in world space.

    source: path of a file in one of formats.FORMATS; or a trimesh.Trimesh, trimesh.Scene or Scene (returned as it is, after a
    check). strict: missing textures, broken images and broken UVs are errors instead of warnings. Positions keep the unit
    and the axes that the file has; nothing is scaled or turned.
    Errors: InputError, SupportError, LimitError with the codes of this module's table; nothing else.
    """
    if isinstance(source, (str, os.PathLike)):
        return _load_file(Path(source), Notes(strict))
    from .trimesh_read import check_scene, is_trimesh, read_trimesh

    if isinstance(source, Scene):
        return check_scene(source)
    if is_trimesh(source):
        return _guarded(lambda: read_trimesh(source, Notes(strict)), "TXF-I22")
    raise InputError("TXF-I05", "only paths, trimesh objects and Scenes can be loaded", value=type(source).__name__)


load_any = load


def _load_file(path, notes):
    data = _read_file(path)
    entry = format_of(path.suffix.lower())
    if entry is None:
        raise InputError("TXF-I05", "the suffix names no supported format", value=path.suffix.lower() or "none",
                         looks_like=what_it_is(data) or None, allowed=" ".join(SUFFIXES))
    if entry.text:
        data = as_utf8(data)
    check_start(data, entry)
    read = getattr(import_module(f".{entry.module}", __package__), entry.function)
    return _guarded(lambda: read(data, path.parent, notes), entry.code)


def _read_file(path):
    """bytes of the file, never empty."""
    try:
        if path.is_dir():
            raise InputError("TXF-I02", "the path is a directory", path=str(path))
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError("TXF-I01", "the file does not exist", path=str(path)) from error
    except (OSError, ValueError) as error:  # ValueError: NUL in the name
        raise InputError("TXF-I03", "the file cannot be read", path=str(path), reason=str(error)) from error
    if not data:
        raise InputError("TXF-I04", "the file is empty", path=str(path))
    return data


def _guarded(read, code):
    try:
        with np.errstate(all="ignore"):  # overflow and NaN reach assemble as values, which it refuses or names
            return read()
    except _DAMAGE as error:
        raise InputError(code, "the input is malformed", reason=f"{type(error).__name__}: {error}"[:200]) from error
    except MemoryError as error:
        raise LimitError("TXF-I41", "the input needs more memory than there is", reason=str(error)[:200]) from error
