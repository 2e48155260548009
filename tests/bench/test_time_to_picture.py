"""Time to picture: which pairs are compared, and below which link ours is first."""

import json
from math import inf
from pathlib import Path

import pytest

from tools.bench.time_to_picture import RIVALS, Side, crossover, pairs_of


def test_ours_is_not_worse_unless_the_rival_has_no_lower_quality():
    rows = [json.loads(line) for line in (Path(__file__).parents[2] / "tools/bench/ladders.jsonl").read_text().splitlines()]
    pairs = pairs_of(rows)
    assert len(pairs) == 8 * len(RIVALS)
    for pair in pairs:
        lowest = min(row["psnr"] for row in rows if (row["asset"], row["tool"], row["effort"]) == (
            pair.asset, pair.tool, pair.theirs["effort"]) and row["threads"] == 1)
        assert pair.ours["psnr"] >= pair.theirs["psnr"] or pair.ours["point"] == "r03" and pair.theirs["psnr"] == lowest


@pytest.mark.parametrize("ours, theirs, more, link", [
    ((100_000, 2.0, 0.5), (600_000, 0.25, 0.25), 0, 2.0), ((100_000, 2.0, 0.5), (600_000, 0.25, 0.25), 250_000, 1.0),
    ((100_000, 0.1, 0.1), (600_000, 0.2, 0.2), 0, inf), ((600_000, 2.0, 0.5), (100_000, 0.2, 0.2), 0, 0.0),
])
def test_both_are_first_at_the_crossover(ours, theirs, more, link):
    assert crossover(Side(*ours), Side(*theirs), more) == pytest.approx(link)
    if 0 < link < inf:
        assert Side(ours[0] + more, *ours[1:]).at(link) == pytest.approx(Side(*theirs).at(link))
