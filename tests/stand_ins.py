"""Requests to the server of texf-view that say what they like."""

import io
import socket


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
