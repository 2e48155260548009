"""What a run tells about itself: seconds by stage, peak memory, warnings and dropped properties."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Cancelled(KeyboardInterrupt):
    """The progress callback asked to stop."""


class Report:
    """What happened on the way, whatever came of it. on_progress: function (stage, done, total) called at every stage; False
    cancels. seconds: by stage; warnings, dropped: what will look different, in sentences; remarks: what changes no picture;
    trials: of a search, a dict each; channels: of a decoder, a dict for each attribute unit, {"field", "channels", "decode_ms"};
    child_peak_memory_bytes: of a
    decoder in a child process; note: what the stage at work has to say of itself, "" for nothing."""

    def __init__(self, on_progress: Callable[[str, int, int], object] | None = None) -> None:
        self.on_progress = on_progress
        self.seconds: dict[str, float] = {}
        self.warnings: list[str] = []
        self.dropped: list[str] = []
        self.remarks: list[str] = []
        self.trials: list[dict] = []
        self.channels: list[dict] = []
        self.note = ""
        self.child_peak_memory_bytes: int | None = None

    def take(self, other: "Report") -> None:
        """Adds what another report of the same run has: seconds, sentences, trials and channels."""
        self.take_seconds(other)
        for name in ("warnings", "dropped", "remarks", "trials", "channels"):
            getattr(self, name).extend(getattr(other, name))

    def take_seconds(self, other: "Report") -> None:
        """Adds the seconds of another report alone: of work whose result was not kept."""
        for name, value in other.seconds.items():
            self.seconds[name] = round(self.seconds.get(name, 0.0) + value, 6)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.progress(name, 0, 1)
        begin = time.perf_counter()
        yield
        self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - begin, 6)
        self.progress(name, 1, 1)

    def progress(self, stage: str, done: int, total: int) -> None:
        if self.on_progress and self.on_progress(stage, done, total) is False:
            raise Cancelled(f"cancelled in stage {stage}")


def peak_memory_bytes() -> int | None:
    """Largest resident set of this process so far, in bytes; None where the platform does not tell."""
    try:
        with open("/proc/self/status", "rb") as file:
            return peak_of_status(file.read())
    except (OSError, ValueError):
        pass
    try:
        import resource
        import sys
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def peak_of_status(status: bytes) -> int:
    """The same from the text of Linux's /proc/self/status; ValueError: it does not say. Linux's getrusage() will not do: what it
    tells a child includes the peak of the process that began it."""
    begin = status.index(b"VmHWM:") + 6
    return int(status[begin : status.index(b"kB", begin)]) * 1024
