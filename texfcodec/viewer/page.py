"""The page as one file that needs neither server nor network: its style, its modules, the decoder and the assets within it.

The modules of web/ become one script, each a function of its own, whose names nobody else sees. Every import and export of theirs
is a line of one form, which is checked here, because a module of another form would break only the exported page.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
import zlib
from collections.abc import Callable, Sequence

from ..core.json_text import json_text
from ..limits import Limits
from ..sandbox.wasm import MODULE
from .pack import pack_light
from .server import WEB, about_page

ENTRY = "main.js"
STYLE, SCRIPT = '<link rel="stylesheet" href="web/style.css">', '<script type="module" src="web/main.js"></script>'
TITLE, CHARSET = "<title>texf-view</title>", '<meta charset="utf-8">'
IMPORT = re.compile(r"import (\{ ?[\w$]+(?:, [\w$]+)* ?\}) from '\./([\w.-]+\.js)';")
EXPORT = re.compile(r"export (?=(?:async )?function\*? ([\w$]+)|class ([\w$]+)|const ([\w$]+) =)")
_LOOKS_LIKE_ONE = re.compile(r"\s*(?:import\b(?!\.meta)|export\b)")
_BREAKS_OUT = re.compile(r"<(?=/(?:script|style)|!--|script)", re.IGNORECASE)


def export_page(assets: Sequence[bytes], title: str, start: dict | None = None, version: str = "", *,
                names: Sequence[str] = (), limits: Limits | None = None) -> bytes:
    """The page with these streams, or containers of viewer.pack.pack(), in it, as one HTML file.

    title: as text; start: JSON-ready, how the page is to begin; version: of the package; names: of the assets; limits: of streams
    that are dropped on it. Its policy forbids every request, and every script and style but those that it holds.
    """
    page = (WEB / "index.html").read_text(encoding="utf-8")
    style = inlined((WEB / "style.css").read_text(encoding="utf-8"), "\\3c ")
    script = inlined(bundled(), "\\x3c")
    facts = about_page(list(names) or [""] * len(assets), False, start, version, limits or Limits())
    about = json_text(facts).replace("<", "\\u003c")
    held = {"decoder": MODULE.read_bytes(), "light": pack_light(), **{f"asset-{i}": one for i, one in enumerate(assets)}}
    data = [f'<script type="application/json" id="about">{about}</script>']
    data += [f'<script type="application/octet-stream" id="{name}">{packed(one)}</script>' for name, one in held.items()]
    parts = {CHARSET: f'{CHARSET}\n<meta http-equiv="Content-Security-Policy" content="{policy(script, style)}">',
             TITLE: f"<title>{html.escape(title)}</title>", STYLE: f"<style>{style}</style>",
             SCRIPT: "\n".join([*data, f'<script type="module">{script}</script>'])}
    return _with_parts(page, parts).encode()


def _with_parts(page, parts):
    """The page with each of the parts in the place of its mark, which must be there once; what is put in is not looked at."""
    if any(page.count(mark) != 1 for mark in parts):
        raise ValueError("a mark of index.html is missing or repeated")
    marks = re.compile("|".join(map(re.escape, parts)))
    return marks.sub(lambda found: parts[found[0]], page)


def policy(script: str, style: str) -> str:
    """The Content-Security-Policy of a page with this script and this style, named by their digests."""
    named = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (script, style)]
    return (f"default-src 'none'; script-src 'sha256-{named[0]}' 'wasm-unsafe-eval'; worker-src blob:; "
            f"style-src 'sha256-{named[1]}'; img-src blob: data:; "
            "base-uri 'none'; form-action 'none'")


def packed(data: bytes) -> str:
    """Bytes deflated and in base 85, with a comma in place of "<": a quarter longer than its bytes, where base 64 is a
    third, and nothing in it can end the element that it stands in. web/inlined.js reads it."""
    return base64.b85encode(zlib.compress(data, 9)).decode().replace("<", ",")


def inlined(text: str, less: str) -> str:
    """A module or style that can stand within an HTML element: the "<" of what would end it, or open a comment, is written as the
    language writes it in strings. Line ends are those that a parser of HTML makes of them, before a digest is taken."""
    return _BREAKS_OUT.sub(lambda _: less, text.replace("\r\n", "\n").replace("\r", "\n"))


def bundled(read: Callable[[str], str] = lambda name: (WEB / name).read_text(encoding="utf-8"), entry: str = ENTRY) -> str:
    """All modules that the entry needs as one script, each behind those that it imports. read: text of a module by its name.

    Raises ValueError where a line of a module is none of the forms that this understands, or modules import each other.
    """
    places: dict[str, str] = {}  # of a module's exports, by its name
    texts: list[str] = []

    def visit(name, above):
        if name in above:
            raise ValueError(f"{name} imports itself by way of {' and '.join(above[above.index(name) + 1:]) or 'nothing'}")
        if name in places:
            return
        text = read(name)
        for needed in needs_of(name, text):
            visit(needed, [*above, name])
        places[name] = f"module{len(places)}"
        texts.append(_as_function(text, places[name], places))

    visit(entry, [])
    return "\n".join(texts) + "\n"


def needs_of(name: str, text: str) -> list[str]:
    """Names of the modules that a module imports. Raises ValueError for imports and exports of another form."""
    lines = [line for line in text.splitlines() if _LOOKS_LIKE_ONE.match(line)]
    strange = [line for line in lines if not (IMPORT.fullmatch(line) or EXPORT.match(line))]
    if strange or re.search(r"\bimport\s*\(|\bimport\.meta\b", text):
        raise ValueError(f"{name} has an import or export that cannot be bundled: {strange[:1]}")
    return [found[2] for line in lines if (found := IMPORT.fullmatch(line))]


def _as_function(text, place, places):
    """A module as a function that returns its exports, which `place` then names; without comments of whole lines and indents,
    which nobody reads here."""
    exports = [next(filter(None, found.groups())) for line in text.splitlines() if (found := EXPORT.match(line))]
    text = re.sub(r"(?m)^[ \t]*/\*\*(?:[^*]|\*(?!/))*\*/\n", "", text)
    lines = []
    for line in map(str.strip, text.splitlines()):
        if found := IMPORT.fullmatch(line):
            lines.append(f"const {found[1]} = {places[found[2]]};")
        elif line and not line.startswith("//"):
            lines.append(EXPORT.sub("", line, count=1))
    body = "\n".join(lines)
    return f"const {place} = (() => {{\n{body}\nreturn {{ {', '.join(exports)} }};\n}})();"
