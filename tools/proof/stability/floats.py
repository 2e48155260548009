"""Cases of the encoder's floats: how near to a tie they decide, and that the stream is a sound one on either side."""

from dataclasses import replace
from decimal import Decimal, localcontext

import numpy as np
from shapes import mapped_sheet, noise, painted_sphere

from oracles import kernels as oracles
from texfcodec.api import decode
from texfcodec.codecs.raht.transform.quantise import step_of
from texfcodec.codecs.raht.transform.raht import _forward, _tree_weights
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.options import EncodeOptions
from texfcodec.scene.scene import Scene
from tools.proof.stability.case import Case, Draws
from tools.proof.stability.lattice import PLAIN
from tools.proof.stability.transform import DROPPED, STEPS, UNIT, amplified, decoded, divided, hard_keys

GROUP = "Floats of the encoder"
DIGITS = 50


def scaled_block(draw: Draws) -> tuple[np.ndarray, dict, int, int]:
    """(Coefficients in steps from the encoder's floats, the exact ones by node, the step, the largest residual) of a block."""
    weights, step = divided(draw, draw.integer(2, 4000)), step_of(draw.integer(0, 63))
    residual = {o: draw.integer(-255 * UNIT, 255 * UNIT) for o in weights}
    tree, scaled, given = np.zeros(15, np.int64), np.zeros((7, 1)), np.zeros((8, 1))
    _tree_weights(0, np.int64(sum(1 << o for o in weights)), np.array([weights[o] for o in sorted(weights)], np.int64), tree)
    for octant, value in residual.items():
        given[octant] = value
    _forward(tree, given, 0, np.zeros(15), scaled, float(step))
    exact = {}
    with localcontext() as context:
        context.prec = DIGITS
        for node, (sign, square) in oracles.forward(weights, residual).items():
            exact[node] = sign * (Decimal(square.numerator) / Decimal(square.denominator)).sqrt() / step
    largest = max(map(abs, residual.values()))
    gains = {n: np.sqrt(float(tree[2 * n + 1]) * tree[2 * n + 2] / tree[n]) for n in exact}
    return scaled[:, 0], {n: (value, gains[n] * largest / step) for n, value in exact.items()}, step, largest


def quantiser_input(draw: Draws) -> float:
    """Error of a coefficient before it is rounded, in 2^-53 of the largest residual in its scale."""
    scaled, exact, _, largest = scaled_block(draw)
    if not largest or not exact:
        return 0.0
    return max(float(abs(Decimal(float(scaled[n])) - value)) / (scale * 2.0**-53) for n, (value, scale) in exact.items())


def fields_of_ties(draw: Draws) -> float:
    """The error in steps of fields whose coefficients lie on ties or one unit of 1/4096 level beside them."""
    keys, depth = hard_keys(draw)
    qp = 4 + 6 * draw.integer(0, 4)  # whole steps
    step, rng = step_of(qp), draw.generator()
    values = rng.integers(0, 255 * UNIT * 2 // step + 1, (len(keys), 1)) * (step // 2) + rng.integers(-1, 2, (len(keys), 1))
    values = np.clip(values, 0, 255 * UNIT).astype(np.int32)
    got, (moved, rounding) = decoded(keys, depth, values, [qp], draw.pick((0, 6))), amplified(keys, depth)
    left = np.maximum(np.abs(got - values)[:, 0] - rounding, 0)
    return float((left / np.maximum(moved * step, 1e-9)).max()) if moved.any() else float(left.max())


def scene_on_ties(draw: Draws) -> tuple[Scene, int]:
    """(A scene whose positions lie in the middle between lattice positions, the lattice's bits)."""
    bits = draw.integer(8, 12)
    scene = painted_sphere(4, seed=draw.integer(0, 9)) if draw.pick((True, False)) else \
        mapped_sheet({"roughness": noise(1, 8, 8)}, noise(2, 8, 8), cells=2)
    last, low, high = (1 << bits) - 1, scene.positions.min(axis=0), scene.positions.max(axis=0)
    unit = (scene.positions - low) / (high - low).max()
    inner = (unit > 0.1) & (unit < 0.9)
    return replace(scene, positions=np.where(inner, (np.floor(unit * last) + 0.5) / last, np.round(unit))), bits


def nudged(scene: Scene, way: float) -> Scene:
    """A scene of which every position, UV and colour is the next number up or down; those at 0 and 1 stay, with the cube."""
    move = lambda a: None if a is None else np.where((a == 0) | (a == 1), a, np.nextafter(a, a.dtype.type(way)))
    return replace(scene, positions=move(scene.positions), corner_uv=move(scene.corner_uv), corner_color=move(scene.corner_color))


def either_side(draw: Draws) -> float:
    """Lattice steps between what is decoded of a scene on ties and of the same an ulp up and down; infinite where a stream is not
    sound or another number of faces comes back."""
    scene, bits = scene_on_ties(draw)
    support = draw.pick(("voxels", "texels")) if scene.textures else "voxels"
    options = EncodeOptions(**PLAIN | {"qp": draw.integer(4, 50)}, position_bits=bits, support=support)
    made = [decode(encode_scene(one, options).data) for one in (scene, nudged(scene, np.inf), nudged(scene, -np.inf))]
    if len({len(texf.faces) for texf in made}) > 1:
        return np.inf
    corners = [np.sort(texf.lattice_positions[texf.faces].reshape(-1, 3), axis=0) for texf in made]
    return float(max(np.abs(other - corners[0]).max() for other in corners[1:]))


CASES = (
    Case("input of the quantiser", GROUP,
         "coefficients of any block before rounding, against 50 digits",
         20, "times 2^-53 of the residual",
         "Two means of means and a difference are at most 12 roundings of numbers no larger than the largest residual, square "
         "root, product and quotient 8 more. So a tie is decided otherwise than exactly only within 2^-48 or so of it, and no "
         "other machine decides: the coefficient is sent.",
         quantiser_input, 40),
    Case("fields on ties", GROUP,
         "values in half steps and one unit beside, whole steps, direct and mixed contexts",
         DROPPED, STEPS,
         "On a tie both neighbours are half a step away; the decoder has what was sent, and the encoder predicts from that.",
         fields_of_ties, 8),
    Case("scenes on ties", GROUP,
         "positions in the middle between lattice positions, and all positions, UVs and colours an ulp up or down; voxels, "
         "texels and a map",
         1, "lattice steps",
         "A float that decides otherwise moves a position by one step, never two. Everything behind is made from the decoded "
         "lattice, UVs and values (6, 7), so each of the three streams is sound: its checksums of geometry, keys and values are "
         "tested.",
         either_side, 2),
)
