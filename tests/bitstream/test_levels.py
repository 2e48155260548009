"""Levels (spec 10.1): what a stream needs is what the limits refuse, and its level follows from that."""

import json
from dataclasses import replace

import pytest
from conftest import REPOSITORY

from texfcodec.api import decode, inspect
from texfcodec.errors import LimitError
from texfcodec.limits import LEVELS, Limits, level_of
from texfcodec.options import DecodeOptions

BOUNDED = [name for name in Limits.__dataclass_fields__ if not name.startswith(("isolate", "image"))]  # of streams
VECTORS = ["subset/two_fields", "subset/metadata", "subset/texels", "subset/neural_resident"]


def stream_of(vector):
    return (REPOSITORY / "conformance" / vector / "in.texf").read_bytes()


@pytest.mark.parametrize("vector", VECTORS)
def test_a_stream_decodes_within_what_it_needs_and_not_within_one_less(vector):
    """Samples and voxels that are touched and dropped again are known only when the surface is."""
    data = stream_of(vector)
    needs = inspect(data)["needs"]
    within = Limits(**needs | {"voxels": 3 * needs["voxels"]})
    decode(data, DecodeOptions(limits=within, threads=1))
    for name, count in needs.items():
        if count > 1:  # a limit of 0 is none
            with pytest.raises(LimitError):
                decode(data, DecodeOptions(limits=replace(within, **{name: count - 1}), threads=1))


def test_the_vectors_above_need_something_of_every_bound_that_their_headers_tell():
    every = [inspect(stream_of(vector))["needs"] for vector in VECTORS]
    assert {name for needs in every for name, count in needs.items() if count > 1} == set(BOUNDED) - {"samples"}


@pytest.mark.parametrize("name", BOUNDED)
def test_one_over_a_bound_is_the_next_level(name):
    for level, bounds in LEVELS.items():
        assert level_of({name: getattr(bounds, name)}) == level
        assert level_of({name: getattr(bounds, name) + 1}) == (level + 1 if level + 1 in LEVELS else None)


def test_the_last_level_is_what_the_decoder_takes_by_default():
    assert LEVELS[max(LEVELS)] == Limits()


def test_texf_info_says_the_level_and_that_the_surface_may_raise_it(call, monkeypatch):
    path = str(REPOSITORY / "conformance" / VECTORS[0] / "in.texf")
    assert "level: 1 by its counts; --verify" in call("texf-info", path)[1]
    assert "level: 1\n" in call("texf-info", path, "--verify")[1]
    monkeypatch.setitem(LEVELS, 1, replace(LEVELS[1], samples=10))
    assert json.loads(call("texf-info", path, "--json")[1])["level"] == 1
    assert json.loads(call("texf-info", path, "--verify", "--json")[1])["level"] == 2
