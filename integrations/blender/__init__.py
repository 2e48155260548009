"""Add-on for Blender: opens .texf files and GLBs with TEXF_stream, and exports both. docs/guide/in_blender.md.

Blender's glTF importer finds glTF2ImportUserExtension here, by its name, in every add-on that is enabled.
"""

import sys
from types import SimpleNamespace

from .codec import EXTENSION, Unusable, form_of, plain_glb


class Refused:
    """Replaces a document that cannot be decoded. At the first look at it the importer gets an error of its own kind, which it
    reports before anything is in the scene. An error of the hook is logged only, and meshes of zeros would follow."""

    def __init__(self, error: Exception) -> None:
        self.__dict__["error"] = error

    def __getattr__(self, name: str) -> object:
        raise self.__dict__["error"]


class glTF2ImportUserExtension:
    """Hands Blender's importer an ordinary glTF in place of one with streams."""

    def __init__(self) -> None:
        self.extensions = [SimpleNamespace(name=EXTENSION, required=True)]  # so that the importer does not refuse the file itself

    def gather_import_gltf_before_hook(self, gltf: object) -> None:
        """Replace the importer's document and buffer by those of the expanded file. gltf: a glTFImporter."""
        form = form_of(gltf.data)
        if form is None:
            return
        importer = sys.modules[type(gltf).__module__]
        try:
            glb, warnings = plain_glb(gltf.filename, form)
        except Unusable as error:
            if EXTENSION in (gltf.data.extensions_required or ()):
                gltf.data = Refused(importer.ImportError(str(error)))
            else:
                gltf.log.warning(f"The fallback is shown: {error}", popup=True)
            return
        root, gltf.glb_buffer = gltf.load_glb(memoryview(glb))
        gltf.data, gltf.buffers = importer.gltf_from_dict(root), {}
        for sentence in warnings:
            gltf.log.warning(sentence, popup=True)


def register() -> None:
    """Add the operators and their menu entries. Raises RuntimeError outside Blender."""
    try:
        from . import operators
    except ModuleNotFoundError as error:
        raise RuntimeError("The TEXF add-on runs inside Blender 4.2 or later, or with its module bpy.") from error
    operators.register()


def unregister() -> None:
    """Remove what register() added."""
    from . import operators

    operators.unregister()
