"""texfcodec: a codec for textured meshes that keeps the texture in the voxels the surface touches.

Names are imported when they are first used, so that `import texfcodec` is quick; editors and type checkers read the imports here.
"""

from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "Cancelled", "DecodeOptions", "EncodeOptions", "Encoded", "InputError", "JointCodec", "LimitError", "Limits", "LossWarning",
    "EncodedContainer", "PlaneCodec", "Report", "Scene", "StreamError", "SupportError", "Texf", "TexfError", "decode", "encode",
    "encode_gltf", "encode_to_result", "expand", "inspect",
]
__version__ = "1.0.0"

if TYPE_CHECKING:
    from .api import decode, encode, encode_gltf, encode_to_result, expand, inspect
    from .codecs.base import JointCodec, PlaneCodec
    from .encoder.container.encode import EncodedContainer
    from .encoder.write import Encoded
    from .errors import InputError, LimitError, LossWarning, StreamError, SupportError, TexfError
    from .limits import Limits
    from .options import DecodeOptions, EncodeOptions
    from .report import Cancelled, Report
    from .scene.scene import Scene
    from .texf import Texf
else:
    _HOME = {
        "encode": "api", "encode_to_result": "api", "encode_gltf": "api", "expand": "api", "decode": "api", "inspect": "api",
        "Texf": "texf", "Encoded": "encoder.write", "EncodedContainer": "encoder.container.encode", "Scene": "scene.scene",
        "PlaneCodec": "codecs.base", "JointCodec": "codecs.base", "EncodeOptions": "options", "DecodeOptions": "options",
        "Limits": "limits", "Report": "report", "Cancelled": "report", "TexfError": "errors", "InputError": "errors",
        "StreamError": "errors", "LimitError": "errors", "SupportError": "errors", "LossWarning": "errors",
    }

    def __getattr__(name):
        if name not in _HOME:
            raise AttributeError(f"module 'texfcodec' has no attribute {name!r}")
        return getattr(import_module("." + _HOME[name], __name__), name)

    def __dir__():
        return [*__all__, "__version__"]
