"""The table of all cases, by name."""

from tools.proof.stability import entropy, fits, floats, lattice, looks, neural, surfaces, transform

CASES = {case.name: case for room in (lattice, surfaces, transform, entropy, fits, neural, looks, floats) for case in room.CASES}
GROUPS = tuple(dict.fromkeys(case.group for case in CASES.values()))
