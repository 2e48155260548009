"""Ladders of speed: every tool at every effort that it has, measured in one warm process an asset, as lines of JSON.

python tools/bench/ladders.py ROWS.jsonl --assets FOLDER [--asset NAME ...] [--tool NAME ...] [--again]

Rows that ROWS.jsonl has are not measured again; --again drops those before that the other flags select. A row: "asset", "tool",
"effort", "point" (rate or quality), "threads", "bytes" of everything, "psnr" of Y in daylight, 8 views of 512 pixels, "encode"
and "decode", each [processor seconds of the process and its children, seconds of wall], and "commit". Rows of the tool "knobs"
have "explained" instead: what texf-enc --explain-time measures. A tool that is not here, or that codes no such asset, is named
on stderr. Ours is decoded by the native library, which `make native` builds.

Images are those of methods/uv.py at the bits of ASSETS, each at the better subsampling, which is settled before the clock runs.
The seconds of programs (PROGRAMS) are those of a whole process on the source's file; those of all others begin after loading.
"""

import argparse
import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # run as a command
    sys.path.insert(0, str(REPOSITORY))

import texfcodec  # noqa: E402
from texfcodec.encoder.encode import encode_scene  # noqa: E402
from texfcodec.encoder.explain import explain_time  # noqa: E402
from texfcodec.geometry.canonical import fit_cube  # noqa: E402
from texfcodec.io.load import load  # noqa: E402
from texfcodec.metrics.views import KeptViews, ViewSettings  # noqa: E402
from texfcodec.render.environment import DAYLIGHT  # noqa: E402
from texfcodec.report import Report  # noqa: E402
from tools.bench.methods import draco_mesh, find, image_codecs, parametrise, uv  # noqa: E402
from tools.bench.methods.programs import ProgramError  # noqa: E402
from tools.bench.provenance import commit_of  # noqa: E402

VIEWS, SIZE, EXACT, TRIED = 8, 512, 99.0, 60  # EXACT: dB of equal pictures; TRIED: quality that settles subsamplings
# The eight of README: options of methods/uv.py, the bits on the hull of tools/bench/materials at r03's PSNR.
ASSETS = {
    "waterbottle_pbr": {"uv_bits": 12}, "damaged_helmet": {"uv_bits": 14}, "cat_webp": {"uv_bits": 14},
    "vintage_fan": {"uv_bits": 14, "tangent_bits": 8}, "bball_0001": {"uv_bits": 12}, "avocado": {"uv_bits": 12},
    "clearcoat_blend": {"uv_bits": 12}, "snapper_vcolor": {"uv_bits": 12, "tangent_bits": 8, "colour_bits": 6},
}
SCAN = "bball_0001"


class Rung(NamedTuple):
    """An effort of a tool. points: rates or qualities; most: million texels of an asset above which it would take minutes."""

    tool: str
    effort: object
    points: tuple
    threads: int = 1
    most: float = 1e3


RUNGS = (  # the usual effort of each first
    Rung("avif6", 6, (15, 40, 65, 82, 93, 99), most=9), Rung("avif6", 6, (40, 82, 93, 99)), Rung("webp4", 4, (50, 80, 95)),
    Rung("jxl", 7, (4.0, 2.0, 0.5)), Rung("etc1s", 0, (100,)), Rung("uastc", 0, (80, 100), most=9),
    Rung("uastc", 0, (80,), most=13), *(Rung("gltf-transform", images, ("",)) for images in ("avif", "webp")),
    Rung("gltfpack", "-cc", ("",)),
    Rung("ours", "balanced", ("r01", "r02", "r03")), Rung("texf-enc", "balanced", ("r03",)),
    *(Rung("avif6", speed, (82,)) for speed in (10, 8, 7)), *(Rung("webp4", method, (95,)) for method in (0, 2, 6)),
    *(Rung("jxl", effort, (0.5,)) for effort in (1, 4)),
    *(Rung("hevc", preset, (30, 22)) for preset in ("slow", "medium", "ultrafast")),
    *(Rung("tmc13", transform, (34, 28)) for transform in ("raht", "predlift")),
    Rung("ours", "fast", ("r01", "r03")), Rung("texf-enc", "fast", ("r03",)),
    Rung("avif6", 4, (82,), most=13), *(Rung("jxl", effort, (0.5,), most=13) for effort in (3, 5, 8)),
    Rung("ours", "balanced", ("r03",), 2), Rung("avif6", 6, (82,), 2), Rung("jxl", 7, (0.5,), 2),
    *(Rung("avif6", speed, (82,), most=most) for speed, most in ((9, 5), (5, 5), (3, 5), (2, 5), (1, 1), (0, 1))),
    *(Rung("webp4", method, (95,), most=5) for method in (1, 3, 5)), Rung("jxl", 9, (0.5,), most=5),
    *(Rung("etc1s", effort, (100,), most=5) for effort in (3, 6)), Rung("uastc", 3, (80,), most=5),
    Rung("knobs", "balanced", ("r03",)),
)
PROGRAMS = {"texf-enc", "gltf-transform", "gltfpack"}
KEY = "asset", "tool", "effort", "point", "threads"


def clock():
    """Return (processor seconds of this process and its ended children, seconds of wall)."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(used.ru_utime + used.ru_stime for used in both), time.perf_counter()


def timed(work, *arguments, **options):
    """Return (result of a call, [processor seconds, seconds of wall])."""
    begin = clock()
    result = work(*arguments, **options)
    return result, [round(after - before, 4) for before, after in zip(begin, clock(), strict=True)]


class Asset:
    """A source, its pictures and its form for rivals that code images. folder: for files."""

    def __init__(self, name, path, folder):
        self.name, self.path, self.folder, self.scene = name, path, folder, load(path)
        self.options = uv.DEFAULTS | {"codec": "avif6", "quality": TRIED, "maps": "all", "normal_bits": 8} | ASSETS[name]

    @cached_property
    def views(self):
        """The source's pictures in daylight; those of the scan, which has no normals to light it by, as it is."""
        return KeptViews(self.scene, VIEWS, SIZE, ViewSettings(environment=None if self.name == SCAN else DAYLIGHT))

    @cached_property
    def textured(self):
        """Textured, with the source's UVs."""
        return Textured(uv.shown_in_light(self.scene), self.options, self.folder)

    @cached_property
    def unwrapped(self):
        """Textured, with UVs of xatlas, and the seconds that these took."""
        request = parametrise.Request("xatlas", parametrise.side_of(self.scene), parametrise.SECONDS)
        (scene, _), seconds = timed(parametrise.reparametrised, self.scene, request, self.folder, 1)
        textured = Textured(scene, self.options | {"maps": "none"}, self.folder)
        textured.seconds = [a + b for a, b in zip(textured.seconds, seconds, strict=True)]
        return textured

    @cached_property
    def texels(self):
        """Millions of texels of the images."""
        images = {id(texture.image): texture.image for texture in self.scene.textures}.values()
        return sum(image.shape[0] * image.shape[1] for image in images) / 1e6


class Textured:
    """Draco's mesh and the images of a scene, ready for codecs. seconds, decode: of the mesh; size: its bytes."""

    def __init__(self, scene, options, folder):
        self.rival = rival = draco_mesh.rival_of(scene, with_maps=options["maps"] == "all")
        bits = uv.uv_bits_of(rival, options)
        meshes, facts = uv.enc_meshes(rival, bits, options)
        for number, data in enumerate(meshes):
            (folder / uv.MESH.format(number)).write_bytes(data)
        cube = fit_cube(scene.positions, parametrise.POSITION_BITS)
        self.layout = facts | uv.handed_through(rival, options, cube)
        self.images = [(image, uv.better_chroma(image, components, options))
                       for image, components in uv.images_of(rival, options)]
        parts, part_bits = uv.corner_parts(rival, bits, options)
        _, self.seconds = timed(draco_mesh.enc_mesh, rival.lattice, rival.scene.faces, parts, part_bits)
        self.mesh = uv.dec_meshes(folder, self.layout)
        _, self.decode = timed(lambda: [draco_mesh.dec_mesh(data) for data in meshes])
        self.size = sum(map(len, meshes))


def by_images(asset, tool, effort, point, threads):
    """Code Draco's mesh and images; return (bytes, decoded Scene, seconds of encoding, of decoding)."""
    if sentence := "new UVs are for the scan" if tool == "hevc" and asset.name != SCAN else image_codecs.missing(tool):
        raise LookupError(sentence)
    textured = asset.unwrapped if tool == "hevc" else asset.textured
    coded, encode = timed(lambda: [image_codecs.enc_image(image, tool, point, chroma, threads, effort)
                                   for image, chroma in textured.images])
    images, decode = timed(lambda: [image_codecs.dec_image(data, tool, *image.shape[1::-1])
                                    for data, (image, _) in zip(coded, textured.images, strict=True)])
    encode, decode = ([round(a + b, 4) for a, b in zip(seconds, mesh, strict=True)]
                      for seconds, mesh in ((encode, textured.seconds), (decode, textured.decode)))
    return textured.size + sum(map(len, coded)), uv.scene_of(textured.layout, textured.mesh, images), encode, decode


def by_us(asset, _, effort, point, threads):
    """Code the asset with our encoder; return what by_images() returns."""
    options = texfcodec.EncodeOptions(rate=point, effort=effort, threads=threads)
    encoded, encode = timed(texfcodec.encode, asset.scene, options)
    texf, decode = timed(texfcodec.decode, encoded, texfcodec.DecodeOptions(threads=threads, engine="native"))
    return len(encoded), texf, encode, decode


def by_tmc13(asset, _, effort, point, threads):
    """Code our voxels of the asset with TMC13; return what by_images() returns."""
    method, options, report = find("external"), {"qp": point, "transform": effort}, Report()
    if sentence := "voxels of base colours are for the scan" if asset.name != SCAN else method.missing(options):
        raise LookupError(sentence)
    facts, encode = timed(method.encode, asset.scene, options, asset.folder, threads, report)
    decoded, decode = timed(method.decode, asset.folder, options, threads, report)
    return facts["bytes"]["total"], decoded, encode, decode


def by_program(asset, tool, effort, point, _):
    """Code the source's file with a program of PROGRAMS; return what by_images() returns."""
    out = asset.folder / ("out.texf" if tool == "texf-enc" else "out.glb")
    words = shlex.split(os.environ.get("TEXFCODEC_" + tool.upper().replace("-", "_"), "")) or [shutil.which(tool)]
    commands = {
        "texf-enc": [sys.executable, "-m", "texfcodec.cli.enc", asset.path, out, "--rate", point, "--effort", effort, "--quiet"],
        "gltf-transform": [*words, "optimize", asset.path, out, "--compress", "draco", "--texture-compress", effort],
        "gltfpack": [*words, "-i", asset.path, "-o", out, "-cc"]}
    if commands[tool][0] is None:
        raise LookupError(f"{tool} is not installed: npm install -g brings it")
    out.unlink(missing_ok=True)
    _, encode = timed(subprocess.run, [str(word) for word in commands[tool]], check=True, capture_output=True, timeout=900)
    decoded, decode = timed(texfcodec.decode if tool == "texf-enc" else load, out)
    return out.stat().st_size, decoded, encode, decode


CODERS = {"ours": by_us, "tmc13": by_tmc13} | dict.fromkeys(PROGRAMS, by_program)


def explained(asset, effort, point):
    """Return what explain_time() measures of all neighbours of an effort and rate."""
    options = texfcodec.EncodeOptions(rate=point, effort=effort, threads=1)
    return explain_time(asset.scene, options, encode_scene(asset.scene, options), {}, 1e6)


def row_of(asset, rung, point):
    """Measure one point of a rung; return its row."""
    facts = dict(zip(KEY, (asset.name, rung.tool, rung.effort, point, rung.threads), strict=True))
    facts["commit"] = commit_of(REPOSITORY)
    if rung.tool == "knobs":
        return facts | {"explained": explained(asset, rung.effort, point)}
    size, decoded, encode, decode = CODERS.get(rung.tool, by_images)(asset, rung.tool, rung.effort, point, rung.threads)
    psnr = round(asset.views.compare(decoded)["psnr"]["y"] or EXACT, 3)
    return facts | {"bytes": size, "psnr": psnr, "encode": encode, "decode": decode}


def points_of(asset, tools, known):
    """Yield (Rung, point) of what tools are to measure of an Asset. known: keys of rows, which grows by what is yielded."""
    for rung in (rung for rung in RUNGS if rung.tool in tools and asset.texels <= rung.most):
        for point in rung.points:
            key = asset.name, rung.tool, rung.effort, point, rung.threads
            if key not in known:
                known.add(key)
                yield rung, point


def measure(asset, tools, known, file):
    """Append the rows of an asset that are not known to a file, each when it is measured."""
    absent, warm = set(), set()
    for rung, point in points_of(asset, tools, known):
        if rung.tool in absent:
            continue
        try:
            if rung.tool == "ours" and rung.effort not in warm:
                by_us(asset, "", rung.effort, point, rung.threads)  # loads kernels before the clock runs
                warm.add(rung.effort)
            file.write(json.dumps(row_of(asset, rung, point)) + "\n")
            file.flush()
        except (LookupError, ProgramError, subprocess.SubprocessError) as error:
            absent.add(rung.tool)
            print(f"{asset.name}: {rung.tool}: {error}", file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", type=Path)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--asset", action="append", choices=ASSETS)
    parser.add_argument("--tool", action="append", choices={rung.tool for rung in RUNGS})
    parser.add_argument("--again", action="store_true")
    arguments = parser.parse_args()
    names, tools = arguments.asset or ASSETS, arguments.tool or {rung.tool for rung in RUNGS}
    rows = [json.loads(line) for line in arguments.rows.read_text().splitlines()] if arguments.rows.exists() else []
    if arguments.again:
        rows = [row for row in rows if row["asset"] not in names or row["tool"] not in tools]
        arguments.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    known = {tuple(row[name] for name in KEY) for row in rows}
    with arguments.rows.open("a") as file:
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                measure(Asset(name, arguments.assets / f"{name}.glb", Path(folder)), tools, known, file)


if __name__ == "__main__":
    main()
