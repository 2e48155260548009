"""glTF accessors -> numpy arrays: strides, interleaving, every component type, sparse (glTF 2.0 section 3.6.2)."""

import numpy as np

from ...errors import InputError, LimitError
from .document import Document
from .properties import integer, malformed, part

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5124: "<i4", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MAX_IMPLICIT = 1 << 24  # elements an accessor without data may ask for: zeros cost the file nothing, us memory


def read_accessor(document: Document, index: int, kinds: tuple[str, ...]) -> np.ndarray:
    """Raw array [count, width] in the stored dtype; a view of the file unless the accessor is sparse.

    kinds: allowed types, e.g. ("VEC3",). Errors: TXF-I09 malformed, TXF-I11 outside its buffer, LimitError TXF-I41.
    """
    entry = document.entry("accessors", index)
    if entry.get("type") not in kinds or not is_readable(entry):
        raise malformed(f"accessor {index} has an unexpected type", value=str(entry.get("type"))[:20],
                        component=str(entry.get("componentType"))[:20], allowed="/".join(kinds))
    shape, dtype = shape_of(entry)
    if "bufferView" in entry:
        array = _from_view(document, entry["bufferView"], integer(entry, "byteOffset", 0, low=0), shape, dtype, index)
    elif shape[0] <= MAX_IMPLICIT:
        array = np.zeros(shape, dtype)
    else:
        raise LimitError("TXF-I41", f"accessor {index} has too many elements", value=shape[0], allowed=MAX_IMPLICIT)
    if "sparse" not in entry:
        return array
    if index not in document.sparse:
        document.sparse[index] = _with_sparse(document, entry, array, index)
    return document.sparse[index]


def is_readable(entry: dict) -> bool:
    """Return whether shape_of() knows the types of an accessor. Matrices of 2 x 2 and 3 x 3 have padding, which is not read."""
    kind, component = entry.get("type"), entry.get("componentType")
    return isinstance(kind, str) and kind in _WIDTHS and isinstance(component, int) and component in DTYPES


def shape_of(entry: dict) -> tuple[tuple[int, int], np.dtype]:
    """((count, width), type of a component) of an accessor of a known type."""
    return (integer(entry, "count", low=1), _WIDTHS[entry["type"]]), np.dtype(DTYPES[entry["componentType"]])


def read_floats(document: Document, index: int, kinds: tuple[str, ...], normalized: bool | None = None,
                rows: np.ndarray | None = None) -> np.ndarray:
    """Array of read_accessor(), with integers scaled if normalized (section 3.6.2.2): float [count, width].

    normalized: overrides the accessor's property; rows: rows to read, None for all.
    """
    array = read_accessor(document, index, kinds)
    array = array if rows is None else array[rows]
    if normalized is None:
        normalized = document.entry("accessors", index).get("normalized", False)
    return normalized_floats(array) if normalized else array


def normalized_floats(array: np.ndarray) -> np.ndarray:
    """Integers [n, width] -> float64 in [0, 1] or [-1, 1] by their type; floats stay."""
    if array.dtype.kind == "f":
        return array
    scaled = array / np.float64(np.iinfo(array.dtype).max)
    return np.maximum(scaled, -1.0) if array.dtype.kind == "i" else scaled


def _from_view(document, view, offset, shape, dtype, index):
    return rows_of_view(document.view(view), offset, shape, dtype, index)


def rows_of_view(view: tuple[memoryview | bytes, int | None], offset: int, shape: tuple[int, int], dtype: np.dtype,
                 index: int) -> np.ndarray:
    """Array [count, width] over a bufferView, which is (bytes, byteStride or None). index: of the accessor. Raises InputError
    TXF-I11 if the array leaves the view."""
    (data, stride), (count, width) = view, shape
    size = width * dtype.itemsize
    stride = stride or size
    need = offset + stride * (count - 1) + size
    if stride < size or need > len(data):
        raise InputError("TXF-I11", f"accessor {index} exceeds its bufferView", value=need, allowed=len(data))
    return np.ndarray(shape, dtype, data, offset, (stride, dtype.itemsize))


def _with_sparse(document, entry, array, index):
    sparse = part(entry, "sparse")
    count = integer(sparse, "count", low=1)
    where, what = part(sparse, "indices"), part(sparse, "values")
    if where.get("componentType") not in (5121, 5123, 5125):
        raise malformed(f"accessor {index} has sparse indices of an unexpected type")
    rows = _from_view(document, where.get("bufferView"), integer(where, "byteOffset", 0, low=0), (count, 1),
                      np.dtype(DTYPES[where["componentType"]]), index)[:, 0]
    values = _from_view(document, what.get("bufferView"), integer(what, "byteOffset", 0, low=0),
                        (count, array.shape[1]), array.dtype, index)
    if rows.max() >= len(array):
        raise InputError("TXF-I11", f"accessor {index} has a sparse index beyond its end",
                         value=int(rows.max()), allowed=len(array) - 1)
    array = array.copy()
    array[rows] = values
    return array
