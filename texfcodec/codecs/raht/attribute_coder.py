"""The RAHT attribute codec (codec_id 0, spec clause 7): values on active voxels <-> codewords.

Levels are coded from the root down, so every prefix of levels is a coarser field. Levels above slice_level form the trunk, one
codeword; below it the nodes are split into slices in Morton order, each with a codeword and a copy of the trunk's contexts.
Slices run in parallel level by level: a block predicts from the whole level above, but on its own level only from its slice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from ...errors import StreamError
from .coefficients.blocks import Blocks, Rules, Wanted, new_scratch
from .coefficients.dct_blocks import UP, _dec_dct_level, _enc_dct_level, dct_blocks, new_dct_model, no_dct_blocks
from .coefficients.direct import _dec_direct_level, _enc_direct_level
from .coefficients.mixed import _dec_mixed_level, _enc_mixed_level
from .coefficients.mixed_contexts import new_mixed_model
from .coefficients.planar import new_kept
from .coefficients.residual import ResidualPlan, code_residuals, fit_cross, new_residual_model
from .entropy.contexts import CONTEXTS, LEVELS
from .entropy.mixing import copy_model, new_model
from .entropy.range_coder import CACHE, FULL, PENDING, POS, START_BYTES, Coder, finish, new_decoder, new_encoder
from .transform.filter import apply_stage, fit_stage, rings_of
from .transform.octree import Nodes, Octree
from .transform.prediction import DEFAULT_KERNEL, Means, inverse_range
from .transform.quantise import step_of

if TYPE_CHECKING:
    from ...field.texels import TexelSupport
    from ...field.voxels import VoxelSupport

SLICE_VOXELS = 1 << 19  # encoder's choice: at most so many voxels a slice, and an even number of slices ...
WHOLE_VOXELS = 1 << 18  # ... but one slice for fewer than this
MAX_SLICES = 64
# Encoder's choice: slices start at the first level with so many nodes. With 1 << 10 streams take 1 % more.
SLICE_NODES = 1 << 16
# Levels of so few symbols get a buffer that cannot overflow: a symbol has at most UNARY + 2 decisions of 13 bits, each with a
# probability of 2**-13 or more, an escape of 2 * MAX_PREFIX + 1 bits, and a few decisions of its node: 40 bytes.
FEW_SYMBOLS, MOST_SYMBOL_BYTES = 4096, 256
FIRST_ROOM = 64  # bytes of a level buffer beside one per coefficient; no level starts with less


@dataclass(frozen=True)
class Tools:
    """Tools of the attribute coder. kernel, colour_range: prediction (clause 7.3); models: 0 for direct contexts, else the number
    of mixed models (7.5.5), at most 8; filters: stages of the filter (7.7), at most 3; trade_off: squared steps per bit;
    component_cross: 0..16, how far components follow the first (7.4.4); planar: whether z = 0 for all voxels; planar_transform,
    dct_blocks: 0 or 1, 0 unless planar (7.11); dct_blocks need models."""

    kernel: tuple = DEFAULT_KERNEL
    colour_range: int = 0
    models: int = 0
    filters: int = 0
    trade_off: float = 0.05
    planar: int = 0
    planar_transform: int = 0
    component_cross: int = 0
    dct_blocks: int = 0


@dataclass
class CodedAttributes:
    """Content of an attribute unit. colour_range, models, filters and planar to dct_blocks: see Tools and FilterStage; residual:
    0 or the largest error plus 1; residual_cross: [C], if there are residuals; root: [C] means; slice_first: first node of each
    slice at slice_level; codewords: trunk first (only if slice_level > 0), then one per slice; level_bytes: for each codeword and
    level, the number of bytes that a decoder has read after the level, minus those before it."""

    qp: list
    kernel: list
    colour_range: int
    models: int
    filters: list
    root: list
    slice_level: int
    slice_first: list
    codewords: list
    level_bytes: list
    residual: int = 0
    residual_cross: list = field(default_factory=list)
    planar: int = 0
    planar_transform: int = 0
    component_cross: int = 0
    dct_blocks: int = 0


def octree_of(support: VoxelSupport | TexelSupport) -> Octree:
    """Return the Octree over a support's keys, built once and cached in the support for all planes on it."""
    return support.kept("octree", lambda: Octree(support.keys, support.depth, int(support.planar)))


@lru_cache(maxsize=1)
def _bits_of():
    p = np.maximum(np.arange(4097), 0.5) / 4096
    return np.round(-256 * np.log2(p)).astype(np.int64)


def _original_means(levels, values):
    """Rounded means of every level, int32 [n, C] with 12 fractional bits, from values int32 [N, C] of the voxels."""
    means = [values]
    sums = values.astype(np.int64)
    for level in levels[-2::-1]:
        sums = np.add.reduceat(sums, level.first_child[:-1], axis=0)
        w = level.weight[:, None]
        means.append(((2 * sums + w) // (2 * w)).astype(np.int32))
    return means[::-1]


def _plan_slices(levels, deepest):
    """(slice level, at most `deepest`; first node of each slice, by equal numbers of voxels)."""
    voxels = len(levels[-1])
    if voxels < WHOLE_VOXELS:
        return 0, [0]
    slices = min(MAX_SLICES, 2 * -(-voxels // (2 * SLICE_VOXELS)))
    level = min(next(i for i, lv in enumerate(levels) if len(lv) >= SLICE_NODES), deepest)
    ends = np.cumsum(levels[level].weight)
    first = np.searchsorted(ends, voxels * np.arange(slices) // slices, side="right")
    return level, np.unique(first).tolist()


class _Descent:
    """State of encoder and decoder on the way down: the neighbour table, the energies and the means of one level."""

    def __init__(self, octree, root, tools, pool):
        assert octree.planar == tools.planar  # by which the kernels look into its tables
        self.octree, self.levels, self.planar, self.pool = octree, octree.levels, tools.planar, pool
        self.with_dct, self.dct, self.part = tools.dct_blocks, no_dct_blocks(len(root)), 0
        self.table = octree.table(0)
        self.above, self.kept_above = np.zeros((1, 2), np.uint8), new_kept(1, len(root), tools.planar)
        self.mean = np.array([root], np.int32)

    def run(self, jobs):
        return [job() for job in jobs] if self.pool is None or len(jobs) == 1 else list(self.pool.map(lambda job: job(), jobs))

    def blocks(self, depth):
        """Blocks of the parents at `depth`; the level kernels fill their energies and their children's means."""
        level, below = self.levels[depth], self.levels[depth + 1]
        energy = np.zeros((len(level), 2), np.uint8)
        child_mean = np.empty((len(below), self.mean.shape[1]), np.int32)
        nodes = Nodes(level.first_child, level.occupancy, below.weight, self.table, self.planar)
        kept = new_kept(len(level), self.mean.shape[1], self.planar)
        if self.with_dct:
            self.dct, self.part = dct_blocks(self.levels, depth, self.mean.shape[1], self.dct)
        return Blocks(nodes, Means(self.mean, child_mean), self.above, energy, self.kept_above, kept, self.dct)

    def descend(self, depth, blocks, ranges):
        """Moves to the level below `depth`. ranges: node ranges of the slices, for parallel table building."""
        level = self.levels[depth]
        self.mean = blocks.means.child
        self.above = np.repeat(blocks.energy, np.diff(level.first_child), axis=0)
        self.kept_above = np.repeat(blocks.kept, np.diff(level.first_child), axis=0) if self.planar else blocks.kept
        if depth + 2 < len(self.levels):
            self.table = self.octree.table(depth + 1, ranges, self.run)


def _ranges(levels, depth, slice_level, slice_first):
    """Node ranges at `depth`: of the trunk (one range) or of the slices."""
    if depth < slice_level:
        return [(0, len(levels[depth]))]
    first = np.array(slice_first, np.int64)
    for d in range(slice_level, depth):
        first = levels[d].first_child[first]
    bounds = [*first.tolist(), len(levels[depth])]
    return list(zip(bounds[:-1], bounds[1:], strict=True))


def _level_class(levels, depth):
    return min(len(levels) - 2 - depth, LEVELS - 1)


class _SliceEncoder:
    """Encoder of one codeword: coder state, contexts, the bytes so far and the number that a decoder needs for each level."""

    def __init__(self, model, scratch):
        self.state, self.model, self.scratch = new_encoder(), model, scratch
        self.chunks, self.written, self.level_bytes = [], 0, []

    def _reached(self):
        """Number of bytes that a decoder has read by now."""
        return self.written + int(self.state[PENDING] + (self.state[CACHE] >= 0)) + START_BYTES

    def code(self, symbols, rules, blocks, wanted, begin, end):
        """Codes one level of `symbols` coefficients. The other arguments are those of the level kernels."""
        enc_level = _enc_mixed_level if rules.models else _enc_direct_level
        before = self._reached() if self.level_bytes else 0

        def write(out):
            arguments = Coder(self.state, out, 0), self.model, rules, blocks, wanted, self.scratch, begin, end
            if rules.part:
                _enc_dct_level(*arguments)
            enc_level(*arguments)

        self._write(symbols, write)
        self.level_bytes.append(self._reached() - before)

    def code_residuals(self, walk, symbols):
        """Codes the residuals of a slice after its last level; walk: see residual.code_residuals."""
        self.model = new_residual_model()
        self._write(symbols, lambda out: walk(True, Coder(self.state, out, 0), self.model))

    def _write(self, symbols, write):
        """Calls write(out) with a buffer that fits the usual bytes of `symbols` symbols, of few any. If it overflows, they are
        coded again from the same state into a larger buffer."""
        is_safe = symbols <= FEW_SYMBOLS
        room, begin = FIRST_ROOM + symbols * (MOST_SYMBOL_BYTES if is_safe else 1), None
        if not is_safe:
            begin = self.state.copy(), copy_model(self.model)
        while True:
            out = np.empty(room + int(self.state[PENDING]), np.uint8)
            self.state[POS] = 0
            write(out)
            if not self.state[FULL]:
                break
            assert begin is not None, "a symbol took more than MOST_SYMBOL_BYTES"
            self.state, self.model, room = begin[0].copy(), copy_model(begin[1]), 4 * room
        self.chunks.append(out[: int(self.state[POS])].tobytes())
        self.written += len(self.chunks[-1])

    def codeword(self):
        """Ends the codeword and returns its bytes. Trailing zero bytes are omitted, because the decoder reads zeros past the
        end."""
        out = np.empty(FIRST_ROOM + int(self.state[PENDING]), np.uint8)
        self.state[POS] = 0
        return b"".join([*self.chunks, finish(self.state, out)]).rstrip(b"\0")


def _block_rules(tools: Tools | CodedAttributes, components: int) -> tuple[int, int]:
    """rotated and cross of Rules from Tools or CodedAttributes."""
    return tools.planar_transform, tools.component_cross if components > 1 else 0


def _new_model(tools):
    if not tools.models:
        return new_model(CONTEXTS, 0, 0)
    return new_dct_model() if tools.dct_blocks else new_mixed_model()


def enc_attributes(keys: np.ndarray, depth: int, values: np.ndarray, qp: Sequence[int], tools: Tools | None = None,
                   threads: int = 1, plan: ResidualPlan | None = None,
                   octree: Octree | None = None) -> tuple[CodedAttributes, np.ndarray]:
    """Code values on voxels or texels, and return (CodedAttributes, decoded means int32 [N, C], or with a ResidualPlan decoded
    values uint8 [N, C]). The result does not depend on `threads`. keys: int64 [N], ascending Morton keys of `depth` levels;
    values: int32 [N, C] with 12 fractional bits; qp: [C] in 0..63; plan: bounds the error of each value; octree: of these keys,
    if it exists already."""
    tools = tools or Tools()
    octree = octree or Octree(keys, depth, tools.planar)
    levels = octree.levels
    originals = _original_means(levels, np.ascontiguousarray(values, np.int32))
    root = originals[0][0].tolist()
    slice_level, slice_first = _plan_slices(levels, max(depth - UP, 1) if tools.dct_blocks else depth)
    steps, weights = np.array([step_of(v) for v in qp], np.int64), np.array(tools.kernel, np.int64)
    colour_inverse, lagrangian = inverse_range(tools.colour_range, int(steps[0])), 1 / tools.trade_off
    trunk = _SliceEncoder(_new_model(tools), new_scratch(len(qp)))
    coders = active = [trunk]
    with ThreadPoolExecutor(threads) as pool:
        walk = _Descent(octree, root, tools, pool if threads > 1 else None)
        for d in range(depth):
            ranges = _ranges(levels, d, slice_level, slice_first)
            if d == slice_level > 0:
                active = [_SliceEncoder(copy_model(trunk.model), new_scratch(len(qp))) for _ in ranges]
                coders = [trunk, *active]
            blocks, wanted = walk.blocks(d), Wanted(originals[d + 1], originals[-1], 256 * lagrangian, _bits_of())
            rules = Rules(_level_class(levels, d), tools.models, steps, (1 << 32) // steps, weights, colour_inverse,
                          *_block_rules(tools, len(qp)), walk.part)
            children = levels[d].first_child
            assert children is not None  # only the last level has none
            symbols = len(qp) * max(walk.part, 1)  # by child
            walk.run([partial(coder.code, int(children[end] - children[begin]) * symbols, rules, blocks, wanted, begin, end)
                      for coder, (begin, end) in zip(active, ranges, strict=True)])
            walk.descend(d, blocks, ranges)
        filters = []
        for _ in range(tools.filters if depth else 0):
            stage = fit_stage(rings_of(octree), walk.mean, originals[-1], steps, lagrangian, walk.run)
            if stage is None:
                break
            filters.append(stage)
            walk.mean = apply_stage(stage, rings_of(octree), walk.mean, steps, walk.run)
        decoded, residual, cross = walk.mean if plan is None else plan.inverse(walk.mean), 0, []
        if plan is not None and depth:
            parents, residual = _ranges(levels, depth - 1, slice_level, slice_first), plan.delta + 1
            cross = fit_cross(levels[-2], walk.table, tools.planar, decoded, plan.original, parents, walk.run)
            decoded = code_residuals([coder.code_residuals for coder in active], levels[-2], walk.table, tools.planar, parents,
                                     decoded, plan.delta, cross, plan.original, walk.run)
    codewords = [coder.codeword() for coder in coders] if depth else []
    level_bytes = [coder.level_bytes for coder in coders] if depth else []
    coded = CodedAttributes(list(qp), list(tools.kernel), tools.colour_range, tools.models, filters, root, slice_level,
                            slice_first, codewords, level_bytes, residual, cross, tools.planar, *_block_rules(tools, len(qp)),
                            tools.dct_blocks)
    return coded, decoded


def dec_attributes(keys: np.ndarray, depth: int, coded: CodedAttributes, data: np.ndarray, spans: list[tuple[int, int]],
                   stop_level: int, threads: int = 1, inverse: Callable | None = None,
                   reached: list[list[int]] | None = None, octree: Octree | None = None) -> np.ndarray:
    """Decodes levels 0..stop_level. Returns the means int32 [n, C] of that level's nodes, in Morton order, or, if `inverse` is
    given, the values uint8 [n, C] that it computes from them, including their residuals.

    keys: int64 [N], ascending Morton keys of all voxels or texels, of `depth` levels; coded: CodedAttributes without codewords;
    data: uint8, the unit's payload; spans: (begin, end) of each codeword in data, checked by the caller against len(data);
    reached: list that receives, for each codeword, the number of its bytes read after each of its levels, and after its
    residuals; octree: of these keys, if it exists already. Raises StreamError for slices that begin past the nodes of their
    level.
    """
    octree = octree or Octree(keys, depth, coded.planar)
    levels = octree.levels
    if coded.slice_first[-1] >= len(levels[coded.slice_level]):
        raise StreamError("TXF-S12", "a slice begins past the last node", clause="5.7.1", value=coded.slice_first[-1],
                          allowed=f"< {len(levels[coded.slice_level])}")
    data = np.array(data, np.uint8)  # a writable copy: encoder and decoder share kernels
    steps, weights = np.array([step_of(v) for v in coded.qp], np.int64), np.array(coded.kernel, np.int64)
    colour_inverse = inverse_range(coded.colour_range, int(steps[0]))
    active = [(Coder(new_decoder(data, *span), data, span[1]), _new_model(coded)) for span in spans[:1]]
    watched: list[list[int]] = [[] for _ in spans]
    first = 0  # codeword that the first of the active coders reads
    with ThreadPoolExecutor(threads) as pool:
        walk = _Descent(octree, coded.root, coded, pool if threads > 1 else None)
        for d in range(stop_level):
            ranges = _ranges(levels, d, coded.slice_level, coded.slice_first)
            if d == coded.slice_level > 0:
                trunk = active[0][-1]
                active = [(Coder(new_decoder(data, *span), data, span[1]), copy_model(trunk)) for span in spans[1:]]
                first = 1
            blocks = walk.blocks(d)
            rules = Rules(_level_class(levels, d), coded.models, steps, (1 << 32) // steps, weights, colour_inverse,
                          *_block_rules(coded, len(steps)), walk.part)
            walk.run([partial(_dec_level, coder, model, rules, blocks, new_scratch(len(steps)), begin, end)
                      for (coder, model), (begin, end) in zip(active, ranges, strict=True)])
            walk.descend(d, blocks, ranges)
            _watch(watched[first:], spans[first:], active)
        for stage in coded.filters if 0 < stop_level == depth else ():
            walk.mean = apply_stage(stage, rings_of(octree), walk.mean, steps, walk.run)
        decoded = walk.mean if inverse is None else inverse(walk.mean)
        if inverse is not None and coded.residual and 0 < stop_level == depth:
            parents = _ranges(levels, depth - 1, coded.slice_level, coded.slice_first)
            readers = [partial(_read_residuals, coder) for coder, _ in active]
            decoded = code_residuals(readers, levels[-2], walk.table, coded.planar, parents, decoded, coded.residual - 1,
                                     coded.residual_cross, decoded, walk.run)
            _watch(watched[first:], spans[first:], active)
    if reached is not None:
        reached += watched
    return decoded


def _dec_level(coder, model, rules, blocks, scratch, begin, end):
    arguments = coder, model, rules, blocks, scratch, begin, end
    if rules.part:
        _dec_dct_level(*arguments)
    (_dec_mixed_level if rules.models else _dec_direct_level)(*arguments)


def _watch(watched, spans, coders):
    """Appends to each list of watched the number of bytes that its coder has read."""
    for rows, (begin, _), (coder, _) in zip(watched, spans, coders, strict=False):
        rows.append(int(coder.state[POS]) - begin)


def _read_residuals(coder, walk, _):
    walk(False, coder, new_residual_model())
