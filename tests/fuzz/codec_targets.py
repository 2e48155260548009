"""Targets of the codecs: units drawn from their syntax tables with an element or two bent, and the stages inside."""

from functools import lru_cache

import numpy as np

from conformance.reference import bits
from conformance.reference.attributes import decode_values
from conformance.reference.syntax import read_raht
from fuzz.choices import Choices
from fuzz.seeds import SLOW, SMALL
from fuzz.syntax import bend, draw
from texfcodec.codecs.base import Group
from texfcodec.codecs.coded_normals import dec_residuals, enc_residuals
from texfcodec.codecs.constant import CONSTANT, Constant
from texfcodec.codecs.neural.neural_codec import Neural
from texfcodec.codecs.neural.neural_syntax import NEURAL
from texfcodec.codecs.neural.payload import enc_codes
from texfcodec.codecs.neural.transport import dec_transport, enc_transport
from texfcodec.codecs.raht.raht_codec import Raht
from texfcodec.codecs.raht.raht_syntax import RAHT
from texfcodec.codecs.sharp_edges import dec_marks, enc_marks
from texfcodec.core.syntax_walk import Reader, read_structure, write_structure
from texfcodec.errors import StreamError
from texfcodec.field.extents import octree_depth
from texfcodec.field.morton import encode_morton
from texfcodec.field.texels import TexelSupport
from texfcodec.field.voxelise import voxelise
from texfcodec.field.voxels import VoxelSupport
from texfcodec.geometry.canonical import CanonicalCube
from texfcodec.geometry.corner_groups import ONE, groups_of
from texfcodec.geometry.edges import NUM_FOLDS, coded_edges, shared_edges, weld
from texfcodec.options import DecodeOptions
from texfcodec.report import Report
from texfcodec.scene.channels import channels_of

MOST_CELLS = 12 if SLOW else 40
GROUPS = (Group(tuple(channels_of([{"num_semantics": 1, "group_semantics": [0], "group_components": 3}])[0])),)


def _support(choices):
    """A few voxels, or texels, side by side or anywhere in a small grid; of texels, squares of 8 x 8 too."""
    planar, size, count = choices.flag(3), choices.pick((1, 2, 3, 4, 8, 9, 33)), choices.whole(1, MOST_CELLS)
    xyz = np.frombuffer(choices.filled(3 * count), np.uint8).reshape(count, 3) % min(size, 8 if choices.flag() else size)
    xyz = xyz * (1, 1, 0) if planar else xyz
    keys = np.unique(encode_morton(xyz))
    if planar and size >= 8 and choices.flag():
        first = choices.whole(0, 3 if size > 16 else 0) << 6  # of the Morton order of texels
        square = [sum((i >> bit & 1) << 3 * (bit // 2) + bit % 2 for bit in range(8)) for i in range(first, first + 64)]
        keys = np.union1d(keys, square)
    return TexelSupport(keys=keys, width=size, height=size, wrap=(0, 0), fraction_bits=0) if planar else VoxelSupport(size, keys)


def _raht_given(choices, components, depth, cells):
    """What the ranges of RAHT's table do not say (5.7.1 to 5.7.3)."""
    fill = choices.pick((b"\0", b"\xff", b"\x55"))
    return {
        "colour_transform": int(components == 3 and choices.flag()),
        "filter_mask": lambda *_: choices.whole(0, (1 << 5 * components) - 1) & choices.whole(0, (1 << 5 * components) - 1),
        "filter_coefficients": lambda v, _: [(byte ^ 128) - 128 for byte in choices.filled(v["NumTaps"])],
        "kernel": lambda *_: [1 + choices.whole(0, 254), *choices.filled(6)],
        "root_mean": lambda *_: [(choices.whole(0, 255) - 20) << choices.pick((0, 8, 12)) for _ in range(components)],
        "residual": lambda *_: choices.near(0, 128) if depth and choices.flag() else 0,
        "slice_level": lambda *_: choices.whole(0, max(depth - 1, 0)),
        "num_slices": lambda *_: choices.whole(1, min(4, max(cells, 1))), "slice_step": lambda v, _: [1] * v["NumSteps"],
        "codeword_length": lambda *_: choices.whole(0, 60), "level_bytes": lambda v, _: list(choices.filled(v["NumLevels"])),
        "codeword_data": lambda v, _: b"".join(choices.take(one["codeword_length"]).ljust(one["codeword_length"], fill)
                                               for one in v["codewords"]),
    }


def drawn_raht(choices: Choices) -> tuple[bytes, dict, VoxelSupport | TexelSupport, int]:
    """(raht_parameters, legal or with up to two elements bent; the variables that they take from elsewhere; their support; levels
    to leave out)."""
    support, components = _support(choices), choices.pick((1, 3))
    known = {"resolution": max(support.size) if support.planar else support.size, "Planar": int(support.planar),
             "NumComponents": components, "offset": 0}
    given = _raht_given(choices, components, octree_depth(known["resolution"]), len(support))
    payload = write_structure(RAHT, draw(RAHT, choices, dict(known), given))
    if choices.flag():
        rows: list = []
        read_structure(RAHT, Reader(payload, 0, len(payload)), dict(known), rows)
        payload = bend(payload, rows, choices)
    return payload, known, support, choices.whole(0, 2) if choices.flag(4) else 0


def _decoded(payload, known, support, levels, threads=1):
    values, codec = dict(known), Raht()
    codec.read_parameters(Reader(payload, 0, len(payload)), values)
    codec.check(values)
    return values, codec.dec(values, support, levels, threads)


def raht(data: bytes) -> None:
    """Attributes: any parameters, any codewords; one thread and two say the same."""
    choices = Choices(data)
    payload, known, support, levels = drawn_raht(choices)
    values, plane = _decoded(payload, known, support, levels)
    assert plane.dtype == np.uint8 and plane.shape == (len(support.coarser(levels)), values["NumComponents"])
    if values["slice_level"] and choices.flag(4):
        assert (_decoded(payload, known, support, levels, 2)[1] == plane).all()
    group = Raht().describe(values) | {"field_index": 0, "group_index": 0, "semantic": "colour", "bytes": len(payload)}
    assert all(Raht().info_lines(group))


def raht_twice(data: bytes) -> None:
    """As raht, and the decoder in plain Python, written from the specification alone, refuses and decodes the same."""
    payload, known, support, levels = drawn_raht(Choices(data))
    refused = None
    try:
        found = _decoded(payload, known, support, levels)[1].tobytes()
    except StreamError as error:
        found, refused = None, error
    unit = {"group_index": 0, "field_index": 0, "depth": octree_depth(known["resolution"])}
    header = {"channel_groups": [{"components": known["NumComponents"]}]}
    try:
        read_raht(bits.Reader(payload), unit, header, [{"support": known["Planar"]}])
        expected = decode_values(unit, support.keys.tolist(), levels)
    except bits.Invalid as error:
        assert found is None, f"only the naive decoder refuses: {error}"
        raise refused from None
    assert refused is None, f"the naive decoder does not refuse: {refused}"
    assert found == expected, "two decoders decode to different values"


def constant(data: bytes) -> None:
    """A value for all, on a support that keeps what is derived of it."""
    choices = Choices(data)
    support, components = _support(choices), choices.pick((1, 3))
    assert support.kept("levels", list) is support.kept("levels", list)
    payload = write_structure(CONSTANT, draw(CONSTANT, choices, {"NumComponents": components}, {}))
    payload = payload[: choices.whole(0, components)] if choices.flag(4) else payload
    values = {"NumComponents": components}
    reader = Reader(payload, 0, len(payload))
    Constant().read_parameters(reader, values)
    Constant().check(values)
    levels = choices.whole(0, 2)
    plane = Constant().dec(values, support, levels, 1)
    assert plane.shape == (len(support.coarser(levels)), components) and (plane == values["plane_value"]).all()
    Constant().describe(values)


@lru_cache(maxsize=64)
def _surface(number):
    """(lattice, faces) of a few faces in a cube of 8 bits."""
    rng = np.random.default_rng(number)
    return rng.integers(0, 256, (6, 3)).astype(np.int64), np.array([[0, 1, 2], [2, 3, 4], [3, 4, 5]])


@lru_cache(maxsize=256)
def _voxels(surface, resolution, threshold):
    return voxelise(*_surface(surface), 8, resolution, threshold)[0]


def _neural_given(choices, surfaces):
    """What the ranges of 3DNTC's tables do not say (5.7.4, 5.7.5): as many latents as there are voxels, small networks."""
    counts = lambda v, _: [max(len(_voxels(one, v["level_resolution"], v["latent_threshold"])), 1) for one in surfaces]
    rows = lambda v: sum(level["NumRows"] for level in v["latent_levels"])
    halves = lambda v, _: (np.frombuffer(choices.filled(v["ParameterBytes"]), "<u2") & 0xEBFF).tobytes()
    return {
        "num_features": lambda *_: 2 * choices.whole(1, 5),
        "hidden_width": lambda v, _: [choices.near(1, 16) for _ in range(v["num_hidden"])],
        "num_levels": lambda *_: choices.whole(1, 3), "level_resolution": lambda *_: choices.pick((1, 2, 3, 5, 8)),
        "table_log2": lambda *_: choices.pick((0, 0, 1, 4)), "latent_threshold": lambda *_: choices.pick((0, 0, 0, 9)),
        "num_latents": lambda v, c: counts(v, c) if v["NumCounts"] else [],
        "wave_octaves": lambda *_: choices.near(0, 8), "network_data": halves,
        "latent_data": lambda v, _: choices.take(40) if v["form"] else choices.filled(rows(v) * v["num_features"] // 2),
    }


def neural(data: bytes) -> None:
    """A 3DNTC payload: network, latents in either form, evaluation at voxels and at points (5.7.4, 11)."""
    choices, codec = Choices(data), Neural()
    numbers = [choices.whole(0, 3) for _ in range(choices.whole(1, 2))]
    known = {"num_fields": len(numbers), "NumOutputs": 3, "offset": 0}
    payload = write_structure(NEURAL, draw(NEURAL, choices, dict(known), _neural_given(choices, numbers)))
    if choices.flag():
        rows: list = []
        read_structure(NEURAL, Reader(payload, 0, len(payload)), dict(known), rows)
        payload = bend(payload, rows, choices)
    values, surfaces = dict(known), [_surface(number) for number in numbers]
    codec.read_parameters(Reader(payload, 0, len(payload)), values)
    codec.check(values)
    codec.describe(values)
    if codec.count_samples(values, surfaces, 8) > SMALL.samples:
        return
    tables = codec.dec(values, surfaces, 8, GROUPS, DecodeOptions(limits=SMALL, threads=1), Report())
    points = np.frombuffer(choices.filled(24), "<f8").reshape(1, 3)
    for number, table in zip(numbers, tables, strict=True):
        support = VoxelSupport(4, _voxels(number, 4, 0)[: 4 if SLOW else 50])
        assert table.values(support).shape == (len(support), 3)
        answered = table.query(CanonicalCube((0.0, 0.0, 0.0), 1.0, 8), np.nan_to_num(points, posinf=1e300, neginf=-1e300))
        assert np.isfinite(answered).all()
    facts, arrays = codec.pack(tables)
    again = codec.unpack(facts, arrays, GROUPS, len(tables))
    assert (again[0].payload.codes == tables[0].payload.codes).all()


def transport(data: bytes) -> None:
    """Latents in the transport form come back; any bytes give codes in range (11.9)."""
    choices = Choices(data)
    features, rows = 2 * choices.whole(1, 4), choices.whole(1, 6 if SLOW else 30)
    raw = choices.filled(rows * features // 2)
    codes = np.array([[byte & 15, byte >> 4] for byte in raw], np.int8).reshape(rows, features) - np.int8(8)
    assert (dec_transport(enc_transport(codes), rows, features) == codes).all() and len(enc_codes(codes)) == len(raw)
    any_codes = dec_transport(choices.rest(), rows, features)
    assert any_codes.min() >= -8 and any_codes.max() <= 7


def _few_faces(choices):
    """(lattice int64 [V, 3], faces int64 [F, 3], bool [F]) of any few faces."""
    corners, count = choices.whole(3, 12), choices.whole(0, 20)
    bits = choices.pick((1, 8, 20))
    lattice = np.array([[choices.whole(0, (1 << bits) - 1) for _ in range(3)] for _ in range(corners)], np.int64)
    faces = np.frombuffer(choices.filled(3 * count), np.uint8).astype(np.int64).reshape(count, 3) % corners
    return lattice, faces, np.frombuffer(choices.filled(count), np.uint8) % 4 != 3


def coded_normals(data: bytes) -> None:
    """Residuals at the corners of any few faces: they come back, and any bytes give normals near length 1 (8.4.4)."""
    choices = Choices(data)
    lattice, faces, coded = _few_faces(choices)
    edges = shared_edges(weld(lattice)[faces])
    groups = groups_of(lattice, faces, coded, edges, np.frombuffer(choices.filled(len(edges)), np.uint8) % 3 == 1)
    drawn = np.frombuffer(choices.filled(2 * len(groups)), np.int8).astype(np.int64).reshape(-1, 2)
    residuals = np.clip(drawn * choices.pick((1, 9, 70)), -8205, 8205)
    assert (dec_residuals(enc_residuals(residuals, groups), groups) == residuals).all()
    normals = groups.normals(dec_residuals(choices.rest(), groups), choices.pick((1, 180, 4096))).astype(np.float64)
    assert np.all(np.abs(np.linalg.norm(normals, axis=1) - (1 << ONE)) < 4)


def sharp_edges(data: bytes) -> None:
    """Marks on the edges of any few faces: they come back, and any bytes give as many marks (8.4.2)."""
    choices = Choices(data)
    lattice, faces, marked = _few_faces(choices)
    corners = len(lattice)
    ends, fold = coded_edges(lattice, faces, marked)
    assert ends.max(initial=-1) < corners and fold.min(initial=0) >= 0 and fold.max(initial=0) < NUM_FOLDS
    marks = np.frombuffer(choices.filled(len(ends)), np.uint8) % 2 == 1
    assert (dec_marks(enc_marks(marks, ends, fold), ends, fold) == marks).all()
    assert dec_marks(choices.rest(), ends, fold).shape == (len(ends),)
