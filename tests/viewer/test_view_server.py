"""The server of texf-view: it answers its own page and refuses everybody else."""

import json
import socket
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from stand_ins import ask, post, talk

from texfcodec.errors import InputError, StreamError
from texfcodec.limits import Limits
from texfcodec.render.environment import DAYLIGHT
from texfcodec.viewer import server
from texfcodec.viewer.server import HEADERS, Shown, ViewServer

DATA = [b"first asset", bytes(range(256)) * 1000]
ASSETS = [Shown("one", 3, DATA[0], ["a map is lost"]), Shown("two", 4, DATA[1])]
LIMITS = {"fileBytes": Limits().file_bytes, "vertices": Limits().vertices, "faces": Limits().faces, "voxels": Limits().voxels,
          "texels": Limits().texels, "samples": Limits().samples, "latents": Limits().latents,
          "metadataBytes": Limits().metadata_bytes}


def dropped(data, name):
    """A drop of its own: gives the bytes back, turned round."""
    if data == b"broken":
        raise StreamError("TXF-S01", "the stream does not start with the TexF signature", clause="5.1")
    if data == b"bug":
        raise KeyError("surprise")
    if data == b"large":
        raise MemoryError
    return name.encode() + b":" + data[::-1]


@pytest.fixture
def view():
    with ViewServer(ASSETS, dropped, start={"mode": "split"}, version="1.2", limits=Limits(file_bytes=1 << 20)) as view:
        yield view


# What is served


def test_the_page_and_its_modules_are_served_under_a_strict_policy(view):
    for place, kind, word in (("", "text/html", b"<canvas"), ("web/viewer.js", "text/javascript", b"three.js"),
                              ("web/style.css", "text/css", b"#view {")):
        status, headers, body = ask(view, place)
        assert (status, headers["Content-Type"]) == (200, f"{kind}; charset=utf-8") and word in body
        assert headers.items() >= HEADERS.items() and int(headers["Content-Length"]) == len(body)
    for name, word in (("Content-Security-Policy", "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; "),
                       ("X-Content-Type-Options", "nosniff"), ("Referrer-Policy", "no-referrer"), ("Cache-Control", "no-store"),
                       ("Cross-Origin-Resource-Policy", "same-origin")):
        assert HEADERS[name].startswith(word)
    assert HEADERS["Content-Security-Policy"].count("unsafe") == 1


def test_every_file_of_the_page_is_served_by_its_kind():
    with ViewServer([]) as view:
        names = [path.name for path in Path(server.WEB).iterdir() if path.is_file()]
        assert "index.html" in names and set(view.pages) == {*names, "texf_simd.wasm"}
        status, headers, body = ask(view, "web/texf_simd.wasm")
        assert (status, headers["Content-Type"], body[:4]) == (200, "application/wasm", b"\0asm")


def test_assets_come_as_they_are(view):
    for number, data in enumerate(DATA):
        status, headers, body = ask(view, f"asset/{number}")
        assert (status, headers["Content-Type"], body) == (200, "application/octet-stream", data)


def test_page_is_told_what_there_is_and_in_which_light(view):
    about = json.loads(ask(view, "about")[2])
    assert about.pop("limits") == {"fileBytes": 1 << 20, **{name: LIMITS[name] for name in LIMITS if name != "fileBytes"}}
    light = about.pop("light")
    height = 0.3
    sky = sum(np.array(power) * height**n for n, power in enumerate(light["powers"]))
    assert sky == pytest.approx(DAYLIGHT.radiance(np.array([[0.0], [height], [0.95]]))[:, 0], rel=1e-4)
    assert [one["irradiance"] for one in light["lights"]] == [pytest.approx(one.irradiance.tolist()) for one in DAYLIGHT.lights]
    assets = [{"name": "one", "bytes": 3, "warnings": ["a map is lost"]}, {"name": "two", "bytes": 4, "warnings": []}]
    assert about == {"assets": assets, "version": "1.2", "drop": True, "start": {"mode": "split"}}
    with ViewServer([]) as idle:
        assert json.loads(ask(idle, "about")[2])["drop"] is False


def test_it_is_called_localhost_as_well(view):
    name = f"localhost:{view.port}"
    assert ask(view, "about", Host=name)[0] == 200
    assert post(view, "drop?name=a", b"abc", Host=name, Origin=f"http://{name}")[0] == 200


def test_tokens_and_ports_are_new_for_every_server():
    with ViewServer([Shown("a", 1, b"a")]) as one, ViewServer([Shown("b", 1, b"b")]) as two:
        assert one.token != two.token and one.port != two.port and len(one.token) >= 32
        assert (ask(one, "asset/0")[2], ask(two, "asset/0")[2]) == (b"a", b"b")
        assert ask(one, f"/{two.token}/asset/0", whole=True)[0] == 404


# Who is refused


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "localhost", "127.0.0.1:1",
                                  "127.0.0.1.evil:{port}", "[::1]:{port}", "", ["127.0.0.1:{port}", "evil.example:{port}"],
                                  ["127.0.0.1:{port}"] * 2])
def test_server_refuses_another_host(view, host):
    names = [name.format(port=view.port) for name in (host if isinstance(host, list) else [host])]
    for place in ("", "about", "asset/0"):
        status, headers, body = ask(view, place, Host=names)
        assert status == 421 and b"first asset" not in body and headers.items() >= HEADERS.items()
    assert post(view, "drop?name=a", b"abc", Host=names, Origin=f"http://{names[0]}")[0] == 421


def test_server_refuses_a_request_that_names_no_host(view):
    assert ask(view, "about", leave=("Host",))[0] == 421
    said = talk(view, f"GET /{view.token}/asset/0\r\n\r\n".encode())  # as before HTTP/1.0
    assert b" 421 " in said and b"first asset" not in said


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "", "http://127.0.0.1", "http://127.0.0.1:1",
                                    "https://127.0.0.1:{port}", "http://localhost:{port}", "http://127.0.0.1:{port}.evil", "http://127.0.0.1:{port}/"])
def test_server_refuses_another_origin(view, origin):
    origin = origin.format(port=view.port)
    assert post(view, "drop?name=a", b"abc", Origin=origin)[0] == 403
    assert ask(view, "asset/0", Origin=origin)[0] == 403


def test_server_refuses_a_post_that_names_no_origin_or_two(view):
    own = f"http://127.0.0.1:{view.port}"
    assert post(view, "drop?name=a", b"abc", leave=("Origin",))[0] == 403
    assert post(view, "drop?name=a", b"abc", Origin=[own, "http://evil.example"])[0] == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_server_refuses_what_the_browser_calls_foreign_but_for_a_link_to_the_page(view, site):
    for mode in ("no-cors", "cors", "websocket"):
        assert ask(view, "asset/0", Sec_Fetch_Site=site, Sec_Fetch_Mode=mode)[0] == 403
    assert ask(view, "", Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate")[0] == 200
    assert post(view, "drop?name=a", b"abc", Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate")[0] == 403
    assert ask(view, "asset/0", Sec_Fetch_Site="same-origin", Sec_Fetch_Mode="cors")[0] == 200


@pytest.mark.parametrize("path", ["/", "", "/about", "//about", "/{token}", "/{token}x/about", "/{half}/about",
                                  "/{swapped}/about", "/x/{token}/about", "/\xff\xfe/about", "*", "http://evil.example/", "http://evil.example/{token}/about",
                                  "{token}/about"])
def test_server_refuses_who_does_not_know_the_token(view, path):
    words = {"token": view.token, "half": view.token[:16], "swapped": view.token.swapcase()}
    status, _, body = ask(view, path.format(**words), whole=True)
    assert status in (400, 404) and view.token.encode() not in body


@pytest.mark.parametrize("place", [
    "..", "../", "../about", "web/..", "web/../about", "web/../server.py", "web/%2e%2e/server.py", "%2e%2e/server.py",
    "web/..%2fserver.py", "web/..\\server.py", "web/%252e%252e/server.py", "web//boot.js", "web/./boot.js", "/web/boot.js", "web",
    "web/", "web/index.html", "index.html", "web/boot.js%00", "web/boot.js?x", "web/boot.js/", "web/boot%2ejs", "web/main.js",
    "about/", "about?x=1", "ABOUT", "asset", "asset/", "asset/2", "asset/-1", "asset/0/", "asset/0x0", "asset/\xb2",
    "asset/99999999999999999999", "asset/0%00", "result/0", "drop", "drop?name=a", "favicon.ico", "job", "light", "app/main.js",
    "web/" + "a" * 5000,
])  # fmt: skip
def test_server_refuses_every_other_path(view, place):
    status, _, body = ask(view, place)
    assert status == 404 and len(body) < 100


@pytest.mark.parametrize("method", ["HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "CONNECT", "get", "G" * 300])
def test_server_refuses_every_other_method(view, method):
    status, headers, body = ask(view, "about", method)
    assert status in (400, 501) and headers.items() >= HEADERS.items() and b"limits" not in body


@pytest.mark.parametrize("place", ["", "about", "asset/0", "web/viewer.js", "result/0", "drop", "drop/?name=a"])
def test_server_takes_posts_at_one_place_only(view, place):
    assert post(view, place, b"{}")[0] == 404


def test_server_refuses_a_post_without_length(view):
    for more in ({"leave": ("Content-Length",)}, {"Transfer_Encoding": "chunked"},
                 {"Transfer_Encoding": "chunked", "leave": ("Content-Length",)},
                 *({"Content_Length": text} for text in ("-1", "+3", "3.0", "9" * 30)),
                 {"Content_Length": ["3", "3"]}):
        assert post(view, "drop?name=a", b"abc", **more)[0] == 411, more


def test_server_refuses_what_is_too_large_before_it_comes_and_says_so_after(view):
    begin = time.monotonic()
    status, _, body = post(view, "drop?name=a", b"abc", Content_Length=str((1 << 20) + 1))
    assert status == 413 and b"1048576" in body and time.monotonic() - begin < 10
    assert post(view, "drop?name=a", bytes(3 << 20))[0] == 413
    assert post(view, "drop?name=a", bytes(1 << 20))[0] == 200


def test_limit_of_a_request_is_that_of_a_stream():
    with ViewServer([], dropped) as view:
        assert post(view, "drop?name=a", b"abc", Content_Length=str(Limits().file_bytes + 1))[0] == 413


def test_a_body_that_ends_early_is_refused(view):
    head = f"POST /{view.token}/drop?name=a HTTP/1.1\r\nHost: 127.0.0.1:{view.port}\r\nOrigin: http://127.0.0.1:{view.port}\r\n"
    with socket.create_connection(("127.0.0.1", view.port), timeout=20) as line:
        line.sendall(f"{head}Content-Length: 9\r\n\r\nabc".encode())
        line.shutdown(socket.SHUT_WR)
        assert b" 400 " in line.recv(1 << 16)


@pytest.mark.parametrize("data", [b"\r\n", b"GET\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00", b"GET / HTTP/9.9\r\n\r\n",
                                  b"GET " + b"/" * 70000, b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 200 + b"\r\n",
                                  b"GET / HTTP/1.1\r\nA: " + b"b" * 70000 + b"\r\n\r\n"])
def test_a_head_that_is_none_costs_nothing(view, data):
    with socket.create_connection(("127.0.0.1", view.port), timeout=20) as line:
        line.sendall(data)
        line.shutdown(socket.SHUT_WR)
        said = line.recv(1 << 16)
    assert b" 200 " not in said and ask(view, "about")[0] == 200


def test_a_slow_client_is_left_and_holds_up_nobody(monkeypatch):
    monkeypatch.setattr(server, "VISIT_SECONDS", 0.5)
    with ViewServer(ASSETS) as view, socket.create_connection(("127.0.0.1", view.port), timeout=20) as slow:
        begin = time.monotonic()
        with pytest.raises(OSError):
            for byte in f"GET /{view.token}/about HTTP/1.1\r\nX: {'y' * 400}".encode():
                slow.sendall(bytes([byte]))
                time.sleep(0.05)
                if byte == ord("G"):
                    assert ask(view, "about")[0] == 200
        assert time.monotonic() - begin < 10


def test_connections_at_a_time_are_counted(monkeypatch):
    monkeypatch.setattr(server, "MOST_VISITS", 2)
    with ViewServer(ASSETS) as view:
        place = ("127.0.0.1", view.port)
        with socket.create_connection(place) as one, socket.create_connection(place) as two:
            one.sendall(b"G")
            two.sendall(b"G")
            time.sleep(0.3)
            assert talk(view, b"") == b""
        deadline, status = time.monotonic() + 10, None
        while status is None and time.monotonic() < deadline:
            try:
                status = ask(view, "about")[0]
            except IndexError:  # turned away without an answer: the two are still counted
                time.sleep(0.05)
        assert status == 200


def test_many_are_served_at_once(view):
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda i: ask(view, f"asset/{i % 2}")[2], range(40)))
    assert answers == DATA * 20


def test_server_listens_on_the_loopback_interface_only(view):
    assert view._http.socket.getsockname()[0] == "127.0.0.1" and view.address == f"http://127.0.0.1:{view.port}/{view.token}/"
    others = {"127.0.0.2"} if sys.platform.startswith("linux") else set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: it asks which interface leads outwards
            others.add(probe.getsockname()[0])
        except OSError:
            pass
    for other in others - {"127.0.0.1", "0.0.0.0"}:
        with pytest.raises(OSError):
            socket.create_connection((other, view.port), timeout=2).close()


def test_nothing_answers_once_the_server_is_left():
    with ViewServer([]) as view:
        assert ask(view, "about")[0] == 200
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", view.port), timeout=2).close()


def test_a_port_that_is_taken_is_a_coded_error(view):
    with pytest.raises(InputError) as raised:
        ViewServer([], port=view.port)
    assert raised.value.code == "TXF-C08" and raised.value.details["port"] == view.port


# Files that are dropped


def test_a_dropped_file_becomes_a_mesh_and_an_error_is_data(view):
    assert post(view, "drop?name=a%20b.texf", b"abc")[::2] == (200, b"a b.texf:cba")
    status, headers, body = post(view, "drop?name=a", b"broken")
    assert (status, headers["Content-Type"]) == (422, "application/json")
    told = json.loads(body)
    assert told == {"code": "TXF-S01", "message": "the stream does not start with the TexF signature", "clause": "5.1"}
    status, _, body = post(view, "drop?name=a", b"bug")
    assert status == 500 and json.loads(body)["code"] == "TXF-C04" and b"surprise" not in body
    status, _, body = post(view, "drop?name=a", b"large")
    assert status == 422 and json.loads(body)["code"] == "TXF-L09" and ask(view, "about")[0] == 200


def test_a_name_of_a_dropped_file_is_one_short_line(view):
    assert post(view, "drop?name=%00%1b[2Ja%0d%0ab", b"c")[2] == b"[2Jab:c"
    assert len(post(view, "drop?name=" + "a" * 5000, b"c")[2]) == 257
    for place in ("drop?", "drop?nam=a", "drop?name=a&name=b"):
        assert post(view, place, b"c")[0] == 400
    assert post(view, "drop?name=", b"c")[::2] == (200, b":c")
