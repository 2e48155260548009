"""What a process takes, for tools/bench/history.py and tools/bench/pairs.py."""

import os
import subprocess
import sys
import time


def timed(words, root=None):
    """{"wall", "processor" in seconds, "memory" in bytes} of `python -m words`, with the package of a checkout where a root is
    given; CalledProcessError where it fails."""
    begin, variables = time.monotonic(), os.environ | ({"PYTHONPATH": str(root)} if root else {})
    process = subprocess.Popen([sys.executable, "-m", *words], stdout=subprocess.DEVNULL, env=variables, cwd=root)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words)
    return {"wall": time.monotonic() - begin, "processor": used.ru_utime + used.ru_stime, "memory": 1024 * used.ru_maxrss}
