"""What `make site` adds to docs/: pages that stand elsewhere in the repository, navigation, and the gallery.

Links of a page are those of the repository, so that they work there too: they are turned into links of the site here. What the
site does not have, a source file for instance, keeps its name and loses its link.
"""

import os
import posixpath
import re
import subprocess
import sys
from pathlib import Path

from mkdocs.structure.files import File

REPOSITORY = Path(__file__).resolve().parents[1]
PROJECT = ("bitstream_spec.md", "conformance/README.md", "js/README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md",
           "PATENTS.md")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
VASE, SCAN, COLOURS = "vase", "scan with image", "scan with vertex colours"  # the demo asset, and meshes of face_meshes.py
GALLERY = {"texels": (VASE, ["--rate", "r04"]), "voxels": (VASE, ["--resolution", "512", "--qp", "24"]),
           "small": (VASE, ["--rate", "r01"]), "scan": (SCAN, ["--rate", "r03"]), "colours": (COLOURS, ["--rate", "r03"])}
FACES = 20_000  # of the generated meshes


def on_files(files, config):
    """The pages of PROJECT, under project/."""
    for name in PROJECT:
        files.append(File.generated(config, f"project/{name}", abs_src_path=str(REPOSITORY / name)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Links to files of the repository as links of the site."""
    own = page.file.src_uri
    place = own.removeprefix("project/") if own.startswith("project/") else f"docs/{own}"

    def mended(match):
        picture, text, target = match.groups()
        path, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target) or not path:
            return match.group(0)
        there = posixpath.normpath(posixpath.join(posixpath.dirname(place), path))
        there = "docs/index.md" if there == "README.md" else there
        there = there.removeprefix("docs/") if there.startswith("docs/") else f"project/{there}"
        if files.get_file_from_path(there) is None:
            return text if not picture else match.group(0)
        way = posixpath.relpath(there, posixpath.dirname(own) or ".")
        return f"{picture}[{text}]({way}{'#' + anchor if anchor else ''})"

    return LINK.sub(mended, markdown)


def on_post_build(config):
    """The exported viewer pages of gallery.md."""
    folder = Path(config["site_dir"]) / "gallery"
    folder.mkdir(exist_ok=True)
    for name, (mesh, options) in GALLERY.items():
        source, stream = folder / f"{mesh.replace(' ', '_')}.glb", folder / f"{name}.texf"
        if not source.exists():
            _make(mesh, source)
        _run("texfcodec.cli.enc", source, stream, *options)
        _run("texfcodec.cli.view", stream, source, "--export", folder / f"{name}.html")


def _make(mesh, path):
    if mesh == VASE:
        _run("texfcodec.demo.asset", path)
        return
    sys.path.insert(0, str(REPOSITORY / "tests"))
    from load.meshes import GENERATORS, glb_of

    path.write_bytes(glb_of(GENERATORS[mesh](FACES)))


def _run(module, *arguments):
    command = [sys.executable, "-m", module, *map(str, arguments)]
    subprocess.run(command, check=True, cwd=REPOSITORY, env={**os.environ, "PYTHONWARNINGS": "ignore"}, stdout=subprocess.DEVNULL)
