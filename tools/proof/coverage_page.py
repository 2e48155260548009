"""docs/reports/coverage.md: what tools/proof/coverage_table.py counted, by module, and every branch that no run takes."""

from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table, wrapped

INTRODUCTION = (
    "How much of the decoder its tests and vectors run. Measured are whole files: every module of the package that a fresh "
    "interpreter holds after `texf-dec` has decoded a vector of each kind to each kind of file, alone and in a child process. "
    "What encodes stands beside what decodes in the same files, and counts as well; only blocks for the type checker (`if "
    "TYPE_CHECKING`) do not. A branch is a way out of an `if`, `for` or `while`; a condition inside one line (`a if b else c`, "
    "`and`, `or`) is none.")
COMPILED = (
    "A compiled kernel cannot be watched: what runs with the JIT counts for the Python around the kernels alone, and the "
    "branches of kernels are those that plain Python takes.")


def page_of(modules, reasons, runs):
    """docs/reports/coverage.md. modules: Module; reasons: {key: why}; runs: (Part, seconds)."""
    branches, missed = sum(m.branches for m in modules), sum(len(m.missed) for m in modules)
    share = f"{100 * (branches - missed) / max(branches, 1):.2f} %"
    out = ["# Branches of the decoder", "",
           *wrapped([f"Made by `make -C tools coverage` (tools/proof/coverage_table.py). {INTRODUCTION}"]), "",
           *wrapped([f"**{branches - missed} of {branches} branches are taken, {share}**, in {len(modules)} modules of "
                    f"{sum(m.statements for m in modules)} statements; the other {missed} are named below. {COMPILED}"]), "",
           "## What runs", "", *_parts(runs), "", "## By module", "", *_by_module(modules, share), "",
           "## Branches not taken", "", *_missed(modules, reasons)]
    return "\n".join(out) + "\n"


def _parts(runs):
    rows = [[part.name, part.told, f"{seconds:.0f}"] for part, seconds in runs]
    yield from markdown_table(["part", "what", "seconds"], rows, 2)
    yield ""
    yield f"Made {made_on()}; other work may have shared the processor."


def _by_module(modules, share):
    rows = [[m.name, m.statements, m.branches, len(m.missed), _share(m)] for m in modules]
    total = [sum(row[i] for row in rows) for i in (1, 2, 3)]
    return markdown_table(["module", "statements", "branches", "not taken", "taken"], [*rows, ["all", *total, share]])


def _share(module):
    return f"{100 * (module.branches - len(module.missed)) / module.branches:.1f} %" if module.branches else ""


def _missed(modules, reasons):
    rows = [[f"{m.name}:{branch.line}", branch.function, _code(branch.text), _code(branch.goal),
             reasons.get(branch.key_in(m.name), "**no reason given**")] for m in modules for branch in m.missed]
    return markdown_table(["line", "function", "at", "never goes to", "why"], rows, 5)


def _code(text):
    return f"`{text}`"
