"""Clause 11 in plain Python: rows and latents at a point, waves, network, values, voxels and the transport form of 3DNTC."""

from itertools import product
from math import floor
from operator import mul

from conformance.reference.attributes import RangeDecoder, de_interleave
from conformance.reference.bits import require
from conformance.reference.voxels import active_voxels, clip

POSITIONS, LARGEST, KNEE = 2**24, 2**24, 24576
HASH_FACTORS, HASH_FIELD = (1, 2654435761, 805459861), 3674653429


def latent_keys(unit, triangles, position_bits):
    """Clause 11.3: by level and field the keys of voxels with latents; triangles: of every field, as active_voxels takes them."""
    keys = []
    for level in unit["latent_levels"]:
        of_field = []
        for field, wanted in enumerate(level["num_latents"]):
            grid = level["level_resolution"], level["latent_threshold"]
            of_field.append(active_voxels(triangles[field], position_bits, *grid))
            found = len(of_field[-1])
            require(found == wanted, f"{found} voxels of field {field} have latents, num_latents is {wanted}")
        keys.append(of_field)
    return keys


class LatentLevel:
    """Clause 11.3: one level's table of rows, and by field where the rows of its voxels are."""

    def __init__(self, level, keys):
        """keys: of every field, none where the level is hashed. The rows follow."""
        self.resolution, self.table_log2, self.num_rows, self.rows = level["level_resolution"], level["table_log2"], 0, None
        self.row_of = []  # by field, from (x, y, z) to the number of a row
        for of_field in keys:
            self.row_of.append({de_interleave(key): self.num_rows + number for number, key in enumerate(of_field)})
            self.num_rows += len(of_field)
        if self.table_log2 > 0:
            self.num_rows = 2**self.table_log2

    def row(self, field, corner):
        """Number of the row of a corner, None where it has none."""
        if self.table_log2 == 0:
            return self.row_of[field].get(corner)
        hashed = field * HASH_FIELD
        for coordinate, factor in zip(corner, HASH_FACTORS, strict=True):
            hashed ^= (coordinate + 1) * factor
        return hashed % self.num_rows

    def latents(self, field, position, num_features):
        """Clause 11.4: the latents at a position, with 14 fractional bits."""
        u = [((p * self.resolution) >> 12) - 2048 for p in position]
        total, sums = 0, [0] * num_features
        for corner in product((0, 1), repeat=3):
            weight = 1
            for d, along in zip(corner, u, strict=True):
                weight *= along % 4096 if d == 1 else 4096 - along % 4096
            weight >>= 12
            row = self.row(field, tuple((along >> 12) + d for d, along in zip(corner, u, strict=True)))
            if weight == 0 or row is None:
                continue
            total += weight
            sums = [s + weight * (2 * q + 1) for s, q in zip(sums, self.rows[row], strict=True)]
        return [(s * (2**38 // total) + 2**27) >> 28 for s in sums] if total > 0 else sums


def read_rows(unit, levels):
    """Clause 5.7.4, latent_data: gives every level its rows, each a list of codes."""
    num_features, num_rows = unit["num_features"], sum(level.num_rows for level in levels)
    if unit["form"] == 1:
        rows = transported_rows(unit["latent_data"], num_features, num_rows)
    else:
        data, size = unit["latent_data"], num_features // 2
        require(len(data) == num_rows * size, f"latent_data has {len(data)} bytes where {num_rows} rows have {num_rows * size}")
        rows = [resident_row(data[at : at + size]) for at in range(0, len(data), size)]
    at = 0
    for level in levels:
        level.rows = rows[at : at + level.num_rows]
        at += level.num_rows


def resident_row(row):
    """Codes of the bytes of a row, two's complement of four bits, the low half first."""
    return [half - 16 if half > 7 else half for byte in row for half in (byte & 15, byte >> 4)]


def transported_rows(codeword, num_features, num_rows):
    """Clause 11.9."""
    decoder, contexts, rows = RangeDecoder(codeword), [(2**21, 2**21, 0)] * (num_features * 256), []
    before = before_that = [0] * num_features
    for _ in range(num_rows):
        row = []
        for k in range(num_features):
            first = (k * 16 + 4 * ((before[k] + 8) >> 2) + ((before_that[k] + 8) >> 2)) * 16
            node = 1
            for _ in range(4):
                node = 2 * node + decoder.bit(contexts, first + node)
            row.append(node - 24)
        rows.append(row)
        before, before_that = row, before
    return rows


def waves(position, wave_octaves, first_wave):
    """Clause 11.5."""
    inputs = []
    for m in range(wave_octaves):
        for p in position:
            phase = ((p * (first_wave << m)) >> 9) & 65535
            inputs += [abs(phase - 32768) - 16384, abs(((phase + 16384) & 65535) - 32768) - 16384]
    return inputs


def fixed_point(binary16):
    """Clause 11.6: 16 fractional bits of a parameter that is given as the number its 16 bits form."""
    e, m = binary16 >> 10 & 31, binary16 & 1023
    n, s = (m + 1024, e - 9) if e > 0 else (m, -8)
    magnitude = n << s if s >= 0 else (n + (1 << (-s - 1))) >> -s
    return -magnitude if binary16 >> 15 else magnitude


def layers_of(parameters, widths):
    """Clause 5.7.4, network_data: per layer, a list of weights and the bias of every output, in fixed point."""
    numbers, layers = iter([fixed_point(parameter) for parameter in parameters]), []
    for inputs, outputs in zip(widths, widths[1:], strict=False):
        weights = [[next(numbers) for _ in range(inputs)] for _ in range(outputs)]
        layers.append([(row, next(numbers)) for row in weights])
    return layers


def hard_gelu(v):
    """Clause 11.6."""
    m = clip(-KNEE, KNEE, v)
    return v if v > KNEE else (m * (m + KNEE) * 43691 + 2**30) >> 31


def network(layers, x):
    """Clause 11.6: the outputs of the last layer."""
    for number, layer in enumerate(layers):
        sums = [(bias << 14) + sum(map(mul, weights, x)) for weights, bias in layer]
        x = [clip(-LARGEST, LARGEST, (y + 2**15) >> 16) for y in sums]
        if number < len(layers) - 1:
            x = [hard_gelu(v) for v in x]
    return x


def centre(voxel, resolution):
    """Clause 11.2: the position of the centre of a voxel (x, y, z)."""
    return tuple(((2 * v + 1) << 23) // resolution for v in voxel)


def position_of(point, header):
    """Clause 11.2: the position of a world point, with its grid coordinate of 8.1 for K = 2^24."""
    side, cells = header["side"], 2 ** header["position_bits"]
    scale = (cells - 1) * (2**24 / cells)
    grid = [(p - o) / side * scale if side > 0 else 0.0 for p, o in zip(point, header["origin"], strict=True)]
    return tuple(floor(clip(0, POSITIONS - 1, x)) for x in grid)  # clipped first: x may be infinite


class Neural:
    """A 3DNTC unit that answers any position of any field."""

    def __init__(self, unit, keys):
        """keys: see latent_keys."""
        self.unit, self.layers = unit, layers_of(unit["parameters"], unit["widths"])
        self.levels = [LatentLevel(level, of_field) for level, of_field in zip(unit["latent_levels"], keys, strict=True)]
        read_rows(unit, self.levels)

    def answer(self, field, position):
        """Clauses 11.4 to 11.7: V of all components of all groups."""
        inputs = [latent for level in self.levels for latent in level.latents(field, position, self.unit["num_features"])]
        inputs += waves(position, self.unit["wave_octaves"], self.unit["first_wave"])
        return [clip(0, 65280, ((v + 16384) * 32640 + 2**13) >> 14) for v in network(self.layers, inputs)]

    def voxel_values(self, field, resolution, keys):
        """Clause 11.8: a list of the values of all components of all groups for every voxel."""
        positions = [centre(de_interleave(key), resolution) for key in keys]
        return [[(value + 128) >> 8 for value in self.answer(field, position)] for position in positions]


def coarse_values(keys, values, left_out):
    """Clause 8.3: the values of the nodes so many levels above the voxels."""
    below = {}
    for key, of_voxel in zip(keys, values, strict=True):
        below.setdefault(key >> 3 * left_out, []).append(of_voxel)
    mean = lambda numbers: (2 * sum(numbers) + len(numbers)) // (2 * len(numbers))
    return [[mean(numbers) for numbers in zip(*below[node], strict=True)] for node in sorted(below)]
