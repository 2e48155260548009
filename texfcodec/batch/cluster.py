"""Tasks on a running Dask cluster. The extra `cluster` installs its client.

The client keeps a window of tasks on the scheduler. A worker that sees the client's folder (by its PROBE) works there and answers
with the folder's name; any other works among its own temporary files and answers with them, packed. Such a worker also requests
the asset if it does not see it: its files travel once per asset, as a task of their own, so that the scheduler can send them
again if a worker is lost. Each attempt has a folder of its own, so that no two attempts meet; only the client renames.

The scheduler gives the tasks of a lost worker to others. If a task is no longer wanted, because its client cancelled it or is
gone, the worker notices within seconds and kills its processes; they also end with the worker.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError, LimitError
from .children import WARM_UP, Caps, Children
from .folders import PROBE
from .local import Ended, terminated_as_interrupted
from .tasks import FAILED, INTERRUPTED, LOG, UNSUITED, Outcome, Task, package_code, perform, remove_folder

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_SECONDS = 20  # a busy machine may take a while to answer
SENT_BYTES = 1 << 30  # an asset or the files of a result are larger only where all see the same folder
ATTEMPTS = 8  # of one task, by workers that it does not suit or that need its files
RETRIES = 3  # of a task that the worker itself could not run
AHEAD = 2  # tasks on the scheduler for each thread of the workers
RESOURCE = "texf"  # a worker started with --resources texf=N works at N tasks at a time, each with its share of the threads
BLIND = "blind"  # the state of an outcome: the worker does not see the asset
Packed = dict[str, bytes]
_warming = threading.Lock()


# The worker's side.


@dataclass(frozen=True)
class Answer:
    """Result of a task, as a worker returns it.

    worker: its address; folder: name of the attempt's folder, if client and worker share a disk; files: otherwise its contents.
    """

    outcome: Outcome
    worker: str
    folder: str = ""
    files: Packed | None = None


def work(task: Task, size: int, room: str, sent: tuple[str, Packed] | None) -> Answer:
    """Run a task on the Dask worker of this thread and return its Answer.

    size: bytes of the asset at the client, by which the worker recognises the file; room: the client's folder for attempts;
    sent: (name, {name: bytes}), the asset's name and its files if they came along, else None.
    """
    from distributed import get_worker

    worker = get_worker()
    if task.package and task.package != package_code():
        return Answer(Outcome(UNSUITED, "the worker has another version of texfcodec than the client"), worker.address)
    shared, seen = _sees(Path(room)), _has(task.input, size)
    if not seen and sent is None:
        return Answer(Outcome(BLIND), worker.address)
    children = Children(_unwanted_task(worker))
    with _own_folder(worker) as own:
        _warm_up(children)
        if not seen and sent is not None:
            name, files = sent
            task = replace(task, input=_unpack(own / "asset", files) / name)
        folder = (Path(room) if shared else own) / uuid.uuid4().hex
        try:
            outcome = perform(_shared_out(task, worker), folder, children)
            if outcome.state == INTERRUPTED:
                remove_folder(folder)
            return _answer(outcome, worker.address, folder, shared)
        finally:
            if not shared:
                remove_folder(folder)


def _sees(room):
    try:
        return (room / PROBE).read_text(encoding="utf-8") == room.name
    except OSError:
        return False


def _has(path, size):
    return path.is_file() and path.stat().st_size == size


def _unwanted_task(worker):
    """Function: whether the task of this thread is no longer wanted, or the worker closes."""
    key = worker.get_current_task()

    def unwanted():
        state = worker.state.tasks.get(key)
        return state is None or state.state == "cancelled" or worker.status.name not in ("running", "paused")

    return unwanted


@contextlib.contextmanager
def _own_folder(worker):
    folder = Path(tempfile.mkdtemp(prefix="texf-", dir=worker.local_directory))
    try:
        yield folder
    finally:
        remove_folder(folder)


def _warm_up(children):
    """Compiles the kernels before a worker's first task, whose time they would count for."""
    from ..precompile import kernels_compiled  # by name only: the worker itself runs no kernel

    with _warming:
        if not kernels_compiled():
            children.run(WARM_UP, subprocess.DEVNULL, subprocess.DEVNULL, Caps(1))


def _shared_out(task, worker):
    """The task with its share of the worker's threads and memory."""
    at_once = max(min(worker.state.nthreads, int(worker.state.total_resources.get(RESOURCE, worker.state.nthreads))), 1)
    caps = [memory for memory in (task.memory, (worker.memory_manager.memory_limit or 0) // at_once) if memory]
    return replace(task, threads=max(worker.state.nthreads // at_once, 1), memory=min(caps, default=None))


def _answer(outcome, address, folder, shared):
    if shared:
        return Answer(outcome, address, folder.name)
    total = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else 0
    if total > SENT_BYTES:
        outcome = Outcome(FAILED, f"the result has {total} bytes; without a shared folder a worker can send at most {SENT_BYTES}")
        return Answer(outcome, address, files={LOG: (folder / LOG).read_bytes()})
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return Answer(outcome, address, files=files)


def _unpack(folder: Path, files: Packed) -> Path:
    for name, data in files.items():
        path = folder / name
        if not path.resolve().is_relative_to(folder.resolve()):
            raise ValueError(f"{name} leaves its folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    folder.mkdir(exist_ok=True)
    return folder


def same(sent: tuple[str, Packed]) -> tuple[str, Packed]:
    """Return (name, files) of an asset unchanged: as a Dask task it keeps the asset on the cluster for other tasks."""
    return sent


# The client's side.


def run_there(tasks: Sequence[Task], address: str, room: Path, ended: Ended, note: Callable[[str], object]) -> None:
    """Run tasks as local.run_here() does, but on a Dask cluster. address: such as tcp://HOST:8786; room: the client's folder for
    attempts; ended(task, outcome, folder): called for each task; note(text): shows a text to the user.

    Raises InputError TXF-C05 if the cluster cannot be reached or is lost, TXF-C06 if its client is not installed.
    """
    with terminated_as_interrupted(), _connected(address) as client:
        Run(client, address, room, ended, note).run(tasks)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """A client that prints nothing on its own."""
    import logging

    try:
        import dask
        from distributed import Client
    except ImportError:
        raise InputError("TXF-C06", 'the client of Dask clusters is not installed: pip install "texfcodec[cluster]"') from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL + 1)
    dask.config.set({"distributed.admin.large-graph-warning-threshold": f"{2 * SENT_BYTES}B"})
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError("TXF-C05", f"no Dask scheduler answered at {address} within {CONNECT_SECONDS} s",
                         reason=str(error)[:200] or type(error).__name__) from None
    try:
        yield client
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=CONNECT_SECONDS)


class Run:
    """Tasks of one client on one cluster. room, ended, note: as of run_there()."""

    def __init__(self, client: Client, address: str, room: Path, ended: Ended, note: Callable[[str], object]) -> None:
        self.client, self.address, self.room, self.ended, self.note = client, address, room, ended, note
        self.over: queue.SimpleQueue = queue.SimpleQueue()
        self.waiting: dict[Future, tuple[Task, int]] = {}  # future: task and which attempt it is
        self.assets: dict[Path, Future] = {}  # futures of assets that were sent
        self.blind: set[Path] = set()  # assets that some worker does not see
        self.unsuited: dict[str, str] = {}  # worker: why
        self.is_idle = False

    def run(self, tasks: Sequence[Task]) -> None:
        """Run all tasks and call ended() for each. However this ends, no task stays on the cluster."""
        todo = list(reversed(tasks))
        try:
            while todo or self.waiting:
                room = AHEAD * max(self._threads(), 1) - len(self.waiting)
                for _ in range(min(room, len(todo))):
                    self._submit(todo.pop(), 0)
                self._drop_assets({task.input for task, _ in self.waiting.values()} | {task.input for task in todo[-1:]})
                self._take()
        finally:
            with contextlib.suppress(Exception):
                self.client.cancel([*self.waiting, *self.assets.values()], asynchronous=False)

    def _threads(self):
        """Threads of all workers; notes when there are none. Raises InputError if the scheduler is gone."""
        try:
            threads = sum(self.client.nthreads().values())
        except Exception as error:
            raise self._lost() from error
        if not threads and not self.is_idle:
            self.note(f"the cluster at {self.address} has no workers; waiting for the first")
        self.is_idle = not threads
        return threads

    def _lost(self):
        return InputError("TXF-C05", f"lost the connection to the Dask scheduler at {self.address}")

    def _submit(self, task, attempt):
        sent = None
        if task.input in self.blind:
            try:
                sent = self._sent(task.input)
            except (LimitError, OSError, ValueError) as error:
                return self._ended(task, Outcome(FAILED, str(error)))
        suited = [address for address in self.client.nthreads() if address not in self.unsuited] if self.unsuited else []
        known = self.client.scheduler_info()["workers"].values()
        resources = {RESOURCE: 1} if any(RESOURCE in worker["resources"] for worker in known) else None
        size = task.input.stat().st_size if task.input.is_file() else -1
        future = self.client.submit(work, task, size, str(self.room), sent, key=f"texf-{uuid.uuid4().hex}", pure=False,
                                    retries=RETRIES, resources=resources, workers=suited or None,
                                    allow_other_workers=bool(suited))
        self.waiting[future] = task, attempt
        future.add_done_callback(self.over.put)

    def _sent(self, path):
        """The future of an asset's files. Raises LimitError if they are too large."""
        if path not in self.assets:
            named = files_of(path)
            files = {name: file for name, file in named.items() if file.is_file()}
            total = sum(file.stat().st_size for file in files.values())
            if total > SENT_BYTES:
                raise LimitError("TXF-L13", f"{path.name} has {total} bytes; without a shared folder the client can send at "
                                            f"most {SENT_BYTES}")
            sent = next(iter(named)), {name: file.read_bytes() for name, file in files.items()}
            self.assets[path] = self.client.submit(same, sent, key=f"texf-asset-{uuid.uuid4().hex}", pure=False)
        return self.assets[path]

    def _drop_assets(self, wanted):
        for path in self.assets.keys() - wanted:
            del self.assets[path]

    def _take(self):
        """Waits up to a second for a task to end, and hands over its result or runs it again."""
        try:
            future = self.over.get(timeout=1)
        except queue.Empty:
            return
        task, attempt = self.waiting.pop(future)
        answer = self._answer(future)
        if isinstance(answer, Outcome):
            self._ended(task, answer)
        elif attempt < ATTEMPTS and self._goes_on(task, answer):
            if answer.folder:
                remove_folder(self.room / answer.folder)
            self._submit(task, attempt + 1)
        else:
            folder = self.room / (answer.folder or uuid.uuid4().hex)
            if answer.files is not None:
                _unpack(folder, answer.files)
            self._ended(task, answer.outcome, folder)

    def _ended(self, task, outcome, folder=None):
        folder = folder or self.room / uuid.uuid4().hex
        self.ended(task, outcome, folder)
        remove_folder(folder)

    def _answer(self, future):
        """The Answer of a finished future, or the Outcome of one that did not reach work()."""
        try:
            return future.result()
        except Exception as error:
            if self.client.status not in ("running", "connecting"):
                raise self._lost() from error
            said = " ".join(str(error).split())[:300]
            return Outcome(FAILED, f"no worker could run the task: {type(error).__name__}: {said}")

    def _goes_on(self, task, answer):
        """Return whether another attempt makes sense: with the asset sent along, on another worker, or after an interruption."""
        state = answer.outcome.state
        if state == BLIND:
            self.blind.add(task.input)
        elif state == UNSUITED:
            if answer.worker not in self.unsuited:
                self.note(f"worker {answer.worker}: {answer.outcome.reason}")
            self.unsuited[answer.worker] = answer.outcome.reason
            return any(address not in self.unsuited for address in self.client.nthreads())
        return state in (BLIND, INTERRUPTED)


def files_of(path: Path) -> dict[str, Path]:
    """Return {name: path} of the files that an asset consists of, itself first. Names are relative to their common folder.

    If an asset cannot be loaded, it is its only file: the encoder reports the error.
    """
    from ..io.load import load

    try:
        names = [] if path.suffix.lower() in (".stl", ".off", ".3mf") else list(load(path).files)
    except Exception:
        names = []
    files = {os.path.abspath(name): Path(name) for name in (path, *names)}
    top = os.path.commonpath([os.path.dirname(name) for name in files])
    return {Path(name).relative_to(top).as_posix(): file for name, file in files.items()}
