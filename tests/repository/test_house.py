"""What a program can enforce of CONTRIBUTING.md. Each check is also shown to catch what it is there for."""

import ast
import re
import shutil
import statistics
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest
from conftest import LONG_TESTS
from interpreter import modules_after

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "texfcodec"
LONGEST_FUNCTION, LONGEST_FILE = 90, 600
IMPORT_SECONDS = 0.3
MACHINE_PATH = re.compile(r"(?<![\w.~-])/(?:work|root|home|Users|opt|tmp)/\w|\b[A-Z]:\\Users\\")
REGISTRY_HOST = re.compile(r"https?://[^\s\"')]*(?:pypi|pythonhosted|npmjs|artifactory|devpi)")
FAST_MATHS = "texfcodec/codecs/neural/train.py"  # the fit's own kernels, whose rounding no decoder sees
DRAWERS = {"util", "utils", "helper", "helpers", "common", "manager", "managers", "misc"}
JIT = {"njit", "jit", "vectorize", "guvectorize", "cfunc", "stencil"}


# Checks: source or tree in, findings out.


def functions_of(tree):
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def name_of(node):
    """`njit` for both njit and numba.njit, "" for anything that is not a name."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def long_functions(tree):
    lengths = [(f.name, f.end_lineno - f.lineno + 1) for f in functions_of(tree)]
    return [f"{name} has {length} lines" for name, length in lengths if length > LONGEST_FUNCTION]


def undocumented_functions(tree):
    public = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef) and not n.name.startswith("_")]
    return [f"{f.name} has no docstring" for f in public if not ast.get_docstring(f)]


def incomplete_signatures(tree):
    """Public functions, and methods of public classes, where a parameter or the result has no type. Kernels get theirs from
    numba, the parameters of a command from click."""
    kinds = [n for n in tree.body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")]
    named = [(f, f.name) for f in _defined(tree.body)]
    named += [(f, f"{kind.name}.{f.name}") for kind in kinds for f in _defined(kind.body)]
    untyped = [name for f, name in named if not _is_typed(f, name) and not _decorators(f) & (JIT | {"kernel", "command"})]
    return [f"{name} has no complete signature" for name in untyped]


def _defined(body):
    functions = [n for n in body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    return [f for f in functions if not f.name.startswith("_") or f.name == "__init__"]


def _decorators(function):
    return {name_of(getattr(d, "func", d)) for d in function.decorator_list}


def _is_typed(function, name):
    given = function.args
    taken = [*given.posonlyargs, *given.args]
    is_bound = "." in name and "staticmethod" not in _decorators(function)  # self or cls, which needs no type
    more = [a for a in (given.vararg, *given.kwonlyargs, given.kwarg) if a is not None]
    return function.returns is not None and all(a.annotation is not None for a in taken[is_bound:] + more)


def uncached_kernels(tree):
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and name_of(node.func) in JIT]
    called = {id(call.func) for call in calls}
    bare = [n for n in ast.walk(tree) if isinstance(n, ast.Name | ast.Attribute) and name_of(n) in JIT and id(n) not in called]
    uncached = [c for c in calls if not any(k.arg == "cache" and getattr(k.value, "value", None) is True for k in c.keywords)]
    return [f"line {node.lineno}: {name_of(getattr(node, 'func', node))} without cache=True" for node in bare + uncached]


def fast_maths(tree):
    """fastmath as a keyword of a call or as a key of a dict that may become one."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    given = [(k.lineno, k.value) for call in calls for k in call.keywords if k.arg == "fastmath"]
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            pairs = zip(node.keys, node.values, strict=True)
            given += [(k.lineno, v) for k, v in pairs if getattr(k, "value", None) == "fastmath"]
    return [f"line {line}: fastmath" for line, value in given if getattr(value, "value", None) is not False]


def drawer_names(tree):
    named = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)] + functions_of(tree)
    words = {n.name: {w.lower() for w in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", n.name)} for n in named}
    return [f"{name} says nothing" for name, parts in words.items() if parts & (DRAWERS - {"common"})]


def claimless_tests(tree):
    """Tests that neither assert nor expect an error, nor call a function of the same file that does."""
    functions = {f.name: f for f in functions_of(tree)}
    claiming = set()
    while True:
        found = {name for name, f in functions.items() if any(_claims(node, claiming) for node in ast.walk(f))}
        if found == claiming:
            return [f"{name} claims nothing" for name in functions if name.startswith("test") and name not in claiming]
        claiming = found


def _claims(node, claiming):
    if isinstance(node, ast.Assert):
        return True
    name = name_of(node.func) if isinstance(node, ast.Call) else ""
    return name in {"raises", "warns", "fail"} | claiming or name.startswith("assert_")


# The repository as it stands.


def tracked_files():
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, check=False)
    if listing.returncode != 0:
        pytest.skip("not a git checkout: there is no list of tracked files")
    paths = [REPOSITORY / name for name in listing.stdout.decode().split("\0") if name]
    return [path for path in paths if path.is_file()]


@lru_cache
def parsed(folder):
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.py"))}


def findings(check, folder=PACKAGE):
    trees = parsed(folder)
    return [f"{path.relative_to(REPOSITORY).as_posix()}: {finding}" for path, tree in trees.items() for finding in check(tree)]


@pytest.mark.parametrize("check", [long_functions, undocumented_functions, incomplete_signatures, uncached_kernels, fast_maths,
                                   drawer_names])
def test_package_has_no(check):
    found = [finding for finding in findings(check) if not (check is fast_maths and finding.startswith(FAST_MATHS))]
    assert not found, "\n".join(found)


def test_every_test_claims_something():
    found = findings(claimless_tests, REPOSITORY / "tests")
    assert not found, "\n".join(found)


def test_long_tests_are_tests():
    found = {(path.stem, node.name) for path in (REPOSITORY / "tests").rglob("test_*.py")
             for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.FunctionDef)}
    assert [name for module, names in LONG_TESTS.items() for name in names if (module, name) not in found] == []


def test_no_file_of_the_package_is_too_long():
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in PACKAGE.rglob("*.py")}
    assert [f"{path.name} has {length} lines" for path, length in lengths.items() if length > LONGEST_FILE] == []


def test_no_module_or_folder_is_a_drawer():
    names = [path.relative_to(REPOSITORY).with_suffix("").as_posix() for path in tracked_files() if path.suffix == ".py"]
    assert [name for name in names if DRAWERS & set(re.split("[/_]", name))] == []


def test_no_tracked_file_names_a_machine_path_or_a_registry():
    found = []
    for path in tracked_files():
        data = path.read_bytes()
        text = "" if b"\0" in data else data.decode("utf-8", "replace")
        hits = [hit.group() for pattern in (MACHINE_PATH, REGISTRY_HOST) for hit in pattern.finditer(text)]
        found += [f"{path.relative_to(REPOSITORY)}: {hit}" for hit in hits]
    assert not found, "\n".join(found)


# The rooms, each with those that it may enter before it; the last ones are the doors.
ORDER = ("errors", "findings", "limits", "report", "core", "scene", "geometry", "field", "codecs", "bitstream", "options", "texf",
         "decoder", "io", "render", "metrics", "encoder", "sandbox", "validate", "api", "precompile", "batch", "viewer", "cli",
         "demo", "__init__")


# Methods of a Texf that users call on it, and that enter the rooms of their work when they are called.
DOORS = {("texf.py", "io"), ("texf.py", "render")}


def rooms_entered(tree, package):
    """Rooms that a file imports from, at the top or inside functions. package: where the file is, as ["texfcodec", ...]."""
    for node in imports_that_run(tree):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").split(".")[0] == "texfcodec"):
            base = package[: len(package) + 1 - node.level] if node.level else []
            path = [*base, *(node.module.split(".") if node.module else [])]
            for name in [a.name for a in node.names] if len(path) == 1 else [path[1]]:
                yield name if (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file() else "__init__"


def imports_that_run(tree):
    """All nodes but those below `if TYPE_CHECKING`, which only type checkers and editors follow."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and name_of(node.test) == "TYPE_CHECKING":
            yield from (inner for other in node.orelse for inner in ast.walk(other))
            continue
        yield node
        yield from imports_that_run(node)


def against_the_order(files):
    """Imports of a room that stands later, or of itself as a package. files: {path in the package: tree}."""
    for path, tree in files.items():
        room = path.parts[0].removesuffix(".py")
        for entered in rooms_entered(tree, ["texfcodec", *path.parent.parts]):
            public = entered == "__init__" and room in ("demo", "cli")  # they use the package as its users do
            door = (path.as_posix(), entered) in DOORS
            if entered != room and not public and not door and ORDER.index(entered) >= ORDER.index(room):
                yield f"{path.as_posix()} imports {entered}"


def test_no_import_runs_against_the_order_of_the_rooms():
    paths = [path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py")]
    assert {path.parts[0].removesuffix(".py") for path in paths} == set(ORDER)
    assert list(against_the_order({path: ast.parse((PACKAGE / path).read_text(encoding="utf-8")) for path in paths})) == []


@pytest.mark.parametrize("path, line", [
    ("core/x.py", "from ..field.grid import y"), ("field/x.py", "def f():\n    from ..codecs import y"),
    ("codecs/raht/x.py", "from ...encoder import y"), ("decoder.py", "from .encoder import encode"),
    ("texf.py", "from . import decode"), ("scene/x.py", "from texfcodec.options import y"),
    ("io/x.py", "if TYPE_CHECKING:\n    pass\nelse:\n    from ..encoder import y"),
])
def test_an_import_against_the_order_is_found(path, line):
    assert len(list(against_the_order({Path(path): ast.parse(line)}))) == 1


def test_an_import_for_type_checking_alone_may_cross_the_order():
    assert list(against_the_order({Path("scene/x.py"): ast.parse("if TYPE_CHECKING:\n    from ..texf import Texf")})) == []


def circles(paths):
    """Groups of modules that import each other in a ring, at the top or inside functions. paths: of files of the package."""
    names = {".".join(("texfcodec", *path.with_suffix("").parts)).removesuffix(".__init__"): path for path in paths}
    after = {name: set(modules_entered(ast.parse((PACKAGE / path).read_text(encoding="utf-8")), path, names)) - {name}
             for name, path in names.items()}
    reached: dict = {}
    for name in names:
        seen, front = set(), [name]
        while front:
            new = after[front.pop()] - seen
            seen |= new
            front += new
        reached[name] = seen
    rings = {frozenset(other for other in reached[name] if name in reached[other]) for name in names if name in reached[name]}
    return sorted(sorted(ring) for ring in rings)


def modules_entered(tree, path, names):
    """Names of the package's modules that a file imports, as rooms_entered() looks for rooms."""
    package = ["texfcodec", *path.parent.parts]
    for node in imports_that_run(tree):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").split(".")[0] == "texfcodec"):
            base = package[: len(package) + 1 - node.level] if node.level else []
            source = ".".join([*base, *(node.module.split(".") if node.module else [])])
            yield from (f"{source}.{a.name}" if f"{source}.{a.name}" in names else source for a in node.names)


def test_no_modules_import_each_other():
    paths = [path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py")]
    doors = {"texfcodec", "texfcodec.texf"}  # __init__ names what it hands out; a Texf's methods enter io and render
    assert [ring for ring in circles(paths) if not doors & set(ring)] == []


def test_at_most_three_files_outside_the_codecs_name_one():
    """By its name as users type it, in code or in words; options are the table that users read."""
    named = re.compile(r"\b(raht|3dntc|neural)\b", re.IGNORECASE)
    found = [path.relative_to(PACKAGE).as_posix() for path in sorted(PACKAGE.rglob("*.py"))
             if named.search(path.read_text(encoding="utf-8")) and path.relative_to(PACKAGE).parts[0] != "codecs"]
    assert len(found) <= 3, found


def test_decoder_never_meets_torch_or_the_encoder_side_rooms():
    if not (PACKAGE / "decoder.py").exists():
        pytest.skip("texfcodec/decoder.py is not written yet")
    rooms = ("render", "encoder", "codecs.neural.fit", "codecs.neural.fit_payload", "cli")
    strangers = ("torch", *(f"texfcodec.{room}" for room in rooms))
    modules, _ = modules_after("import texfcodec.decoder")
    assert "texfcodec.decoder" in modules
    assert [m for m in modules if m in strangers or m.startswith(tuple(s + "." for s in strangers))] == []


def test_package_is_imported_fast_and_without_numba():
    runs = [modules_after("import texfcodec") for _ in range(3)]
    assert "numba" not in runs[0][0] and "torch" not in runs[0][0]
    # processor time, so that a busy machine does not fail the test
    assert statistics.median(seconds for _, seconds in runs) < IMPORT_SECONDS


def test_a_name_that_the_package_does_not_have_is_an_attribute_error():
    import texfcodec

    for name, there in (("decode", True), ("transcode", False)):
        assert hasattr(texfcodec, name) == there


def test_the_steps_from_a_mesh_to_a_stream_name_functions_that_are_there():
    text = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    steps = text[text.index("in ten steps") : text.index("## Adding to it")]
    named = re.findall(r"`(?:\w+\.)?(\w+)(?:\(\))?`\s+\(([\w/]+\.py)\)", steps)
    assert len(re.findall(r"^\d+\. \*\*", steps, re.MULTILINE)) == 10 and len(named) >= 15
    defined = {file: {node.name for node in ast.walk(ast.parse((PACKAGE / file).read_text(encoding="utf-8")))
                      if isinstance(node, ast.FunctionDef | ast.ClassDef)} for _, file in named}
    assert [(name, file) for name, file in named if name not in defined[file]] == []


# The checks themselves, against what they must catch and must let pass.


@pytest.mark.parametrize(
    "check, bad",
    [
        (long_functions, "def f():\n" + "    x = 1\n" * LONGEST_FUNCTION),
        (undocumented_functions, "def f():\n    return 1"),
        (incomplete_signatures, "def f(a: int): pass"),
        (incomplete_signatures, "def f(a) -> int: pass"),
        (incomplete_signatures, "def f(*a, b: int) -> int: pass"),
        (incomplete_signatures, "def f(a: int, *, b=1) -> int: pass"),
        (incomplete_signatures, "def f(**a) -> int: pass"),
        (incomplete_signatures, "class A:\n    def f(self, a) -> int: pass"),
        (incomplete_signatures, "class A:\n    def __init__(self): pass"),
        (incomplete_signatures, "class A:\n    @property\n    def f(self): pass"),
        (incomplete_signatures, "class A:\n    @staticmethod\n    def f(a) -> int: pass"),
        (uncached_kernels, "@njit\ndef _f(): pass"),
        (uncached_kernels, "@numba.njit\ndef _f(): pass"),
        (uncached_kernels, "@numba.njit(nogil=True)\ndef _f(): pass"),
        (uncached_kernels, "_jit = nb.njit(cache=False)"),
        (fast_maths, "@njit(cache=True, fastmath=True)\ndef _f(): pass"),
        (fast_maths, "@njit(cache=True, fastmath={'nnan'})\ndef _f(): pass"),
        (fast_maths, "fused = {'fastmath': True}"),
        (drawer_names, "class MeshManager: pass"),
        (drawer_names, "def _read_helper(): pass"),
        (claimless_tests, "def test_x():\n    f()"),
        (claimless_tests, "def g():\n    h()\ndef test_x():\n    g()"),
    ],
)
def test_check_catches(check, bad):
    assert len(check(ast.parse(bad))) == 1


@pytest.mark.parametrize(
    "check, good",
    [
        (long_functions, "def f():\n" + "    x = 1\n" * (LONGEST_FUNCTION - 1)),
        (undocumented_functions, "def f():\n    'Says what.'\ndef _g(): pass\nclass A:\n    def h(self): pass"),
        (incomplete_signatures, "def f(a: int, *b: int, c: int = 1, **d: int) -> int: pass\ndef _g(a): pass"),
        (incomplete_signatures, "class A:\n    def __init__(self, a: int) -> None: pass\n    def _f(self, a): pass"),
        (incomplete_signatures, "class A:\n    @property\n    def f(self) -> int: pass\nclass _B:\n    def f(self, a): pass"),
        (incomplete_signatures, "@click.command('x')\ndef f(a): pass\n@kernel\ndef g(a): pass\n@kernel(x=1)\ndef h(a): pass"),
        (uncached_kernels, "from numba import njit\n@njit(cache=True)\ndef _f(): pass\n_jit = nb.njit(cache=True)"),
        (fast_maths, "@njit(cache=True, fastmath=False)\ndef _f(): pass"),
        (drawer_names, "def common_prefix(): pass\nclass Image: pass"),
        (claimless_tests, "def test_x():\n    with pytest.raises(ValueError):\n        f()"),
        (claimless_tests, "def g():\n    np.testing.assert_array_equal(1, 1)\ndef h():\n    g()\ndef test_x():\n    h()"),
    ],
)
def test_check_lets_pass(check, good):
    assert check(ast.parse(good)) == []


def test_path_and_host_patterns_catch_what_they_are_for():
    paths = ["/wo" + "rk/main", "see /ho" + "me/me/x", "'/tm" + "p/venv'", "C:\\Use" + "rs\\me"]
    hosts = ["https://py" + "pi.org/simple", "http://mirror.example/py" + "pi/x"]
    assert all(MACHINE_PATH.search(text) for text in paths) and all(REGISTRY_HOST.search(text) for text in hosts)
    fine = ["tests/tmp/x", "a/work/b", "/images/1", "https://example.org/home/page", "/usr/bin/env bash", "../home/x"]
    assert not any(MACHINE_PATH.search(text) or REGISTRY_HOST.search(text) for text in fine)


# mypy, as pyproject.toml sets it up, over the package: here, because the longest files are begun first


def checked(cache, *arguments):
    """What mypy prints; cache: folder that it keeps between runs."""
    command = [sys.executable, "-m", "mypy", "--no-color-output", "--cache-dir", str(cache), *arguments]
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert run.returncode in (0, 1) and not run.stderr, run.stdout + run.stderr  # 2: it could not check at all
    return run.stdout


def test_nothing_is_found_in_the_package(pytestconfig):
    said = checked(pytestconfig.cache.mkdir("mypy"))
    assert said.startswith("Success: no issues found in "), said
    folders = [path for path in (REPOSITORY / "texfcodec").rglob("*") if path.is_dir() and "__pycache__" not in path.parts]
    others = [folder for folder in folders if not any(folder.rglob("*.py"))]  # which count as one module each
    assert int(said.split()[5]) == len(list((REPOSITORY / "texfcodec").rglob("*.py"))) + len(others)


def test_a_wrong_argument_and_a_wrong_result_are_found(tmp_path, pytestconfig):
    module = tmp_path / "threads.py"
    shutil.copy(REPOSITORY / "texfcodec" / "core" / "threads.py", module)
    cache = pytestconfig.cache.mkdir("mypy_planted")  # of its own: the two tests may run at the same time
    assert checked(cache, str(module)).startswith("Success")
    with open(module, "a", encoding="utf-8") as file:
        file.write("\n\ndef half(count: int) -> int:\n    over_blocks(print, str(count), 1, 1)\n    return count / 2\n")
        file.write("\n\ndef _quarter(count):\n    return len(4) + count\n")
    said = checked(cache, str(module))
    assert "[arg-type]" in said and "[return-value]" in said and "Found 3 errors in 1 file" in said, said
