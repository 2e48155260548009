"""What good conformance vectors claim of planar supports (7.11) and of components that follow (7.4.4);
claims.py has them all."""

import numpy as np

from conformance.make.good import values_of

BOUND = 512  # of a factor of clause 7.4.4
LARGEST_COEFFICIENT = 1 << 25  # of clause 7.11.4


def is_planar(case):
    """There are RAHT units, each of a field over texels, and there is no other field."""
    return bool(case.images) and not case.grids and case.each(lambda unit: unit["Planar"] == 1)


def heard(case, **off):
    """Every RAHT unit, of several components where component_cross is off, has other values with these elements instead."""
    units = [u for u in case.raht if u["NumComponents"] > 1 or "component_cross" not in off]
    values = lambda unit: values_of(unit, case.texf.fields[unit["field_index"]].keys).tobytes()
    return bool(units) and all(values(unit | off) != values(unit) for unit in units)


def squares(case):
    """Whether nodes three levels above the texels have all their texels, as a set."""
    keys = [np.unique(case.texf.fields[unit["field_index"]].keys >> 9, return_counts=True)[1] for unit in case.raht]
    return {bool(full) for counts in keys for full in counts == 64}


def components(case):
    """Numbers of components of the RAHT units."""
    return {unit["NumComponents"] for unit in case.raht}


def has_five_taps(case, count):
    """Every unit has so many filter stages, of five taps for each bit, and there is no tap that changes nothing."""
    five = lambda stage: len(stage["filter_coefficients"]) == 5 * stage["filter_mask"].bit_count() > 0
    stages = case.each(lambda unit: len(unit["filters"]) == count and all(map(five, unit["filters"])))
    return is_planar(case) and stages and not any(silent for of_unit in case.silent for silent in of_unit)


# Claim -> predicate of the Case of claims.py and the arguments.
PLANAR = {
    "a planar support": is_planar,
    "no rotated splits": lambda c: is_planar(c) and c.each(lambda u: u["planar_transform"] == 0),
    "rotated splits": lambda c: c.each(lambda u: u["planar_transform"] == 1) and heard(c, planar_transform=0),
    "no components that follow": lambda c: is_planar(c) and c.each(lambda u: not u["component_cross"]),
    "components that follow": lambda c: heard(c, component_cross=0),
    "DCT blocks": lambda c: heard(c, dct_blocks=0),
    "DCT blocks beside others": lambda c: heard(c, dct_blocks=0) and squares(c) == {False, True},
    "DCT blocks of one component and of three": lambda c: heard(c, dct_blocks=0) and components(c) == {1, 3},
    "DCT blocks above the slices": lambda c: heard(c, dct_blocks=0) and c.each(lambda u: u["slice_level"] > u["Depth"] - 3),
    "DCT blocks of {} coefficients": lambda c, n: n in c.trace.counts,
    "coefficients at their bounds": lambda c: {("dct", -LARGEST_COEFFICIENT), ("dct", LARGEST_COEFFICIENT)} <= c.trace.clipped,
    "component_cross {}": lambda c, n: c.each(lambda u: u["component_cross"] == n) and heard(c, component_cross=0),
    "two filter stages of five taps": lambda c: has_five_taps(c, 2),
    "factors at their bounds": lambda c: {("following", -BOUND), ("following", BOUND)} <= c.trace.clipped,
}
# Clause -> what a vector that lists it has to hold.
PLANAR_CLAUSES = {
    "7.11": is_planar,
    "7.11.1": lambda c: heard(c, planar_transform=0),
    "7.4.4": lambda c: heard(c, component_cross=0),
    "7.11.2": lambda c: is_planar(c) and c.each(lambda u: u["num_models"] == 8),  # fewer lack some of the models that change
    "7.11.4": lambda c: heard(c, dct_blocks=0),
    "7.11.3": lambda c: is_planar(c) and heard(c, filters=[]),
}
