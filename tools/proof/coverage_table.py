"""Branches of everything a decode imports, and which of them no run takes, with the JIT off.

python tools/proof/coverage_table.py [--part NAME ...] [--out FOLDER] [--page docs/reports/coverage.md] [--keep]

What a decode imports is asked of a fresh interpreter, in which texf-dec decodes one vector of each kind (SEEN_ON) to each kind of
file: the modules of texfcodec that it holds at its end are measured, whole, the encoder's side of a file too. Then the PARTS run,
each in a process of its own and with those that it starts, and the library `coverage` adds up the branches that they take.
--part runs some of them only, --keep adds to what earlier runs left in the folder, --out.

A branch that no part takes is missed. coverage_reasons.json says of branches why they cannot or need not be taken, by module,
function and the text of the line, so that a reason holds while its code does. Exit code 7: a part fails, a missed branch has no
reason, or less than LEAST of all branches are taken.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # run as a command
    sys.path.insert(0, str(REPOSITORY))

from tools.bench.provenance import made_on  # noqa: E402
from tools.bench.result_tables import markdown_table, wrapped  # noqa: E402

EXIT_DIFFERS = 7
LEAST = 98.0  # per cent of the branches
REASONS = Path(__file__).with_name("coverage_reasons.json")
# Streams that go different ways, with the files that they are decoded to and how.
SEEN_ON = (("subset/k3", ".npz"), ("subset/k3", ".glb"), ("subset/k3", ".gltf"), ("subset/k3", ".obj"), ("subset/k3", ".ply"),
           ("subset/texels_alpha", ".glb"), ("subset/neural_hash", ".glb"), ("subset/constant", ".glb"),
           ("uncommon/planar_mixed", ".glb"), ("subset/k3", ".glb", "--isolate"))
KERNELS_HERE = ("--engine", "numba")  # without it, a cold cache of kernels leaves the decode and its modules to the sandbox
LISTED = """
import json, sys
from texfcodec.cli.dec import main
try:
    main(sys.argv[2:])
except SystemExit as ended:
    assert ended.code == 0
open(sys.argv[1], "w").write(json.dumps([name for name in sys.modules if name.partition(".")[0] == "texfcodec"]))
"""
JIT_OFF, JIT_ON = {"NUMBA_DISABLE_JIT": "1"}, {"NUMBA_DISABLE_JIT": "0"}
PYTEST = ("-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider",
          "--deselect", "tests/cli/test_cli.py::test_info_is_quick_and_knows_no_numba",  # traced, it is not quick
          "--deselect", "tests/repository/test_api.py::test_mypy_finds_nothing_and_sees_every_public_name",  # it keeps a cache
          "--deselect",
          "tests/repository/test_api.py::test_mypy_refuses_faces_of_the_source_where_those_of_the_sent_mesh_are_due_and_the_reverse")
TESTS = tomllib.loads(Path(__file__).with_name("coverage_parts.toml").read_text(encoding="utf-8"))  # of the parts


@dataclass(frozen=True)
class Part:
    """A run whose branches are measured. call: arguments of the interpreter; variables: of its environment."""

    name: str
    call: tuple[str, ...]
    variables: dict
    description: str


def tests_of(chosen):
    """Return arguments of the interpreter that run quick tests. chosen: "file" or "file::test", of tests/*/test_file.py."""
    parts = [name.partition("::") for name in chosen]
    path = lambda file: next(REPOSITORY.glob(f"tests/*/test_{file}.py")).relative_to(REPOSITORY).as_posix()
    return (*PYTEST, *(f"{path(file)}{between}{test}" for file, between, test in parts))


def description_of(chosen):
    """Return the description of the tests that tests_of(chosen) runs."""
    return "quick tests of " + ", ".join(dict.fromkeys(name.partition("::")[0] for name in chosen))


PARTS = (
    Part("conformance", ("conformance/run.py", "subset/", "uncommon/", "faulty/"), JIT_OFF,
         "every vector but those of everyday size, at every level of detail, with its queries; no JIT"),
    Part("plain", tests_of(TESTS["plain"]), JIT_OFF, description_of(TESTS["plain"]) + "; no JIT"),
    Part("compiled", tests_of(TESTS["compiled"]), JIT_ON, description_of(TESTS["compiled"]) + "; with the JIT"),
    Part("warmup", ("-m", "texfcodec.cli.enc", "--warmup"), JIT_ON, "`texf-enc --warmup`"),
)


@dataclass(frozen=True)
class Branch:
    """A way out of a statement. function, line: where it is; text: first line of the statement; goal: line that it leads to."""

    function: str
    line: int
    text: str
    goal: str

    def key_in(self, module):
        """Return a key of the branch in a module that does not depend on line numbers, only on the text."""
        return f"{module}.{self.function}: {self.text} -> {self.goal}"


@dataclass(frozen=True)
class Module:
    """Coverage of a module: number of statements and branches. missed: the branches that were not taken, by line."""

    name: str
    statements: int
    branches: int
    missed: tuple[Branch, ...]


# What is measured


def modules_of_a_decode(cases=SEEN_ON):
    """Return {name: file} of all modules of texfcodec that decoding imports. cases: decodes that are watched."""
    names = set()
    with tempfile.TemporaryDirectory() as folder:
        for vector, suffix, *more in cases:
            listing = Path(folder) / "modules.json"
            call = [sys.executable, "-c", LISTED, str(listing), str(REPOSITORY / "conformance" / vector / "in.texf"),
                    str(Path(folder) / f"out{suffix}"), "--overwrite", "--quiet",
                    *(more or KERNELS_HERE)]
            subprocess.run(call, cwd=REPOSITORY, env=environment(), check=True)
            names.update(json.loads(listing.read_text(encoding="utf-8")))
    return {name: file for name in sorted(names) if (file := file_of(name)).stat().st_size}


def file_of(module):
    """Return the file of a module of the package. module: dotted name."""
    path = REPOSITORY.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def environment(**variables):
    """This process's, in which the checkout that this file is in comes before an installed one."""
    path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, **variables}


def settings(folder, source=REPOSITORY / "texfcodec"):
    """Write the settings of `coverage` into a folder and return their file. Whole files count: no comment excludes a line."""
    folder = folder.resolve()
    file = folder / "coveragerc"
    (folder / "data").mkdir(parents=True, exist_ok=True)
    file.write_text(f"[run]\nbranch = true\nparallel = true\ndata_file = {folder / 'data' / 'coverage'}\n"
                    f"source = {source}\npatch =\n    subprocess\n    _exit\nsigterm = true\n"
                    "[report]\nexclude_lines = ^if TYPE_CHECKING:\npartial_branches =\n", encoding="utf-8")
    return file


def run_part(part, rc):
    """Run a Part under `coverage` and return (exit code, seconds). rc: file of settings()."""
    start = time.monotonic()
    call = [sys.executable, "-m", "coverage", "run", f"--rcfile={rc}", *part.call]
    ended = subprocess.run(call, cwd=REPOSITORY, env=environment(**part.variables), check=False)
    return ended.returncode, time.monotonic() - start


# What was found


def measured(rc, modules):
    """Return a Module for each of modules {name: file}, from all data that run_part() left beside rc, the settings file."""
    from coverage import Coverage

    coverage = Coverage(config_file=str(rc), data_file=str(rc.parent / "all"))
    coverage.combine([str(file) for file in sorted((rc.parent / "data").iterdir())], keep=True)
    report = rc.parent / "report.json"
    coverage.json_report(outfile=str(report), include=[str(file) for file in modules.values()], ignore_errors=False)
    measured_files = json.loads(report.read_text(encoding="utf-8"))["files"]
    files = {(REPOSITORY / name).resolve(): part for name, part in measured_files.items()}
    return [counted(name, files[file], file.read_text(encoding="utf-8").splitlines()) for name, file in modules.items()]


def counted(name, measured_file, lines):
    """Return the Module of one file. measured_file: its entry in the JSON report of `coverage`; lines: its text."""
    at = lambda line: "end" if line < 0 else lines[line - 1].strip()
    missed = [Branch(function or "module", line, at(line), at(goal))
              for function, part in measured_file["functions"].items() for line, goal in part["missing_branches"]]
    summary = measured_file["summary"]
    return Module(name.removeprefix("texfcodec."), summary["num_statements"], summary["num_branches"],
                  tuple(sorted(missed, key=lambda branch: branch.line)))


def share_of(modules):
    """Return the percentage of the branches of modules that are taken."""
    branches = sum(m.branches for m in modules)
    return 100 * (1 - sum(len(m.missed) for m in modules) / max(branches, 1))


def complaints(modules, reasons):
    """Return a sentence for everything that makes the run fail: branches not taken without a reason, a share that is too low."""
    sentences = [f"{m.name}:{branch.line} is not taken and nothing says why: {branch.key_in(m.name)}"
                 for m in modules for branch in m.missed if branch.key_in(m.name) not in reasons]
    share = share_of(modules)
    return sentences + ([f"{share:.2f} % of the branches are taken, less than {LEAST} %"] if share < LEAST else [])


# The page

INTRODUCTION = (
    "How much of the decoder its tests and vectors run. Measured are whole files: every module of the package that a fresh "
    "interpreter holds after `texf-dec` has decoded a vector of each kind to each kind of file, alone and in a child process. "
    "What encodes stands beside what decodes in the same files, and counts as well; only blocks for the type checker (`if "
    "TYPE_CHECKING`) do not. A branch is a way out of an `if`, `for` or `while`; a condition inside one line (`a if b else c`, "
    "`and`, `or`) is none.")
KERNELS = (
    "A compiled kernel cannot be watched: what runs with the JIT counts for the Python around the kernels alone, and the "
    "branches of kernels are those that plain Python takes.")


def page_of(modules, reasons, runs):
    """Return the text of docs/reports/coverage.md. modules: [Module]; reasons: {branch's key: why}; runs: [(Part, seconds)]."""
    statements, branches, missed = (sum(numbers) for numbers in zip(*((m.statements, m.branches, len(m.missed)) for m in modules),
                                                                 strict=True))
    share = f"{100 * (branches - missed) / max(branches, 1):.2f} %"
    rows = [[m.name, m.statements, m.branches, len(m.missed),
             f"{100 * (m.branches - len(m.missed)) / m.branches:.1f} %" if m.branches else ""] for m in modules]
    left = [[f"{m.name}:{branch.line}", branch.function, f"`{branch.text}`", f"`{branch.goal}`",
             reasons.get(branch.key_in(m.name), "**no reason given**")] for m in modules for branch in m.missed]
    out = ["# Branches of the decoder", "", f"Made by `make -C tools coverage`. {INTRODUCTION}", "",
           f"**{branches - missed} of {branches} branches are taken, {share}**, in {len(modules)} modules of {statements} "
           f"statements; the other {missed} are named below. {KERNELS}", "", "## What runs", "",
           *markdown_table(["part", "what", "seconds"], [[p.name, p.description, f"{spent:.0f}"] for p, spent in runs], 2), "",
           f"Made {made_on()}; other work may have shared the processor.", "", "## By module", "",
           *markdown_table(["module", "statements", "branches", "not taken", "taken"],
                           [*rows, ["all", statements, branches, missed, share]]), "",
           "## Branches not taken", "", *markdown_table(["line", "function", "at", "never goes to", "why"], left, 5)]
    return "\n".join(wrapped(out)) + "\n"


def _arguments(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", action="append", choices=[part.name for part in PARTS], help="run this part alone (repeatable)")
    parser.add_argument("--keep", action="store_true", help="add to what earlier runs left in the folder")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "out" / "coverage", help="folder of what is measured")
    parser.add_argument("--page", type=Path, help="write this Markdown page")
    return parser.parse_args(arguments)


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    args = _arguments(arguments)
    if not args.keep:
        shutil.rmtree(args.out / "data", ignore_errors=True)
    rc, modules = settings(args.out), modules_of_a_decode()
    times, failed = args.out / "seconds.json", []
    spent = json.loads(times.read_text(encoding="utf-8")) if args.keep and times.exists() else {}
    for part in PARTS:
        if args.part is None or part.name in args.part:
            code, spent[part.name] = run_part(part, rc)
            failed += [f"{part.name} ends with {code}"] if code else []
            print(f"{part.name}: {spent[part.name]:.0f} s", flush=True)
    times.write_text(json.dumps(spent), encoding="utf-8")
    reasons = json.loads(REASONS.read_text(encoding="utf-8"))
    measured_modules = measured(rc, modules)
    if args.page:
        runs = [(part, spent[part.name]) for part in PARTS if part.name in spent]
        args.page.write_text(page_of(measured_modules, reasons, runs), encoding="utf-8")
    wrong = failed + complaints(measured_modules, reasons)
    branches = sum(m.branches for m in measured_modules)
    print("\n".join([*wrong, f"{share_of(measured_modules):.2f} % of {branches} branches in {len(measured_modules)} modules"]))
    return EXIT_DIFFERS if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
