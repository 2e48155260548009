"""tools/bench/costs.py: seconds go to the functions that take them, and the page has the largest of both sides."""

import json
import os
import subprocess
import sys
import threading
import time

from tools.bench import costs

MADE = """
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


def made_in(folder):
    """The module made of a package texfcodec below a folder."""
    (folder / "texfcodec").mkdir()
    (folder / "texfcodec" / "__init__.py").write_text("")
    path = folder / "texfcodec" / "made.py"
    path.write_text(MADE)
    return path


def test_a_thread_at_work_is_where_it_is_and_one_that_waits_nowhere(tmp_path):
    """Frames of other files do not count, unless the package called them."""
    path, names = made_in(tmp_path), {}
    exec(compile(MADE, path, "exec"), names)
    threads = {name: threading.Thread(target=names[name]) for name in ("busy", "idle")}
    for thread in threads.values():
        thread.start()
    try:
        end = time.monotonic() + 20
        while time.monotonic() < end:
            frames = sys._current_frames()
            found = {name: costs.place_of(frames[thread.ident]) for name, thread in threads.items()}
            if found == {"busy": "made.busy", "idle": None}:
                break
        assert found == {"busy": "made.busy", "idle": None}
        assert costs.place_of(sys._getframe()) is None
    finally:
        names["stop"].set()
        for thread in threads.values():
            thread.join()


def test_a_process_that_is_watched_tells_functions_of_its_own_package(tmp_path):
    made_in(tmp_path)
    told = tmp_path / "told.json"
    subprocess.run([sys.executable, costs.__file__, costs.WATCH, told, "texfcodec.made"], check=True, cwd=tmp_path,
                   env=os.environ | {"PYTHONPATH": str(tmp_path)})
    found = json.loads(told.read_text())
    assert 0 < found["costs"]["made.spin"] and sum(found["costs"].values()) <= 1.01 * found["wall"]


def test_the_page_has_the_largest_of_either_side():
    side = {"before": {"wall": 5.0, "costs": {"a.f": 3.0, "a.g": 2.0, "a.h": 0.5}},
            "after": {"wall": 2.0, "costs": {"a.f": 0.25, "a.h": 1.5}}}
    text = costs.page_of({"commits": ["0123", "4567"], "rate": "r03", "machine": "2 cores", "rows": {"cube": {
        "encode": side, "save": side}}}, 1)
    lines = text.splitlines()
    assert [line for line in lines if line.startswith("| `a.")] == ["| `a.h` | 0.50 | 1.50 |", "| `a.f` | 3.00 | 0.25 |"] * 2
    assert "| all | 5.5 | 1.8 |" in lines and "| by the wall clock | 5.0 | 2.0 |" in lines
