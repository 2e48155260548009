"""Hard cases with a bound each: the choices of a trial, and the worst of many trials, by seeds and by a search from there on.

A trial takes every number that it needs from its Draws, which remember the answers as numbers in 0..1. So one search serves all
cases: it changes some of the answers of the worst trial so far and plays it again. tools/proof/stability.py writes the page.
"""

import math
import re
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

TEST, PAGE, MOST = range(3)  # how large heavy cases are: in tests, for docs/reports/stability.md, and as large as they are run
CHANGED = 3  # answers that a step of the search changes at most


class Draws:
    """The choices of one trial. given: answers in 0..1 to begin with, further ones come from rng; size: TEST, PAGE or MOST."""

    def __init__(self, rng: np.random.Generator, given: Sequence[float] = (), size: int = TEST) -> None:
        self.rng, self.given, self.chosen, self.taken = rng, given, size, []

    def unit(self) -> float:
        """A number in 0..1, 1 left out but for answers of a search."""
        i = len(self.taken)
        self.taken.append(self.given[i] if i < len(self.given) else float(self.rng.random()))
        return self.taken[-1]

    def real(self, low: float, high: float) -> float:
        """A number in low..high."""
        return low + (high - low) * self.unit()

    def power(self, low: float, high: float, base: float = 10.0) -> float:
        """base to a power of low..high."""
        return base ** self.real(low, high)

    def integer(self, low: int, high: int) -> int:
        """A whole number in low..high, both included."""
        return min(low + int(self.unit() * (high - low + 1)), high)

    def pick(self, options: Sequence) -> object:
        """One of the options."""
        return options[self.integer(0, len(options) - 1)]

    def reals(self, shape: tuple, low: float, high: float) -> np.ndarray:
        """Numbers in low..high, float64, each a choice of its own."""
        return np.array([self.real(low, high) for _ in range(math.prod(shape))], np.float64).reshape(shape)

    def integers(self, shape: tuple, low: int, high: int) -> np.ndarray:
        """Whole numbers in low..high, int64, each a choice of its own."""
        return np.array([self.integer(low, high) for _ in range(math.prod(shape))], np.int64).reshape(shape)

    def generator(self) -> np.random.Generator:
        """A generator for what is too much to choose one by one; its seed is one choice."""
        return np.random.default_rng(self.integer(0, (1 << 32) - 1))

    def size(self, test: int, page: int, most: int) -> int:
        """How large a heavy case is."""
        return (test, page, most)[self.chosen]


@dataclass(frozen=True)
class Case:
    """bound: the largest value, in `unit`, that a trial may have; stress: what is hard; why: why the bound holds, with its clause
    of bitstream_spec.md; measure: function from Draws to the value of a trial, of which larger is worse; seeds: trials in
    the tests; search: whether searching pays; heavy: whether a trial for the page takes long, so that a few are enough."""

    name: str
    group: str
    bound: float
    unit: str
    stress: str
    why: str
    measure: Callable[[Draws], float]
    seeds: int = 6
    search: bool = True
    heavy: bool = False

    def worst(self) -> "Worst":
        """The worst trial of the tests."""
        return worst_of(self, trials=self.seeds)


class Group:
    """Cases about one subject; called as a decorator, it adds a measure, whose docstring says "Stress: ..." and "Bound: ..."."""

    def __init__(self, name: str) -> None:
        self.name, self.cases = name, []

    def __iter__(self) -> Iterator[Case]:
        return iter(self.cases)

    def __call__(self, name: str, bound: float, unit: str, **more: object) -> Callable:
        """Decorator of the measure of a case; more: fields of Case."""
        def add(measure: Callable[[Draws], float]) -> Callable[[Draws], float]:
            said = more.pop("text", None) or measure.__doc__
            _, stress, why = (" ".join(part.split()) for part in re.split(r"\n\s*(?:Stress|Bound): ", said))
            self.cases.append(Case(name, self.name, bound, unit, stress, why, measure, **more))
            return measure

        return add


@dataclass(frozen=True)
class Worst:
    """The worst trial of a case. answers: of its Draws; by: "seeds" or "search"; trials, seconds: of all; size: as in Draws."""

    value: float
    answers: tuple
    by: str
    trials: int = 0
    seconds: float = 0.0
    size: int = TEST


def value_of(case: Case, answers: Sequence[float], rng: np.random.Generator, size: int = TEST) -> tuple[float, tuple]:
    """(value of a trial, all answers that it took). What is not a number counts as infinite."""
    draws = Draws(rng, answers, size)
    try:
        value = float(case.measure(draws))
    except Exception as error:
        error.add_note(f"case {case.name}, answers {draws.taken}")
        raise
    return (math.inf if math.isnan(value) else value), tuple(draws.taken)


def changed(answers: Sequence[float], rng: np.random.Generator) -> tuple:
    """Answers of which one to three are others: any number, one near by, or an end or the middle of the range."""
    out = list(answers)
    for place in rng.integers(0, max(len(out), 1), rng.integers(1, CHANGED + 1)) if out else ():
        kind = rng.integers(0, 4)
        if kind == 0:
            out[place] = float(rng.random())
        elif kind < 3:
            out[place] = float(np.clip(out[place] + rng.normal() * 10.0 ** rng.uniform(-8, -0.5), 0, 1))
        else:
            out[place] = float(rng.choice([0.0, 0.5, 1.0]))
    return tuple(out)


def worst_of(case: Case, trials: int | None = None, seconds: float | None = None, size: int = TEST) -> Worst:
    """The worst of so many trials, or of those that begin within so many seconds, at least one.

    Every second trial is a step of the search, where the case has one: a hill climb from the worst trial so far, which also goes
    sideways. The trials are the same for a case whenever they are made; time only says how many there are.
    """
    begin, place, n, worst = time.perf_counter(), zlib.crc32(case.name.encode()), 0, Worst(-math.inf, (), "seeds")
    while n == 0 or ((trials is None or n < trials) and (seconds is None or time.perf_counter() - begin < seconds)):
        searching = case.search and n % 2 == 1
        rng = np.random.default_rng([place, n])
        value, answers = value_of(case, changed(worst.answers, rng) if searching else (), rng, size)
        n += 1
        if value > worst.value:
            worst = Worst(value, answers, "search" if searching else "seeds")
        elif value == worst.value and searching:
            worst = replace(worst, answers=answers)
    return replace(worst, trials=n, seconds=time.perf_counter() - begin, size=size)
