"""Loading: a path or a mesh object becomes a Scene, or one error with a code of texfcodec/findings.py (TXF-I01 to I41)."""

import os
from importlib import import_module
from pathlib import Path

import numpy as np

from ..errors import InputError, LimitError
from ..limits import Limits
from ..scene.scene import Scene
from .formats import SUFFIXES, format_of
from .magic import as_utf8, check_start, suffix_of, what_it_is
from .opened import opened, recording
from .parts import Notes

# What Python and numpy raise when a number or a reference of a damaged file is used; the readers check what they can
# name better, this catches the rest so that no traceback reaches a user.
_DAMAGE = (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError, RecursionError)


def load(source: object, strict: bool = False, limits: Limits | None = None) -> Scene:
    """A mesh file or mesh object -> Scene in world space.

    source: path of a file in one of formats.FORMATS; its bytes, or a file object open for reading bytes, whose format is that
    of its name where it has one with a suffix, else by the first bytes; or a trimesh.Trimesh, trimesh.Scene or Scene (returned
    as it is, after a check). strict: missing textures, broken images and broken UVs are errors instead of warnings. limits: of
    images, by their pixels, and of a stream that a GLB or glTF carries, which is read in place of the meshes beside it. Positions
    of COLLADA and 3MF, which state unit and axes, are in metres with Y up; those of all other formats are as the file has them.
    Errors: InputError, SupportError, LimitError with codes of texfcodec/findings.py; nothing else.
    """
    notes = Notes(strict, limits)
    if isinstance(source, (str, os.PathLike)):
        with recording() as files:
            scene = _load_file(Path(source), notes)
        scene.files = files
        return scene
    if isinstance(source, (bytes, bytearray, memoryview)):
        return _load_data(bytes(source), None, notes)
    if hasattr(source, "read"):
        return _load_data(_read_object(source), _name_of(source), notes)
    from .trimesh_object import check_scene, is_trimesh, read_trimesh

    if isinstance(source, Scene):
        return check_scene(source)
    if is_trimesh(source):
        return no_metal(_guarded(lambda: read_trimesh(source, notes), "TXF-I22"))
    raise InputError("TXF-I05", "this type cannot be loaded; pass a path, bytes, a binary file object, a trimesh object or a "
                                "Scene",
                     value=type(source).__name__)


def _load_file(path, notes):
    data = _read_file(path)
    opened(path)
    entry = format_of(path.suffix.lower())
    if entry is None:
        raise InputError("TXF-I05", "the suffix does not belong to a supported format", value=path.suffix.lower() or "none",
                         looks_like=what_it_is(data) or None, allowed=" ".join(SUFFIXES))
    return _scene_of(data, path, entry, notes)


def _load_data(data, name, notes):
    """Scene of bytes, by their name where they have one, a path as text. Files that they name are looked for beside that path,
    or in the working folder."""
    if not data:
        raise InputError("TXF-I04", "the data is empty", path=name)
    path = Path(name or "")
    suffix = path.suffix.lower() if format_of(path.suffix.lower()) else suffix_of(data)
    if suffix is None:
        raise InputError("TXF-I05", "the first bytes do not identify the format; pass a path or a file object whose name has the "
                         "suffix", value=bytes(data[:4]).hex(),
                         looks_like=what_it_is(data) or None, allowed=" ".join(SUFFIXES))
    with recording() as files:
        scene = _scene_of(data, path, format_of(suffix), notes)
    scene.files = {name or "-": len(data), **files}
    return scene


def _read_object(file):
    """All bytes of a file object."""
    try:
        data = file.read()
    except (OSError, ValueError, AttributeError) as error:  # ValueError: it is closed, or its text is no UTF-8
        raise InputError("TXF-I03", "the file object cannot be read", reason=str(error)[:200]) from error
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise InputError("TXF-I03", "the file object returns text, not bytes; open it with mode 'rb'", value=type(data).__name__)
    return bytes(data)


def _name_of(file):
    """The name of a file object, None where it has none; files that were opened by a number are called by it."""
    name = getattr(file, "name", None)
    return os.fspath(name) if isinstance(name, (str, os.PathLike)) and name else None


def _scene_of(data, path, entry, notes):
    """Scene of the bytes of a file in a format; path: of the file, beside which others are that it names."""
    if entry.text:
        data = as_utf8(data)
    check_start(data, entry)
    notes.path = path
    read = getattr(import_module(f".{entry.module}", __package__), entry.function)
    scene = _guarded(lambda: read(data, path.parent, notes), entry.code)
    return scene if entry.function == "read_gltf" else no_metal(scene)


def no_metal(scene: Scene) -> Scene:
    """The Scene, of a format that knows no metal, with materials that are none: glTF's own default is one."""
    for material in scene.materials:
        if material.parameters.setdefault("metallic", (0.0,)) == (1.0,):  # the file says metal, which is the default
            del material.parameters["metallic"]
    return scene


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
        raise LimitError("TXF-I41", "there is not enough memory for the input", reason=str(error)[:200]) from error
