"""Files of a catalogue's folder that are not assets, counted by suffix; files that meshes refer to are not counted."""

from __future__ import annotations

from pathlib import PurePath

from ..report import plural

COMPANIONS = frozenset({".mtl", ".bin", ".png", ".jpg", ".jpeg", ".webp", ".avif", ".ktx2", ".ktx", ".basis", ".dds", ".tga",
                        ".bmp", ".gif", ".tif", ".tiff", ".exr", ".hdr"})  # what a mesh file may name
SYSTEM_FOLDERS = frozenset({"__MACOSX", ".git", "@eaDir", "$RECYCLE.BIN", "System Volume Information"})
_SYSTEM_FILES = frozenset({".ds_store", "thumbs.db", "desktop.ini"})
_SYSTEM, _NO_SUFFIX = "files of the operating system", "files without suffix"


def is_system_file(name: str) -> bool:
    """Return whether the operating system wrote a file for itself, such as the resource fork ._chair.glb of macOS."""
    return name.startswith("._") or name.lower() in _SYSTEM_FILES


class PassedOver(dict[str, list[str]]):
    """Names of the files that a catalogue skips: a dict of lists by suffix in lower case, or by kind."""

    def add(self, name: str, is_system: bool = False) -> None:
        """Add a file that is not encoded; files that a mesh may refer to are ignored. name: its path in the catalogue;
        is_system: whether it is a folder of the operating system."""
        path = PurePath(name)
        if is_system or is_system_file(path.name):
            self.setdefault(_SYSTEM, []).append(name)
        elif path.suffix.lower() not in COMPANIONS:
            self.setdefault(path.suffix.lower() or _NO_SUFFIX, []).append(name)

    def counts(self) -> dict[str, int]:
        """Number of files of each kind, the most frequent first."""
        return {kind: len(self[kind]) for kind in sorted(self, key=lambda kind: (-len(self[kind]), kind))}

    def line(self) -> list[str]:
        """One sentence, or nothing."""
        counts = self.counts()
        singular = {_SYSTEM: "file of the operating system", _NO_SUFFIX: "file without suffix"}
        parts = [f"{plural(count, singular.get(kind, kind), kind)} ({'such as ' if count > 1 else ''}{self[kind][0]})"
                 for kind, count in counts.items()]
        return [f"{plural(sum(counts.values()), 'file is', 'files are')} skipped: {', '.join(parts)}"] if parts else []
