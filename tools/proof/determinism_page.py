"""What the runs of tools/proof/determinism.py come to: a verdict for every row and configuration, and the page."""

from dataclasses import dataclass

from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table, wrapped

SAME, STREAM, ARRAYS, FAILS, NOT_RUN = "same", "**stream differs**", "**ARRAYS DIFFER**", "**fails**", "not run"
ORDER = (SAME, NOT_RUN, STREAM, FAILS, ARRAYS)  # of several cases in a row the last one counts
INTRODUCTION = (
    "Each column is a configuration in a process of its own, which is compared with the reference: the SHA-256 of the "
    "stream that it codes, and of every array that it decodes, at all levels and without the finest two, from the stream "
    "*that the reference has coded*; the colours asked at 1000 points are among them. Decoding is integers alone and may "
    "never differ (clause 1 of the specification). An encoder reckons with floating point, and where that rounds otherwise "
    "it may take another decision, whose stream is as valid: so does a fit of 3DNTC (the row with codec 3dntc), hundreds of "
    "steps in fast floating point, which is the same for any number of threads, locale and folder, but not for another "
    "processor or compiler.")


@dataclass(frozen=True)
class Verdict:
    """text: one of ORDER; why: what is behind it, "" where all is the same."""

    text: str
    why: str = ""

    @property
    def differs(self):
        """Whether it is a reason to end with EXIT_DIFFERS."""
        return self.text not in (SAME, NOT_RUN)


def verdicts_of(runs, cases):
    """{row: {configuration: Verdict}} of all runs but the reference, the first; the reference where it fails itself."""
    reference, *others = runs
    table = {}
    for case in cases:
        row = table.setdefault(case.name, {})
        expected = reference.rows.get(case.key)
        for run in others:
            new = _verdict(case, expected, run, reference.reason)
            old = row.get(run.configuration.name, Verdict(SAME))
            row[run.configuration.name] = max(old, new, key=lambda verdict: ORDER.index(verdict.text))
    return table


def _verdict(case, expected, run, reason):
    if expected is None or "missing" in expected:
        return Verdict(NOT_RUN, expected["missing"] if expected else f"the reference was not run: {reason}")
    if "error" in expected:
        return Verdict(FAILS, f"the reference fails: {expected['error']}")
    if run.configuration.tiny_only and not case.tiny:
        return Verdict(NOT_RUN, run.configuration.told)
    found = run.rows.get(case.key)
    if found is None or "missing" in found:
        return Verdict(NOT_RUN, run.reason or found["missing"])
    if "error" in found:
        return Verdict(FAILS, f"{case.key}: {found['error']}")
    arrays = expected["arrays"] | found["arrays"]
    changed = [name for name in arrays if expected["arrays"].get(name) != found["arrays"].get(name)]
    if changed:
        return Verdict(ARRAYS, f"{case.key}: {', '.join(changed)}")
    if found["stream"] != expected["stream"]:
        return Verdict(STREAM, f"{case.key}: {found['bytes']:,} bytes, where the reference has {expected['bytes']:,}")
    return Verdict(SAME)


def page_of(runs, cases, verdicts, options):
    """docs/reports/determinism.md. options: {row: what it is coded with}."""
    reference, *others = runs
    count = {text: sum(v.text == text for row in verdicts.values() for v in row.values()) for text in ORDER}
    total = sum(count.values())
    lines = ["# Determinism", "", f"Made by `make -C tools determinism` (tools/proof/determinism.py) {made_on()}.", "",
             INTRODUCTION, "",
             f"Of {total} cells {count[SAME]} are the same, {count[NOT_RUN]} were not run, in {count[STREAM]} the encoder's "
             f"stream differs, in {count[ARRAYS]} a decoded array; {count[FAILS]} fail.", "", *_matrix(others, verdicts), "",
             "## Configurations", "", *_configurations(runs), "", "## Rows", "", *_rows(reference, cases, options)]
    return "\n".join(wrapped(lines)) + "\n"


def _matrix(runs, verdicts):
    names = [run.configuration.name for run in runs]
    notes, body = {}, []
    for row, cells in verdicts.items():
        body.append([row, *(_cell(cells[name], f"{row}, {name}", notes) for name in names)])
    table = markdown_table(["", *names], body, len(names) + 1)
    return [*table, *[""][:len(notes)], *(f"{number}. {text[0].upper()}{text[1:]}." for text, number in notes.items())]


def _cell(verdict, place, notes):
    if verdict.text == SAME:
        return SAME
    text = verdict.why if verdict.text == NOT_RUN else f"{place}: {verdict.why}"
    return f"{verdict.text} ({notes.setdefault(text.rstrip('.'), len(notes) + 1)})"


def _configurations(runs):
    head = ["configuration", "what it is", "Python", "numba", "numpy", "AVX2 used by", "libm", "locale"]
    rows = []
    for run in runs:
        one, facts = run.configuration, run.facts
        if facts is None:
            rows.append([one.name, f"{one.told}; not run: {run.reason}", *[""] * (len(head) - 2)])
            continue
        text = f"point “{facts['decimal point']}”, {facts['offset to UTC']}, {facts['encoding']}"
        rows.append([one.name, one.told, facts["python"], facts["numba"] if facts["jit"] else f"{facts['numba']}, JIT off",
                     facts["numpy"], ", ".join(facts["wide"]) or "none", facts["libm"][:6], text])
    yield ("What each process found out about itself before it began; a configuration that is not what it says is not run. AVX2 "
           "is looked for in numpy's dispatch, in the code that numba makes of a loop, and in the core that OpenBLAS chose; "
           "*libm* is a hash over answers of the C library's sin, exp, log and pow, which has other code for processors without "
           "FMA. Packages beside numba and numpy have the same versions everywhere.")
    yield ""
    yield from markdown_table(head, rows, len(head))


def _rows(reference, cases, options):
    names = dict.fromkeys(case.name for case in cases)
    rows = []
    for name in names:
        mine = [reference.rows.get(case.key, {}) for case in cases if case.name == name]
        given = ", ".join(f"{key} {value}" for key, value in options.get(name, {}).items()) or "decoded alone"
        rows.append([name, given, f"{sum(row.get('bytes', 0) for row in mine):,}"])
    yield "Options of the encoder, and bytes of the reference's stream."
    yield ""
    yield from markdown_table(["row", "options", "bytes"], rows, 2)
