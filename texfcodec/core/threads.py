"""One way to run blocks of work on threads."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def over_blocks(one: Callable[[int], object], count: int, block: int, threads: int) -> None:
    """Calls one(begin) for begin = 0, block, 2 block, ... below count, on so many threads; one must only write its own part."""
    begins = range(0, count, block)
    if threads > 1 and len(begins) > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(one, begins))
    else:
        for begin in begins:
            one(begin)
