"""texfcodec: a codec for textured meshes that keeps the texture in the voxels the surface touches.

Names are imported when they are first used, so that `import texfcodec` is quick.
"""

from importlib import import_module

_HOME = {
    "encode": "api", "encode_to_result": "api", "decode": "api", "inspect": "api", "Texf": "texf", "Encoded": "encoder",
    "PlaneCodec": "codecs.codec", "JointCodec": "codecs.codec",
    "EncodeOptions": "options", "DecodeOptions": "options", "Limits": "limits", "Report": "report",
    "TexfError": "errors", "InputError": "errors", "StreamError": "errors", "LimitError": "errors", "SupportError": "errors",
}
__all__ = sorted(_HOME)  # noqa: PLE0605
__version__ = "0.1.0"


def __getattr__(name):
    if name not in _HOME:
        raise AttributeError(f"module 'texfcodec' has no attribute {name!r}")
    return getattr(import_module("." + _HOME[name], __name__), name)


def __dir__():
    return [*__all__, "__version__"]
