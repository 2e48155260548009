"""From measured settings to claims: bytes at equal quality, Pareto fronts, dominated settings, and what one more second buys.

A setting is dominated where another is no worse in each cost and better in one. Seconds that differ by NOISE or less count as
equal, and better is from 0.1 % of bytes and 0.01 dB on; of seconds alone there is slack, so that no two dominate each other.
Bytes at equal quality: percent of bytes above the rate curve that the defaults have over QP at the same support, at the setting's
own dB. So settings of different bytes and decibels become one number.
"""

import math
import statistics
from collections import Counter
from dataclasses import dataclass, field

from texfcodec.encoder.explain import BETTER, DOMINATED, NOISE, per_second, verdict
from texfcodec.metrics.bd_rate import difference_at
from tools.bench.accuracy_bench import PROCESSOR, WALL, Measured, key_of
from tools.bench.accuracy_knobs import AUTO, KNOBS, QP, STREAM, Knob, Place, curve_settings, encode_setting, name_of

SECONDS, BYTES, DECIBELS = (math.log1p(NOISE), math.log1p(NOISE)), (0.0, 0.001), (0.0, 0.01)  # (slack, gain); logarithms, -dB
PERCENT, ERROR = (0.0, 0.1), (0.0, 0.005)  # of bytes at equal quality; dB off the reference


def dominates(a, b, axes):
    """Whether costs a are no worse than costs b throughout and better in one. axes: (slack, gain) of each cost: what may be
    worse and counts as no worse, and what counts as better only from the gain on."""
    sides = list(zip(a, b, axes, strict=True))
    return all(x <= y + slack for x, y, (slack, _) in sides) and any(x < y - gain for x, y, (_, gain) in sides)


def dominators(costs, axes):
    """For each of the costs the indices of those that dominate it; the front are those with an empty list."""
    return [[i for i, a in enumerate(costs) if dominates(a, b, axes)] for b in costs]


@dataclass
class Row:
    """A value of a knob on one asset. percent: bytes above the defaults' curve at equal quality, None where it does not say;
    error: root mean square of a metric's errors in dB; by: names of the values of the same knob that dominate it; measured:
    None for what has not been measured."""

    knob: Knob
    value: object
    measured: Measured
    seconds: tuple
    percent: float | None = None
    error: float | None = None
    by: list = field(default_factory=list)

    @property
    def name(self):
        return name_of(self.value)

    @property
    def is_default(self):
        return self.value == self.knob.default

    @property
    def quality(self):
        """dB that the knob is judged by."""
        return self.measured.image_y if self.knob.image else self.measured.psnr_y


@dataclass
class Asset:
    """What was measured of one asset. clock: whose seconds the claims are made from; rows: {knob's name: [Row]}."""

    name: str
    place: Place
    clock: str
    spread: float
    rows: dict
    geometry: float = 0.0


def asset_of(name, place, measured, quick=False):
    """Asset of {key: Measured}; knobs that were not measured are left out."""
    spreads = [m.spread for m in measured.values() if m.spread is not None]
    spread = statistics.median(spreads) if spreads else math.inf
    clock = WALL if spread <= NOISE else PROCESSOR
    asset = Asset(name, place, clock, spread, {})
    for knob in KNOBS:
        found = {value: measured.get(key_of(setting)) for value, setting in knob.settings(place, quick).items()}
        rows = [Row(knob, value, m, m.seconds[WALL if knob.name == "threads" else clock]) for value, m in found.items() if m]
        if rows:
            _fill(rows, place, measured, quick)
            asset.rows[knob.name] = rows
    base = measured.get(key_of(encode_setting(place.base(place.home) | {"qp": QP}, True)))
    asset.geometry = base.geometry / base.bytes if base else 0.0
    return asset


def _fill(rows, place, measured, quick):
    """percent or error, and by, of the rows of one knob."""
    knob = rows[0].knob
    curve = [] if knob.over == STREAM else _curve(knob, place, measured, quick)
    for row in rows:
        if knob.over == STREAM:
            errors = row.measured.errors
            row.error = math.sqrt(statistics.fmean(e * e for e in errors)) if errors else None
        else:
            row.percent = percent_at(curve, row)
    if knob.name == "QP":  # it is the curve
        return
    known, costs, axes = _costs(rows)
    for row, beaten in zip(known, dominators(costs, axes), strict=True):
        row.by = [known[i].name for i in beaten]


def _costs(rows):
    """(rows that can be compared, their costs, the axes of these): seconds with a metric's error, or with bytes at equal quality;
    where no curve says these, with bytes and dB."""
    key, axis = ("error", ERROR) if rows[0].knob.over == STREAM else ("percent", PERCENT)
    known = [row for row in rows if getattr(row, key) is not None]
    if known or key == "error":
        return known, [(math.log(r.seconds[0]), getattr(r, key)) for r in known], (SECONDS, axis)
    known = [row for row in rows if row.quality is not None]
    costs = [(math.log(r.seconds[0]), math.log(r.measured.bytes), -r.quality) for r in known]
    return known, costs, (SECONDS, BYTES, DECIBELS)


def _curve(knob, place, measured, quick):
    """[(bytes, dB)] of the defaults over QP, for a knob, less what another QP beats in both; empty where there is none."""
    over = place.curve(knob.over)
    found = [measured.get(key_of(setting)) for setting in curve_settings(place, over, quick)] if over else []
    points = [(m.bytes, m.image_y if knob.image else m.psnr_y) for m in found if m]
    points = sorted((size, quality) for size, quality in points if quality is not None and math.isfinite(quality))
    return [point for i, point in enumerate(points) if all(quality < point[1] for _, quality in points[:i])]


def percent_at(curve, row):
    """Percent of bytes of a Row above the curve at its own quality; None beyond the curve's ends, and where the curve is none."""
    quality = row.quality
    if quality is None or len(curve) < 2 or not min(q for _, q in curve) - 1 <= quality <= max(q for _, q in curve) + 1:
        return None
    try:
        return difference_at([size for size, _ in curve], [q for _, q in curve], row.measured.bytes, quality)
    except ValueError:
        return None


def beaten_presets(asset):
    """{preset: names of settings that dominate it in seconds, bytes and dB}, among those that leave as much to the encoder."""
    rows = [row for rows in asset.rows.values() for row in rows if row.knob.over == AUTO and not row.knob.hindsight]
    costs = [(math.log(r.seconds[0]), math.log(r.measured.bytes), -r.measured.psnr_y) for r in rows]
    found = dominators(costs, (SECONDS, BYTES, DECIBELS))
    return {row.value: sorted({f"{rows[i].knob.name} {rows[i].name}" for i in by}) for row, by in zip(rows, found, strict=True)
            if row.knob.name == "preset"}


def to_change(assets):
    """[(what, assets that say so, number of assets asked, what beats it there)]: presets, and defaults of knobs, that are
    dominated on an asset; those dominated on most assets first."""
    votes, asked, better = {}, Counter(), {}
    for asset in assets:
        judged = {f"preset {name}": by for name, by in beaten_presets(asset).items()}
        judged |= {f"{name}: {row.name}": row.by for name, rows in asset.rows.items() if name != "preset"
                   for row in rows if row.is_default and not row.knob.hindsight}
        for what, by in judged.items():
            asked[what] += 1
            if by:
                votes.setdefault(what, []).append(asset.name)
                better.setdefault(what, []).append(f"{asset.name}: {', '.join(by[:2])}")
    rows = [(what, names, asked[what], better[what]) for what, names in votes.items()]
    return sorted(rows, key=lambda row: -len(row[1]) / row[2])


@dataclass
class Step:
    """A step of a knob from its default. trades: {asset: (seconds more, percent of bytes more, verdict)}."""

    knob: Knob
    value: object
    trades: dict

    @property
    def seconds(self):
        return statistics.median(trade[0] for trade in self.trades.values())

    @property
    def percent(self):
        return statistics.median(trade[1] for trade in self.trades.values())

    @property
    def verdict(self):
        """What most assets say."""
        return Counter(trade[2] for trade in self.trades.values()).most_common(1)[0][0]

    @property
    def bought(self):
        """Percent of bytes that a second more buys or a second less costs, median over the assets where it is a trade."""
        found = [value for seconds, percent, word in self.trades.values()
                 if word not in (BETTER, DOMINATED) and (value := per_second(1e9, 1e9 + seconds, percent, 0.0)) is not None]
        return statistics.median(found) if found else None


def steps_of(assets):
    """[Step]: for each knob of encodes, the values next to the default, below and above."""
    steps = []
    for knob in KNOBS:
        if knob.over == STREAM or knob.name in ("preset", "QP"):
            continue
        trades = {}
        for asset in assets:
            rows = [row for row in asset.rows.get(knob.name, []) if row.percent is not None]
            place = next((i for i, row in enumerate(rows) if row.is_default), None)
            for row in [] if place is None else rows[max(place - 1, 0): place] + rows[place + 1: place + 2]:
                base, percent = rows[place], 100 * ((100 + row.percent) / (100 + rows[place].percent) - 1)
                word = verdict(base.seconds[0], row.seconds[0], percent)
                trades.setdefault(row.value, {})[asset.name] = (row.seconds[0] - base.seconds[0], percent, word)
        steps += [Step(knob, value, trades[value]) for value in knob.values if value in trades]
    return steps

