"""The claims of good conformance vectors, each looked up in the vector's stream and in what it decodes to.

A vector lists its claims: keys of CLAIMS, alone or as (key, argument, ...). Its title is those keys with their arguments put in.
"""

import json
import zlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from conformance.make.claims_materials import MATERIAL_CLAUSES, MATERIALS
from conformance.make.claims_normals import NORMALS, NORMALS_CLAUSES
from conformance.make.claims_planar import PLANAR, PLANAR_CLAUSES
from conformance.make.claims_texels import TEXELS
from conformance.make.good import parsed, units_of, values_of
from conformance.make.trace import traced
from conformance.make.vector import in_full, title_of
from texfcodec import decode
from texfcodec.bitstream.syntax import SUPPORT_TEXELS, SUPPORT_VOXELS, UNIT_MATERIALS, UNIT_METADATA
from texfcodec.bitstream.units import write_unit
from texfcodec.codecs.neural.neural_syntax import FORM_RESIDENT, FORM_TRANSPORT
from texfcodec.codecs.neural.transport import dec_transport
from texfcodec.codecs.raht.transform.prediction import DEFAULT_KERNEL
from texfcodec.field.morton import decode_morton
from texfcodec.field.voxelise import voxelise
from texfcodec.scene.channels import ALPHA, BASE_COLOUR
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, ALPHA_OPAQUE

RAHT_ID, CONSTANT_ID = 0, 2
CHANNELS_OF = {"colour": {BASE_COLOUR.semantic}, "alpha": {ALPHA.semantic}, "both": {BASE_COLOUR.semantic, ALPHA.semantic}}
LARGEST_MEAN = 1 << 22
LARGEST_HALF = 0x6BFF  # 4094 as binary16


@dataclass
class Case:
    """A good vector as it stands: claims and clauses, its bytes and the levels of detail that it lists."""

    claims: list
    clauses: list
    data: bytes
    lods: list

    @cached_property
    def stream(self):
        return parsed(self.data)

    @cached_property
    def texf(self):
        return decode(self.data)

    @cached_property
    def trace(self):
        return traced(self.data)

    @cached_property
    def silent(self):
        """By RAHT unit and filter stage: the numbers of the taps without which all values are the same."""
        return [silent_taps(unit, self.texf.fields[unit["field_index"]].keys) for unit in self.raht]

    header = property(lambda self: self.stream.header)
    semantics = property(lambda self: [group["group_semantics"][0] for group in self.header["channel_groups"]])
    grids = property(lambda self: [f["resolution"] for f in self.stream.fields if f["support"] == SUPPORT_VOXELS])
    images = property(lambda self: [f for f in self.stream.fields if f["support"] == SUPPORT_TEXELS])
    textured = property(lambda self: [u for u in self.texf.units if u.uv is not None])
    uv_units = property(lambda self: [u for u in self.stream.geometry if u["Support"] == SUPPORT_TEXELS])
    corners = property(lambda self: np.concatenate([u.uv[u.faces] for u in self.textured]))
    neural = property(lambda self: self.stream.joint)
    raht = property(lambda self: [unit for unit in self.stream.attributes if unit["codec_id"] == RAHT_ID])
    constant = property(lambda self: [unit for unit in self.stream.attributes if unit["codec_id"] == CONSTANT_ID])
    levels = property(lambda self: self.neural["latent_levels"])
    stages = property(lambda self: [unit["filters"] for unit in self.raht])
    codewords = property(lambda self: b"".join(bytes(unit["codeword_data"]) for unit in self.raht)
                         if self.raht else bytes(self.neural["latent_data"]))
    halves = property(lambda self: np.frombuffer(bytes(self.neural["network_data"]), "<u2").astype(np.int64))

    def each(self, condition):
        """Whether there are RAHT units and the condition holds for all of them."""
        return bool(self.raht) and all(map(condition, self.raht))


def case_at(folder):
    """The Case of a vector's folder."""
    case = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    return Case(case["claims"], case["clauses"], (folder / "in.texf").read_bytes(), [int(lod) for lod in case["lods"]])


def silent_taps(unit, keys):
    """By stage of a RAHT unit: numbers of the entries of filter_coefficients that may be 0 without a change of any value."""
    whole, out = values_of(unit, keys), []
    for i, stage in enumerate(unit["filters"]):
        taps = stage["filter_coefficients"]
        without = [stage | {"filter_coefficients": [*taps[:j], 0, *taps[j + 1 :]]} for j in range(len(taps))]
        stages = [[*unit["filters"][:i], changed, *unit["filters"][i + 1 :]] for changed in without]
        out.append([j for j, s in enumerate(stages) if np.array_equal(values_of(unit | {"filters": s}, keys), whole)])
    return out


# Predicates that do not fit a line


def has_stages(case, count=None):
    """Every filtered unit has so many stages, there is one, and each stage with a bit in its mask changes a value."""
    filtered = [i for i, stages in enumerate(case.stages) if stages]
    heard = all(len(silent) < len(stage["filter_coefficients"]) or not stage["filter_mask"]
                for i in filtered for stage, silent in zip(case.stages[i], case.silent[i], strict=True))
    return bool(filtered) and heard and (count is None or all(len(case.stages[i]) == count for i in filtered))


def filters_only(case, semantic):
    """The units of one semantic are filtered, those of the others are there and not."""
    of = {unit["group_index"]: bool(unit["filters"]) for unit in case.raht}
    return len(of) > 1 and all(there == (case.semantics[group] == semantic) for group, there in of.items())


def groups_of(case, units):
    """Semantics of some attribute units."""
    return {case.semantics[unit["group_index"]] for unit in units}


def has_component_filter(case, component):
    """All five classes of this component of three, and nothing else."""
    wanted = sum(1 << 3 * k + component for k in range(5))
    return has_stages(case) and all(s["filter_mask"] == wanted for stages in case.stages for s in stages)


def has_every_tap(case):
    """The masks are full and every tap changes a value."""
    full = all(s["filter_mask"] == (1 << 5 * u["NumComponents"]) - 1 for u in case.raht for s in u["filters"])
    return full and has_stages(case) and not any(silent for of_unit in case.silent for silent in of_unit)


def has_slices(case):
    return case.each(lambda unit: unit["slice_level"] > 0 and unit["NumSlices"] > 1)


def drops_voxels(case):
    """Fewer voxels than the geometry touches."""
    (field,), (unit,) = case.stream.fields, case.texf.units
    touched, _ = voxelise(unit.lattice, unit.faces, case.header["position_bits"], field["resolution"], 0)
    return field["num_keys"] < len(touched)


def lonely_voxels(case):
    """Number of voxels without any of the 26 neighbours."""
    places = np.concatenate([decode_morton(field.keys) for field in case.texf.fields]).astype(np.int64)
    apart = np.abs(places[:, None] - places[None]).max(-1)
    return int((((apart <= 1).sum(1)) == 1).sum())


def off_corner(case):
    """Number of vertices that are not on a voxel corner."""
    (unit,), (grid,) = case.texf.units, case.grids
    return int(((unit.lattice.astype(np.int64) * grid) % (1 << case.header["position_bits"]) > 0).any(1).sum())


def least_faces(case):
    """Number of faces on the edge that has most of them."""
    (unit,) = case.texf.units
    places = [tuple(p) for p in unit.lattice.tolist()]
    edges = [frozenset((places[f[i]], places[f[i - 1]])) for f in unit.faces.tolist() for i in range(3)]
    return max(edges.count(edge) for edge in edges)


def areas(case):
    """Length of the cross product of two edges of every face, in lattice units."""
    crosses = [np.cross(*(c[1:] - c[0])) for u in case.texf.units for c in u.lattice.astype(np.int64)[u.faces]]
    return [float(np.linalg.norm(c)) for c in crosses]


def point_faces(case):
    """Number of faces whose corners are one grid coordinate (6.1), though not one position."""
    (unit,), (grid,) = case.texf.units, case.grids
    corners = unit.lattice.astype(np.int64)[unit.faces]
    same = ((corners * grid << 16) >> case.header["position_bits"])
    return int(((same == same[:, :1]).all((1, 2)) & ~(corners == corners[:, :1]).all((1, 2))).sum())


def is_noise(data):
    """Bytes that no compressor makes smaller."""
    return len(data) > 100 and len(zlib.compress(data, 9)) >= len(data)


def other_metadata(case):
    """Whether the metadata unit is one that is passed over."""
    return UNIT_METADATA in [unit["type"] for unit in case.stream.skipped]


def metadata_is_early(case):
    kinds = [kind for kind, _ in units_of(case.data)]
    return kinds.index(UNIT_METADATA) < kinds.index(UNIT_MATERIALS)


def neural_codes(case):
    """All codes of a transport form."""
    rows = sum(level["NumRows"] for level in case.levels)
    return dec_transport(bytes(case.neural["latent_data"]), rows, case.neural["num_features"])


def rounded_halves(case):
    """Whether a parameter loses bits on its way to fixed point (11.6)."""
    exponent, n = case.halves >> 10 & 31, (case.halves & 1023) + 1024
    return bool(((exponent > 0) & (exponent < 9) & (n & ((1 << np.clip(9 - exponent, 0, 9)) - 1) > 0)).any())


def magnitude_is(case, power):
    """The cube's far corner is 10**power, up to a factor of 10."""
    return abs(np.log10(max(map(abs, [case.header["side"], *case.header["origin"]]))) - power) < 1


def edge_lengths(case):
    """Of the first edge of every face, in steps of the lattice; longest along an axis."""
    return [int(np.abs(u.lattice[face[1]] - u.lattice[face[0]]).max()) for u in case.texf.units for face in u.faces]


# Claim -> predicate of the Case and the arguments.
HEADER_AND_FIELDS = {
    "B = {}": lambda c, bits: c.header["position_bits"] == bits,
    "K = {}": lambda c, k: set(c.grids) == {k},
    "K = G = {}": lambda c, k: set(c.grids) == {k} <= {level["level_resolution"] for level in c.levels},
    "a single block": lambda c: c.grids == [2],
    "no power of two": lambda c: all(k & (k - 1) for k in c.grids),
    "all levels of detail": lambda c: {*range(c.texf.fields[0].support.depth + 1)} < {*c.lods},
    "a Draco mesh of traversal type {}": lambda c, n: {bytes(u["draco_data"])[11] for u in c.stream.geometry} == {n},
    "side {}": lambda c, n: c.header["side"] == n,
    "{} channel groups": lambda c, n: c.header["num_channel_groups"] == n,
    "an empty mesh": lambda c: c.stream.faces == 0,
    "two sheets and a face of one step": lambda c: sorted(edge_lengths(c)) == [1, 1000, 1000],
    "each in a field of its own": lambda c: [(u.field, len(u.faces)) for u in c.texf.units] ==
        [(n, 1) for n in range(len(c.stream.fields))],
    "a face without area": lambda c: 0 in areas(c),
    "faces whose corners are at one position": lambda c: any(
        (corners == corners[:, :1]).all((1, 2)).any() for u in c.texf.units for corners in [u.lattice[u.faces]]),
    "{} faces that share no corner": lambda c, n: [u.faces.size for u in c.texf.units] == [3 * n] ==
        [len(np.unique(u.lattice, axis=0)) for u in c.texf.units],
    "one triangle": lambda c: c.stream.faces == 1,
    "a triangle thinner than a voxel": lambda c: c.stream.faces == 1
        and 0 < max(areas(c)) < (1 << 2 * c.header["position_bits"]) / c.grids[0],
    "a triangle whose corners have one grid coordinate": lambda c: point_faces(c) == 1,
    "all vertices but three on voxel corners": lambda c: off_corner(c) == 3,
    "a mesh that is not a manifold": lambda c: least_faces(c) > 2,
    "coordinates near 1e{}": magnitude_is,
    "area_threshold {} keeps every touched voxel": lambda c, n:
        not drops_voxels(c) and c.stream.fields[0]["area_threshold"] == n,
    "area_threshold {} drops some": lambda c, n: drops_voxels(c) and c.stream.fields[0]["area_threshold"] == n,
    "five materials in one field": lambda c: (c.header["num_materials"], len(c.grids)) == (5, 1),
    "two fields": lambda c: len(c.stream.fields) == 2,
    "fields of different K": lambda c: len(set(c.grids)) == 2,
    "geometry units out of field order": lambda c: (order := [u["field_index"] for u in c.stream.geometry]) != sorted(order),
    "alpha group for a MASK material beside an opaque one": lambda c: ALPHA.semantic in c.semantics
        and {m["alpha_mode"] for m in c.stream.materials} == {ALPHA_MASK, ALPHA_OPAQUE},
    "alpha group for a BLEND material": lambda c: ALPHA.semantic in c.semantics
        and {m["alpha_mode"] for m in c.stream.materials} == {ALPHA_BLEND},
    "colour and alpha": lambda c: c.semantics == [BASE_COLOUR.semantic, ALPHA.semantic],
    "alpha before colour": lambda c: c.semantics == [ALPHA.semantic, BASE_COLOUR.semantic],
    "a metadata unit": lambda c: c.stream.metadata is not None,
    "metadata early": metadata_is_early,
    "metadata of another format": other_metadata,
    "unknown ancillary units": lambda c: len(c.stream.skipped) > 1,
    "checksums of 0 and of 2^32 - 1": lambda c:
        {bytes(4), b"\xff" * 4} <= {write_unit(*unit)[-4:] for unit in units_of(c.data)},
}
CODEWORDS = {
    "no level": lambda c: c.each(lambda u: u["Depth"] == 0),
    "no codeword": lambda c: c.each(lambda u: not u["codewords"]),
    "a codeword of no bytes": lambda c: (not c.raht or c.each(lambda u: u["codewords"])) and c.codewords == b"",
    "a codeword that begins above every range": lambda c: c.codewords[:4] == b"\xff" * 4,
    "a codeword that begins with the bound of its first bit": lambda c: c.codewords[:4] == (65535 * 32768).to_bytes(4, "big"),
    "numbers of eight bytes": lambda c: c.each(lambda u: min(min(word["level_bytes"]) for word in u["codewords"]) >> 49 > 0),
    "zeros": lambda c: c.codewords[:20] == bytes(20),
    "then zeros": lambda c: c.codewords[4:8] == bytes(4),
    "a residual beyond 255": lambda c: c.trace.escapes > 240 and c.each(lambda u: u["residual"]),
    "then random bytes": lambda c: is_noise(c.codewords.lstrip(b"\0")),
    "random bytes as a codeword": lambda c: is_noise(c.codewords),
    "more than are read": lambda c: c.trace.unread > 0,
    "random bytes through the mixed contexts": lambda c: is_noise(c.codewords) and c.each(lambda u: u["num_models"]),
    "random bytes through the residuals": lambda c: is_noise(c.codewords) and c.each(lambda u: u["residual"]),
    "zeros up to the middle of the residuals": lambda c:
        c.codewords[:1000] == bytes(1000) and c.each(lambda u: u["residual"]),
    "the largest ones": lambda c: c.trace.escapes >= 240 and c.each(lambda u: u["residual"]),
    "long magnitudes": lambda c: c.trace.escapes > 0,
    "the longest escapes": lambda c: c.trace.escapes >= 1 << 24,
    "saturated differences and means": lambda c: c.trace.differences == LARGEST_MEAN - 1
        and {("attributes", LARGEST_MEAN), ("attributes", -LARGEST_MEAN)} <= c.trace.clipped,
    "means at their bounds": lambda c: {("filter" if any(c.stages) else "attributes", sign * LARGEST_MEAN) for sign in (-1, 1)}
        <= c.trace.clipped,
    "clipped values": lambda c: {("attributes", 0), ("attributes", 255)} <= c.trace.clipped,
    "probabilities at their lower bound": lambda c: ("attributes", 24) in c.trace.clipped,
}
RAHT = {
    "the smallest step": lambda c: c.each(lambda u: set(u["qp"]) == {0}),
    "another step in every component": lambda c: c.each(lambda u: len(set(u["qp"])) == u["NumComponents"] > 1),
    "the largest step": lambda c: c.each(lambda u: max(u["qp"]) == 63),
    "another prediction kernel": lambda c: c.each(lambda u: tuple(u["kernel"]) != tuple(DEFAULT_KERNEL)),
    "one weight 0": lambda c: c.each(lambda u: list(u["kernel"]).count(0) == 1),
    "direct contexts": lambda c: c.each(lambda u: u["num_models"] == 0),
    "a single model": lambda c: c.each(lambda u: u["num_models"] == 1),
    "{} models": lambda c, n: c.each(lambda u: u["num_models"] == n),
    "colour range": lambda c: c.each(lambda u: u["colour_range"] > 0),
    "no colour range": lambda c: c.each(lambda u: u["colour_range"] == 0),
    "three components without a colour transform": lambda c: c.each(
        lambda u: u["colour_transform"] == 0 and u["NumComponents"] == 3),
    "no transform": lambda c: c.each(lambda u: u["colour_transform"] == 0),
    "slices": has_slices,
    "slices with the level index": lambda c: has_slices(c) and c.each(lambda u: u["level_index"]),
    "slices of colour and alpha": lambda c: has_slices(c) and len(c.raht) == len(c.semantics) == 2,
    "slices from level {} on": lambda c, n: has_slices(c) and c.each(lambda u: u["slice_level"] == n),
    "a trunk with a single slice": lambda c: c.each(lambda u: u["slice_level"] > 0 and u["NumSlices"] == 1),
    "the level index without slices": lambda c: c.each(lambda u: u["level_index"] and u["slice_level"] == 0),
    "lossless": lambda c: c.each(lambda u: u["residual"] == 1),
    "a first component with a residual_cross": lambda c: c.each(lambda u: u["residual_cross"][u["NumComponents"] // 3] > 0),
    "noise with errors of at most {} from a coarse field": lambda c, n:
        c.each(lambda u: u["residual"] == n + 1 and min(u["qp"]) >= 30),
}
FILTERS = {
    "no filter": lambda c: c.each(lambda u: not u["filters"]),
    "a filter": has_stages,
    "{} filter stages": has_stages,
    "three filter stages that have nothing to do": lambda c: c.each(
        lambda u: len(u["filters"]) == 3 and all(s["filter_mask"] for s in u["filters"])) and not has_stages(c, 3),
    "a filter stage of every class and component": lambda c: has_stages(c, 1) and has_every_tap(c),
    "a filter of alpha alone": lambda c: has_stages(c) and filters_only(c, ALPHA.semantic),
    "a filter of colour alone": lambda c: has_stages(c) and filters_only(c, BASE_COLOUR.semantic),
    "beside alpha": lambda c: ALPHA.semantic in c.semantics,
    "a filter of component {} alone": has_component_filter,
    "a filter of the second alone": lambda c: has_stages(c) and [bool(stages) for stages in c.stages] == [False, True],
    "the second without a bit in its mask": lambda c: c.each(
        lambda u: [bool(s["filter_mask"]) for s in u["filters"]] == [True, False, True]),
    "lossless after three filter stages": lambda c: has_stages(c, 3) and c.each(lambda u: u["residual"] == 1 and u["filters"]),
    "errors of at most {} after a filter stage": lambda c, n:
        has_stages(c, 1) and c.each(lambda u: u["residual"] == n + 1 and u["filters"]),
    "coefficients of -128 and 127": lambda c: {-128, 127} == {t for u in c.stages for s in u for t in s["filter_coefficients"]},
    "voxels without a neighbour": lambda c: lonely_voxels(c) > 0,
}
CONSTANT = {
    "{} constant": lambda c, which: groups_of(c, c.constant) == CHANNELS_OF[which],
    "{} constant beside RAHT {}": lambda c, which, other:
        (groups_of(c, c.constant), groups_of(c, c.raht)) == (CHANNELS_OF[which], CHANNELS_OF[other]),
    "values of 0 and 255": lambda c: {v for unit in c.constant for v in unit["plane_value"]} == {0, 255},
    "the second constant": lambda c: [u["field_index"] for u in c.constant] == [1] and [u["field_index"] for u in c.raht] == [0],
    "all constant": lambda c: bool(c.constant) and not c.raht,
}
NEURAL = {
    "3DNTC": lambda c: c.neural is not None,
    "a grid of latents": lambda c: [level["table_log2"] for level in c.levels] == [0],
    "two grids": lambda c: [level["table_log2"] for level in c.levels] == [0, 0],
    "{} form": lambda c, form:
        c.neural["form"] == {"resident": FORM_RESIDENT, "transport": FORM_TRANSPORT}[form],
    "two hash tables": lambda c: len(c.levels) == 2 and all(level["table_log2"] for level in c.levels),
    "two fields share a hash table of another grid": lambda c: len(c.grids) == 2 and any(
        level["table_log2"] and level["level_resolution"] not in c.grids for level in c.levels),
    "four levels": lambda c: len(c.levels) == 4,
    "hashed ones between grids": lambda c: [level["table_log2"] > 0 for level in c.levels] == [True, False, True, False],
    "a grid as fine": lambda c: c.grids == [level["level_resolution"] for level in c.levels if level["table_log2"] == 0],
    "a grid of one cell": lambda c: any((lv["level_resolution"], lv["table_log2"]) == (1, 0) for lv in c.levels),
    "a grid of {}": lambda c, n: any((lv["level_resolution"], lv["table_log2"]) == (n, 0) for lv in c.levels),
    "a latent_threshold that leaves points without latents": lambda c: c.trace.empty,
    "hidden layers of 5, 1 and 128 units": lambda c: c.neural["hidden_width"] == [5, 1, 128],
    "four hidden layers": lambda c: len(c.neural["hidden_width"]) == 4,
    "no waves": lambda c: c.neural["wave_octaves"] == 0,
    "two latents a row": lambda c: c.neural["num_features"] == 2,
    "eight octaves": lambda c: c.neural["wave_octaves"] == 8,
    "first_wave {}": lambda c, n: c.neural["first_wave"] == n,
    "the most inputs that there are": lambda c: c.neural["Widths"][0] == 4 * 64 + 6 * 8,
    "parameters of +-4094": lambda c: {LARGEST_HALF, LARGEST_HALF | 1 << 15} <= set(c.halves.tolist()),
    "saturated activations": lambda c: {("neural", 1 << 24), ("neural", -(1 << 24))} <= c.trace.clipped,
    "subnormal parameters": lambda c: bool(((c.halves >> 10 & 31 == 0) & (c.halves & 1023 > 0)).any()),
    "zeros of both signs": lambda c: {0, 1 << 15} <= set(c.halves.tolist()),
    "rounding to fixed point": rounded_halves,
    "parameters of any sign, exponent and fraction": lambda c:
        {*range(27)} <= set((c.halves >> 10 & 31).tolist()) and len(set((c.halves & 1023).tolist())) > 100,
    "all codes -8": lambda c: set(neural_codes(c).ravel().tolist()) == {-8},
    "a short codeword": lambda c: len(c.codewords) * 8 < neural_codes(c).size,
}
# What a scene looks like, and limits that a scene was built to lie on: nothing that can be looked up in the stream.
SCENES = ("a ribbon", "one inside the other", "areas and heights exactly on a limit", "one colour but for a few spots",
          "two values but for a few spots", "a sample that one rounding would move", "folds on both sides of every step",
          "area weights exactly at area_threshold and just below it", "floats a quarter beside their numbers",
          "greys in coarse blocks of eight children", "a grid coordinate just below a voxel",
          "corners that the grid sorts otherwise", "a sample beside the grid", "a triangle twice",
          "a face of three positions on a line", "normals near an axis")
CLAIMS = HEADER_AND_FIELDS | CODEWORDS | RAHT | FILTERS | TEXELS | PLANAR | CONSTANT | NEURAL | MATERIALS | NORMALS
CLAIMS |= dict.fromkeys(SCENES, lambda case: True)
# Clause -> what a vector that lists it has to hold, for the tools that a stream may do without.
CLAUSES = {
    "5.6.1": lambda c: c.grids,
    "5.6.2": lambda c: c.images,
    **dict.fromkeys(("6.1", "6.2", "6.3", "6.4"), lambda c: c.grids),
    **dict.fromkeys(("6.5", "6.5.1", "6.5.2", "6.5.4"), lambda c: c.images),
    "6.5.3": TEXELS["UVs beside the image"],
    "5.7.2": lambda c: c.each(lambda u: u["Depth"] > 0),
    "5.7.3": lambda c: any(c.stages),
    "5.7.4": lambda c: c.neural,
    "5.7.5": lambda c: c.neural,
    "5.7.6": lambda c: c.constant,
    "5.8": lambda c: c.stream.metadata is not None or other_metadata(c),
    "7.5.2": lambda c: c.each(lambda u: u["num_models"] == 0),
    "7.5.5": lambda c: c.each(lambda u: u["num_models"] > 0),
    "7.6.4": lambda c: c.each(lambda u: u["num_models"] > 0),
    "7.7": lambda c: has_stages(c),
    "7.8.1": lambda c: any(u["colour_transform"] == 0 for u in c.raht),
    "7.8.2": lambda c: any(u["colour_transform"] == 1 for u in c.raht),
    "7.9": lambda c: c.each(lambda u: u["residual"] > 0),
    "11.9": lambda c: c.neural["form"] == FORM_TRANSPORT,
} | PLANAR_CLAUSES | MATERIAL_CLAUSES | NORMALS_CLAUSES


def unkept(case):
    """Claims of a Case that its stream does not keep: one sentence each."""
    out = []
    for claim in case.claims:
        key, *arguments = in_full(claim)
        if key not in CLAIMS:
            out.append(f"nothing checks '{key}'")
        elif not CLAIMS[key](case, *arguments):
            out.append(f"'{title_of([claim])}' is not there")
    neural = [clause for clause in case.clauses if clause.startswith("11.") and not case.neural]
    return out + [f"nothing of clause {c} is there" for c in case.clauses if c in neural or c in CLAUSES and not CLAUSES[c](case)]
