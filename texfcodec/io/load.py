"""Loading: a path or a mesh object becomes a Scene, or one error with a code of findings.py (TXF-I01 to I41)."""

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
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
    """Read a mesh file or a mesh object.

    Parameters
    ----------
    source : str, PathLike, bytes-like, file object, trimesh.Trimesh, trimesh.Scene, Scene or dict
        A path of a file in one of formats.FORMATS; the bytes of such a file, or a file object open for reading them; or a mesh in
        memory; or arrays by name, as sparse.arrays.read_arrays() takes them. The suffix of a file object's name gives its format;
        without a known suffix the first bytes do.
    strict : bool
        Whether missing textures, broken images and broken UVs are errors instead of warnings.
    limits : Limits, optional
        Limits of images, by their pixels, and of a stream that a GLB or glTF carries. Such a stream is read in place of the
        meshes beside it.

    Returns
    -------
    Scene
        The mesh in world space. COLLADA and 3MF state unit and axes: their positions are in metres with Y up. Positions of all
        other formats are as the file has them. A Scene is checked and returned as it is.

    Raises
    ------
    InputError, SupportError, LimitError
        Codes TXF-I01 to I41 of findings.py; nothing else is raised.
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
    if isinstance(source, Mapping):
        from .sparse.arrays import read_arrays

        return no_metal(_guarded(lambda: read_arrays(source, notes), "TXF-I44"))
    if is_trimesh(source):
        return no_metal(_guarded(lambda: read_trimesh(source, notes), "TXF-I22"))
    raise InputError("TXF-I05", "this type cannot be loaded; pass a path, bytes, a binary file object, a trimesh object, a "
                                "Scene or a dict of arrays",
                     value=type(source).__name__)


def load_posed(source: object, times: Sequence[float], animation: str | None = None,
               limits: Limits | None = None) -> Iterator[Scene]:
    """Read a glTF file in the poses of an animation.

    Parameters
    ----------
    source : str, PathLike, bytes-like or file object
        A .glb or .gltf file; streams of its meshes are decoded once.
    times : sequence of float
        Seconds.
    animation : str, optional
        Name or number; None for the first.
    limits : Limits, optional
        As of load().

    Yields
    ------
    Scene
        The meshes in world space, at each time.

    Raises
    ------
    InputError, SupportError, LimitError
        As load(); TXF-I29 if the input has no such animation.
    """
    from .gltf.pose import plain_glb, read_posed

    with recording() as files:
        data, folder = read_source(source)
        if isinstance(source, (str, os.PathLike)):
            opened(Path(source))
        plain = _guarded(lambda: plain_glb(data, folder, limits or Limits()), "TXF-I09")
    for time in times:
        notes = Notes(limits=limits)
        notes.path = Path(source) if isinstance(source, (str, os.PathLike)) else Path()
        with recording() as more:
            scene = _guarded(partial(read_posed, plain, folder, notes, time, animation), "TXF-I09")
        scene.files = files | more
        yield scene


def read_source(source: object) -> tuple[bytes, Path]:
    """Read a file without parsing it.

    Parameters
    ----------
    source : str, PathLike, bytes-like or file object
        As of load().

    Returns
    -------
    tuple of bytes and Path
        Its bytes, and the folder that relative names in it start from.

    Raises
    ------
    InputError
        TXF-I01 to I05.
    """
    if isinstance(source, (str, os.PathLike)):
        return _read_file(Path(source)), Path(source).parent
    if isinstance(source, (bytes, bytearray, memoryview)):
        return bytes(source), Path()
    if hasattr(source, "read"):
        return _read_object(source), Path(_name_of(source) or "").parent
    raise InputError("TXF-I05", "expected the bytes of a file, its path, or a file object", value=type(source).__name__)


def _load_file(path, notes):
    data = _read_file(path)
    opened(path)
    entry = format_of(path.suffix.lower())
    if entry is None:
        raise InputError("TXF-I05", "the suffix does not belong to a supported format", value=path.suffix.lower() or "none",
                         looks_like=what_it_is(data) or None, allowed=" ".join(SUFFIXES))
    return _scene_of(data, path, entry, notes)


def _load_data(data, name, notes):
    """Scene of the bytes of a file. name: its path as text, or None. Files that the data name are looked for beside that path, or
    in the working folder if there is none."""
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
    """The name of a file object, or None. The name of a file that was opened by its descriptor is a number, which does not
    count."""
    name = getattr(file, "name", None)
    return os.fspath(name) if isinstance(name, (str, os.PathLike)) and name else None


def _scene_of(data, path, entry, notes):
    """Scene of the bytes of a file. path: of the file; other files that it names are beside it. entry: its Format."""
    if entry.text:
        data = as_utf8(data)
    check_start(data, entry)
    notes.path = path
    read = getattr(import_module(f".{entry.module}", __package__), entry.function)
    scene = _guarded(lambda: read(data, path.parent, notes), entry.code)
    return scene if entry.function == "read_gltf" else no_metal(scene)


def no_metal(scene: Scene) -> Scene:
    """Set metalness to 0 in materials that do not state it, in place, and return the Scene.

    Formats without metalness mean materials that are not metal, while glTF's default is 1.

    Parameters
    ----------
    scene : Scene
        A Scene from a file in a format other than glTF.

    Returns
    -------
    Scene
        The same Scene.
    """
    for material in scene.materials:
        absent = (1.0,) if material.maps.get("metallic") == -1 else (0.0,)
        if material.parameters.setdefault("metallic", absent) == (1.0,):  # the file says metal, which is the default
            del material.parameters["metallic"]
    return scene


def _read_file(path):
    """Bytes of a file, never empty. Raises InputError TXF-I01 to I04."""
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
    """Return read()'s result. Exceptions of damaged input become InputError with this code."""
    try:
        with np.errstate(all="ignore"):  # overflow and NaN reach assemble as values, which it refuses or names
            return read()
    except _DAMAGE as error:
        raise InputError(code, "the input is malformed", reason=f"{type(error).__name__}: {error}"[:200]) from error
    except MemoryError as error:
        raise LimitError("TXF-I41", "there is not enough memory for the input", reason=str(error)[:200]) from error
