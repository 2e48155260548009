"""The conformance vectors of the adaptive Wiener filter (clause 7.7), good and faulty.

The coefficients are drawn at random, so that every tap matters, and the residuals after them are coded for what they leave.
"""

import zlib
from unittest.mock import patch

import numpy as np

from conformance.make.faulty import with_element, with_units, with_values
from conformance.make.good import (
    encoded,
    exact_areas,
    noise_sheet,
    one_voxel,
    parsed,
    raht,
    recoded,
    split_by_material,
    two_sheets,
    values_of,
    with_codeword,
    written,
)
from texfcodec import decode
from texfcodec.bitstream.syntax import UNIT_ATTRIBUTE as A
from texfcodec.codecs.raht import attribute_coder
from texfcodec.codecs.raht.transform.filter import stage_of
from texfcodec.scene.scene import ALPHA_BLEND, Material, Scene, Texture

SLICES = {"WHOLE_VOXELS": 1, "SLICE_VOXELS": 300, "SLICE_NODES": 40}
FIVE_CLASSES = sum(1 << 3 * k for k in range(5))  # of component 0 of three


def every(components):
    """The mask of all classes of all components."""
    return (1 << 5 * components) - 1


def drawn(mask, components, seed, taps=None):
    """A FilterStage of the mask, its coefficients drawn from `taps`, by default from -40..40 without 0."""
    taps = [t for t in range(-40, 41) if t] if taps is None else taps
    return stage_of(mask, np.random.default_rng(seed).choice(taps, 3 * mask.bit_count()), components)


def filtered(data, stages, slices=None, **choices):
    """The stream coded anew with these filter stages, not fitted ones. stages: by number of components; choices: of raht."""
    left = {components: iter(of_group) for components, of_group in stages.items()}
    hold = (slices or {"SLICE_VOXELS": 1 << 18}) | {"fit_stage": lambda level, table, mean, *_: next(left[mean.shape[1]], None)}
    return recoded(data, slices=hold, filters=3, **choices)


def rising_noise(alpha=False):
    """A square whose texture goes from flat to noise: surroundings of every class of roughness."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    swing = np.linspace(0, 1, 48)[None, :, None] ** 2 * 110
    noise = 125 + swing * np.random.default_rng(17).uniform(-1, 1, (48, 48, 4))
    if not alpha:
        noise[..., 3] = 255
    positions = np.column_stack([corners, corners @ [0.3, 0.6]])
    material = Material("noise", texture=0, **({"alpha_mode": ALPHA_BLEND} if alpha else {}))
    return Scene(positions, faces, np.zeros(2, np.int64), corners[faces], None, [material], [Texture(noise.astype(np.uint8))])


def one_voxel_filtered():
    """K = 1 with three stages: the voxel has no neighbour, so that they change nothing."""
    def edit(stream):
        (unit,) = stream.attributes
        unit.update(num_filters=3, filters=[{"filter_mask": every(3), "filter_coefficients": [99] * 45}] * 3)

    return with_values(one_voxel(), edit)


def largest_filtered():
    """Random bytes for a codeword, means at their bounds and coefficients at both ends of their range."""
    stages = {3: [drawn(every(3), 3, 50 + n, taps=[-128, 127]) for n in range(3)]}
    sheet = filtered(encoded(noise_sheet(), resolution=24, qp=40), stages, models=8)
    return with_codeword(sheet, np.random.default_rng(51).bytes(6000), [40, 50, 40])


def second_field_filtered():
    """Two fields, of which the second is filtered."""
    data = split_by_material(encoded(two_sheets(), resolution=21, qp=30))
    stream, keys = parsed(data), decode(data).fields[1].keys
    unit, stage = stream.attributes[1], drawn(every(3), 3, 60)
    with patch.object(attribute_coder, "fit_stage", lambda *_: stage):
        unit.update(raht(values_of(unit, keys), keys, 21, unit["qp"], filters=1))
    return written(stream)


def uncommon():
    """What the encoder's fit seldom or never makes of the small scenes of scenes.py."""
    sheet, both = encoded(rising_noise(), resolution=32, qp=22), encoded(rising_noise(alpha=True), resolution=32, qp=22)
    three = [drawn(mask, 3, 20 + n) for n, mask in enumerate((0o77777, 0o25252, 0o71346))]
    hollow = [drawn(every(3), 3, 30), stage_of(0, [], 3), drawn(every(3), 3, 31)]
    alpha = [drawn(every(1), 1, 40 + n) for n in range(3)]
    slices = {"slices": SLICES, "models": 6}
    return [
        ("all_tools", [("{} models", 8), "colour range", "components that follow", ("{} filter stages", 2)],
         ("5.7.3", "7.3", "7.4.4", "7.5.5", "7.6.4", "7.7"),
         filtered(encoded(noise_sheet(), resolution=40, qp=34), {3: three[:2]}, models=8, colour_range=3, component_cross=10),
         (0, 1)),
        ("filter_fitted_slices", ["a filter", "slices"], ("5.7.3", "7.2", "7.7"),
         recoded(encoded(noise_sheet(), resolution=40, qp=34), slices=SLICES, models=8, colour_range=3, filters=3), (0, 1)),
        ("filter_classes", ["a filter stage of every class and component"], ("5.7.3", "7.7"),
         filtered(sheet, {3: [drawn(every(3), 3, 10)]}, models=6), (0, 1)),
        ("filter_slices", ["a filter stage of every class and component", "slices with the level index"], ("5.7.3", "7.2", "7.7"),
         filtered(sheet, {3: [drawn(every(3), 3, 11)]}, index=True, **slices), (0, 1)),
        ("filter_three_stages", [("{} filter stages", 3)], ("5.7.3", "7.7"), filtered(sheet, {3: three}, models=6), (0, 1)),
        ("filter_three_stages_slices", [("{} filter stages", 3), "slices of colour and alpha"], ("5.7.3", "7.2", "7.7"),
         filtered(both, {3: three, 1: alpha}, colour_range=5, **slices), (0, 2)),
        ("filter_alpha", ["a filter of alpha alone"], ("5.7.3", "7.7"), filtered(both, {3: [], 1: alpha[:1]}, **slices), (0, 1)),
        ("filter_colour", ["a filter of colour alone", "beside alpha"], ("5.7.3", "7.7"),
         filtered(both, {3: three[:1], 1: []}), (0,)),
        ("filter_first_component", [("a filter of component {} alone", 0)], ("5.7.3", "7.7"),
         filtered(sheet, {3: [drawn(FIVE_CLASSES, 3, 12)]}), (0,)),
        ("filter_last_component", [("a filter of component {} alone", 2), "no transform"], ("5.7.3", "7.7", "7.8.1"),
         filtered(sheet, {3: [drawn(FIVE_CLASSES << 2, 3, 13)]}, plain=True), (0,)),
        ("filter_empty_stage", [("{} filter stages", 3), "the second without a bit in its mask"], ("5.7.3", "7.7"),
         filtered(sheet, {3: hollow}), (0,)),
        ("filter_lossless_slices", ["lossless after three filter stages", "slices of colour and alpha"], ("5.7.3", "7.7", "7.9"),
         filtered(both, {3: three, 1: alpha}, max_error=0, **slices), (0, 1)),
        ("filter_near_lossless", [("errors of at most {} after a filter stage", 3)], ("7.7", "7.9"),
         filtered(sheet, {3: three[:1]}, max_error=3), (0, 1)),
        ("filter_largest", [("{} filter stages", 3), "coefficients of -128 and 127", "means at their bounds"], ("5.7.3", "7.7"),
         largest_filtered(), (0, 1)),
        ("filter_two_fields", ["two fields", "a filter of the second alone"], ("5.7.3", "7.7"), second_field_filtered(), (0, 1)),
        ("filter_lonely_voxels", ["a filter", "voxels without a neighbour"], ("7.7",),
         filtered(exact_areas(), {3: [drawn(every(3), 3, 14)]}), (0,)),
        ("filter_one_voxel", [("K = {}", 1), "three filter stages that have nothing to do"], ("5.7.3",), one_voxel_filtered(),
         (0, 1)),
    ]


# Faulty ones. Their values_crc is what a decoder without the check would get, so that only the check can refuse them.


def out_of_range(data, element, raw, **believed):
    """The stream with raw bytes for an element, and the values_crc that goes with what a decoder would believe the unit to be."""
    stream = parsed(data)
    (unit,) = stream.attributes
    values = values_of(unit | believed, decode(data).fields[0].keys)
    return with_element(with_element(data, A, "values_crc", zlib.crc32(values).to_bytes(4, "little")), A, element, raw)


def stage_bytes(stage):
    """A stage (values by name) as it stands in a stream."""
    return stage["filter_mask"].to_bytes(2, "little") + np.array(stage["filter_coefficients"], np.int8).tobytes()


def faulty():
    """Clauses 5.7.1 and 5.7.3, and the checksum after clause 7.7."""
    sheet = encoded(rising_noise(), resolution=12, qp=22)
    single, two = (filtered(sheet, {3: [drawn(every(3), 3, 70 + n) for n in range(count)]}) for count in (1, 2))
    three, bounded = filtered(sheet, {3: [drawn(every(3), 3, 70)] * 3}), recoded(sheet, models=6, max_error=0)
    (stage,), first = parsed(single).attributes[0]["filters"], parsed(three).attributes[0]["filters"][0]
    known = {"filter_mask": 0x7FFE, "filter_coefficients": stage["filter_coefficients"][:42]}
    cross = [0, 0, 17]
    cut = lambda units: units.__setitem__(-2, (A, units[-2][1][:40]))
    swap = lambda stream: stream.attributes[0]["filters"].reverse()
    none = lambda stream: stream.attributes[0].update(num_filters=0, filters=[])
    tap = lambda stream: stream.attributes[0]["filters"][0]["filter_coefficients"].__setitem__(0, 99)
    return [
        ("filter_four_stages", "four filter stages, all of them there", "5.7.1",
         out_of_range(three, "num_filters", b"\4" + stage_bytes(first), filters=[first] * 4), "TXF-S04"),
        ("filter_mask_bit_15", "a filter_mask bit beyond the classes, with its coefficients", "5.7.3",
         out_of_range(single, "filters[0].filter_mask", b"\xfe\xff", filters=[known]), "TXF-S04"),
        ("filter_cut", "the unit ends in filter_coefficients", "5.7.3", with_units(single, cut), "TXF-S02"),
        ("filter_coefficient", "another filter coefficient", "7.7", with_values(single, tap), "TXF-S32"),
        ("filter_left_out", "a filter stage is left out", "7.7", with_values(single, none), "TXF-S32"),
        ("filter_stage_order", "two filter stages change places", "7.7", with_values(two, swap), "TXF-S32"),
        ("residual_cross_17", "residual_cross 17", "5.7.1",
         out_of_range(bounded, "residual_cross", bytes(cross), residual_cross=cross), "TXF-S04"),
    ]
