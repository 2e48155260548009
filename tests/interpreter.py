"""A fresh interpreter, and what it has loaded."""

import json
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def modules_after(statement):
    """Names of all modules loaded by a fresh interpreter that ran the statement, and its processor seconds."""
    timed = f"import json, sys, time; start = time.process_time(); {statement}; seconds = time.process_time() - start"
    program = f"{timed}; print(json.dumps([seconds, *sys.modules]))"
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    seconds, *modules = json.loads(run.stdout)
    return modules, seconds
