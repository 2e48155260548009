"""Points that ask (clauses 8.1, 8.2 and 11.2): queries of the vectors, and reference decoders with a wrong rule."""

import json
from fractions import Fraction
from math import floor

import numpy as np
import pytest
from test_conformance import ReferenceDecoder

from conformance import run as runner
from conformance.reference import queries, texels
from conformance.reference.voxels import clip
from texfcodec import decode

VECTORS = runner.HERE
ASKED = sorted(path.parent.relative_to(VECTORS).as_posix() for path in VECTORS.glob("*/*/queries.json"))


def questions(name):
    """All queries of a vector."""
    return [query for of_lod in runner.queries_of(VECTORS / name)["lods"].values() for query in of_lod]


def test_queries_hold_what_they_are_for():
    every = [query for name in ASKED for query in questions(name)]
    found = {query["why"] for query in every}
    assert {"the centre of a voxel", "midway between 2 centres", "midway between 4 centres", "midway between 8 centres",
            "as near to several centres", "on the surface", "far outside", "further than 10^6 voxels", "a border of texels",
            "the border of the image", "just beyond the border of the image", "on a face whose UVs have no area",
            "where the order of 8.1 decides", "between faces, no face known"} <= found
    assert len(every) > 1000 and sum(len(query["answers"]) > 1 for query in every) > 50
    assert all(np.isfinite([float.fromhex(p) for p in query["point"]]).all() for query in every)


def test_sheets_that_are_equally_near_may_both_answer():
    nobody = [query for query in questions("uncommon/queries_sheets") if query["field"] < 0]
    assert any(len(query["answers"]) > 1 for query in nobody) and any(len(query["answers"]) == 1 for query in nobody)


def test_public_query_gives_the_same_answers():
    told = [query for query in runner.queries_of(VECTORS / "subset/k3")["lods"]["0"] if len(query["answers"]) == 1]
    points = np.array([[float.fromhex(p) for p in query["point"]] for query in told])
    wanted = np.array([query["answers"][0] for query in told])
    assert np.abs(decode((VECTORS / "subset/k3/in.texf").read_bytes()).query(points)[:, :3] - wanted).max() <= 0.01


def rounded_once(point, header):
    """Clause 11.2 without binary64."""
    grid = queries.grid_point(queries.lattice_point(point, header), header["position_bits"], 2**24)
    return tuple(floor(clip(0, 2**24 - 1, v)) for v in grid)


@pytest.mark.parametrize("name, module, rule, wrong", [
    ("subset/k3", queries, "trilinear", lambda x, cells: None),
    ("subset/k3", queries, "nearest", lambda x, cells: [max(cells.values())]),
    ("uncommon/queries_sheets", queries, "FACES_EQUALLY_NEAR", 10),
    ("uncommon/texels_flat", queries, "on_plane", lambda point, corners: [1, 1, 1]),
    ("uncommon/texels_clamp", texels, "fold", lambda mode, u, size: u - size * (u // size)),
    ("uncommon/texels_mirror", texels, "fold", lambda mode, u, size: clip(-1, size + 1, u)),
    ("uncommon/texels_low", texels, "fold", lambda mode, u, size: clip(-1, size + 1, u)),
    ("uncommon/maps_shift_texels", queries.Asked, "level", lambda self, field, group: field["left_out"]),
    ("uncommon/neural_shortest_waves", queries, "position_of", rounded_once),
])
def test_decoder_with_a_wrong_rule_answers_wrong(monkeypatch, name, module, rule, wrong):
    monkeypatch.setattr(module, rule, wrong)
    try:
        faults = runner.faults_of(ReferenceDecoder(), VECTORS / name)
    except (ValueError, IndexError, TypeError):  # cells of another level: not one for one with the values
        return
    assert faults and "queries are answered wrong" in faults[0]


def test_runner_takes_any_right_answer_as_a_whole_and_no_mixture():
    told = {"components": [2], "tolerance": 0.01}
    asked = [{"why": "a tie", "answers": [[1, 2], [3, None]]}]
    said = lambda *numbers: runner.faults_of_answers({"group0_answers.bin": np.array(numbers, "<f8").tobytes()}, asked, told)
    assert said(1, 2.009) == said(3, np.nan) == said(2.995, 99) == []
    assert "1 of 1 queries" in said(1, 3)[0] and "(a tie)" in said(1, np.nan)[0] and said(np.nan, 2) and said(1)


def test_point_on_a_face_without_area_is_taken_to_its_longest_reach():
    line = [[0, 0, 0], [4, 0, 0], [2, 0, 0]]
    for x, wanted in ((-3, 0), (1, 1), (9, 4)):
        away, weights = queries.nearest_on_face([Fraction(x), Fraction(5), Fraction(0)], line)
        assert queries.blend(weights, line) == [wanted, 0, 0] and away == (x - wanted) ** 2 + 25
    assert queries.nearest_on_face([Fraction(1, 3)] * 3, [[1, 1, 1]] * 3)[0] == Fraction(4, 3)


def test_queries_are_written_as_the_runner_packs_them():
    asked = [{"field": -1, "triangle": 7, "point": [(0.1).hex(), (-2.0**80).hex(), (0.0).hex()]}]
    assert queries.read_queries(runner.packed(asked)) == [(-1, 7, [0.1, -(2.0**80), 0.0])]
    assert json.loads((VECTORS / "subset/k3/queries.json").read_text())["components"] == [3]
