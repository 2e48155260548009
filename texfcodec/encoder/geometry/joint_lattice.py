"""Lattice positions that are chosen together: what rounding does to one vertex, its neighbours make good (encoder only).

Among whole positions k, (x(k) - x*)' A (x(k) - x*) is made least by descent: one coordinate after the other goes to the whole
number that is best while all others stay, until none moves. It starts from the nearest lattice points and can only get better.
"""

from __future__ import annotations

import numpy as np

from ...core.kernel import kernel
from ...geometry.canonical import CanonicalCube
from .vertex_fit import VertexFit

REACH = 2  # steps that a coordinate may be away from the nearest
MOST_ROUNDS = 200


def joint_lattice(fit: VertexFit, cube: CanonicalCube, reach: int = REACH) -> np.ndarray:
    """Lattice positions of the fit's vertices, int64 [V, 3] in 0..2**B - 1."""
    start = cube.to_lattice(fit.positions)
    if cube.side == 0 or not len(start):
        return start
    out, step = start.copy(), cube.side / cube.last
    off = start - (fit.positions - np.asarray(cube.origin)) / step  # in steps of the lattice
    pull = fit.matrix @ off
    _descend(fit.matrix.first, fit.matrix.column, fit.matrix.block, start, reach, cube.last, out, pull, MOST_ROUNDS)
    return out


@kernel(allocates=False)
def _descend(first, column, block, start, reach, last, out, pull, rounds):
    """Moves out. pull: float64 [V, 3], A times the error of out, which is kept."""
    for _ in range(rounds):
        moved = 0
        for v in range(out.shape[0]):
            own = first[v]
            while column[own] != v:
                own += 1
            for k in range(3):
                stiff = block[own, k, k]
                if not stiff > 0.0:
                    continue
                low = max(start[v, k] - reach, 0)
                high = min(start[v, k] + reach, last)
                to = min(max(out[v, k] + np.int64(np.rint(-pull[v, k] / stiff)), low), high)
                step = to - out[v, k]
                # by how much the form changes; a tie stays
                if step == 0 or not 2.0 * step * pull[v, k] + step * step * stiff < -1e-9 * stiff:
                    continue
                out[v, k] = to
                moved += 1
                for i in range(first[v], first[v + 1]):
                    for l in range(3):
                        pull[column[i], l] += step * block[i, k, l]
        if moved == 0:
            break
