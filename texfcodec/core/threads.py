"""Ways to run work on threads."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def over_blocks(one: Callable[[int], object], count: int, block: int, threads: int) -> None:
    """Calls one(begin) for begin = 0, block, 2 block, ... below count, on so many threads; one must only write its own part."""
    for _ in in_order(one, range(0, count, block), threads):
        pass


def in_order(one: Callable[[Item], Made], items: Sequence[Item], threads: int) -> Generator[Made, None, None]:
    """Yields one(item) for every item in their order, with so many at work at a time; once the caller turns away, none begins."""
    if threads < 2 or len(items) < 2:
        yield from map(one, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        jobs = [pool.submit(one, item) for item in items]
        try:
            for job in jobs:
                yield job.result()
        finally:
            for job in jobs:
                job.cancel()
