"""The page's own server: on the loopback interface only, a token in every path, and nothing served but the page, the assets that
it was given and what is dropped on it.

Other pages in the same browser are the danger: they can send requests here too. So a request names this host (a foreign name
that was pointed at the loopback address does not), comes from this origin, and knows the token.
"""

from __future__ import annotations

import hmac
import io
import os
import re
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import TCPServer
from typing import Any, NamedTuple
from urllib.parse import parse_qs

from ..core.json_text import json_text
from ..errors import InputError, TexfError
from ..limits import Limits
from ..render.environment import DAYLIGHT
from ..sandbox.wasm import LIMITS, MODULE

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")  # of this host, as a browser may write them
WEB = Path(__file__).parent / "web"
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8",
         ".wasm": "application/wasm"}
BYTES, JSON = "application/octet-stream", "application/json"
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src blob:; style-src 'self'; "
                               "connect-src 'self' blob: data:; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; "
                               "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}  # fmt: skip
MOST_VISITS = 64  # connections at a time; a browser opens six
VISIT_SECONDS = 60.0  # for a whole request, and again for the whole answer
LINGER_SECONDS = 2.0  # for what a refused client still sends, so that it reads why
LONGEST_NAME = 255


class Shown(NamedTuple):
    """An asset that the page shows. size: bytes of its source files; data: a .texf stream or a GLB; warnings: a sentence
    each."""

    name: str
    size: int
    data: bytes
    warnings: list[str] = []  # noqa: RUF012  never changed


class ViewServer:
    """Context manager: serves the page at .address to this machine until the block ends.

    assets: what the page shows; drop(data, name): converts a mesh file that the user drops on the page to a GLB, or raises
    TexfError; without it the page takes streams and GLB files alone. start: JSON-ready first state of the page (camera, mode,
    ...); version: the package's; port: 0 for any that is free; limits: of streams and of a request.
    """

    def __init__(self, assets: Sequence[Shown], drop: Callable[[bytes, str], bytes] | None = None, *, start: dict | None = None,
                 version: str = "", port: int = 0, limits: Limits | None = None) -> None:
        self.assets, self.drop = list(assets), drop
        self.start, self.version, self.limits, self.token = start, version, limits or Limits(), secrets.token_urlsafe(24)
        self.pages = {path.name: path.read_bytes() for path in (*WEB.iterdir(), MODULE) if path.suffix in KINDS}
        self.dropping = threading.Lock()  # one at a time: each may take as much memory as its limits allow
        try:
            self._http = _Http((HOST, port), self)
        except (OSError, OverflowError) as error:
            raise InputError("TXF-C08", "the page cannot be served at this port", port=port, reason=str(error)) from None

    def __enter__(self) -> ViewServer:
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    @property
    def port(self) -> int:
        """The port that it listens at."""
        return self._http.server_address[1]

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def about(self) -> dict:
        """Answer to the page's first request."""
        return about_page(self.assets, self.drop is not None, self.start, self.version, self.limits)


def about_page(assets: Sequence[Shown], drop: bool, start: dict | None, version: str, limits: Limits) -> dict:
    """Return what the page needs to know about itself, JSON-ready: its assets, version, first state, limits of streams, and
    light. drop: whether a server converts meshes that are dropped on it; start: first state, such as camera and mode."""
    words = {name: name.partition("_")[0] + "".join(part.title() for part in name.split("_")[1:]) for name in LIMITS}
    lights = [{"direction": light.direction.tolist(), "irradiance": light.irradiance.tolist()} for light in DAYLIGHT.lights]
    rows = [{"name": asset.name, "bytes": asset.size, "warnings": asset.warnings} for asset in assets]
    return {"assets": rows, "version": version,
            "drop": drop, "start": start, "light": {"powers": DAYLIGHT.powers.tolist(), "lights": lights},
            "limits": {word: getattr(limits, name) or 0 for name, word in words.items()}}


class Refused(Exception):
    """A request that gets no answer but a status and a sentence."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status, self.sentence = status, sentence


class _Http(ThreadingHTTPServer):
    """A thread for each connection, so many at a time; what goes wrong in one is its client's affair."""

    daemon_threads, block_on_close, request_queue_size = True, False, MOST_VISITS
    allow_reuse_address = os.name != "nt"  # there another process could take the port over

    def __init__(self, address, view):
        self.view, self.visits = view, threading.BoundedSemaphore(MOST_VISITS)
        super().__init__(address, _Visit)

    def server_bind(self):
        TCPServer.server_bind(self)  # not HTTPServer's, which asks name servers what this host is called

    def process_request(self, request, client_address):
        if not self.visits.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request, client_address):
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.visits.release()

    def handle_error(self, request, client_address):
        pass  # a client that went away


class _Timed(io.RawIOBase):
    """Bytes that a client sends, all of them within so many seconds: one that sends a byte now and then holds no thread for
    long."""

    def __init__(self, connection, seconds):
        self.connection, self.end = connection, time.monotonic() + seconds

    def readable(self):
        return True

    def readinto(self, buffer):
        self.connection.settimeout(max(self.end - time.monotonic(), 1e-3))
        return self.connection.recv_into(buffer)


class _Visit(BaseHTTPRequestHandler):
    """One request and its answer."""

    server: _Http
    server_version, sys_version = "texf-view", ""
    default_request_version = "HTTP/1.0"  # not 0.9, whose answers have no head

    def setup(self):
        super().setup()
        self.rfile = io.BufferedReader(_Timed(self.connection, VISIT_SECONDS))
        self.is_refused = False

    def log_message(self, *_):
        pass

    def send_error(self, code, message=None, explain=None):
        """Answer a request that the base class refuses, such as an unknown method or a head that is too long. code: HTTP
        status."""
        self._refuse(code, message or "refused")

    def do_GET(self):
        with self._refusing():
            self._get(self._place(needs_origin=False))

    def do_POST(self):
        with self._refusing():
            self._post(self._place(needs_origin=True))

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except Refused as refused:
            self._refuse(refused.status, refused.sentence)

    def _refuse(self, status, sentence):
        self.is_refused = True
        self._answer(status, "text/plain; charset=utf-8", sentence.encode("ascii", "backslashreplace") + b"\n")

    def _place(self, needs_origin: bool) -> str:
        """Requested path, below the token. Raises Refused for other requests."""
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or hosts[0].lower() not in [f"{name}:{self.server.view.port}" for name in NAMES]:
            raise Refused(421, "the host name is not allowed")
        origins = self.headers.get_all("Origin") or [""] * needs_origin
        if any(origin.lower() != f"http://{hosts[0]}".lower() for origin in origins):
            raise Refused(403, "requests from another page are not allowed")
        site, mode = self.headers.get("Sec-Fetch-Site", "none"), self.headers.get("Sec-Fetch-Mode")
        if site not in ("none", "same-origin") and (needs_origin or mode != "navigate"):  # a link to the page may be anywhere
            raise Refused(403, "requests from another page are not allowed")
        first, token, place = (*self.path.split("/", 2), "", "", "")[:3]
        knows = hmac.compare_digest(token.encode("latin-1", "replace"), self.server.view.token.encode())
        if first or not knows or self.path.count("/") < 2:
            raise Refused(404, "nothing exists at this address")
        return place

    def _get(self, place):
        """Answers a GET. Every place is matched as a whole: nothing of it ever becomes a path."""
        view = self.server.view
        asset = re.fullmatch(r"asset/([0-9]{1,6})", place)
        place = "" if place.startswith("?") else place  # how the page is to begin, which it reads itself
        name = "index.html" if place == "" else place.removeprefix("web/") if place.startswith("web/") else ""
        if place == "about":
            self._answer_json(200, view.about())
        elif asset and int(asset[1]) < len(view.assets):
            self._answer(200, BYTES, view.assets[int(asset[1])].data)
        elif name in view.pages and (name == "index.html") == (place == ""):
            self._answer(200, KINDS[Path(name).suffix], view.pages[name])
        else:
            raise Refused(404, "nothing exists at this address")

    def _post(self, place):
        view = self.server.view
        if re.fullmatch(r"drop\?[^/]*", place) and view.drop is not None:
            names = parse_qs(place.partition("?")[2], keep_blank_values=True).get("name", [])
            if len(names) != 1:
                raise Refused(400, "a dropped file must have a name")
            self._drop(view, self._body(), "".join(c for c in names[0] if c.isprintable())[:LONGEST_NAME])
        else:
            raise Refused(404, "nothing exists at this address")

    def _body(self):
        """The bytes that were sent. Raises Refused."""
        lengths, most = self.headers.get_all("Content-Length") or [], self.server.view.limits.file_bytes
        if len(lengths) != 1 or not re.fullmatch(r"[0-9]{1,18}", lengths[0]) or "Transfer-Encoding" in self.headers:
            raise Refused(411, "the length of the content is required")
        length = int(lengths[0])
        if most is not None and length > most:
            raise Refused(413, f"at most {most} bytes are accepted")
        data = self.rfile.read(length)
        if len(data) < length:
            raise Refused(400, "the content is incomplete")
        return data

    def _drop(self, view, data, name):
        """Answers with the GLB of a file, or 422 and the error as data."""
        try:
            with view.dropping:
                converted = view.drop(data, name)
        except TexfError as error:
            self._answer_json(422, error.as_dict())
        except MemoryError:
            self._answer_json(422, {"code": "TXF-L09", "message": "there is not enough memory"})
        except Exception as error:
            self._answer_json(500, {"code": "TXF-C04", "message": "internal error; please report it",
                                    "reason": type(error).__name__})
        else:
            self._answer(200, BYTES, converted)

    def _answer_json(self, status: int, facts: Any):
        self._answer(status, JSON, json_text(facts).encode())

    def _answer(self, status: int, kind: str, data: bytes):
        """Assets go out as they are: the loopback interface is faster than any compression."""
        self.connection.settimeout(VISIT_SECONDS)
        self.close_connection = True
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(data)), "Connection": "close"}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def finish(self):
        """Reads what a refused client has still to say, for a while: closed at once, the connection would be reset, and the
        client would never see the answer."""
        super().finish()
        if not self.is_refused:
            return
        try:
            self.connection.shutdown(socket.SHUT_WR)
            end = time.monotonic() + LINGER_SECONDS
            while time.monotonic() < end:
                self.connection.settimeout(LINGER_SECONDS)
                if not self.connection.recv(1 << 16):
                    break
        except OSError:
            pass
