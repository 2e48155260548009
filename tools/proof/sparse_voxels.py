"""Voxels of generators: a textured model becomes a dense surface with sparse PBR voxels, which are coded and compared.

python tools/proof/sparse_voxels.py MODEL [--side 512] [--faces 1000000] [--rate r03] [--effort fast] [--out FOLDER]

The voxels are those that the surface touches, their values means of its textures there. The faces are the model's, cut until
there are about as many as a generator gives. Prints one JSON object: bytes of the stream and of the same arrays as .vxz without
loss, PSNR of the channels at the voxels, remarks, processor and wall seconds. --out keeps the input as voxels.npz.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[2] / "tests")]

from voxel_files import write_vxz

from texfcodec import EncodeOptions, decode, encode_to_result
from texfcodec.core.colour_error import decibels
from texfcodec.field.transfer import transfer
from texfcodec.field.voxelise import voxelise
from texfcodec.field.voxels import VoxelSupport
from texfcodec.geometry.mesh import Mesh, points_at
from texfcodec.geometry.nearest_points import NearestPoints
from texfcodec.io.load import load
from texfcodec.io.sparse.subdivide import subdivided
from texfcodec.scene.fetch import map_columns, pack_map, pack_source
from texfcodec.texf import Texf

BITS, THREADS = 16, 2
CHANNELS = {"base_color": "base_colour", "metallic": "metallic", "roughness": "roughness", "occlusion": "occlusion"}


def voxels_of(model: str, side: int, most_faces: int) -> dict[str, np.ndarray]:
    """Return the arrays of docs/guide/generated_mesh.md for a model: its surface and voxels along `side` of its longest side."""
    scene = load(model)
    low, high = scene.positions.min(axis=0), scene.positions.max(axis=0)
    length = float((high - low).max()) * (1 + 2 / side)
    origin = (low + high - length) / 2
    lattice = np.clip(np.rint((scene.positions - origin) / length * (1 << BITS)), 0, (1 << BITS) - 1).astype(np.int64)
    keys, _ = voxelise(lattice, scene.faces, BITS, side, 0, THREADS, None)
    support = VoxelSupport(side, keys)

    def mean(packed):
        return transfer(lattice, scene.faces, packed, BITS, side, keys, support.brick_map, 4, THREADS)[0]

    values = {"base_color": mean(pack_source(scene))}
    for name in {name for material in scene.materials for name in material.maps} & {*CHANNELS.values()}:
        values[name] = mean(pack_map(scene, name))[:, map_columns(name)]
    values = {name: np.clip(np.rint(value), 0, 255).astype(np.uint8) for name, value in values.items()}
    return {**_dense(scene, length / side, most_faces), "voxels": support.xyz().astype(np.int64), "origin": origin,
            "voxel_size": np.full(3, length / side), **values}


def _dense(scene, voxel, most_faces):
    """{"vertices", "faces"} of a scene, welded, with edges as short as so many faces allow, but no shorter than a voxel."""
    _, first, number = np.unique(np.round(scene.positions / voxel * 1024), axis=0, return_index=True, return_inverse=True)
    positions, faces = scene.positions[first], number.reshape(-1)[scene.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]

    def restless(points):
        return np.random.default_rng(len(points)).random((len(points), 1)).astype(np.float32)  # so that every long edge is cut

    for longest in voxel * 1.15 ** np.arange(40):
        cut, triangles, _, _ = subdivided(positions, faces, restless(positions), restless, np.full(3, longest), 4 * most_faces)
        if len(triangles) <= most_faces:
            break
    return {"vertices": cut, "faces": triangles}


def psnr_at_voxels(texf: Texf, arrays: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the PSNR in dB, by channel and of "all" components, of a decoded stream at the points of its surface that are
    nearest to the voxels' centres."""
    centres = (arrays["voxels"] + 0.5) * arrays["voxel_size"] + arrays["origin"]
    near = NearestPoints(Mesh(texf.positions, texf.faces)).find(centres, threads=THREADS)
    points, squares = points_at(Mesh(texf.positions, texf.faces), near.face, near.bary), {}
    for name, channel in CHANNELS.items():
        if name not in arrays:
            continue
        factor = np.array(texf.materials[0].parameters.get(channel, (1.0,)))
        got = np.broadcast_to(255 * factor, arrays[name].shape).copy()
        for number, part in enumerate(texf.fields):
            rows = np.flatnonzero(texf.face_field[near.face] == number)
            if channel in part.planes and len(rows):
                got[rows] = texf.query_planes(number, [channel], points[rows], near.face[rows])[channel]
        squares[name] = np.square(got - arrays[name]).mean(axis=0)
    out = {name: round(decibels(max(float(square.mean()), 1e-6)), 2) for name, square in squares.items()}
    return out | {"all": round(decibels(float(np.concatenate(list(squares.values())).mean())), 2)}


def main() -> None:
    """Code the voxels of a model and print what came of it."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("model")
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--faces", type=int, default=1_000_000)
    parser.add_argument("--rate", default="r03")
    parser.add_argument("--effort", default="fast")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    arrays = voxels_of(arguments.model, arguments.side, arguments.faces)
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        np.savez(arguments.out / "voxels.npz", **arrays)
    wall, cpu = time.perf_counter(), time.process_time()
    encoded = encode_to_result(arrays, EncodeOptions(rate=arguments.rate, effort=arguments.effort))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    texf = decode(encoded.data)
    lossless = write_vxz({name: arrays[name] for name in ("voxels", *CHANNELS) if name in arrays}, 256, "lzma")
    print(json.dumps({"voxels": len(arrays["voxels"]), "faces": len(arrays["faces"]), "sent_faces": len(texf.faces),
                      "bytes": len(encoded.data), "sizes": encoded.sizes, "vxz_bytes": len(lossless),
                      "psnr": psnr_at_voxels(texf, arrays), "processor_seconds": round(cpu, 1), "wall_seconds": round(wall, 1),
                      "remarks": encoded.remarks}, indent=1))


if __name__ == "__main__":
    main()
