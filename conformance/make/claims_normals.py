"""What good conformance vectors claim of shading normals (8.4); claims.py has them all."""

import numpy as np

from texfcodec.codecs.coded_normals import dec_residuals
from texfcodec.geometry.edges import BACK, MANY, coded_edges, weld


def rules_of(case):
    """(normal_rule, normal_angle) of every material that has them."""
    return [(m["normal_rule"], m["normal_angle"]) for m in case.stream.materials if m["normal_rule"] is not None]


def has_marks(case):
    """Some edges are sharp and some are not."""
    return case.texf.sharp_edges is not None and 0 < case.texf.sharp_edges.sum() < len(case.texf.sharp_edges)


def folds_of(case):
    """Classes of the edges that are marked."""
    texf = case.texf
    marked = np.array([m.normals.has_marks for m in texf.materials])[texf.face_material]
    return set(coded_edges(texf.lattice_positions, texf.faces, marked)[1].tolist())


def has_coded(case):
    """Some groups have a normal that is not their base."""
    texf = case.texf
    return texf.coded_normals is not None and bool((texf.coded_normals != texf.corner_groups().frame[:, 2]).any())


def residual_sizes(case):
    """Bits of the magnitudes of the residuals."""
    residuals = dec_residuals(case.stream.coded_normals["residual_data"], case.texf.corner_groups())
    return [int(value).bit_length() for value in np.abs(residuals).ravel()]


def corners_of(case):
    """Welded corners of all faces, int64 [F, 3]."""
    return weld(case.texf.lattice_positions)[case.texf.faces]


def most_faces(case):
    """Number of faces on the edge that has most of them."""
    corners = corners_of(case)
    sides = np.sort(np.concatenate([corners[:, [i, i - 1]] for i in range(3)]), axis=1)
    return int(np.unique(sides, axis=0, return_counts=True)[1].max())


# Claim -> predicate of the Case of claims.py and the arguments.
NORMALS = {
    "all weights of rules": lambda c: {rule // 3 for rule, _ in rules_of(c)} == {0}
        and {rule % 3 for rule, _ in rules_of(c)} == {0, 1, 2} and {0, 180} <= {angle for _, angle in rules_of(c)},
    "an unlit material without a rule": lambda c: len(rules_of(c)) < len(c.stream.materials),
    "marks of sharp edges": has_marks,
    "faces with two corners at one position": lambda c: any(len({*corners}) == 2 for corners in corners_of(c).tolist()),
    "many classes of folds": lambda c: len(folds_of(c)) >= 10 and (BACK in folds_of(c) or MANY in folds_of(c)),
    "an edge of nine faces": lambda c: most_faces(c) == 9,
    "marks at one of the materials": lambda c: has_marks(c) and sum(rule >= 3 for rule, _ in rules_of(c)) == 1,
    "coded normals": has_coded,
    "coded normals at one of the materials": lambda c: has_coded(c) and sum(rule == 6 for rule, _ in rules_of(c)) == 1,
    "residuals of all sizes": lambda c: set(residual_sizes(c)) >= set(range(14)),
    "a codeword of noise": has_coded,
    "normals that vanish in their sum": lambda c: has_coded(c)
        and (c.texf.corner_groups().frame[:, 2] == [0, 0, 1 << 14]).all(1).any(),
    "faces at one place": lambda c: len(np.unique(np.sort(corners_of(c), axis=1), axis=0)) < len(c.texf.faces),
    "edges of more than two faces": lambda c: most_faces(c) > 2,
    "every edge sharp": lambda c: c.texf.sharp_edges is not None and bool(c.texf.sharp_edges.all()),
}
# Clause -> what a vector that lists it has to hold.
NORMALS_CLAUSES = {
    "5.10": lambda c: c.stream.sharp_edges is not None,
    "8.4.2": lambda c: c.stream.sharp_edges is not None,
    **dict.fromkeys(("5.11", "8.4.3", "8.4.4"), has_coded),
}
