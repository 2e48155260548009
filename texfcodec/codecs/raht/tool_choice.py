"""The encoder's choice of tools: those of an effort, the prediction that suits a field, and the QPs beneath residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...core.threads import in_order
from .attribute_coder import CodedAttributes, Tools, enc_attributes, octree_of
from .coefficients.dct_blocks import jpeg_likeness
from .coefficients.residual import ResidualPlan
from .transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from .transform.octree import Octree
from .transform.prediction import KERNELS
from .transform.quantise import step_of

if TYPE_CHECKING:
    from ...field.texels import TexelSupport
    from ...field.voxels import VoxelSupport
    from .raht_options import RahtOptions

EFFORTS = {"fast": Tools(component_cross=16), "balanced": Tools(colour_range=5, models=8, filters=1, component_cross=16)}
# Kernel and colour range, from natural textures to flat colours; fast has no time for colour ranges
PREDICTIONS = {"fast": ((KERNELS[1], 0), (KERNELS[3], 0)),
               "balanced": ((KERNELS[1], 10), (KERNELS[1], 5), (KERNELS[2], 5), (KERNELS[3], 3))}
PLANAR_TOOLS: dict[str, Any] = {"planar": 1, "planar_transform": 1, "trade_off": 0.08}
FOLLOW_LESS: dict[str, Any] = {"component_cross": 10}
PLAIN_TRANSFORM: dict[str, Any] = {"planar_transform": 0}
DCT_BLOCKS: dict[str, Any] = {"dct_blocks": 1}
MOST_UNLIKE_JPEG = 0.15  # of jpeg_likeness: where it is more, DCT blocks are not tried
# By whether the support is planar, log2 of the trade-off, more of which saves as many bytes as a QP, at the same PSNR: 0.6 to 1.0
# and 0.8 to 1.2 from QP 10 to 38, two assets each. Small images at fine QPs need 2, and keep a gap before the next QP.
FRACTIONS = {False: 1.0, True: 0.8}
CHROMA_OFFSETS = {False: -1, True: 2}  # by whether the support is planar
BASE_QPS = (16, 22, 28, 34, 40)  # of the levels under residuals (7.9)
DCT_BASE_QPS = (0, 4, 8, 12, 16)  # where there are DCT blocks, which say nearly all of a texture that was JPEG
USUAL_BASE_QP = 28  # within 1 % of the best of them on four assets at K 512, lossless
PIECES = 4
LEAST_VOXELS = 64  # below, nothing is tried
PIECE_VOXELS = {"fast": 1 << 11, "balanced": 1 << 13}  # per piece; 1 << 12 is 0.4 % worse, 3 % faster
LEAST_PIECE, PIECE_SHARE = 1 << 11, 8  # voxels per piece of a small field, and the part of it that a piece is


def tools_of(effort: str, planar: bool) -> Tools:
    """Return the Tools of an effort before any trial. effort: a key of EFFORTS; planar: whether the cells are texels."""
    return replace(EFFORTS[effort], **PLANAR_TOOLS) if planar else EFFORTS[effort]


class _Piece(NamedTuple):
    """Voxels that stand for a field. at: slice of the field's; octree: over them alone, from the smallest cell that holds all."""

    at: slice
    octree: Octree

    @property
    def depth(self):
        """Levels of the octree."""
        return len(self.octree.levels) - 1


def _pieces(keys, depth, effort, planar):
    """Return _Pieces of consecutive voxels in Morton order, spread evenly; the whole field if it is small."""
    count = len(keys)
    voxels = min(PIECE_VOXELS[effort], max(LEAST_PIECE, count // PIECE_SHARE))
    if count <= PIECES * voxels:
        return [_Piece(slice(0, count), Octree(keys, depth, planar))]
    return [_piece(keys, slice(begin, begin + voxels), planar) for begin in np.linspace(0, count - voxels, PIECES).astype(int)]


def _piece(keys, at, planar):
    """Return the _Piece of a slice. Levels above its cell would hold a node each."""
    own = keys[at]
    depth = -(-(int(own[0]) ^ int(own[-1])).bit_length() // 3)
    return _Piece(at, Octree(own & (1 << 3 * depth) - 1, depth, planar))


def _lagrangian_cost(values, qp, tools, piece):
    """Bits plus squared error in steps, weighted as in the quantiser. values: of the piece."""
    coded, means = enc_attributes(piece.octree.keys, piece.depth, values, qp, tools, octree=piece.octree)
    error = (means.astype(np.float64) - values) / [step_of(v) for v in qp]
    return 8 * sum(len(c) for c in coded.codewords) + (error**2).sum() / tools.trade_off


def _may_have_dct_blocks(keys, values, effort, planar):
    return bool(planar and EFFORTS[effort].models) and jpeg_likeness(keys, values[:, 0]) < MOST_UNLIKE_JPEG


def choose_tools(keys: np.ndarray, depth: int, values: np.ndarray, qp: Sequence[int], effort: str, threads: int = 1,
                 planar: bool = False, dct_blocks: int | None = None, is_rough: bool = False) -> Tools:
    """Choose the coding Tools for values by trial. Candidates of PREDICTIONS code a few pieces of the field, and the cheapest
    wins. Then FOLLOW_LESS, PLAIN_TRANSFORM over texels, and DCT_BLOCKS for values that look like JPEG are each adopted if they
    reduce the cost.

    keys: int64 [N], ascending Morton keys of `depth` levels; values: int32 [N, C], 12 fractional bits; qp: [C]; effort: a key of
    EFFORTS; dct_blocks: 0 or 1 if that is decided already; is_rough: take the first candidate without a trial, but still try
    DCT_BLOCKS.
    """
    tools = replace(tools_of(effort, planar), dct_blocks=dct_blocks or 0)
    if len(keys) < LEAST_VOXELS:
        return tools
    candidates = [replace(tools, kernel=kernel, colour_range=reach, filters=0)
                  for kernel, reach in PREDICTIONS[effort][: 1 if is_rough else None]]
    changes = [] if is_rough else [FOLLOW_LESS] * (values.shape[1] > 1) + [PLAIN_TRANSFORM] * planar
    if dct_blocks is None and _may_have_dct_blocks(keys, values, effort, planar):
        changes.append(DCT_BLOCKS)
    if len(candidates) == 1 and not changes:
        return replace(candidates[0], filters=tools.filters)
    pieces = _pieces(keys, depth, effort, tools.planar)
    if is_rough:
        pieces = pieces[len(pieces) // 2 :][:1]

    @cache
    def cost_of(tools):
        return sum(in_order(lambda piece: _lagrangian_cost(values[piece.at], qp, tools, piece), pieces, threads))

    is_flat = cost_of(candidates[-1]) < cost_of(candidates[0])
    best = min(candidates, key=cost_of) if is_flat else _descend(candidates, cost_of)
    least = cost_of(best)
    for change in changes:
        changed = replace(best, **change)
        cost = cost_of(changed)
        if cost < least:
            best, least = changed, cost
    return replace(best, filters=tools.filters)


def _descend(candidates, cost_of):
    """Return the last candidate before cost rises."""
    best = candidates[0]
    for candidate in candidates[1:]:
        if cost_of(candidate) >= cost_of(best):
            break
        best = candidate
    return best


def choose_base(keys: np.ndarray, depth: int, values: np.ndarray, qp_of: Callable[[int], list[int]], plan: ResidualPlan,
                effort: str, threads: int = 1, planar: bool = False) -> tuple[list[int], int]:
    """Choose how coarsely the transform codes values whose residuals follow: (QPs [C], 0 or 1 for DCT blocks). Candidates code a
    few pieces of the field; the fewest bytes, residuals included, win. qp_of: function from a QP to the components' QPs; plan:
    ResidualPlan; the rest as in choose_tools."""
    if effort == "fast" or len(keys) < LEAST_VOXELS:
        return qp_of(USUAL_BASE_QP), 0
    tools = tools_of(effort, planar)
    pieces = _pieces(keys, depth, effort, tools.planar)

    def size(candidate):
        qp, dct_blocks = candidate
        own = replace(tools, dct_blocks=dct_blocks)

        def of_piece(piece):
            there = replace(plan, original=plan.original[piece.at])
            octree = piece.octree
            coded = enc_attributes(octree.keys, piece.depth, values[piece.at], qp_of(qp), own, plan=there, octree=octree)[0]
            return sum(map(len, coded.codewords))

        return sum(in_order(of_piece, pieces, threads))

    candidates = [(qp, 0) for qp in BASE_QPS]
    if _may_have_dct_blocks(keys, values, effort, planar):
        candidates += [(qp, 1) for qp in DCT_BASE_QPS]
    qp, dct_blocks = min(candidates, key=size)
    return qp_of(qp), dct_blocks


def code_plane(plane: np.ndarray, support: VoxelSupport | TexelSupport, colour: bool,
               options: RahtOptions) -> tuple[CodedAttributes, np.ndarray]:
    """Codes a plane with the tools that options.effort permits: (CodedAttributes, decoded values uint8 [N, C]).

    plane: float32 [N, C] in 0..255 on the keys of support; colour: whether its components are red, green, blue. options.max_error
    bounds the error of every rounded value.
    """
    if options.max_error is not None:
        return _code_bounded(plane, support, colour, options)
    values = forward_colour(plane) if colour else forward_plain(np.rint(plane))
    qp = _qp_of(options.qp, plane.shape[1], support, options)
    tools = choose_tools(support.keys, support.depth, values, qp, options.effort, options.threads, support.planar,
                         is_rough=options.is_rough)
    tools = replace(tools, trade_off=tools.trade_off * 2 ** (FRACTIONS[support.planar] * options.qp_fraction))
    coded, means = enc_attributes(support.keys, support.depth, values, qp, tools, options.threads, octree=octree_of(support))
    return coded, inverse_colour(means) if colour else inverse_plain(means)


def _code_bounded(plane, support, colour, options):
    original = np.clip(np.rint(plane), 0, 255).astype(np.uint8)
    values = forward_colour(original) if colour else forward_plain(original)
    plan = ResidualPlan(options.max_error, original, inverse_colour if colour else inverse_plain)
    field = support.keys, support.depth, values
    qp, dct_blocks = choose_base(*field, lambda qp: _qp_of(qp, plane.shape[1], support, options), plan, options.effort,
                                 options.threads, support.planar)
    tools = choose_tools(*field, qp, options.effort, options.threads, support.planar, dct_blocks, options.is_rough)
    return enc_attributes(*field, qp, tools, options.threads, plan, octree_of(support))


def _qp_of(qp, components, support, options):
    offset = CHROMA_OFFSETS[support.planar] if options.chroma_qp_offset is None else options.chroma_qp_offset
    return [min(max(qp + (offset if c else 0), 0), 63) for c in range(components)]
