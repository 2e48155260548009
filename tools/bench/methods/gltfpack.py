"""What people do to a GLB file before they publish it, the other way: gltfpack of meshoptimizer, as a process of its own, with
its best compression of vertices (-cc), no simplification, and images as KTX2 (ETC1S, UASTC) or WebP, whose sides it makes
multiples of 4.

Bytes are those of glb.facts_of; its KTX2 files have all mip levels, a third more texels, and no option leaves them out. Decoded
is the file that was counted, by our loader. gltfpack -cc is made to be compressed once more on its way, by the server; gzip says
what it then has ("gzip_bytes" among the facts), and does not count.

Needs gltfpack, on PATH or named by TEXFCODEC_GLTFPACK or by the option program. `npm install gltfpack` (tried: 1.3.0) gives a
build that leaves images as they are, which is what the texture "kept_webp" is for: images that Pillow has coded before. Builds
of meshoptimizer's releases (tried: 1.2) code images too.
"""

import gzip
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench.methods import checked_options, method
from tools.bench.methods.glb import (
    BARE,
    WHOLE,
    GlbMethod,
    checked,
    coded_images,
    document_of,
    facts_of,
    ktx2_missing,
    meshopt_missing,
    source_of,
    write_document,
)
from tools.bench.methods.programs import ProgramError, program_of, run_program, version_of

DEFAULTS = {"texture": "webp", "quality": 80, "shrink": 1, "position_bits": 14, "uv_bits": 12, "program": "", "seconds": 600}
WORDS = {"webp": ["-tw"], "etc1s": ["-tc"], "uastc": ["-tc", "-tu"], "kept_webp": []}
CHOICES = {"texture": tuple(WORDS)}
RANGES = {"quality": (1, 100), "shrink": (1, 64), "position_bits": (1, 16), "uv_bits": (1, 16), "seconds": (1, 86400)}
NAME, VARIABLE = "gltfpack", "TEXFCODEC_GLTFPACK"
SOURCE, LOG = "source.glb", "program.txt"
BLOCK, TRIAL_SECONDS = 4, 30


@method("gltfpack")
class Gltfpack(GlbMethod):
    """Options and their defaults stand in DEFAULTS: texture one of WORDS; quality 1 to 100, of which gltfpack's own scale of 1 to
    10 (-tq) gets the tenth part; shrink: sides of images are divided by it; seconds: the limit of a run."""

    options = tuple(DEFAULTS)

    def encoder(self):
        """What the program says of itself; "" where it is not there."""
        program = program_of({}, VARIABLE, NAME)
        return version_of((*program, "-v")) if program else ""

    def missing(self, options):
        """A sentence: no program, one that cannot code such images, or a package that reads what it writes."""
        options = checked_options(options, DEFAULTS, RANGES, CHOICES)
        program = program_of(options, VARIABLE, NAME)
        if not program:
            return (f"{NAME} is not installed: take a build of meshoptimizer's releases, or `npm install -g gltfpack`, which "
                    f"codes no images; {VARIABLE} may name it")
        if reason := refused(program, tuple(WORDS[options["texture"]])):
            return f"this {NAME} cannot code images as {options['texture']}, builds of meshoptimizer's releases can: {reason}"
        return meshopt_missing() or (ktx2_missing() if "-tc" in WORDS[options["texture"]] else None)

    def encode(self, scene, options, folder, threads, report):
        """Writes WHOLE and BARE. ValueError: an option is out of range, or a file is not what it should be. ProgramError: a run
        failed, took too long or is not there."""
        options, source = checked_options(options, DEFAULTS, RANGES, CHOICES), source_of(scene)
        if reason := self.missing(options):
            raise ProgramError(reason)
        kept = options["texture"] == "kept_webp"
        if kept and options["shrink"] > 1:
            raise ValueError("images that are kept as they are cannot be made smaller: shrink must be 1")
        with report.stage("programs"):
            write_document(document_of(source), folder / SOURCE)
            self._run(options, [], folder, BARE)
            images = coded_images(source, "webp", options["quality"]) if kept else coded_images(source, "png")
            write_document(document_of(source, images), folder / SOURCE)
            self._run(options, image_words(options, threads) if source.images else [], folder, WHOLE)
        with report.stage("check"):
            made = checked(folder / WHOLE, source, options["shrink"], slack=0 if kept else BLOCK)
        return facts_of(folder, made) | {"gzip_bytes": len(gzip.compress((folder / WHOLE).read_bytes(), 9, mtime=0))}

    def _run(self, options, words, folder, name):
        """Puts SOURCE of a folder through the program, into a file of this name."""
        bits = ["-vp", str(options["position_bits"]), "-vt", str(options["uv_bits"])]
        files = ["-i", str(folder / SOURCE), "-o", str(folder / name)]
        run_program([*program_of(options, VARIABLE, NAME), *files, "-cc", *bits, *words], folder / LOG, options["seconds"])
        (folder / SOURCE).unlink()


def image_words(options, threads):
    """The words of a command line that images are coded by."""
    words = WORDS[options["texture"]]
    if not words:
        return []
    shrink = ["-ts", repr(1 / options["shrink"])] if options["shrink"] > 1 else []
    return [*words, "-tq", str(max(round(options["quality"] / 10), 1)), "-tj", str(threads), *shrink]


@lru_cache(maxsize=8)
def refused(program, words):
    """What a program says against such images, tried on one of 4 x 4 pixels; None where it takes them."""
    corners = np.array([[[0, 0], [1, 0], [1, 1]]], np.float64)
    scene = Scene(np.eye(3), np.array([[0, 1, 2]]), np.zeros(1, np.int64), corners, None, [Material(texture=0)],
                  [Texture(np.full((4, 4, 4), 255, np.uint8))])
    source = source_of(scene)
    with tempfile.TemporaryDirectory(prefix="texf-trial-") as folder:
        path = Path(folder) / SOURCE
        write_document(document_of(source, coded_images(source, "png")), path)
        try:
            run_program([*program, "-i", str(path), "-o", str(path.with_name(WHOLE)), "-cc", *words], path.with_name(LOG),
                        TRIAL_SECONDS)
        except ProgramError as error:
            return str(error)
    return None
