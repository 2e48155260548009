"""docs/reports/time_to_picture.md: which file is on a page first, over which link, ours or Draco with AVIF or KTX2.

python tools/bench/time_to_picture.py --assets FOLDER --cache FOLDER [--page docs/reports/time_to_picture.md]

The files are made once and kept in the cache. time_to_picture.mjs measures them in Chromium in minutes, after npm install in js/.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # run as a command
    sys.path.insert(0, str(REPOSITORY))

import texfcodec  # noqa: E402
from texfcodec.io.formats import IMAGE_FORMATS, ImageFormat  # noqa: E402
from texfcodec.io.gltf.material import extensions_of, write_material  # noqa: E402
from texfcodec.io.gltf.packing import Column, Draco  # noqa: E402
from texfcodec.io.gltf.writer import Document, glb  # noqa: E402
from texfcodec.io.vertex_appearance import unique_corners  # noqa: E402
from texfcodec.scene.channels import BY_NAME  # noqa: E402
from tools.bench.ladders import ASSETS, Asset  # noqa: E402
from tools.bench.methods import glb as glb_files  # noqa: E402
from tools.bench.methods import image_codecs, parametrise, uv  # noqa: E402
from tools.bench.plots import load_pyplot, logarithmic  # noqa: E402
from tools.bench.provenance import made_on  # noqa: E402
from tools.bench.result_tables import markdown_table, wrapped  # noqa: E402

LINKS, LOADS, WORKERS = (1.6, 5, 10, 25, 100), 5, 2  # Mbit/s
RIVALS = {"avif6": ("Draco + AVIF", 6, "avif"), "etc1s": ("Draco + KTX2", 0, "ktx2")}  # name, effort of ladders.py, format
COLOURS = {"ours": "#c2410c", "avif6": "#1f4e9c", "etc1s": "#0891b2"}
USUAL = 82  # AVIF's quality above which its bytes double for half a dB
NOTE = (
    "Time to picture = bytes * 8 / link + decoding + upload and first whole frame. The last two are medians of {loads} loads "
    "from memory in one page, file after file, with {workers} workers that are up and decoders that are compiled: three.js "
    "r{three} (GLTFLoader, DRACOLoader, KTX2Loader; AVIF by the browser) and the package of js/, in Chromium {browser}, which "
    "draws without a graphics card: {graphics}. Nothing of a download is decoded before it is complete.",
    "Pictures are as equal as the points of `tools/bench/ladders.jsonl` allow, in dB of PSNR of Y in daylight (the scan: "
    "unlit): the rival at its largest quality, at most AVIF's 82, that our r03 is not worse than, or at its lowest, and our "
    "smallest rate that is not worse, or r03. Bytes of rivals are those of ladders.py, without a container; what is loaded is "
    "a GLB of Draco's mesh as texf-dec writes it, without TANGENTs, and the same images. KTX2 is ETC1S without smaller mip "
    "levels, which would be a third more bytes; browsers make none for it.",
    "**Below the crossover our picture is first**, above it the rival's: *cached*, with decoders in the browser's cache; "
    "*first visit*, with them on the link too (by brotli: ours {ours:.0f} kB, Draco + AVIF {avif6:.0f} kB, Draco + KTX2 "
    "{etc1s:.0f} kB).")


class Pair(NamedTuple):
    """Two rows of ladders.jsonl, ours and a rival's, that are compared."""

    asset: str
    tool: str
    ours: dict
    theirs: dict

    @property
    def files(self) -> tuple[str, str]:
        """Return the names of our file and the rival's."""
        return f"{self.asset}-{self.ours['point']}.texf", f"{self.asset}-{self.tool}-{self.theirs['point']}.glb"


def pairs_of(rows: list[dict]) -> list[Pair]:
    """Return the Pair of every asset and rival, at pictures as equal as rows of ladders.py allow; NOTE says how."""
    pairs = []
    for name in ASSETS:
        held = [row for row in rows if row["asset"] == name and row["threads"] == 1 and "psnr" in row]
        ours = sorted((row for row in held if (row["tool"], row["effort"]) == ("ours", "balanced")), key=lambda row: row["bytes"])
        for tool, (_, effort, _) in RIVALS.items():
            theirs = sorted((row for row in held if (row["tool"], row["effort"]) == (tool, effort)), key=lambda row: row["bytes"])
            usual = [row for row in theirs if tool != "avif6" or row["point"] <= USUAL]
            rival = next((row for row in reversed(usual) if row["psnr"] <= ours[-1]["psnr"]), theirs[0])
            pairs.append(Pair(name, tool, next((row for row in ours if row["psnr"] >= rival["psnr"]), ours[-1]), rival))
    return pairs


def rival_glb(textured, tool: str, effort: int, quality: float) -> bytes:
    """Return a GLB with Draco and images of a codec, of a ladders.Textured."""
    document, layout = Document({}), textured.layout
    scene = uv.scene_of(layout, textured.mesh, [np.zeros((1, 1, 4), np.uint8)] * len(textured.images))
    materials = [scene.materials[number] for number in np.unique(scene.face_material)]
    images = [dict(m.maps) | ({"base_colour": m.texture} if m.texture >= 0 else {}) for m in materials]
    colours = {layout["textures"][texture][0] for shown in images for name, texture in shown.items() if BY_NAME[name].srgb}
    coded = [image_codecs.enc_image(image, tool, quality, chroma, 1, effort) for image, chroma in textured.images]
    if tool == "etc1s":
        coded = [with_transfer(data, number in colours) for number, data in enumerate(coded)]
    add_textures(document, IMAGE_FORMATS[RIVALS[tool][2]], coded, layout["textures"])
    packing, low = Draco(layout["uv_bits"]), scene.positions.min(axis=0)
    box = SimpleNamespace(positions=scene.positions, origin=low, side=float((scene.positions.max(axis=0) - low).max()),
                          position_bits=parametrise.POSITION_BITS)
    positions, translation, scale = packing.positions(box, np.arange(len(scene.positions)))
    primitives, entries = [], [write_material(*both) for both in zip(materials, images, strict=True)]
    for place, number in enumerate(np.unique(scene.face_material)):
        columns, corners = columns_of(scene, positions, scene.face_material == number)
        primitives.append(packing.primitive(document, columns, corners) | {"material": place})
    document.json["materials"] = entries
    for name in extensions_of(entries):
        document.use_extension(name)
    document.add_mesh(primitives, translation, scale)
    return b"".join(glb(document))


def with_transfer(ktx2: bytes, is_colour: bool) -> bytes:
    """Return a KTX2 file whose data format descriptor says sRGB for colours, else linear; three.js decodes by it."""
    at = int.from_bytes(ktx2[48:52], "little") + 14
    return ktx2[:at] + bytes([2 if is_colour else 1]) + ktx2[at + 1 :]


def add_textures(document: Document, form: ImageFormat, coded: list[bytes], textures: list[tuple]) -> None:
    """Add images, and textures [(number of an image, wrap, name)] that show them."""
    for data in coded:
        document.add("images", {"mimeType": form.mime, "bufferView": document.add_view(data)})
    document.use_extension(form.extension, required=True)
    for number, wrap, _ in textures if coded else ():
        wraps = {"wrapS": glb_files.WRAPS[wrap[0]], "wrapT": glb_files.WRAPS[wrap[1]]}
        sampler = document.add("samplers", {"magFilter": 9729, "minFilter": 9987} | wraps)
        document.add("textures", {"sampler": sampler, "extensions": {form.extension: {"source": number}}})


def columns_of(scene, positions: np.ndarray, faces: np.ndarray) -> tuple[dict[str, Column], np.ndarray]:
    """Return ({attribute: Column of vertices}, vertex int64 [3 F] of each corner) of some faces, bool [F]."""
    given = {"POSITION": positions[scene.faces], "TEXCOORD_0": scene.corner_uv, "NORMAL": scene.corner_normal}
    flat = {name: values[faces].reshape(-1, values.shape[2]).astype(np.float32) + np.float32(0)
            for name, values in given.items() if values is not None}
    if scene.corner_color is not None:
        flat["COLOR_0"] = np.rint(255 * scene.corner_color[faces, :, :3]).astype(np.uint8).reshape(-1, 3)
    bits = (values.view(np.int32) if values.dtype == np.float32 else values for values in flat.values())
    first, corners = unique_corners(*(row for values in bits for row in values.T))
    return {name: Column(values[first], f"VEC{values.shape[1]}", name == "COLOR_0") for name, values in flat.items()}, corners


def make_files(pairs: list[Pair], assets: Path, cache: Path) -> None:
    """Write the files of pairs that the cache does not have."""
    cache.mkdir(parents=True, exist_ok=True)
    for name in ASSETS:
        absent = [pair for pair in pairs if pair.asset == name and not all((cache / file).exists() for file in pair.files)]
        if not absent:
            continue
        with tempfile.TemporaryDirectory() as folder:
            asset = Asset(name, assets / f"{name}.glb", Path(folder))
            for pair in absent:
                stream, rival = (cache / file for file in pair.files)
                if not stream.exists():
                    stream.write_bytes(texfcodec.encode(asset.scene, texfcodec.EncodeOptions(rate=pair.ours["point"])))
                if not rival.exists():
                    rival.write_bytes(rival_glb(asset.textured, pair.tool, pair.theirs["effort"], pair.theirs["point"]))


def measure(pairs: list[Pair], cache: Path) -> dict:
    """Return what time_to_picture.mjs prints, of the files of pairs."""
    link = cache / "js"
    if not link.exists() or link.resolve() != REPOSITORY / "js":
        link.unlink(missing_ok=True)
        link.symlink_to(REPOSITORY / "js")
    files = list(dict.fromkeys(file for pair in pairs for file in pair.files))
    job, pictures = cache / "job.json", cache / "pictures"
    pictures.mkdir(exist_ok=True)
    job.write_text(json.dumps({"root": str(cache.resolve()), "files": files, "loads": LOADS, "workers": WORKERS,
                               "pictures": str(pictures.resolve())}))
    call = ["node", str(REPOSITORY / "tools/bench/time_to_picture.mjs"), str(job.resolve())]
    run = subprocess.run(call, cwd=REPOSITORY / "js", capture_output=True, text=True, timeout=900)
    if run.returncode:
        raise SystemExit(run.stderr)
    return json.loads(run.stdout)


class Side(NamedTuple):
    """A file: bytes, seconds of decoding, and of upload and frame."""

    size: int
    decode: float
    upload: float

    def at(self, link: float) -> float:
        """Return the seconds to the first whole frame over a link of so many Mbit/s."""
        return self.size * 8e-6 / link + self.decode + self.upload


def crossover(ours: Side, theirs: Side, more: int = 0) -> float:
    """Return the link in Mbit/s below which ours is first; 0: at none, inf: at all. more: further bytes of ours."""
    bits, seconds = 8e-6 * (theirs.size - ours.size - more), ours.at(np.inf) - theirs.at(np.inf)
    return np.inf if seconds <= 0 < bits else 0.0 if bits <= 0 else bits / seconds


def in_words(link: float) -> str:
    """Return a crossover() as text of a table."""
    return "ours at all" if np.isinf(link) else "ours at none" if link <= 0 else f"{link:.1f}"


def page_of(pairs: list[Pair], sides: dict[str, Side], facts: dict, picture: str) -> str:
    """Return the page's text. sides: by name of a file; facts: of measure(); picture: name of the chart, "" for none."""
    def row(pair):
        ours, theirs = (sides[file] for file in pair.files)
        more = facts["decoders"]["ours"] - facts["decoders"][pair.tool]
        return [pair.asset, f"{pair.ours['psnr']:.1f} / {pair.theirs['psnr']:.1f}",
                f"{ours.size / 1e3:,.0f} / {theirs.size / 1e3:,.0f}", f"{ours.decode:.2f} / {theirs.decode:.2f}",
                f"{ours.upload:.2f} / {theirs.upload:.2f}", *(f"{ours.at(link):.1f} / {theirs.at(link):.1f}" for link in LINKS),
                f"**{in_words(crossover(ours, theirs))}**", in_words(crossover(ours, theirs, more))]

    head = ["asset", "dB", "kB", "decode, s", "upload, s", *(f"{link:g} Mbit/s" for link in LINKS), "crossover, cached",
            "first visit"]
    values = facts | {name: size / 1e3 for name, size in facts["decoders"].items()} | {"loads": LOADS, "workers": WORKERS}
    parts = ["# Time to picture", f"Made by `make -C tools picture` (tools/bench/time_to_picture.py) {made_on()}.",
             *(part.format(**values) for part in NOTE)]
    parts += [f"![Seconds to the first whole frame over the link, ours and its rivals]({picture})"] if picture else []
    for tool, (name, *_) in RIVALS.items():
        parts += [f"## Ours / {name}", "Seconds to the first whole frame by link; crossover in Mbit/s.",
                  "\n".join(markdown_table(head, [row(pair) for pair in pairs if pair.tool == tool]))]
    return "\n".join(wrapped("\n\n".join(parts).split("\n"))) + "\n"


def draw(pairs: list[Pair], sides: dict[str, Side], path: Path) -> bool:
    """Draw seconds over the link, a panel an asset; return whether matplotlib is there."""
    if (pyplot := load_pyplot()) is None:
        return False
    pyplot.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": path.stem})
    figure, panels = pyplot.subplots(2, 4, figsize=(13, 6), sharex=True)
    links = np.geomspace(1, 200, 40)
    for panel, name in zip(panels.flat, ASSETS, strict=True):
        for pair in (pair for pair in pairs if pair.asset == name):
            for tool, file in zip(("ours", pair.tool), pair.files, strict=True):
                dash = "--" if pair.tool == "etc1s" and tool == "ours" else "-"
                label = f"texfcodec, {pair.ours['point']}" if tool == "ours" else RIVALS[tool][0]
                panel.plot(links, [sides[file].at(link) for link in links], dash, color=COLOURS[tool], label=label)
        logarithmic(panel)
        logarithmic(panel, "y")
        panel.set_title(name, fontsize=9)
        panel.tick_params(labelsize=8)
        handles = dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True))
        panel.legend(handles.values(), handles.keys(), fontsize=7)
    figure.supxlabel("link, Mbit/s", fontsize=9)
    figure.supylabel("seconds to the first whole frame", fontsize=9)
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--page", type=Path, default=REPOSITORY / "docs/reports/time_to_picture.md")
    arguments = parser.parse_args()
    rows = [json.loads(line) for line in (REPOSITORY / "tools/bench/ladders.jsonl").read_text().splitlines()]
    pairs = pairs_of(rows)
    make_files(pairs, arguments.assets, arguments.cache)
    facts = measure(pairs, arguments.cache)
    sizes = {pair.files[1]: pair.theirs["bytes"] for pair in pairs}
    sizes |= {file: (arguments.cache / file).stat().st_size for file, _ in (pair.files for pair in pairs)}
    sides = {file: Side(sizes[file], *(median(times[part]) / 1e3 for part in ("decode", "upload")))
             for file, times in facts["files"].items()}
    picture = f"pictures/{arguments.page.stem}.svg"
    drawn = draw(pairs, sides, arguments.page.parent / picture)
    arguments.page.write_text(page_of(pairs, sides, facts, picture if drawn else ""))


if __name__ == "__main__":
    main()
