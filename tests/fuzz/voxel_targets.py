"""Targets of the two readers of sparse voxels: archives of arrays, and .vxz files in all forms, with something odd in them."""

import io
import json
import struct
import zipfile
from functools import lru_cache

import numpy as np
from voxel_files import shell, write_vxz

from fuzz.choices import Choices, edited
from fuzz.trees import bend_tree
from texfcodec.io.load import load
from texfcodec.limits import Limits

LIMITS = Limits(voxels=1 << 16)
FORMS = [(method, filtered, interleave) for method in ("none", "deflate", "lzma") for filtered in ("none", "parent", "neighbor")
         for interleave in ("as_is", "all", "none")]
SHAPES = ((0,), (1,), (4,), (8, 3), (8, 1), (8,), (3, 8), (8, 4), (2, 2, 2), (8, 0))
TYPES = ("f4", "f8", "i8", "u1", "u2", "i1", "?", "c8", "U2", "M8[s]")


@lru_cache(maxsize=len(FORMS))
def _vxz(form):
    method, filtered, interleave = form
    return write_vxz(shell(5), 4, method, filtered, interleave)


def vxz(data: bytes) -> None:
    """A .vxz file with an odd header, odd blocks, or both."""
    choices = Choices(data)
    file = _vxz(choices.pick(FORMS))
    begin = struct.unpack(">I", file[4:8])[0]
    header, blocks = json.loads(file[8:begin]), file[begin:]
    for _ in range(choices.whole(0, 2)):
        header = bend_tree(header, choices)
    for _ in range(choices.whole(0, 3)):
        blocks = edited(blocks, choices)
    text = json.dumps(header).encode()
    whole = b"VXZ\0" + struct.pack(">I", 8 + len(text)) + text + blocks
    _check(edited(whole, choices) if choices.flag(4) else whole, choices)


def _array(choices):
    shape, kind = choices.pick(SHAPES), np.dtype(choices.pick(TYPES))
    count = int(np.prod(shape))
    values = np.frombuffer(choices.filled(min(count * kind.itemsize, 24)) * (count + 1), np.uint8)[: count * kind.itemsize]
    return values.view(kind).reshape(shape) if kind.kind != "U" else np.full(shape, "a")


def npz(data: bytes) -> None:
    """An archive with arrays of a surface and voxels, some of other shapes, types or names, or with edits of its bytes."""
    choices = Choices(data)
    grid = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    arrays = {"vertices": grid - 0.5, "faces": np.array([[0, 1, 3], [0, 3, 2], [4, 5, 7]]), "voxels": grid, "resolution": 2,
              "base_color": grid.astype(np.uint8) * 200, "metallic": grid[:, 0] * 0.5}
    for _ in range(choices.whole(0, 3)):
        name = choices.pick([*arrays, "origin", "voxel_size", "alpha", "dual_vertices", "intersected", "coord", "other"])
        kind = choices.whole(0, 3)
        if kind == 0:
            arrays.pop(name, None)
        else:
            arrays[name] = _array(choices) if kind < 3 else np.array(choices.real())
    file = io.BytesIO()
    if choices.flag():
        np.savez_compressed(file, **arrays)
    else:
        np.savez(file, **arrays)
    whole = file.getvalue()
    for _ in range(choices.whole(0, 2)):
        whole = edited(whole, choices)
    _check(_sealed(whole) if choices.flag() else whole, choices)


def _sealed(data):
    """The archive with checksums that fit its edited members, if it can be read at all."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {}
            for member in archive.infolist():
                with archive.open(member) as file:
                    file._expected_crc = None
                    members[member.filename] = file.read()
    except Exception:
        return data
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def _check(data, choices):
    name = io.BytesIO(data)
    name.name = "a.vxz" if data[:3] == b"VXZ" else "a.npz"
    scene = load(name, strict=choices.flag(4), limits=LIMITS)
    assert np.isfinite(scene.positions).all() and 0 <= scene.faces.min() and scene.faces.max() < len(scene.positions)
    assert all(np.isfinite(values).all() and values.shape[:2] == scene.faces.shape for values in scene.corner_map.values())
