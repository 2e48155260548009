"""Fields of a Texf for the GPU: voxels by bricks of 8 x 8 x 8, texels as images, 3DNTC as it stands in the stream."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..channels import BY_NAME
from ..codecs.codec import split_groups
from ..codecs.neural.infer import HASH_FIELD, POSITION_BITS
from ..codecs.neural.payload import enc_codes
from ..render.levels import Pyramid
from .container import Blobs

WORDS = 16  # of 32 voxels, a brick


def pack_fields(texf: Any, blobs: Blobs) -> dict[str, Any]:
    """The header's "fields", and "payload" where points ask a network."""
    header: dict[str, Any] = {"channels": [channel.name for channel in texf.channels], "payload": None}
    header["fields"] = [_texels(part, blobs) if part.over_texels else _voxels(texf, number, blobs)
                        for number, part in enumerate(texf.fields)]
    if texf.evaluators and texf.evaluators[0].payload is not None:
        header["payload"] = _payload(texf, blobs)
    return header


def _by_shift(part):
    """[(shift, names of the planes that have it)], the finest first."""
    names = list(part.planes)
    shifts = sorted({part.shifts.get(name, 0) for name in names})
    return [(shift, [name for name in names if part.shifts.get(name, 0) == shift]) for shift in shifts]


def _channels(names):
    return [[name, BY_NAME[name].components] for name in names]


def _voxels(texf, number, blobs):
    """A field over voxels. With a network the finest level is not there: it answers in its place."""
    part, cube = texf.fields[number], texf.cube
    first = 1 if texf.evaluators and part.support.depth else 0
    scale = cube.last * (part.support.resolution / (1 << cube.position_bits)) / cube.last / (1 << part.level_shift)
    planes = []
    for shift, names in _by_shift(part):
        pyramid = Pyramid(part, tuple(names))
        level = pyramid.level(first if shift == 0 else 0)
        counts = level.counts if level.level else None
        planes.append({"channels": _channels(names), "level": shift + level.level,
                       "values": blobs.add(np.rint(level.values).astype(np.uint8), differences=True),
                       "counts": None if counts is None else blobs.add(counts.astype(np.uint8))})
    told = {"kind": "neural" if texf.evaluators else "voxels", "size": part.support.size, "depth": part.support.depth,
            "full_size": part.support.resolution, "count": len(part.support), "first": first, "grid_scale": scale,
            "planes": planes, **_bricks(part.support.coarser(first).keys, blobs)}
    if texf.evaluators:
        told["latents"] = [None if keys is None else _bricks(keys, blobs) for keys in texf.evaluators[number].keys]
    return told


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


def _payload(texf, blobs):
    """The 3DNTC payload as a GPU keeps it: latents of 4 bits, parameters of 16."""
    payload = texf.evaluators[0].payload
    at = np.arange(payload.components)[None]
    return {
        "features": payload.features, "octaves": payload.octaves, "first_wave": payload.first_wave,
        "widths": list(payload.widths), "position_bits": POSITION_BITS,
        "grid_scale": texf.cube.last * ((1 << POSITION_BITS) / (1 << texf.cube.position_bits)) / texf.cube.last,
        "levels": [{"resolution": one.resolution, "log2": one.table_log2,
                    "first_rows": [payload.first_row(number, n) for number in range(len(texf.fields))]}
                   for n, one in enumerate(payload.levels)],
        "salts": [number * HASH_FIELD & 0xFFFFFFFF for number in range(len(texf.fields))],
        "outputs": {name: columns[0].tolist() for name, columns in split_groups(at, texf.groups).items()},
        "codes": blobs.add(np.frombuffer(enc_codes(payload.codes), np.uint8)),
        "network": blobs.add(np.asarray(payload.halves, np.uint16)), "rows": payload.rows,
    }


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
