"""Arrays of an asset as the kernels of frames.cu look them up: bricks of voxels, levels of images, the 3DNTC network.

Numpy and Pillow alone: this runs on a machine where the package is not installed.
"""

from __future__ import annotations

import io
import lzma
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

VOXELS, TEXELS, NEURAL = 0, 1, 2  # what `shade` of frames_pixel.cu takes
WORDS, HASH_FACTOR = 16, 2654435769
PADDED, HIDDEN, OUTPUTS = 64, (64, 48, 32), 3  # as frames.cu has them
FEATURES, INPUTS = 16, 50
POINTERS = ("positions", "faces", "uv", "density", "face_field", "fields", "table", "bits", "values", "images", "image_levels",
            "latents", "latent_table", "latent_bits", "matrices", "fragments")
COUNTS = ("vertices", "face_count", "size", "last", "width", "height", "wrap_s", "wrap_t", "image_last", "resolution0",
          "resolution1", "hash_log2", "first1", "first_wave")
ASSET = np.dtype([(name, np.uint64) for name in POINTERS] + [(name, np.int32) for name in COUNTS]
                 + [(name, np.float32) for name in ("scale", "offset_x", "offset_y", "offset_z")])
FIELD = np.dtype([(name, np.uint32 if name == "salt" else np.int32) for name in (
    "table_at", "table_log2", "bits_at", "latent_table_at", "latent_log2", "latent_bits_at", "salt", "unused")])
CAMERA = np.dtype([("right", np.float32, 3), ("up", np.float32, 3), ("forward", np.float32, 3), ("zoom", np.float32),
                   ("side", np.int32), ("fineness", np.float32)])


@dataclass
class FrameAsset:
    """kind: VOXELS, TEXELS or NEURAL; arrays: by the pointers' names in ASSET; numbers: by the other names."""

    kind: int
    arrays: dict[str, np.ndarray]
    numbers: dict[str, float] = field(default_factory=dict)

    @property
    def voxels_per_radius(self) -> float:
        """What makes a pixel ask coarser voxels; 0 where there are none to ask."""
        return float(self.numbers["scale"]) if "values" in self.arrays else 0.0

    def packed(self, address: Callable[[np.ndarray], int]) -> np.ndarray:
        """The struct Asset, one row of ASSET. address: where an array's copy is, called for each."""
        out = np.zeros(1, ASSET)
        for name, array in self.arrays.items():
            out[name] = address(array)
        for name, number in self.numbers.items():
            out[name] = number
        return out


def camera_of(right: np.ndarray, up: np.ndarray, forward: np.ndarray, zoom: float, side: int, scale: float = 0.0) -> np.ndarray:
    """The struct Camera, one row of CAMERA. zoom: half the picture's side in radii; side: pixels; scale: voxels per radius."""
    out = np.zeros(1, CAMERA)
    fineness = float(np.log2(max(2.0 * zoom / side * scale, 1.0)))
    out["right"], out["up"], out["forward"] = right, up, forward
    out["zoom"], out["side"], out["fineness"] = zoom, side, fineness
    return out


def save_arrays(path: Path, arrays: dict[str, Any]) -> None:
    """Writes arrays and plain values as an npz under LZMA: rows of integers as differences from row to row, column after column,
    and colours as green and what the others differ from it."""
    stored = {}
    for name, array in arrays.items():
        if name in ("lattice", "faces", "values", "bricks"):
            rows = np.ascontiguousarray(array).reshape(len(array), -1)
            steps = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), rows.dtype))
            if name == "values":
                steps[:, ::2] -= steps[:, 1:2]
            stored[name] = np.ascontiguousarray(steps.T)
        else:
            stored[name] = np.asarray(array)
    buffer = io.BytesIO()
    np.savez(buffer, **stored)
    path.write_bytes(lzma.compress(buffer.getvalue(), preset=5))


def load_arrays(path: Path) -> dict[str, Any]:
    """Mirror of save_arrays."""
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as stored:
        out = {name: stored[name] for name in stored.files}
    for name in ("lattice", "faces", "values", "bricks"):
        if name in out:
            steps = np.ascontiguousarray(out[name].T)
            if name == "values":
                steps[:, ::2] += steps[:, 1:2]
            rows = np.cumsum(steps, axis=0, dtype=steps.dtype)
            out[name] = rows[:, 0] if name == "bricks" else rows
    return out


def anchor_of(data: dict[str, Any]) -> dict[str, Any]:
    """The same mesh with the anchor's image in place of the stream's. data: of load_arrays(), of an asset over texels."""
    uv = data["uv"] * (data["anchor_image_size"] / data["image_size"])
    named = {name.removeprefix("anchor_"): array for name, array in data.items() if name.startswith("anchor_")}
    return data | named | {"uv": uv.astype(np.float32), "linear": 1}


def asset_of(data: dict[str, Any]) -> FrameAsset:
    """FrameAsset of what prepare_frames.py stored. data: arrays by name, as load_arrays() gives them."""
    if "lattice" in data:
        step, *offset = data["place"]
        data = data | {"positions": data["lattice"] * step + np.array(offset)}
    positions, faces = np.ascontiguousarray(data["positions"], np.float32), np.ascontiguousarray(data["faces"], np.int32)
    arrays = {"positions": positions, "faces": faces}
    numbers: dict[str, float] = {"vertices": len(positions), "face_count": len(faces)}
    if "image" in data:
        arrays |= _image_arrays(data, positions, faces)
        numbers |= dict(zip(("width", "height", "wrap_s", "wrap_t"), (*data["image_size"], *data["wrap"]), strict=True))
        numbers["image_last"] = len(arrays["image_levels"]) - 1
        return FrameAsset(TEXELS, arrays, numbers)
    scale, *offset = (float(x) for x in data["grid"])
    fields = np.zeros(len(data["salts"] if "halves" in data else data["counts"]), FIELD)
    if "values" in data:
        arrays |= _voxel_arrays(data, fields)
    arrays |= {"face_field": np.ascontiguousarray(data["face_field"], np.int32), "fields": fields}
    numbers |= {"size": int(data["size"]), "last": last_level(int(data["size"])), "scale": scale,
                **dict(zip(("offset_x", "offset_y", "offset_z"), offset, strict=True))}
    if "halves" not in data:
        return FrameAsset(VOXELS, arrays, numbers)
    neural_arrays, neural_numbers = _neural_arrays(data, fields)
    return FrameAsset(NEURAL, arrays | neural_arrays, numbers | neural_numbers)


# ---- Voxels


def bricks_of(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ascending Morton keys int64 [N] as (bricks: uint32 [B], key >> 9; words: uint32 [B, 16], which voxels are there)."""
    bricks, number = np.unique(keys >> 9, return_inverse=True)
    words = np.zeros(len(bricks) * WORDS, np.uint32)
    np.bitwise_or.at(words, number * WORDS + ((keys >> 5) & 15), np.uint32(1) << (keys & 31).astype(np.uint32))
    return bricks.astype(np.uint32), words.reshape(-1, WORDS)


def keys_of(bricks: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Mirror of bricks_of: int64 [N]."""
    octets = np.ascontiguousarray(words, "<u4").view(np.uint8).reshape(len(bricks), -1)
    occupied = np.unpackbits(octets, axis=1, bitorder="little")
    brick, place = np.nonzero(occupied)
    return bricks.astype(np.int64)[brick] << 9 | place


def last_level(size: int) -> int:
    """Number of the level that is one voxel, of `size` voxels a side."""
    return max(size - 1, 0).bit_length()


def _voxel_arrays(data, fields):
    """Look-ups and values of all levels of all fields; fills their rows of FIELD. data: bricks, words and values of all fields,
    and counts int64 [n, 2], bricks and voxels of each. Where "from_level" is 1, values begin with those of level 1."""
    tables, all_bits, rows, row = [], [], [], 0
    last, from_level = last_level(int(data["size"])), int(data.get("from_level", 0))
    places = np.cumsum(np.concatenate([[[0, 0]], data["counts"]]), axis=0)
    for number, ((b, n), (end_b, end_n)) in enumerate(zip(places[:-1], places[1:], strict=True)):
        keys = keys_of(data["bricks"][b:end_b], data["words"][b:end_b])
        weights = data["weights"][n:end_n].astype(np.int64) if from_level else np.ones(len(keys), np.int64)
        levels, values = pyramid_of(keys, data["values"][n:end_n], weights, last - from_level)
        table, log2, bits = look_up_of(levels, from_level)
        bits[:, 1] += np.uint32(row)
        fields["table_at"][number], fields["bits_at"][number] = sum(map(len, tables)), sum(map(len, all_bits))
        fields["table_log2"][number] = log2
        row += len(values)
        tables.append(table)
        all_bits.append(bits)
        rows.append(values)
    return {"table": np.concatenate(tables), "bits": np.concatenate(all_bits), "values": np.concatenate(rows)}


def pyramid_of(keys: np.ndarray, values: np.ndarray, counts: np.ndarray, above: int) -> tuple[list, np.ndarray]:
    """((bricks, words) by level, values of all levels as uint32 RGBA by row): plain means of the voxels below, rounded.

    keys: ascending int64 [N]; values: uint8 [N, 3]; counts: int64 [N], voxels that each is a mean of; above: number of levels.
    """
    rows, levels, sums = [values], [bricks_of(keys)], values * counts[:, None]
    for _ in range(above):
        keys = keys >> 3
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        keys, sums, counts = keys[first], np.add.reduceat(sums, first), np.add.reduceat(counts, first)
        rows.append(np.floor(sums / counts[:, None] + 0.5).astype(np.uint8))
        levels.append(bricks_of(keys))
    return levels, rgba_words(np.concatenate(rows))


def rgba_words(rgb: np.ndarray, alpha: np.ndarray | int = 255) -> np.ndarray:
    """uint8 [..., 3] and alpha as uint32 [...], red in the low byte."""
    out = np.empty((*rgb.shape[:-1], 4), np.uint8)
    out[..., :3], out[..., 3] = rgb, alpha
    return out.view("<u4")[..., 0]


def look_up_of(levels: list[tuple[np.ndarray, np.ndarray]], first: int = 0) -> tuple[np.ndarray, int, np.ndarray]:
    """(table uint32 [2**log2, 2] of (code, brick + 1), log2, bits uint32 [B * 16, 2] of (occupancy, row of the first voxel)).
    levels: (bricks, words) from level `first` on."""
    codes = np.concatenate([_codes(first + number, bricks) for number, (bricks, _) in enumerate(levels)])
    words = np.concatenate([words.reshape(-1) for _, words in levels])
    log2 = max(4, int(2 * len(codes)).bit_length())
    table = np.zeros((1 << log2, 2), np.uint32)
    slots, left = (codes * np.uint32(HASH_FACTOR)) >> np.uint32(32 - log2), np.arange(len(codes))
    while len(left):
        free = left[table[slots[left], 1] == 0]
        _, chosen = np.unique(slots[free], return_index=True)
        placed = free[chosen]
        table[slots[placed]] = np.stack([codes[placed], placed.astype(np.uint32) + 1], axis=1)
        left = left[table[slots[left], 1] != left + 1]
        slots[left] = (slots[left] + 1) & np.uint32((1 << log2) - 1)
    ones = np.bitwise_count(words).astype(np.int64)
    return table, log2, np.stack([words, (np.cumsum(ones) - ones).astype(np.uint32)], axis=1)


def _codes(level, bricks):
    """A number for each brick: coordinates of 10 bits on level 0, of 9 above it."""
    x, y, z = (_compact(bricks >> np.uint32(axis)) for axis in range(3))
    if level == 0:
        return x | y << np.uint32(10) | z << np.uint32(20)
    return x | y << np.uint32(9) | z << np.uint32(18) | np.uint32(0x80000000 | level << 27)


def _compact(keys):
    out = np.zeros_like(keys)
    for bit in range(11):
        out |= ((keys >> np.uint32(3 * bit)) & np.uint32(1)) << np.uint32(bit)
    return out


# ---- Images


def _image_arrays(data, positions, faces):
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None
    pixels = np.asarray(Image.open(io.BytesIO(data["image"].tobytes())).convert("RGBA"))
    if tuple(pixels.shape[1::-1]) != tuple(int(n) for n in data["image_size"]):
        raise ValueError("the stored image has another size")
    levels = linear_levels(pixels) if int(data["linear"]) else masked_levels(pixels)
    places = np.cumsum([0] + [level.size // 4 for level in levels[:-1]])
    sizes = np.array([(at, level.shape[1], level.shape[0], 0) for at, level in zip(places, levels, strict=True)], np.int32)
    uv = np.ascontiguousarray(data["uv"][faces] if data["uv"].ndim == 2 else data["uv"], np.float32)
    return {"uv": uv, "density": density_of(positions[faces], uv), "image_levels": sizes,
            "images": np.concatenate([rgba_words(level[..., :3], level[..., 3]).reshape(-1) for level in levels])}


def density_of(corners: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Texels along one unit of length on every face, float32 [F]. corners: [F, 3, 3]; uv: [F, 3, 2], texels."""
    corners, uv = corners.astype(np.float64), uv.astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    u, v = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    flat = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    return np.sqrt(np.divide(flat, area, out=np.zeros(len(area)), where=area > 0)).astype(np.float32)


def masked_levels(pixels: np.ndarray) -> list[np.ndarray]:
    """Levels of an image over texels, uint8 [H, W, 4], A 255 where a texel is referenced: means of those, rounded."""
    counts = (pixels[..., 3] > 0).astype(np.float32)
    sums, levels = pixels[..., :3] * counts[..., None], [pixels]
    while max(counts.shape) > 1:
        counts, sums = _halved_sums(counts), _halved_sums(sums)
        means = np.rint(sums / np.maximum(counts, 1)[..., None])
        levels.append(np.concatenate([means, np.where(counts > 0, 255, 0)[..., None]], axis=2).astype(np.uint8))
    return levels


def _halved_sums(values):
    """Sums over 2 x 2; what lies outside is 0."""
    height, width = values.shape[:2]
    padding = [(0, height % 2), (0, width % 2)] + [(0, 0)] * (values.ndim - 2)
    values = np.pad(values, padding) if height % 2 or width % 2 else values
    return values[::2, ::2] + values[1::2, ::2] + values[::2, 1::2] + values[1::2, 1::2]


def linear_levels(pixels: np.ndarray) -> list[np.ndarray]:
    """Mip levels of an sRGB-coded image uint8 [H, W, 4], sides powers of two: means of 2 x 2 in linear light, rounded."""
    coded = np.arange(256) / 255
    to_linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4).astype(np.float32)
    levels = [np.concatenate([pixels[..., :3], np.full_like(pixels[..., :1], 255)], axis=2)]
    if any(n & (n - 1) for n in pixels.shape[:2]):
        raise ValueError("a UV texture has sides that are no powers of two")
    while max(levels[-1].shape[:2]) > 1:
        light = to_linear[levels[-1][..., :3]]
        for axis in (0, 1):
            if light.shape[axis] > 1:
                pairs = np.moveaxis(light, axis, 0)
                light = np.moveaxis(pairs[::2] / 2 + pairs[1::2] / 2, 0, axis)
        srgb = np.where(light <= 0.0031308, light * 12.92, 1.055 * np.power(np.maximum(light, 1e-9), 1 / 2.4) - 0.055)
        rgb = np.rint(np.clip(255 * srgb, 0, 255)).astype(np.uint8)
        levels.append(np.concatenate([rgb, np.full_like(rgb[..., :1], 255)], axis=2))
    return levels


# ---- 3DNTC


def _neural_arrays(data, fields):
    """(arrays, numbers) of a payload of the shape that frames_pixel.cu knows; fills rows of FIELD. data: halves uint16 [P];
    codes uint8, two a byte; levels int64 [2, 3] of resolution, log2 of the hash table or 0, first row; latent_bricks,
    latent_words of all fields and latent_counts int64 [n, 2], bricks and rows of each; salts; first_wave."""
    levels = data["levels"]
    weights, biases = layers_of(data["halves"])
    tables, all_bits = [], []
    places = np.cumsum(np.concatenate([[[0, 0]], data["latent_counts"]]), axis=0)
    for number, ((b, row), (end, _)) in enumerate(zip(places[:-1], places[1:], strict=True)):
        table, log2, bits = look_up_of([(data["latent_bricks"][b:end], data["latent_words"][b:end])])
        bits[:, 1] += np.uint32(levels[0, 2] + row)
        fields["latent_table_at"][number], fields["latent_bits_at"][number] = sum(map(len, tables)), sum(map(len, all_bits))
        fields["latent_log2"][number], fields["salt"][number] = log2, data["salts"][number]
        tables.append(table)
        all_bits.append(bits)
    arrays = {
        "latents": np.ascontiguousarray(data["codes"]).view("<u4").reshape(-1, 2), "latent_table": np.concatenate(tables),
        "latent_bits": np.concatenate(all_bits), "fragments": fragments_of(weights),
        "matrices": np.concatenate([w.reshape(-1) for w in weights] + biases).astype(np.float32),
    }
    return arrays, {"resolution0": levels[0, 0], "resolution1": levels[1, 0], "hash_log2": levels[1, 1],
                    "first1": levels[1, 2], "first_wave": int(data["first_wave"])}


def layers_of(halves: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """(weights float64 [outputs, inputs], biases float64 [outputs]) by layer, rounded to 16 fractional bits as clause 11.6 has
    it. halves: uint16 [P], binary16 patterns."""
    plain = halves.view(np.float16).astype(np.float64)
    fixed = np.copysign(np.floor(np.abs(plain) * 65536 + 0.5) / 65536, plain)
    weights, biases, at, inputs = [], [], 0, INPUTS
    for outputs in (*HIDDEN, OUTPUTS):
        weights.append(fixed[at : at + inputs * outputs].reshape(outputs, inputs))
        at += inputs * outputs
        biases.append(fixed[at : at + outputs])
        at, inputs = at + outputs, outputs
    if at != len(halves):
        raise ValueError("the network has another shape than the kernels")
    return weights, biases


def fragments_of(weights: list[np.ndarray]) -> np.ndarray:
    """Weights by layer as mma.m16n8k16 takes its second matrix: uint32 [tiles * 32, 2]. Tiles of 8 outputs and 16 inputs, inputs
    fastest; thread 4 g + t has output g at inputs 2 t, 2 t + 1 in its first word and 2 t + 8, 2 t + 9 in its second."""
    parts = []
    for weight in weights:
        outputs, inputs = (-(-weight.shape[0] // 8) * 8, -(-weight.shape[1] // 16) * 16)
        full = np.zeros((outputs, inputs), np.float16)
        full[: weight.shape[0], : weight.shape[1]] = weight
        tiles = full.reshape(outputs // 8, 8, inputs // 16, 2, 4, 2)  # n, g, i, word, t, half
        parts.append(np.ascontiguousarray(tiles.transpose(0, 2, 1, 4, 3, 5)).view("<u4").reshape(-1, 2))
    return np.concatenate(parts)
