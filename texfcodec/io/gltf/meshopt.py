"""EXT_meshopt_compression and KHR_meshopt_compression: compressed bufferViews, decoded by the package meshoptimizer.

The package's C code trusts counts and strides, so everything that sizes memory is checked here first: against the other
numbers of the bufferView, and against the fewest bytes that so many elements can be packed into.
"""

import numpy as np

from ...errors import InputError, LimitError, SupportError
from .properties import integer, malformed

EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MAX_BYTES = 1 << 30  # of one decoded bufferView; meshoptimizer's own limit too
_STRIDES = {"ATTRIBUTES": range(4, 257, 4), "TRIANGLES": (2, 4), "INDICES": (2, 4)}
_FILTER_STRIDES = {"NONE": range(1, 257), "OCTAHEDRAL": (4, 8), "QUATERNION": (8,), "EXPONENTIAL": range(4, 257, 4)}
_TAIL = 16  # bytes that end an index stream
_BLOCK_BYTES, _BLOCK_VERTICES = 8192, 256  # of an attribute block: as many vertices as fit, a multiple of 16


def decode_view(packed: memoryview, entry: dict, view: dict, index: int) -> bytes:
    """bytes of the compressed bufferView -> bytes of the plain one, count * byteStride of them.

    packed: memoryview; entry: the extension's object; view: the bufferView around it; index: its number, for messages.
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
    """What the coder spends at least: a byte a triangle or index; a block of attributes a control byte for each 4 of stride."""
    if mode == "TRIANGLES":
        return 1 + count // 3 + _TAIL
    if mode == "INDICES":
        return 1 + count + 4
    block = min(_BLOCK_BYTES // stride & ~15, _BLOCK_VERTICES)
    return 1 + -(-count // block) * (stride // 4) + stride


def _decode(packed, mode, kind, count, stride, index):
    meshopt = _package()
    try:
        if mode == "ATTRIBUTES":
            plain = np.ascontiguousarray(meshopt.decode_vertex_buffer(count, stride, packed)).reshape(-1).view(np.uint8)
        else:
            read = meshopt.decode_index_buffer if mode == "TRIANGLES" else meshopt.decode_index_sequence
            plain = read(count, stride, packed).view(np.uint8)[: count * stride]
    except (RuntimeError, ValueError) as error:
        raise InputError("TXF-I12", f"the meshopt data of bufferView {index} cannot be decoded",
                         reason=str(error)[:200]) from error
    if kind != "NONE":
        unfilter = {"OCTAHEDRAL": meshopt.decode_filter_oct, "QUATERNION": meshopt.decode_filter_quat,
                    "EXPONENTIAL": meshopt.decode_filter_exp}[kind]
        plain = unfilter(plain, count, stride)
    return memoryview(plain.tobytes())


def _package():
    try:
        import meshoptimizer
    except ImportError as error:
        raise SupportError("TXF-I30", "meshopt compression requires the package meshoptimizer: run pip install "
                                      '"texfcodec[formats]", or decompress the file with gltfpack or '
                                      "glTF-Transform") from error
    return meshoptimizer


def is_installed() -> bool:
    """True where compressed views can be decoded."""
    from importlib.util import find_spec

    return find_spec("meshoptimizer") is not None
