"""Runs work on threads."""

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def ahead(make: Callable[[], Made], threads: int) -> Callable[[], Made]:
    """Return a function that returns the result of make(). A thread of its own begins make() at once; if threads is 1, the first
    call of the function runs it."""
    if threads < 2:
        return cache(make)
    pool = ThreadPoolExecutor(1)
    job = pool.submit(make)
    pool.shutdown(wait=False)
    return job.result


def over_blocks(call: Callable[[int], object], count: int, block: int, threads: int) -> None:
    """Call call(begin) for begin = 0, block, 2 block, ... below count, on up to `threads` threads. A call writes only the
    results of its own block, begin..begin + block - 1."""
    for _ in in_order(call, range(0, count, block), threads):
        pass


def in_order(call: Callable[[Item], Made], items: Sequence[Item], threads: int) -> Generator[Made, None, None]:
    """Yields call(item) for every item, in their order. `threads` calls run at a time, and as many results wait for the caller.
    No further call begins once the caller closes the generator."""
    if threads < 2 or len(items) < 2:
        yield from map(call, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        jobs = deque(pool.submit(call, item) for item in items[: 2 * threads])
        try:
            for item in items[2 * threads :]:
                yield jobs.popleft().result()
                jobs.append(pool.submit(call, item))
            while jobs:
                yield jobs.popleft().result()
        finally:
            for job in jobs:
                job.cancel()
