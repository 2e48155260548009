"""findings.py against the package: every code that is raised has its row, every row is raised, and the documents are current.

The source is read as syntax trees. A site is a call of an error class (or of Console.fail, or of the validator's Oddity, which
alone says what is no error) whose code is written out, or reaches it through a parameter of the function around it, a loop over
tuples or a constant of a module.
"""

import ast
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from texfcodec import errors
from texfcodec.findings import COMMAND_LINE, ERROR, FINDINGS, SEVERITIES, WARNING, Finding

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "texfcodec"
CODE = re.compile(r"TXF-[A-Z]\d\d")
FAMILIES = ("InputError", "StreamError", "LimitError", "SupportError")
CLAUSE = re.compile(r"\d+(\.\d+)*")
ODDITY = "Oddity"  # warnings and notes
OTHER_CALLS = {"fail": COMMAND_LINE, ODDITY: ODDITY}


@dataclass(frozen=True)
class Site:
    """One code at one call. clause: what is written there, "?" where it is computed, None without; told_exit: of fail()."""

    code: str
    family: str
    clause: str | None
    message: str
    place: str
    told_exit: str | None = None


class Source:
    """Modules as trees (dict name -> source), every node knowing its parent; sites and codes are read from them."""

    def __init__(self, modules):
        self.trees = {name: ast.parse(text) for name, text in modules.items()}
        self.parent = {child: (node, name) for name, tree in self.trees.items() for node in ast.walk(tree)
                       for child in ast.iter_child_nodes(node)}
        nodes = [(name, node) for name, tree in self.trees.items() for node in ast.walk(tree)]
        self.calls = [(name, node) for name, node in nodes if isinstance(node, ast.Call)]
        self.families = {family: family for family in FAMILIES}
        for _, node in nodes:  # a class of its own, such as class PluginError(InputError), is of its base's family
            bases = [called(base) for base in node.bases] if isinstance(node, ast.ClassDef) else []
            for base in bases:
                self.families.setdefault(node.name, self.families.get(base))
        self.constants = dict(pair for tree in self.trees.values() for node in tree.body if isinstance(node, ast.Assign)
                              for pair in assigned(node))
        self.texts = [node for _, node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]

    def above(self, node, *kinds):
        """The nearest node of these kinds around a node, or None."""
        while node in self.parent:
            node, _ = self.parent[node]
            if isinstance(node, kinds):
                return node
        return None

    def place(self, name, node):
        return f"{name}:{node.lineno}"

    def literals(self, node):
        """Constants that an expression may be: itself, both of `a if b else c`, a constant of a module, what callers or a loop
        put into a name."""
        if isinstance(node, ast.Constant):
            return [node]
        if isinstance(node, ast.IfExp):
            return self.literals(node.body) + self.literals(node.orelse)
        if called(node) in self.constants:
            return [self.constants[called(node)]]
        function = self.above(node, ast.FunctionDef)
        if not isinstance(node, ast.Name) or function is None:
            return []
        looped = [one for loop in ast.walk(function) if isinstance(loop, ast.For) for one in self._looped(loop, node.id)]
        return looped or [one for call in self._calls_of(function) for one in self._passed(function, call, node.id)]

    def _looped(self, loop, name):
        targets = loop.target.elts if isinstance(loop.target, ast.Tuple) else [loop.target]
        at = [i for i, target in enumerate(targets) if getattr(target, "id", None) == name]
        rows = getattr(loop.iter, "elts", [])
        rows = [row.elts[at[0]] if isinstance(row, ast.Tuple) else row for row in rows] if at else []
        return [row for row in rows if isinstance(row, ast.Constant)]

    def _calls_of(self, function):
        return [call for _, call in self.calls if called(call.func) == function.name]

    def _passed(self, function, call, name):
        names = [a.arg for a in function.args.args]
        if name not in names:
            return []
        at = names.index(name) - (names[0] in ("self", "cls"))
        given = [k.value for k in call.keywords if k.arg == name] + list(call.args[at : at + 1])
        return [one for one in given if isinstance(one, ast.Constant)]

    def sites(self):
        """Every Site of the modules."""
        found = []
        for name, call in self.calls:
            family = self.families.get(called(call.func), OTHER_CALLS.get(called(call.func)))
            codes = [one for one in self.literals(call.args[0]) if CODE.fullmatch(str(one.value))] if family and call.args else []
            clause = next((k.value for k in call.keywords if k.arg == "clause"), None)
            clause = call.args[2] if clause is None and family == ODDITY and len(call.args) > 2 else clause
            written = [one.value for one in self.literals(clause) if CLAUSE.fullmatch(str(one.value))]
            clauses = [None] if clause is None else written or ["?"]
            told = called(call.args[2]) if family == COMMAND_LINE and len(call.args) > 2 else None
            message = ast.unparse(call.args[1]) if len(call.args) > 1 else "''"
            found += [Site(code.value, family, one, message, self.place(name, call), told) for code in codes for one in clauses]
        return found

    def docstrings(self):
        holders = (ast.Module, ast.ClassDef, ast.FunctionDef)
        return {id(node) for node in self.texts for outer in [self.parent[node][0]]
                if isinstance(outer, ast.Expr) and isinstance(self.parent[outer][0], holders)}

    def codes(self):
        """(code, its node) for every code in every string, docstrings included."""
        return [(code, node) for node in self.texts for code in CODE.findall(node.value)]

    def unreached(self):
        """Places where a code stands by itself that no error ever takes."""
        sites, docstrings = {site.code for site in self.sites()}, self.docstrings()
        return [f"{self.place(self.parent[node][1], node)}: {node.value}" for node in self.texts
                if CODE.fullmatch(node.value) and node.value not in sites and id(node) not in docstrings]


def called(node):
    """`f` for f and for a.f."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def assigned(statement):
    """(name, constant) pairs of `A = 1` and of `A, B = 1, 2` on the level of the module."""
    target, value = statement.targets[0], statement.value
    pairs = zip(target.elts, value.elts, strict=False) if isinstance(value, ast.Tuple) and isinstance(target, ast.Tuple) else (
        [(target, value)])
    return [(one.id, what) for one, what in pairs if isinstance(one, ast.Name) and isinstance(what, ast.Constant)]


def row_to_add(site):
    """The row of findings.py for a site that has none."""
    clause = f'("{site.clause}",)' if site.clause not in (None, "?") else "()"
    family, told = (site.family, "") if site.family != COMMAND_LINE else ("None", f", {site.told_exit}")
    if site.family == ODDITY:
        family, told = "None", ", EXIT_OK, WARNING"
    return (f'texfcodec/findings.py lacks the row of {site.place}; add\n    Finding("{site.code}", {family}, {clause}, '
            f'"<what is wrong, in general>", "<what to do>"{told}),  # said there: {site.message}')


def faults(source, table):
    """What is wrong between the sites of a Source and a table of findings, one sentence each."""
    rows = {row.code: row for row in table}
    sites = source.sites()
    missing = {site.code: row_to_add(site) for site in reversed(sites) if site.code not in rows}
    told = list(missing.values())
    for site in (site for site in sites if site.code in rows):
        row = rows[site.code]
        if site.family != (row.family_name if row.severity == ERROR else ODDITY):
            told.append(f"{site.place}: {site.code} is raised as {site.family}; findings.py says {row.family_name}")
        if site.clause == "?" and not row.clauses or site.clause not in (None, "?") and not row.covers(site.clause):
            told.append(f"{site.place}: {site.code} names clause {site.clause}; findings.py has {row.clauses}: add it there")
        if site.told_exit and getattr(errors, site.told_exit, None) != row.exit_code:
            told.append(f"{site.place}: {site.code} ends with {site.told_exit}; findings.py says {row.exit_code}")
    told += [f"findings.py: nothing raises {code}; remove its row" for code in rows if code not in {site.code for site in sites}]
    told += [f"{place} reaches no error that this test understands: write the code at the raise" for place in source.unreached()]
    told += [f"{source.place(source.parent[node][1], node)}: {code} is not in findings.py" for code, node in source.codes()
             if code not in rows and code not in missing]
    return told


@pytest.fixture(scope="module")
def package():
    paths = [path for path in sorted(PACKAGE.rglob("*.py")) if path.name != "findings.py"]
    return Source({path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding="utf-8") for path in paths})


def test_every_code_that_is_raised_has_its_row_and_every_row_is_raised(package):
    found = faults(package, FINDINGS)
    assert not found, "\n" + "\n".join(found)


def test_the_table_is_sound():
    codes = [row.code for row in FINDINGS]
    assert len(set(codes)) == len(codes) and all(CODE.fullmatch(code) for code in codes)
    for row in FINDINGS:
        assert row.family is None or row.family.__name__ in FAMILIES, row.code
        assert isinstance(row.exit_code, int) and isinstance(row.clauses, tuple), row.code
        assert row.severity in SEVERITIES and (row.severity == ERROR) == (row.exit_code != errors.EXIT_OK), row.code
        assert row.code.startswith("TXF-W") == (row.severity != ERROR), row.code
        assert all(CLAUSE.fullmatch(clause) for clause in row.clauses), row.code
        for words in (row.text, row.remedy):
            assert words and words == words.strip() and not words.endswith(".") and "|" not in words, row.code


def test_every_clause_of_the_table_stands_in_the_specification():
    headings = set(re.findall(r"^#+ ([\d.]+) ", (REPOSITORY / "bitstream_spec.md").read_text(encoding="utf-8"), re.M))
    assert [(row.code, clause) for row in FINDINGS for clause in row.clauses if clause not in headings] == []


def test_every_code_of_a_faulty_vector_stands_in_the_table():
    cases = [json.loads(path.read_text(encoding="utf-8")) for path in (REPOSITORY / "conformance/faulty").glob("*/case.json")]
    assert len(cases) > 100 and {case["code"] for case in cases} <= {row.code for row in FINDINGS}


def test_the_table_is_imported_without_numpy():
    program = "import texfcodec.findings, sys; print([m for m in ('numpy', 'numba', 'click', 'torch') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert run.stdout.strip() == "[]", run.stdout + run.stderr


@pytest.mark.parametrize("document, renew, row", [("SPEC", "with_tables", "| num_materials | `v` | 0..65536 |"),
                                                  ("ERRORS", "with_findings", "| TXF-S03 | 3 | 5.2 |")])  # fmt: skip
def test_the_documents_carry_the_table_as_it_is(monkeypatch, document, renew, row):
    from conformance.make import spec_tables as gen_spec_tables

    text = getattr(gen_spec_tables, document).read_text(encoding="utf-8")
    renewed = getattr(gen_spec_tables, renew)
    assert renewed(text) == text, "stale: run make -C tools spec-tables"
    wrong = text.replace(row, row.replace("3 | 5", "4 | 5").replace("0..", "1.."))
    assert wrong != text and renewed(wrong) == text


# The check itself, against what it must catch and must let pass.


ROW = Finding("TXF-S90", errors.StreamError, ("5.7",), "something is wrong", "mend it")
ODD = Finding("TXF-W90", None, ("5.7",), "something is odd", "mend it", errors.EXIT_OK, WARNING)
TOLD = Finding("TXF-S90", None, (), "something is wrong", "mend it", errors.EXIT_USAGE)


@pytest.mark.parametrize("row, text", [
    (ROW, "raise StreamError('TXF-S90', 'x', clause='5.7.1', offset=3)"),
    (ROW, "raise errors.StreamError('TXF-S90', 'x')"),
    (ROW, "def f(code):\n    raise StreamError(code, 'x')\nf('TXF-S90')\nf(code='TXF-S90')"),
    (ROW, "class A:\n    def f(self, x, code):\n        raise StreamError(code, 'x')\nA().f(1, 'TXF-S90')"),
    (ROW, "def f(where):\n    raise StreamError('TXF-S90', 'x', clause=where)\nf('5.7')"),
    (ROW, "def f():\n    for code, name in (('TXF-S90', 'a'), ('TXF-S90', 'b')):\n        raise StreamError(code, name)"),
    (ROW, "raise StreamError('TXF-S90' if a else 'TXF-S90', 'x')\nif e.code in ('TXF-S90',): pass"),
    (ROW, "class Own(StreamError): pass\nraise Own('TXF-S90', 'x')"),
    (ROW, "CODE, WORD = 'TXF-S90', 'x'\ndef f():\n    raise StreamError(CODE, WORD)"),
    (TOLD, "CODE = 'TXF-S90'\nconsole.fail(place.CODE, 'x', place.EXIT_USAGE)"),
    (TOLD, "console.fail('TXF-S90', 'x', EXIT_USAGE)\nconsole.fail(error.code, error.message, error.exit_code)"),
    (ODD, "yield Oddity('TXF-W90', 'x', '5.7.1', 3)"), (ODD, "Oddity('TXF-W90', 'x', clause='5.7')"),
])  # fmt: skip
def test_check_lets_pass(row, text):
    assert faults(Source({"a.py": text}), (row,)) == []


RAISED = "raise StreamError('TXF-S90', 'x')\n"


@pytest.mark.parametrize("row, text, word", [
    (ROW, RAISED + "raise InputError('TXF-I91', f'{a} is bad')", """Finding("TXF-I91", InputError, (), "<what"""),
    (ROW, RAISED + "raise InputError('TXF-I91', 'y', clause='6.1')", """InputError, ("6.1",), "<what"""),
    (ROW, RAISED + "console.fail('TXF-C91', 'y', EXIT_USAGE)", '"<what to do>", EXIT_USAGE)'),
    (ROW, RAISED + "def f(code):\n    raise LimitError(code, 'x')\nf('TXF-L91')", 'Finding("TXF-L91", LimitError'),
    (ROW, "", "nothing raises TXF-S90"),
    (ROW, "'''TXF-S90 is never raised.'''", "nothing raises TXF-S90"),
    (ROW, "if error.code == 'TXF-S90': pass", "nothing raises TXF-S90"),
    (ROW, "raise InputError('TXF-S90', 'x')", "raised as InputError"),
    (ROW, "raise StreamError('TXF-S90', 'x', clause='5.71')", "names clause 5.71"),
    (ROW, "def f(where):\n    raise StreamError('TXF-S90', 'x', clause=where)\nf('6')", "names clause 6"),
    (TOLD, "console.fail('TXF-S90', 'x', EXIT_IO)", "ends with EXIT_IO"),
    (ODD, "raise StreamError('TXF-W90', 'x')", "raised as StreamError"), (ROW, "Oddity('TXF-S90', 'x')", "raised as Oddity"),
    (ODD, "Oddity('TXF-W90', 'x', '6.1')", "names clause 6.1"), (ODD, "Oddity('TXF-W91', 'x', '5')", '("5",), "<what'),
    (TOLD, "CODE = 'TXF-S90'\nconsole.fail(place.CODE, 'x', place.EXIT_IO)", "ends with EXIT_IO"),
    (ROW, RAISED + "CODE = 'TXF-S91'", "reaches no error"),
    (ROW, RAISED + "table = {'TXF-S91': 3}", "reaches no error"),
    (ROW, RAISED + "def f():\n    '''Raises TXF-S92.'''", "TXF-S92 is not in findings.py"),
])  # fmt: skip
def test_check_catches(row, text, word):
    assert any(word in fault for fault in faults(Source({"a.py": text}), (row,)))
