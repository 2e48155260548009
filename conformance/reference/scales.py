"""The scales of clause 7 in plain Python: steps (7.4.2), falloff (7.3), classes (7.5.1, 7.5.5)."""

STEP_TABLE = (2580, 2896, 3251, 3649, 4096, 4598)
FALLOFF_TABLE = (
    64, 64, 63, 62, 60, 58, 56, 53, 50, 47, 43, 40, 36, 33, 30, 27, 24, 21, 18, 16, 13, 11, 10, 8, 7, 6, 5, 4, 3, 2, 2,
)  # fmt: skip
FINE = (1, 2, 4, 6, 8, 12, 16, 24, 36, 56, 96)
CLASS_ENDS = (0, 1, 3, 6, 12, 28)


def step(qp):
    """Clause 7.4.2."""
    return STEP_TABLE[qp % 6] << (qp // 6)


def falloff(mean, centre, colour_range, luma_step):
    """Clause 7.3: the weight, 64 at most, of a node with these means beside a block with the means `centre`."""
    if colour_range == 0:
        return 64
    inverse = 2**32 // (colour_range * luma_step)
    difference = sum(abs(a - b) for a, b in zip(mean, centre, strict=True))
    return FALLOFF_TABLE[min(30, (difference * inverse) >> 28)]


def energy_class(e):
    """Class of clause 7.5.1."""
    for number, last in enumerate(CLASS_ENDS):
        if e <= last:
            return number
    return 6


def surrounding_classes(near, near_weight, far, far_weight):
    """nearClass and farClass of clause 7.5.1."""
    near_class = energy_class((near + near_weight - 1) // near_weight) if near_weight > 0 else 0
    return near_class, energy_class((far + far_weight - 1) // far_weight)


def sign_of(a):
    """Sign of clause 7.9; 7.5.5, 7.11.2 and 7.11.4 tell signs apart by the same numbers."""
    return 0 if a == 0 else 1 if a > 0 else 2


def half(w):
    """Half of clause 7.5.5."""
    return max(w.bit_length() - 1, 0) // 2


def sixteenths(v, step_of_component):
    """Clause 7.4.2."""
    return (abs(v) * (2**32 // step_of_component)) >> 28


def entries_reached(entries, v):
    """Number of entries that are at most v (7.5.5, 7.7)."""
    return sum(entry <= v for entry in entries)


def fine(v):
    """Fine of clause 7.5.5."""
    return entries_reached(FINE, v)
