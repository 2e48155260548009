"""Files of sparse voxels: a shell of a sphere with its surface as a dual grid, and a writer of .vxz in all its forms."""

import json
import lzma
import struct
import zlib

import numpy as np

STEPS = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1))
RADIUS = 0.4


def shell(side=16):
    """{"voxels", attributes uint8} of a sphere of RADIUS in the cube from -0.5 to 0.5."""
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)

    def inside(corners):
        return np.linalg.norm(corners / side - 0.5, axis=-1) < RADIUS

    corners = np.stack([inside(grid + offset) for offset in np.ndindex(2, 2, 2)], axis=1)
    voxels = grid[corners.any(axis=1) & ~corners.all(axis=1)]
    crossed = np.stack([inside(voxels + 1 - axis) != inside(voxels + 1) for axis in np.eye(3, dtype=int)], axis=1)
    middle = (voxels + 0.5) / side - 0.5
    on_sphere = (middle / np.linalg.norm(middle, axis=1, keepdims=True) * RADIUS + 0.5) * side
    shade = lambda rate: np.rint(127.5 + 127.5 * np.sin(voxels @ np.array(rate))).astype(np.uint8)  # noqa: E731
    return {"voxels": voxels, "base_color": np.stack([shade((.3, .2, .1)), shade((.1, .4, 0)), shade((0, .1, .3))], axis=1),
            "metallic": shade((.2, 0, .2))[:, None], "roughness": shade((0, .3, .1))[:, None],
            "dual_vertices": np.clip((on_sphere - voxels) * 255, 0, 255).astype(np.uint8),
            "intersected": (crossed @ [1, 2, 4]).astype(np.uint8)[:, None]}


def write_vxz(arrays, chunk=8, method="deflate", filtered="none", interleave="as_is"):
    """The bytes of a .vxz file of {"voxels": [N, 3], attribute: uint8 [N, C]}."""
    arrays = dict(arrays)
    voxels, depth = np.asarray(arrays.pop("voxels"), np.int64), chunk.bit_length() - 1
    header = {"num_voxel": len(voxels), "chunk_size": chunk, "filter": filtered, "compression": method, "compression_level": 9,
              "attr_interleave": interleave, "attr": [[name, a.shape[1]] for name, a in arrays.items()], "chunks": []}
    joined, body = np.concatenate(list(arrays.values()), axis=1), b""
    for place in np.unique(voxels // chunk, axis=0):
        rows = np.flatnonzero((voxels // chunk == place).all(axis=1))
        xyz = voxels[rows] % chunk
        code = sum(((xyz[:, axis] >> bit) & 1) << (3 * bit + 2 - axis) for axis in range(3) for bit in range(depth))
        order = np.argsort(code)
        code, xyz, values = code[order], xyz[order], joined[rows][order]
        if filtered != "none":
            values = along_octree(code, depth, values) if filtered == "parent" else from_neighbours(xyz, values)
        entry, chunk_bytes = {"idx": place.tolist()}, b""
        for name, part in (("svo", octree(code, depth)), *blocks(values, header["attr"], interleave)):
            packed = compressed(part.tobytes(), method)
            entry[name], chunk_bytes = [len(chunk_bytes), len(packed)], chunk_bytes + packed
        entry["ptr"], body = [len(body), len(chunk_bytes)], body + chunk_bytes
        header["chunks"].append(entry)
    text = json.dumps(header).encode()
    return b"VXZ\0" + struct.pack(">I", 8 + len(text)) + text + body


def bent(data, change):
    """A .vxz file whose header a function has changed."""
    begin = struct.unpack(">I", data[4:8])[0]
    header = json.loads(data[8:begin])
    change(header)
    text = json.dumps(header).encode()
    return b"VXZ\0" + struct.pack(">I", 8 + len(text)) + text + data[begin:]


def blocks(values, attributes, interleave):
    ends = np.cumsum([count for _, count in attributes])
    if interleave == "all":
        return [("attr", values)]
    if interleave == "as_is":
        return [(name, values[:, end - count : end]) for (name, count), end in zip(attributes, ends, strict=True)]
    return [(f"{name}_{i}", values[:, end - count + i]) for (name, count), end in zip(attributes, ends, strict=True)
            for i in range(count)]


def compressed(data, method):
    if method == "deflate":
        packer = zlib.compressobj(9, wbits=-15)
    elif method == "lzma":
        packer = lzma.LZMACompressor(lzma.FORMAT_RAW, filters=[{"id": lzma.FILTER_LZMA2, "preset": 0}])
    else:
        return data
    return packer.compress(data) + packer.flush()


def octree(code, depth, level=0):
    """The nodes of ascending codes, depth first."""
    child = (code >> 3 * (depth - 1 - level)) & 7
    node = np.bitwise_or.reduce(1 << child).astype(np.uint8)
    below = [octree(code[child == c], depth, level + 1) for c in np.unique(child)] if level + 1 < depth else []
    return np.concatenate([[node], *below]).astype(np.uint8)


def along_octree(code, depth, values):
    """Differences of children from the child before, node by node."""
    out = [values[0]]

    def visit(rows, level):
        child = (code[rows] >> 3 * (depth - 1 - level)) & 7
        parts = [rows[child == c] for c in np.unique(child)]
        out.extend(values[here[0]] - values[before[0]] for before, here in zip(parts[:-1], parts[1:], strict=True))
        for part in parts if level + 1 < depth else []:
            visit(part, level + 1)

    visit(np.arange(len(code)), 0)
    return np.array(out, np.uint8)


def from_neighbours(xyz, values):
    place, out = {tuple(p): i for i, p in enumerate(xyz.tolist())}, values.copy()
    for i, p in enumerate(xyz.tolist()):
        others = [place[q] for step in STEPS if (q := tuple(np.subtract(p, step).tolist())) in place]
        if others:
            out[i] -= values[others[-1]]
    return out
