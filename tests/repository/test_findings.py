"""findings.py against the package: every code that is raised has its row, every row is raised, and the documents are current.

The source is read as syntax trees. A site is a call of an error class (or of Console.fail, or of the validator's Oddity, which
alone says what is not an error) whose code is written out. A code that reaches its call through a parameter or a constant is
checked where the error is made: the fixture raised_as_the_table_says of conftest.py watches every one that a test raises.
"""

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

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


class Site(NamedTuple):
    """A call that names a code: what it calls, the clause that is written there, None without, and the exit code of fail()."""

    place: str
    code: str
    family: str
    clause: str | None
    exit: str | None


def name_of(node):
    """`f` for f and for a.f."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def literal(node):
    return node.value if isinstance(node, ast.Constant) else None


def parsed(texts):
    """(place, node) of every node of modules, {name: text}, that stands somewhere."""
    return [(f"{name}:{node.lineno}", node) for name, text in texts.items() for node in ast.walk(ast.parse(text))
            if hasattr(node, "lineno")]


def nodes_of(modules, kind):
    return [(place, node) for place, node in modules if isinstance(node, kind)]


def sites_of(modules):
    families = {family: family for family in FAMILIES} | OTHER_CALLS
    for _, node in nodes_of(modules, ast.ClassDef):  # one of its own, such as PluginError(InputError), is of its base's family
        families.update((node.name, base) for base in map(name_of, node.bases) if base in FAMILIES)
    for place, call in nodes_of(modules, ast.Call):
        family, code = families.get(name_of(call.func)), literal(call.args[0]) if call.args else None
        if family and CODE.fullmatch(str(code)):
            third = call.args[2] if len(call.args) > 2 else None
            clause = next((k.value for k in call.keywords if k.arg == "clause"), third if family == ODDITY else None)
            yield Site(place, code, family, literal(clause), name_of(third) if family == COMMAND_LINE else None)


def faults(modules, table):
    """What is wrong between modules, as parsed() gives them, and a table of findings, one sentence each."""
    rows = {row.code: row for row in table}
    written = [(place, node.value) for place, node in nodes_of(modules, ast.Constant) if isinstance(node.value, str)]
    compared = [literal(node) for _, outer in nodes_of(modules, ast.Compare) for node in ast.walk(outer)]
    used = set(Counter(text for _, text in written) - Counter(compared))
    wrong = [f"{place}: {code} is not in findings.py; add its row" for place, text in written for code in CODE.findall(text)
             if code not in rows]
    wrong += [f"findings.py: nothing raises {code}; remove its row" for code in rows if code not in used]
    for site in (site for site in sites_of(modules) if site.code in rows):
        row = rows[site.code]
        family = row.family_name if row.severity == ERROR else ODDITY
        if site.family != family:
            wrong.append(f"{site.place}: {site.code} is raised as {site.family}; findings.py says {family}")
        if site.clause and not row.covers(site.clause):
            wrong.append(f"{site.place}: {site.code} names clause {site.clause}; findings.py has {row.clauses}")
        if site.exit and getattr(errors, site.exit, None) != row.exit_code:
            wrong.append(f"{site.place}: {site.code} ends with {site.exit}; findings.py says {row.exit_code}")
    return wrong


@pytest.fixture(scope="module")
def package():
    paths = [path for path in sorted(PACKAGE.rglob("*.py")) if path.name != "findings.py"]
    return parsed({path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding="utf-8") for path in paths})


def test_every_code_that_is_raised_has_its_row_and_every_row_is_raised(package):
    assert len(list(sites_of(package))) > 300
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
LINE = Finding("TXF-S90", None, (), "something is wrong", "mend it", errors.EXIT_USAGE)


RAISED = "raise StreamError('TXF-S90', 'x')\n"


@pytest.mark.parametrize("row, text, word", [
    (ROW, "raise StreamError('TXF-S90', 'x', clause='5.7.1', offset=3)", None),
    (ROW, "raise errors.StreamError('TXF-S90')", None),
    (ROW, "def f(code):\n    raise StreamError(code, 'x')\nf('TXF-S90')", None),
    (ROW, "class Own(StreamError): pass\nraise Own('TXF-S90', 'x')", None),
    (LINE, "console.fail('TXF-S90', 'x', EXIT_USAGE)\nconsole.fail(error.code, error.message, error.exit_code)", None),
    (ODD, "yield Oddity('TXF-W90', 'x', '5.7.1', 3)", None), (ODD, "Oddity('TXF-W90', 'x', clause='5.7')", None),
    (ROW, RAISED + "raise InputError('TXF-I91', f'{a} is bad')", "TXF-I91 is not in findings.py"),
    (ROW, RAISED + "def f():\n    \'\'\'Raises TXF-S92.\'\'\'", "TXF-S92 is not in findings.py"),
    (ROW, "\'\'\'TXF-S90 is never raised.\'\'\'", "nothing raises TXF-S90"),
    (ROW, "if error.code == 'TXF-S90': pass", "nothing raises TXF-S90"),
    (ROW, "raise InputError('TXF-S90', 'x')", "raised as InputError"),
    (ROW, "class Own(InputError): pass\nraise Own('TXF-S90', 'x')", "raised as InputError"),
    (ROW, "raise StreamError('TXF-S90', 'x', clause='5.71')", "names clause 5.71"),
    (LINE, "console.fail('TXF-S90', 'x', EXIT_IO)", "ends with EXIT_IO"),
    (ODD, "raise StreamError('TXF-W90', 'x')", "raised as StreamError"), (ROW, "Oddity('TXF-S90', 'x')", "raised as Oddity"),
    (ODD, "Oddity('TXF-W90', 'x', '6.1')", "names clause 6.1"),
])  # fmt: skip
def test_check_catches_and_lets_pass(row, text, word):
    assert [word in fault for fault in faults(parsed({"a.py": text}), (row,))] == ([True] if word else [])
