"""Accessors of a glTF file in shared bufferViews: equal ones once, and without the bounds that glTF does not ask for."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from ...core.json_text import json_text
from ..gltf.accessor import rows_of_view, shape_of
from ..gltf.meshopt import EXTENSIONS as MESHOPT
from ..gltf.properties import extensions
from .references import references

if TYPE_CHECKING:
    from .rewritten import Rewritten

ATTRIBUTE, INDICES = 34962, 34963  # targets of bufferViews


def pack_accessors(file: Rewritten) -> None:
    """Put the data of accessors into one bufferView for each kind of use and size of a row, and merge equal accessors.

    Accessors that are sparse or compressed, and bufferViews that something else refers to, stay as they are.
    """
    uses, bounded = _uses(file)
    groups: dict[tuple, bytearray] = {}
    places: dict[tuple, int] = {}
    placed: list[tuple[dict, tuple]] = []
    for number, use in uses.items():
        entry = file.root["accessors"][number]
        if number not in bounded:
            entry.pop("min", None)
            entry.pop("max", None)
        if not _is_plain(file, entry):
            continue
        rows = _rows(file, entry, number, pad=use == ATTRIBUTE)
        group = use, rows.shape[1]
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


def _is_plain(file, entry):
    """Return whether an accessor has all its values in a bufferView that no other extension compresses."""
    if "sparse" in entry or "bufferView" not in entry:
        return False
    view = file.root["bufferViews"][entry["bufferView"]]
    return not any(name in extensions(view) for name in MESHOPT)


def _rows(file, entry, number, pad):
    """Return the rows of an accessor, uint8 [N, bytes]. pad: whether to multiples of four bytes."""
    shape, dtype = shape_of(entry)
    view = file.view(entry["bufferView"])
    values = np.ascontiguousarray(rows_of_view(view, entry.get("byteOffset", 0), shape, dtype, number))
    rows = values.view(np.uint8).reshape(shape[0], -1)
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
