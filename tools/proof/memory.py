"""Resident memory of this process, where its system tells: Linux does."""

from pathlib import Path

from texfcodec.report import peak_memory_bytes

RECORD = Path("/proc/self/clear_refs")


def resident(field):
    """Return a value of /proc/self/status in bytes. field: VmRSS, the resident memory now, or VmHWM, its peak."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines[field].split()[0]) * 1024


def forget_peak():
    """Sets the record of the highest resident memory back to what is held now. OSError: the system does not let us."""
    RECORD.write_text("5")


class Memory:
    """Measurement of this process's resident memory in bytes from here on; the system's record of the peak is reset first."""

    def __init__(self):
        try:
            forget_peak()
        except OSError:  # another system, or one that forbids it: the peak then holds the warm-up too
            pass
        self.idle = _status_bytes("VmRSS")

    def result(self):
        """{"peak", "idle"}: the highest since, and what the process held before; None where the system does not tell."""
        return {"peak": peak_memory_bytes(), "idle": self.idle}


def _status_bytes(field):
    try:
        return resident(field)
    except (OSError, KeyError):
        return None
