"""Inputs of the GPU frames, made where the package is: python -m tools.gpu.prepare_frames --assets FOLDER --out FOLDER

For player, helmet and room: streams with explicit voxels, with texels and (player, helmet) of 3DNTC, decoded; and what
texf-render draws of each, every eighth pixel of one view. The anchor is the source's own image on the mesh of the stream with
texels, as an ordinary UV texture; it travels as JPEG of at most 2048 a side, and its reference picture is of that image. Streams
are kept under --streams, for a second run.
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import texfcodec
from texfcodec.codecs.neural.infer import HASH_FIELD, infer, voxel_positions
from texfcodec.codecs.neural.payload import Payload, Tables, enc_codes
from texfcodec.field.texels import TexelSupport
from texfcodec.field.voxels import VoxelSupport
from texfcodec.io.load import load
from texfcodec.metrics.views import SIZE, VIEWS, ViewSettings, renderer
from texfcodec.render.camera import Camera, bounding_sphere, fibonacci_direction, orthographic
from texfcodec.scene.scene import WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Scene
from texfcodec.texf import Texf

from .frames_asset import FEATURES, HIDDEN, OUTPUTS, bricks_of, save_arrays
from .frames_build import compile_cubin
from .frames_egl import write_shaders

ASSETS = {"player": "bball_0001.glb", "helmet": "damaged_helmet.glb", "room": "mp_room_lod3.glb"}
NEURAL_ASSETS, FAR_ASSET = ("player", "helmet"), "player"
RATES = {"player": "r03", "helmet": "r01", "room": "r01"}  # K is 1024 at both; the bytes that travel are fewer
NEURAL_STEPS, TEXEL_SIZE, ANCHOR_SIZE, ANCHOR_QUALITY = 3000, 2048, 2048, 85
POINTS = 4096
REFERENCE_VIEW, REFERENCE_PIXELS = 7, 256
FAR = 4.0
WRAP = {WRAP_REPEAT: 0, WRAP_CLAMP: 1, WRAP_MIRROR: 2}
Arrays = dict[str, Any]


def texf_arrays(texf: Texf, centre: np.ndarray, radius: float, is_far: bool = True) -> Arrays:
    """What frames_asset.asset_of() takes of a decoded stream. centre, radius: of the source's bounding sphere; is_far: whether
    pictures from afar are drawn, for which a 3DNTC stream needs coarser voxels. Raises ValueError for what the kernels do not
    know: fields of both kinds, alpha, several images, another network."""
    if texf.has_alpha or not texf.fields or len({field.over_texels for field in texf.fields}) > 1:
        raise ValueError("the kernels know opaque assets with fields over voxels or over texels")
    arrays = {"lattice": texf.lattice_positions.astype(np.int32), "faces": texf.faces.astype(np.int32),
              "place": np.array([texf.side / texf.cube.last / radius, *((texf.origin - centre) / radius)])}
    if texf.fields[0].over_texels:
        return arrays | _texel_arrays(texf)
    return arrays | _voxel_arrays(texf, centre, radius, is_far)


def _texel_arrays(texf):
    (field,) = texf.fields
    support = field.support
    alpha = support.image(np.full((len(support), 1), 255, np.uint8))
    image = np.concatenate([support.image(field.planes["base_colour"]), alpha], axis=2)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", lossless=True, exact=True, method=3, quality=40)
    return {"image": np.frombuffer(buffer.getvalue(), np.uint8), "image_size": np.array([support.width, support.height]),
            "wrap": np.array([WRAP[mode] for mode in support.wrap]), "linear": 0, "uv": texf.uv.astype(np.float32)}


def _voxel_arrays(texf, centre, radius, is_far):
    supports = [field.support for field in texf.fields]
    if len({support.resolution for support in supports}) > 1 or any(support.level_shift for support in supports):
        raise ValueError("the kernels know fields of one resolution")
    scale = texf.cube.to_grid(texf.origin + texf.side, supports[0].resolution).max() / texf.side
    out = {"face_field": texf.face_field.astype(np.int32), "size": supports[0].size,
           "grid": np.array([scale * radius, *((centre - texf.origin) * scale)])}
    if not texf.evaluators:
        return out | _stored_voxels([(field.support.keys, field.planes["base_colour"]) for field in texf.fields])
    neural = _neural_arrays(texf, supports)
    if not is_far:
        return out | neural
    coarser = [_level_above(field.support.keys, field.planes["base_colour"]) for field in texf.fields]
    return out | neural | _stored_voxels([(keys, values) for keys, values, _ in coarser]) | {
        "from_level": 1, "weights": np.concatenate([weights for _, _, weights in coarser]).astype(np.uint8)}


def _stored_voxels(fields):
    parts = [bricks_of(keys) for keys, _ in fields]
    return {"bricks": np.concatenate([b for b, _ in parts]), "words": np.concatenate([w for _, w in parts]),
            "values": np.concatenate([values for _, values in fields]),
            "counts": np.array([(len(b), len(keys)) for (b, _), (keys, _) in zip(parts, fields, strict=True)])}


def _level_above(keys, values):
    """(keys, values, voxels that each is the mean of) of level 1, the finest that a renderer asks beside a network."""
    first = np.flatnonzero(np.diff(keys >> 3, prepend=-1))
    weights = np.diff(np.append(first, len(keys)))
    sums = np.add.reduceat(values.astype(np.int64), first)
    return keys[first] >> 3, np.floor(sums / weights[:, None] + 0.5).astype(np.uint8), weights


def _neural_arrays(texf, supports):
    tables = [evaluator for evaluator in texf.evaluators if isinstance(evaluator, Tables)]
    payload = tables[0].payload
    assert isinstance(payload, Payload)  # of a decoded stream
    coarse, fine = payload.levels
    shape = payload.features, payload.hidden, payload.components, payload.octaves
    if shape != (FEATURES, HIDDEN, OUTPUTS, 3) or coarse.table_log2 or not fine.table_log2:
        raise ValueError(f"the kernels know another shape of network than {payload}")
    parts = [bricks_of(table.keys[0]) for table in tables]
    positions, exact = _known_points(supports, tables)
    return {
        "halves": payload.halves.astype(np.uint16), "codes": np.frombuffer(enc_codes(payload.codes), np.uint8),
        "first_wave": payload.first_wave, "salts": np.array([n * HASH_FIELD & 0xFFFFFFFF for n in range(len(tables))], np.uint32),
        "levels": np.array([(level.resolution, level.table_log2, payload.first_row(0, n))
                            for n, level in enumerate((coarse, fine))]),
        "latent_bricks": np.concatenate([b for b, _ in parts]), "latent_words": np.concatenate([w for _, w in parts]),
        "latent_counts": np.array([(len(b), len(t.keys[0])) for (b, _), t in zip(parts, tables, strict=True)]),
        "points": positions, "exact": exact,
    }


def _known_points(supports: list[VoxelSupport], tables: list[Tables]) -> tuple[np.ndarray, np.ndarray]:
    """(int32 [POINTS, 4] of places of 2**24 a side and the field, float32 [POINTS, 3] of what the normative evaluation says)."""
    random = np.random.default_rng(0)
    of_field = random.integers(0, len(tables), POINTS)
    positions, exact = np.zeros((POINTS, 4), np.int32), np.zeros((POINTS, 3), np.float32)
    for number, (support, table) in enumerate(zip(supports, tables, strict=True)):
        chosen = np.flatnonzero(of_field == number)
        voxel = support.xyz()[random.integers(0, len(support), len(chosen))]
        step = (1 << 24) // support.resolution // 2
        place = voxel_positions(voxel, support.resolution) + random.integers(-step, step, (len(chosen), 3), np.int32)
        positions[chosen, :3], positions[chosen, 3] = np.clip(place, 0, (1 << 24) - 1), number
        exact[chosen] = infer(np.ascontiguousarray(positions[chosen, :3]), table) / np.float32(256)
    return positions, exact


def anchor_arrays(scene: Scene, texf: Texf) -> tuple[Arrays, Scene]:
    """(what frames_asset.anchor_of() takes: the image of a source that has one, a Scene of texf's mesh with the image as it
    travels). texf: with one field over texels."""
    used = {m.texture for m in scene.materials}
    if len(used) > 1 or any((np.asarray(m.factor) != 1).any() for m in scene.materials) or scene.corner_color is not None:
        raise ValueError("an anchor has one image and no other colour")
    texture, support = scene.textures[used.pop()], texf.fields[0].support
    assert isinstance(support, TexelSupport)
    image = Image.fromarray(np.ascontiguousarray(texture.image[..., :3]))
    times = max(1, max(image.size) // ANCHOR_SIZE)
    image, buffer = image.reduce(times) if times > 1 else image, io.BytesIO()
    image.save(buffer, "JPEG", quality=ANCHOR_QUALITY, subsampling=0)
    pixels = np.asarray(Image.open(io.BytesIO(buffer.getvalue())).convert("RGBA"))
    uv = (texf.uv / np.array([support.width, support.height]))[texf.faces]
    carried = Scene(texf.positions, texf.faces, np.zeros(len(texf.faces), np.int64), uv, None,
                    [replace(scene.materials[0], texture=0, maps={})], [replace(texture, image=pixels)])
    return {"anchor_image": np.frombuffer(buffer.getvalue(), np.uint8), "anchor_image_size": np.array(image.size)}, carried


def cameras_of(centre: np.ndarray, radius: float, views: int = VIEWS) -> np.ndarray:
    """right, up and forward of the metric's views, float32 [views, 3, 3]."""
    cameras = [orthographic(fibonacci_direction(i, views), centre, radius, 16) for i in range(views)]
    return np.array([(c.right, c.up, c.forward) for c in cameras], np.float32)


def reference_picture(side: Scene | Texf, camera: Camera) -> np.ndarray:
    """What texf-render draws as the metric draws it, with coarser levels: uint8 [H, W, 4], alpha 255 where anything is seen."""
    picture = renderer(side, ViewSettings(mipmaps=True))(camera)
    seen = np.zeros(camera.width * camera.height, np.uint8)
    seen[picture.pixel] = 255
    return np.concatenate([picture.image(), seen.reshape(camera.height, camera.width, 1)], axis=2)


def references(side: Scene | Texf, centre: np.ndarray, radius: float, zooms: dict[str, float], size: int = SIZE) -> Arrays:
    """Reference pictures by the name of how far away: the middle 1 / zoom of the picture, about 256 x 256 of its pixels."""
    out: Arrays = {"reference_view": REFERENCE_VIEW, "reference_side": size}
    for name, zoom in zooms.items():
        camera = orthographic(fibonacci_direction(REFERENCE_VIEW, VIEWS), centre, radius * zoom, size)
        first, step = round(size / 2 - size / 2 / zoom), max(1, round(size / REFERENCE_PIXELS / zoom))
        out[f"reference_{name}"] = reference_picture(side, camera)[first : size - first : step, first : size - first : step]
        out[f"window_{name}"] = np.array([first, step])
    return out


def prepare(asset: str, source: Path, streams: Path, out: Path) -> Iterator[str]:
    """Writes the inputs of one asset, and yields their names."""
    scene = load(source)
    centre, radius = bounding_sphere(scene.positions)
    for kind in ("voxels", "texels", *(["3dntc"] if asset in NEURAL_ASSETS else [])):
        data = stream_of(asset, kind, source, streams)
        texf = texfcodec.decode(data)
        facts = {"stream_bytes": len(data), "faces": len(texf.faces), "holds": texf.counted(), "rate": RATES[asset]}
        if kind == "3dntc":
            facts["rate"] = f"mpeg1, {NEURAL_STEPS} steps"
        arrays = texf_arrays(texf, centre, radius, FAR_ASSET == asset) | {"cameras": cameras_of(centre, radius)}
        zooms = {"near": 1.0} | ({"far": FAR} if kind == "3dntc" and FAR_ASSET == asset else {})
        arrays |= references(texf, centre, radius, zooms) | {"facts": json.dumps(facts)}
        if kind == "texels":
            anchor, carried = anchor_arrays(scene, texf)
            pictures = references(carried, centre, radius, zooms)
            arrays |= anchor | {f"anchor_{name}": pictures[name] for name in ("reference_near", "window_near")}
        name = f"frames_{asset}_{kind}.npz.xz"
        save_arrays(out / name, arrays)
        yield name


def stream_of(asset: str, kind: str, source: Path, streams: Path) -> bytes:
    """The stream of an asset, encoded where the folder does not have it yet."""
    path = streams / f"{asset}.{kind}.texf"
    if not path.exists():
        options: dict[str, Any] = {"effects": "none", "no_check": True}
        options |= {"codec": "3dntc", "steps": NEURAL_STEPS} if kind == "3dntc" else {"rate": RATES[asset], "support": kind}
        options |= {"texel_size": TEXEL_SIZE} if kind == "texels" else {}
        path.write_bytes(texfcodec.encode(str(source), options))
    return path.read_bytes()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--streams", type=Path, required=True)
    given = parser.parse_args()
    for folder in (given.out, given.streams):
        folder.mkdir(parents=True, exist_ok=True)
    print(f"kernels: {compile_cubin(given.out) or 'there is no nvcc; the machine with the GPU compiles them'}", flush=True)
    for asset, source in ASSETS.items():
        begin = time.perf_counter()
        for name in prepare(asset, given.assets / source, given.streams, given.out):
            print(f"{name}: {(given.out / name).stat().st_size} bytes, {time.perf_counter() - begin:.0f} s", flush=True)
    print(f"shaders: {write_shaders(given.out) if shutil.which('node') else 'there is no node'}")


if __name__ == "__main__":
    main()
