"""EXT_meshopt_compression and KHR_meshopt_compression: compressed bufferViews. meshopt_views.py decodes them, and the package
meshoptimizer, which has no wheels, decodes attributes of version 1.

The package's C code trusts counts and strides, so this module first checks every number that sizes memory: against the other
numbers of the bufferView, and against the fewest bytes that the elements can be packed into.
"""

import numpy as np

from ...errors import InputError, LimitError, SupportError
from .properties import integer, malformed

EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MAX_BYTES = 1 << 30  # of one decoded bufferView; meshoptimizer's own limit too
_STRIDES = {"ATTRIBUTES": range(4, 257, 4), "TRIANGLES": (2, 4), "INDICES": (2, 4)}
_FILTER_STRIDES = {"NONE": range(1, 257), "OCTAHEDRAL": (4, 8), "QUATERNION": (8,), "EXPONENTIAL": range(4, 257, 4)}
_NEWER_ATTRIBUTES = 0xA1  # first byte
_TAIL = 16  # bytes that end an index stream
_BLOCK_BYTES, _BLOCK_VERTICES = 8192, 256  # of an attribute block: as many vertices as fit, a multiple of 16


def decode_view(packed: memoryview, entry: dict, view: dict, index: int) -> bytes:
    """Decompress a meshopt bufferView into count * byteStride plain bytes.

    packed: its compressed bytes; entry: the extension's object; view: the bufferView around it; index: its number, for messages.
    Errors: TXF-I09 malformed, TXF-I12 broken data, SupportError TXF-I30 the package is missing or the filter unknown,
    LimitError TXF-I41.
    """
    count, stride = integer(entry, "count", low=1), integer(entry, "byteStride", low=1)
    mode, kind = entry.get("mode"), entry.get("filter", "NONE")
    if not isinstance(mode, str) or stride not in _STRIDES.get(mode, ()):
        raise malformed(f"bufferView {index} has an unusable meshopt mode or stride", mode=str(mode)[:20], value=stride)
    if not isinstance(kind, str) or kind not in _FILTER_STRIDES:
        raise SupportError("TXF-I30", f"bufferView {index} uses a meshopt filter that is not supported", value=str(kind)[:20],
                           allowed=" ".join(_FILTER_STRIDES))
    if stride not in _FILTER_STRIDES[kind] or (mode != "ATTRIBUTES" and kind != "NONE"):
        raise malformed(f"bufferView {index} has an unsuitable meshopt filter", filter=kind, value=stride)
    if integer(view, "byteLength", low=0) != count * stride:
        raise malformed(f"the length of bufferView {index} differs from its meshopt count",
                        value=view["byteLength"], allowed=count * stride)
    if count * stride > MAX_BYTES:
        raise LimitError("TXF-I41", f"bufferView {index} decodes to too many bytes", value=count * stride, allowed=MAX_BYTES)
    if mode == "TRIANGLES" and count % 3:
        raise malformed(f"the meshopt count of bufferView {index} is not a multiple of 3", value=count)
    fewest = _fewest_bytes(mode, count, stride)
    if len(packed) < fewest:
        raise InputError("TXF-I12", f"the meshopt data of bufferView {index} is too short for its count",
                         value=len(packed), allowed=fewest)
    return _decode(bytes(packed), mode, kind, count, stride, index)


def _fewest_bytes(mode, count, stride):
    """Fewest bytes that the coder needs: one for each triangle or index; for each block of attributes one for each 4 bytes of
    stride."""
    if mode == "TRIANGLES":
        return 1 + count // 3 + _TAIL
    if mode == "INDICES":
        return 1 + count + 4
    block = min(_BLOCK_BYTES // stride & ~15, _BLOCK_VERTICES)
    return 1 + -(-count // block) * (stride // 4) + stride


def _decode(packed, mode, kind, count, stride, index):
    from .meshopt_views import decode_attributes, decode_sequence, decode_triangles, unfilter  # they need numba

    if mode == "ATTRIBUTES":
        newer = packed[0] == _NEWER_ATTRIBUTES
        plain = _by_package(packed, count, stride, index) if newer else decode_attributes(packed, count, stride)
    else:
        plain = (decode_triangles if mode == "TRIANGLES" else decode_sequence)(packed, count)
    if plain is None:
        raise _broken(index)
    if mode != "ATTRIBUTES":
        plain = plain.astype(np.uint16) if stride == 2 else plain
    elif kind != "NONE":
        plain = unfilter(kind, plain)
    return memoryview(plain.tobytes())


def _broken(index, reason=None):
    return InputError("TXF-I12", f"the meshopt data of bufferView {index} cannot be decoded", reason=reason)


def _by_package(packed, count, stride, index):
    """Attributes of version 1, uint8 [count, stride], which KHR_meshopt_compression adds to version 0 of EXT."""
    try:
        import meshoptimizer
    except ImportError as error:
        raise SupportError("TXF-I30", "meshopt attributes of version 1 require the package meshoptimizer: run pip install "
                                      '"texfcodec[formats]", or decompress the file with gltfpack or '
                                      "glTF-Transform") from error
    try:
        plain = np.ascontiguousarray(meshoptimizer.decode_vertex_buffer(count, stride, packed))
    except (RuntimeError, ValueError) as error:
        raise _broken(index, str(error)[:200]) from error
    return plain.reshape(-1).view(np.uint8)[: count * stride].reshape(count, stride)
