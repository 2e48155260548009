"""bench/costs.py: seconds go to the functions that take them, and the page has the largest of both sides."""

import json
import os
import subprocess
import sys

from bench import costs

MADE = """
import threading, time
def busy():
    end = time.perf_counter() + 0.4
    while time.perf_counter() < end: pass
worker = threading.Thread(target=busy)
worker.start()
busy()
worker.join()
threading.Event().wait(0.3)
"""


def test_all_threads_count_and_those_that_wait_do_not(tmp_path):
    package = tmp_path / "texfcodec"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "made.py").write_text(MADE)
    told = tmp_path / "told.json"
    subprocess.run([sys.executable, costs.__file__, costs.WATCH, told, "texfcodec.made"], check=True, cwd=tmp_path,
                   env=os.environ | {"PYTHONPATH": str(tmp_path)})
    found = json.loads(told.read_text())
    assert 0.4 < found["costs"]["made.busy"] <= 2 * found["wall"] and found["wall"] > 0.7
    assert found["costs"].get("made.<module>", 0) < 0.2


def test_the_page_has_the_largest_of_either_side():
    side = {"before": {"wall": 5.0, "costs": {"a.f": 3.0, "a.g": 2.0, "a.h": 0.5}},
            "after": {"wall": 2.0, "costs": {"a.f": 0.25, "a.h": 1.5}}}
    text = costs.page_of({"commits": ["0123", "4567"], "rate": "r03", "machine": "2 cores", "rows": {"cube": {
        "encode": side, "save": side}}}, 1)
    lines = text.splitlines()
    assert [line for line in lines if line.startswith("| `a.")] == ["| `a.h` | 0.50 | 1.50 |", "| `a.f` | 3.00 | 0.25 |"] * 2
    assert "| all | 5.5 | 1.8 |" in lines and "| by the wall clock | 5.0 | 2.0 |" in lines
