"""The conformance vectors of codec 3DNTC, good and faulty: payloads of random codes and parameters on the scenes of scenes.py.

Nothing is fitted, since a fit depends on the machine; what a payload answers need not look like anything.
"""

import zlib

import numpy as np

from conformance.make.faulty import allowing, with_element, with_units, with_values
from conformance.make.good import (
    alpha_first,
    empty,
    encoded,
    needle,
    one_voxel,
    parsed,
    scene_of,
    split_by_material,
    torus,
    two_sheets,
    units_of,
    written,
)
from texfcodec import decode
from texfcodec.bitstream.syntax import UNIT_ATTRIBUTE
from texfcodec.codecs.neural.infer import voxel_values
from texfcodec.codecs.neural.neural_codec import Neural
from texfcodec.codecs.neural.neural_syntax import FORM_RESIDENT, FORM_TRANSPORT, NEURAL
from texfcodec.codecs.neural.payload import Level, Payload, Tables, join_parameters, payload_values, split_parameters
from texfcodec.codecs.neural.transport import dec_transport
from texfcodec.field.morton import decode_morton
from texfcodec.field.voxelise import voxelise
from texfcodec.geometry.geometry_unit import field_surface
from texfcodec.scene.scene import ALPHA_BLEND, Material

A = UNIT_ATTRIBUTE
NEGATIVE = 0x8000  # sign of a binary16 number
LARGEST = 0x6BFF  # 4094, the last one below 2^12
QUICK = {"features": 4, "hidden": (6, 4), "waves": (1, 9)}  # small payloads


# Parameters: uint16 [P] from a generator and the payload that they are for.


def useful_halves(random, payload):
    """Weights that keep the spread of what they are given, so that most values are neither 0 nor 255: multiples of 2**-15."""
    weights, biases = split_parameters(random.integers(-1023, 1024, payload.parameters), payload.widths)
    scales = [4.0 / 1024 / (1 << (w.shape[1].bit_length() + 1) // 2) for w in weights]
    flat = join_parameters([w * s for w, s in zip(weights, scales, strict=True)], [b / 4096 for b in biases])
    return flat.astype(np.float16).view(np.uint16)


def halves_between(random, payload, *exponents):
    """Any sign and fraction; exponents: the least and the largest exponent field of each layer."""
    fractions, signs = random.integers(0, 1024, payload.parameters), random.integers(0, 2, payload.parameters)
    weights, biases = split_parameters(fractions | signs << 15, payload.widths)
    for layer, (least, most) in zip(zip(weights, biases, strict=True), exponents, strict=True):
        for part in layer:
            part |= random.integers(least, most + 1, part.shape) << 10
    return join_parameters(weights, biases).astype(np.uint16)


def largest_halves(random, payload):
    """+-4094 in two layers: saturated activations, and in the second layer's first row, all of one sign, the largest sums."""
    flat = (LARGEST | random.integers(0, 2, payload.parameters) << 15).astype(np.uint16)
    weights, biases = split_parameters(flat, payload.widths)
    weights[1][0] = LARGEST
    weights[2] -= np.uint16(25 << 10)  # to 2**-13, so that the values are not all at their ends
    for part in biases:
        part[:] = 0
    return join_parameters(weights, biases)


def small_halves(random, payload):
    """A first layer that saturates, then subnormals, zeros of both signs, and what is rounded to a fixed-point number."""
    flat = halves_between(random, payload, (24, 26), (0, 0), (8, 18))
    weights, biases = split_parameters(flat, payload.widths)
    weights[1][:, ::3] &= NEGATIVE
    biases[2][:] = NEGATIVE
    return join_parameters(weights, biases)


def with_half(data, place, pattern):
    """The stream with another pattern for one parameter, counted from the end where place is negative."""

    def edit(stream):
        unit = stream.attributes[0]
        halves = np.frombuffer(unit["network_data"], "<u2").copy()
        halves[place] = pattern
        unit["network_data"] = halves.tobytes()

    return with_values(data, edit)


# Streams


def crc_of(payload, stream, texf, keys):
    """values_crc (11.8). keys: by field, those of its levels."""
    total = 0
    for number, part in enumerate(texf.fields):
        tables = Tables(payload, number, keys[number])
        total = zlib.crc32(voxel_values(decode_morton(part.keys), stream.fields[number]["resolution"], tables), total)
    return total


def neural(data, seed, levels, features=8, hidden=(12, 8), waves=(2, 8), form=FORM_RESIDENT, halves=useful_halves, codes=None,
           latent_data=None):
    """The stream with a 3DNTC unit in place of its attribute units.

    levels: (G, table_log2, latent_threshold) of each; waves: wave_octaves and first_wave; halves: function (generator, payload);
    codes: what codes are drawn from, all by default; latent_data: a codeword to take the codes from.
    """
    stream, texf, random = parsed(data), decode(data), np.random.default_rng(seed)
    surfaces = [field_surface(texf.units, i) for i in range(len(texf.fields))]
    keys = [[None if log2 else voxelise(*surface, texf.position_bits, grid, threshold)[0] for grid, log2, threshold in levels]
            for surface in surfaces]
    shape = tuple(Level(grid, log2, threshold, () if log2 else tuple(len(k[n]) for k in keys))
                  for n, (grid, log2, threshold) in enumerate(levels))
    outputs = sum(group["group_components"] for group in stream.header["channel_groups"])
    payload = Payload(features, *waves, tuple(hidden), shape, outputs)
    payload.halves = halves(random, payload)
    if latent_data is None:
        payload.codes = random.choice(np.array(range(-8, 8) if codes is None else codes, np.int8), (payload.rows, features))
    else:
        payload.codes = dec_transport(latent_data, payload.rows, features)
    unit = {"field_index": 0, "group_index": 0, "codec_id": Neural.id, "level_shift": 0,
            "values_crc": crc_of(payload, stream, texf, keys),
            **payload_values(payload, form)}
    stream.attributes = [unit | ({} if latent_data is None else {"latent_data": latent_data})]
    return written(stream)


def ring(resolution, *materials):
    """A torus to put a payload on; its own values are not used."""
    return encoded(scene_of(*torus(12, 6), list(materials) or None), resolution=resolution, qp=46)


def sheets(resolution):
    """Two fields."""
    return split_by_material(encoded(two_sheets(), resolution=resolution, qp=46))


def veil(resolution):
    """Colour and alpha."""
    return ring(resolution, Material("veil", alpha_mode=ALPHA_BLEND))


def subset():
    """What the encoder writes every day, only that codes and parameters are random."""
    usual = {"features": 16, "hidden": (16, 12, 8)}
    return [
        ("neural_resident", ["3DNTC", "a grid of latents", ("{} form", "resident")], ("5.7.4", "5.7.5", "11.3", "11.6", "11.8"),
         neural(ring(24), 1, [(10, 0, 77)], waves=(3, 20), **usual), (0, 1, 5)),
        ("neural_transport", ["3DNTC", "a grid of latents", ("{} form", "transport")], ("5.7.4", "11.9"),
         neural(ring(20), 2, [(9, 0, 77)], waves=(3, 18), form=FORM_TRANSPORT, **usual), (0, 2)),
        ("neural_hash", ["3DNTC", "two hash tables"], ("5.7.5", "11.3", "11.4"),
         neural(ring(24), 3, [(12, 7, 0), (6, 6, 0)], waves=(3, 2), **usual), (0,)),
    ]


def fields_and_levels():
    """Clauses 5.7.5 and 11.2 to 11.4."""
    fine, coarse = parsed(sheets(21)), parsed(sheets(12))
    fine.fields[1], fine.attributes[1] = coarse.fields[1], coarse.attributes[1]
    return [
        ("neural_two_fields", ["3DNTC", "two fields", "fields of different K", "two grids", ("{} form", "transport")],
         ("5.7", "5.7.5", "11.3", "11.8"), neural(written(fine), 4, [(9, 0, 77), (4, 0, 0)], form=FORM_TRANSPORT), (0, 1, 4, 5)),
        ("neural_two_fields_hash", ["3DNTC", "two fields share a hash table of another grid"], ("5.7.5", "11.3"),
         neural(sheets(17), 5, [(11, 6, 0), (5, 0, 40)], **QUICK), (0, 2)),
        ("neural_levels", ["3DNTC", "four levels", "hashed ones between grids"], ("5.7.5", "11.3", "11.4"),
         neural(sheets(18), 6, [(3, 5, 0), (8, 0, 77), (40, 1, 0), (5, 0, 0)], **QUICK), (0,)),
        ("neural_alpha", ["3DNTC", "colour and alpha"], ("5.7", "11.1"), neural(veil(18), 7, [(8, 0, 77)], **QUICK), (0, 1)),
        ("neural_alpha_first", ["3DNTC", "alpha before colour"], ("5.3.1", "11.1"),
         neural(alpha_first(), 8, [(7, 5, 0)], **QUICK), (0, 2)),
        ("neural_k33", ["3DNTC", ("K = {}", 33), "all levels of detail", "a grid as fine"], ("8.3", "11.2", "11.4"),
         neural(ring(33), 9, [(33, 0, 77)], features=2, hidden=(6,), waves=(1, 33)), (*range(8), 13)),
        ("neural_one_voxel", ["3DNTC", ("K = {}", 1), "a grid of one cell"], ("8.3", "11.2", "11.4"),
         neural(one_voxel(), 10, [(1, 0, 0), (2, 0, 0)], **QUICK), (0, 1)),
        ("neural_sparse", ["3DNTC", "a latent_threshold that leaves points without latents"], ("5.7.5", "11.3", "11.4"),
         neural(ring(24), 11, [(30, 0, 330), (20, 0, 330)], **QUICK), (0, 1)),
        ("neural_needle", ["3DNTC", ("B = {}", 20), ("K = G = {}", 8192), ("a grid of {}", 1000)], ("10", "11.2", "11.3", "11.4"),
         neural(needle(), 12, [(8192, 3, 0), (1000, 0, 0)], features=2, hidden=(4,), waves=(1, 1000)), (0, 5)),
    ]


def network_and_codes():
    """Clauses 5.7.4 and 11.5 to 11.9."""
    flat = {"codes": (-8,), "form": FORM_TRANSPORT}
    return [
        ("neural_widths", ["3DNTC", "hidden layers of 5, 1 and 128 units"], ("5.7.4", "11.6"),
         neural(ring(14), 21, [(6, 0, 77)], features=6, hidden=(5, 1, 128)), (0,)),
        ("neural_four_layers", ["3DNTC", "four hidden layers", "no waves", "two latents a row"], ("5.7.4", "11.6"),
         neural(ring(16), 22, [(9, 0, 77)], features=2, hidden=(9, 7, 3, 2), waves=(0, 1)), (0,)),
        ("neural_no_waves", ["3DNTC", "no waves"], ("5.7.4", "11.5"), neural(ring(18), 23, [(7, 0, 77)], waves=(0, 16384)), (0,)),
        ("neural_waves", ["3DNTC", "eight octaves", ("first_wave {}", 16383)], ("10", "11.5"),
         neural(ring(21), 24, [(4, 0, 77)], features=2, waves=(8, 16383)), (0,)),
        ("neural_shortest_waves", ["3DNTC", "eight octaves", ("first_wave {}", 16384)], ("10", "11.5"),
         neural(ring(21), 34, [(4, 0, 77)], features=2, waves=(8, 16384)), (0,)),
        ("neural_most_inputs", ["3DNTC", "the most inputs that there are"], ("10", "11.5", "11.6"),
         neural(ring(12), 25, [(9, 3, 0), (8, 2, 0), (7, 1, 0), (6, 1, 0)], features=64, waves=(8, 1)), (0,)),
        ("neural_largest", ["3DNTC", "parameters of +-4094", "saturated activations"], ("10", "11.6", "11.7"),
         neural(ring(14), 26, [(6, 5, 0)], features=2, hidden=(128, 8), waves=(0, 1), halves=largest_halves), (0,)),
        ("neural_small", ["3DNTC", "subnormal parameters", "zeros of both signs", "rounding to fixed point"], ("5.7.4", "11.6"),
         neural(ring(16), 27, [(7, 0, 77)], hidden=(24, 24), halves=small_halves), (0,)),
        ("neural_any_halves", ["3DNTC", "parameters of any sign, exponent and fraction"], ("11.6", "11.7"),
         neural(ring(16), 28, [(7, 0, 77)], hidden=(16, 16),
                halves=lambda random, payload: halves_between(random, payload, (0, 26), (0, 14), (0, 10))), (0,)),
        ("neural_flat", ["3DNTC", "all codes -8", "a short codeword"], ("11.9",), neural(ring(18), 29, [(8, 0, 77)], **flat),
         (0,)),
        ("neural_no_codeword", ["3DNTC", "a codeword of no bytes"], ("11.9",),
         neural(ring(18), 30, [(8, 0, 77)], form=FORM_TRANSPORT, latent_data=b""), (0,)),
        ("neural_random_codeword", ["3DNTC", "random bytes as a codeword", "more than are read"], ("11.9",),
         neural(ring(18), 31, [(8, 0, 77)], form=FORM_TRANSPORT, latent_data=np.random.default_rng(32).bytes(1500)), (0,)),
        ("neural_ones_codeword", ["3DNTC", "a codeword that begins above every range"], ("7.6.2", "11.9"),
         neural(sheets(12), 33, [(5, 0, 77), (6, 5, 0)], form=FORM_TRANSPORT, latent_data=b"\xff" * 9 + bytes(40) + b"\x55" * 50),
         (0,)),
    ]


def uncommon():
    """What a decoder meets seldom, and what only another encoder would write."""
    return fields_and_levels() + network_and_codes()


# Faulty ones


def one_unit(data, edit):
    """The stream whose only attribute unit `edit` has changed."""
    return with_values(data, lambda stream: edit(stream.attributes[0]))


def with_level(data, number=0, more=0, **changes):
    """The stream with other elements in one of its latent levels, and `more` bytes of latents."""

    def edit(unit):
        unit["latent_levels"][number].update(changes)
        unit["latent_data"] = bytes(unit["latent_data"]) + bytes(more)

    return one_unit(data, edit)


def of_zeros(data, *hidden, levels=1):
    """The stream of one level with hidden layers of these widths and so many levels, even where that is too few, and parameters
    of 0, for which all values are 128."""
    stream = parsed(data)
    (unit,), (part,) = stream.attributes, stream.fields
    widths = [unit["num_features"] * levels + 6 * unit["wave_octaves"], *hidden, unit["Widths"][-1]]
    unit.update(num_levels=levels, latent_levels=unit["latent_levels"][:levels], latent_data=bytes(unit["latent_data"]) * levels)
    parameters = sum((inputs + 1) * outputs for inputs, outputs in zip(widths, widths[1:], strict=False))
    unit.update(num_hidden=len(hidden), hidden_width=list(hidden), network_data=bytes(2 * parameters),
                values_crc=zlib.crc32(bytes([128]) * (widths[-1] * part["num_keys"])))
    with allowing(NEURAL, "num_hidden", low=0), allowing(NEURAL, "hidden_width", low=0), allowing(NEURAL, "num_levels", low=0):
        return written(stream)


def faulty_elements(data):
    """Elements of clauses 5.7.4 and 5.7.5 that are out of their range."""
    level, u16 = "latent_levels[0].", lambda number: number.to_bytes(2, "little")
    lines = [
        ("form_2", "form 2", "5.7.4", "form", b"\2"), ("features_0", "no features", "5.7.4", "num_features", b"\0"),
        ("features_66", "66 features", "5.7.4", "num_features", b"\x42"),
        ("octaves_9", "nine octaves", "5.7.4", "wave_octaves", b"\t"),
        ("hidden_5", "five hidden layers", "5.7.4", "num_hidden", b"\5"),
        ("width_129", "a hidden layer of 129 units", "5.7.4", "hidden_width", b"\x81\4"),
        ("levels_0", "no level", "5.7.4", "num_levels", b"\0"), ("levels_5", "five levels", "5.7.4", "num_levels", b"\5"),
        ("grid_0", "G = 0", "5.7.5", level + "level_resolution", u16(0)),
        ("grid_8193", "G = 8193", "5.7.5", level + "level_resolution", u16(8193)),
        ("table_log2_25", "a hash table of 2^25 rows", "5.7.5", level + "table_log2", b"\x19"),
        ("num_latents_0", "a grid without latents", "5.7.5", level + "num_latents", b"\0"),
    ]
    still = neural(ring(12), 41, [(6, 0, 77)], **QUICK | {"waves": (0, 1)})  # without waves the first one moves nothing
    wave = lambda n: with_element(still, A, "first_wave", u16(n))
    waves = [(f"neural_first_wave_{n}", f"3DNTC: first_wave {n}", "5.7.4", wave(n), "TXF-S04") for n in (0, 16385)]
    few = [("neural_hidden_0", "3DNTC: no hidden layer", "5.7.4", of_zeros(data), "TXF-S04"),
           ("neural_width_0", "3DNTC: a hidden layer of no units", "5.7.4", of_zeros(data, 6, 0), "TXF-S04")]
    code = lambda element: "TXF-U09" if element == "form" else "TXF-S04"
    return [(f"neural_{name}", f"3DNTC: {title}", clause, with_element(data, A, element, raw), code(element))
            for name, title, clause, element, raw in lines] + waves + few


def faulty_payloads(resident, transport, two):
    """Latents, parameters and the checksum (5.7.4, 5.7.5, 11.3, 11.6, 11.8)."""
    rows = parsed(resident).attributes[0]["latent_levels"][0]["num_latents"][0]
    row = QUICK["features"] // 2
    first, second = parsed(two).attributes[0]["latent_levels"][0]["num_latents"]
    cut = lambda unit: unit.update(latent_data=unit["latent_data"][:-1])
    flip = lambda name: lambda unit: unit.update({name: bytes([unit[name][0] ^ 0x10]) + unit[name][1:]})
    odd = neural(ring(12), 42, [(6, 0, 77)], **QUICK | {"features": 5}, form=FORM_TRANSPORT)
    short = lambda units: units.__setitem__(-2, (A, units[-2][1][:40]))
    lines = [
        ("features_odd", "five features", "5.7.4", odd, "TXF-S04"),
        ("latents_short", "a byte of latents too few", "5.7.4", one_unit(resident, cut), "TXF-S10"),
        ("latents_long", "a byte of latents too many", "5.7.4", with_level(resident, more=1), "TXF-S10"),
        ("network_cut", "the unit ends in network_data", "5.7.4", with_units(resident, short), "TXF-S02"),
        ("num_latents", "a row more than the grid has", "11.3",
         with_level(resident, more=row, num_latents=[rows + 1]), "TXF-S30"),
        ("num_latents_less", "a row fewer than the grid has, transport form", "11.3",
         with_level(transport, num_latents=[rows - 1]), "TXF-S30"),
        ("num_latents_moved", "a row of one field counted as the other's", "11.3",
         with_level(two, num_latents=[first - 1, second + 1]), "TXF-S30"),
        ("num_latents_huge", "2^40 rows", "5.7.5", with_level(resident, num_latents=[1 << 40]), "TXF-S10"),
        ("latent_threshold", "another latent_threshold than the rows were kept by", "11.3",
         with_level(resident, latent_threshold=200), "TXF-S30"),
        ("level_resolution", "another G than the rows were made for", "11.3",
         with_level(resident, level_resolution=7), "TXF-S30"),
        ("nan", "a parameter that is not a number", "5.7.4", with_half(resident, 3, 0x7E00), "TXF-S50"),
        ("infinity", "an infinite parameter", "5.7.4", with_half(transport, -1, 0x7C00 | NEGATIVE), "TXF-S50"),
        ("half_4096", "a parameter of 2^12", "5.7.4", with_half(resident, -2, LARGEST + 1), "TXF-S50"),
        ("half_4096_unasked", "a parameter of 2^12 that moves no value", "5.7.4",
         with_half(of_zeros(resident, 6), 0, LARGEST + 1), "TXF-S50"),
        ("values_crc", "a wrong values_crc", "11.8", with_element(resident, A, "values_crc", b"\1\2\3\4"), "TXF-S32"),
        ("code", "a flipped bit in a code", "11.8", one_unit(resident, flip("latent_data")), "TXF-S32"),
        ("codeword", "a flipped bit in the codeword", "11.8", one_unit(transport, flip("latent_data")), "TXF-S32"),
        ("parameter", "a flipped bit in a parameter", "11.8", one_unit(resident, flip("network_data")), "TXF-S32"),
    ]
    return [(f"neural_{name}", f"3DNTC: {title}", *rest) for name, title, *rest in lines]


def faulty_units(resident, two, alpha):
    """Clause 5.7: a 3DNTC unit is the only one and stands for all fields and groups."""
    plain, plain_two, plain_alpha = parsed(ring(12)), parsed(sheets(12)), parsed(veil(12))
    beside = lambda data, units: with_values(data, lambda stream: setattr(stream, "attributes", units(stream.attributes)))
    (every,), raht = parsed(two).attributes, plain.attributes[0]
    lines = [
        ("twice", "a second 3DNTC unit", resident, lambda listed: listed * 2),
        ("before_raht", "a RAHT unit after the 3DNTC unit", resident, lambda listed: [*listed, raht]),
        ("after_raht", "a RAHT unit before the 3DNTC unit", resident, lambda listed: [raht, *listed]),
        ("second_group", "a 3DNTC unit for alpha beside RAHT for colour", alpha,
         lambda listed: [plain_alpha.attributes[0], listed[0] | {"group_index": 1}]),
        ("second_field", "a 3DNTC unit for one of two fields beside RAHT for the other", two,
         lambda listed: [plain_two.attributes[0], every | {"field_index": 1}]),
        ("field_index", "field_index 1", two, lambda listed: [every | {"field_index": 1}]),
        ("group_index", "group_index 1", alpha, lambda listed: [listed[0] | {"group_index": 1}]),
    ]
    alone = with_units(empty(), lambda units: units.insert(-1, units_of(resident)[-2]))
    return [*((f"neural_{name}", f"3DNTC: {title}", "5.7", beside(data, units), "TXF-S11") for name, title, data, units in lines),
            ("neural_empty", "3DNTC: a unit in a stream without fields", "5.7", alone, "TXF-S09")]


def faulty():
    """All faulty vectors of the codec."""
    resident, two = neural(ring(12), 41, [(6, 0, 77)], **QUICK), neural(sheets(12), 43, [(6, 0, 77)], **QUICK)
    transport = neural(ring(12), 41, [(6, 0, 77)], **QUICK, form=FORM_TRANSPORT)
    alpha = neural(veil(12), 44, [(6, 0, 77)], **QUICK)
    huge = with_level(transport, num_latents=[1 << 40])
    # The largest table is allowed, so that what comes after it decides.
    largest = with_element(neural(ring(12), 41, [(6, 5, 0)], **QUICK, form=FORM_TRANSPORT), A,
                           "latent_levels[0].table_log2", b"\x18")
    other = units_of(with_element(ring(12), A, "codec_id", b"\x07"))[-2]
    unknown = [("neural_table_log2_24", "3DNTC: a hash table of 2^24 rows, then an unknown codec", "5.7.5",
                with_units(largest, lambda units: units.insert(-1, other)), "TXF-U02")]
    limit = [("neural_latents_huge", "3DNTC: 2^40 rows in the transport form", "10", huge, "TXF-L10")]
    lines = faulty_elements(resident) + faulty_payloads(resident, transport, two) + faulty_units(resident, two, alpha)
    return [*lines, *unknown, *limit]
