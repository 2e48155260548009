"""Tasks on this machine, several at a time, each in processes of its own."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path

from ..core import cleanup
from .children import Children
from .tasks import FULL, INTERRUPTED, Outcome, Task, perform, remove_folder

Ended = Callable[[Task, Outcome, Path], object]


def run_here(tasks: Sequence[Task], workers: int, room: Path, ended: Ended) -> None:
    """Run tasks on this machine, `workers` at a time, each in a new folder below room.

    ended(task, outcome, folder) is called in this thread as each task ends; its folder is removed after that. A full disk stops
    the other tasks, and their outcome reports it; Ctrl-C and SIGTERM stop all.
    """
    children, full = Children(), threading.Event()

    def run_task(number, task):
        folder = room / str(number)
        if full.is_set():
            return Outcome(FULL, "the disk is full; coding did not start"), folder
        outcome = perform(task, folder, children)
        if cleanup.is_ending():  # the answer to Ctrl-C took the child's exit code, and its folder
            return Outcome(INTERRUPTED, "interrupted"), folder
        if outcome.state == FULL:
            full.set()
        return outcome, folder

    with ThreadPoolExecutor(workers) as pool, terminated_as_interrupted():
        waiting = {pool.submit(run_task, number, task): task for number, task in enumerate(tasks)}
        try:
            for future in as_completed(waiting):
                outcome, folder = future.result()
                if outcome.state == INTERRUPTED:
                    raise KeyboardInterrupt
                ended(waiting.pop(future), outcome, folder)
                remove_folder(folder)
        except BaseException:
            children.stop()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Context manager: SIGTERM raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number, frame):
        raise KeyboardInterrupt

    usual = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, usual)
