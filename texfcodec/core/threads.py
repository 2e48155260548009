"""Ways to run work on threads."""

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def ahead(make: Callable[[], Made], threads: int) -> Callable[[], Made]:
    """Begins make() on a thread of its own, or at the first call where there is but one; the function gives what it made."""
    if threads < 2:
        return cache(make)
    pool = ThreadPoolExecutor(1)
    made = pool.submit(make)
    pool.shutdown(wait=False)
    return made.result


def over_blocks(one: Callable[[int], object], count: int, block: int, threads: int) -> None:
    """Calls one(begin) for begin = 0, block, 2 block, ... below count, on so many threads; one must only write its own part."""
    for _ in in_order(one, range(0, count, block), threads):
        pass


def in_order(one: Callable[[Item], Made], items: Sequence[Item], threads: int) -> Generator[Made, None, None]:
    """Yields one(item) for every item in their order, with so many at work at a time and as many waiting for the caller; once it
    turns away, none begins."""
    if threads < 2 or len(items) < 2:
        yield from map(one, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        jobs = deque(pool.submit(one, item) for item in items[: 2 * threads])
        try:
            for item in items[2 * threads :]:
                yield jobs.popleft().result()
                jobs.append(pool.submit(one, item))
            while jobs:
                yield jobs.popleft().result()
        finally:
            for job in jobs:
                job.cancel()
