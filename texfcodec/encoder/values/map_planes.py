"""The maps of materials as values of fields: channel groups that are coded together, and the values of the maps."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ...codecs.base import Group
from ...core.colour_error import decibels
from ...field.morton import encode_morton
from ...field.samples import surface_samples
from ...field.transfer import LEAST_WEIGHT, fill_uncoloured, transfer
from ...field.voxelise import SAMPLES_PER_EDGE
from ...scene.channels import ALPHA, BASE_COLOUR, BY_NAME, CHANNELS, FULL, channel_over
from ...scene.fetch import map_columns, pack_map

if TYPE_CHECKING:
    from ...codecs.base import Source
    from ...scene.scene import Material
    from .source_field import SourceField

TOGETHER = ("roughness", "metallic")  # one group where both are coded: 0 to 6 % fewer bytes than apart (helmet, bottle), with
# occlusion as a third 2 to 6 % more


def map_names(materials: Iterable[Material]) -> set[str]:
    """Return the names of the channels that any of the materials has a map of."""
    return {name for material in materials for name in material.maps}


def groups_of(present: set[str], alpha: bool) -> tuple[Group, ...]:
    """Return the channel groups of a stream, in order. present: names of all channels, in channels.CHANNELS, that any field has
    beside base colour and alpha; alpha: whether alpha is coded."""
    groups = [Group((BASE_COLOUR,))] + [Group((ALPHA,))] * alpha
    joint = [BY_NAME[name] for name in TOGETHER if name in present]
    for channel in CHANNELS[2:]:
        if channel.name not in present:
            continue
        if channel.name in TOGETHER:
            groups += [Group(tuple(joint))] if channel is joint[0] else []
        else:
            groups.append(Group((channel,)))
    return tuple(groups)


def with_grey(groups: tuple[Group, ...], fields: list[SourceField]) -> tuple[Group, ...]:
    """Return the groups, with a colour's group marked grey if its components are alike in all fields."""
    return tuple(group._replace(grey=_is_grey(group, fields)) for group in groups)


def _is_grey(group, fields):
    if len(group.channels) > 1 or not group.channels[0].srgb:
        return False
    planes = [field.planes[group.channels[0].name] for field in fields if group.channels[0].name in field.planes]
    return bool(planes) and all(_alike(plane[:: max(1, len(plane) // 64)]) and _alike(plane) for plane in planes)


def _alike(plane):
    return bool((np.ptp(plane, axis=1) <= 0.5).all())


def joined(part: SourceField, group: Group) -> tuple[np.ndarray, int]:
    """Return (values of a group's channels side by side, float32 [n, components]; levels by which they are coarser than the
    field). The field has at least one of the channels. Those that it lacks are 255; coarser ones are brought to the finest."""
    shift = min(part.shifts.get(channel.name, 0) for channel in group.channels if channel.name in part.planes)
    support = part.support.coarser(shift)
    planes = {}
    for channel in group.channels:
        plane, levels = part.planes.get(channel.name), part.shifts.get(channel.name, 0) - shift
        if plane is None:
            plane = np.full((len(support), channel.components), FULL, np.float32)
        elif levels:
            plane = plane[np.searchsorted(support.coarser(levels).keys, support.keys >> 3 * min(levels, support.depth))]
        planes[channel.name] = plane
    return group.join(planes), shift


def errors_of(group: Group, plane: np.ndarray, decoded: np.ndarray) -> dict:
    """Return the entry of the report on a coded group: {"channels": names, "psnr": dB by name, None if it is exact}. plane:
    float32 [n, components]; decoded: uint8 of that shape."""
    psnr, begin = {}, 0
    for channel in group.channels:
        columns = slice(begin, begin + (1 if group.grey else channel.components))
        error = float(((decoded[:, columns] - plane[:, columns]) ** 2).mean())
        psnr[channel.name], begin = round(decibels(error), 2) if error else None, columns.stop
    return {"channels": list(psnr), "psnr": psnr}


def with_maps(part: SourceField, source: Source, number: int, names: set[str], threads: int) -> SourceField:
    """Return a SourceField over voxels with the values of the maps of its faces. number: of the field in source; names: channels
    of the maps, as materials know them."""
    planes: dict[str, np.ndarray] = {}
    done: set[str] = set()
    for name in sorted(names):
        channel = channel_over(name, planar=False)
        in_field = (source.face_field == number) & source.mapped(channel)
        if channel.name != name:
            planes[channel.name] = _deviations(part, source, in_field, channel.name, threads)
        elif name not in done:
            together = _same_pass(source, name, names - done, in_field, number)
            planes |= _transferred(part, source, in_field, together, threads)
            done |= set(together)
    return part.with_planes(planes)


def _same_pass(source, name, names, in_field, number):
    """Return the channels, this one first, whose values at face corners one pass can transfer: all linear, of the same faces, in
    columns of their own."""
    out, used = [name], set(map_columns(name))
    if name not in source.scene.corner_map or BY_NAME[name].srgb:
        return out
    for other in sorted(names - {name}):
        if other not in source.scene.corner_map or BY_NAME[other].srgb or used & set(map_columns(other)):
            continue
        faces = (source.face_field == number) & source.mapped(BY_NAME[other])
        corner_alone = all(m.maps.get(n, -1) < 0 for m in source.scene.materials for n in (name, other))
        if corner_alone and np.array_equal(faces, in_field):
            out, used = [*out, other], used | set(map_columns(other))
    return out


def _transferred(part, source, in_field, names, threads):
    """Return the means of maps over the surface in each voxel, float32 [N, C] by channel; voxels that only faces without the maps
    touch continue their neighbours. in_field: bool [F], faces of the field with the maps; names: of _same_pass()."""
    surface = source.surface
    packed = pack_map(source.scene, names[0], surface.origin_face[in_field])
    for name in names[1:]:
        other = pack_map(source.scene, name, surface.origin_face[in_field]).corner_colour
        packed.corner_colour[..., map_columns(name)] = other[..., map_columns(name)]
    density = int(np.clip(np.ceil(2 * part.texels_per_edge), SAMPLES_PER_EDGE, 4))
    colour, _ = transfer(surface.lattice, surface.faces[in_field], packed, surface.cube.position_bits, part.support.resolution,
                         part.keys, part.support.brick_map, density, threads)
    return {name: np.ascontiguousarray(colour[:, map_columns(name)]) for name in names}


def _deviations(part, source, in_field, name, threads):
    """Return the same for a channel that no image holds directly, with the values of source.maps."""
    surface, rows, resolution = source.surface, np.flatnonzero(in_field), part.support.resolution
    sums = np.zeros((len(part.keys), 4))
    for points, face, bary, share in surface_samples(surface.lattice, surface.faces[rows], surface.cube.position_bits,
                                                     resolution, SAMPLES_PER_EDGE):
        cell = np.clip(np.floor(points).astype(np.int64), 0, resolution - 1)
        key = encode_morton(cell)
        rank = np.minimum(np.searchsorted(part.keys, key), len(part.keys) - 1)
        there = part.keys[rank] == key
        values = source.maps(name, rows[face[there]], bary[there], threads)
        weight = share[there] + LEAST_WEIGHT
        for c in range(3):
            sums[:, c] += np.bincount(rank[there], weight * values[:, c], len(sums))
        sums[:, 3] += np.bincount(rank[there], weight, len(sums))
    colour = (sums[:, :3] / np.maximum(sums[:, 3:], 1e-30)).astype(np.float32)
    fill_uncoloured(part.keys, colour, sums[:, 3])
    return colour
