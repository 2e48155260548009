"""Stand-ins for the browser and for the page, so that viewer/headless.py and texf-view are tried without either, and requests to
the server that say what they like."""

import io
import shutil
import socket
import sys
from pathlib import Path

from texfcodec.viewer import headless, page, server

FAKE = """#!{python}
import json, os, subprocess, sys, time, urllib.request

address, what = sys.argv[-1], {what!r}
origin = "/".join(address.split("/")[:3])

def ask(place, data=None, kind=""):
    head = {{"Content-Type": kind, "Origin": origin}} if data is not None else {{}}
    with urllib.request.urlopen(urllib.request.Request(address + place, data, head)) as answer:
        return answer.read()

if what == "ends":
    sys.exit(3)
if what == "breaks":
    print('[1:2:INFO:CONSOLE:3] "Uncaught Error: no such thing", source: ' + address + ' (3)', file=sys.stderr, flush=True)
if what in ("sleeps", "breaks"):
    subprocess.run([sys.executable, "-c", "import time; time.sleep(60)"])
for number, job in enumerate(json.loads(ask("job"))):
    if what == "refuses":
        ask(f"result/{{number}}", b'{{"error": {{"message": "there is no layer of this name"}}}}', "application/json")
    elif what == "draws":
        ask(f"result/{{number}}", {png!r} + json.dumps(job).encode(), "image/png")
    else:
        ask(f"result/{{number}}", b"%d %d" % (number, len(ask("asset/0"))), "application/octet-stream")
time.sleep(60)
"""
PNG = b"\x89PNG\r\n\x1a\n"
MAIN = """import { double } from './double.js';
import { inlined, inlinedText, isExported } from './inlined.js';

async function start() {
  if (isExported()) {
    const data = new Uint8Array(await inlined('asset-0')), { names } = JSON.parse(inlinedText('about'));
    document.title = `${names.length} ${data.length} ${data.reduce((sum, v) => sum + v, 0)} </script>`;
    return;
  }
  const answer = await fetch('job');
  const jobs = answer.status === 204 ? [] : await answer.json();
  for (let i = 0; i < jobs.length; i++) {
    const gl = document.createElement('canvas').getContext('webgl2');
    const size = (await (await fetch('asset/0')).arrayBuffer()).byteLength;
    const facts = { version: gl.getParameter(gl.VERSION), size: double(size) };
    const headers = { 'Content-Type': 'application/json' };
    await fetch(`result/${i}`, { method: 'POST', headers, body: JSON.stringify(facts) });
  }
}

start();
"""


def fake_browser(folder, what):
    """Path of a program in place of a browser: it "ends" at once, "sleeps" with a child, "breaks" on the page, or it answers each
    job: "refuses" it, "draws" a PNG whose rest is the job, or tells the "size" of the first container."""
    path = folder / f"browser_{what}"
    path.write_text(FAKE.format(python=sys.executable, what=what, png=PNG))
    path.chmod(0o755)
    return path


def write_page(folder):
    """A small page in a folder, for use in place of viewer/web/: with the real index.html and inlined.js."""
    for name in ("index.html", "inlined.js"):
        shutil.copy(server.WEB / name, folder / name)
    (folder / "style.css").write_text("canvas { width: 100%; }\n")
    (folder / "double.js").write_text("export function double(number) {\n  return 2 * number;\n}\n")
    (folder / "main.js").write_text(MAIN)
    return Path(folder)


def use_page(monkeypatch, folder):
    """The page of a folder in place of viewer/web/."""
    for module in (server, page):
        monkeypatch.setattr(module, "WEB", folder)


def real_browser():
    """Path of a browser on this machine, or None."""
    return headless.find_browser()


def talk(view, data, seconds=20):
    """What comes back for bytes sent as they are: bytes, up to the end of the connection."""
    with socket.create_connection(("127.0.0.1", view.port), timeout=seconds) as line:
        line.sendall(data)
        out = io.BytesIO()
        while part := line.recv(1 << 16):
            out.write(part)
    return out.getvalue()


def ask(view, place, method="GET", body=None, whole=False, leave=(), **headers):
    """(status, headers, body) of a request as the page makes it, but for what headers say. place: below the token, or with whole
    the path itself; leave: names of headers that are not sent."""
    own = {"Host": f"127.0.0.1:{view.port}"}
    if body is not None:
        own |= {"Origin": f"http://127.0.0.1:{view.port}", "Content-Length": str(len(body)), "Content-Type": "application/json"}
    own |= {name.replace("_", "-"): value for name, value in headers.items()}
    lines = [f"{method} {place if whole else f'/{view.token}/{place}'} HTTP/1.1"]
    lines += [f"{name}: {one}" for name, value in own.items() if name not in leave
              for one in (value if isinstance(value, list) else [value])]
    head, _, rest = talk(view, "\r\n".join([*lines, "", ""]).encode("latin-1") + (body or b"")).partition(b"\r\n\r\n")
    first, *told = head.decode("latin-1").split("\r\n")
    return int(first.split()[1]), dict(line.split(": ", 1) for line in told), rest


def post(view, place, body, **headers):
    """As ask(), a POST of a body."""
    return ask(view, place, "POST", body, **headers)
