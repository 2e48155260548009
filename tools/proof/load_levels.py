"""What decoding takes at the bounds of a level (bitstream_spec.md 10.1): streams that come near one bound each.

python tools/proof/load_levels.py STREAM SMALL LEVEL      decodes one here, after a small one of its kind; JSON on stdout
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.proof.load_scenes import REPOSITORY  # finds the shapes of the tests
from tools.proof.memory import Memory

LEVELS_RUN = (1, 2)
NEAR = 0.85  # of a bound is what a stream aims at: voxels that are hardly touched count and are not kept
SMALL = 64  # resolution of the small stream, from which the large one's is reckoned
COUNTED = {"voxels": "voxels", "texels": "voxels", "faces": "faces", "samples": "samples"}  # stream: the bound that it comes near


def _torus(around, across, copies=1):
    from conformance.make.scenes import scene_of, torus

    positions, faces, colours = torus(around, across)
    return scene_of(positions, np.tile(faces, (copies, 1)), colours)


def _image(side):
    """Waves and noise, uint8 [side, side, 4], so that coefficients have to be decoded."""
    y, x = np.mgrid[:side, :side] / 64.0
    image = np.full((side, side, 4), 255, np.uint8)
    for c in range(3):
        grain = np.random.default_rng(c).normal(0, 12, (side, side))
        image[..., c] = np.clip(128 + 70 * np.sin(x + c) * np.cos(y * (c + 1)) + grain, 0, 255)
    return image


def samples_of(texf, resolution):
    """Samples of a surface of one field over voxels (10.1)."""
    from texfcodec.field.voxelise import count_samples

    return count_samples(texf.lattice_positions, texf.faces, texf.position_bits, resolution)


def streams_of(kind, bounds):
    """(small stream, one near the bound) as bytes. kind: of COUNTED; bounds: Limits of a level."""
    from shapes import mapped_sheet

    from texfcodec.api import decode
    from texfcodec.encoder.encode import encode_scene
    from texfcodec.options import EncodeOptions

    def coded(scene, **options):
        return encode_scene(scene, EncodeOptions(effort="fast", qp=22, refine="off", threads=2, **options)).data

    bound = NEAR * getattr(bounds, COUNTED[kind])
    if kind == "texels":
        sheet = lambda side: coded(mapped_sheet({}, colour=_image(side)), support="texels")
        return sheet(SMALL), sheet(int(np.sqrt(bound)))
    if kind == "faces":
        across = 1 << (int(np.log2(bound)) // 2 - 1)
        return coded(_torus(32, 16), resolution=SMALL), coded(_torus(int(bound) // (2 * across), across), resolution=SMALL)
    small = coded(_torus(64, 32), resolution=SMALL)
    made = decode(small)
    resolution = int(SMALL * np.sqrt(NEAR * bounds.voxels / len(made.fields[0].support)) * (0.7 if kind == "samples" else 1))
    once = samples_of(made, resolution)
    return small, coded(_torus(64, 32, int(bound / once) if kind == "samples" else 1), resolution=resolution)


def run_levels(levels=LEVELS_RUN):
    """{"rows": one for each stream and level: level, kind, count of what it comes near, bytes of the stream, seconds, memory in
    bytes beyond what the idle decoder holds}."""
    from texfcodec.limits import LEVELS

    rows = []
    for level in levels:
        for kind in COUNTED:
            with tempfile.TemporaryDirectory() as folder:
                paths = [Path(folder) / name for name in ("stream.texf", "small.texf")]
                for path, data in zip(paths, reversed(streams_of(kind, LEVELS[level])), strict=True):
                    path.write_bytes(data)
                command = [sys.executable, str(REPOSITORY / "tools" / "proof" / "load_levels.py"), *map(str, paths), str(level)]
                run = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, cwd=REPOSITORY)
                found = json.loads(run.stdout)
                rows.append({"level": level, "kind": kind, "bytes": paths[0].stat().st_size, **found,
                             "count": found["counts"][COUNTED[kind]], "bound": getattr(LEVELS[level], COUNTED[kind])})
    return {"rows": rows}


def levels_faults(found):
    """What misses the target: sentences."""
    return [f"the stream for {row['kind']} of level {row['level']} has {row['count']:,} of {row['bound']:,}"
            for row in found["rows"] if not 0.5 < row["count"] / row["bound"] <= 1]


def main():
    """The child's side."""
    from texfcodec.api import decode
    from texfcodec.field.voxels import VoxelSupport
    from texfcodec.limits import LEVELS
    from texfcodec.options import DecodeOptions

    stream, small = (Path(name).read_bytes() for name in sys.argv[1:3])
    options = DecodeOptions(threads=2, limits=LEVELS[int(sys.argv[3])])
    decode(small, options)  # kernels are there from now on
    memory, begin = Memory(), time.perf_counter()
    texf = decode(stream, options)
    seconds, held = time.perf_counter() - begin, memory.result()
    support = texf.fields[0].support
    counts = {"voxels": len(support), "faces": len(texf.faces),
              "samples": samples_of(texf, support.size) if isinstance(support, VoxelSupport) else 0}
    print(json.dumps({"seconds": seconds, "memory": held["peak"] - held["idle"], "counts": counts}))


if __name__ == "__main__":
    main()
