"""How fast the memory of a process grows that does the same thing again and again.

python tools/proof/load_slope.py KIND CALLS      one kind in this process, its answer as JSON on stdout
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.proof.load_scenes import small_scenes
from tools.proof.memory import resident

REPOSITORY = Path(__file__).resolve().parents[2]
CALLS, TARGET = 500, 20_000  # of a kind; bytes a call
WARM = 0.3  # the first part of the calls, in which caches and the allocator's arenas fill
POINTS = 2000
REFUSED_AT_ONCE = 25  # faulty vectors that one call reads


def slope_of(call, count, warm=WARM):
    """Calls call(i) for i below count. {"calls", "bytes a call", "error", "first", "last"}: the slope of resident memory by least
    squares after the first part of the calls, its standard error, and the memory at the ends of what was fitted."""
    sizes = np.zeros(count)
    for i in range(count):
        call(i)
        sizes[i] = resident("VmRSS")
    begin = int(warm * count)
    number, size = np.arange(begin, count), sizes[begin:]
    centred = number - number.mean()
    slope = centred @ size / (centred @ centred)
    left = size - size.mean() - slope * centred
    error = np.sqrt(left @ left / max(len(left) - 2, 1) / (centred @ centred))
    return {"calls": count, "bytes a call": round(float(slope)), "error": round(float(error)), "first": int(size[0]),
            "last": int(size[-1])}


# What is done again and again


def encodes():
    """Every scene in turn is coded."""
    from texfcodec.encoder.encode import encode_scene

    turns = list(small_scenes().values())
    return lambda i: encode_scene(*turns[i % len(turns)])


def decodes():
    """Every stream in turn is decoded."""
    from texfcodec.api import decode

    streams = _streams()
    return lambda i: decode(streams[i % len(streams)])


def both():
    """Every scene in turn is coded and decoded."""
    from texfcodec.api import decode
    from texfcodec.encoder.encode import encode_scene

    turns = list(small_scenes().values())
    return lambda i: decode(encode_scene(*turns[i % len(turns)]).data)


def queries():
    """Every decoded asset in turn is asked for the colours at random points."""
    texfs, rng = _decoded(), np.random.default_rng(0)

    def call(i):
        texf = texfs[i % len(texfs)]
        face = rng.integers(0, len(texf.faces), POINTS)
        texf.query(texf.positions[texf.faces[face]].mean(axis=1), face)

    return call


def saves():
    """Every decoded asset in turn is saved as GLB."""
    texfs, folder = _decoded(), tempfile.TemporaryDirectory()

    def call(i):
        texfs[i % len(texfs)].save(Path(folder.name) / "a.glb", texture_size=64)

    return call


def refusals():
    """Faulty conformance vectors in turn are refused."""
    from texfcodec.api import decode
    from texfcodec.errors import TexfError

    streams = itertools.cycle([path.read_bytes() for path in sorted((REPOSITORY / "conformance" / "faulty").glob("*/in.texf"))])

    def call(i):
        for data in itertools.islice(streams, REFUSED_AT_ONCE):
            try:
                decode(data)
            except TexfError:
                pass

    return call


KINDS = {"encode": encodes, "decode": decodes, "encode and decode": both, "query": queries, "save GLB": saves,
         f"{REFUSED_AT_ONCE} faulty vectors refused": refusals}


def _streams():
    from texfcodec.encoder.encode import encode_scene

    return [encode_scene(scene, options).data for scene, options in small_scenes().values()]


def _decoded():
    from texfcodec.api import decode

    return [decode(stream) for stream in _streams()]


def measured(kind, calls):
    """What slope_of() says of a kind, measured in a process of its own, whose allocator has one arena: glibc gives threads one
    each until there are eight a core, and what an arena keeps looks like a leak until all are in use."""
    run = subprocess.run([sys.executable, __file__, kind, str(calls)], stdout=subprocess.PIPE, check=True, cwd=REPOSITORY,
                         env={**os.environ, "PYTHONPATH": str(REPOSITORY), "MALLOC_ARENA_MAX": "1"})
    return json.loads(run.stdout)


def run_slopes(calls=CALLS):
    """{kind: what slope_of() says}, each kind in a process of its own."""
    found = {}
    for kind in KINDS:
        found[kind] = measured(kind, calls)
        print(f"{kind}: {found[kind]['bytes a call']} bytes a call", flush=True)
    return found


def slope_faults(found):
    """What misses the target: sentences."""
    return [f"{kind}: {row['bytes a call']:,} bytes a call" for kind, row in found.items() if row["bytes a call"] > TARGET]


if __name__ == "__main__":
    print(json.dumps(slope_of(KINDS[sys.argv[1]](), int(sys.argv[2]))))
