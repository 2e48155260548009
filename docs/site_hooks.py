"""What `make site` adds to docs/: pages that stand elsewhere in the repository, navigation, and the gallery.

Links of a page are those of the repository, so that they work there too: they are turned into links of the site here. What the
site does not have, a source file for instance, keeps its name and loses its link.
"""

import posixpath
import re
import shutil
import sys
from pathlib import Path

from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).resolve().parent))
import gallery  # noqa: E402

REPOSITORY = Path(__file__).resolve().parents[1]
PROJECT = ("bitstream_spec.md", "conformance/README.md", "js/README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md",
           "PATENTS.md")
GALLERY = REPOSITORY / "out" / "gallery"
sizes = {}  # of the gallery's sources and streams
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def on_pre_build(config):
    """Make the pages of the gallery, whose bytes gallery.md shows."""
    shutil.rmtree(GALLERY, ignore_errors=True)
    GALLERY.mkdir(parents=True)
    sizes.update(gallery.make(GALLERY))


def on_files(files, config):
    """The pages of PROJECT, under project/."""
    for name in PROJECT:
        files.append(File.generated(config, f"project/{name}", abs_src_path=str(REPOSITORY / name)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Links to files of the repository as links of the site."""
    own = page.file.src_uri
    if own == "gallery.md":
        markdown = gallery.with_cards(markdown, sizes)
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
    """Copy the exported viewer pages of gallery.md into the site."""
    out = Path(config["site_dir"]) / "gallery"
    out.mkdir(exist_ok=True)
    for entry in gallery.ENTRIES:
        shutil.copy(GALLERY / f"{entry.name}.html", out)
