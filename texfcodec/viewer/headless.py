"""The page in a browser without a window: jobs go in, what the page answers comes back.

The browser draws in software, so that a picture does not hang on a machine's graphics card or its driver.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from ..core import cleanup
from ..errors import SupportError
from ..limits import Limits
from .server import JSON, Answer, ViewServer

BROWSER = "TEXF_BROWSER"  # names a browser, in place of those of NAMES that stand on the PATH
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge")
FLAGS = (
    "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    "--force-color-profile=srgb", "--force-device-scale-factor=1", "--disable-dev-shm-usage", "--no-first-run",
    "--no-default-browser-check", "--disable-background-networking", "--disable-component-update", "--disable-default-apps",
    "--disable-domain-reliability", "--disable-extensions", "--disable-sync", "--disable-breakpad", "--disable-crash-reporter",
    "--disable-background-timer-throttling", "--disable-renderer-backgrounding", "--metrics-recording-only", "--mute-audio",
    "--no-proxy-server", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--enable-logging=stderr",
)  # fmt: skip
SAID = "said.txt"  # in the browser's folder: its stderr
MOST_SAID, LONGEST_REASON = 1 << 20, 300
PLACES = ["HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_RUNTIME_DIR"]  # where programs write
LONGEST_FOLDER = 56  # of characters; Chromium puts a socket into TMPDIR, whose whole path may have about 100
END_SECONDS = 5.0  # for all processes of a browser to end once they are killed
_GLANCE = 0.2  # seconds after which it is looked whether the browser still lives


def find_browser() -> str | None:
    """Path of a browser that runs without a window: the one that TEXF_BROWSER names, else the first of NAMES on the PATH."""
    named = os.environ.get(BROWSER)
    found = (shutil.which(name) for name in ((named,) if named else NAMES))
    return next((path for path in found if path), None)


def needed_browser() -> str:
    """As find_browser(), or SupportError TXF-C09."""
    browser = find_browser()
    if browser is None:
        raise SupportError("TXF-C09", f"no browser was found; install Chromium, or set {BROWSER} to a Chromium-based browser",
                           allowed=" ".join(NAMES),
                           value=os.environ.get(BROWSER))
    return browser


def flags() -> list[str]:
    """What a browser without a window is started with. Root, under whom containers run, cannot set up Chromium's sandbox."""
    rootly = hasattr(os, "geteuid") and os.geteuid() == 0
    return [*FLAGS, *["--no-sandbox"] * rootly]


def run_jobs(assets: Sequence[bytes], jobs: Sequence[dict], seconds: float = 120, *, names: Sequence[str] = (),
             limits: Limits | None = None) -> list[bytes]:
    """What the page answers to each of the jobs, for streams or containers of viewer.pack.pack(). names: theirs; limits: of
    streams.

    seconds: for all of them together, the browser's start included. Raises SupportError TXF-C09 where there is no browser,
    TXF-C10 where it ends or takes longer, TXF-C11 where the page cannot do a job.
    """
    browser = needed_browser()
    if not jobs:
        return []
    with ViewServer(assets, jobs, names=names, limits=limits) as server, cleanup.Folder("texf-view-") as folder:
        child = cleanup.hold(lambda: Browser(browser, server.address, Path(folder)))
        try:
            return _all_answers(server, child, time.monotonic() + seconds)
        finally:
            child.kill()
            cleanup.drop(child)


def _all_answers(server, child, end):
    """The answers, as they come in; the first that tells of an error ends the wait."""
    while True:
        is_over, lives = time.monotonic() > end, child.lives()  # asked first: the last answer may come while it ends
        answers = server.answers(_GLANCE)
        for number, answer in sorted(answers.items()):
            _check(answer, server.jobs[number])
        if len(answers) == len(server.jobs):
            return [answers[number][1] for number in range(len(answers))]
        if complaint := child.complaint():
            raise SupportError("TXF-C11", "the page in the browser cannot do this", reason=complaint)
        if is_over or not lives:
            what = "the browser took too long" if lives else "the browser ended before the page finished"
            raise SupportError("TXF-C10", what, reason=child.last_words() or None)


def _check(answer: Answer, job: dict) -> None:
    """Raises SupportError TXF-C11 where an answer is {"error": a sentence, or {"message": ...}}."""
    kind, data = answer
    if kind != JSON:
        return
    try:
        facts = json.loads(data)
    except ValueError:
        facts = {"error": "the result is not JSON"}
    error = facts.get("error") if isinstance(facts, dict) else None
    if error is not None:
        sentence = error.get("message", error) if isinstance(error, dict) else error
        raise SupportError("TXF-C11", f"the page in the browser cannot do this: {str(sentence)[:500]}", value=job.get("kind"))


class Browser:
    """A browser without a window at an address, its processes in a group of their own, its profile and all else that it writes
    in a folder."""

    def __init__(self, path: str, address: str, folder: Path) -> None:
        names = [*PLACES, "TMPDIR"] if len(str(folder)) <= LONGEST_FOLDER else PLACES
        places = {name: str(folder) for name in names}
        self.said = folder / SAID
        command = [path, *flags(), f"--user-data-dir={folder / 'profile'}", address]
        with open(self.said, "wb") as said:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said,
                                             env={**os.environ, **places}, start_new_session=True)
        self.pid = self._process.pid

    def lives(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Ends it with all of its processes, and waits a little until they are gone: they write into the folder."""
        if not hasattr(os, "killpg"):
            self._process.kill()
            self._process.wait()
            return
        end = time.monotonic() + END_SECONDS
        try:
            while time.monotonic() < end:
                os.killpg(self.pid, signal.SIGKILL)
                self._process.poll()  # not wait(), whose lock an interrupted thread may hold
                time.sleep(0.01)
        except (ProcessLookupError, PermissionError):  # none is left
            pass

    def complaint(self) -> str:
        """An error that the page did not see coming, "" where there is none."""
        told = [line for line in self._lines() if "CONSOLE" in line and "Uncaught" in line]
        return _without_place(told[0]) if told else ""

    def last_words(self) -> str:
        """The last that the page has complained of, or, of a browser that has ended, the last that it said itself."""
        lines = self._lines()
        told = [line for line in lines if "CONSOLE" in line] or ([] if self.lives() else lines)
        return _without_place(told[-1]) if told else ""

    def _lines(self):
        with open(self.said, "rb") as said:
            return said.read(MOST_SAID).decode("utf-8", "replace").splitlines()


def _without_place(line):
    """What a line of a browser's log says, without where in the browser that was and from which address the page came."""
    said = line.partition("] ")[2] or line
    return said.partition(", source: ")[0][:LONGEST_REASON]
