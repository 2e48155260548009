"""Points a second of the kernels, and seconds of whole pipelines, pictures, metrics and processes, on the demo asset at K = 512.

`make bench` keeps each run in pytest-benchmark's own storage and compares it with the one before. The extra column
points_per_second is in the JSON (--benchmark-json). All are seconds of the processor, which other work disturbs least.
"""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from texfcodec.api import decode
from texfcodec.codecs.raht.attribute_coder import dec_attributes, enc_attributes
from texfcodec.codecs.raht.transform.colour import forward_colour, inverse_colour
from texfcodec.codecs.raht.transform.octree import build_octree
from texfcodec.demo.asset import make_sample, write_sample
from texfcodec.encoder.encode import encode_scene
from texfcodec.field.extents import octree_depth
from texfcodec.field.grid import build_brick_map
from texfcodec.field.morton import decode_morton
from texfcodec.field.query import query_field
from texfcodec.field.transfer import transfer
from texfcodec.field.voxelise import voxelise
from texfcodec.geometry.surface import make_surface
from texfcodec.metrics.views import compare_views
from texfcodec.options import EncodeOptions, default_threads
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.shade import render_scene, render_texf
from texfcodec.scene.fetch import pack_source

RESOLUTION, QP, SIDE = 512, [28, 27, 27], 2048
DEPTH, OPTIONS = octree_depth(RESOLUTION), EncodeOptions(resolution=RESOLUTION, qp=28, support="voxels")
KERNELS = {
    "voxelise": lambda f, threads: voxelise(*f["place"], threads=threads),
    "transfer": lambda f, threads: transfer(*f["place"][:2], f["source"], *f["place"][2:], f["keys"], f["map"], threads=threads),
    "octree": lambda f, threads: build_octree(f["keys"], DEPTH),
    "enc_attributes": lambda f, threads: enc_attributes(f["keys"], DEPTH, f["values"], QP, threads=threads),
    "dec_attributes": lambda f, threads: dec_attributes(f["keys"], DEPTH, *f["coded"], DEPTH, threads),
    "colour_both_ways": lambda f, threads: inverse_colour(forward_colour(f["colour"])),
    "query": lambda f, threads: query_field(f["points"], RESOLUTION, f["keys"], f["map"], f["colour"]),
    "encode": lambda f, threads: encode_scene(f["scene"], OPTIONS),
    "decode": lambda f, threads: decode(f["stream"]),
    "view_from_textures": lambda f, threads: render_scene(f["scene"], f["camera"], threads=threads),
    "view_from_field": lambda f, threads: render_texf(f["texf"], f["camera"], filtering=False, threads=threads),
    "metric_of_16_views": lambda f, threads: compare_views(f["scene"], f["texf"], threads=threads),
}


@pytest.fixture(scope="module")
def field():
    """What the kernels take."""
    scene = make_sample()
    surface = make_surface(scene, OPTIONS)
    place = surface.lattice, surface.faces, OPTIONS.position_bits, RESOLUTION
    keys, _ = voxelise(*place)
    brick_map, source = build_brick_map(keys), pack_source(scene, surface.origin_face)
    colour, _ = transfer(*place[:2], source, *place[2:], keys, brick_map)
    unit, _ = enc_attributes(keys, DEPTH, forward_colour(colour), QP)
    ends = np.cumsum([0] + [len(c) for c in unit.codewords]).tolist()
    coded = unit, np.frombuffer(b"".join(unit.codewords), np.uint8), list(zip(ends[:-1], ends[1:], strict=True))
    stream = encode_scene(scene, OPTIONS).data
    return {"scene": scene, "place": place, "keys": keys, "map": brick_map, "source": source, "colour": colour,
            "values": forward_colour(colour), "coded": coded, "stream": stream, "texf": decode(stream),
            "points": decode_morton(keys[::3]) + 0.5,
            "camera": orthographic(fibonacci_direction(3, 16), *bounding_sphere(scene.positions), SIDE)}


@pytest.mark.parametrize("threads", [1, default_threads()])
@pytest.mark.parametrize("name", KERNELS)
def test_speed(benchmark, field, name, threads):
    result = benchmark.pedantic(lambda: KERNELS[name](field, threads), rounds=5, iterations=1, warmup_rounds=1)
    if benchmark.stats:
        benchmark.extra_info["points_per_second"] = round(len(field["keys"]) / benchmark.stats.stats.min)
    assert result is not None


def with_children():
    """Processor seconds of this process and of those that it has waited for."""
    return time.process_time() + sum(os.times()[2:4])


@pytest.mark.benchmark(timer=with_children)
@pytest.mark.parametrize("tool, words", [("enc", ("sample.glb", "sample.texf")), ("dec", ("sample.texf", "out.glb"))])
def test_process(benchmark, tool, words, tmp_path):
    write_sample(tmp_path / "sample.glb")
    enc = "enc", "sample.glb", "sample.texf"
    for name, *files in (enc, (tool, *words)):  # what dec reads, and compiled kernels
        run_tool(name, files, tmp_path)
    benchmark.pedantic(lambda: run_tool(tool, words, tmp_path), rounds=3, iterations=1)


def run_tool(name, files, folder):
    """A process of texf-enc or texf-dec in a folder."""
    subprocess.run([sys.executable, "-m", f"texfcodec.cli.{name}", *files, "--quiet"], cwd=folder, check=True)
