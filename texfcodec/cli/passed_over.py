"""Files of a catalogue's folder that are no assets: counted by suffix, but for those that meshes name."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import PurePath

from ..report import plural

COMPANIONS = frozenset({".mtl", ".bin", ".png", ".jpg", ".jpeg", ".webp", ".avif", ".ktx2", ".ktx", ".basis", ".dds", ".tga",
                        ".bmp", ".gif", ".tif", ".tiff", ".exr", ".hdr"})  # what a mesh file may name
_SYSTEM_FOLDERS = frozenset({"__MACOSX", ".git", "@eaDir", "$RECYCLE.BIN", "System Volume Information"})
_SYSTEM_FILES = frozenset({".ds_store", "thumbs.db", "desktop.ini"})
_SYSTEM, _NO_SUFFIX = "files of the operating system", "files without suffix"
_FORKS = "._"  # what macOS writes beside a file on other systems' disks


def is_system_folder(name: str) -> bool:
    """Returns whether a folder belongs to the operating system or an archiver, not to the user."""
    return name in _SYSTEM_FOLDERS


def is_system_file(name: str) -> bool:
    """Returns whether the operating system wrote a file for itself, such as the resource fork ._chair.glb."""
    return name.startswith(_FORKS) or name.lower() in _SYSTEM_FILES


@dataclass
class PassedOver:
    """counts: by suffix in lower case, or by kind; firsts: the first name of each."""

    counts: Counter[str] = field(default_factory=Counter)
    firsts: dict[str, str] = field(default_factory=dict)

    def add(self, name: str) -> None:
        """A file, by its path in the catalogue, that is not encoded."""
        path = PurePath(name)
        suffix = path.suffix.lower()
        if suffix not in COMPANIONS or is_system_file(path.name):
            self._count(_SYSTEM if is_system_file(path.name) else suffix or _NO_SUFFIX, name)

    def add_folder(self, name: str) -> None:
        """A folder of the operating system."""
        self._count(_SYSTEM, name + "/")

    def _count(self, kind, name):
        self.counts[kind] += 1
        self.firsts.setdefault(kind, name)

    def line(self) -> str:
        """One sentence, "" where there is nothing to say."""
        kinds = sorted(self.counts, key=lambda kind: (-self.counts[kind], kind))
        parts = [f"{self._counted(kind)} ({'such as ' if self.counts[kind] > 1 else ''}{self.firsts[kind]})" for kind in kinds]
        total = sum(self.counts.values())
        return f"{plural(total, 'file is', 'files are')} skipped: {', '.join(parts)}" if parts else ""

    def _counted(self, kind):
        return plural(self.counts[kind], kind if kind.startswith(".") else kind.replace("files", "file", 1), kind)
