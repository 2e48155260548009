"""What a 3DNTC payload is fitted to: points on the source's surface with their colours, and the latents around them."""

from dataclasses import dataclass

import numpy as np

from ..asset.sample import pack_source, sample_source
from ..field.morton import _morton_key
from ..kernel import kernel
from ..quality.psnr import sample_surface
from .infer import LOCAL_BITS, POSITION_BITS, _local, _rows_around, cube_positions

CHUNK = 1 << 20  # points sampled at a time


@dataclass
class Samples:
    """position: int32 [M, 3] as infer takes them; target: uint8 [M, C]; share: uint8 [M, C], weights of the errors; field: int16
    [M]."""

    position: np.ndarray
    target: np.ndarray
    share: np.ndarray
    field: np.ndarray

    def __len__(self):
        return len(self.position)

    def taken(self, rows):
        """The samples of some rows, int64 [m] or slice."""
        return Samples(self.position[rows], self.target[rows], self.share[rows], self.field[rows])


def draw_samples(scene, surface, face_field, count, components, seed, threads):
    """Samples spread evenly by area over the surface that is coded. components: 3, or 4 with alpha."""
    lattice = surface.lattice.astype(np.float64)
    face, bary = sample_surface(lattice, surface.faces, count, seed)
    source = pack_source(scene, surface.origin_face)
    target, share = np.empty((2, count, components), np.uint8)
    out = Samples(np.empty((count, 3), np.int32), target, share, face_field[face].astype(np.int16))
    scale = 2.0 ** (POSITION_BITS - surface.cube.position_bits)
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        points = np.einsum("mk,mkc->mc", bary[part], lattice[surface.faces[face[part]]])
        out.position[part] = cube_positions(points * scale)
        rgba = np.rint(sample_source(source, face[part], bary[part], threads)).astype(np.uint8)
        out.target[part] = rgba[:, :components]
        out.share[part] = 255
        if components == 4:  # what cannot be seen need not be right
            out.share[part, :3] = np.maximum(rgba[:, 3:], 1)
    return out


@kernel
def _keys(position, resolution, keys):
    """Morton keys of the cells of latents that points lie in; cell (x, y, z) has the latents x..x+1, y..y+1, z..z+1."""
    for i in range(position.shape[0]):
        x, y, z = (_local(np.int64(position[i, 0]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 1]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 2]), resolution) >> LOCAL_BITS)
        keys[i] = _morton_key(x + 1, y + 1, z + 1)


@kernel
def _corner_rows(position, resolution, log2, first, salt, slots, bricks, words, ranks, corner):
    """Rows of the eight latents of the cells that points lie in, int32 [M, 8], -1 where none is."""
    row = np.empty(8, np.int64)
    for i in range(position.shape[0]):
        x, y, z = (_local(np.int64(position[i, 0]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 1]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 2]), resolution) >> LOCAL_BITS)
        _rows_around(x, y, z, resolution, log2, salt, slots, bricks, words, ranks, row)
        for q in range(8):
            corner[i, q] = row[q] + first if row[q] >= 0 else -1


def order_along_curve(position):
    """Order of points along a Morton curve of 2048 cells a side: neighbours in it read the same latents."""
    keys = np.empty(len(position), np.int64)
    _keys(position, 2048, keys)
    return np.argsort(keys, kind="stable")


def cells_of(samples, tables):
    """The latents around each sample: (cell int32 [M, L], corners int32 [cells, 8]); row cell[i, n] of corners names the eight
    latents of level n around sample i, -1 where none is. tables: payload.Tables by field."""
    levels = len(tables[0].index[0])
    cell, corners, made = np.empty((len(samples), levels), np.int32), [], 0
    for number, table in enumerate(tables):
        mine = np.flatnonzero(samples.field == number)
        of_level, places, slots, bricks, words, ranks = table.index
        for n in range(levels):
            keys = np.empty(len(mine), np.int64)
            _keys(samples.position[mine], of_level[n, 0], keys)
            _, one, inverse = np.unique(keys, return_index=True, return_inverse=True)
            rows = np.empty((len(one), 8), np.int32)
            s, t, b, e = places[n, 0], places[n + 1, 0], places[n, 1], places[n + 1, 1]
            _corner_rows(samples.position[mine[one]], *of_level[n], slots[s:t], bricks[b:e], words[b:e], ranks[b:e], rows)
            cell[mine, n] = made + inverse.reshape(-1)
            corners.append(rows)
            made += len(rows)
    return cell, np.concatenate(corners) if corners else np.empty((0, 8), np.int32)
