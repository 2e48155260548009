"""The highest memory of a process that refuses a faulty stream.

python tools/proof/load_refused.py STREAM OUT      texf-dec of one stream; its exit code and highest memory as JSON on stdout
python tools/proof/load_refused.py  streams by lines of stdin, each in a fork of one warm process, a line of JSON each
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.proof.memory import resident

REPOSITORY = Path(__file__).resolve().parents[2]
FAULTY = REPOSITORY / "conformance" / "faulty"
GOOD = ("subset/k33", "subset/texels", "subset/maps_texels", "subset/neural_resident", "uncommon/normals_marks")
TARGET, WORST = 256 << 20, 10
BASELINES = {"Python alone": "pass", "with numpy and numba": "import numpy, numba",
             "with the whole decoder": "import texfcodec.decoder, texfcodec.cli.dec"}


def refused_by_tool(path, out):
    """Runs texf-dec in this process: {"code", "peak"}, its exit code and the highest memory of the process in bytes."""
    from texfcodec.cli.dec import main

    try:
        main([str(path), str(out), "--quiet"])
        code = 0
    except SystemExit as ended:
        code = ended.code
    return {"code": code, "peak": resident("VmHWM")}


def _in_forks():
    """Decodes the good vectors, then every stream whose path stands on a line of stdin in a child of its own."""
    from texfcodec.api import decode
    from texfcodec.errors import TexfError
    from texfcodec.options import DecodeOptions

    def refuse(path):
        try:
            decode(path.read_bytes(), DecodeOptions(threads=1))
            return 0
        except TexfError as error:
            return error.exit_code

    for name in GOOD:
        assert refuse(REPOSITORY / "conformance" / name / "in.texf") == 0
    print(json.dumps({"idle": resident("VmRSS")}), flush=True)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            began = resident("VmRSS")  # less than the parent's: pages of files are mapped when they are touched
            told = {"path": line.strip(), "code": refuse(Path(line.strip())), "peak": resident("VmHWM"), "began": began}
            os.write(1, json.dumps(told).encode() + b"\n")
            os._exit(0)
        os.waitpid(child, 0)


# The parent's side


def in_forks(paths):
    """(memory of the warm process in bytes, {path: {"code", "peak", "began"}}); a child that fell has no answer."""
    run = _child((), "\n".join(map(str, paths)))
    head, *rows = map(json.loads, run.splitlines())
    return head["idle"], {Path(row.pop("path")): row for row in rows}


def by_tool(path):
    """{"code", "peak"} of texf-dec in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        return json.loads(_child((str(path), f"{folder}/a.npz"), ""))


def _child(words, told):
    run = subprocess.run([sys.executable, __file__, *words], input=told, stdout=subprocess.PIPE, check=True, text=True,
                         cwd=REPOSITORY, env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    return run.stdout


def baselines():
    """{what is imported: highest memory in bytes}; last, texf-dec of a good vector."""
    program = "{}\nprint([l for l in open('/proc/self/status') if l.startswith('VmHWM')][0].split()[1])"
    found = {name: 1024 * int(subprocess.run([sys.executable, "-c", program.format(words)], capture_output=True, text=True,
                                             check=True, cwd=REPOSITORY).stdout) for name, words in BASELINES.items()}
    return found | {f"texf-dec of {GOOD[0]}": by_tool(REPOSITORY / "conformance" / GOOD[0] / "in.texf")["peak"]}


def run_refused(every=False):
    """{"idle", "baselines", "rows": {vector: {"code", "peak"}}, "tool": the same of the worst, or of every one, by texf-dec}."""
    paths = sorted(FAULTY.glob("*/in.texf"))
    idle, rows = in_forks(paths)
    fallen = [path.parent.name for path in paths if path not in rows]
    named = {path.parent.name: row for path, row in rows.items()}
    worst = sorted(named, key=lambda name: -named[name]["peak"])
    tool = {name: by_tool(FAULTY / name / "in.texf") for name in (worst if every else worst[:WORST])}
    return {"idle": idle, "baselines": baselines(), "rows": named, "fallen": fallen, "tool": tool}


def refused_faults(found):
    """What misses the target: sentences."""
    high = [f"{name}: {row['peak'] >> 20} MB" for rows in (found["rows"], found["tool"]) for name, row in rows.items()
            if row["peak"] > TARGET]
    taken = [f"{name}: decoded" for rows in (found["rows"], found["tool"]) for name, row in rows.items() if row["code"] == 0]
    return [*high, *taken, *(f"{name}: its process fell" for name in found["fallen"])]


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(refused_by_tool(*map(Path, sys.argv[1:3]))))
    else:
        _in_forks()
