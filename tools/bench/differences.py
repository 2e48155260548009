"""BD-rates of groups of settings against others, asset by asset, with how much of both curves they speak for."""

from dataclasses import dataclass

import numpy as np

from texfcodec.metrics.bd_rate import bd_rate
from tools.bench.results import curve_of, grouped, measures_of


@dataclass(frozen=True)
class Difference:
    """A BD-rate. percent: of rate at equal quality, None without one; reason: why there is none; overlap: the smaller of the
    shares 0..1 of each curve's quality range that the other covers."""

    percent: float | None
    overlap: float | None
    reason: str | None


@dataclass(frozen=True)
class Pair:
    """Two groups of settings to compare. name, other: their names; rows, anchor: {asset: rows} of each."""

    name: str
    other: str
    rows: dict
    anchor: dict

    def differences(self, kind):
        """Return {asset: {measure: Difference}} for the assets and measures of both groups. kind: "total" or "texture" bytes."""
        shared = [asset for asset in self.rows if asset in self.anchor]
        measures = measures_of([row for asset in shared for side in (self.rows, self.anchor) for row in side[asset]])
        return {asset: {measure: difference(self.anchor[asset], self.rows[asset], measure, kind) for measure in measures}
                for asset in shared}


def pairs_of(rows, anchors, group=None, anchor_group=None):
    """Return the [Pair] of groups to compare. anchors: rows of another folder, None to compare groups of rows themselves."""
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
    """Return the BD-rate of rows against an anchor's in one of MEASURES, in percent. Raises ValueError if there is none."""
    return bd_rate(*curve_of(anchor, measure, kind), *curve_of(rows, measure, kind))


def difference(anchor, rows, measure, kind):
    """Return rate_difference() as a Difference, which has the reason if there is none."""
    try:
        percent, reason = rate_difference(anchor, rows, measure, kind), None
    except ValueError as error:
        percent, reason = None, str(error)
    return Difference(percent, overlap_of(curve_of(anchor, measure, kind)[1], curve_of(rows, measure, kind)[1]), reason)


def overlap_of(a, b):
    """Return the smaller of the shares 0..1 of two lists' ranges that the other covers; None if a list has no range."""
    if min(len(a), len(b)) < 2:
        return None
    shared, longest = min(max(a), max(b)) - max(min(a), min(b)), max(max(a) - min(a), max(b) - min(b))
    return max(shared, 0.0) / longest if longest > 0 else None


def summary(differences, of=np.mean):
    """Return (of(percents), their number) over the Differences that have a percent; (None, 0) without. of: mean or median."""
    values = [difference.percent for difference in differences if difference.percent is not None]
    return (float(of(values)), len(values)) if values else (None, 0)
