"""tools/bench/ab.py: what a process takes, where its seconds go, what it compiles, and the pages of both sides."""

import subprocess
import sys
import threading
import time

import pytest

from tools.bench import ab

FOUND = {"commits": ["0123", "4567"], "machine": "2 cores", "rate": "r03"}
BUSY = """
import threading
stop = threading.Event()
def busy():
    while not stop.is_set(): pass
def idle():
    stop.wait(20)
def spin(count=3_000_000):
    for _ in range(count): pass
if __name__ == "__main__":
    spin()
"""


@pytest.fixture
def package(tmp_path):
    """A folder with a package texfcodec that has the module busy."""
    (tmp_path / "texfcodec").mkdir()
    (tmp_path / "texfcodec" / "__init__.py").write_text("")
    (tmp_path / "texfcodec" / "busy.py").write_text(BUSY)
    return tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="os.wait4")
def test_what_a_process_takes_is_of_its_checkout_and_its_failure_is_no_measurement(package):
    found = ab.timed(["-m", "timeit", "-n1", "-r1", "import time, texfcodec.busy; time.sleep(0.6)"], package)
    assert 0 < found["processor"] < 0.5 < found["wall"] and found["memory"] > 1 << 20
    with pytest.raises(subprocess.CalledProcessError):
        ab.timed(["-c", "raise SystemExit(3)"], package)


def test_a_commit_is_checked_out_and_removed_and_a_folder_is_taken_as_it_is(tmp_path):
    def git(*words):
        return subprocess.run(["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True,
                              capture_output=True, text=True).stdout

    git("init", "--quiet")
    for text in ("old", "new"):
        (tmp_path / "file").write_text(text)
        git("add", "file")
        git("commit", "--quiet", "-m", text)
    with ab.checked_out("HEAD~1", tmp_path) as root:
        assert (root / "file").read_text() == "old" and len(git("worktree", "list").splitlines()) == 2
    assert not root.exists() and len(git("worktree", "list").splitlines()) == 1
    with ab.checked_out(str(tmp_path)) as root:
        assert root == tmp_path.resolve()


def test_a_thread_at_work_is_where_it_is_and_one_that_waits_nowhere(package):
    """Frames of other files do not count, unless the package called them."""
    names = {}
    exec(compile(BUSY, package / "texfcodec" / "busy.py", "exec"), names)
    threads = {name: threading.Thread(target=names[name]) for name in ("busy", "idle")}
    for thread in threads.values():
        thread.start()
    try:
        end, found = time.monotonic() + 20, {}
        while found != {"busy": "busy.busy", "idle": None} and time.monotonic() < end:
            frames = sys._current_frames()
            found = {name: ab.place_of(frames[thread.ident]) for name, thread in threads.items()}
        assert found == {"busy": "busy.busy", "idle": None} and ab.place_of(sys._getframe()) is None
    finally:
        names["stop"].set()
        for thread in threads.values():
            thread.join()


def test_a_watched_process_says_its_costs_and_kernels_with_seconds_of_their_own(package):
    found = ab.watched("costs", package, ["texfcodec.busy"])
    assert 0 < found["costs"]["busy.spin"] and sum(found["costs"].values()) <= 1.01 * found["wall"]
    (package / "pair.py").write_text("import numba\n@numba.njit\ndef inner(v): return v + 1\n@numba.njit\n"
                                     "def outer(v): return inner(v)\nassert outer(1) == 2\n")
    kernels = ab.watched("compiled", package, ["pair"])["compiled"]
    assert {name.rsplit(".", 1)[1] for name in kernels} == {"inner", "outer"} and min(kernels.values()) > 0


def cells(text, first):
    """The cells of the first line of a table that begins with a cell."""
    return next([cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith(f"| {first} |"))


def test_the_page_of_pairs_has_medians_and_what_differs():
    def row(wall, content, size=10):
        return {"wall": wall, "processor": 2 * wall, "memory": 1 << 20, "bytes": size, "sha256": content}

    rows = {name: {"encode": {"before": row(10.0, "a"), "after": row(wall, "a")},
                   "save": {"before": row(4.0, "a", 7), "after": row(2.0, glb, 9)}}
            for name, wall, glb in (("cube", 5.0, "a"), ("fan", 8.0, "b"), ("hat", 9.0, "a"))}
    text = ab.page_of("pairs", FOUND | {"rows": rows})
    assert "80 % of the time" in text and "0123 before, 4567 after" in text
    assert cells(text, "fan") == ["fan", "10", "a", "10.0, 8.0", "20.0, 16.0", "the same", "4.0, 2.0", "8.0, 4.0", "+2 bytes",
                                  "2.00", "1"]
    assert cells(text, "hat")[8] == "the same"


def test_the_page_of_costs_has_the_largest_of_either_side(monkeypatch):
    monkeypatch.setattr(ab, "MOST_COSTS", 1)
    side = {"before": {"wall": 5.0, "costs": {"a.f": 3.0, "a.g": 2.0, "a.h": 0.5}},
            "after": {"wall": 2.0, "costs": {"a.f": 0.25, "a.h": 1.5}}}
    text = ab.page_of("costs", FOUND | {"rows": {"cube": {"encode": side, "save": side}}})
    lines = [line[2:] for line in text.splitlines() if line.startswith("| `")]
    assert lines == ["`a.h` | 0.50 | 1.50 |", "`a.f` | 3.00 | 0.25 |"] * 2
    assert cells(text, "all") == ["all", "5.5", "1.8"] and cells(text, "by the wall clock")[1:] == ["5.0", "2.0"]


def test_the_page_of_kernels_has_rooms_and_the_longest(monkeypatch):
    monkeypatch.setattr(ab, "MOST_KERNELS", 1)
    own = {"texfcodec.field.voxelise._touched": 0.5, "texfcodec.field.voxelise._slot": 0.25, "numba.np.arrayobj.impl": 0.004}
    row = {tool: {"wall": 3.0, "compiled": own, "files": 4} for tool in ("texf-enc", "texf-dec")}
    text = ab.page_of("compiled", FOUND | {"commits": ["0123"], "rows": {"cube": row}})
    assert cells(text, "texf-enc")[1:] == ["3.0", "0.8", "3", "4"] and cells(text, "field")[1:] == ["0.75", "0.75"]
    assert cells(text, "field.voxelise._touched")[1:] == ["0.50", "0.50"] and "_slot" not in text and "numba.np" not in text
