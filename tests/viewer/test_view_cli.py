"""texf-view: the exported page stands alone and lets nothing out, and Ctrl-C leaves nothing."""

import base64
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.error
import urllib.request
import zlib
from pathlib import Path

import pytest
from interrupts import group_lives

from texfcodec import EncodeOptions, decode, encode
from texfcodec.cli import view as command
from texfcodec.demo.asset import make_sample
from texfcodec.io.load import load
from texfcodec.sandbox.wasm import MODULE
from texfcodec.viewer import page
from texfcodec.viewer.server import ViewServer

REPOSITORY = Path(__file__).resolve().parents[2]
EMPTY = REPOSITORY / "conformance" / "uncommon" / "empty" / "in.texf"
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="no Ctrl-C for another process")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a stream, s.texf, and a mesh, s.glb."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "s.texf").write_bytes(encode(make_sample(), EncodeOptions(resolution=32, qp=30)))
    decode((folder / "s.texf").read_bytes()).save(folder / "s.glb", appearance="vertex")
    return folder


def held_in(text):
    """What a page holds, by its name."""
    found = re.findall(r'<script type="application/octet-stream" id="([^"]*)">([^<]*)</script>', text)
    return {name: zlib.decompress(base64.b85decode(data.replace(",", "<"))) for name, data in found}


def assets_in(text):
    """The streams and GLB files that a page holds."""
    return [data for name, data in held_in(text).items() if name.startswith("asset-")]


def shown(*data):
    return [page.Shown(f"{number}.texf", len(one), one) for number, one in enumerate(data)]


def digest(data):
    return f"'sha256-{base64.b64encode(hashlib.sha256(data).digest()).decode()}'"


# The exported page


def test_a_page_holds_its_assets_style_and_scripts_and_asks_for_nothing():
    data = [bytes(range(256)) * 9, b"", b"abc", b"</script><!--" * 9]
    text = page.export_page(shown(*data), "two vases", {"mode": "split"}).decode()
    assert assets_in(text) == data and held_in(text)["decoder"] == MODULE.read_bytes()
    assert held_in(text)["viewer"] == (page.WEB / "viewer.js").read_bytes()
    assert "<title>two vases</title>" in text and "#view {" in text
    about = json.loads(re.search(r'id="about">(.*?)</script>', text)[1])
    assert [one["name"] for one in about["assets"]] == ["0.texf", "1.texf", "2.texf", "3.texf"]
    assert (about["drop"], about["start"]) == (False, {"mode": "split"})
    assert re.findall(r"\b(?:src|href)=\"?([^\" >]*)", text) == ["data:,"]


def test_policy_of_a_page_names_its_scripts_and_style_by_their_digests():
    text = page.export_page(shown(b"abc"), "vase").decode()
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    assert text.index("http-equiv") < text.index("<title>") and policy.startswith("default-src 'none'; ")
    (boot,), style = re.findall(r"<script>(.*?)</script>", text, re.S), re.search(r"<style>(.*?)</style>", text, re.S)[1]
    scripts = f"{digest(boot.encode())} {digest((page.WEB / 'viewer.js').read_bytes())}"
    assert f"script-src {scripts} 'wasm-unsafe-eval'; " in policy and f"style-src {digest(style.encode())};" in policy
    assert policy.replace("wasm-unsafe-eval", "").count("unsafe") == 0 and "worker-src blob:;" in policy
    assert "img-src blob: data:;" in policy and "connect-src blob: data:;" in policy


@pytest.mark.parametrize("title", ["<script>alert(1)</script>", '"><img src=x>', "</title><b>", "a & b", "\u202eevil", "<!--"])
def test_hostile_names_stay_text(title):
    text = page.export_page([page.Shown(title, 1, title.encode(), [title])], title, {"layer": title}).decode()
    head, _, rest = text.partition("</title>")
    title_there = head.partition("<title>")[2]
    assert not set(title_there) & set("<>\"'") and len(re.findall(r"<script\b", text)) == 5 and text.count("<!--") == 0
    about = json.loads(re.search(r'id="about">(.*?)</script>', rest)[1])
    assert about["start"] == {"layer": title} and about["assets"][0] == {"name": title, "bytes": 1, "warnings": [title]}


def test_a_script_or_style_cannot_end_its_element(tmp_path, monkeypatch):
    for name in ("index.html", "viewer.js"):
        shutil.copy(page.WEB / name, tmp_path / name)
    (tmp_path / "boot.js").write_text("const DOUBLE = '</script><script><!--</SCRIPT';\n")
    (tmp_path / "style.css").write_text("p::before { content: '</style><script>'; }\r\nb { c: d; }\r")
    monkeypatch.setattr(page, "WEB", tmp_path)
    text = page.export_page([], "vase").decode()
    assert len(re.findall(r"(?i)</?script", text)) == 8 and len(re.findall("(?i)</style", text)) == 1
    assert "<!--" not in text and "\r" not in text and r"'\x3c/script>\x3cscript>\x3c!--\x3c/SCRIPT'" in text


def test_the_page_is_small_and_names_no_address():
    text = page.export_page(shown(b"abc"), "vase").decode()
    assert re.findall(r"https?:|\bwss?:|@import|url\(", text) == [] and len(text) < 440_000


# texf-view --export


def test_export_writes_a_page_with_what_it_was_given(call, made, tmp_path):
    out = tmp_path / "page.html"
    flags = ("--json", "--camera", "top", "--shaded")
    code, said, err = call("texf-view", made / "s.texf", made / "s.glb", "--export", out, *flags)
    facts = json.loads(said)
    assert (code, err, facts["files"]) == (0, "", ["page.html"])
    assert {a["name"]: a["bytes"] for a in facts["assets"]} == {path.name: path.stat().st_size for path in made.iterdir()}
    text = out.read_text()
    assert assets_in(text) == [(made / "s.texf").read_bytes(), (made / "s.glb").read_bytes()]
    assert "<title>s.texf and s.glb</title>" in text
    begun = json.loads(re.search(r'id="about">(.*?)</script>', text)[1])["start"]
    assert begun == {"camera": {"direction": [0, 1, 0], "perspective": None}, "shaded": True, "mode": "split", "layer": None}
    assert {"load", "check", "pack", "export", "save", "total"} <= set(facts["seconds"]) and "address" not in facts


def test_page_on_stdout_is_clean_and_stdin_may_be_a_stream(made):
    program = [sys.executable, "-m", "texfcodec.cli.view", "-", "--export", "-", "--json"]
    data = (made / "s.texf").read_bytes()
    run = subprocess.run(program, cwd=REPOSITORY, capture_output=True, check=False, timeout=300, input=data)
    assert run.returncode == 0 and run.stdout.startswith(b"<!DOCTYPE html>") and json.loads(run.stderr)["files"] == []


def test_an_empty_asset_is_exported(call, tmp_path):
    code, said, _ = call("texf-view", EMPTY, "--export", tmp_path / "a.html", "--json")
    assert code == 0 and json.loads(said)["assets"][0]["bytes"] == EMPTY.stat().st_size
    assert assets_in((tmp_path / "a.html").read_text()) == [EMPTY.read_bytes()]


def test_a_camera_may_be_that_of_a_link_and_two_are_compared(call, made, tmp_path):
    flags = ("--camera", " 30,-10.5,2,0,1e-3,0,0", "--mode", "difference", "--json")
    code, _, _ = call("texf-view", made / "s.texf", made / "s.glb", "--export", tmp_path / "a.html", *flags)
    begun = json.loads(re.search(r'id="about">(.*?)</script>', (tmp_path / "a.html").read_text())[1])["start"]
    assert (code, begun["camera"], begun["mode"]) == (0, {"link": "30,-10.5,2,0,0.001,0,0"}, "difference")


def test_a_mesh_of_another_format_is_held_as_a_glb(call, tmp_path):
    (tmp_path / "a.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    code, _, _ = call("texf-view", tmp_path / "a.off", "--export", tmp_path / "a.html", "--json")
    (data,) = assets_in((tmp_path / "a.html").read_text())
    assert code == 0 and len(load(data).faces) == 1


# Refusals


def test_no_output_replaces_what_is_shown(call, made, tmp_path):
    for number, name in enumerate(("s.texf", "s.glb")):
        source = tmp_path / f"{name}.html"
        source.write_bytes((made / name).read_bytes())
        inputs = [made / "s.texf", source] if number else [source]
        if not number:
            source = tmp_path / "hard.texf"
            source.write_bytes((made / name).read_bytes())
            os.link(source, tmp_path / "hard.html")
            inputs = [source]
        out = tmp_path / "hard.html" if not number else source
        before = out.read_bytes()
        code, said, _ = call("texf-view", *inputs, "--export", out, "--json")
        assert (code, json.loads(said)["error"]["code"]) == (2, "TXF-O07") and out.read_bytes() == before


@pytest.mark.parametrize("arguments, word", [
    (("--export", "a.png"), "must end in .html"), (("--screenshot", "a.png"), "--screenshot"),
    (("--mode", "split"), "requires OTHER"),
    (("--camera", "up"), "is not a view"),
    (("--camera", "1,2,3,4,5,6,x"), "is not a camera"), (("--camera", "1,2,3,4,5,6,inf"), "is not a camera"),
    (("--camera", "1,2,3"), "is not a view"), (("--camera", "0,0,2,0,0,0,0", "--perspective", "30"), "--perspective"),
    (("--port", "70000"), "0..65535"), (("--mode", "heat"), "heat"), (("-", "-"), "only one input"),
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


def test_limits_hold(call, made, tmp_path):
    code, out, _ = call("texf-view", made / "s.texf", "--export", tmp_path / "a.html", "--limit", "faces=3", "--json")
    assert (code, json.loads(out)["error"]["code"]) == (6, "TXF-L03") and not (tmp_path / "a.html").exists()


def test_a_port_that_is_taken_is_refused(call, made):
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
    assert ([one["name"] for one in about["assets"]], about["drop"], about["start"]["mode"]) == (["s.texf"], True, "single")
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
