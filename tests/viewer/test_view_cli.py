"""texf-view: the exported page stands alone and lets nothing out, the picture is the page's own, and Ctrl-C leaves nothing."""

import base64
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import zlib
from pathlib import Path

import pytest
from interrupts import group_lives
from stand_ins import PNG, fake_browser, real_browser, use_page, write_page

from texfcodec import EncodeOptions, decode, encode
from texfcodec.cli import view as command
from texfcodec.demo.asset import make_sample
from texfcodec.render.backdrop import GREY
from texfcodec.sandbox.wasm import MODULE
from texfcodec.viewer import headless, page
from texfcodec.viewer.server import ViewServer

REPOSITORY = Path(__file__).resolve().parents[2]
EMPTY = REPOSITORY / "conformance" / "uncommon" / "empty" / "in.texf"
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="no Ctrl-C for another process, and no script names its program")
CHROMIUM = pytest.mark.skipif(real_browser() is None, reason="there is no Chromium on the PATH")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a stream, s.texf, and a mesh, s.glb."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "s.texf").write_bytes(encode(make_sample(), EncodeOptions(resolution=32, qp=30)))
    decode((folder / "s.texf").read_bytes()).save(folder / "s.glb", appearance="vertex")
    return folder


@pytest.fixture
def web(tmp_path, monkeypatch):
    """A small page in place of the real one."""
    (tmp_path / "web").mkdir()
    use_page(monkeypatch, write_page(tmp_path / "web"))
    return tmp_path / "web"


@pytest.fixture
def browser(web, tmp_path, monkeypatch):
    """browser(what): the stand-in for a browser is the one in use."""
    return lambda what: monkeypatch.setenv("TEXF_BROWSER", str(fake_browser(tmp_path, what)))


def held_in(text):
    """What a page holds, by its name."""
    found = re.findall(r'<script type="application/octet-stream" id="([^"]*)">([^<]*)</script>', text)
    return {name: zlib.decompress(base64.b85decode(data.replace(",", "<"))) for name, data in found}


def assets_in(text):
    """The streams and containers that a page holds."""
    return [data for name, data in held_in(text).items() if name.startswith("asset-")]


def scripts_of(text):
    return re.findall(r'<script type="module">(.*?)</script>', text, re.S)


# The exported page


def test_a_page_holds_its_assets_style_and_modules_and_asks_for_nothing(web):
    containers = [bytes(range(256)) * 9, b"", b"abc", b"</script><!--" * 9]
    text = page.export_page(containers, "two vases", {"mode": "split"}).decode()
    assert assets_in(text) == containers and held_in(text)["decoder"] == MODULE.read_bytes()
    assert "<title>two vases</title>" in text and "canvas { width: 100%; }" in text
    about = json.loads(re.search(r'id="about">(.*?)</script>', text)[1])
    assert (about["names"], about["drop"], about["start"]) == (["", "", "", ""], False, {"mode": "split"})
    assert re.findall(r"\b(?:src|href)=\"?([^\" >]*)", text) == ["data:,"]
    (script,) = scripts_of(text)
    assert script.index("function double") < script.index("2 * number") < script.index("async function start")
    assert "function isExported" in script and "const { double } = module" in script
    assert not re.search(r"^(?:import|export)\b", script, re.M)


def test_policy_of_a_page_names_its_script_and_style_by_their_digests(web):
    import hashlib

    text = page.export_page([b"abc"], "vase").decode()
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    assert text.index("http-equiv") < text.index("<title>") and policy.startswith("default-src 'none'; ")
    for name, part in (("script-src", scripts_of(text)[0]), ("style-src", re.search(r"<style>(.*?)</style>", text, re.S)[1])):
        digest = base64.b64encode(hashlib.sha256(part.encode()).digest()).decode()
        assert f"{name} 'sha256-{digest}'" in policy
    assert policy.replace("wasm-unsafe-eval", "").count("unsafe") == 0 and "worker-src blob:;" in policy
    assert "img-src blob: data:" in policy and "connect-src" not in policy


@pytest.mark.parametrize("title", ["<script>alert(1)</script>", '"><img src=x>', "</title><b>", "a & b", "\u202eevil", "<!--"])
def test_hostile_names_stay_text(web, title):
    text = page.export_page([title.encode()], title, {"layer": title}).decode()
    head, _, rest = text.partition("</title>")
    shown = head.partition("<title>")[2]
    assert not set(shown) & set("<>\"'") and len(re.findall(r"<script\b", text)) == 5 and text.count("<!--") == 0
    assert json.loads(re.search(r'id="about">(.*?)</script>', rest)[1])["start"] == {"layer": title}


def test_a_module_or_style_cannot_end_its_element(web):
    (web / "double.js").write_text("export const DOUBLE = '</script><script><!--</SCRIPT';\nexport function double() {}\n")
    (web / "style.css").write_text("p::before { content: '</style><script>'; }\r\nb { c: d; }\r")
    text = page.export_page([], "vase").decode()
    assert len(re.findall(r"(?i)</?script", text)) == 8 and len(re.findall("(?i)</style", text)) == 1
    assert "<!--" not in text and "\r" not in text and r"'\x3c/script>\x3cscript>\x3c!--\x3c/SCRIPT'" in text


@pytest.mark.parametrize("line", [
    "import * as x from './a.js';", "import x from './a.js';", "import { a as b } from './a.js';", "import './a.js';",
    "import { a } from '../a.js';", "import { a } from 'a.js';", 'import { a } from "./a.js";', "import { a } from './a.js'",
    "import {", "export default 3;", "export { a };", "export let a = 3;", "export * from './a.js';",
    "const a = await import('./a.js');", "const a = import.meta.url;", "  export const a = 3;",
])  # fmt: skip
def test_a_module_of_another_form_is_refused(line):
    with pytest.raises(ValueError, match=r"main\.js"):
        page.bundled({"main.js": f"const b = 3;\n{line}\n", "a.js": ""}.__getitem__)


def test_modules_stand_once_and_behind_those_that_they_import():
    modules = {"main.js": "import { b } from './b.js';\nimport {a} from './a.js';\nmain;\n", "a.js": "export const a = 1;\n",
               "b.js": "import { a } from './a.js';\nexport function b() {}\n"}
    joined = page.bundled(modules.__getitem__)
    assert joined == """const module0 = (() => {
const a = 1;
return { a };
})();
const module1 = (() => {
const { a } = module0;
function b() {}
return { b };
})();
const module2 = (() => {
const { b } = module1;
const {a} = module0;
main;
return {  };
})();
"""
    modules["a.js"] = "import { b } from './b.js';\n"
    with pytest.raises(ValueError, match="imports itself"):
        page.bundled(modules.__getitem__)


def test_a_bundled_module_keeps_its_names_to_itself_and_loses_its_comments():
    text = "// A module.\n\n/**\n * Doubles.\n */\nexport async function* f(x) {\n  yield 2 * x; // twice\n}\nexport class C {}\n"
    joined = page.bundled({"main.js": text}.__getitem__)
    assert joined.split("\n")[1:-2] == ["async function* f(x) {", "yield 2 * x; // twice", "}", "class C {}", "return { f, C };"]


def test_every_module_of_the_page_is_in_its_script():
    joined = page.bundled()
    modules = [path for path in page.WEB.glob("*.js")]
    assert joined.count("= (() => {") == len(modules) > 30 and not re.search(r"^(?:import|export)\b", joined, re.M)


@pytest.mark.parametrize("name", ["engine", "supports", "glsl_voxels", "glsl_neural"])
def test_the_page_shares_modules_with_the_package(name):
    """`make web` copies them."""
    assert (page.WEB / f"{name}.js").read_bytes() == (REPOSITORY / f"js/src/{name}.js").read_bytes()


def test_the_real_page_names_no_address():
    text = page.export_page([b"abc"], "vase").decode()
    assert re.findall(r"https?:|\bwss?:|@import|url\(", text) == [] and len(text) < 400_000


@CHROMIUM
def test_an_exported_page_opens_from_disk_and_unpacks_what_it_holds(web, tmp_path):
    data = bytes(range(256)) * 40 + b"xyz"
    (tmp_path / "page.html").write_bytes(page.export_page([data], "vase"))
    with tempfile.TemporaryDirectory(prefix="t-", ignore_cleanup_errors=True) as profile:
        program = [headless.find_browser(), *headless.flags(), f"--user-data-dir={profile}", "--virtual-time-budget=9000"]
        program += ["--dump-dom", (tmp_path / "page.html").as_uri()]
        run = subprocess.run(program, capture_output=True, timeout=120, check=False)
    said = run.stderr.decode("utf-8", "replace")
    assert f"<title>1 {len(data)} {sum(data)} &lt;/script&gt;</title>" in run.stdout.decode() and "CONSOLE" not in said, said


# texf-view --export


def test_export_writes_a_page_with_what_it_was_given(call, made, web, tmp_path):
    out = tmp_path / "page.html"
    flags = ("--json", "--camera", "top", "--shaded")
    code, said, err = call("texf-view", made / "s.texf", made / "s.glb", "--export", out, *flags)
    facts = json.loads(said)
    assert (code, err, facts["files"]) == (0, "", ["page.html"])
    assert {a["name"]: a["bytes"] for a in facts["assets"]} == {path.name: path.stat().st_size for path in made.iterdir()}
    text = out.read_text()
    assert assets_in(text)[0] == (made / "s.texf").read_bytes() and assets_in(text)[1].startswith(b"TXVW")
    assert "<title>s.texf and s.glb</title>" in text
    begun = json.loads(re.search(r'id="about">(.*?)</script>', text)[1])["start"]
    assert begun == {"camera": {"direction": [0, 1, 0], "perspective": None}, "shaded": True, "mode": "split", "layer": None,
                     "effects": "scene"}
    assert {"load", "check", "pack", "export", "save", "total"} <= set(facts["seconds"]) and "address" not in facts


def test_page_on_stdout_is_clean_and_stdin_may_be_a_stream(made):
    program = [sys.executable, "-m", "texfcodec.cli.view", "-", "--export", "-", "--json"]
    data = (made / "s.texf").read_bytes()
    run = subprocess.run(program, cwd=REPOSITORY, capture_output=True, check=False, timeout=300, input=data)
    assert run.returncode == 0 and run.stdout.startswith(b"<!DOCTYPE html>") and json.loads(run.stderr)["files"] == []


def test_an_empty_asset_is_exported(call, web, tmp_path):
    code, said, _ = call("texf-view", EMPTY, "--export", tmp_path / "a.html", "--json")
    assert code == 0 and json.loads(said)["assets"][0]["bytes"] == EMPTY.stat().st_size
    assert assets_in((tmp_path / "a.html").read_text()) == [EMPTY.read_bytes()]


# texf-view --screenshot


@POSIX
def test_screenshot_is_what_the_page_answers_to_one_job(call, made, browser, tmp_path):
    browser("draws")
    out = tmp_path / "a.png"
    flags = ("--size", "64x48", "--camera", "90,0", "--perspective", "40", "--layer", "normals", "--effects", "all")
    code, said, err = call("texf-view", made / "s.texf", "--screenshot", out, *flags)
    assert (code, err) == (0, "") and said.startswith(f"{out}: {out.stat().st_size} bytes\n")
    data = out.read_bytes()
    job = json.loads(data.removeprefix(PNG))
    assert job.pop("camera") == {"direction": pytest.approx([1, 0, 0]), "perspective": 40.0}
    assert job == {"kind": "picture", "size": [64, 48], "anti_alias": 1, "shaded": None, "mode": "single", "layer": "normals",
                   "effects": "all", "background": [list(end) for end in GREY], "captions": True}


@POSIX
def test_a_camera_may_be_that_of_a_link_and_two_are_compared(call, made, browser, tmp_path):
    browser("draws")
    flags = ("--camera", " 30,-10.5,2,0,1e-3,0,0", "--mode", "difference", "--json")
    code, said, _ = call("texf-view", made / "s.texf", made / "s.glb", "--screenshot", tmp_path / "a.png", *flags)
    job = json.loads((tmp_path / "a.png").read_bytes().removeprefix(PNG))
    assert (code, job["camera"], job["mode"], job["size"]) == (0, {"link": "30,-10.5,2,0,0.001,0,0"}, "difference", [1024, 1024])
    assert "browser" in json.loads(said)["seconds"]


@POSIX
@pytest.mark.parametrize("what, code", [("size", "TXF-C11"), ("refuses", "TXF-C11"), ("ends", "TXF-C10")])
def test_a_page_that_gives_no_picture_is_a_coded_error_and_nothing_is_written(call, made, browser, tmp_path, what, code):
    browser(what)
    exit_code, said, err = call("texf-view", made / "s.texf", "--screenshot", tmp_path / "a.png", "--json")
    assert (exit_code, json.loads(said)["error"]["code"], err) == (5, code, "") and not (tmp_path / "a.png").exists()


def test_a_missing_browser_is_named_before_any_work(call, made, tmp_path, monkeypatch):
    monkeypatch.setenv("TEXF_BROWSER", "no-such-browser")
    code, out, err = call("texf-view", made / "not_there.texf", "--screenshot", tmp_path / "a.png")
    assert (code, out) == (5, "") and "TXF-C09" in err and "no-such-browser" in err and "chromium" in err and err.count("\n") == 1


# Refusals


@pytest.mark.parametrize("flag, suffix", [("--export", ".html"), ("--screenshot", ".png")])
def test_no_output_replaces_what_is_shown(call, made, browser, tmp_path, flag, suffix):
    browser("draws")
    for number, name in enumerate(("s.texf", "s.glb")):
        source = tmp_path / f"{name}{suffix}"
        source.write_bytes((made / name).read_bytes())
        inputs = [made / "s.texf", source] if number else [source]
        if not number:
            source = tmp_path / "hard.texf"
            source.write_bytes((made / name).read_bytes())
            os.link(source, tmp_path / f"hard{suffix}")
            inputs = [source]
        out = tmp_path / f"hard{suffix}" if not number else source
        before = out.read_bytes()
        code, said, _ = call("texf-view", *inputs, flag, out, "--json")
        assert (code, json.loads(said)["error"]["code"]) == (2, "TXF-O07") and out.read_bytes() == before


@pytest.mark.parametrize("arguments, word", [
    (("--export", "a.png"), "must end in .html"), (("--screenshot", "a.html"), "must end in .png"),
    (("--export", "-", "--screenshot", "-"), "both"), (("--mode", "split"), "requires OTHER"),
    (("--camera", "up"), "is not a view"),
    (("--camera", "1,2,3,4,5,6,x"), "is not a camera"), (("--camera", "1,2,3,4,5,6,inf"), "is not a camera"),
    (("--camera", "1,2,3"), "is not a view"), (("--camera", "0,0,2,0,0,0,0", "--perspective", "30"), "--perspective"),
    (("--size", "0"), "neither N nor WxH"), (("--size", "9000"), "neither N nor WxH"), (("--port", "70000"), "0..65535"),
    (("--mode", "heat"), "heat"), (("--effects", "none"), "none"), (("-", "-"), "only one input"),
    (("--perspective", "nan"), "nan"),
])  # fmt: skip
def test_a_wrong_command_line_is_one_sentence(call, made, arguments, word):
    arguments = arguments if arguments[0] == "-" else (made / "s.texf", *arguments)
    code, out, err = call("texf-view", *arguments)
    assert (code, out) == (1, "") and word in err and err.count("\n") == 1 and "--help" in err


@pytest.mark.parametrize("content, code", [(b"junk", "TXF-S01"), (b"", "TXF-S01"), (None, "TXF-I01")])
def test_what_cannot_be_read_is_a_coded_error(call, tmp_path, content, code):
    path = tmp_path / "a.texf"
    if content is not None:
        path.write_bytes(content)
    exit_code, out, _ = call("texf-view", path, "--no-browser", "--json")
    error = json.loads(out)["error"]
    assert error["code"] == code and exit_code == error["exit_code"] > 0


def test_limits_hold(call, made, web, tmp_path):
    code, out, _ = call("texf-view", made / "s.texf", "--export", tmp_path / "a.html", "--limit", "faces=3", "--json")
    assert (code, json.loads(out)["error"]["code"]) == (6, "TXF-L03") and not (tmp_path / "a.html").exists()


def test_a_port_that_is_taken_is_refused(call, made, web):
    with ViewServer([]) as other:
        code, out, _ = call("texf-view", made / "s.texf", "--port", other.port, "--no-browser", "--json")
    assert (code, json.loads(out)["error"]["code"]) == (2, "TXF-C08")


# Serving, and its end


def start(*arguments, **environment):
    """A texf-view of its own, in a group of its own, with SIGINT as a shell in the foreground gives it."""
    program = [sys.executable, "-m", "texfcodec.cli.view", *(str(a) for a in arguments)]
    return subprocess.Popen(program, cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            env={**os.environ, **environment}, start_new_session=True, text=True,
                            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))


@POSIX
@pytest.mark.parametrize("flags, said", [((), "press Ctrl-C to stop\nclosed\n"), (("--quiet",), ""), (("--json",), "")])
def test_the_page_is_served_until_ctrl_c_which_ends_with_0_and_leaves_nothing(made, tmp_path, flags, said):
    run = start(made / "s.texf", "--no-browser", *flags, TMPDIR=str(tmp_path))
    line = run.stdout.readline()
    address = json.loads(line)["address"] if "--json" in flags else line.strip()
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", address), line
    with urllib.request.urlopen(address + "about", timeout=60) as answer:
        about = json.loads(answer.read())
    assert (about["names"], about["drop"], about["start"]["mode"]) == (["s.texf"], True, "single")
    origin = "/".join(address.split("/")[:3])
    request = urllib.request.Request(address + "drop?name=a.ply", b"junk", {"Origin": origin})
    with pytest.raises(urllib.error.HTTPError) as raised:
        urllib.request.urlopen(request, timeout=120)
    with raised.value as answer:
        assert answer.code == 422 and json.loads(answer.read())["code"].startswith("TXF-I")
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=60)
    assert (run.returncode, out) == (0, "") and "".join(x for x in err.splitlines(True) if not x.startswith("progress: ")) == said
    assert list(tmp_path.iterdir()) == [] and not group_lives(run.pid)


@POSIX
def test_ctrl_c_while_the_browser_works_ends_it_and_leaves_nothing(made, tmp_path):
    scratch, pids = tmp_path / "scratch", set()
    scratch.mkdir()
    run = start(made / "s.texf", "--screenshot", tmp_path / "a.png", TMPDIR=str(scratch),
                TEXF_BROWSER=str(fake_browser(tmp_path, "sleeps")))
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and run.poll() is None and not list(scratch.glob("texf-view-*/said.txt")):
        time.sleep(0.05)
    time.sleep(0.5)
    if Path("/proc").is_dir():
        pids = {int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit() and is_below(int(p.name), str(tmp_path))}
        assert pids
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=60)
    told = [line for line in err.splitlines() if not line.startswith("progress: ")]
    assert (run.returncode, out, told) == (130, "", ["error TXF-C02: interrupted; nothing was written"])
    assert list(scratch.iterdir()) == [] and not (tmp_path / "a.png").exists()
    assert [pid for pid in pids if Path(f"/proc/{pid}").exists() and is_below(pid, str(tmp_path))] == []


def is_below(pid, folder):
    """Whether a process is the stand-in for a browser that stands in a folder."""
    try:
        return f"{folder}/browser_".encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def test_a_browser_with_a_window_is_opened_and_one_in_the_terminal_is_not(monkeypatch):
    import webbrowser

    opened = []

    class Window(webbrowser.BackgroundBrowser):
        def open(self, url, new=0, autoraise=True):
            opened.append(url)
            return True

    for browser, expected in ((Window("x"), True), (webbrowser.GenericBrowser("lynx"), False)):
        monkeypatch.setattr(webbrowser, "get", lambda browser=browser: browser)
        assert command._open("address") is expected
    assert opened == ["address"]

    def none():
        raise webbrowser.Error("no browser")

    monkeypatch.setattr(webbrowser, "get", none)
    assert command._open("address") is False
