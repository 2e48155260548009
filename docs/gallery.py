"""The gallery: meshes, streams, pages by texf-view --export, pictures by texf-render, and the cards of gallery.md.

python docs/gallery.py     writes the cards and the pictures into docs/, after a change of the encoder
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from PIL import Image

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
PICTURES = DOCS / "pictures" / "gallery"
FACES, COLUMNS = 20_000, 2  # of the generated scan; cards in a row
BLOCK = re.compile(r"(<!-- cards -->\n).*(<!-- end -->)", re.S)


class Entry(NamedTuple):
    """A page. source: its mesh file; options: of texf-enc; view: of texf-render; title, text: of its card."""

    name: str
    source: str
    options: tuple
    view: tuple
    title: str
    text: str


ENTRIES = (
    Entry("scan", "scan.glb", ("--rate", "r03"), ("40,20",), "A scan", "generated: 19,200 faces and an image"),
    Entry("prop", "barrel.glb", ("--rate", "r03"), ("20,22",), "A game prop", "base colour, normals, roughness and metal"),
    Entry("scene", "windmill.glb", ("--rate", "r03"), ("30,12", "--time", "0.35"), "A scene with an animation",
          "stays a GLB with its nodes; the key M turns the sails"),
    Entry("generated", "generated.npz", ("--rate", "r03", "--effort", "fast"), ("30,25",), "A generated mesh",
          "voxels with colour and roughness, no UVs and no image"),
    Entry("texels", "vase.glb", ("--rate", "r04"), ("30,25",), "The demo asset at r04",
          "images over texels, vertex colours over voxels"),
    Entry("voxels", "vase.glb", ("--resolution", "512", "--qp", "24"), ("200,15",), "The demo asset over voxels",
          "K 512, QP 24: no UVs in the stream"),
)


def make(folder):
    """Write sources, streams and pages of all ENTRIES into a folder; return {name: (source's bytes, stream's bytes)}."""
    sizes = {}
    for entry in ENTRIES:
        source = folder / entry.source
        stream = folder / f"{entry.name}{'.glb' if entry.name == 'scene' else '.texf'}"
        if not source.exists():
            _write_source(source)
        _run("enc", source, stream, *entry.options)
        beside = [] if source.suffix == ".npz" else [source]
        _run("view", stream, *beside, "--export", folder / f"{entry.name}.html", "--camera", entry.view[0])
        sizes[entry.name] = source.stat().st_size, stream.stat().st_size
    return sizes


def with_cards(markdown, sizes):
    """Return gallery.md with the cards of these sizes."""
    cells = []
    for entry in ENTRIES:
        link, (before, after) = f'<a href="gallery/{entry.name}.html">', (size / 1000 for size in sizes[entry.name])
        picture = f'<img src="pictures/gallery/{entry.name}.jpg" width="480" alt="{entry.title}">'
        cells.append(f'<td width="50%">{link}{picture}</a><br>{link}<b>{entry.title}</b></a><br>{entry.text}<br>'
                     f"{before:,.0f} kB, coded <b>{after:,.0f} kB</b></td>")
    rows = ["<tr>\n" + "\n".join(cells[at:at + COLUMNS]) + "\n</tr>\n" for at in range(0, len(cells), COLUMNS)]
    return BLOCK.sub(lambda match: f'{match[1]}<table class="cards">\n{"".join(rows)}</table>\n{match[2]}', markdown)


def _write_source(path):
    if path.stem == "vase":
        _run("demo", path)
        return
    sys.path[:0] = [str(DOCS), str(REPOSITORY / "tests")]
    import gallery_assets

    from load.meshes import GENERATORS, glb_of

    if path.stem == "scan":
        path.write_bytes(glb_of(GENERATORS["scan with image"](FACES)))
    else:
        {"barrel": gallery_assets.write_barrel, "windmill": gallery_assets.write_windmill,
         "generated": gallery_assets.write_voxels}[path.stem](path)


def _run(tool, *arguments):
    module = "texfcodec.demo.asset" if tool == "demo" else f"texfcodec.cli.{tool}"
    command = [sys.executable, "-m", module, *map(str, arguments)]
    subprocess.run(command, check=True, cwd=REPOSITORY, env={**os.environ, "PYTHONWARNINGS": "ignore"}, stdout=subprocess.DEVNULL)


def main():
    """Write the cards and the pictures into docs/."""
    with tempfile.TemporaryDirectory() as name:
        folder, page = Path(name), DOCS / "gallery.md"
        page.write_text(with_cards(page.read_text(encoding="utf-8"), make(folder)), encoding="utf-8")
        PICTURES.mkdir(parents=True, exist_ok=True)
        for entry in ENTRIES:
            shown = folder / ("scene.glb" if entry.name == "scene" else f"{entry.name}.texf")
            _run("render", shown, folder / "a.png", "--view", *entry.view, "--size", "480x360", "--anti-alias", "3", "--shaded",
                 "--background", "236,238,241")
            Image.open(folder / "a.png").convert("RGB").save(PICTURES / f"{entry.name}.jpg", quality=80, optimize=True)


if __name__ == "__main__":
    main()
