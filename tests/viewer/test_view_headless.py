"""What is dropped on the page of texf-view, from whoever it came, and the browser without a window that it is drawn by."""

import base64
import json
import os
import re
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest
from stand_ins import fake_browser, post, real_browser, use_page, write_page

from texfcodec import EncodeOptions, LimitError, decode, encode
from texfcodec.demo.asset import make_sample
from texfcodec.errors import InputError, StreamError, SupportError
from texfcodec.io.formats import SUFFIXES
from texfcodec.limits import Limits
from texfcodec.viewer import headless
from texfcodec.viewer.container import parse
from texfcodec.viewer.dropped import container_of_dropped
from texfcodec.viewer.server import ViewServer

CONTAINERS = [b"first container", b"second"]
JOBS = [{"kind": "picture"}, {"kind": "other"}]
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="the stand-in for a browser is a script that names its Python")
CHROMIUM = pytest.mark.skipif(real_browser() is None, reason="there is no Chromium on the PATH")


@pytest.fixture
def web(tmp_path, monkeypatch):
    """A small page in place of the real one."""
    (tmp_path / "web").mkdir()
    use_page(monkeypatch, write_page(tmp_path / "web"))


# Files that are dropped


@pytest.fixture(scope="module")
def stream():
    return encode(make_sample(), EncodeOptions(resolution=32, qp=30))


@pytest.fixture(scope="module")
def glb(stream, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    decode(stream).save(path, appearance="vertex")
    return path.read_bytes()


def glb_of(document):
    """A GLB without a binary chunk."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + np.array([2, 20 + len(text), len(text), 0x4E4F534A], "<u4").tobytes() + text


def with_image(uri):
    """A GLB with one triangle whose texture is at a URI."""
    buffer = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.array([[0, 0], [1, 0], [0, 1]], "<f4").tobytes()
    accessor = {"componentType": 5126, "count": 3}
    return glb_of({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "images": [{"uri": uri}],
        "textures": [{"source": 0}], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "buffers": [{"byteLength": 60, "uri": "data:;base64," + base64.b64encode(buffer).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24}],
        "accessors": [{**accessor, "bufferView": 0, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                      {**accessor, "bufferView": 1, "type": "VEC2"}],
    })  # fmt: skip


def test_meshes_are_taken_and_broken_ones_leave_the_server_at_work(web, stream, glb):
    with ViewServer([], drop=container_of_dropped) as view:
        bare = glb_of({"asset": {"version": "2.0"}})
        for data, code in ((b"", "TXF-I04"), (b"garbage" * 99, "TXF-I05"), (stream, "TXF-I05"),
                           (glb[: len(glb) // 2], "TXF-I07"), (b"glTF" + bytes(99), "TXF-I33"), (bare, "TXF-I15")):
            status, _, body = post(view, "drop?name=a", data)
            assert (status, json.loads(body)["code"]) == (422, code), code
        status, _, body = post(view, "drop?name=vase", glb)
        assert status == 200 and len(body) > 1000 and b"vase" in body


def test_a_dropped_mesh_reaches_no_file_of_this_machine(tmp_path, monkeypatch):
    from PIL import Image

    Image.new("RGB", (4, 4), (1, 2, 3)).save(tmp_path / "private.png")
    monkeypatch.chdir(tmp_path)
    data = container_of_dropped(with_image("private.png"), "a.glb")
    assert b"private.png" in data  # the warning that it is missing
    with pytest.raises(InputError) as raised:
        container_of_dropped(with_image(str(tmp_path / "private.png")), "a.glb")
    assert raised.value.code == "TXF-I16" and str(tmp_path) not in str(raised.value)


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
DROPPED = {"a.STL": STL, "a.off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"}


@pytest.mark.parametrize("name", DROPPED)
def test_a_mesh_of_any_format_can_be_dropped(name):
    header = parse(container_of_dropped(DROPPED[name].encode(), name))[0]
    assert (header["faces"], header["name"], header["plain"], header["warnings"]) == (1, name, True, [])


def test_a_format_is_taken_by_its_suffix_and_another_is_told_those_that_are_read():
    for suffix in SUFFIXES[-2:]:
        with pytest.raises(InputError) as raised:
            container_of_dropped(b"no such thing", f"a{suffix}")
        assert raised.value.code != "TXF-I05", suffix
    with pytest.raises(InputError, match=r"\.fbx is not a supported format; choose \.texf .*\.stl"):
        container_of_dropped(b"Kaydara FBX Binary", "a.fbx")


def test_what_a_dropped_file_names_is_said_to_be_missing_and_what_to_do(tmp_path, monkeypatch):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\n")
    monkeypatch.chdir(tmp_path)
    named = f"mtllib {{}}\nusemtl m\n{TRIANGLE}"
    for name in ("a.obj", str(tmp_path / "a.obj")):
        header = parse(container_of_dropped(named.format("a.mtl").encode(), name))[0]
        assert "'a.mtl' is missing" in header["warnings"][0] and "open it with texf-view instead" in header["warnings"][-1]
    with pytest.raises(InputError) as raised:
        container_of_dropped(named.format(tmp_path / "a.mtl").encode(), "a.obj")
    assert raised.value.code == "TXF-I16"
    document = {"asset": {"version": "2.0"}, "buffers": [{"uri": "a.bin", "byteLength": 36}], "nodes": [{"mesh": 0}],
                "bufferViews": [{"buffer": 0, "byteLength": 36}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]}
    with pytest.raises(InputError, match=r"a\.bin' is missing.*open it with texf-view instead"):
        container_of_dropped(json.dumps(document).encode(), "a.gltf")


def test_what_is_dropped_is_read_under_the_limits(glb):
    if not sys.platform.startswith("linux"):
        pytest.skip("memory is capped by Linux's limits")
    with pytest.raises(LimitError) as raised:
        container_of_dropped(glb, "a", Limits(isolate_bytes=1 << 12))
    assert raised.value.code == "TXF-L07"


def test_a_reader_of_meshes_that_crashes_is_an_error_of_the_file(glb, monkeypatch):
    from texfcodec.viewer import dropped as room

    monkeypatch.setattr(room, "run_child", lambda *_: subprocess.CompletedProcess([], -11, b"", b""))
    with pytest.raises(StreamError) as raised:
        container_of_dropped(glb, "a.glb")
    assert raised.value.code == "TXF-S40" and raised.value.details["status"] == -11


# A browser without a window


@pytest.fixture
def browser(web, tmp_path, monkeypatch):
    """browser(what): the stand-in for a browser is the one in use; temporaries go into tmp_path / "scratch"."""
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))

    def use(what):
        monkeypatch.setenv("TEXF_BROWSER", str(fake_browser(tmp_path, what)))
        return tmp_path / "scratch"

    return use


@POSIX
def test_jobs_are_answered_in_their_order(browser):
    scratch = browser("size")
    assert headless.run_jobs(CONTAINERS, JOBS) == [b"0 15", b"1 15"] and list(scratch.iterdir()) == []
    assert headless.run_jobs(CONTAINERS, []) == []


@POSIX
@pytest.mark.parametrize("what, code, word", [
    ("ends", "TXF-C10", "ended"), ("sleeps", "TXF-C10", "too long"), ("breaks", "TXF-C11", "no such thing"),
    ("refuses", "TXF-C11", "no layer of this name"),
])  # fmt: skip
def test_a_browser_that_gives_no_answer_is_ended_with_all_its_children(browser, monkeypatch, what, code, word):
    scratch, pids = browser(what), []
    start = headless.Browser.__init__
    monkeypatch.setattr(headless.Browser, "__init__", lambda self, *a: (start(self, *a), pids.append(self.pid))[0])
    begin = time.monotonic()
    with pytest.raises(SupportError) as raised:
        headless.run_jobs(CONTAINERS, JOBS, seconds=1.5 if what == "sleeps" else 60)
    assert raised.value.code == code and word in str(raised.value) and "http" not in str(raised.value)
    assert list(scratch.iterdir()) == [] and time.monotonic() - begin < 30
    with pytest.raises(ProcessLookupError):
        os.killpg(pids[0], 0)


def test_a_missing_browser_is_named_and_looked_for_by_name(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    for named in (None, "no-such-browser"):
        monkeypatch.delenv("TEXF_BROWSER", raising=False)
        if named:
            monkeypatch.setenv("TEXF_BROWSER", named)
        with pytest.raises(SupportError) as raised:
            headless.run_jobs([], JOBS)
        assert raised.value.code == "TXF-C09" and "TEXF_BROWSER" in raised.value.message
        assert raised.value.details.get("value") == named
    monkeypatch.delenv("TEXF_BROWSER")
    if sys.platform != "win32":
        for name in ("google-chrome", "chromium"):
            (tmp_path / name).write_text("#!/bin/sh\n")
            (tmp_path / name).chmod(0o755)
            assert headless.find_browser() == str(tmp_path / name)


@CHROMIUM
def test_a_real_browser_runs_the_page_under_its_policy_with_webgl2(web, monkeypatch):
    with tempfile.TemporaryDirectory(prefix="t-") as scratch:  # with a short name, for Chromium's socket
        monkeypatch.setattr(tempfile, "tempdir", scratch)
        (answer,) = headless.run_jobs(CONTAINERS, [{"kind": "any"}])
        assert os.listdir(scratch) == []
    facts = json.loads(answer)
    assert facts["size"] == 30 and re.match(r"WebGL 2\.0", facts["version"])
