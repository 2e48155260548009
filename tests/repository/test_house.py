"""What a program can enforce of CONTRIBUTING.md. Each check is also shown to catch what it is there for."""

import ast
import re
import statistics
import subprocess
from functools import cache, lru_cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
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
DOORS = {("texfcodec.texf", "io"), ("texfcodec.texf", "render")}


@cache
def imports():
    """{module: the modules that it imports} of the package, but for what only type checkers follow."""
    graph = grimp.build_graph("texfcodec", exclude_type_checking_imports=True, cache_dir=None)
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def room_of(module):
    return (module + ".__init__").split(".")[1]


def may_import(module, other):
    """Whether a module may import another: of an earlier room, or the package as its users do."""
    room, entered = room_of(module), room_of(other)
    public = entered == "__init__" and room in ("demo", "cli")
    return room == entered or public or (module, entered) in DOORS or ORDER.index(entered) < ORDER.index(room)


def test_no_import_runs_against_the_order_of_the_rooms():
    names = {path.relative_to(REPOSITORY).with_suffix("").as_posix().replace("/", ".") for path in PACKAGE.rglob("*.py")}
    assert {name.removesuffix(".__init__") for name in names} <= set(imports()) and set(map(room_of, imports())) == set(ORDER)
    assert [(one, other) for one, others in imports().items() for other in others if not may_import(one, other)] == []


def test_no_modules_import_each_other():
    doors = {"texfcodec", "texfcodec.texf"}  # __init__ names what it hands out; a Texf's methods enter io and render
    TopologicalSorter({one: others - doors for one, others in imports().items() if one not in doors}).prepare()
    assert sum(map(len, imports().values())) > 1000


def test_at_most_three_files_outside_the_codecs_name_one():
    """By its name as users type it, in code or in words; options are the table that users read."""
    named = re.compile(r"\b(raht|3dntc|neural)\b", re.IGNORECASE)
    found = [path.relative_to(PACKAGE).as_posix() for path in sorted(PACKAGE.rglob("*.py"))
             if named.search(path.read_text(encoding="utf-8")) and path.relative_to(PACKAGE).parts[0] != "codecs"]
    assert len(found) <= 3, found


def test_decoder_never_meets_torch_or_the_encoder_side_rooms():
    rooms = ("render", "encoder", "codecs.neural.fit", "codecs.neural.fit_payload", "cli")
    foreign = ("torch", *(f"texfcodec.{room}" for room in rooms))
    modules, _ = modules_after("import texfcodec.decoder")
    assert "texfcodec.decoder" in modules
    assert [m for m in modules if m in foreign or m.startswith(tuple(s + "." for s in foreign))] == []


def test_package_is_imported_fast_and_without_numba():
    runs = [modules_after("import texfcodec") for _ in range(3)]
    assert "numba" not in runs[0][0] and "torch" not in runs[0][0]
    # processor time, so that a busy machine does not fail the test
    assert statistics.median(seconds for _, seconds in runs) < IMPORT_SECONDS


def test_the_steps_from_a_mesh_to_a_stream_name_functions_that_are_there():
    text = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    steps = text[text.index("in ten steps") : text.index("## Adding to it")]
    named = re.findall(r"`(?:\w+\.)?(\w+)(?:\(\))?`\s+\(([\w/]+\.py)\)", steps)
    assert len(re.findall(r"^\d+\. \*\*", steps, re.MULTILINE)) == 10 and len(named) >= 15
    defined = {file: {node.name for node in ast.walk(ast.parse((PACKAGE / file).read_text(encoding="utf-8")))
                      if isinstance(node, ast.FunctionDef | ast.ClassDef)} for _, file in named}
    assert [(name, file) for name, file in named if name not in defined[file]] == []


# The checks themselves: what each must catch, and what it must let pass.


@pytest.mark.parametrize("check, bad, good", [
    (long_functions, ["def f():\n" + "    x = 1\n" * LONGEST_FUNCTION], ["def f():\n" + "    x = 1\n" * (LONGEST_FUNCTION - 1)]),
    (undocumented_functions, ["def f():\n    return 1"],
     ["def f():\n    'Says what.'\ndef _g(): pass\nclass A:\n    def h(self): pass"]),
    (incomplete_signatures,
     ["def f(a: int): pass", "def f(*a, b: int) -> int: pass", "def f(a: int, *, b=1) -> int: pass", "def f(**a) -> int: pass",
      "class A:\n    def f(self, a) -> int: pass", "class A:\n    def __init__(self): pass",
      "class A:\n    @staticmethod\n    def f(a) -> int: pass"],
     ["def f(a: int, *b: int, c: int = 1, **d: int) -> int: pass\ndef _g(a): pass\nclass _B:\n    def f(self, a): pass",
      "class A:\n    def __init__(self, a: int) -> None: pass\n    @property\n    def f(self) -> int: pass",
      "@click.command('x')\ndef f(a): pass\n@kernel\ndef g(a): pass\n@kernel(x=1)\ndef h(a): pass"]),
    (uncached_kernels, ["@njit\ndef _f(): pass", "@numba.njit(nogil=True)\ndef _f(): pass", "_jit = nb.njit(cache=False)"],
     ["from numba import njit\n@njit(cache=True)\ndef _f(): pass\n_jit = nb.njit(cache=True)"]),
    (fast_maths, ["@njit(cache=True, fastmath={'nnan'})\ndef _f(): pass", "fused = {'fastmath': True}"],
     ["@njit(cache=True, fastmath=False)\ndef _f(): pass"]),
    (drawer_names, ["class MeshManager: pass", "def _read_helper(): pass"], ["def common_prefix(): pass\nclass Image: pass"]),
    (claimless_tests, ["def test_x():\n    f()", "def g():\n    h()\ndef test_x():\n    g()"],
     ["def test_x():\n    with pytest.raises(ValueError):\n        f()",
      "def g():\n    np.testing.assert_array_equal(1, 1)\ndef h():\n    g()\ndef test_x():\n    h()"]),
])
def test_check_catches_and_lets_pass(check, bad, good):
    assert [len(check(ast.parse(text))) for text in bad + good] == [1] * len(bad) + [0] * len(good)


def test_path_and_host_patterns_catch_what_they_are_for():
    paths = ["/wo" + "rk/main", "see /ho" + "me/me/x", "'/tm" + "p/venv'", "C:\\Use" + "rs\\me"]
    hosts = ["https://py" + "pi.org/simple", "http://mirror.example/py" + "pi/x"]
    assert all(MACHINE_PATH.search(text) for text in paths) and all(REGISTRY_HOST.search(text) for text in hosts)
    fine = ["tests/tmp/x", "a/work/b", "/images/1", "https://example.org/home/page", "/usr/bin/env bash", "../home/x"]
    assert not any(MACHINE_PATH.search(text) or REGISTRY_HOST.search(text) for text in fine)
