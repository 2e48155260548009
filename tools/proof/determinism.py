"""The same bytes everywhere: streams and decoded arrays of the same assets under many configurations, as a table.

python tools/proof/determinism.py [--assets FOLDER] [--out FOLDER] [--environments] [--python FILE ...] [--quick] [--page FILE.md]

Every configuration is a process of its own (tools/proof/determinism_child.py), which proves first that it is what it says:
that numpy,
numba and BLAS do without AVX2, that the decimal point is a comma. It codes every asset, and decodes the stream that the reference
made. What cannot be run stands in the table with the reason. --environments makes the virtual environments with other versions
that are not there yet; --python names further interpreters for them. A run goes on where it was stopped. Exit code 7: something
differs.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.batch.tasks import package_code
from texfcodec.errors import EXIT_DIFFERS
from tools.proof.determinism_child import SCENES
from tools.proof.determinism_page import page_of, verdicts_of
from tools.proof.environments import Environment, NotMade, python_of

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL_VALUES = 300  # voxels and texels of a vector that interpreted kernels decode in a second
SLOW_PYTHON = "interpreted code is 100 times slower: tiny scenes and small vectors alone"
SETTLED = {"LC_ALL": "C.UTF-8", "TZ": "UTC", "PYTHONHASHSEED": "0"}
CLEARED = ("NUMBA_", "NPY_", "OPENBLAS_", "GLIBC_", "LC_", "LANG", "TZ", "PYTHONUTF8", "PYTHONHASHSEED", "LOCPATH")
KEPT = ("NUMBA_CACHE_DIR",)
ELSEWHERE = "another plâce"  # a folder whose name has a space and a letter that is not ASCII
NO_AVX2 = {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Nehalem",
           "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4,-AVX512F_Usable,-AVX2_Usable,-FMA_Usable,-FMA4_Usable"}

# The twelve assets: many kinds of source, and each by another way of the encoder, at a size that takes seconds.
ASSETS = {
    "avocado": {"rate": "r01"},
    "bball_0001_vcolor": {"resolution": 256, "qp": 24, "effort": "best"},
    "cat_webp": {"support": "texels", "texel_size": 512, "rate": "r02"},
    "chess_board": {"resolution": 256, "qp": 30},
    "clearcoat_blend": {"resolution": 192, "qp": 28, "effects": "all"},
    "damaged_helmet": {"support": "texels", "texel_size": 256, "rate": "r01"},
    "hard_broken": {"resolution": 200, "lossless": True},
    "hard_hugecoord": {"resolution": 256, "qp": 20},
    "house_mask": {"resolution": 256, "max_error": 2},
    "mars_terrain16": {"target_bytes": 60_000, "effort": "fast"},
    "snapper_vcolor": {"resolution": 128, "qp": 24, "refine": "render", "refine_iterations": 2},
    "tiny_plane": {"codec": "3dntc", "point": "mpeg1", "resolution": 64, "steps": 40},
}
SAMPLE = {"resolution": 256, "qp": 24}
TINY = {"tiny sphere": {"resolution": 8, "qp": 4}, "tiny sheets": {"resolution": 6, "qp": 20, "partition": "off"},
        "tiny maps": {"support": "texels", "qp": 30, "resolution": 8}}


@dataclass(frozen=True)
class Case:
    """name: the row of the table, which many cases may share; source, options: what is coded, None for what is only decoded;
    path: the asset, or the stream that is decoded; tiny: interpreted kernels are quick enough."""

    key: str
    name: str
    source: str | None = None
    options: dict = field(default_factory=dict)
    path: Path | None = None
    tiny: bool = False


@dataclass(frozen=True)
class Configuration:
    """expects: facts of determinism_child that must begin so, or be so, for the configuration to be what its name says; told: a
    sentence for the page; decode, encode: options beside those of the cases, for whoever wants to see a difference."""

    name: str
    told: str
    expects: dict
    threads: int = 1
    variables: dict = field(default_factory=dict)
    environment: Environment | None = None
    elsewhere: bool = False
    tiny_only: bool = False
    encode: dict = field(default_factory=dict)
    decode: dict = field(default_factory=dict)

    @property
    def slug(self):
        """Its name for files."""
        return re.sub(r"\W+", "_", self.name.lower())


REFERENCE = Configuration("reference", "one thread, this interpreter, C.UTF-8, UTC", {"decimal point": ".", "jit": True})
OLD = Environment("3.11", ("numba==0.60.*", "numpy==1.26.*"))
MIDDLE = Environment("3.11", ("numba==0.60.*", "numpy==2.0.*"))
CONFIGURATIONS = (
    Configuration("2 threads", "two threads, of BLAS too", {}, threads=2),
    Configuration("7 threads", "seven threads, of BLAS too", {}, threads=7),
    Configuration("JIT off", SLOW_PYTHON, {"jit": False}, threads=2, variables={"NUMBA_DISABLE_JIT": "1"}, tiny_only=True),
    Configuration("no AVX2", "numpy, numba, OpenBLAS and the C library told to do without AVX2, AVX-512 and FMA", {"wide": []},
                  variables=NO_AVX2),
    Configuration("Turkish, +05:45", "a Turkish locale, whose decimal point is a comma, time zone of Kathmandu, random hashes",
                  {"decimal point": ",", "offset to UTC": "+0545", "random hashes": True},
                  variables={"LC_ALL": "tr_TR.UTF-8", "TZ": "Asia/Kathmandu", "PYTHONHASHSEED": "random"}),
    Configuration("C, no UTF-8", "the C locale with Python's UTF-8 mode switched off: text is ASCII",
                  {"UTF-8 mode": 0, "encoding": "ANSI_X3.4"},
                  variables={"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}),
    Configuration("another folder", f"copies of the assets in a folder “{ELSEWHERE}”, which is the working folder too", {},
                  elsewhere=True),
    Configuration("numba 0.60, numpy 1.26", "Python 3.11", {"python": "3.11", "numba": "0.60", "numpy": "1.26"}, environment=OLD),
    Configuration("numba 0.60, numpy 2.0", "Python 3.11", {"python": "3.11", "numba": "0.60", "numpy": "2.0"},
                  environment=MIDDLE),
    Configuration("Python 3.12", "the newest numba and numpy that fit together", {"python": "3.12"},
                  environment=Environment("3.12")),
    Configuration("Python 3.13", "the newest numba and numpy that fit together", {"python": "3.13"},
                  environment=Environment("3.13")),
)
QUICK = ("7 threads", "Turkish, +05:45")


def cases_of(assets, quick):
    """Every Case: the tiny scenes; unless quick the sample, the assets of a folder (None: none) and the vectors."""
    found = [Case(name, name, name, options, tiny=True) for name, options in TINY.items()]
    if quick:
        return found
    found.append(Case("sample", "sample", "sample", SAMPLE))
    if assets is not None:
        found += [Case(name, name, name, options, assets / f"{name}.glb") for name, options in ASSETS.items()]
    return found + _vectors()


def _vectors():
    small, large = [], []
    for path in sorted((REPOSITORY / "conformance").glob("*/*/case.json")):
        told = json.loads(path.read_text(encoding="utf-8"))
        if "expect" not in told:
            values = sum(sum(told["features"].get(name) or [0]) for name in ("voxels", "texels"))
            (small if values <= SMALL_VALUES else large).append(path.parent)
    return [Case(folder.name, f"{len(group)} {size} vectors", path=folder / "in.texf", tiny=size == "small")
            for size, group in (("small", small), ("larger", large)) for folder in group]


# One configuration


class Run:
    """The rows of one configuration, kept in a file as they come. facts: of its process; rows: {key: row}; reason: why there are
    no more, "" where there are all."""

    def __init__(self, configuration, folder):
        self.configuration, self.facts, self.rows, self.reason = configuration, None, {}, ""
        self.path, self.code = folder / f"{configuration.slug}.jsonl", package_code()
        self._take_up()

    def _take_up(self):
        """Reads what an earlier run of the same code has left; of other code it is forgotten."""
        try:
            head, *lines = [json.loads(line) for line in self.path.read_text(encoding="utf-8").splitlines()]
        except (OSError, ValueError):
            head, lines = {}, []
        if head.get("code") == self.code:
            self.facts, self.rows = head["facts"], {row["key"]: row for row in lines if "error" not in row}
        else:
            self.path.unlink(missing_ok=True)

    def note(self, row):
        """Keeps facts, the first time, or a row."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def missing(self, cases):
        """Those that have no row yet and that the configuration is for."""
        return [case for case in cases if case.key not in self.rows and (case.tiny or not self.configuration.tiny_only)]


def run(configuration, cases, args, streams):
    """The Run of a configuration. streams: {key: file that is decoded}; keys that are missing are coded there first."""
    found = Run(configuration, args.out)
    todo = found.missing(cases)
    absent = [case for case in todo if case.path is not None and not case.path.exists()]
    for case in absent:
        found.rows[case.key] = {"key": case.key, "missing": "the asset is not there"}
    todo = [case for case in todo if case not in absent]
    if todo:
        try:
            _run_child(found, todo, args, streams)
        except NotMade as reason:
            found.reason = str(reason)
    return found


def _run_child(found, todo, args, streams):
    configuration = found.configuration
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch) / ELSEWHERE if configuration.elsewhere else REPOSITORY
        place.mkdir(exist_ok=True)
        job = {"threads": configuration.threads,
               "cases": [_told(case, place, configuration, streams, args.out) for case in todo]}
        python, variables = _process_of(configuration, args)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "encoding": "utf-8"}
        with ((args.out / f"{configuration.slug}.log").open("w") as log,
              subprocess.Popen([python, REPOSITORY / "tools/proof/determinism_child.py"], cwd=place, stderr=log, env=variables,
                               **pipes) as child):
            try:
                _listen(child, json.dumps(job), found, todo)
            finally:
                child.kill()


def _told(case, place, configuration, streams, out):
    """A case as the child is told it."""
    source = case.source
    if source is not None and source not in SCENES:
        source = str(shutil.copy(case.path, place / f"{case.key}.glb") if configuration.elsewhere else case.path.resolve())
    decoded = streams.get(case.key) if case.source is not None else case.path
    keep = out / "streams" / configuration.slug / f"{case.key.replace(' ', '_')}.texf"
    keep.parent.mkdir(parents=True, exist_ok=True)
    return {"name": case.key, "source": source, "options": {**case.options, **configuration.encode}, "keep": str(keep),
            "decode": configuration.decode, "stream": None if decoded is None else str(decoded)}


def _process_of(configuration, args):
    """(interpreter, variables of its environment) of a configuration."""
    clean = {name: value for name, value in os.environ.items() if name in KEPT or not name.startswith(CLEARED)}
    threads = {f"{name}_NUM_THREADS": str(configuration.threads) for name in ("OMP", "OPENBLAS", "MKL")}
    variables = {**clean, **SETTLED, **threads, **configuration.variables}
    python = sys.executable
    if configuration.environment is not None:
        top = args.out / "environments"
        python = python_of(configuration.environment, top, args.environments, args.python)
        variables = {**variables, "NUMBA_CACHE_DIR": str(top / configuration.environment.folder / "kernels")}
    if "NUMBA_CPU_NAME" in configuration.variables:
        program = "import numpy as n; c = getattr(n, '_core', None) or n.core; print(*c._multiarray_umath.__cpu_dispatch__)"
        dispatched = subprocess.run([python, "-c", program], capture_output=True, text=True, check=True).stdout.split()
        variables["NPY_DISABLE_CPU_FEATURES"] = " ".join(dispatched)
    if not configuration.variables.get("LC_ALL", "C").startswith("C"):
        variables["LOCPATH"] = str(_locale(configuration.variables["LC_ALL"], args.out / "locales"))
    return python, variables


def _locale(name, folder):
    """A folder that holds a locale, made from the system's own definitions. Raises NotMade."""
    language, charset = name.split(".")
    if not (folder / name).is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        try:
            subprocess.run(["localedef", "-i", language, "-f", charset, str(folder / name)], capture_output=True, check=False)
        except OSError:
            pass
    if not (folder / name).is_dir():
        raise NotMade(f"this system has no locale {name} and makes none")
    return folder.resolve()


def _listen(child, job, found, todo):
    """Takes facts and rows from a child as they come. Raises NotMade where it is not what the configuration says, or ends."""
    child.stdin.write(job)
    child.stdin.close()
    lines = (json.loads(line) for line in child.stdout)
    facts = next(lines, None)
    if facts is None:
        raise NotMade(f"its process ends with {child.wait()} before it says a word")
    for name, wanted in found.configuration.expects.items():
        is_so = facts[name].startswith(wanted) if isinstance(wanted, str) else facts[name] == wanted
        if not is_so:
            raise NotMade(f"{name} is {facts[name]!r}, not {wanted!r}")
    if found.facts is None:
        found.note({"code": found.code, "facts": facts})
    found.facts = facts
    for row in lines:
        row["key"] = row.pop("name")
        found.rows[row["key"]] = row
        found.note(row)
        print(f"{found.configuration.name}: {row['key']}: {row.get('error') or str(row['seconds']) + ' s'}", flush=True)
    left = [case for case in todo if case.key not in found.rows]
    if left:
        raise NotMade(f"its process ended with {child.wait()} at {left[0].key}")


# All of them


def run_all(cases, configurations, args):
    """[Run], the reference first; every other decodes what that has coded."""
    args.out.mkdir(parents=True, exist_ok=True)
    args.out = args.out.resolve()
    reference = run(REFERENCE, cases, args, {})
    kept = args.out / "streams" / REFERENCE.slug
    streams = {case.key: kept / f"{case.key.replace(' ', '_')}.texf" for case in cases if case.source is not None}
    streams = {key: path for key, path in streams.items() if path.exists()}
    return [reference, *(run(one, cases, args, streams) for one in configurations)]


def main(arguments=None, more=()):
    """Command line of the tool. more: further Configurations."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, help="folder of the assets; without it scenes made by code alone")
    parser.add_argument("--out", type=Path, default=Path("out/determinism"), help="what is kept of a run, environments too")
    parser.add_argument("--environments", action="store_true", help="make environments that are not there yet; downloads")
    parser.add_argument("--python", action="append", default=[], metavar="FILE", help="a further interpreter; repeatable")
    parser.add_argument("--only", action="append", metavar="NAME", help="this configuration; repeatable")
    parser.add_argument("--quick", action="store_true", help=f"tiny scenes, and of the configurations {' and '.join(QUICK)}")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    cases = cases_of(args.assets, args.quick)
    wanted = args.only or (QUICK if args.quick else [one.name for one in CONFIGURATIONS])
    runs = run_all(cases, [*(one for one in CONFIGURATIONS if one.name in wanted), *more], args)
    verdicts = verdicts_of(runs, cases)
    text = page_of(runs, cases, verdicts, {**TINY, "sample": SAMPLE, **ASSETS})
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return EXIT_DIFFERS if any(one.differs for row in verdicts.values() for one in row.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
