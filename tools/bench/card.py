"""Measure bytes that stay on the graphics card, and a frame's time, in three.js, beside PNG and KTX2: docs/reports/card.md.

python tools/bench/card.py --assets FOLDER [--out out/card] [--page docs/reports/card.md] [ASSET ...]

Needs Chromium ($CHROMIUM), node and js/node_modules, and alktx2 for KTX2. Streams and KTX2 files that OUT lacks are made there;
OUT/ASSET.3dntc.texf is measured if it is there (texf-enc --codec 3dntc takes minutes).
"""

import argparse
import io
import json
import math
import os
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # run as a command
    sys.path.insert(0, str(REPOSITORY))

import texfcodec  # noqa: E402
from tools.bench.provenance import made_on  # noqa: E402
from tools.bench.result_tables import markdown_table, wrapped  # noqa: E402

ASSETS = {"waterbottle_pbr": "water bottle", "damaged_helmet": "damaged helmet", "cat_webp": "cat", "vintage_fan": "vintage fan",
          "bball_0001": "basketball player", "avocado": "avocado", "clearcoat_blend": "clear coat test",
          "snapper_vcolor": "fish with vertex colours"}
COLOURS = ("baseColorTexture", "emissiveTexture", "sheenColorTexture", "specularColorTexture", "diffuseTexture")
QUALITY = {"uastc": 100, "etc1s": 80}  # of alktx2, effort 3
PHONE, DESKTOP = ["bptc", "s3tc", "rgtc"], ["astc", "etc"]  # extensions that the other kind of card has
MB = 1e6


def glb_with_ktx2(data, codec):
    """Return a GLB whose images are KTX2 with all mip levels. data: bytes of a GLB; codec: "uastc" or "etc1s"."""
    import alktx2

    length = struct.unpack_from("<I", data, 12)[0]
    root, binary = json.loads(data[20 : 20 + length]), bytearray(data[28 + length :])
    coloured = coloured_images(root)
    for number, image in enumerate(root.get("images", [])):
        view = root["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        pixels = np.asarray(Image.open(io.BytesIO(binary[start : start + view["byteLength"]])).convert("RGBA"))
        height, width = pixels.shape[:2]
        is_colour, has_alpha = number in coloured, bool((pixels[..., 3] < 255).any())
        coded = alktx2.encode_raw_rgba_to_ktx2(pixels.tobytes(), width, height, has_alpha, codec=codec, quality=QUALITY[codec],
                                               effort=3, srgb=is_colour, linear=not is_colour, mipmaps=True)
        binary += bytes(-len(binary) % 4)
        root["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(coded)})
        root["images"][number] = {"mimeType": "image/ktx2", "bufferView": len(root["bufferViews"]) - 1}
        binary += coded
    for texture in root.get("textures", []):
        texture["extensions"] = {"KHR_texture_basisu": {"source": source_of(texture)}}
        texture.pop("source", None)
    root["extensionsUsed"] = [*set(root.get("extensionsUsed", [])) - {"EXT_texture_webp"}, "KHR_texture_basisu"]
    root["extensionsRequired"] = [*set(root.get("extensionsRequired", [])) - {"EXT_texture_webp"}, "KHR_texture_basisu"]
    binary += bytes(-len(binary) % 4)
    root["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(binary), 0x004E4942) + bytes(binary)


def source_of(texture):
    """Return the number of a texture's image."""
    return texture.get("extensions", {}).get("EXT_texture_webp", texture).get("source", 0)


def coloured_images(root):
    """Return the numbers of the images that hold colours."""
    numbers = set()

    def walk(part):
        for name, value in part.items():
            if name in COLOURS:
                numbers.add(source_of(root["textures"][value["index"]]))
            elif isinstance(value, dict):
                walk(value)

    for material in root.get("materials", []):
        walk(material)
    return numbers


def kept(path, make):
    """Return a file's path; it is written with what make() returns if it is not there."""
    if not path.is_file():
        path.write_bytes(make())
    return path


def is_over_voxels(path):
    """Return whether a stream has a field over voxels."""
    return any(not field.over_texels for field in texfcodec.decode(path.read_bytes()).fields)


def jobs_of(asset, source, out):
    """Return the measurements of an asset, dicts for card.mjs. source: its GLB; out: folder of streams and KTX2 files."""
    def stream(support):
        return texfcodec.encode(str(source), texfcodec.EncodeOptions(rate="r03", support=support))

    best = kept(out / f"{asset}.texf", lambda: stream("auto"))
    jobs = [("PNG", source, [])]
    texels = best
    if is_over_voxels(best):
        jobs.append(("ours, voxels", best, DESKTOP))
        texels = kept(out / f"{asset}.texels.texf", lambda: stream("texels"))
    jobs += [("ours, texels", texels, DESKTOP), ("ours, texels, BC7", texels, DESKTOP), ("ours, texels, ASTC", texels, PHONE)]
    if (neural := out / f"{asset}.3dntc.texf").is_file():
        jobs.append(("ours, 3DNTC", neural, DESKTOP))
    if b'"images"' in source.read_bytes()[:200_000]:
        for codec in QUALITY:
            file = kept(out / f"{asset}.{codec}.glb", lambda codec=codec: glb_with_ktx2(source.read_bytes(), codec))
            jobs += [(f"KTX2, {codec.upper()}, desktop", file, DESKTOP), (f"KTX2, {codec.upper()}, phone", file, PHONE)]
    return [{"asset": asset, "method": method, "file": str(file), "hidden": hidden, "blocks": method.endswith(("BC7", "ASTC"))}
            for method, file, hidden in jobs]


def measured(jobs, out):
    """Return the rows that card.mjs prints of jobs."""
    (out / "jobs.json").write_text(json.dumps(jobs), encoding="utf-8")
    run = subprocess.run(["node", "../tools/bench/card.mjs", str((out / "jobs.json").resolve())], cwd=REPOSITORY / "js",
                         env=os.environ, stdout=subprocess.PIPE, text=True, check=True)
    (out / "rows.jsonl").write_text(run.stdout, encoding="utf-8")
    return [json.loads(line) for line in run.stdout.splitlines()]


TEXT = """# What stays on the card

Made by `make -C tools card` (tools/bench/card.py) {where}.
Bytes are those that three.js r{revision} asks of WebGL in Chromium, in MB of 1,000,000: textures with mipmaps, and vertices with
indices as geometry. **There is no graphics card here.** Milliseconds are those of the processor on which SwiftShader draws
512 x 512 pixels, and say nothing of a card. TEXFLoader filters textures with an anisotropy of 16, GLTFLoader with none.

Ours are streams of r03. *BC7* and *ASTC* are those of [TEXFLoader.detectSupport()](../guide/web.md). PNG is the source as
GLTFLoader shows it, KTX2 the same with its images by Basis Universal. A desktop's card has BC7, a phone's has ASTC and ETC2.
KTX2Loader makes BC7 of ETC1S on a desktop, and on a phone ETC2, which without alpha has half the bytes. The 3DNTC streams have
the base colour alone, after 3,000 steps (`texf-enc --codec 3dntc --effects none --steps 3000`).

## Beside KTX2

Textures of ours in blocks, in percent of the column's. They are smaller than KTX2's where the source has two images of data
whose components fit one texture, or one that is uniform. They are larger where a stream has two fields of an image, because
pieces that share texels turn normals in different directions (cat, fan, fish), and where an image is in many fields (clear coat
test).
"""


def psnr_of(row):
    """Return the least PSNR over components and fields of each kind of texture in blocks, in dB: {maps: dB}."""
    least = {}
    for texture in row.get("psnr", []):
        name = " ".join(texture["maps"])
        least[name] = min(least.get(name, math.inf), *texture["psnr"])
    return least


def page_of(rows):
    """Return the text of docs/reports/card.md for rows of card.mjs."""
    by = {(row["asset"], row["method"]): row for row in rows}
    assets = list(dict.fromkeys(row["asset"] for row in rows))
    rivals = ["ours, texels", "KTX2, UASTC, desktop", "KTX2, ETC1S, desktop", "KTX2, ETC1S, phone"]
    shares = [[ASSETS[asset], *(share(by[asset, "ours, texels, BC7"], by.get((asset, rival))) for rival in rivals)]
              for asset in assets]
    heads = ["ours in RGBA8", "UASTC", "ETC1S, desktop", "ETC1S, phone"]
    lines = [*TEXT.format(where=made_on(), revision=revision()).split("\n"), *markdown_table(["asset", *heads], shares), "",
             "## All", "", *markdown_table(["asset", "as", "textures", "textures, MB", "geometry, MB", "ms a frame"],
                                           [cells(row) for row in rows], 2), "",
             "## What blocks lose", "",
             "PSNR is that of the largest level against the decoded field, of each texture's worst component, by Chromium.",
             "Milliseconds are of the processor for all textures of the asset at first use, pictures included.", "",
             *markdown_table(["asset", "as", "dB", "ms"], [loss(row) for row in rows if "blocks_ms" in row], 3)]
    return "\n".join(wrapped(lines)) + "\n"


def loss(row):
    """Return a row's cells of the table of what blocks lose."""
    values = "; ".join(f"{maps} {value:.1f}" for maps, value in psnr_of(row).items())
    return [ASSETS[row["asset"]], row["method"].rpartition(" ")[2], values, row["blocks_ms"]]


def share(row, rival):
    """Return a row's bytes of textures in percent of a rival's; a dash if there is none."""
    return f"{100 * row['texture_bytes'] / rival['texture_bytes']:.0f} %" if rival else "-"


def cells(row):
    """Return a row's cells of the table of all."""
    if "error" in row:
        return [ASSETS[row["asset"]], row["method"], "-", "-", "-", row["error"][:80]]
    sizes = [f"{row[key] / MB:.2f}" for key in ("texture_bytes", "buffer_bytes")]
    return [ASSETS[row["asset"]], row["method"], row["textures"], *sizes, f"{row['frame_ms']:.0f}"]


def revision():
    """Return the revision of three.js in js/node_modules."""
    return json.loads((REPOSITORY / "js/node_modules/three/package.json").read_text(encoding="utf-8"))["version"].split(".")[1]


def parser():
    """Return the parser of the command line."""
    command = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    command.add_argument("names", nargs="*", metavar="ASSET", help="those of README.md where none is named")
    command.add_argument("--assets", type=Path, required=True, help="folder of ASSET.glb")
    command.add_argument("--out", type=Path, default=REPOSITORY / "out/card")
    command.add_argument("--page", type=Path)
    return command


def main(words=None):
    """Run the command."""
    options = parser().parse_args(words)
    warnings.simplefilter("ignore", texfcodec.LossWarning)
    options.out.mkdir(parents=True, exist_ok=True)
    jobs = [job for name in options.names or ASSETS for job in jobs_of(name, options.assets / f"{name}.glb", options.out)]
    page = page_of(measured(jobs, options.out))
    (options.page.write_text(page, encoding="utf-8") if options.page else print(page))


if __name__ == "__main__":
    main()
