"""Running one target for some time in this process: the plain loop, the loop that coverage guides, the replay of kept inputs.

Called by supervision.py in a child process, whose memory is capped and whose present input is on a panel that the parent reads
when the child has died or does not come back.

    python tests/fuzz/execution.py PANEL REQUEST     REQUEST: JSON, see Request
"""

import contextlib
import itertools
import json
import mmap
import os
import random
import resource
import struct
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path

if __package__ in (None, ""):  # run as a command: this folder is found as fuzz.*
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from fuzz.branches import Tracer, taken  # noqa: E402
from fuzz.choices import ODD_NUMBERS  # noqa: E402
from fuzz.targets import TARGETS  # noqa: E402
from texfcodec.report import peak_of_status  # noqa: E402

PANEL = struct.Struct("<QdI")  # executions, when the present one began (0 before the first), length of its input
PANEL_BYTES = 1 << 16
ADDRESS_SPACE = 3 << 30  # beyond what the process has before its first input
MOST_MEMORY = 256 << 20  # that one input may add to the largest memory of the process
COMPILE_SECONDS = 600.0  # that an input may take while kernels are compiled, on a busy machine
WARM_INPUTS = 12  # that run before anything is timed: kernels are compiled by then


@dataclass
class Request:
    """mode: "plain", "guided" or "replay"; corpus: folder of inputs that are kept, or replayed; found: where findings go."""

    target: str
    mode: str
    seconds: float
    seed: int
    corpus: str
    found: str


@dataclass
class Answer:
    """What a run says at its end. outcomes: how often each; places: branches that were taken; findings: names of their files."""

    executions: int = 0
    seconds: float = 0.0
    outcomes: dict = field(default_factory=dict)
    taken: list = field(default_factory=list)
    missed: list = field(default_factory=list)
    kept: int = 0
    findings: list = field(default_factory=list)


class Panel:
    """What parent and child share of the present execution: a small file in memory."""

    def __init__(self, path: str) -> None:
        with open(path, "r+b") as file:
            self.map = mmap.mmap(file.fileno(), PANEL_BYTES)

    def begin(self, executions: int, data: bytes, grace: float = 0.0) -> None:
        """An input runs; grace: seconds that are not counted."""
        self.map[PANEL.size : PANEL.size + len(data)] = data
        PANEL.pack_into(self.map, 0, executions, time.monotonic() + grace, len(data))

    def rest(self, executions: int) -> None:
        """Nothing runs."""
        PANEL.pack_into(self.map, 0, executions, 0.0, 0)

    def read(self) -> tuple[int, float, bytes]:
        """(executions, when the present one began, its input)."""
        executions, begin, length = PANEL.unpack_from(self.map, 0)
        return executions, begin, bytes(self.map[PANEL.size : PANEL.size + length])


class Loop:
    """One run of a target."""

    def __init__(self, request: Request, panel: Panel) -> None:
        self.request, self.panel, self.target = request, panel, TARGETS[request.target]
        self.answer, self.chance, self.known = Answer(), random.Random(request.seed), set()
        self.status, self.peak = os.open("/proc/self/status", os.O_RDONLY), 0
        self.began = time.process_time()

    def warm_up(self) -> None:
        """Lets kernels be compiled and seeds be read, then caps the memory."""
        for data in [b"", *(self.random_input() for _ in range(WARM_INPUTS))]:
            self.compile_for(data)
        with open("/proc/self/statm") as file:
            present = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (present + ADDRESS_SPACE, present + ADDRESS_SPACE))
        self.peak = self.peak_bytes()
        self.began = time.process_time()

    def compile_for(self, data: bytes) -> None:
        """Runs an input without a look at the time or at what it does."""
        self.panel.begin(self.answer.executions, data, COMPILE_SECONDS)
        with contextlib.suppress(Exception):  # it will be met again
            self.target.outcome(data)
        self.panel.rest(self.answer.executions)

    def random_input(self) -> bytes:
        """Bytes of any length that the target makes use of; half of them are mostly zeros, which is what is legal and plain."""
        length = self.chance.randrange(self.target.bytes + 1)
        data = bytearray(self.chance.randbytes(length))
        if self.chance.random() < 0.5:
            for i in range(length):
                if self.chance.random() < 0.7:
                    data[i] = 0
        return bytes(data)

    def forget_memory(self) -> None:
        """The largest memory so far no longer counts: compiling took it."""
        with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as file:
            file.write("5")
        self.peak = self.peak_bytes()

    def peak_bytes(self) -> int:
        """Largest resident memory of this process since it began or forgot."""
        return peak_of_status(os.pread(self.status, 4096, 0))

    def execute(self, data: bytes) -> None:
        """Runs one input, counts it, and keeps what it should not have done."""
        answer = self.answer
        self.panel.begin(answer.executions, data)
        try:
            outcome = self.target.outcome(data)
        except Exception as error:
            outcome = "finding"
            self.find(data, "exception", _place_of(error), "".join(traceback.format_exception(error)))
        answer.executions += 1
        answer.outcomes[outcome] = answer.outcomes.get(outcome, 0) + 1
        peak = self.peak_bytes()
        if peak > self.peak:
            if peak - self.peak > MOST_MEMORY:
                self.find(data, "memory", "", f"{(peak - self.peak) >> 20} MB more than before")
            self.peak = peak
        self.panel.rest(answer.executions)

    def find(self, data: bytes, kind: str, place: str, said: str) -> None:
        """Keeps a finding, one for each place."""
        if (kind, place) not in self.known:
            self.known.add((kind, place))
            self.answer.findings.append(keep_finding(Path(self.request.found), self.request.target, kind, place, data, said))

    def is_over(self) -> bool:
        return self.seconds > self.request.seconds

    @property
    def seconds(self) -> float:
        """Of the processor: a busy machine takes longer and does as much."""
        return time.process_time() - self.began


def keep_finding(folder: Path, target: str, kind: str, place: str, data: bytes, said: str) -> dict:
    """Writes the input of a finding as a file: {"target", "kind", "place", "file", "said"}."""
    import hashlib

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{target}-{kind}-{hashlib.sha256(data).hexdigest()[:8]}.bin"
    path.write_bytes(data)
    return {"target": target, "kind": kind, "place": place, "file": path.name, "said": said[-2000:]}


def _place_of(error):
    """Type of an exception and the line of the package, or else of the target, that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if f"{os.sep}texfcodec{os.sep}" in frame.filename] or frames
    return f"{type(error).__name__} in {Path(ours[-1].filename).name}:{ours[-1].lineno}"


def plain(loop: Loop) -> None:
    """Random inputs, and changed ones of the corpus."""
    kept = [path.read_bytes() for path in sorted(Path(loop.request.corpus).glob("*.bin"))]
    loop.warm_up()
    while not loop.is_over():
        changed = kept and loop.chance.random() < 0.5
        loop.execute(mutated(loop.chance.choice(kept), loop, kept) if changed else loop.random_input())


def guided(loop: Loop) -> None:
    """Keeps inputs that reach arcs which none has reached before, and changes those."""
    folder = Path(loop.request.corpus)
    folder.mkdir(parents=True, exist_ok=True)
    kept = [path.read_bytes() for path in sorted(folder.glob("*.bin"))]
    loop.warm_up()
    with Tracer() as tracer:
        for data in itertools.chain([b"", *kept], _tried(loop, kept)):
            tracer.fresh = False
            loop.execute(data)
            if tracer.fresh and data not in kept:
                kept.append(data)
                (folder / f"{len(kept):05d}-{loop.request.seed}.bin").write_bytes(data)
    loop.answer.kept = len(kept)
    loop.answer.taken, loop.answer.missed = taken(loop.target.modules, tracer.arcs)


def _tried(loop, kept):
    """New inputs until the time is over, most of them changed ones of those that are kept by then."""
    while not loop.is_over():
        alone = len(kept) < 2 or loop.chance.random() < 0.2
        yield loop.random_input() if alone else mutated(loop.chance.choice(kept), loop, kept)


def replay(loop: Loop) -> None:
    """Every input of the corpus, once its kernels are compiled."""
    loop.warm_up()
    for path in sorted(Path(loop.request.corpus).glob("*.bin")):
        loop.compile_for(path.read_bytes())
        loop.forget_memory()
        loop.execute(path.read_bytes())


def mutated(data: bytes, loop: Loop, kept: list) -> bytes:
    """An input with one to four changes: bits, bytes, runs, parts of another one."""
    chance, out = loop.chance, bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 4))):
        kind, at = chance.randrange(7), chance.randrange(len(out) + 1)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << chance.randrange(8)
        elif kind == 1 and at < len(out):
            out[at] = chance.randrange(256)
        elif kind == 2:
            out[at:at] = chance.randbytes(chance.randrange(1, 9))
        elif kind == 3:
            del out[at : at + chance.randrange(1, 9)]
        elif kind == 4:
            out[at : at + 4] = (chance.choice(ODD_NUMBERS) & 0xFFFFFFFF).to_bytes(4, "little")
        elif kind == 5 and kept:
            other = chance.choice(kept)
            out[at:] = other[chance.randrange(len(other) + 1) :]
        else:
            out[at : at + 8] = bytes(8)
    return bytes(out[: loop.target.bytes])


MODES = {"plain": plain, "guided": guided, "replay": replay}


def main() -> None:
    """The child's side: runs the request and prints the answer as the last line."""
    panel, request = Panel(sys.argv[1]), Request(**json.loads(sys.argv[2]))
    loop = Loop(request, panel)
    MODES[request.mode](loop)
    loop.answer.seconds = loop.seconds
    print(json.dumps(vars(loop.answer)))


if __name__ == "__main__":
    main()
