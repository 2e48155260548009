"""The viewer's page in headless Chromium, driven through the DevTools protocol over a pipe: real keys, pointers and files."""

import base64
import fcntl
import io
import json
import os
import select
import signal
import subprocess
import sys
import time

import numpy as np
from browser import BROWSER, FLAGS
from PIL import Image

READ, WRITE = 3, 4  # where Chromium reads and writes messages, each ended by a zero
BUTTONS = {"none": 0, "left": 1, "right": 2}
SHIFT = 8
CODES = {" ": "Space", "+": "Equal", "-": "Minus"}
NUMBERS = {"Escape": 27}  # of keys that the browser itself understands


def _pipe():
    """The ends of a pipe, neither of them where Chromium looks for its own."""
    ends = os.pipe()
    moved = tuple(fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, WRITE + 1) for end in ends)
    for end in ends:
        os.close(end)
    return moved


class Page:
    """A page of the viewer. Errors that it does not catch, and what its console calls an error, stand in .errors."""

    def __init__(self, folder, size=(640, 400), flags=()):
        self.errors, self._answers, self._rest, self._number = [], {}, b"", 0
        (theirs, self._write), (self._read, to_us) = _pipe(), _pipe()
        rootly = ["--no-sandbox"] if os.geteuid() == 0 else []
        command = [BROWSER, *FLAGS, *rootly, *flags, "--remote-debugging-pipe", "--force-device-scale-factor=1",
                   f"--window-size={size[0]},{size[1]}", f"--user-data-dir={folder}", "about:blank"]
        moved = f"import os, sys; os.dup2({theirs}, {READ}); os.dup2({to_us}, {WRITE}); os.execv(sys.argv[1], sys.argv[1:])"
        with open(folder.parent / f"{folder.name}.log", "wb") as log:
            self._process = subprocess.Popen([sys.executable, "-c", moved, *command], pass_fds=(theirs, to_us), stdout=log,
                                             stderr=log, start_new_session=True)
        os.close(theirs)
        os.close(to_us)
        self.session = None
        targets = self.call("Target.getTargets")["targetInfos"]
        target = next(one["targetId"] for one in targets if one["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for end in (self._read, self._write):
            os.close(end)

    def call(self, method, seconds=60, **parameters):
        """The result of a method of the protocol."""
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + seconds
        while number not in self._answers:
            self._take(method, end)
        answer = self._answers.pop(number)
        assert "error" not in answer, (method, answer["error"])
        return answer["result"]

    def _take(self, what, end):
        """Takes in what the browser has said by now."""
        assert select.select([self._read], [], [], max(0, end - time.monotonic()))[0], f"{what}: the browser says nothing"
        data = os.read(self._read, 1 << 20)
        assert data, f"{what}: the browser has ended"
        *messages, self._rest = (self._rest + data).split(b"\0")
        for message in map(json.loads, messages):
            if "id" in message:
                self._answers[message["id"]] = message
            else:
                self._listen(message["method"], message["params"])

    def _listen(self, method, told):
        if method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(told["entry"]["text"])
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.errors.append(str(told["args"]))

    def open(self, address, seconds=60):
        """Goes to an address and waits until the viewer's picture stands in full."""
        self.call("Page.navigate", url=address)
        canvas = "#view:not([aria-busy])"
        ready = f"document.querySelector('{canvas}')?.viewer || document.querySelector('{canvas} ~ #message:not([hidden])')"
        self.until(f"location.href !== 'about:blank' && Boolean({ready})", seconds)
        self.settle()

    def settle(self):
        """Waits until nothing is left to be drawn."""
        self.run("document.getElementById('view').viewer?.settled()")

    def run(self, expression, seconds=60):
        """The value of an expression of JavaScript, or of its promise; `viewer` is the page's Viewer."""
        code = f"(async (viewer) => ({expression}))(document.getElementById('view')?.viewer)"
        answer = self.call("Runtime.evaluate", seconds, expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"].get("exception", answer["exceptionDetails"])
        return answer["result"].get("value")

    def until(self, expression, seconds=30):
        """Waits until an expression holds, and gives its value."""
        end = time.monotonic() + seconds
        while not (value := self.run(expression)):
            assert time.monotonic() < end, f"{expression} does not come to hold; {self.errors}"
            time.sleep(0.05)
        return value

    def press(self, key, shift=False):
        """Presses and releases a key, and waits for the picture."""
        code = CODES.get(key, key if len(key) > 1 else f"Key{key.upper()}")
        text = {"text": key} if len(key) == 1 else {}
        told = {"key": key, "code": code, "modifiers": SHIFT * shift, "windowsVirtualKeyCode": NUMBERS.get(key, 0)}
        self.call("Input.dispatchKeyEvent", type="keyDown", **told, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **told)
        self.settle()

    def mouse(self, kind, x, y, button="none", **more):
        """Sends one event of the mouse."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=BUTTONS[button], **more)

    def drag(self, start, end, button="left", shift=False):
        """Drags from one point to another, and waits for the picture."""
        more = {"modifiers": SHIFT * shift}
        self.mouse("mouseMoved", *start, **more)
        self.mouse("mousePressed", *start, button, clickCount=1, **more)
        self.mouse("mouseMoved", *((a + b) / 2 for a, b in zip(start, end, strict=True)), button, **more)
        self.mouse("mouseMoved", *end, button, **more)
        self.mouse("mouseReleased", *end, button, clickCount=1, **more)
        self.settle()

    def touch(self, *steps):
        """Lays fingers on the page, moves and lifts them: each step is a list of points."""
        for number, points in enumerate([*steps, []]):
            kind = "touchEnd" if not points else "touchMove" if number else "touchStart"
            told = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(points)]
            self.call("Input.dispatchTouchEvent", type=kind, touchPoints=told)
        self.settle()

    def drop(self, path, x, y, shift=False):
        """Drags a file of this machine onto a point of the page and lets it go."""
        data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            self.call("Input.dispatchDragEvent", type=kind, x=x, y=y, data=data, modifiers=SHIFT * shift)

    def message(self):
        """The sentence that stands on the page, "" without one."""
        return self.run("document.querySelector('#message:not([hidden]) span')?.textContent ?? ''")

    def pixels(self):
        """What is on the canvas, over white: uint8 [H, W, 3]."""
        text = self.run("(viewer.draw(1), viewer.canvas.toDataURL())")
        drawn = Image.open(io.BytesIO(base64.b64decode(text.partition(",")[2]))).convert("RGBA")
        return np.asarray(Image.alpha_composite(Image.new("RGBA", drawn.size, "white"), drawn).convert("RGB"))

    def screenshot(self):
        """What is in the window, PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
