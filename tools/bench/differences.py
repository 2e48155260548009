"""BD-rates of groups of settings against others, asset by asset, with how much of both curves they speak for."""

from dataclasses import dataclass

import numpy as np

from texfcodec.metrics.bd_rate import bd_rate
from tools.bench.results import curve_of, grouped, measures_of


@dataclass(frozen=True)
class Difference:
    """percent: BD-rate, None where there is none, and then reason says why. overlap: the part of each curve's range of quality
    that the other has as well, 0..1, of the two the smaller."""

    percent: float | None
    overlap: float | None
    reason: str | None


@dataclass(frozen=True)
class Pair:
    """Two groups to compare. name, other: how they are called; rows, anchor: {asset: rows} of each."""

    name: str
    other: str
    rows: dict
    anchor: dict

    def differences(self, kind):
        """{asset: {measure: Difference}} for the assets that both have, by the measures that some of their rows have."""
        shared = [asset for asset in self.rows if asset in self.anchor]
        measures = measures_of([row for asset in shared for side in (self.rows, self.anchor) for row in side[asset]])
        return {asset: {measure: difference(self.anchor[asset], self.rows[asset], measure, kind) for measure in measures}
                for asset in shared}


def pairs_of(rows, anchors, group=None, anchor_group=None):
    """[Pair] to compare. anchors: rows of another folder, or None."""
    ours = grouped(rows)
    theirs = ours if anchors is None else grouped(anchors)
    for name, known in ((group, ours), (anchor_group, theirs)):
        if name is not None and name not in known:
            raise SystemExit(f"there is no group {name!r}, only {', '.join(known)}")
    pairs = []
    for name in [group] if group else ours:
        other = anchor_group or (name if name in theirs else next(iter(theirs)) if len(theirs) == 1 else None)
        if other is None:
            raise SystemExit(f"the anchor has no group {name!r}; say which with --anchor-group: {', '.join(theirs)}")
        shared = group is not None or any(asset in theirs[other] for asset in ours[name])
        if shared and (anchors is not None or name != other):
            pairs.append(Pair(name, other, ours[name], theirs[other]))
    return pairs


def rate_difference(anchor, rows, measure, kind="texture"):
    """BD-rate of one curve's rows against an anchor's in one of MEASURES, in percent; ValueError says why there is none."""
    return bd_rate(*curve_of(anchor, measure, kind), *curve_of(rows, measure, kind))


def difference(anchor, rows, measure, kind):
    """rate_difference() as a Difference."""
    try:
        percent, reason = rate_difference(anchor, rows, measure, kind), None
    except ValueError as error:
        percent, reason = None, str(error)
    return Difference(percent, overlap_of(curve_of(anchor, measure, kind)[1], curve_of(rows, measure, kind)[1]), reason)


def overlap_of(a, b):
    """The part of each list's range that the other has as well, 0..1, of the two the smaller; None where one has no range."""
    if min(len(a), len(b)) < 2:
        return None
    shared, longest = min(max(a), max(b)) - max(min(a), min(b)), max(max(a) - min(a), max(b) - min(b))
    return max(shared, 0.0) / longest if longest > 0 else None


def summary(differences, of=np.mean):
    """(of(percents), their number) of the Differences that have one; (None, 0) without."""
    values = [difference.percent for difference in differences if difference.percent is not None]
    return (float(of(values)), len(values)) if values else (None, 0)
