"""Lets every call to the system, and every array, of a run of a tool fail once, one after the other, and says what ends badly.

    python tests/fuzz/faults.py [--tool NAME ...] [--kind NAME ...] [--every N] [--state FILE.jsonl]

A run must end with a documented exit code and, unless it is 0, one TXF code that names what is wrong, without a traceback, an
internal error, a temporary or a partial output. With 0 the output is the whole one. A call counts where code of the package, or
what it calls of Python's own library, makes it; arrays count where the package itself asks numpy for them.
"""

import argparse
import builtins
import contextlib
import errno
import importlib
import io
import json
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __package__ in (None, ""):
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np  # noqa: E402
from mesh_files import RED_BLUE, encoded, textured  # noqa: E402

from fuzz.seeds import VECTORS  # noqa: E402
from texfcodec.findings import BY_CODE  # noqa: E402

REPOSITORY = Path(__file__).resolve().parents[2]
OURS = str(REPOSITORY / "texfcodec") + os.sep
DOCUMENTED = (0, 1, 2, 3, 5, 6, 130)  # 4 is an internal error
NUMBERS = {"disk full": errno.ENOSPC, "input and output": errno.EIO, "not permitted": errno.EACCES, "read-only": errno.EROFS,
           "too many files": errno.EMFILE}
KINDS = (*NUMBERS, "memory", "vanished")
ARRAYS = ("empty", "zeros", "ones", "full", "array", "asarray", "ascontiguousarray", "concatenate", "stack", "arange", "repeat",
          "tile", "unique", "where", "empty_like", "zeros_like", "column_stack", "cumsum", "sort", "argsort", "bincount",
          "flatnonzero", "diff", "frombuffer", "full_like", "pad", "searchsorted", "cross", "einsum", "matmul", "dot", "clip")
CALLS = tuple((os, name) for name in ("open", "replace", "mkdir", "stat", "unlink", "rmdir", "scandir", "pipe"))
REMOVALS = ("os.scandir()", "os.unlink()", "os.rmdir()")  # where one fails, a temporary has to stay
OBJ = """mtllib a.mtl
v 0 0 0
v 1 0 0
v 1 1 0
vt 0 0
vt 1 0
vt 1 1
usemtl m
f 1/1 2/2 3/3
"""
SMALL = ("--resolution", "16", "--qp", "40", "--refine", "off", "--effort", "fast", "--threads", "1")
RUNS = {  # name: tool, arguments
    "enc": ("enc", ("{in}/a.obj", "{out}/a.texf", *SMALL)),
    "enc gltf": ("enc", ("{in}/a.gltf", "{out}/a.texf", *SMALL)),
    "info voxels": ("info", ("{in}/voxels.texf", "--verify")),
    "info texels": ("info", ("{in}/texels.texf",)),
    "dec voxels": ("dec", ("{in}/voxels.texf", "{out}/a.ply", "--threads", "1")),
    "dec texels": ("dec", ("{in}/texels.texf", "{out}/a.gltf", "--threads", "1")),
    "dec neural": ("dec", ("{in}/neural.texf", "{out}/a.npz", "--threads", "1")),
    "dec glb": ("dec", ("{in}/voxels.texf", "{out}/a.glb", "--texture-size", "16", "--atlas", "fast", "--threads", "1")),
    "dec isolated": ("dec", ("{in}/one.texf", "{out}/a.ply", "--isolate", "--threads", "1")),
}
STREAMS = {"voxels": "uncommon/filter_lonely_voxels", "texels": "uncommon/texels_one", "neural": "uncommon/neural_one_voxel",
           "one": "uncommon/one_voxel"}


@dataclass
class Ended:
    """How a run ended. calls: those that could have failed; fired: what failed, None where fewer calls were made; out, said:
    stdout and stderr; files: of the output folder; left: temporaries."""

    code: Any
    out: str
    said: str
    calls: int
    fired: str | None
    files: dict
    left: list


class Injector:
    """Counts calls, and lets one of them fail. kind: of KINDS; at: which call, from 0, None to count only; folder: that
    vanishes."""

    def __init__(self, kind: str, at: int | None, folder: Path) -> None:
        self.kind, self.at, self.folder = kind, at, folder
        self.calls, self.fired = 0, None

    def meets(self, what: str) -> None:
        """A call is made; raises where it is the one."""
        number, self.calls = self.calls, self.calls + 1
        if number != self.at:
            return
        self.fired = what
        if self.kind == "memory":
            raise MemoryError(f"no memory for {what}")
        if self.kind == "vanished":
            shutil.rmtree(self.folder, ignore_errors=True)
            return
        number = NUMBERS[self.kind]
        raise OSError(number, os.strerror(number), "a path")


def _is_ours(depth):
    """Whether a caller so many frames up is code of the package."""
    return sys._getframe(depth + 1).f_code.co_filename.startswith(OURS)


def _is_below_ours():
    """Whether code of the package is among the callers, with nothing of the import system or of another package between."""
    frame = sys._getframe(2)
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith(OURS):
            return True
        if "importlib" in name or "site-packages" in name or name.startswith("<frozen importlib"):
            return False
        frame = frame.f_back
    return False


class _File(io.IOBase):
    """A file whose reads, writes and closing count as calls."""

    def __init__(self, file, injector):
        self._file, self._injector = file, injector

    def __getattr__(self, name):
        value = getattr(self._file, name)
        if name in ("read", "readinto", "readall", "write", "writelines", "flush"):
            def counted(*arguments):
                self._injector.meets(f"{name}()")
                return value(*arguments)

            return counted
        return value

    read = property(lambda self: self.__getattr__("read"))
    readinto = property(lambda self: self.__getattr__("readinto"))
    write = property(lambda self: self.__getattr__("write"))
    writelines = property(lambda self: self.__getattr__("writelines"))
    flush = property(lambda self: self.__getattr__("flush"))
    seek = property(lambda self: self._file.seek)
    tell, readable = property(lambda self: self._file.tell), property(lambda self: self._file.readable)
    writable, seekable = property(lambda self: self._file.writable), property(lambda self: self._file.seekable)

    def close(self):
        if not self._file.closed:
            self._file.close()

    @property
    def closed(self):
        return self._file.closed

    def fileno(self):
        return self._file.fileno()


def _patches(injector) -> Iterator[tuple[Any, str, Callable]]:
    """(object, name, what takes its place) of everything that is counted for a kind of fault."""
    if injector.kind == "memory":
        for name in ARRAYS:
            yield np, name, _counted_array(getattr(np, name), name, injector)
        return
    for holder, name in CALLS:
        yield holder, name, _counted(getattr(holder, name), f"os.{name}()", injector)

    def opened(file, mode="r", *arguments, true=builtins.open, **more):
        if isinstance(file, int) or not _is_below_ours():
            return true(file, mode, *arguments, **more)
        injector.meets("open()")
        made = true(file, mode, *arguments, **more)
        return _File(made, injector) if "b" in mode else made

    yield builtins, "open", opened
    yield io, "open", opened


def _counted(call, what, injector):
    def counted(*arguments, **more):
        if _is_below_ours():
            injector.meets(what)
        return call(*arguments, **more)

    return counted


def _counted_array(make, name, injector):
    def counted(*arguments, **more):
        if _is_ours(1):
            injector.meets(f"np.{name}()")
        return make(*arguments, **more)

    return counted


@contextlib.contextmanager
def injected(kind: str | None, at: int | None, folder: Path) -> Iterator[Injector]:
    """The block with one fault in it, or with nothing counted where kind is None."""
    injector = Injector(kind or "", at, folder)
    patches = list(_patches(injector)) if kind else []
    before = [(holder, name, getattr(holder, name)) for holder, name, _ in patches]
    for holder, name, counted in patches:
        setattr(holder, name, counted)
    try:
        yield injector
    finally:
        for holder, name, usual in before:
            setattr(holder, name, usual)


class Bench:
    """A folder with what the tools read; each run gets an output folder and a place for temporaries of its own."""

    def __init__(self, top: Path) -> None:
        self.top, self.whole = top, {}
        (top / "in").mkdir()
        (top / "in/a.obj").write_text(OBJ)
        (top / "in/a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
        (top / "in/a.png").write_bytes(encoded(RED_BLUE))
        builder = textured()
        (top / "in/a.bin").write_bytes(builder.blob)
        tree = builder.tree | {"buffers": [{"uri": "a.bin", "byteLength": len(builder.blob)}], "images": [{"uri": "a.png"}]}
        (top / "in/a.gltf").write_text(json.dumps(tree))
        for name, vector in STREAMS.items():
            shutil.copy(VECTORS / vector / "in.texf", top / f"in/{name}.texf")

    def run(self, name: str, kind: str | None, at: int | None) -> Ended:
        """One run of RUNS with one fault, or with none; where kind is None, nothing stands between the tool and its calls."""
        tool, words = RUNS[name]
        out, scratch = self.top / "out", self.top / "scratch"
        for folder in (out, scratch):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        arguments = [word.format(**{"in": self.top / "in", "out": out}) for word in words]
        main = importlib.import_module(f"texfcodec.cli.{tool}").main
        told, said, before = io.StringIO(), io.StringIO(), tempfile.tempdir
        tempfile.tempdir = str(scratch)
        try:
            with contextlib.redirect_stdout(told), contextlib.redirect_stderr(said), injected(kind, at, out) as injector:
                try:
                    code = main(arguments)
                except SystemExit as ended:
                    code = ended.code
                except BaseException as error:  # nothing may come through, whatever it is
                    code = f"{type(error).__name__}: {error}"
        finally:
            tempfile.tempdir = before
        files = {path.name: path.read_bytes() for path in out.iterdir()} if out.is_dir() else {}
        return Ended(code, told.getvalue(), said.getvalue(), injector.calls, injector.fired, files,
                     [path.name for path in scratch.iterdir()])

    def usual(self, name: str) -> dict:
        """Files of the run without a fault."""
        if name not in self.whole:
            for kind in (None, "memory"):  # the first may import and compile
                ended = self.run(name, kind, None)
            assert ended.code == 0, ended.said
            self.whole[name] = ended.files
        return self.whole[name]

    def sweep(self, name: str, kind: str, every: int = 1) -> Iterator[tuple[int, Ended]]:
        """(number of the call, how it ended) for every call that a run makes, or each `every`-th."""
        self.usual(name)
        at = 0
        while True:
            ended = self.run(name, kind, at)
            if ended.fired is None:
                return
            yield at, ended
            at += every

    def faults(self, name: str, kind: str, ended: Ended) -> Iterator[str]:
        """What is wrong with the end of a run: sentences."""
        said = ended.said + ended.out
        codes = [word.strip(":") for word in said.split() if word.startswith("TXF-")]
        if ended.code not in DOCUMENTED:
            yield f"ends with {ended.code}: {said[-300:].strip()!r}"
        elif ended.code and (not codes or codes[0] not in BY_CODE or BY_CODE[codes[0]].exit_code != ended.code):
            yield f"ends with {ended.code} and names {codes}"
        if "Traceback" in said:
            yield "shows a traceback"
        if ended.left and ended.fired not in REMOVALS:
            yield f"leaves {ended.left} among the temporary files"
        excused = kind == "vanished" or "TXF-I16" in said  # a library or texture that is missing is a warning
        if ended.code == 0 and ended.files != self.usual(name) and not excused:
            yield f"ends with 0 and leaves other files: {sorted(ended.files)}"
        if ended.code != 0 and ended.files:
            yield f"ends with {ended.code} and leaves {sorted(ended.files)}"


def swept(bench: Bench, name: str, kind: str, every: int = 1) -> tuple[Counter, list[str]]:
    """(how often each exit code, a sentence for each end that is bad) of a sweep."""
    counts: Counter = Counter()
    found: list[str] = []
    for at, ended in bench.sweep(name, kind, every):
        counts[str(ended.code)] += 1
        found += [f"{name}, {kind} at call {at}, {ended.fired}: {fault}" for fault in bench.faults(name, kind, ended)]
    return counts, found


def main(words: list[str] | None = None) -> int:
    """The command line: 0 where every run ended as it should, else 7."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tool", action="append", choices=RUNS, help="only this run; may be repeated")
    parser.add_argument("--kind", action="append", choices=KINDS, help="only this fault; may be repeated")
    parser.add_argument("--every", type=int, default=1, help="only each N-th call")
    parser.add_argument("--state", type=Path, help="add a line for each sweep to this file")
    chosen, bad = parser.parse_args(words), 0
    if chosen.state:
        chosen.state.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        for name in chosen.tool or RUNS:
            for kind in chosen.kind or KINDS:
                counts, found = swept(bench, name, kind, chosen.every)
                told = ", ".join(f"{times} with {code}" for code, times in sorted(counts.items())) or "never"
                print(f"{name}, {kind}: {counts.total()} faults, ended {told}; {len(found)} badly", flush=True)
                print(*(f"  {one}" for one in found), sep="\n", end="\n" * bool(found), flush=True)
                bad += len(found)
                if chosen.state:
                    with open(chosen.state, "a", encoding="utf-8") as file:
                        file.write(json.dumps({"run": name, "kind": kind, "faults": counts.total(), "codes": counts,
                                               "bad": len(found)}) + "\n")
    return 7 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
