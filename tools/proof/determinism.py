"""The same bytes everywhere: streams and decoded arrays of the same assets under many configurations, as a table.

python tools/proof/determinism.py [--assets FOLDER] [--out FOLDER] [--environments] [--python FILE ...] [--quick] [--page FILE.md]

Every configuration is a process of its own (tools/proof/determinism_child.py), which proves first that it is what it says: that
numpy, numba and BLAS do without AVX2, that the decimal point is a comma. It codes every asset, and decodes the stream that the
reference made. What cannot be run stands in the table with the reason. --environments makes the virtual environments with other
versions that are not there yet; --python names further interpreters for them. A run goes on where it was stopped. Exit code 7:
something differs.
"""

import argparse
import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.batch.tasks import package_code
from texfcodec.errors import EXIT_DIFFERS
from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table, wrapped
from tools.proof.determinism_child import SCENES

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL_VALUES = 300  # voxels and texels of a vector that interpreted kernels decode in a second
SLOW_PYTHON = "interpreted code is 100 times slower: tiny scenes and small vectors alone"
SETTLED = {"LC_ALL": "C.UTF-8", "TZ": "UTC", "PYTHONHASHSEED": "0"}
CLEARED = ("NUMBA_", "NPY_", "OPENBLAS_", "GLIBC_", "LC_", "LANG", "TZ", "PYTHONUTF8", "PYTHONHASHSEED", "LOCPATH")
ELSEWHERE = "another plâce"  # a folder whose name has a space and a letter that is not ASCII
NO_AVX2 = {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Nehalem",
           "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4,-AVX512F_Usable,-AVX2_Usable,-FMA_Usable,-FMA4_Usable"}

# The twelve assets: many kinds of source, and each by another way of the encoder, at a size that takes seconds.
ASSETS = {
    "avocado": {"rate": "r01"},
    "bball_0001_vcolor": {"resolution": 256, "qp": 24},
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


class NotMade(Exception):
    """A configuration cannot be run; the message says why, in a few words."""


class Case(NamedTuple):
    """An asset to encode and decode, or a stream to decode. name: row of the table, which several cases may share; source,
    options: what is encoded, None if it is only decoded; path: of the asset or the stream; tiny: whether interpreted kernels are
    quick enough."""

    key: str
    name: str
    source: str | None = None
    options: dict = {}
    path: Path | None = None
    tiny: bool = False


@dataclass(frozen=True)
class Configuration:
    """Circumstances of a process. description: a sentence for the page; expects: facts of determinism_child that must begin with
    or equal these; threads, variables: of the process; python, pins: of a virtual environment, its version and the requirements
    that vary; elsewhere: whether it works in another folder; tiny_only: tiny cases alone."""

    name: str
    description: str
    expects: dict
    threads: int = 1
    variables: dict = field(default_factory=dict)
    python: str = ""
    pins: tuple[str, ...] = ()
    elsewhere: bool = False
    tiny_only: bool = False

    @property
    def slug(self):
        """Its name for files."""
        return re.sub(r"\W+", "_", self.name.lower())


REFERENCE = Configuration("reference", "one thread, this interpreter, C.UTF-8, UTC", {"decimal point": ".", "jit": True})
NEWEST = "the newest numba and numpy that fit together"
CONFIGURATIONS = (
    Configuration("2 threads", "two threads, of BLAS too", {}, threads=2),
    Configuration("7 threads", "seven threads, of BLAS too", {}, threads=7),
    Configuration("JIT off", SLOW_PYTHON, {"jit": False}, threads=2, variables={"NUMBA_DISABLE_JIT": "1"}, tiny_only=True),
    Configuration("no AVX2", "numpy, numba, OpenBLAS and the C library without AVX2, AVX-512 and FMA", {"wide": []},
                  variables=NO_AVX2),
    Configuration("Turkish, +05:45", "a Turkish locale, whose decimal point is a comma, time zone of Kathmandu, random hashes",
                  {"decimal point": ",", "offset to UTC": "+0545", "random hashes": True},
                  variables={"LC_ALL": "tr_TR.UTF-8", "TZ": "Asia/Kathmandu", "PYTHONHASHSEED": "random"}),
    Configuration("C, no UTF-8", "the C locale with Python's UTF-8 mode switched off: text is ASCII",
                  {"UTF-8 mode": 0, "encoding": "ANSI_X3.4"},
                  variables={"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}),
    Configuration("another folder", f"copies of the assets in a folder “{ELSEWHERE}”, which is the working folder too", {},
                  elsewhere=True),
    Configuration("numba 0.60, numpy 1.26", "Python 3.11", {"python": "3.11", "numba": "0.60", "numpy": "1.26"}, python="3.11",
                  pins=("numba==0.60.*", "numpy==1.26.*")),
    Configuration("numba 0.60, numpy 2.0", "Python 3.11", {"python": "3.11", "numba": "0.60", "numpy": "2.0"}, python="3.11",
                  pins=("numba==0.60.*", "numpy==2.0.*")),
    Configuration("Python 3.12", NEWEST, {"python": "3.12"}, python="3.12"),
    Configuration("Python 3.13", NEWEST, {"python": "3.13"}, python="3.13"))
QUICK = ("7 threads", "Turkish, +05:45")


def cases_of(assets, quick):
    """Return all Cases: the tiny scenes, and unless quick the sample, assets of a folder (None: none) and the vectors."""
    cases = [Case(name, name, name, options, tiny=True) for name, options in TINY.items()]
    if quick:
        return cases
    cases.append(Case("sample", "sample", "sample", SAMPLE))
    cases += [Case(name, name, name, options, assets / f"{name}.glb") for name, options in ASSETS.items()] if assets else []
    groups = {"small": [], "larger": []}
    for path in sorted((REPOSITORY / "conformance").glob("*/*/case.json")):
        facts = json.loads(path.read_text(encoding="utf-8"))
        if "expect" not in facts:
            values = sum(sum(facts["features"].get(name) or [0]) for name in ("voxels", "texels"))
            groups["small" if values <= SMALL_VALUES else "larger"].append(path.parent)
    return cases + [Case(folder.name, f"{len(group)} {size} vectors", path=folder / "in.texf", tiny=size == "small")
                    for size, group in groups.items() for folder in group]


# Virtual environments with other versions

VARIED = ("numba", "numpy")  # what environments differ in, beside Python; everything else is held at the version in use here


def interpreter_of(version, given=()):
    """Return a Python interpreter of a version such as "3.12": one of those given, this one, or that on PATH. Raises NotMade."""
    for program in filter(None, (*given, sys.executable, shutil.which(f"python{version}"))):
        words = [program, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        try:
            if subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip() == version:
                return program
        except OSError:
            pass
    raise NotMade(f"no Python {version} was found")


def requirements(pins):
    """Return what the package and the demo asset need, as words for pip: pins, and for the rest the versions in use here. scipy
    comes with scikit-image, and brings an OpenBLAS that determinism_child.py inspects."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needs = [*project["dependencies"], *project["optional-dependencies"]["demo"], "scipy"]
    names = [re.match(r"[\w.-]+", text).group() for text in needs]
    pinned = {re.match(r"[\w.-]+", pin).group() for pin in pins}
    held = [f"{name}=={importlib.metadata.version(name)}" for name in names if name not in VARIED]
    return [*pins, *(text for name, text in zip(names, needs, strict=True) if name in VARIED and name not in pinned), *held]


def python_of(configuration, args):
    """Return (interpreter, folder) of a configuration's environment, made first with args.environments. Raises NotMade."""
    name = re.sub(r"[^\w.]+", "_", "-".join([f"python{configuration.python}", *configuration.pins])).strip("_.")
    folder = args.out / "environments" / name
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    if not (folder / "made").exists():
        if not args.environments:
            raise NotMade("its environment is made by --environments only")
        interpreter = interpreter_of(configuration.python, args.python)
        shutil.rmtree(folder, ignore_errors=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
        for words in ([interpreter, "-m", "venv", str(folder)], [*pip, *requirements(configuration.pins)]):
            run = subprocess.run(words, capture_output=True, text=True, check=False)
            if run.returncode:
                said = [line for line in run.stderr.splitlines() if line.startswith("ERROR:")] or run.stderr.splitlines() or [""]
                raise NotMade(f"{words[2]} fails: {said[0].removeprefix('ERROR: ')[:160]}")
        (folder / "made").touch()
    return python, folder


# One configuration


class Run:
    """The rows of one configuration, appended to a file as they come. facts: of its process; rows: {key: row}; reason: why rows
    are missing, or ""."""

    def __init__(self, configuration, folder):
        self.configuration, self.facts, self.rows, self.reason = configuration, None, {}, ""
        self.path, self.code = folder / f"{configuration.slug}.jsonl", package_code()
        try:  # what an earlier run of the same code has left; of other code it is forgotten
            head, *lines = [json.loads(line) for line in self.path.read_text(encoding="utf-8").splitlines()]
        except (OSError, ValueError):
            head, lines = {}, []
        if head.get("code") == self.code:
            self.facts, self.rows = head["facts"], {row["key"]: row for row in lines if "error" not in row}
        else:
            self.path.unlink(missing_ok=True)

    def note(self, row):
        """Append the facts, or a row, to the file."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def run(configuration, cases, args, streams):
    """Run the cases under a configuration; return its Run. streams: {key: stream to decode}; others are encoded there first."""
    run_so_far, todo = Run(configuration, args.out), []
    for case in cases:
        if case.path is not None and not case.path.exists():
            run_so_far.rows.setdefault(case.key, {"key": case.key, "missing": "the asset is not there"})
        elif case.key not in run_so_far.rows and (case.tiny or not configuration.tiny_only):
            todo.append(case)
    try:
        if todo:
            _run_child(run_so_far, todo, args, streams)
    except NotMade as reason:
        run_so_far.reason = str(reason)
    return run_so_far


def _run_child(run_so_far, todo, args, streams):
    configuration = run_so_far.configuration
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch) / ELSEWHERE if configuration.elsewhere else REPOSITORY
        place.mkdir(exist_ok=True)
        jobs = [_job(case, place, configuration, streams, args.out) for case in todo]
        python, variables = _process_of(configuration, args)
        with ((args.out / f"{configuration.slug}.log").open("w") as log,
              subprocess.Popen([python, REPOSITORY / "tools/proof/determinism_child.py"], cwd=place, stderr=log, env=variables,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8") as child):
            try:
                _listen(child, json.dumps({"threads": configuration.threads, "cases": jobs}), run_so_far, todo)
            finally:
                child.kill()


def _job(case, place, configuration, streams, out):
    """A case as the child takes it."""
    source = case.source
    if source is not None and source not in SCENES:
        source = str(shutil.copy(case.path, place / f"{case.key}.glb") if configuration.elsewhere else case.path.resolve())
    decoded = streams.get(case.key) if case.source is not None else case.path
    keep = stream_of(case, configuration, out)
    keep.parent.mkdir(parents=True, exist_ok=True)
    return {"name": case.key, "source": source, "options": case.options, "keep": str(keep),
            "stream": None if decoded is None else str(decoded)}


def stream_of(case, configuration, out):
    """Return the path of the stream of a case under a configuration. out: folder of results."""
    return out / "streams" / configuration.slug / f"{case.key.replace(' ', '_')}.texf"


def _process_of(configuration, args):
    """(interpreter, variables of its environment) of a configuration."""
    clean = {name: value for name, value in os.environ.items() if name == "NUMBA_CACHE_DIR" or not name.startswith(CLEARED)}
    threads = {f"{name}_NUM_THREADS": str(configuration.threads) for name in ("OMP", "OPENBLAS", "MKL")}
    python, variables = sys.executable, {**clean, **SETTLED, **threads, **configuration.variables}
    if configuration.python:
        python, folder = python_of(configuration, args)
        variables["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    if "NUMBA_CPU_NAME" in configuration.variables:
        program = "import numpy as n; c = getattr(n, '_core', None) or n.core; print(*c._multiarray_umath.__cpu_dispatch__)"
        dispatched = subprocess.run([python, "-c", program], capture_output=True, text=True, check=True).stdout.split()
        variables["NPY_DISABLE_CPU_FEATURES"] = " ".join(dispatched)
    if not variables["LC_ALL"].startswith("C"):
        variables["LOCPATH"] = str(_locale(variables["LC_ALL"], args.out / "locales"))
    return python, variables


def _locale(name, folder):
    """A folder that holds a locale, made from the system's own definitions. Raises NotMade."""
    language, charset = name.split(".")
    if not (folder / name).is_dir() and shutil.which("localedef"):
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(["localedef", "-i", language, "-f", charset, str(folder / name)], capture_output=True, check=False)
    if not (folder / name).is_dir():
        raise NotMade(f"this system has no locale {name} and makes none")
    return folder.resolve()


def _listen(child, job, run_so_far, todo):
    """Takes facts and rows from a child as they come. Raises NotMade if it is not what the configuration says."""
    child.stdin.write(job)
    child.stdin.close()
    lines = (json.loads(line) for line in child.stdout)
    facts = next(lines, None)
    if facts is None:
        raise NotMade(f"its process ends with {child.wait()} before it says a word")
    for name, wanted in run_so_far.configuration.expects.items():
        if not (facts[name].startswith(wanted) if isinstance(wanted, str) else facts[name] == wanted):
            raise NotMade(f"{name} is {facts[name]!r}, not {wanted!r}")
    if run_so_far.facts is None:
        run_so_far.note({"code": run_so_far.code, "facts": facts})
    run_so_far.facts = facts
    for row in lines:
        row["key"] = row.pop("name")
        run_so_far.rows[row["key"]] = row
        run_so_far.note(row)
        print(f"{run_so_far.configuration.name}: {row['key']}: {row.get('error') or str(row['seconds']) + ' s'}", flush=True)
    if left := [case for case in todo if case.key not in run_so_far.rows]:
        raise NotMade(f"its process ended with {child.wait()} at {left[0].key}")


# Verdicts, and the page

SAME, STREAM, ARRAYS, FAILS, NOT_RUN = "same", "**stream differs**", "**ARRAYS DIFFER**", "**fails**", "not run"
ORDER = (SAME, NOT_RUN, STREAM, FAILS, ARRAYS)  # of several cases in a row the last one counts
INTRODUCTION = (
    "Each column is a configuration in a process of its own, which is compared with the reference: the SHA-256 of the "
    "stream that it codes, and of every array that it decodes, at all levels and without the finest two, from the stream "
    "*that the reference has coded*; the colours asked at 1000 points are among them. Decoding is integers alone and may "
    "never differ (clause 1 of the specification). An encoder reckons with floating point, and where that rounds otherwise "
    "it may take another decision, whose stream is as valid: so does a fit of 3DNTC (the row with codec 3dntc), hundreds of "
    "steps in fast floating point, which is the same for any number of threads, locale and folder, but not for another "
    "processor or compiler.")


class Verdict(NamedTuple):
    """The comparison of a configuration with the reference. text: one of ORDER; why: details, "" if all is the same."""

    text: str
    why: str = ""

    @property
    def differs(self):
        """Whether it is a reason to end with EXIT_DIFFERS."""
        return self.text not in (SAME, NOT_RUN)


def verdicts_of(runs, cases):
    """Return {row: {configuration: Verdict}} of all runs but the first, the reference, with which they are compared."""
    reference, *others = runs
    table = {}
    for case in cases:
        row = table.setdefault(case.name, {})
        expected = reference.rows.get(case.key)
        for run in others:
            new = _verdict(case, expected, run, reference.reason)
            old = row.get(run.configuration.name, Verdict(SAME))
            row[run.configuration.name] = max(old, new, key=lambda verdict: ORDER.index(verdict.text))
    return table


def _verdict(case, expected, run, reason):
    if expected is None or "missing" in expected:
        return Verdict(NOT_RUN, expected["missing"] if expected else f"the reference was not run: {reason}")
    if "error" in expected:
        return Verdict(FAILS, f"the reference fails: {expected['error']}")
    if run.configuration.tiny_only and not case.tiny:
        return Verdict(NOT_RUN, run.configuration.description)
    row = run.rows.get(case.key)
    if row is None or "missing" in row:
        return Verdict(NOT_RUN, run.reason or row["missing"])
    if "error" in row:
        return Verdict(FAILS, f"{case.key}: {row['error']}")
    arrays = expected["arrays"] | row["arrays"]
    changed = [name for name in arrays if expected["arrays"].get(name) != row["arrays"].get(name)]
    if changed:
        return Verdict(ARRAYS, f"{case.key}: {', '.join(changed)}")
    if row["stream"] != expected["stream"]:
        return Verdict(STREAM, f"{case.key}: {row['bytes']:,} bytes, where the reference has {expected['bytes']:,}")
    return Verdict(SAME)


def page_of(runs, cases, verdicts, options):
    """Return the text of docs/reports/determinism.md. verdicts: of verdicts_of(); options: {row: options of its encode}."""
    reference, *others = runs
    count = {text: sum(v.text == text for row in verdicts.values() for v in row.values()) for text in ORDER}
    same = (f"Of {sum(count.values())} cells {count[SAME]} are the same, {count[NOT_RUN]} were not run, in {count[STREAM]} the "
            f"encoder's stream differs, in {count[ARRAYS]} a decoded array; {count[FAILS]} fail.")
    lines = ["# Determinism", "", f"Made by `make -C tools determinism` (tools/proof/determinism.py) {made_on()}.", "",
             INTRODUCTION, "",
             same, "", *_matrix(others, verdicts), "", "## Configurations", "", *_configurations(runs), "", "## Rows", "",
             *_rows(reference, cases, options)]
    return "\n".join(wrapped(lines)) + "\n"


def _matrix(runs, verdicts):
    names, notes = [run.configuration.name for run in runs], {}

    def cell(verdict, place):
        text = verdict.why if verdict.text == NOT_RUN else f"{place}: {verdict.why}"
        return SAME if verdict.text == SAME else f"{verdict.text} ({notes.setdefault(text.rstrip('.'), len(notes) + 1)})"

    body = [[row, *(cell(cells[name], f"{row}, {name}") for name in names)] for row, cells in verdicts.items()]
    table = markdown_table(["", *names], body, len(names) + 1)
    return [*table, *[""][:len(notes)], *(f"{number}. {text[0].upper()}{text[1:]}." for text, number in notes.items())]


def _configurations(runs):
    rows, head = [], ["configuration", "what it is", "Python", "numba", "numpy", "AVX2 used by", "libm", "locale"]
    for run in runs:
        configuration, facts = run.configuration, run.facts
        name, description = configuration.name, configuration.description
        rows.append([name, f"{description}; not run: {run.reason}", *[""] * (len(head) - 2)] if facts is None else [
            name, description, facts["python"], facts["numba"] + ("" if facts["jit"] else ", JIT off"), facts["numpy"],
            ", ".join(facts["wide"]) or "none", facts["libm"][:6],
            f"point “{facts['decimal point']}”, {facts['offset to UTC']}, {facts['encoding']}"])
    yield ("What each process measured of itself before it began; a configuration that is not what it says is not run. AVX2 "
           "is looked for in numpy's dispatch, in the code that numba makes of a loop, and in the core that OpenBLAS chose; "
           "*libm* is a hash over answers of the C library's sin, exp, log and pow, which has other code for processors without "
           "FMA. Packages beside numba and numpy have the same versions everywhere.")
    yield from ("", *markdown_table(head, rows, len(head)))


def _rows(reference, cases, options):
    rows = []
    for name in dict.fromkeys(case.name for case in cases):
        own = [reference.rows.get(case.key, {}) for case in cases if case.name == name]
        given = ", ".join(f"{key} {value}" for key, value in options.get(name, {}).items()) or "decoded alone"
        rows.append([name, given, f"{sum(row.get('bytes', 0) for row in own):,}"])
    yield from ("Options of the encoder, and bytes of the reference's stream.", "")
    yield from markdown_table(["row", "options", "bytes"], rows, 2)


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, help="folder of the assets; without it scenes made by code alone")
    parser.add_argument("--out", type=Path, default=Path("out/determinism"), help="what is kept of a run, environments too")
    parser.add_argument("--environments", action="store_true", help="make environments that are not there yet; downloads")
    parser.add_argument("--python", action="append", default=[], metavar="FILE", help="a further interpreter; repeatable")
    parser.add_argument("--only", action="append", metavar="NAME", help="this configuration; repeatable")
    parser.add_argument("--quick", action="store_true", help=f"tiny scenes, and of the configurations {' and '.join(QUICK)}")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    args.out, cases = args.out.resolve(), cases_of(args.assets, args.quick)
    wanted = args.only or (QUICK if args.quick else [configuration.name for configuration in CONFIGURATIONS])
    reference = run(REFERENCE, cases, args, {})  # every other decodes what this has encoded
    streams = {case.key: stream_of(case, REFERENCE, args.out) for case in cases if case.source is not None}
    streams = {key: path for key, path in streams.items() if path.exists()}
    chosen = [configuration for configuration in CONFIGURATIONS if configuration.name in wanted]
    runs = [reference, *(run(configuration, cases, args, streams) for configuration in chosen)]
    verdicts = verdicts_of(runs, cases)
    text = page_of(runs, cases, verdicts, {**TINY, "sample": SAMPLE, **ASSETS})
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return EXIT_DIFFERS if any(verdict.differs for row in verdicts.values() for verdict in row.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
