"""The page as one file that needs neither server nor network: its style, its modules and the containers within it.

The modules of web/ are written so that they can be put behind each other: every import and export is one line of one form, and
no two modules have a name in common. What they hold is checked here, because a module that breaks these rules would break only
the exported page.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
import zlib
from collections.abc import Callable, Sequence

from ..core.json_text import json_text
from .server import WEB, about_page

ENTRY = "main.js"
STYLE, SCRIPT = '<link rel="stylesheet" href="web/style.css">', '<script type="module" src="web/main.js"></script>'
TITLE, CHARSET = "<title>texf-view</title>", '<meta charset="utf-8">'
IMPORT = re.compile(r"import \{ [\w$]+(?:, [\w$]+)* \} from '\./([\w.-]+\.js)';")
EXPORT = re.compile(r"export (?=(?:async )?function |class |const )")
_LOOKS_LIKE_ONE = re.compile(r"\s*(?:import\b(?!\.meta)|export\b)")
_BREAKS_OUT = re.compile(r"<(?=/(?:script|style)|!--|script)", re.IGNORECASE)


def export_page(containers: Sequence[bytes], title: str, start: dict | None = None, version: str = "") -> bytes:
    """The page with these containers of viewer.pack.pack() in it, as one HTML file.

    title: as text; start: JSON-ready, how the page is to begin; version: of the package. Its policy forbids every request, and
    every script and style but those that it holds.
    """
    page = (WEB / "index.html").read_text(encoding="utf-8")
    style = inlined((WEB / "style.css").read_text(encoding="utf-8"), "\\3c ")
    script = inlined(joined_modules(), "\\x3c")
    about = json_text(about_page(len(containers), False, start, version)).replace("<", "\\u003c")
    data = [f'<script type="application/json" id="about">{about}</script>']
    data += [f'<script type="application/octet-stream" id="asset-{i}">{packed(one)}</script>' for i, one in enumerate(containers)]
    parts = {CHARSET: f'{CHARSET}\n<meta http-equiv="Content-Security-Policy" content="{policy(script, style)}">',
             TITLE: f"<title>{html.escape(title)}</title>", STYLE: f"<style>{style}</style>",
             SCRIPT: "\n".join([*data, f'<script type="module">{script}</script>'])}
    return _with_parts(page, parts).encode()


def _with_parts(page, parts):
    """The page with each of the parts in the place of its mark, which must be there once; what is put in is not looked at."""
    if any(page.count(mark) != 1 for mark in parts):
        raise ValueError("a mark of index.html is missing, or is there twice")
    marks = re.compile("|".join(map(re.escape, parts)))
    return marks.sub(lambda found: parts[found[0]], page)


def policy(script: str, style: str) -> str:
    """The Content-Security-Policy of a page with this script and this style, named by their digests."""
    named = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (script, style)]
    return (f"default-src 'none'; script-src 'sha256-{named[0]}'; style-src 'sha256-{named[1]}'; img-src blob: data:; "
            "base-uri 'none'; form-action 'none'")


def packed(container: bytes) -> str:
    """A container deflated and in base 85, with a comma in place of "<": a quarter longer than its bytes, where base 64 is a
    third, and nothing in it can end the element that it stands in. web/inlined.js reads it."""
    return base64.b85encode(zlib.compress(container, 9)).decode().replace("<", ",")


def inlined(text: str, less: str) -> str:
    """A module or style that can stand within an HTML element: the "<" of what would end it, or open a comment, is written as the
    language writes it in strings. Line ends are those that a parser of HTML makes of them, before a digest is taken."""
    return _BREAKS_OUT.sub(lambda _: less, text.replace("\r\n", "\n").replace("\r", "\n"))


def joined_modules(read: Callable[[str], str] = lambda name: (WEB / name).read_text(encoding="utf-8"), entry: str = ENTRY) -> str:
    """All modules that the entry needs as one, each behind those that it imports. read: text of a module by its name.

    Raises ValueError where a line of a module is none of the forms that this understands.
    """
    done: dict[str, str] = {}

    def visit(name, above):
        if name in above:
            raise ValueError(f"{name} imports itself by way of {' and '.join(above[above.index(name) + 1:]) or 'nothing'}")
        if name in done:
            return
        text = read(name)
        for needed in needs_of(name, text):
            visit(needed, [*above, name])
        done[name] = without_marks(text)

    visit(entry, [])
    return "\n".join(done.values())


def needs_of(name: str, text: str) -> list[str]:
    """Names of the modules that a module imports. Raises ValueError for imports and exports of another form."""
    lines = [line for line in text.splitlines() if _LOOKS_LIKE_ONE.match(line)]
    strange = [line for line in lines if not (IMPORT.fullmatch(line) or EXPORT.match(line))]
    if strange or re.search(r"\bimport\s*\(|\bimport\.meta\b", text):
        raise ValueError(f"{name} has an import or export that cannot be joined: {strange[:1]}")
    return [found[1] for line in lines if (found := IMPORT.fullmatch(line))]


def without_marks(text: str) -> str:
    """A module without its imports, and without the word export."""
    lines = [EXPORT.sub("", line, count=1) if EXPORT.match(line) else line for line in text.splitlines()]
    return "\n".join(line for line in lines if not IMPORT.fullmatch(line)) + "\n"


def top_names(text: str) -> list[str]:
    """Names that a module declares at its top level, imports left out. What is left over of a line of GLSL is no declaration."""
    named = r"(?:(?:async )?function\*?|class) +([\w$]+)|(?:const|let|var) +(\{[^}]*\}|\[[^\]]*\]|[\w$]+)\s*[=;]"
    found = re.finditer(rf"^(?:export )?(?:{named})", text, re.M)
    return [name for one in found for name in re.findall(r"[\w$]+", one[1] or one[2])]
