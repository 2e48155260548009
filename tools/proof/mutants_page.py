"""docs/reports/mutants.md: what tools/proof/mutants.py found, by module, by clause and one by one."""

import ast
import re
from collections import Counter
from pathlib import Path

from tools.bench.provenance import made_on

NAIVE = Path(__file__).resolve().parents[2] / "conformance" / "reference"


def clauses_of(module):
    """{function: the clauses that its docstring, or that of what it stands in, names} of a module."""
    found = {}

    def walk(node, place, clauses):
        for part in node.body:
            if isinstance(part, ast.FunctionDef | ast.ClassDef):
                said = re.findall(r"\d+(?:\.\d+)+|(?<=[Cc]lause )\d+", ast.get_docstring(part) or "")
                own = said or clauses
                found[".".join([*place, part.name])] = own
                walk(part, [*place, part.name], own)

    tree = ast.parse((NAIVE / f"{module}.py").read_text(encoding="utf-8"))
    walk(tree, [], re.findall(r"\d+(?:\.\d+)+|(?<=[Cc]lause )\d+", ast.get_docstring(tree) or ""))
    return found


def statements_of(module):
    """Number of statements of a module."""
    return sum(isinstance(node, ast.stmt) for node in ast.walk(ast.parse((NAIVE / f"{module}.py").read_text(encoding="utf-8"))))


def page_of(found, equivalents, told=""):
    """docs/reports/mutants.md. found: {Mutant: killer or None}; told: what was run, a sentence or more."""
    survivors = [m for m, killer in found.items() if killer is None and m.name not in equivalents]
    settled = len(found) - len(survivors)
    share = f"{settled / max(len(found), 1):.1%}"
    out = ["# Mutants of the reference decoder", "",
           f"Made by `make -C tools mutants` (tools/proof/mutants.py) {made_on()}: one rule of "
           "conformance/reference changed at a time, tried on every vector that runs the line.", "",
           *([told, ""] if told else []),
           f"{len(found)} mutants, {settled} killed or equivalent ({share}), {len(survivors)} survivors.", "",
           *_by_module(found, equivalents)]
    if survivors:
        out += ["", "## Survivors", "", "| place | rule | clause | change |", "|---|---|---|---|"]
        out += [f"| conformance/reference/{m.module}.py:{m.line} | {m.function} | {', '.join(_clauses(m))} | {_change(m)} |"
                for m in survivors]
    out += ["", "## Equivalent", "", "| rule | change | why nothing changes |", "|---|---|---|"]
    out += [f"| {m.module}.{m.function} | {_change(m)} | {equivalents[m.name]} |"
            for m, killer in found.items() if killer is None and m.name in equivalents]
    return "\n".join(out + ["", *_by_clause(found)]) + "\n"


def _change(mutant):
    return " -> ".join("`" + text.replace("|", "\\|") + "`" for text in (mutant.before, mutant.after))


def _clauses(mutant):
    return clauses_of(mutant.module).get(mutant.function, ["none named"])


def _by_module(found, equivalents):
    """Rows of the table of modules."""
    out = ["| module | statements | mutants | killed | equivalent | survivors |", "|---|---:|---:|---:|---:|---:|"]
    for module in dict.fromkeys(m.module for m in found):
        mine = {m: killer for m, killer in found.items() if m.module == module}
        dead = sum(killer is not None for killer in mine.values())
        same = sum(killer is None and m.name in equivalents for m, killer in mine.items())
        out.append(f"| {module} | {statements_of(module)} | {len(mine)} | {dead} | {same} | {len(mine) - dead - same} |")
    return out


def _by_clause(found):
    """Rows of the table of clauses and vectors."""
    out = ["## Which vector kills which rule", "", "The quickest that does, by clause; a vector may kill many more.", "",
           "| clause | mutants killed | by |", "|---|---:|---|"]
    by_clause = {}
    for m, killer in found.items():
        for clause in _clauses(m) if killer else []:
            by_clause.setdefault(clause, Counter())[killer] += 1
    number = lambda clause: [int(part) if part.isdigit() else 0 for part in clause.split(".")]
    for clause in sorted(by_clause, key=number):
        killers = ", ".join(f"{name} {count}" for name, count in by_clause[clause].most_common(6))
        out.append(f"| {clause} | {by_clause[clause].total()} | {killers} |")
    return out
