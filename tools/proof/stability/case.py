"""A case of the table, the choices of one of its trials, and the worst of many: by seeds, and by a search from there on.

A trial asks its Draws for every number it needs, and these remember the answers as numbers in 0..1. So one search serves all
cases: it changes some of the answers of the worst trial so far and plays it again.
"""

import math
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

TEST, PAGE, MOST = range(3)  # how large heavy cases are: in tests, for docs/reports/stability.md, and as large as they are run
MUTATED = 3  # answers that a step of the search changes at most


class Draws:
    """The choices of one trial. given: answers in 0..1 to begin with; what is asked beyond them comes from rng. size: TEST, PAGE
    or MOST."""

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
    """A row of the table. stresses: what is stressed; bound: the largest value that a trial may have, in `unit`; why: why it
    holds, with its clause of bitstream_spec.md; measure: function from Draws to the value of one trial, of which larger is worse;
    seeds: trials in the tests; search: whether searching pays; heavy: whether a trial for the page takes long, so that a few
    are enough."""

    name: str
    group: str
    stresses: str
    bound: float
    unit: str
    why: str
    measure: Callable[[Draws], float]
    seeds: int = 6
    search: bool = True
    heavy: bool = False


@dataclass(frozen=True)
class Worst:
    """The worst trial of a case. value; answers: its Draws' answers; by: "seeds" or "search"; trials, seconds: of all; size: as
    Draws has it."""

    value: float
    answers: tuple
    by: str
    trials: int
    seconds: float
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


def mutated(answers: Sequence[float], rng: np.random.Generator) -> tuple:
    """Answers of which one to three are others: any number, one near by, or an end or the middle of the range."""
    changed = list(answers)
    for place in rng.integers(0, max(len(changed), 1), rng.integers(1, MUTATED + 1)) if changed else ():
        kind = rng.integers(0, 4)
        if kind == 0:
            changed[place] = float(rng.random())
        elif kind < 3:
            changed[place] = float(np.clip(changed[place] + rng.normal() * 10.0 ** rng.uniform(-8, -0.5), 0, 1))
        else:
            changed[place] = float(rng.choice([0.0, 0.5, 1.0]))
    return tuple(changed)


def worst_of(case: Case, trials: int | None = None, seconds: float | None = None, size: int = TEST) -> Worst:
    """The worst of so many trials, or of those that begin within so many seconds, at least one.

    Every second trial is a step of the search, where the case has one: a hill climb from the worst trial so far, which also goes
    sideways. The trials are the same for a case whenever they are made; time only says how many there are.
    """
    begin, place, n = time.perf_counter(), zlib.crc32(case.name.encode()), 0
    best, at, by = -math.inf, (), "seeds"
    while n == 0 or ((trials is None or n < trials) and (seconds is None or time.perf_counter() - begin < seconds)):
        searching = case.search and n % 2 == 1
        rng = np.random.default_rng([place, n])
        value, answers = value_of(case, mutated(at, rng) if searching else (), rng, size)
        n += 1
        if value > best:
            best, at, by = value, answers, "search" if searching else "seeds"
        elif value == best and searching:
            at = answers
    return Worst(best, at, by, n, time.perf_counter() - begin, size)
