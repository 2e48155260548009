"""The good conformance vectors of fields over texels (clauses 5.5, 5.6.2, 6.5 and 8.3).

But for the first, which the encoder writes, their streams are put together here from integers: lattice, faces and UVs.
"""

import zlib
from dataclasses import dataclass

import DracoPy
import numpy as np

from conformance.make.good import encoded, raht, torus, with_checksum, written
from texfcodec.bitstream.appearance import needed_groups
from texfcodec.bitstream.stream import Stream
from texfcodec.bitstream.syntax import SUPPORT_TEXELS, SUPPORT_VOXELS, VERSION
from texfcodec.bitstream.values import attribute_values, material_values
from texfcodec.codecs import codec_of
from texfcodec.codecs.base import Group
from texfcodec.field.keyed import keys_crc
from texfcodec.field.morton import decode_morton
from texfcodec.field.texel_set import referenced_texels
from texfcodec.field.texels import TexelSupport
from texfcodec.field.voxelise import voxelise
from texfcodec.field.voxels import VoxelSupport
from texfcodec.geometry.draco import counts_of
from texfcodec.scene.channels import ALPHA, BASE_COLOUR, group_values
from texfcodec.scene.scene import ALPHA_BLEND, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Scene, Texture

BITS = 10  # of a lattice coordinate
REPEATED, CLAMPED, MIRRORED = (WRAP_REPEAT,) * 2, (WRAP_CLAMP,) * 2, (WRAP_MIRROR,) * 2
SLICES = {"WHOLE_VOXELS": 1, "SLICE_VOXELS": 60, "SLICE_NODES": 20}


# Surfaces, and pictures on them


@dataclass
class Patch:
    """A geometry unit to be. lattice: int64 [V, 3]; faces: int64 [F, 3]; uv: int64 [F, 3, 2], None over voxels; bits: of the
    quantisation of the UVs, 0 where they are plain; range: of the UVs, None for what they reach; draco: bytes over voxels that
    decode to it, None for those of the encoder."""

    lattice: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None = None
    bits: int = 0
    range: int | None = None
    field: int = 0
    material: int = 0
    draco: bytes | None = None

    def textured(self):
        """Draco bytes with the UVs, and the elements that go with them."""
        origin = np.floor(self.uv.min(axis=(0, 1))).astype(np.int64)
        corners = np.column_stack([self.lattice[self.faces.reshape(-1)], (self.uv - origin).reshape(-1, 2)])
        unique, local = np.unique(corners, axis=0, return_inverse=True)
        more = {"uv_origin": origin.tolist(), "uv_bits": self.bits, "uv_range": self.range or int(unique[:, 3:].max())}
        return draco_of(unique[:, :3], local.reshape(-1, 3), unique[:, 3:], self.bits), more

    def values(self, textured):
        """Syntax values of the unit."""
        if textured:
            data, more = self.textured()
        else:
            mesh = self.lattice.astype(np.uint32), self.faces.astype(np.uint32)
            data, more = self.draco or DracoPy.encode(*mesh, compression_level=10), {}
        counts = counts_of(data)
        return with_checksum({"field_index": self.field, "material_index": self.material, "unit_vertices": counts[0],
                              "unit_faces": counts[1], **more, "draco_data": data})


def draco_of(lattice, faces, uv, bits):
    """Draco bytes with UVs [V, 2], quantised to so many bits, or plain where these are 0."""
    kind = {"tex_coord": uv.astype(np.float64), "tex_coord_quantization_bits": bits} if bits else \
        {"generic_attributes": {1: uv.astype(np.uint32)}}
    return DracoPy.encode(lattice.astype(np.uint32), faces.astype(np.uint32), compression_level=10, create_metadata=False, **kind)


@dataclass
class Image:
    """A field over texels to be. pixels: uint8 [H, W, C] of base colour and alpha; fraction: bits of a UV below the texel."""

    pixels: np.ndarray
    wrap: tuple = REPEATED
    fraction: int = 4
    constant: bool = False


@dataclass
class Grid:
    """A field over voxels to be, of one value."""

    resolution: int
    colour: tuple = (90, 120, 30)
    constant: bool = True


def picture(width, height, channels=3, seed=0, noise=0):
    """Smooth colours, with noise on top, uint8 [H, W, C]."""
    x, y = np.meshgrid(np.arange(width) / max(width, 2), np.arange(height) / max(height, 2))
    waves = [128 + 100 * np.sin(2 * np.pi * (x * (c + 1) + y * (2 - c)) + c + seed) for c in range(channels)]
    noisy = np.stack(waves, -1) + np.random.default_rng(seed).normal(0, noise, (height, width, channels))
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def ring(size, fraction=4, turns=(1, 1), shift=(0, 0), around=10, across=5):
    """A torus whose UVs go round an image of `size` so many times in either direction: Patch. Its seams are where they begin."""
    positions, faces, _ = torus(around, across)
    low = positions.min(axis=0)
    lattice = np.floor((positions - low) / np.ptp(positions, axis=0).max() * ((1 << BITS) - 1)).astype(np.int64)
    i, j = faces // across, faces % across
    unrolled = lambda n, count: np.where((n == 0) & (np.ptp(n, axis=1, keepdims=True) > 1), count, n) / count
    places = np.stack([unrolled(i, around) * turns[0] * size[0], unrolled(j, across) * turns[1] * size[1]], -1)
    return Patch(lattice, faces, np.floor((places + shift) * (1 << fraction) + 0.5).astype(np.int64))


def sheet(uv, **more):
    """Two faces, the corners of the first three UVs and of the last three: Patch."""
    lattice = np.array([[0, 0, 0], [1000, 0, 100], [1000, 900, 200], [0, 900, 300]])
    return Patch(lattice, np.array([[0, 1, 2], [0, 2, 3]]), np.asarray(uv).reshape(2, 3, 2), **more)


# Streams


def stream_of_parts(fields, patches, materials=1, alpha=False, qp=30, groups=None, shifts=None, constants=(), **tools):
    """Bytes of a stream of Images and Grids and the Patches on them; the checksums are right.

    materials: Materials, or how many plain ones; groups: what is coded, beside the usual base colour and alpha waves in every
    channel; shifts: level_shift by (field, group), constants: pairs of them that are constant; tools: as raht().
    """
    groups = groups or [Group((BASE_COLOUR,))] + [Group((ALPHA,))] * alpha
    if isinstance(materials, int):
        materials = [Material(f"m{n}", alpha_mode=ALPHA_BLEND * alpha) for n in range(materials)]
    written_materials = [material_values(material) for material in materials]
    units = [patch.values(isinstance(fields[patch.field], Image)) for patch in patches]
    stream = Stream({
        "version": VERSION, "position_bits": BITS, "origin": [-1.0, 0.0, 2.0], "side": 3.0,
        "num_materials": len(materials), "num_fields": len(fields), "num_geometry_units": len(units),
        "num_channel_groups": len(groups), "channel_groups": [group_values(*group) for group in groups]})
    stream.geometry, stream.materials, shown = units, written_materials, []
    for number, field in enumerate(fields):
        own = [patch for patch in patches if patch.field == number]
        shown.append((_texels if isinstance(field, Image) else _voxels)(field, own, stream, number))
    for number, group_numbers in enumerate(needed_groups(stream)):
        for group in group_numbers:
            shift, constant = (shifts or {}).get((number, group), 0), fields[number].constant or (number, group) in constants
            unit = _unit(groups[group], *shown[number], shift, qp, None if constant else tools)
            stream.attributes.append({**unit, "field_index": number, "group_index": group})
    return written(stream)


def _texels(field, patches, stream, number):
    """Adds a field over texels to the stream: its support and pixels."""
    height, width = field.pixels.shape[:2]
    uv = np.concatenate([_whole_uv(patch).reshape(-1, 2) for patch in patches])
    keys = referenced_texels(uv, np.arange(len(uv)).reshape(-1, 3), field.fraction, (width, height), field.wrap)
    stream.fields.append({"field_index": number, "support": SUPPORT_TEXELS, "width": width, "height": height,
                          "wrap_s": field.wrap[0], "wrap_t": field.wrap[1], "uv_fraction_bits": field.fraction,
                          "num_keys": len(keys), "keys_crc": keys_crc(keys)})
    xy = decode_morton(keys)
    support = TexelSupport(keys=keys, width=width, height=height, wrap=field.wrap, fraction_bits=field.fraction)
    return support, field.pixels[xy[:, 1], xy[:, 0]]


def _whole_uv(patch):
    """The UVs of a Patch as they decode, int64 [F, 3, 2]: quantised ones are rounded twice."""
    if not patch.bits:
        return patch.uv
    last, origin = (1 << patch.bits) - 1, np.floor(patch.uv.min(axis=(0, 1))).astype(np.int64)
    reach = patch.range or int((patch.uv - origin).max())
    n = np.floor((patch.uv - origin) * (last / reach) + 0.5).astype(np.int64)
    return (2 * n * reach + last) // (2 * last) + origin


def _voxels(field, patches, stream, number):
    """Adds a field over voxels to the stream: its support and colours."""
    starts = np.cumsum([0] + [len(patch.lattice) for patch in patches])
    faces = np.concatenate([patch.faces + start for patch, start in zip(patches, starts[:-1], strict=True)])
    keys, _ = voxelise(np.concatenate([patch.lattice for patch in patches]), faces, BITS, field.resolution, 0)
    stream.fields.append({"field_index": number, "support": SUPPORT_VOXELS, "resolution": field.resolution, "area_threshold": 0,
                          "num_keys": len(keys), "keys_crc": keys_crc(keys)})
    return VoxelSupport(field.resolution, keys), np.repeat(np.array([[*field.colour, 255]], np.uint8), len(keys), axis=0)


def waves(channel, support):
    """Values of a channel that is neither base colour nor alpha, uint8 [n, C]."""
    place = decode_morton(support.keys).astype(np.float64) / np.max(support.size)
    phases = [place @ np.array([c + 1, 2 - c, 1]) * 2 * np.pi + c + channel.semantic for c in range(channel.components)]
    return np.round(128 + 100 * np.sin(np.stack(phases, -1))).astype(np.uint8)


def plane_of(group, support, pixels):
    """Values of a group on a support, uint8 [n, components]. pixels: uint8 [n, 3 or 4] of base colour and alpha."""
    visible = {BASE_COLOUR: slice(0, 3), ALPHA: slice(3, 4)}
    return group.join({c.name: pixels[:, visible[c]] if c in visible else waves(c, support) for c in group.channels})


def _unit(group, support, pixels, shift, qp, tools):
    """Syntax values of an attribute unit but for field and group: RAHT, or constant where tools are None."""
    support = support.coarser(shift)
    plane = plane_of(group, support, pixels[: len(support.keys)])
    if tools is None:
        value = plane[0].tolist()
        return attribute_values(codec_of("constant"), 0, 0, zlib.crc32(bytes(value) * len(plane)), {"plane_value": value}, shift)
    usual = {"planar": int(support.planar), "plain": not group.channels[0].srgb}
    payload = raht(plane, support.keys, int(np.max(support.size)), np.broadcast_to(qp, plane.shape[1]).tolist(), **usual | tools)
    return attribute_values(codec_of("raht"), 0, 0, 0, payload, shift)


# The good ones


def wall():
    """A scene as the encoder gets it: a torus with a tiled image."""
    patch = ring((12, 10), 8, (3, 2))
    uv = patch.uv / np.array([12, 10]) / 256
    image = np.dstack([picture(12, 10), np.full((10, 12), 255, np.uint8)])
    return Scene(patch.lattice.astype(np.float64), patch.faces, np.zeros(len(patch.faces), np.int64), uv, None,
                 [Material("wall", texture=0)], [Texture(image)])


def subset():
    """What the encoder writes every day."""
    stream = encoded(wall(), support="texels", qp=30)
    image = lambda size, **more: Image(picture(*size, **more), REPEATED)
    return [
        ("texels", ["a field over texels", "UVs beside the image"], ("5.5", "5.6.2", "6.5.3"), stream, (0, 1)),
        ("texels_repeat",
         [("an image of {} x {}", 24, 16), ("wrap {}", "repeat"), "all levels of detail", "seams", "every texel asked"],
         ("5.5", "5.6.2", "6.5.4", "8.3"), stream_of_parts([image((24, 16))], [ring((24, 16))]), (*range(6), 9)),
        ("texels_lossless", [("an image of {} x {}", 21, 13), ("wrap {}", "repeat"), "lossless"], ("6.5.4", "7.9", "8.3"),
         stream_of_parts([image((21, 13), noise=30)], [ring((21, 13))], qp=24, models=8, max_error=0), (0, 1, 3)),
        ("texels_alpha", ["colour and alpha", ("an image of {} x {}", 18, 9), ("wrap {}", "repeat")], ("5.5", "5.7", "7.8.1"),
         stream_of_parts([image((18, 9), channels=4)], [ring((18, 9))], alpha=True), (0, 1)),
    ]


def several():
    """Streams of several fields and units."""
    first, second = ring((13, 9)), ring((8, 8), 2, (2, 1))
    second.lattice = second.lattice // 2
    parts = [ring((14, 11), shift=(3 * n, n)) for n in range(3)]
    for n, part in enumerate(parts):
        part.material, part.faces, part.uv = n, part.faces[n::3], part.uv[n::3]
    mixed = [Image(picture(13, 9), CLAMPED), Grid(6), Image(picture(8, 8, seed=2), MIRRORED, 2)]
    hole = Patch(first.lattice[:, ::-1] // 3, first.faces, None, field=1)
    second.field = 2
    return {"materials": stream_of_parts([Image(picture(14, 11))], parts, materials=3),
            "mixed": stream_of_parts(mixed, [second, hole, first]),
            "constant": stream_of_parts([Image(picture(13, 9), MIRRORED), Image(picture(8, 8), REPEATED, 2, constant=True)],
                                        [first, _of(second, 1)])}


def _of(patch, field):
    patch.field = field
    return patch


def borders():
    """UVs on centres and on borders of texels, where the open squares end."""
    texel = 16
    centres = [(c, r) for c in (8, 8 + 3 * texel, 8 + 7 * texel) for r in (8, 8 + 4 * texel)]
    edges = [(0, 0), (3 * texel, 0), (3 * texel, 5 * texel), (0, 0), (3 * texel, 5 * texel), (0, 5 * texel)]
    return (stream_of_parts([Image(picture(9, 7))], [sheet([centres[i] for i in (0, 4, 5, 0, 5, 1)])]),
            stream_of_parts([Image(picture(9, 7), MIRRORED)], [sheet(edges)]))


def flat():
    """Faces whose UVs are a line or a point."""
    line = [(5, 5), (133, 69), (69, 37)]
    return stream_of_parts([Image(picture(9, 7), CLAMPED)], [sheet([*line, (40, 88), (40, 88), (40, 88)])])


def rounded():
    """Quantised UVs much finer than the steps they stand for."""
    patch = ring((9, 6), 2)
    patch.uv = patch.uv + 0.37 * np.sin(patch.lattice[patch.faces][:, :, :2])
    patch.uv = np.clip(patch.uv, 0, 36)
    patch.uv[0, 0], patch.uv[0, 1] = 0, 36
    return stream_of_parts([Image(picture(9, 6), CLAMPED, 2)], [quantised(patch, 14, 36)])


def off_by(quarters):
    """A Patch of UVs in eight bits of a range of 200, scaled so that the largest is so many quarters from its whole number."""
    uv = np.array([(0, 0), (200, 8), (190, 100), (0, 0), (190, 100), (9, 112)])
    return quantised(sheet(uv * (1 + quarters / 4 / 255)), 8, 200)


def quantised(patch, bits, reach=None):
    patch.bits, patch.range = bits, reach
    return patch


def far(sign, most=(1 << 25) - 1):
    """UVs that begin, or end, where uv_origin does."""
    uv = np.array([(0, 0), (90, 7), (80, 60), (0, 0), (80, 60), (3, 66)]) + sign * most
    return stream_of_parts([Image(picture(7, 5), MIRRORED if sign > 0 else REPEATED)], [sheet(uv, bits=7)])


def longest():
    """A face that crosses 4096 texels, as far as UVs in 1/256 of a texel go."""
    last = (1 << 20) - 1
    uv = [(0, 0), (last, 700), (last, 900), (0, 0), (last, 900), (500, 800)]
    return stream_of_parts([Image(picture(5, 3), (WRAP_MIRROR, WRAP_CLAMP), 8)], [sheet(uv, bits=20)])


def uncommon():
    """What a decoder meets seldom, and what only another encoder would write."""
    parts, (centres, edges) = several(), borders()
    wide = [(0, 8), (16384 * 16 - 1, 8), (9000 * 16, 3), (0, 8), (9000 * 16, 3), (77, 2)]
    tall = [(5, -3000), (9, 7000), (-40, 9000), (5, -3000), (-40, 9000), (60, 300)]
    noisy, tools = Image(picture(27, 22, noise=20)), {"models": 8, "colour_range": 3, "filters": 2}
    return [
        ("texels_one", [("an image of {} x {}", 1, 1), ("wrap {}", "mirror"), "no level", "no codeword"], ("5.7.1", "6.5", "8.3"),
         stream_of_parts([Image(picture(1, 1), MIRRORED)], [ring((1, 1))]), (0, 1)),
        ("texels_wide", [("an image of {} x {}", 16384, 1), ("wrap {} x {}", "repeat", "clamp")], ("5.5", "6.5", "7.1", "8.3"),
         stream_of_parts([Image(picture(16384, 1, noise=9), (WRAP_REPEAT, WRAP_CLAMP))], [sheet(wide)], qp=44), (0, 1, 13, 14)),
        ("texels_tall", [("an image of {} x {}", 1, 300), ("wrap {} x {}", "clamp", "mirror"), "UVs beside the image"],
         ("5.5", "6.5.3", "8.3"), stream_of_parts([Image(picture(1, 300), (WRAP_CLAMP, WRAP_MIRROR))], [sheet(tall)]), (0, 2, 9)),
        ("texels_clamp", [("an image of {} x {}", 13, 7), ("wrap {}", "clamp"), "UVs beside the image"], ("6.5.3",),
         stream_of_parts([Image(picture(13, 7), CLAMPED)], [ring((13, 7), 4, (2, 1), (-8, 3))]), (0, 1)),
        ("texels_mirror", [("an image of {} x {}", 10, 22), ("wrap {}", "mirror"), "UVs beside the image"], ("6.5.3",),
         stream_of_parts([Image(picture(10, 22), MIRRORED)], [ring((10, 22), 4, (0.6, -0.4), (-17, 2.3))]), (0, 1)),
        ("texels_repeat_mirror", [("an image of {} x {}", 7, 6), ("wrap {} x {}", "repeat", "mirror"), "UVs beside the image"],
         ("6.5.3",),
         stream_of_parts([Image(picture(7, 6), (WRAP_REPEAT, WRAP_MIRROR))], [ring((7, 6), 4, (0.4, 0.5), (5.6, -7.2))]), (0,)),
        ("texels_parts", [("an image of {} x {}", 32, 32), ("wrap {}", "clamp"), "texels that no face asks"],
         ("6.5.2", "7.1", "8.3"), stream_of_parts([Image(picture(32, 32), CLAMPED)], [ring((32, 32), 4, (0.4, 0.2), (3, 9))]),
         (0, 2)),
        ("texels_whole", [("an image of {} x {}", 9, 8), ("wrap {}", "repeat"), "UVs in whole texels", "plain UVs"],
         ("5.6.2", "6.5.2"), stream_of_parts([Image(picture(9, 8), REPEATED, 0)], [ring((9, 8), 0, (2, 1))]), (0,)),
        ("texels_fine", [("an image of {} x {}", 5, 3), ("wrap {} x {}", "mirror", "clamp"), ("UVs in 1/{} of a texel", 256),
          ("UVs quantised to {} bits", 20)], ("5.6.2", "6.5.2"), longest(), (0,)),
        ("texels_quantised", [("an image of {} x {}", 24, 16), ("wrap {}", "repeat"), ("UVs quantised to {} bits", 9)],
         ("5.6.2",), stream_of_parts([Image(picture(24, 16))], [quantised(ring((24, 16)), 9)]), (0,)),
        ("texels_rounded", [("UVs quantised to {} bits", 14), "many of which stand for one number"], ("5.6.2",), rounded(), (0,)),
        ("texels_near", [("UVs quantised to {} bits", 8), "one by nearly a quarter off"], ("5.6.2",),
         stream_of_parts([Image(picture(14, 8), CLAMPED)], [off_by(0.99)]), (0,)),
        ("texels_low", [("uv_origin {}", -33554431)], ("5.6.2", "6.5.3"), far(-1), (0,)),
        ("texels_high", [("uv_origin {}", 33554431)], ("5.6.2", "6.5.3"), far(1), (0,)),
        ("texels_centres", [("all UVs on {} of texels", "centres")], ("6.5.2",), centres, (0,)),
        ("texels_borders", [("all UVs on {} of texels", "borders")], ("6.5.2",), edges, (0,)),
        ("texels_flat", [("a face whose UVs are a {}", "line"), ("a face whose UVs are a {}", "point")], ("6.5.1", "6.5.2"),
         flat(), (0,)),
        ("texels_materials", ["three materials in one field over texels"], ("5.6", "6.5.4"), parts["materials"], (0, 1)),
        ("texels_mixed", ["two fields over texels", "one over voxels", "geometry units out of field order"],
         ("5.5", "5.6.1", "5.6.2", "8.3"), parts["mixed"], (0, 1, 3)),
        ("texels_constant", ["two fields over texels", "the second constant"], ("5.7.6", "6.5.4", "8.3"), parts["constant"],
         (0, 2)),
        ("texels_tools", [("an image of {} x {}", 27, 22), ("wrap {}", "repeat"), ("{} models", 8), "colour range", "a filter"],
         ("7.3", "7.5.5", "7.7"), stream_of_parts([noisy], [ring((27, 22))], qp=36, **tools), (0, 1)),
        ("texels_slices", [("an image of {} x {}", 27, 22), ("wrap {}", "repeat"), "lossless", "slices"], ("5.7.1", "7.2", "7.9"),
         stream_of_parts([noisy], [ring((27, 22))], qp=30, models=6, max_error=0, slices=SLICES), (0, 1)),
        ("texels_near_lossless",
         [("an image of {} x {}", 27, 22), ("wrap {}", "repeat"), ("noise with errors of at most {} from a coarse field", 3)],
         ("7.9",), stream_of_parts([noisy], [ring((27, 22))], qp=36, models=8, max_error=3), (0, 1)),
    ]
