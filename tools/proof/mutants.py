"""Mutants of the reference decoder: one rule changed at a time, to see whether a conformance vector notices.

python tools/proof/mutants.py [--module NAME ...] [--only PART ...] [--every N | --sample N [--seed S ...]] [--jobs N]
                        [--seconds S] [--state FILE.jsonl] [--page docs/reports/mutants.md]

A mutant has one operator, comparison, constant or condition of conformance/reference changed. It is *killed* when a vector is
decoded to something else, refused otherwise, answers a query wrong, or takes too long. A *survivor* is a rule that no vector
holds, or a change that means the same: equivalents.json there says of which mutants this was shown, and why. --only takes
functions (split, neural.waves) and clauses (7.6, with all below). --state keeps what was found, so that a run goes on where it
was stopped, with what vectors call beside it (FILE.cases.json). Exit code 7: there are survivors that are not said to be
equivalent.
"""

import argparse
import ast
import hashlib
import importlib.abc
import importlib.util
import json
import os
import random
import re
import signal
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # run as a command
    sys.path.insert(0, str(REPOSITORY))

from conformance import run as runner  # noqa: E402
from tools.bench.provenance import made_on  # noqa: E402

VECTORS, NAIVE = REPOSITORY / "conformance", REPOSITORY / "conformance" / "reference"
EQUIVALENTS = NAIVE / "equivalents.json"
MODULES = ("attributes", "bits", "dct", "decoder", "edges", "filter", "following", "materials", "mixing", "neural", "normals",
           "planar", "queries", "residual", "scales", "syntax", "texels", "voxels")
TOLERANCES = ("EQUALLY_NEAR", "FACES_EQUALLY_NEAR")  # of what answers pass: no rules of a decoder either
UNRUN = ("main", "arrays", "answer_files", "read_queries")  # what is no rule of a decoder, but how it is called
SLOWEST = 20.0  # seconds of the processor that a vector may take
PATIENCE = 10.0  # how much longer a mutant may take
COMPARISONS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
               ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is}
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
             ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr, ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult,
             ast.FloorDiv: ast.Mult}
FITTED = ("Vectors were written for what survived of the samples with seeds 0 to 2 and 11 to 14, so that only other seeds say "
          "something: before anything was written for them, of 300 with seed 13 it was 95.7 %, of 300 with seed 14 94 %.")
TOP = "module"  # the place of what stands in no function: it runs when the module is imported
SWAPPED = {"min": "max", "max": "min", "sorted": "list", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """One change of a module. number: of the module's changes; function, line: where it is; before, after: the expression as
    source; turn: its rank among those with the same key, from 1."""

    module: str
    number: int
    function: str
    line: int
    before: str
    after: str
    turn: int = 1

    @property
    def key(self):
        """A name that holds while the function's own text does, wherever it moves."""
        return f"{self.module}.{self.function}: {self.before} -> {self.after}"

    @property
    def name(self):
        """The key, with the turn where it is not the first: what equivalents.json calls it."""
        return self.key if self.turn == 1 else f"{self.key} ({self.turn})"


# What is changed


def source_of(module):
    """Return the syntax tree of a module of conformance/reference."""
    return ast.parse((NAIVE / f"{module}.py").read_text(encoding="utf-8"))


def alternatives(node):
    """Return other expressions for a node of a syntax tree, each a small mistake that an author of a decoder could make."""
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return [ast.Constant(node.value + 1), *([ast.Constant(node.value - 1)] if node.value > 0 else [])]
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
        return [ast.Compare(node.left, [COMPARISONS[type(node.ops[0])]()], node.comparators)]
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        rounded_up = [ast.UnaryOp(ast.USub(), ast.BinOp(ast.UnaryOp(ast.USub(), node.left), node.op, node.right))]
        return [ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right),
                *(rounded_up if isinstance(node.op, ast.FloorDiv | ast.RShift) else [])]
    if isinstance(node, ast.BoolOp):
        return [ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        return [node.operand]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id in SWAPPED:
            return [ast.Call(ast.Name(SWAPPED[node.func.id], ast.Load()), node.args, node.keywords)]
        if node.func.id == "require":
            return [ast.Constant(None)]
    return []


class _Changer(ast.NodeTransformer):
    """Counts the changes of a module in the order in which they stand; makes the one of a number."""

    def __init__(self, wanted=None):
        self.wanted, self.count, self.mutants, self.where = wanted, 0, [], [TOP]

    def visit_FunctionDef(self, node):
        self.where.append(node.name)
        node.body = [self.visit(part) for part in node.body]
        self.where.pop()
        return node

    visit_ClassDef = visit_FunctionDef

    def visit_JoinedStr(self, node):
        return node  # words to a person

    def generic_visit(self, node):
        for other in alternatives(node):
            place = ".".join(self.where[1:]) or TOP
            self.mutants.append((self.count, place, node.lineno, ast.unparse(node), ast.unparse(other)))
            self.count += 1
            if self.count - 1 == self.wanted:
                return ast.copy_location(other, node)
        return super().generic_visit(node)


def mutants_of(module):
    """Return every Mutant of a module of conformance/reference."""
    changer, tree, turns, out = _Changer(), source_of(module), Counter(), []
    left_out = {node.lineno for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in TOLERANCES}
    changer.visit(tree)
    for mutant_row in changer.mutants:
        if mutant_row[1] not in UNRUN and not (mutant_row[1] == TOP and mutant_row[2] in left_out):
            mutant = Mutant(module, *mutant_row)
            turns[mutant.key] += 1
            out.append(replace(mutant, turn=turns[mutant.key]))
    return out


@cache
def called_at_import(module):
    """Return the functions that a module calls at import, for its constants; no trace of a case shows those calls."""
    statements = source_of(module).body
    assigned = [statement for statement in statements if isinstance(statement, ast.Assign)]
    calls = [node for statement in assigned for node in ast.walk(statement) if isinstance(node, ast.Call)]
    return {node.func.id for node in calls if isinstance(node.func, ast.Name)}


def changed_code(mutant):
    """Return the compiled module with a Mutant's change."""
    tree = _Changer(mutant.number).visit(source_of(mutant.module))
    return compile(ast.fix_missing_locations(tree), f"{mutant.module} changed", "exec")


class _Importer(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives the changed module wherever it is imported."""

    def __init__(self, mutant):
        self.name, self.code = f"conformance.reference.{mutant.module}", changed_code(mutant)

    def find_spec(self, name, path=None, target=None):
        return importlib.util.spec_from_loader(name, self) if name == self.name else None

    def exec_module(self, module):
        exec(self.code, module.__dict__)


# What vectors say


@dataclass
class Case:
    """A vector at one level of detail. expected: its queries, as in queries.json; said: hashes of its arrays and whether its
    answers are wrong, or how it is refused; functions: those it calls."""

    name: str
    data: bytes
    lod: int
    said: object = None
    seconds: float = 0.0
    functions: frozenset = frozenset()
    expected: dict | None = None

    def runs(self, mutant):
        """Return whether the case calls the function of a mutant, or, if that runs at import, any function of its module."""
        if mutant.function == TOP or mutant.function in called_at_import(mutant.module):
            return any(module == mutant.module for module, _ in self.functions)
        return (mutant.module, mutant.function) in self.functions


def cases_of():
    """Every small vector that does not ask for a limit, at every level of detail that it has."""
    cases = []
    for path in sorted({*VECTORS.glob("*/*/case.json")} - {*VECTORS.glob("real/*/case.json")}):  # hours for the reference
        case_json, data = json.loads(path.read_text(encoding="utf-8")), (path.parent / "in.texf").read_bytes()
        name = f"{path.parent.parent.name}/{path.parent.name}"
        if case_json.get("expect") != "limit":
            queries = runner.queries_of(path.parent)
            cases += [Case(name, data, int(lod), expected=queries) for lod in case_json.get("lods", {"0": None})]
    return cases


def answer(case):
    """Decode a case with the loaded reference decoder; return {array: SHA-256} or the name of its refusal. Any other exception
    is a wrong answer."""
    from conformance.reference import decoder
    from conformance.reference.bits import Invalid, Unsupported

    queries = case.expected["lods"].get(str(case.lod), []) if case.expected else []
    try:
        texf = decoder.decode(case.data, case.lod)
        files, faults = decoder.arrays(texf), []
        if queries:
            from conformance.reference.queries import answer_files, read_queries

            answers = answer_files(texf, read_queries(runner.packed(queries)))
            files_of_answers = {f"{name}.bin": content for name, content in answers.items()}
            faults = runner.faults_of_answers(files_of_answers, queries, case.expected)
    except Invalid:
        return "Invalid"
    except Unsupported:
        return "Unsupported"
    except Exception as error:
        return f"raised {type(error).__name__}"
    return {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())} | {"queries": bool(faults)}


def traced(case):
    """Return the case with its answer, seconds and the functions it calls; none if it takes more than SLOWEST seconds."""
    called, folder, begin = set(), str(NAIVE), time.process_time()

    def stop(*_):
        raise TimeoutError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, SLOWEST)
    sys.settrace(lambda frame, *_: called.add(frame.f_code) if frame.f_code.co_filename.startswith(folder) else None)
    case.said = answer(case)
    sys.settrace(None)
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    case.seconds = time.process_time() - begin
    if case.said != "raised TimeoutError":
        case.functions = frozenset((Path(c.co_filename).stem, c.co_qualname.replace(".<locals>", "")) for c in called)
    return case


def known_cases(cases, path):
    """Return the traced cases that call functions. Known traces, keyed by a hash of their inputs, are in the file path."""
    before = json.loads(path.read_text(encoding="utf-8")) if path and path.exists() else {}
    sources = b"".join(file.read_bytes() for file in sorted(NAIVE.glob("*.py")))
    for case in cases:
        mark = hashlib.sha256(sources + case.data + json.dumps([case.lod, case.expected]).encode()).hexdigest()
        if mark in before:
            case.said, case.seconds, functions = before[mark]
            case.functions = frozenset(map(tuple, functions))
            continue
        traced(case)
        before[mark] = case.said, case.seconds, sorted(case.functions)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(before), encoding="utf-8")
    return [case for case in cases if case.functions]


def killer_of(mutant, cases):
    """Return the name of the first of cases whose answer a mutant changes; None if it survives. They run in a child process,
    which may hang or crash."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        _try_cases(mutant, cases, writing)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        *_, last = ["import", *pipe.read().splitlines()]
    os.waitpid(child, 0)
    return None if last == "survived" else last


def _try_cases(mutant, cases, writing):
    """In the child: writes the name of every case before it is tried, "survived" after the last."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        for name in [name for name in sys.modules if name.startswith("conformance.reference")]:
            del sys.modules[name]
        sys.meta_path.insert(0, _Importer(mutant))
        for case in cases:
            os.write(writing, f"{case.name}\n".encode())
            signal.setitimer(signal.ITIMER_PROF, PATIENCE * case.seconds + 2)  # the signal ends the child
            if answer(case) != case.said:
                os._exit(0)
        os.write(writing, b"survived\n")
    finally:
        os._exit(0)


# The page


@cache
def clauses_of(module):
    """Return {function: clauses that its docstring names, or that of what contains it} of a module."""
    clauses_by_place = {}

    def walk(node, place, outer):
        clauses = re.findall(r"\d+(?:\.\d+)+|(?<=[Cc]lause )\d+", ast.get_docstring(node) or "") or outer
        clauses_by_place[".".join(place)] = clauses
        for part in node.body:
            if isinstance(part, ast.FunctionDef | ast.ClassDef):
                walk(part, [*place, part.name], clauses)

    walk(source_of(module), [], [])
    return clauses_by_place


def page_of(killers, equivalents, remark=""):
    """Return the text of docs/reports/mutants.md. killers: {Mutant: name of a case or None}; equivalents: known to change
    nothing; remark: what was run, in sentences."""
    survivors = [m for m, killer in killers.items() if killer is None and m.name not in equivalents]
    settled = len(killers) - len(survivors)
    share = settled / max(len(killers), 1)
    change = lambda m: " -> ".join("`" + text.replace("|", "\\|") + "`" for text in (m.before, m.after))
    clauses = lambda m: clauses_of(m.module).get(m.function, ["none named"])
    out = ["# Mutants of the reference decoder", "", f"Made by `make -C tools mutants` (tools/proof/mutants.py) {made_on()}: one "
           "rule of conformance/reference changed at a time, tried on every vector that runs the line.", "",
           *([remark, ""] if remark else []),
           f"{len(killers)} mutants, {settled} killed or equivalent ({share:.1%}), {len(survivors)} survivors.", "",
           "| module | statements | mutants | killed | equivalent | survivors |", "|---|---:|---:|---:|---:|---:|"]
    for module in dict.fromkeys(m.module for m in killers):
        own = [(m, killer) for m, killer in killers.items() if m.module == module]
        dead, same = sum(killer is not None for _, killer in own), sum(k is None and m.name in equivalents for m, k in own)
        statements = sum(isinstance(node, ast.stmt) for node in ast.walk(source_of(module)))
        out.append(f"| {module} | {statements} | {len(own)} | {dead} | {same} | {len(own) - dead - same} |")
    if survivors:
        out += ["", "## Survivors", "", "| place | rule | clause | change |", "|---|---|---|---|"]
        out += [f"| conformance/reference/{m.module}.py:{m.line} | {m.function} | {', '.join(clauses(m))} | {change(m)} |"
                for m in survivors]
    out += ["", "## Equivalent", "", "| rule | change | why nothing changes |", "|---|---|---|"]
    out += [f"| {m.module}.{m.function} | {change(m)} | {equivalents[m.name]} |"
            for m, killer in killers.items() if killer is None and m.name in equivalents]
    out += ["", "## Which vector kills which rule", "", "The quickest that does, by clause; a vector may kill many more.", "",
            "| clause | mutants killed | by |", "|---|---:|---|"]
    by_clause = {}
    for m, killer in killers.items():
        for clause in clauses(m) if killer else []:
            by_clause.setdefault(clause, Counter())[killer] += 1
    for clause in sorted(by_clause, key=lambda clause: [int(part) if part.isdigit() else 0 for part in clause.split(".")]):
        names = ", ".join(f"{name} {count}" for name, count in by_clause[clause].most_common(6))
        out.append(f"| {clause} | {by_clause[clause].total()} | {names} |")
    return "\n".join(out) + "\n"


# The run


def is_of(mutant, part):
    """Return whether a mutant is in a part: a function, or the functions of a clause and of its subclauses."""
    clauses = clauses_of(mutant.module).get(mutant.function, [])
    return part in (mutant.function, mutant.function.split(".")[-1], f"{mutant.module}.{mutant.function}") or any(
        f"{clause}.".startswith(f"{part}.") for clause in clauses)


def _arguments(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--module", action="append", choices=MODULES, help="of these modules only; repeatable")
    add("--only", action="append", metavar="PART", help="of this function or clause only; repeatable")
    add("--every", type=int, default=1, metavar="N", help="every N-th mutant only")
    add("--sample", type=int, metavar="N", help="so many, drawn at random")
    add("--seed", type=int, action="append", metavar="S", help="of the drawing (default 0); repeatable, a sample each")
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="N")
    add("--seconds", type=float, default=0, metavar="S", help="begin no more mutants after so long")
    add("--state", type=Path, metavar="FILE.jsonl", help="the results: read first, then added to")
    add("--page", type=Path, metavar="FILE.md")
    return parser.parse_args(arguments)


def wanted_mutants(args):
    """Return (the mutants that the parsed arguments select, a sentence on how)."""
    every = [m for module in args.module or MODULES for m in mutants_of(module)]
    chosen_mutants = [m for m in every if not args.only or any(is_of(m, part) for part in args.only)][:: args.every]
    if args.sample is None or args.sample >= len(chosen_mutants):
        is_part = len(chosen_mutants) < len(every)
        return chosen_mutants, f"{len(chosen_mutants)} of {len(every)} mutants." if is_part else "Every mutant."
    seeds = args.seed or [0]
    drawn = dict.fromkeys(m for seed in seeds for m in random.Random(seed).sample(chosen_mutants, args.sample))
    return list(drawn), (f"Samples: {args.sample} of {len(chosen_mutants)} mutants each, drawn at random with seeds "
                         f"{', '.join(map(str, seeds))}. {FITTED}")


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    args = _arguments(arguments)
    sys.path.insert(0, str(REPOSITORY / "tests"))
    wanted, chosen = wanted_mutants(args)
    rows = map(json.loads, args.state.read_text(encoding="utf-8").splitlines()) if args.state and args.state.exists() else ()
    known, spent = {tuple(row["mutant"]): row for row in rows}, {}
    equivalents = json.loads(EQUIVALENTS.read_text(encoding="utf-8")) if EQUIVALENTS.exists() else {}
    identity = lambda m: (m.module, m.number, m.key)
    traces = args.state.with_suffix(".cases.json") if args.state else None
    cases = sorted(known_cases(cases_of(), traces), key=lambda case: case.seconds)
    print(f"{len(wanted)} mutants, {len(cases)} cases, {sum(case.seconds for case in cases):.0f} s", flush=True)
    begin = time.monotonic()

    def run_mutant(mutant):
        if mutant.name in equivalents:
            return None
        if row := known.get(identity(mutant)):
            spent[mutant] = row.get("seconds", 0.0)
            return row["killer"]
        start = time.monotonic()
        if args.seconds and start - begin > args.seconds:
            return "not run"
        killer = killer_of(mutant, [case for case in cases if case.runs(mutant)])
        spent[mutant] = time.monotonic() - start
        if args.state:
            args.state.parent.mkdir(parents=True, exist_ok=True)
            with args.state.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"mutant": identity(mutant), "killer": killer, "seconds": round(spent[mutant], 2)}) + "\n")
        return killer

    with ThreadPoolExecutor(args.jobs) as pool:
        killers = dict(zip(wanted, pool.map(run_mutant, wanted), strict=True))
    killers = {mutant: killer for mutant, killer in killers.items() if killer != "not run"}
    survivors = [m for m, killer in killers.items() if killer is None and m.name not in equivalents]
    print("\n".join([*(f"survivor {m.name} (line {m.line})" for m in survivors),
                     f"{len(killers)} of {len(wanted)} mutants run, {len(survivors)} survivors"]))
    if args.page:
        remark = f"{chosen} {len(killers)} were run in {sum(spent.values()):.0f} s, on {len(cases)} vectors and levels of detail."
        args.page.write_text(page_of(killers, equivalents, remark), encoding="utf-8")
    return 7 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
