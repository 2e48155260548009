"""Points a second of the kernels and of whole pipelines on a synthetic surface of about 0.6 million voxels (K = 512).

`make bench`, or pytest bench --benchmark-only; the extra column points_per_second is in the JSON (--benchmark-json). Whole
processes with their start, memory and targets: python bench/run.py.
"""

import numpy as np
import pytest
from surface import torus

from texfcodec.api import decode
from texfcodec.codecs.raht.attribute_coder import dec_attributes, enc_attributes
from texfcodec.codecs.raht.transform.colour import forward_colour, inverse_colour
from texfcodec.codecs.raht.transform.octree import build_octree
from texfcodec.codecs.raht.transform.prediction import DEFAULT_KERNEL
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.field.extents import octree_depth
from texfcodec.field.grid import build_brick_map
from texfcodec.field.morton import decode_morton
from texfcodec.field.query import query_field
from texfcodec.field.transfer import transfer
from texfcodec.field.voxelise import voxelise
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.scene.fetch import pack_source

RESOLUTION, QP = 512, [28, 27, 27]
OPTIONS = EncodeOptions(resolution=RESOLUTION, qp=28)


@pytest.fixture(scope="module")
def field():
    """Everything the kernels take: surface, source, keys, brick map and colour values."""
    scene = torus()
    surface = make_surface(scene, OPTIONS)
    keys, _ = voxelise(surface.lattice, surface.faces, OPTIONS.position_bits, RESOLUTION)
    brick_map, source = build_brick_map(keys), pack_source(scene, surface.origin_face)
    colour, _ = transfer(surface.lattice, surface.faces, source, OPTIONS.position_bits, RESOLUTION, keys, brick_map)
    return {"scene": scene, "surface": surface, "keys": keys, "map": brick_map, "source": source, "colour": colour,
            "values": forward_colour(colour)}


def timed(benchmark, points, function):
    """Runs the benchmark and notes points a second of its best round."""
    result = benchmark.pedantic(function, rounds=5, iterations=1, warmup_rounds=1)
    if benchmark.stats:
        benchmark.extra_info["points"] = points
        benchmark.extra_info["points_per_second"] = round(points / benchmark.stats.stats.min)
    return result


@pytest.mark.parametrize("threads", [1, 2])
def test_voxelise(benchmark, field, threads):
    s = field["surface"]
    keys, _ = timed(benchmark, len(field["keys"]),
                    lambda: voxelise(s.lattice, s.faces, OPTIONS.position_bits, RESOLUTION, threads=threads))
    assert len(keys) == len(field["keys"])


@pytest.mark.parametrize("threads", [1, 2])
def test_transfer(benchmark, field, threads):
    s = field["surface"]
    colour, _ = timed(benchmark, len(field["keys"]),
                      lambda: transfer(s.lattice, s.faces, field["source"], OPTIONS.position_bits, RESOLUTION, field["keys"],
                                       field["map"], threads=threads))
    np.testing.assert_array_equal(colour, field["colour"])


def test_octree(benchmark, field):
    levels = timed(benchmark, len(field["keys"]), lambda: build_octree(field["keys"], octree_depth(RESOLUTION)))
    assert levels[0].weight.tolist() == [len(field["keys"])]


@pytest.mark.parametrize("threads", [1, 2])
def test_enc_attributes(benchmark, field, threads):
    unit, _ = timed(benchmark, len(field["keys"]), lambda: enc_attributes(
        field["keys"], octree_depth(RESOLUTION), field["values"], QP, DEFAULT_KERNEL, threads))
    assert unit.codewords


@pytest.mark.parametrize("threads", [1, 2])
def test_dec_attributes(benchmark, field, threads):
    depth = octree_depth(RESOLUTION)
    unit, expected = enc_attributes(field["keys"], depth, field["values"], QP, DEFAULT_KERNEL)
    data, ends = np.frombuffer(b"".join(unit.codewords), np.uint8), np.cumsum([0] + [len(c) for c in unit.codewords]).tolist()
    spans = list(zip(ends[:-1], ends[1:], strict=True))
    means = timed(benchmark, len(field["keys"]), lambda: dec_attributes(field["keys"], depth, unit, data, spans, depth, threads))
    np.testing.assert_array_equal(means, expected)


def test_colour_both_ways(benchmark, field):
    rgb = timed(benchmark, len(field["keys"]), lambda: inverse_colour(forward_colour(field["colour"])))
    assert np.abs(rgb - field["colour"]).max() <= 1


def test_query(benchmark, field):
    centres = decode_morton(field["keys"][::3]) + np.random.default_rng(1).uniform(0, 1, (len(field["keys"][::3]), 3))
    answers, missed = timed(benchmark, len(centres),
                            lambda: query_field(centres, RESOLUTION, field["keys"], field["map"], field["colour"]))
    assert answers.min() >= 0 and answers.max() <= 255.5 and not missed.any()


def test_encode(benchmark, field):
    data = timed(benchmark, len(field["keys"]), lambda: encode_scene(field["scene"], OPTIONS)).data
    assert len(data) > 1000


def test_decode(benchmark, field):
    data = encode_scene(field["scene"], OPTIONS).data
    assert timed(benchmark, len(field["keys"]), lambda: decode(data)).fields
