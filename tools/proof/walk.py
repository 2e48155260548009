"""Follows one argument through the calls of the package: which files hold it, and how often its way climbs back up.

python -m tools.proof.walk encoder/pipeline.py:encode_scene:options [--package DIR] [--steps]

The argument is followed as the object that it is, by name, as an attribute that it was kept in, and as an argument of further
calls; not what is read from it. Calls are walked in the order of the text, each function once for each of its parameters. A file
stands a floor above all that it imports, imports for type checkers left out. A climb is a move of the walk, into a call or back
from it, to a file on a higher floor. Nothing is run, so that what a call dispatches to is every function of that name.
"""

import argparse
import ast
from functools import cached_property
from itertools import pairwise
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "texfcodec"


class Package:
    """The files of a package, their functions by name, their imports and floors."""

    def __init__(self, root):
        self.root = Path(root)
        paths = [path.relative_to(self.root) for path in sorted(self.root.rglob("*.py"))]
        self.trees = {path.as_posix(): ast.parse((self.root / path).read_text(encoding="utf-8")) for path in paths}
        self.functions = {}  # name: [(file, class or "", node)]
        for file, tree in self.trees.items():
            for node in tree.body:
                kinds = node.body if isinstance(node, ast.ClassDef) else [node]
                for function in kinds:
                    if isinstance(function, ast.FunctionDef):
                        owner = node.name if isinstance(node, ast.ClassDef) else ""
                        self.functions.setdefault(function.name, []).append((file, owner, function))

    def imported(self, file):
        """{local name: (file, name there)} of a file's imports within the package; name there is "" for a module."""
        out, here = {}, list(Path(file).parent.parts)
        for node in _running(self.trees[file]):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = here[: len(here) + 1 - node.level] + (node.module.split(".") if node.module else [])
                for alias in node.names:
                    module = "/".join([*base, alias.name]) + ".py"
                    whole = (module, "") if module in self.trees else (self._file(base), alias.name)
                    out[alias.asname or alias.name] = whole
        return out

    def _file(self, parts):
        name = "/".join(parts)
        return next((f for f in (f"{name}.py", f"{name}/__init__.py".lstrip("/")) if f in self.trees), "")

    @cached_property
    def floors(self):
        """{file: 0 where it imports nothing, else one more than the highest that it imports}."""
        floors, pending = {}, []

        def floor(file):
            if file in floors or file in pending:
                return floors.get(file, 0)
            pending.append(file)
            floors[file] = max((1 + floor(other) for other, _ in self.imported(file).values() if other in self.trees), default=0)
            pending.pop()
            return floors[file]

        for file in self.trees:
            floor(file)
        return floors

    def callees(self, file, owner, call):
        """[(file, class, node)] of the functions that a call may enter."""
        func, imports = call.func, self.imported(file)
        name = func.attr if isinstance(func, ast.Attribute) else getattr(func, "id", "")
        if isinstance(func, ast.Name):
            home, there = imports.get(name, (file, name))
            found = [f for f in self.functions.get(there, []) if f[0] == home and not f[1]]
            return found or [f for f in self.functions.get("__init__", []) if f[:2] == (home, there)]
        of = func.value.id if isinstance(func, ast.Name | ast.Attribute) and isinstance(func.value, ast.Name) else ""
        if of in imports and imports[of][1] == "":
            return [f for f in self.functions.get(name, []) if f[0] == imports[of][0] and not f[1]]
        methods = [f for f in self.functions.get(name, []) if f[1]]
        if of in imports:  # a class, asked by its name
            return [f for f in methods if f[:2] == imports[of]]
        own = [f for f in methods if f[:2] == (file, owner)]
        return own if of == "self" and own else methods


def _running(tree):
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"):
            yield node
            yield from _running(node)


class Walk:
    """The way of one argument. stays: files in the order in which it is there."""

    def __init__(self, package, file, function, parameter):
        self.package, self.stays, self.kept, self.others, self._seen = package, [file], set(), set(), set()
        for place in package.functions[function]:
            if place[0] == file:
                self._enter(*place, parameter)

    @property
    def files(self):
        return sorted(self.others.union(self.stays))

    @property
    def climbs(self):
        floors = self.package.floors
        return sum(floors[b] > floors[a] for a, b in pairwise(self.stays))

    def _enter(self, file, owner, node, parameter):
        if (file, owner, node.name, parameter) in self._seen:
            return
        self._seen.add((file, owner, node.name, parameter))
        back = self.stays[-1]
        self._stay(file)
        held = {parameter}
        for inner in _in_order(node):
            if isinstance(inner, ast.Assign | ast.AnnAssign) and inner.value is not None and self._is_held(inner.value, held):
                targets = inner.targets if isinstance(inner, ast.Assign) else [inner.target]
                held |= {t.id for t in targets if isinstance(t, ast.Name)}
                self.kept |= {t.attr for t in targets if isinstance(t, ast.Attribute)}
            elif isinstance(inner, ast.Call):
                self._call(file, owner, inner, held)
        self._stay(back)

    def _call(self, file, owner, call, held):
        places = [i for i, argument in enumerate(call.args) if self._is_held(argument, held)]
        names = [k.arg for k in call.keywords if k.arg and self._is_held(k.value, held)]
        if not places and not names:
            return
        callees = self.package.callees(file, owner, call)
        if not callees:  # a constructor that the class did not write: its fields are attributes
            self.kept |= set(names)
        for number, (target_file, target_owner, node) in enumerate(callees):
            arguments = [a.arg for a in (*node.args.posonlyargs, *node.args.args)]
            static = any(getattr(d, "id", "") == "staticmethod" for d in node.decorator_list)
            bound = arguments[1:] if target_owner and not static else arguments
            for parameter in [bound[i] for i in places if i < len(bound)] + [n for n in names if n in arguments + _only(node)]:
                if number:  # one of several that a run chooses from: its file counts, the way there does not again
                    self.others.add(target_file)
                else:
                    self._enter(target_file, target_owner, node, parameter)

    def _is_held(self, value, held):
        if isinstance(value, ast.BoolOp):
            return any(self._is_held(one, held) for one in value.values)
        if isinstance(value, ast.IfExp):
            return self._is_held(value.body, held) or self._is_held(value.orelse, held)
        kept = isinstance(value, ast.Attribute) and value.attr in self.kept
        return kept or (isinstance(value, ast.Name) and value.id in held)

    def _stay(self, file):
        if self.stays[-1] != file:
            self.stays.append(file)


def _only(node):
    return [a.arg for a in node.args.kwonlyargs]


def _in_order(node):
    """Assignments and calls of a function in the order in which they run: arguments before the call that takes them."""
    for child in ast.iter_child_nodes(node):
        yield from _in_order(child)
        if isinstance(child, ast.Assign | ast.AnnAssign | ast.Call):
            yield child


def main(arguments=None):
    """The command."""
    parser = argparse.ArgumentParser(prog="walk", description=__doc__.splitlines()[0])
    parser.add_argument("start", help="FILE:FUNCTION:PARAMETER, the file as seen from the package")
    parser.add_argument("--package", default=PACKAGE, type=Path)
    parser.add_argument("--steps", action="store_true", help="every stay, with its floor")
    given = parser.parse_args(arguments)
    walk = Walk(Package(given.package), *given.start.split(":"))
    if given.steps:
        for file in walk.stays:
            print(f"{walk.package.floors[file]:3} {file}")
    print(f"{given.start}: {len(walk.files)} files, {walk.climbs} climbs")


if __name__ == "__main__":
    main()
