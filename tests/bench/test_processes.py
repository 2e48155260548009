import subprocess
import sys

import pytest

from tools.bench.processes import timed


@pytest.mark.skipif(sys.platform == "win32", reason="os.wait4")
def test_what_a_process_takes_is_told_and_its_failure_is_no_measurement():
    found = timed(["timeit", "-n1", "-r1", "import time; time.sleep(0.6)"])
    assert 0 < found["processor"] < 0.5 < found["wall"] and found["memory"] > 1 << 20
    with pytest.raises(subprocess.CalledProcessError):
        timed(["timeit", "-n1", "-r1", "raise SystemExit(3)"])


def test_a_process_runs_the_package_of_its_checkout(tmp_path):
    (tmp_path / "found_there.py").write_text("print(1)")
    timed(["found_there"], tmp_path)
    with pytest.raises(subprocess.CalledProcessError):
        timed(["found_there"])
