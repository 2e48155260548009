"""Fields of a Texf for the GPU: voxels by bricks of 8 x 8 x 8, texels as images, what else answers as it is kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..codecs.base import split_groups
from ..render.levels import Pyramid
from ..scene.channels import BY_NAME
from .container import Blobs

if TYPE_CHECKING:
    from ..texf import Texf

WORDS = 16  # of 32 voxels, a brick


def pack_fields(texf: Texf, blobs: Blobs) -> dict[str, Any]:
    """The header's "fields", and "payload" where a shader can ask what the stream's evaluators are made of."""
    resident = texf.codec.resident(texf.evaluators) if texf.evaluators and texf.codec else None
    facts, arrays, keys = resident or (None, {}, [None] * len(texf.fields))
    fields = [_texels(part, blobs) if part.over_texels else _voxels(texf, number, keys[number], blobs)
              for number, part in enumerate(texf.fields)]
    payload = None if facts is None else facts | _payload(texf, facts["position_bits"], arrays, blobs)
    return {"channels": [channel.name for channel in texf.channels], "fields": fields, "payload": payload}


def _by_shift(part):
    """[(shift, names of the planes that have it)], the finest first."""
    names = list(part.planes)
    shifts = sorted({part.shifts.get(name, 0) for name in names})
    return [(shift, [name for name in names if part.shifts.get(name, 0) == shift]) for shift in shifts]


def _channels(names):
    return [[name, BY_NAME[name].components] for name in names]


def _voxels(texf, number, latents, blobs):
    """A field over voxels. latents: keys by table of what answers in the place of the finest level, which then is not there; None
    where nothing does."""
    part = texf.fields[number]
    first = 1 if latents is not None and part.support.depth else 0
    planes = []
    for shift, names in _by_shift(part):
        level = Pyramid(part, tuple(names)).level(first if shift == 0 else 0)
        planes.append({"channels": _channels(names), "level": shift + level.level,
                       "values": blobs.add(np.rint(level.values).astype(np.uint8), differences=True),
                       "counts": blobs.add(level.counts.astype(np.uint8)) if level.level else None})
    told = {"kind": "voxels", "size": part.support.size, "depth": part.support.depth, "full_size": part.support.resolution,
            "count": len(part.support), "first": first, "planes": planes,
            "grid_scale": _grid_scale(texf.cube, part.support.resolution) / (1 << part.level_shift),
            **_bricks(part.support.coarser(first).keys, blobs)}
    if latents is not None:
        told |= {"kind": "latents", "latents": [None if keys is None else _bricks(keys, blobs) for keys in latents]}
    return told


def _grid_scale(cube, resolution):
    """What a lattice coordinate is multiplied with to be one of a grid (6.2)."""
    return resolution / (1 << cube.position_bits)


def _bricks(keys, blobs):
    """Ascending Morton keys as bricks: key >> 9 of each, and 512 bits of which of its voxels are there."""
    bricks, which = np.unique(keys >> 9, return_inverse=True)
    words = np.zeros((len(bricks), WORDS), np.uint32)
    np.bitwise_or.at(words, (which, (keys >> 5) & 15), np.uint32(1) << (keys & 31).astype(np.uint32))
    return {"bricks": blobs.add(bricks.astype(np.uint32), differences=True), "words": blobs.add(words)}


def _texels(part, blobs):
    """A field over texels: its images, and which of their texels the surface asks."""
    planes = []
    for shift, names in _by_shift(part):
        support = part.support_of(names[0])
        image = support.image(np.hstack([part.planes[name] for name in names]))
        planes.append({"channels": _channels(names), "level": shift, "values": blobs.add(image), "mask": _mask(support, blobs)})
    support = part.support
    return {"kind": "texels", "size": list(support.size), "full_size": [support.width, support.height], "count": len(support),
            "wrap": list(support.wrap), "shift": support.level_shift, "planes": planes}


def _mask(support, blobs):
    """Bits, row after row from the low ones on; None where every texel is asked."""
    if len(support) == support.size[0] * support.size[1]:
        return None
    return blobs.add(np.packbits(support.rank >= 0, bitorder="little"))


def _payload(texf, position_bits, arrays, blobs):
    """Arrays of what a shader asks, how it counts places, and which of its outputs belong to which channel."""
    at = np.arange(sum(group.components for group in texf.groups))[None]
    outputs = {name: columns[0].tolist() for name, columns in split_groups(at, texf.groups).items()}
    return {"grid_scale": _grid_scale(texf.cube, 1 << position_bits), "outputs": outputs,
            **{name: blobs.add(array) for name, array in arrays.items()}}


def resident_bytes(header: dict[str, Any]) -> int:
    """Bytes of the arrays that the page's GPU memory is made of, as they come in the container; levels and tables not counted."""
    sizes = {"u8": 1, "u16": 2, "i16": 2, "u32": 4, "f32": 4}
    found, todo = 0, [header]
    while todo:
        one = todo.pop()
        if isinstance(one, dict) and "at" in one:
            found += sizes[one["type"]] * int(np.prod(one["shape"], dtype=np.int64))
        elif isinstance(one, dict | list):
            todo += one.values() if isinstance(one, dict) else one
    return found
