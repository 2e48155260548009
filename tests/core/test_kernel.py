"""Compiled kernels never outlive the sources they were made from."""

import ast
import errno
import gc
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import pytest
from numba.core.event import Listener as Recorder
from numba.core.event import install_listener

from texfcodec.core import kernel as kernel_room
from texfcodec.core.kernel import cache_folder, fingerprint, kernel
from texfcodec.core.kernel_library import TRIED, KernelLibrary

PACKAGE = kernel_room.PACKAGE


BLOCKS = "codecs/raht/coefficients/blocks.py"


def test_a_change_in_what_a_kernel_imports_moves_its_cache(tmp_path, monkeypatch):
    shutil.copytree(PACKAGE, tmp_path / "p", ignore=shutil.ignore_patterns("__pycache__"))
    here = fingerprint(PACKAGE / BLOCKS)
    monkeypatch.setattr(kernel_room, "PACKAGE", tmp_path / "p")

    def now():
        kernel_room._read.cache_clear()
        return fingerprint.__wrapped__(tmp_path / "p" / BLOCKS)

    same = now()
    assert same == now() != here
    for name in (BLOCKS, "codecs/raht/entropy/range_coder.py", "core/integer.py"):  # itself, straight, through others
        path = tmp_path / "p" / name
        path.write_text(path.read_text() + "\n")
        assert now() != same
        same = now()
    for name in ("cli/enc.py", "scene/scene.py"):
        path = tmp_path / "p" / name
        path.write_text(path.read_text() + "\n")
        assert now() == same


def test_every_import_of_the_package_is_followed():
    """The fingerprint reads imports as text; what Python itself makes of them must be no more."""
    for path in PACKAGE.rglob("*.py"):
        package = ["texfcodec", *path.relative_to(PACKAGE).parent.parts]
        wanted = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("texfcodec")):
                base = package[: len(package) + 1 - node.level] if node.level else []
                name = ".".join([*base, *([node.module] if node.module else [])])
                wanted |= {name, *(f"{name}.{a.name}" for a in node.names)}
        files = {PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py") for name in wanted}
        assert {file for file in files if file.is_file()} <= set(kernel_room._read(path)[2]), path


def test_kernels_are_cached_there_and_other_packages_keep_their_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_room, "cache_folder", lambda path: tmp_path)
    usual = numba.config.CACHE_DIR

    @kernel
    def _twice(v):
        return 2 * v

    assert _twice(21) == 42 and numba.config.CACHE_DIR == usual
    assert list(tmp_path.glob("*/*.nbi"))


def test_a_cache_folder_of_the_users_is_honoured(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert cache_folder(PACKAGE / BLOCKS) == tmp_path / "texfcodec" / fingerprint(PACKAGE / BLOCKS)


def test_without_a_home_the_cache_stays_with_the_package(monkeypatch):
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("no home")

    monkeypatch.setattr(Path, "home", homeless)
    assert PACKAGE in cache_folder(PACKAGE / BLOCKS).parents


def test_a_cache_that_cannot_be_made_is_passed_over(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "next"))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "next"))
    assert cache_folder(PACKAGE / BLOCKS) == tmp_path / "next" / "texfcodec" / fingerprint(PACKAGE / BLOCKS)


def test_where_no_place_may_be_written_the_cache_is_the_packages_own(monkeypatch):
    monkeypatch.setattr(kernel_room.os, "access", lambda *_: False)
    assert PACKAGE in cache_folder(PACKAGE / BLOCKS).parents


def test_only_the_kernel_room_asks_numba():
    asking = [path for path in PACKAGE.rglob("*.py") for node in ast.walk(ast.parse(path.read_text()))
              if isinstance(node, ast.Import | ast.ImportFrom)
              and any(n.split(".")[0] == "numba" for n in [getattr(node, "module", None) or "", *(a.name for a in node.names)])]
    assert {path.relative_to(PACKAGE).as_posix() for path in asking} == {"core/kernel.py", "core/kernel_library.py"}


def test_a_kernel_that_kernels_call_is_compiled_once_whatever_the_constants(tmp_path, monkeypatch):
    """Numba takes 0, 1 and a variable for three types; a third of a first run went there and into wrappers for Python."""
    monkeypatch.setattr(kernel_room, "cache_folder", lambda path: tmp_path)
    compiled = []

    class Listener(Recorder):
        def on_start(self, event):
            compiled.append(event.data["dispatcher"].py_func.__name__)

        def on_end(self, event):
            pass

    @kernel
    def _next(v):
        return v + 1

    @kernel
    def _sum(v):
        return _next(0) + _next(1) + _next(v)

    with install_listener("numba:compile", Listener()):
        assert _sum(5) == 9
        assert compiled == ["_sum", "_next"]
        assert _next(7) == 8  # still callable from Python
    assert compiled == ["_sum", "_next", "_next"]
    assert {file.name.split("-")[0].rsplit(".", 1)[1] for file in tmp_path.glob("*/*.nbi")} == {"_sum", "_next"}


@pytest.mark.skipif(numba.version_info.short != TRIED, reason="another numba, which compiles in its own way")
def test_a_function_that_only_kernels_call_is_not_translated_by_itself(tmp_path, monkeypatch):
    """It was optimised and translated on its own and again within each caller, a sixth of a first run."""
    monkeypatch.setattr(kernel_room, "cache_folder", lambda path: tmp_path)
    translated, translate = [], KernelLibrary._finalize_specific
    monkeypatch.setattr(KernelLibrary, "_finalize_specific", lambda self: translated.append(self.name) or translate(self))

    def _next(v):
        return v + 1

    def _sum(v):
        return _next(v) + _next(2 * v)

    _next = kernel(_next)
    assert kernel(_sum)(5) == 17 and [name.rsplit(".", 1)[1] for name in translated] == ["_sum"]
    _next = kernel(_next.py_func)  # as a later process: loaded from the cache and linked into another caller
    again = kernel(lambda v: _next(v))
    assert again(5) == 6 and [name.rsplit(".", 1)[1] for name in translated] == ["_sum", "<lambda>"]


def test_the_collector_rests_while_a_kernel_is_compiled_and_runs_again(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_room, "cache_folder", lambda path: tmp_path)
    collecting = []

    class Listener(Recorder):
        def on_start(self, event):
            collecting.append(gc.isenabled())

        def on_end(self, event):
            pass

    @kernel
    def _half(v):
        return v // 2

    @kernel
    def _broken(v):
        return v.nothing

    with install_listener("numba:compile", Listener()):
        assert _half(8) == 4
        with pytest.raises(numba.TypingError):
            _broken(1)
    assert collecting == [False, False] and gc.isenabled()


@pytest.fixture
def twice(tmp_path, monkeypatch):
    """A function: a kernel that doubles, as a process that begins has it, with its cache in tmp_path."""
    monkeypatch.setattr(kernel_room, "cache_folder", lambda path: tmp_path)

    def _twice(v):
        return 2 * v

    return lambda: kernel(_twice)


def file_of(folder, ending):
    return next(folder.rglob(f"*{ending}"))


def test_code_of_other_types_under_a_kernels_name_is_not_run(twice, tmp_path):
    """What numba leaves behind where two processes at once take the same number for the code of different types."""
    first = twice()
    assert [first(21), first(1.5)] == [42, 3.0]
    shutil.copy(file_of(tmp_path, ".2.nbc"), file_of(tmp_path, ".1.nbc"))
    later = twice()
    assert isinstance(later(21), int) and later.stats.cache_misses.total() == 1
    again = twice()
    assert [again(21), again(1.5)] == [42, 3.0] and again.stats.cache_hits.total() == 2


@pytest.mark.parametrize("ending", [".nbi", ".1.nbc"])
@pytest.mark.parametrize("left", [0, 40, None])
def test_a_cache_file_that_was_cut_short_costs_a_compilation(twice, tmp_path, ending, left):
    assert twice()(21) == 42
    path = file_of(tmp_path, ending)
    path.write_bytes(b"no cache at all" if left is None else path.read_bytes()[:left])
    assert twice()(21) == 42
    whole = twice()
    assert whole(21) == 42 and whole.stats.cache_hits.total() == 1


def test_a_kernel_runs_where_its_code_cannot_be_kept(twice, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(numba.core.caching.IndexDataCacheFile, "_save_data", full)
    assert twice()(21) == 42 and not list(tmp_path.rglob("*.nbc"))


def test_one_process_at_a_time_reads_or_writes_the_cache_of_a_kernel(twice, tmp_path):
    fcntl = pytest.importorskip("fcntl")
    told, made = [], twice()
    waiting = threading.Thread(target=lambda: told.append(made(21)))
    with open(tmp_path / "_twice.lock", "wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        waiting.start()
        waiting.join(1)
        assert waiting.is_alive() and not told
    waiting.join(60)
    assert told == [42]


def test_what_one_process_compiles_another_waits_for_and_loads(tmp_path):
    program = tmp_path / "slow_to_compile.py"
    program.write_text("""
import sys, time
from pathlib import Path
from numba.extending import overload
from texfcodec.core.kernel import kernel

def doubled(v):
    return 2 * v

@overload(doubled)
def _(v):
    Path(sys.argv[1]).touch()
    while not Path(sys.argv[2]).exists():  # until the other is on its way
        time.sleep(0.01)
    time.sleep(0.5)
    return lambda v: 2 * v

@kernel
def _twice(v):
    return doubled(v)

Path(sys.argv[1]).touch() if sys.argv[3:] else None
print(_twice(21), _twice.stats.cache_misses.total())
""")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(PACKAGE.parent)}
    command = [sys.executable, program, tmp_path / "first", tmp_path / "second"]
    first = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        while not (tmp_path / "first").exists():
            assert first.poll() is None
            time.sleep(0.01)
        second = subprocess.run([*command[:2], tmp_path / "second", tmp_path / "second", "told"], env=environment,
                                capture_output=True, text=True, check=True)
        assert first.communicate()[0].split() == ["42", "1"] and second.stdout.split() == ["42", "0"]
    finally:
        first.kill()


@pytest.mark.slow
def test_warming_up_compiles_every_way_of_coding_a_level_and_the_residuals():
    program = """
from texfcodec.codecs.raht.coefficients import direct, mixed, residual
from texfcodec.precompile import warm_up
warm_up()
entries = [direct._enc_direct_level, direct._dec_direct_level, mixed._enc_mixed_level, mixed._dec_mixed_level,
           residual._enc_residuals, residual._dec_residuals]
print([len(entry.signatures) for entry in entries])
"""
    run = subprocess.run([sys.executable, "-c", program], cwd=PACKAGE.parent, capture_output=True, text=True, check=False)
    assert run.stdout.strip() == "[1, 1, 1, 1, 1, 1]", run.stderr


def test_two_threads_that_make_kernels_get_each_its_own_cache_folder(tmp_path):
    """One read what the other had set, and left it there for the life of the process."""
    class Numba:
        class config:
            CACHE_DIR, DISABLE_JIT = "the user's", True

        @staticmethod
        def njit(**_):
            def decorate(function):
                time.sleep(0.02)  # the other thread sets its own, unless it waits
                return function.__name__, Numba.config.CACHE_DIR
            return decorate

    found = {}

    def make(name):
        def one():
            pass

        one.__name__ = name
        found[name] = kernel_room._compiled(Numba, one, tmp_path / name, {})

    threads = [threading.Thread(target=make, args=(name,)) for name in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {name: (name, str(tmp_path / name)) for name in "abc"} and Numba.config.CACHE_DIR == "the user's"
