"""Guidance by atheris, libFuzzer for Python, where it is installed. It sees Python, so kernels are not compiled.

    NUMBA_DISABLE_JIT=1 python tests/fuzz/atheris_loop.py TARGET FOLDER [flags of libFuzzer]
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

if __package__ in (None, ""):
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

SLOWEST = 90  # seconds of one input, without the compiler
MEGABYTES = 3072
_UNITS = re.compile(rb"stat::number_of_executed_units: *(\d+)")
_KINDS = {"crash": "exception", "timeout": "hang", "oom": "memory"}  # what libFuzzer calls its files


def run_atheris(target, seconds, seed, corpus, found):
    """Answer of a run of a Target: executions and findings; what it keeps goes into the corpus for our own loop."""
    from fuzz.execution import Answer, keep_finding
    from fuzz.supervision import WITHOUT_JIT

    corpus.mkdir(parents=True, exist_ok=True)
    answer, begin = Answer(), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        new, left = Path(folder) / "new", Path(folder) / "left"
        new.mkdir()
        left.mkdir()
        flags = [f"-max_total_time={max(int(seconds), 1)}", f"-seed={seed & 0x7FFFFFFF or 1}", f"-max_len={target.bytes}",
                 "-len_control=0", f"-artifact_prefix={left}/", f"-timeout={SLOWEST}", f"-rss_limit_mb={MEGABYTES}",
                 "-print_final_stats=1"]
        command = [sys.executable, str(Path(__file__)), target.name, str(new), str(corpus), *flags]
        run = subprocess.run(command, capture_output=True, env={**os.environ, **WITHOUT_JIT}, check=False)
        units = _UNITS.findall(run.stderr)
        if not units:
            raise SystemExit(f"atheris does not run: {run.stderr[-2000:].decode('utf-8', 'replace')}")
        answer.executions = int(units[-1])
        for path in new.iterdir():
            (corpus / f"{path.name[:16]}.bin").write_bytes(path.read_bytes())
        for path in sorted(left.iterdir()):
            kind = _KINDS.get(path.name.partition("-")[0], path.name.partition("-")[0])
            said = run.stderr[-2000:].decode("utf-8", "replace")
            answer.findings.append(keep_finding(found, target.name, kind, "atheris", path.read_bytes(), said))
    answer.seconds = time.monotonic() - begin
    return answer


def main():
    """The child's side: atheris takes the process over, and ends it."""
    import atheris

    with atheris.instrument_imports(include=["texfcodec"]):
        from fuzz.targets import TARGETS
    target = TARGETS[sys.argv[1]]
    target.outcome(b"")
    atheris.Setup([sys.argv[0], *sys.argv[2:]], lambda data: target.outcome(data) and None)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
