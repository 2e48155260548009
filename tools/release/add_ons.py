"""The add-ons of integrations/ as zip files, whose bytes depend on the files alone.

    python -m tools.release.add_ons [OUT]           # texf-blender.zip and texf-comfyui.zip, of the working folder
"""

import sys
import zipfile
from pathlib import Path

from tools.release.clean_copy import REPOSITORY

INSIDE = {"blender": "", "comfyui": "texf/"}  # Blender takes an add-on's files at the top, ComfyUI a folder for custom_nodes
EARLIEST = (1980, 1, 1, 0, 0, 0)


def pack_add_ons(tree: Path, out: Path) -> list[Path]:
    """Write a zip of each add-on of a tree into out, and return their paths."""
    out.mkdir(parents=True, exist_ok=True)
    packed = []
    for name, inside in INSIDE.items():
        packed.append(out / f"texf-{name}.zip")
        with zipfile.ZipFile(packed[-1], "w") as archive:
            for file in sorted(path for path in (tree / "integrations" / name).iterdir() if path.is_file()):
                entry = zipfile.ZipInfo(inside + file.name, EARLIEST)
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(entry, file.read_bytes())
    return packed


if __name__ == "__main__":
    print("\n".join(map(str, pack_add_ons(REPOSITORY, Path(*sys.argv[1:] or ["out"])))))
