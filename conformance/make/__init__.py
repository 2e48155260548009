"""The makers of the vectors, and of what the specification says by tables. They call the runner's decoder and the naive one."""

import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
sys.path[1:1] = [str(_ROOT / "conformance"), str(_ROOT / "tests")]
