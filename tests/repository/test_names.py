"""Names say what a thing is: words that are ruled out as names, and docstrings that name what is there."""

import ast
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "texfcodec"
RULED_OUT = {"told", "made", "asked", "found", "one", "mine"}  # they say that there is something, and not what
MODULE = re.compile(r"\b((?:[a-z_]+/)*[a-z_]+)\.py\b")  # a module in a docstring, by its path or its name


def names_of(tree):
    """(name, line) of everything that a module's source gives a name to."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno


def ruled_out(tree):
    """Lines of the names that are ruled out, with the underscore that makes them private or without."""
    return [f"{name}:{line}" for name, line in names_of(tree) if name.strip("_") in RULED_OUT]


def modules_not_there(tree, modules):
    """Modules that docstrings name and that are not there. modules: paths below the package, without suffix."""
    known = {"/".join(parts[i:]) for parts in (path.split("/") for path in modules) for i in range(len(parts))}
    documented = (node for node in ast.walk(tree) if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef))
    texts = [ast.get_docstring(node) or "" for node in documented]
    return sorted({name for text in texts for name in MODULE.findall(text)} - known)


SOURCES = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}
TOOLS = {path.relative_to(REPOSITORY).as_posix(): path for folder in ("tools", "conformance/make")
         for path in sorted((REPOSITORY / folder).rglob("*.py"))}


@pytest.fixture(scope="module")
def modules():
    return [name.removesuffix(".py") for name in SOURCES]


@pytest.mark.parametrize("name", SOURCES | TOOLS)
def test_no_name_says_only_that_something_is_there(name):
    assert ruled_out(ast.parse((SOURCES | TOOLS)[name].read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize("name", SOURCES)
def test_docstrings_name_modules_that_are_there(name, modules):
    assert modules_not_there(ast.parse(SOURCES[name].read_text(encoding="utf-8")), modules) == []


def test_the_checks_see_what_they_must():
    assert ruled_out(ast.parse("for one in x:\n    made, y.told = one")) == ["one:1", "made:2", "told:2"]
    assert ruled_out(ast.parse("def f(_found): ...\nclass asked: ...")) != []
    tree = ast.parse('"""See a/b.py and c.py."""')
    assert modules_not_there(tree, ["z/a/b", "c"]) == [] and modules_not_there(tree, ["z/b"]) == ["a/b", "c"]
