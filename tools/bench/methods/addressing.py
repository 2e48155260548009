"""What a GPU needs beside the serialised values of voxels: a structure that gives the rank of a voxel along the curve, or says
that there is none. Two are here, each as the bytes that would lie in GPU memory; a key is a voxel's place along the curve
(space_filling.curve_keys), three bits a level.

The DAG is an octree in which equal subtrees are there once. Its leaves are cubes of 4 x 4 x 4 voxels, masks of 64 bits; an inner
node is a word of 32 bits, the mask of its children below 24 bits of the number of voxels under it, and a pointer of 32 bits for
every child. The rank is the sum of the numbers of all earlier siblings on the way down, which are read for that.

The octree is one mask of 8 bits a node, level by level, in records of 64 bytes: the number of bits set in all earlier records,
then 60 masks. Node n + 1 is the one that the n-th set bit of the whole list leads to, so that counting bits is all there is to
do, on the last level too, where it gives the rank.
"""

import numpy as np

LEAF_BITS = 6  # of a key, inside a leaf of the DAG
MOST_COUNTED = (1 << 24) - 1
RECORD, MASKS = 64, 60  # bytes of the octree's record, and those of them that are masks
ONES = np.array([bin(value).count("1") for value in range(256)], np.int64)


def enc_dag(keys, bits):
    """Bytes of the DAG of keys int64 [N], ascending, N >= 1, each below 8**bits. ValueError: a subtree has too many voxels."""
    bits = max(bits, 2)
    parents, first = np.unique(keys >> LEAF_BITS, return_index=True)
    masks = np.bitwise_or.reduceat(np.uint64(1) << (keys & 63).astype(np.uint64), first)
    leaves, node = np.unique(masks, return_inverse=True)
    words, place = [leaves.astype("<u8").view("<u4")], 2 * np.arange(len(leaves))
    counts, total = _ones(leaves), 2 * len(leaves)
    for _ in range(bits - 2):
        children, digit = node, parents & 7
        parents, row = np.unique(parents >> 3, return_inverse=True)
        table = np.full((len(parents), 8), -1, np.int64)
        table[row, digit] = children
        nodes, node = np.unique(table, axis=0, return_inverse=True)
        there = nodes >= 0
        below = np.where(there, counts[nodes], 0).sum(axis=1)
        if len(parents) > 1 and below.max() > MOST_COUNTED:
            raise ValueError(f"a node of the DAG would have to count {below.max()} voxels, and 24 bits hold {MOST_COUNTED}")
        place, counts, here = _write(words, total, there, (place[nodes], below))
        total += here
    return np.concatenate([np.array([place[node[0]] + 1], "<u4"), *words]).tobytes()


def _write(words, total, there, values):
    """Appends the words of one level's nodes; (place of each node, voxels under each, words written). Places count from the word
    after the first, which is the root's place."""
    pointers, below = values
    lengths = 1 + there.sum(axis=1)
    starts = np.cumsum(lengths) - lengths
    level = np.empty(lengths.sum(), "<u4")
    level[starts] = (there << np.arange(8)).sum(axis=1) | np.minimum(below, MOST_COUNTED) << 8
    behind = (starts[:, None] + np.cumsum(there, axis=1))[there]
    level[behind] = pointers[there] + 1
    words.append(level)
    return total + starts, below, len(level)


def find_in_dag(data, keys, bits):
    """Rank of each key in a DAG, int64 [N], -1 where it is not there: what a shader would do, for all keys at once."""
    words, bits = np.frombuffer(data, "<u4").astype(np.int64), max(bits, 2)
    node, rank = np.full(len(keys), words[0]), np.zeros(len(keys), np.int64)
    found = keys >> 3 * bits == 0
    for level in range(bits - 1, 1, -1):
        digit, mask = keys >> 3 * level & 7, words[node] & 255
        found &= mask >> digit & 1 == 1
        after = node.copy()
        for child in range(8):
            there = found & (mask >> child & 1 == 1)
            pointer = words[np.where(there, node + 1 + ONES[mask & (1 << child) - 1], 0)]
            pointer = np.where(there, pointer, 0)
            under = words[pointer] >> 8 if level > 2 else _ones32(words[pointer]) + _ones32(words[pointer + there])
            rank += np.where(there & (child < digit), under, 0)
            after = np.where(there & (child == digit), pointer, after)
        node = after
    mask = words[node] | words[np.minimum(node + 1, len(words) - 1)] << 32
    bit = keys & 63
    found &= mask >> bit & 1 == 1
    earlier = mask & ((np.int64(1) << bit) - 1)
    rank += _ones32(earlier & 0xFFFFFFFF) + _ones32(earlier >> 32 & 0xFFFFFFFF)
    return np.where(found, rank, -1)


def _ones32(values):
    return sum(ONES[values >> shift & 255] for shift in (0, 8, 16, 24))


def _ones(masks):
    """Set bits of uint64 [N], int64 [N]."""
    return ONES[masks[:, None].view(np.uint8)].sum(axis=1)


def enc_octree(keys, bits):
    """Bytes of the octree of keys, as enc_dag()."""
    levels = []
    for level in range(bits):
        cells = np.unique(keys >> 3 * level)
        first = np.flatnonzero(np.diff(cells >> 3, prepend=-1))
        levels.append(np.bitwise_or.reduceat(np.int64(1) << (cells & 7), first))
    masks = np.concatenate(levels[::-1]).astype(np.uint8)
    masks = np.pad(masks, (0, -len(masks) % MASKS)).reshape(-1, MASKS)
    before = np.cumsum(ONES[masks].sum(axis=1))
    counts = np.append(0, before[:-1]).astype("<u4")
    return np.hstack([counts[:, None].view(np.uint8), masks]).tobytes()


def find_in_octree(data, keys, bits):
    """Rank of each key in an octree, as find_in_dag()."""
    records = np.frombuffer(data, np.uint8).reshape(-1, RECORD)
    counts, masks = records[:, :4].copy().view("<u4")[:, 0].astype(np.int64), records[:, 4:]
    within = np.cumsum(ONES[masks], axis=1) - ONES[masks]  # what a shader counts in at most 15 words
    node, found = np.zeros(len(keys), np.int64), keys >> 3 * bits == 0
    for level in range(bits - 1, -1, -1):
        record, byte = np.divmod(node, MASKS)
        digit, mask = keys >> 3 * level & 7, masks[record, byte].astype(np.int64)
        found &= mask >> digit & 1 == 1
        set_before = counts[record] + within[record, byte] + ONES[mask & (1 << digit) - 1]
        node = np.where(found, set_before + 1, 0)
    inner = _nodes_above(masks, bits)
    return np.where(found, node - 1 - inner, -1)


def _nodes_above(masks, bits):
    """Nodes of the octree but for the root, which come before the voxels in the count of set bits."""
    ones, begin, end = ONES[masks].reshape(-1), 0, 1
    for _ in range(bits - 1):
        begin, end = end, end + ones[begin:end].sum()
    return end - 1


STRUCTURES = {"dag": (enc_dag, find_in_dag), "octree": (enc_octree, find_in_octree)}
