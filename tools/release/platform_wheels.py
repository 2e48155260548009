"""Wheels of single platforms: the wheel of any platform, and the native library in it, built by zig for another system.

Only that of this machine can be tried here. The others are UNTESTED: they are built and listed, nothing more.
"""

import base64
import csv
import hashlib
import io
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import NamedTuple

from tools.release.clean_copy import REPOSITORY, run


class Platform(NamedTuple):
    """target: zig's name; tag: that of wheels; library: name of the file, as texfcodec/sandbox/native.py looks for it."""

    target: str
    tag: str
    library: str


PLATFORMS = (
    Platform("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64", "libtexf.so"),
    Platform("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64", "libtexf.so"),
    Platform("aarch64-macos.13.0", "macosx_13_0_arm64", "libtexf.dylib"),
    Platform("x86_64-macos.13.0", "macosx_13_0_x86_64", "libtexf.dylib"),
    Platform("x86_64-windows-gnu", "win_amd64", "texf.dll"),
)
PLACE = "texfcodec/sandbox/"


def install_zig(folder: Path) -> Path:
    """A new environment with zig of the version that native/Makefile names; returns its interpreter."""
    version = re.search(r"^ZIG_VERSION \?= (\S+)$", (REPOSITORY / "native/Makefile").read_text(encoding="utf-8"), re.M)
    run(sys.executable, "-m", "venv", folder)
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"ziglang=={version and version.group(1)}")
    return python


def build_library(copy: Path, platform: Platform, python: Path) -> bytes:
    """The native library of a copy of the tree. python: an interpreter with zig. SystemExit where it fails."""
    built = copy / "native" / platform.target / platform.library
    built.parent.mkdir()
    done = subprocess.run(["make", "-s", "-C", copy / "native", "platform", f"TARGET={platform.target}", f"PYTHON={python}",
                           f"LIBRARY={built}"], stdout=sys.stderr, check=False)
    if done.returncode:
        raise SystemExit(f"the native library for {platform.target} is not built: make ended with {done.returncode}")
    return built.read_bytes()


def platform_wheel(wheel: Path, platform: Platform, library: bytes, folder: Path) -> Path:
    """The wheel of any platform with the library in it and the platform's tag, in a folder; the same bytes for the same input."""
    out = folder / wheel.name.replace("-none-any.whl", f"-none-{platform.tag}.whl")
    with zipfile.ZipFile(wheel) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        entries = {entry.filename: entry for entry in old.infolist()}
        record = next(name for name in entries if name.endswith(".dist-info/RECORD"))
        held = {name: old.read(name) for name in entries if name != record} | {PLACE + platform.library: library}
        about = record.replace("RECORD", "WHEEL")
        held[about] = held[about].replace(b"Root-Is-Purelib: true", b"Root-Is-Purelib: false").replace(
            b"Tag: py3-none-any", f"Tag: py3-none-{platform.tag}".encode())
        held[record] = _record_of(held, record)
        model = entries[record]
        for name, content in held.items():
            entry = zipfile.ZipInfo(name, model.date_time)
            entry.external_attr, entry.compress_type = entries.get(name, model).external_attr, zipfile.ZIP_DEFLATED
            new.writestr(entry, content)
    return out


def _record_of(held, record):
    """The list of all files with hashes and sizes, as wheels hold it."""
    out = io.StringIO(newline="")
    rows = csv.writer(out, lineterminator="\n")
    for name, content in held.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        rows.writerow([name, f"sha256={digest}", len(content)])
    rows.writerow([record, "", ""])
    return out.getvalue().encode()
