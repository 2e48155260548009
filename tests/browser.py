"""JavaScript of the viewer in headless Chromium, for tests: run_module() gives back what a module's main() returns."""

import base64
import json
import os
import shutil
import signal
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

WEB = Path(__file__).resolve().parents[1] / "texfcodec" / "viewer" / "web"
NAMES = (os.environ.get("CHROMIUM", "chromium"), "chromium", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, NAMES)), None)
FLAGS = ["--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-first-run",
         "--disable-background-networking", "--disable-dev-shm-usage"]
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on PATH to run the viewer's modules in")

PAGE = """<!doctype html><meta charset="utf-8"><script type="module">
const KINDS = { float32: Float32Array, float64: Float64Array, int32: Int32Array, uint32: Uint32Array, uint8: Uint8Array };
function revived(key, value) {
  if (!value || !(value.$kind in KINDS)) return value;
  const array = new KINDS[value.$kind](Uint8Array.from(atob(value.base64), (c) => c.charCodeAt(0)).buffer);
  return Object.assign(array, { shape: value.shape });
}
function packed(key, value) {
  if (!ArrayBuffer.isView(value)) return value;
  const bytes = new Uint8Array(value.buffer, value.byteOffset, value.byteLength);
  let text = '';
  for (let i = 0; i < bytes.length; i += 4096) text += String.fromCharCode(...bytes.subarray(i, i + 4096));
  const $kind = Object.keys(KINDS).find((name) => value instanceof KINDS[name]);
  return { $kind, shape: value.shape ?? [value.length], base64: btoa(text) };
}
let answer;
try {
  const { main } = await import('./module.js');
  const data = JSON.parse(await (await fetch('data')).text(), revived);
  answer = JSON.stringify({ value: await main(data) ?? null }, packed);
} catch (error) {
  answer = JSON.stringify({ error: `${error}\\n${error.stack}` });
}
await fetch('answer', { method: 'POST', body: answer });
</script>"""


def run_module(tmp_path, javascript, data=None, seconds=120):
    """What `main(data)` of a module returns, or a promise of it. javascript: the text of the module, which exports main() and
    may import './NAME.js' of the viewer's; data, and what comes back: JSON, with numpy arrays as typed arrays that have a
    property shape. An exception of the page is an AssertionError here."""
    files = {"/": ("text/html", PAGE.encode()), "/module.js": ("text/javascript", javascript.encode()),
             "/data": ("application/json", json.dumps(data, default=_packed).encode())}
    with _Server(files) as server:
        command = [BROWSER, *FLAGS, *(["--no-sandbox"] if os.geteuid() == 0 else []), f"--user-data-dir={tmp_path / 'profile'}",
                   f"http://127.0.0.1:{server.server_port}/"]
        with open(tmp_path / "browser.log", "wb") as log:
            browser = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        try:
            assert server.answered.wait(seconds), f"no answer in {seconds} s: {(tmp_path / 'browser.log').read_text()[-2000:]}"
        finally:
            os.killpg(browser.pid, signal.SIGKILL)
            browser.wait()
        answer = json.loads(server.answer, object_hook=_revived)
    assert "error" not in answer, answer["error"]
    return answer["value"]


def _packed(array):
    return {"$kind": array.dtype.name, "shape": array.shape, "base64": base64.b64encode(array.tobytes()).decode()}


def _revived(value):
    if "$kind" not in value:
        return value
    return np.frombuffer(base64.b64decode(value["base64"]), value["$kind"]).reshape(value["shape"])


class _Server(ThreadingHTTPServer):
    """Serves the page, the module under test and the viewer's modules on the loopback, and takes the answer."""

    daemon_threads = True

    def __init__(self, files):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.files, self.answered, self.answer = files, threading.Event(), b""

    def __enter__(self):
        threading.Thread(target=self.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        kind, body = self.server.files.get(self.path, ("text/javascript", None))
        modules = {f"/{path.name}": path for path in WEB.glob("*.js")}
        if body is None and self.path in modules:
            body = modules[self.path].read_bytes()
        self.send_response(404 if body is None else 200)
        self.send_header("Content-Type", kind)
        self.end_headers()
        self.wfile.write(body or b"")

    def do_POST(self):
        self.server.answer = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(204)
        self.end_headers()
        self.server.answered.set()

    def log_message(self, *_):
        pass
