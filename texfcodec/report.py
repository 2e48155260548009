"""The report of a run: seconds by stage, peak memory, warnings and dropped properties."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Step = Callable[[int, int], object]  # (done, total)
SENTENCES = ("warnings", "dropped", "remarks")  # the lists of a report that are for people


def no_step(done: int, total: int) -> None:
    """A Step without an effect."""


def plural(count: int, singular: str, many: str) -> str:
    """Return a count and its noun: plural(1, "face is flat", "faces are flat") is "1 face is flat"."""
    return f"{count} {singular if count == 1 else many}"


class Cancelled(KeyboardInterrupt):
    """The progress callback returned False."""


class Report:
    """Record of a run, successful or not.

    Parameters
    ----------
    on_progress : function (stage, done, total), optional
        Called at the beginning and the end of every stage, and within those that may take more than two seconds; False cancels,
        which raises Cancelled.

    Attributes
    ----------
    seconds : dict
        By stage.
    warnings, dropped : list of str
        Visible differences, in sentences; names of properties that are not coded.
    remarks : list of str
        Sentences on things that change no picture.
    trials : list of dict
        Trial encodes of a search.
    channels : list of dict
        Of a decoder, {"field", "channels", "decode_ms"} for each attribute unit.
    child_peak_memory_bytes : int or None
        Of a decoder in a child process.
    note : str
        Text on the current stage, "" for none.

    Notes
    -----
    A stage is a block `with report.stage(name):`. A stage that may last more than two seconds reports its progress from a loop
    that it has anyway: `report.stage(name, (number, count))` for each of its parts, and within a part step(done, total), the
    function that stage() gives and that rooms without a Report take as an argument. Nothing is computed for the percentage alone.
    """

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

    def __repr__(self) -> str:
        longest = sorted(self.seconds, key=lambda name: -self.seconds[name])[:3]
        stages = ", ".join(f"{name} {self.seconds[name]:.2f}" for name in longest)
        more = ", ..." if len(self.seconds) > len(longest) else ""
        counts = ", ".join(f"{len(getattr(self, name))} {name}" for name in SENTENCES)
        return f"<Report: {sum(self.seconds.values()):.2f} s" + (f" ({stages}{more})" if stages else "") + f", {counts}>"

    def take(self, other: "Report") -> None:
        """Add the seconds, sentences, trials and channels of another report of the same run to this one's."""
        self.take_seconds(other)
        self.take_sentences(other)

    def take_sentences(self, other: "Report") -> None:
        """Add what another report says, but not its seconds."""
        for name in ("warnings", "dropped", "remarks", "trials", "channels"):
            getattr(self, name).extend(getattr(other, name))

    def take_seconds(self, other: "Report") -> None:
        """Adds the seconds of another report, and nothing else, for work whose result was not kept."""
        for name, value in other.seconds.items():
            self.seconds[name] = round(self.seconds.get(name, 0.0) + value, 6)

    @contextmanager
    def stage(self, name: str, part: tuple[int, int] = (0, 1)) -> Iterator[Step]:
        """Context manager around a stage of the run, which adds its seconds to those of the same name.

        part: (number, count) of a stage in parts, such as fields. Gives step(done, total), which reports the progress of this
        part.
        """
        number, parts = part
        self.progress(name, number, parts)
        begin = time.perf_counter()
        yield lambda done, total: self.progress(name, number * total + done, parts * total)
        self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - begin, 6)
        self.progress(name, number + 1, parts)

    def progress(self, stage: str, done: int, total: int) -> None:
        """Reports the progress of a stage to the callback. Raises Cancelled if the callback returns False."""
        if self.on_progress and self.on_progress(stage, done, total) is False:
            raise Cancelled(f"cancelled in stage {stage}")


def peak_memory_bytes() -> int | None:
    """Largest resident set of this process so far, in bytes; None if the platform does not report it."""
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
    """Return the peak memory of a process in bytes, from the text of its /proc/.../status on Linux. Raises ValueError if it is
    not there.

    Linux's getrusage() is no substitute: for a child it includes the peak of the process that started it.
    """
    begin = status.index(b"VmHWM:") + 6
    return int(status[begin : status.index(b"kB", begin)]) * 1024
