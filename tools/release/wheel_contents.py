"""What a wheel may hold: the package's files of the commit, all of them, and what describes it."""

from collections.abc import Iterable

DESCRIPTION = ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "top_level.txt", "licenses/LICENSE", "licenses/PATENTS.md")


def faults_of_contents(names: Iterable[str], tracked: Iterable[str]) -> list[str]:
    """A sentence for every file that is too many or missing.

    names: of the files in the wheel; tracked: paths of all files of the commit.
    """
    held = set(names)
    folder = next((name.split("/")[0] for name in held if name.split("/")[0].endswith(".dist-info")), "?.dist-info")
    wanted = {path for path in tracked if path.startswith("texfcodec/")} | {f"{folder}/{name}" for name in DESCRIPTION}
    return ([f"{name} does not belong into the wheel" for name in sorted(held - wanted)]
            + [f"{name} is missing from the wheel" for name in sorted(wanted - held)])
