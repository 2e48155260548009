"""A target in child processes: those that crash, hang or take too much memory cost one input each, and are begun again.

Findings of every kind are run once more, compiled and with all indices checked, before they count as hangs.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from fuzz.execution import PANEL_BYTES, Answer, Panel, Request, keep_finding

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
HANG_SECONDS = 10.0  # of one input, compiled
SLOW_HANG_SECONDS = 90.0  # kernels as plain Python, and traced
START_SECONDS = 900.0  # until the first input: kernels are compiled, on a busy machine
LOOK_SECONDS = 0.1
WITHOUT_JIT = {"NUMBA_DISABLE_JIT": "1"}


@dataclass
class Ended:
    """How a child ended: its answer, or else what the panel said then. kind: "", "crash" or "hang"."""

    answer: Answer | None
    kind: str = ""
    executions: int = 0
    data: bytes = b""
    said: str = ""


def run_child(request: Request, environment: dict[str, str], hang: float) -> Ended:
    """One child process, to its end or until an input takes longer than `hang` seconds."""
    with tempfile.NamedTemporaryFile() as file, tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        file.write(bytes(PANEL_BYTES))
        file.flush()
        panel = Panel(file.name)
        command = [sys.executable, str(HERE / "execution.py"), file.name, json.dumps(asdict(request))]
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=err, env={**os.environ, **environment})
        kind, began = "", time.monotonic()
        while child.poll() is None:
            time.sleep(LOOK_SECONDS)
            executions, begin, _ = panel.read()
            now = time.monotonic()
            if (begin and now - begin > hang) or (not executions and not begin and now - began > START_SECONDS):
                kind = "hang"
                child.kill()
                child.wait()
        out.seek(0)
        err.seek(0)
        if child.returncode == 0:
            return Ended(Answer(**json.loads(out.read().decode().splitlines()[-1])))
        executions, begin, data = panel.read()
        said = err.read().decode("utf-8", "replace")[-2000:]
        how = signal.Signals(-child.returncode).name if child.returncode < 0 else f"exit code {child.returncode}"
        if not begin and not kind:
            raise SystemExit(f"the harness of {request.target} fails, not an input: {how}\n{said}")
        return Ended(None, kind or "crash", executions, data, f"{how}\n{said}")


def supervise(request: Request, environment: dict[str, str] | None = None) -> Answer:
    """Runs a request for its time, with as many children as it takes."""
    whole, environment = Answer(), environment or {}
    hang = SLOW_HANG_SECONDS if environment.get("NUMBA_DISABLE_JIT") else HANG_SECONDS
    left, seed = request.seconds, request.seed
    while True:
        begin = time.monotonic()
        ended = run_child(Request(**{**asdict(request), "seconds": left, "seed": seed}), environment, hang)
        if ended.answer is not None:
            return _joined(whole, ended.answer)
        whole.executions += ended.executions
        whole.findings.append(keep_finding(Path(request.found), request.target, ended.kind, "", ended.data, ended.said))
        spent = min(time.monotonic() - begin, left)
        whole.seconds += spent
        left, seed = left - spent, seed + 1000
        if left <= 1 or request.mode == "replay":
            return whole


def _joined(a: Answer, b: Answer) -> Answer:
    """Two parts of one run; the later one knows all branches, because it began with what the earlier one kept."""
    outcomes = {name: a.outcomes.get(name, 0) + b.outcomes.get(name, 0) for name in {**a.outcomes, **b.outcomes}}
    return Answer(a.executions + b.executions, a.seconds + b.seconds, outcomes, b.taken, b.missed, b.kept,
                  a.findings + b.findings)


def checked(cache: Path) -> dict[str, str]:
    """Environment of a child whose compiled code checks every index; its kernels are kept apart."""
    return {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(cache)}


def confirm(finding: dict, found: Path, cache: Path) -> dict:
    """The finding with what becomes of its input compiled and with indices checked: "value", a code, or what goes wrong."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / finding["file"]).write_bytes((found / finding["file"]).read_bytes())
        request = Request(finding["target"], "replay", 1e9, 0, folder, folder)
        ended = run_child(request, checked(cache), HANG_SECONDS)
    if ended.answer is None:
        return {**finding, "checked": ended.kind, "checked_said": ended.said}
    again = ended.answer.findings
    return {**finding, "checked": again[0]["place"] or again[0]["kind"] if again else next(iter(ended.answer.outcomes), "")}


def is_real(finding: dict) -> bool:
    """A hang of traced Python that the compiled code does not share is none, nor is memory that compiling took."""
    return finding["kind"] not in ("hang", "memory") or finding.get("checked", finding["kind"]) == finding["kind"]
