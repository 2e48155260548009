"""Accessors of a glTF file in shared bufferViews: equal ones once, and without the bounds that glTF does not ask for."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from ...core.json_text import json_text
from ...errors import InputError
from ..gltf.accessor import is_readable, rows_of_view, shape_of
from ..gltf.meshopt import EXTENSIONS as MESHOPT
from ..gltf.properties import extensions, integer
from .references import references

if TYPE_CHECKING:
    from .rewritten import Rewritten

ATTRIBUTE, INDICES = 34962, 34963  # targets of bufferViews


def pack_accessors(file: Rewritten) -> None:
    """Put the data of accessors into one bufferView for each kind of use and size of a row, and merge equal accessors.

    Accessors that are sparse or compressed, and bufferViews that something else refers to, stay as they are.
    """
    uses, bounded = _uses(file)
    plain = {number: values for number in uses if (values := _values(file, number)) is not None}
    groups: dict[tuple, bytearray] = {}
    places: dict[tuple, int] = {}
    placed: list[tuple[dict, tuple]] = []
    for number in uses.keys() - bounded:
        file.root["accessors"][number].pop("min", None)
        file.root["accessors"][number].pop("max", None)
    if _overlap(file, plain):
        return
    for number, values in plain.items():
        entry = file.root["accessors"][number]
        rows = _rows(values, pad=uses[number] == ATTRIBUTE)
        group = uses[number], rows.shape[1]
        data = rows.tobytes()
        held = groups.setdefault(group, bytearray())
        if (group, data) not in places:
            places[group, data] = len(held)
            held += data
        entry["byteOffset"] = places[group, data]
        placed.append((entry, group))
    _place(file, groups, placed)
    _merge(file)


def _uses(file):
    """Return ({accessor: its use: the target that its bufferView needs, or the array that refers to it}, accessors that need
    bounds)."""
    uses: dict[int, int | str] = {}
    bounded, mixed = set(), set()
    for holder, reference in references(file.root):
        if reference.kind != "accessors":
            continue
        use: int | str = holder[0]  # the validator wants a view for each kind of use
        if use == "meshes" and reference.key != "splits":
            use = INDICES if reference.key == "indices" else ATTRIBUTE
        if reference.key in ("POSITION", "input"):
            bounded.add(reference.target)
        if uses.setdefault(reference.target, use) != use:
            mixed.add(reference.target)
    return {number: use for number, use in uses.items() if number not in mixed}, bounded


def _values(file, number):
    """Return the values of an accessor, [N, width]; None if they are sparse, compressed by another extension, of an unknown type
    or not all there."""
    entry = file.root["accessors"][number]
    if "sparse" in entry or "bufferView" not in entry or not is_readable(entry):
        return None
    if any(name in extensions(file.root["bufferViews"][entry["bufferView"]]) for name in MESHOPT):
        return None
    try:
        return rows_of_view(file.view(entry["bufferView"]), integer(entry, "byteOffset", 0, low=0), *shape_of(entry), number)
    except InputError:
        return None


def _overlap(file, plain):
    """Return whether accessors share so many bytes that copies of each would make the file much larger."""
    views = {file.root["accessors"][number]["bufferView"] for number in plain}
    return sum(values.nbytes for values in plain.values()) > 2 * sum(len(file.view(view)[0]) for view in views)


def _rows(values, pad):
    """Return the rows of values, uint8 [N, bytes]. pad: whether to multiples of four bytes."""
    rows = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4))) if pad else rows


def _place(file, groups, placed):
    """Add a bufferView for each group, and name it in the accessors."""
    users = Counter(group for _, group in placed)
    numbers = {}
    for group, data in sorted(groups.items(), key=lambda item: -item[0][1]):
        use, size = group
        properties = {"target": use} if isinstance(use, int) else {}
        if use == ATTRIBUTE and (users[group] > 1 or any(size != row_size(e) for e, of in placed if of == group)):
            properties["byteStride"] = size
        numbers[group] = file.add_view(bytes(data), **properties)
    for entry, group in placed:
        entry["bufferView"] = numbers[group]
        if not entry["byteOffset"]:
            del entry["byteOffset"]


def row_size(entry: dict) -> int:
    """Return the bytes of a row of an accessor, without padding."""
    shape, dtype = shape_of(entry)
    return shape[1] * dtype.itemsize


def _merge(file):
    """Make references to equal accessors refer to the first of them."""
    first: dict[str, int] = {}
    same = {}
    for number, entry in enumerate(file.root.get("accessors", [])):
        same[number] = first.setdefault(json_text(entry, sort_keys=True), number)
    for _, reference in list(references(file.root)):
        if reference.kind == "accessors":
            reference.owner[reference.key] = same[reference.target]
