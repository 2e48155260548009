"""Which branches of the package a run takes: the statements if, for and while, each entered and passed by.

Traced in Python, so it sees kernels only where they are not compiled. A branch on one line with its body cannot be told and does
not count, nor does what only the encoder's side calls.
"""

import ast
import re
import sys
import threading
from functools import lru_cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "texfcodec"
# By name, functions of modules with two sides that a decoder or loader never enters.
OTHER_SIDE = re.compile(r"_?(enc|encode|write|fit|forward|choose|make|measure|scale_plane|original|plan|cross_sums|resident_bytes"
                        r"|index_bytes|shown_area|result_lines|check_options|suits|split_corners)(_|$)|.*(_cost|Encoder)$")


class Branch:
    """One way out of a statement. place: "module.py:line", with " not" where it is passed by; head, body: lines, inclusive."""

    def __init__(self, place: str, head: tuple[int, int], body: tuple[int, int], entered: bool) -> None:
        self.place, self.head, self.body, self.entered = place, head, body, entered

    def is_taken(self, arcs: set) -> bool:
        """Whether one of the arcs (from line, to line) goes this way."""
        low, high = self.head
        return any(low <= a <= high and not low <= b <= high and (self.body[0] <= b <= self.body[1]) == self.entered
                   for a, b in arcs)


@lru_cache(maxsize=256)
def branches_of(module: str) -> tuple[Branch, ...]:
    """Branches of a module, a path in the package such as "core/syntax_walk.py", or of some of its functions and classes:
    "core/syntax_walk.py#Reader#write_v"."""
    module, *names = module.split("#")
    found: list[Branch] = []

    def visit(node):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and OTHER_SIDE.match(node.name) and node.name not in names:
            return
        if isinstance(node, ast.If | ast.For | ast.While):
            last = node.iter if isinstance(node, ast.For) else node.test
            head, body = (node.lineno, last.end_lineno), (node.body[0].lineno, node.body[-1].end_lineno)
            always = isinstance(last, ast.Constant) and isinstance(node, ast.While)
            if body[0] > head[1] and not always:
                found.extend(Branch(f"{module}:{node.lineno}{'' if way else ' not'}", head, body, way) for way in (True, False))
        for child in ast.iter_child_nodes(node):
            visit(child)

    for node in ast.parse((PACKAGE / module).read_text(encoding="utf-8")).body:
        wanted = isinstance(node, ast.FunctionDef | ast.ClassDef) and (not names or node.name in names)
        if wanted:  # what runs at import is over before anything is traced
            visit(node)
    return tuple(found)


def taken(modules: tuple, arcs: dict[str, set]) -> tuple[list[str], list[str]]:
    """(places of the branches that were taken, of those that were not) of some modules. arcs: by module, pairs of lines."""
    went: list[str] = []
    missed: list[str] = []
    for module in modules:
        seen = arcs.get(module.partition("#")[0], set())
        for branch in branches_of(module):
            (went if branch.is_taken(seen) else missed).append(branch.place)
    return went, missed


class Tracer:
    """Context manager: collects arcs of the package in `arcs`, by module, in this thread and those that begin meanwhile."""

    def __init__(self) -> None:
        self.arcs: dict[str, set] = {}
        self.fresh = False  # whether an arc was seen that was not there before
        self._files: dict[str, set | None] = {}

    def __enter__(self):
        threading.settrace(self._enter)
        sys.settrace(self._enter)
        return self

    def __exit__(self, *_):
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]  # as the documentation says it is switched off

    def _arcs_of(self, name):
        path = Path(name)
        if not path.is_relative_to(PACKAGE):
            return None
        return self.arcs.setdefault(path.relative_to(PACKAGE).as_posix(), set())

    def _enter(self, frame, event, arg):
        code = frame.f_code
        try:
            seen = self._files[code.co_filename]
        except KeyError:
            seen = self._files[code.co_filename] = self._arcs_of(code.co_filename)
        if seen is None or code.co_name[0] == "<":  # comprehensions have no statements
            return None
        last = 0

        def step(frame, event, arg):
            nonlocal last
            if event == "exception":
                last = 0
                return step
            arc = (last, frame.f_lineno if event == "line" else -1)
            if arc not in seen:
                seen.add(arc)
                self.fresh = True
            last = arc[1]
            return step

        return step
