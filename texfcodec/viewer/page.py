"""The page as one file that needs neither server nor network: its style, its script, the decoder and the assets within it.

What is large stands in it deflated and in base 85. A short script, web/boot.js, unpacks the viewer and runs it.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
import zlib
from collections.abc import Sequence

from ..core.json_text import json_text
from ..limits import Limits
from ..sandbox.wasm import MODULE
from .server import WEB, Shown, about_page

STYLE, SCRIPT = '<link rel="stylesheet" href="web/style.css">', '<script src="web/viewer.js"></script>'
TITLE, CHARSET = "<title>texf-view</title>", '<meta charset="utf-8">'
_BREAKS_OUT = re.compile(r"<(?=/(?:script|style)|!--|script)", re.IGNORECASE)


def export_page(assets: Sequence[Shown], title: str, start: dict | None = None, version: str = "", *,
                limits: Limits | None = None) -> bytes:
    """Return the viewer's page as one HTML file (UTF-8) that contains these assets, the viewer and the decoder.

    title: plain text; start: JSON-ready first state of the page (camera, mode, ...), as of texf-view; version: of the package;
    limits: for streams that are dropped on it. Its content security policy forbids all requests, and all scripts and styles but
    its own.
    """
    read = lambda name: (WEB / name).read_text(encoding="utf-8")
    style, boot, viewer = inlined(read("style.css"), "\\3c "), inlined(read("boot.js"), "\\x3c"), (WEB / "viewer.js").read_bytes()
    about = json_text(about_page(assets, False, start, version, limits or Limits())).replace("<", "\\u003c")
    held = {"viewer": viewer, "decoder": MODULE.read_bytes(), **{f"asset-{i}": asset.data for i, asset in enumerate(assets)}}
    data = [f'<script type="application/json" id="about">{about}</script>']
    data += [f'<script type="application/octet-stream" id="{name}">{packed(piece)}</script>' for name, piece in held.items()]
    allowed = policy([boot.encode(), viewer], style.encode())
    parts = {CHARSET: f'{CHARSET}\n<meta http-equiv="Content-Security-Policy" content="{allowed}">',
             TITLE: f"<title>{html.escape(title)}</title>", STYLE: f"<style>{style}</style>",
             SCRIPT: "\n".join([*data, f"<script>{boot}</script>"])}
    return _with_parts(read("index.html"), parts).encode()


def _with_parts(page, parts):
    """The page with each of the parts in the place of its mark, which must be there once; what is put in is not looked at."""
    if any(page.count(mark) != 1 for mark in parts):
        raise ValueError("a mark of index.html is missing or repeated")
    marks = re.compile("|".join(map(re.escape, parts)))
    return marks.sub(lambda mark: parts[mark[0]], page)


def policy(scripts: Sequence[bytes], style: bytes) -> str:
    """Return the Content-Security-Policy of a page that allows only these scripts and this style, by their SHA-256."""
    digest = lambda data: f"'sha256-{base64.b64encode(hashlib.sha256(data).digest()).decode()}'"
    return (f"default-src 'none'; script-src {' '.join(map(digest, scripts))} 'wasm-unsafe-eval'; worker-src blob:; "
            f"style-src {digest(style)}; img-src blob: data:; connect-src blob: data:; base-uri 'none'; form-action 'none'")


def packed(data: bytes) -> str:
    """Return the bytes deflated and in base 85 with "," for "<", as text inside an HTML element; web/boot.js reads it. Base 85
    adds a quarter to the size, base 64 a third."""
    return base64.b85encode(zlib.compress(data, 9)).decode().replace("<", ",")


def inlined(text: str, less: str) -> str:
    """Return a script or style as it can stand inside an HTML element, with the line ends that an HTML parser makes. less:
    escape of "<" in strings of that language, which replaces it where it would end the element or open a comment."""
    return _BREAKS_OUT.sub(lambda _: less, text.replace("\r\n", "\n").replace("\r", "\n"))
