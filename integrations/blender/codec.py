"""The add-on's calls of the Python package texfcodec. Nothing here needs Blender."""

import io
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

EXTENSION = "TEXF_stream"


class Unusable(Exception):
    """The package or a file cannot be used. Its text is one sentence for the user."""


def package() -> ModuleType:
    """Return the module texfcodec. Raises Unusable with the command that installs it, if it is missing or too old."""
    command = f'"{sys.executable}" -m pip install --upgrade texfcodec'
    try:
        import texfcodec

        if hasattr(texfcodec, "encode_gltf") and hasattr(texfcodec, "expand"):
            return texfcodec
    except ImportError as error:
        raise Unusable(f"Blender's Python cannot load the package texfcodec ({error}): run {command}") from error
    version = getattr(texfcodec, "__version__", "of an unknown version")
    raise Unusable(f"texfcodec {version} is too old for this add-on: run {command}, and start Blender again")


def form_of(document: object) -> str | None:
    """Return "part" or "scene", the form in which a document of the glTF importer has the extension, or None."""
    if EXTENSION in (document.extensions or {}):
        return "part"
    scenes = document.scenes or []
    return "scene" if any(EXTENSION in (scene.extensions or {}) for scene in scenes[document.scene or 0 :][:1]) else None


def plain_glb(path: str, form: str, appearance: str | None = None) -> tuple[bytes, list[str]]:
    """Return the bytes of an ordinary GLB, and warnings. Raises Unusable.

    form: "part" of a glTF file with coded primitives, "scene" of a stream or of a GLB that carries one; appearance: of a stream,
    "texture", "vertex", or None to let the package choose."""
    with _sentences(path) as (texfcodec, said):
        if form == "part":
            return texfcodec.expand(path), said
        file = io.BytesIO()
        texfcodec.decode(path).save(file, format="glb", appearance=appearance)
        return file.getvalue(), said


def write_coded(glb: str, path: str, options: dict, on_progress: Callable[[str, int, int], object]) -> tuple[int, list[str]]:
    """Encode a GLB into a file, .texf or .glb by its suffix; return its number of bytes, and warnings. Raises Unusable; the file
    is then what it was before. options: of texfcodec.EncodeOptions."""
    with _sentences(path) as (texfcodec, said):
        if not os.access(Path(path).resolve().parent, os.W_OK):  # said before an encode that takes long
            raise Unusable(f"{Path(path).name}: its folder does not exist, or cannot be written to")
        arguments = glb, options, texfcodec.Report(on_progress)
        data = texfcodec.encode(*arguments) if path.endswith(".texf") else texfcodec.encode_gltf(*arguments).data
        new = Path(f"{path}.{os.getpid()}.part")
        try:
            new.write_bytes(data)
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)
        return len(data), said


@contextmanager
def _sentences(path: str) -> Iterator[tuple[ModuleType, list[str]]]:
    """Yield the package and a list that receives its warnings; errors become Unusable with the file's name."""
    texfcodec, said = package(), []
    with warnings.catch_warnings():
        warnings.simplefilter("always", texfcodec.LossWarning)
        warnings.showwarning = lambda message, *_, **__: said.append(str(message))
        try:
            yield texfcodec, said
        except (texfcodec.TexfError, OSError, MemoryError) as error:
            raise Unusable(f"{Path(path).name}: {str(error) or 'there is not enough memory'}") from error
