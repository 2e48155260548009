"""What people do to a GLB file before they publish it, by the programs that do it, each a process of its own:

    gltf_transform  the command gltf-transform of @gltf-transform/cli: smaller images (resize), WebP, AVIF or JPEG, and vertices
                    in Draco or meshopt. Its own defaults stand where no option says otherwise: Draco at speed 5 (at speed 0
                    vertices and UVs of scans take an eighth to a fifth less), effort 4 of sharp's image encoders, AVIF with full
                    chroma. `npm install @gltf-transform/cli` (tried: 4.5.1); for ETC1S and UASTC also the command ktx of
                    KTX-Software.
    gltfpack        meshoptimizer's, with its best compression of vertices (-cc), no simplification, and images as KTX2 (ETC1S,
                    UASTC) or WebP, whose sides it makes multiples of 4; its KTX2 files have all mip levels, a third more texels.
                    gzip says what a server makes of it ("gzip_bytes" among the facts), and does not count. `npm install gltfpack`
                    (tried: 1.3.0) leaves images as they are, which is what the texture "kept_webp" is for: images that Pillow has
                    coded before. Builds of meshoptimizer's releases (tried: 1.2) code images too.

The program is on PATH, or named by TEXFCODEC_GLTF_TRANSFORM, TEXFCODEC_GLTFPACK or the option program. Bytes are those of
glb.facts_of; decoded is the file that was counted, by our loader.
"""

import gzip
import shutil
import tempfile
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench.methods import Method, checked_options, glb, method, programs, source_hash
from tools.bench.methods.glb import (
    BARE,
    WHOLE,
    checked,
    coded_images,
    document_of,
    facts_of,
    scene_sha256,
    source_of,
    write_document,
)
from tools.bench.methods.programs import ProgramError, program_of, run_program, version_of

SOURCE, LOG = "source.glb", "program.txt"
ETC1S_QUALITIES, UASTC_LEVELS = 255, 4  # of gltf-transform's own scales
BLOCK, TRIAL_SECONDS = 4, 30
PACK_WORDS = {"webp": ["-tw"], "etc1s": ["-tc"], "uastc": ["-tc", "-tu"], "kept_webp": []}
DEFAULTS = {"texture": "webp", "quality": 80, "shrink": 1, "position_bits": 14, "uv_bits": 12, "program": "", "seconds": 600}
RANGES = {"quality": (1, 100), "shrink": (1, 64), "position_bits": (1, 16), "uv_bits": (1, 16), "seconds": (1, 86400)}


class GltfProgram(Method):
    """A program that codes GLB files. Options, with defaults in defaults: texture; quality 1 to 100, scaled to the program's own
    range; shrink: divisor of the images' sides; seconds: time limit of each run."""

    name = variable = version_word = install = ""
    defaults, ranges, choices = DEFAULTS, RANGES, {}

    def encoder(self):
        """What the program says of itself; "" where it is not there."""
        program = program_of({}, self.variable, self.name)
        return version_of((*program, self.version_word)) if program else ""

    def version(self):
        """encoder(), and a hash of the files that these methods share."""
        return f"{self.encoder()} {source_hash(glb.__file__, programs.__file__)}"

    def checked(self, options):
        """Return all options with defaults. Raises ValueError with the name of one that is out of range."""
        return checked_options(options, self.defaults, self.ranges, self.choices)

    def missing(self, options):
        """Return a sentence if the program, its support of such images, or a reader of its output is missing; else None."""
        options = self.defaults | options
        program = program_of(options, self.variable, self.name)
        if not program:
            return f"{self.name} is not installed: {self.install}; {self.variable} may name it"
        return self.refuses(program, options) or reader_missing(options)

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into WHOLE, and without images, UVs and colours into BARE. Raises ValueError for an option out of range
        or a faulty output, ProgramError if a run fails or takes too long, LookupError for alpha in JPEG."""
        options, source = self.checked(options), source_of(scene)
        if options["texture"] == "jpeg" and any(image.shape[2] == 4 for image in source.images.values()):
            raise LookupError("JPEG has no alpha, and an image has some that shows")
        if reason := self.missing(options):
            raise ProgramError(reason)
        kept = options["texture"] == "kept_webp"
        if kept and options["shrink"] > 1:
            raise ValueError("images that are kept as they are cannot be made smaller: shrink must be 1")
        with report.stage("programs"):
            write_document(document_of(source), folder / SOURCE)
            self.run(None, options, folder, BARE)
            images = coded_images(source, "webp", options["quality"]) if kept else coded_images(source, "png")
            write_document(document_of(source, images), folder / SOURCE)
            self.run(source, options | {"threads": threads}, folder, WHOLE)
        with report.stage("check"):
            document = checked(folder / WHOLE, source, options["shrink"], 0 if kept else self.slack(options))
        return facts_of(folder, document) | self.further_facts(folder)

    def decode(self, folder, options, threads, report):
        """Return the Scene of WHOLE, read by texfcodec's loader."""
        return checked(folder / WHOLE)

    def values_sha256(self, decoded):
        """Return scene_sha256() of a decoded Scene, which facts_of() returned for the encoder."""
        return scene_sha256(decoded)

    def further_facts(self, folder):
        """Return further entries for the dict of encode(): none here."""
        return {}


def reader_missing(options):
    """Return a sentence if a package that texfcodec's loader needs for the program's output is not installed; else None."""
    if options.get("mesh", "meshopt") == "meshopt" and not find_spec("meshoptimizer"):
        return 'meshopt is read by the package meshoptimizer: pip install "texfcodec[formats]"'
    if options["texture"] in ("etc1s", "uastc") and not find_spec("opengl_basisu"):
        return 'KTX2 is read by the package opengl-basisu: pip install "texfcodec[formats]"'
    return None


@method("gltf_transform")
class GltfTransform(GltfProgram):
    """GltfProgram of gltf-transform. Further options: mesh "draco" or "meshopt"; speed 0 to 10, of Draco."""

    name, variable, version_word = "gltf-transform", "TEXFCODEC_GLTF_TRANSFORM", "--version"
    install = "install node and `npm install -g @gltf-transform/cli`"
    defaults, ranges = DEFAULTS | {"mesh": "draco", "speed": 5}, RANGES | {"speed": (0, 10)}
    choices = {"mesh": ("draco", "meshopt"), "texture": ("webp", "avif", "jpeg", "etc1s", "uastc")}
    options = tuple(defaults)

    def refuses(self, program, options):
        """Return a sentence if a program that codes such images is missing; else None."""
        if options["texture"] in ("etc1s", "uastc") and not shutil.which("ktx"):
            return f"{options['texture']} by {self.name} needs the command ktx on PATH: install KTX-Software of Khronos"
        return None

    def slack(self, options):
        """Return by how many pixels the side of an output image may differ."""
        return int(options["shrink"] > 1)

    def run(self, source, options, folder, name):
        """Run gltf-transform on SOURCE in a folder, step by step, into the file `name`. source: None without images and UVs."""
        path, command = folder / SOURCE, program_of(options, self.variable, self.name)
        for number, (verb, *words) in enumerate([*(image_steps(source, options) if source else []), mesh_step(options)]):
            target = folder / f"step_{number}.glb"
            run_program([*command, verb, str(path), str(target), *words], folder / LOG, options["seconds"])
            if not target.is_file():
                raise ValueError(f"{self.name} {verb} ended well and wrote no file")
            path.unlink()
            path = target
        path.rename(folder / name)


def image_steps(source, options):
    """Return the steps for the images, each the arguments of gltf-transform without its files."""
    steps, quality = [], options["quality"]
    for width, height in sorted(set(source.sizes)) if options["shrink"] > 1 else ():
        sides = [str(max(1, round(side / options["shrink"]))) for side in (width, height)]
        steps.append(["resize", "--pattern", f"{width}x{height}", "--width", sides[0], "--height", sides[1]])
    words = {"etc1s": ["--quality", str(max(1, round(quality / 100 * ETC1S_QUALITIES))), "--mipmaps", "false"],
             "uastc": ["--level", str(round(quality / 100 * UASTC_LEVELS)), "--mipmaps", "false"]}
    usual = ["--formats", "*", "--quality", str(quality)]
    return [*steps, [options["texture"], *words.get(options["texture"], usual)]] if source.images else steps


def mesh_step(options):
    """Return the arguments of gltf-transform, without its files, that compress the mesh."""
    bits = ["--quantize-position", str(options["position_bits"]), "--quantize-texcoord", str(options["uv_bits"])]
    speed = str(options["speed"])
    return [options["mesh"], *bits, *(["--encode-speed", speed, "--decode-speed", speed] if options["mesh"] == "draco" else [])]


@method("gltfpack")
class Gltfpack(GltfProgram):
    """GltfProgram of gltfpack. texture: one of PACK_WORDS; gltfpack's scale of 1 to 10 (-tq) gets a tenth of the quality."""

    name, variable, version_word = "gltfpack", "TEXFCODEC_GLTFPACK", "-v"
    install = "take a build of meshoptimizer's releases, or `npm install -g gltfpack`, which codes no images"
    choices = {"texture": tuple(PACK_WORDS)}
    options = tuple(DEFAULTS)

    def refuses(self, program, options):
        """Return a sentence if this build of gltfpack cannot code such images; else None."""
        reason = refused(program, tuple(PACK_WORDS[options["texture"]]))
        return reason and (f"this {self.name} cannot code images as {options['texture']}, builds of meshoptimizer's releases "
                           f"can: {reason}")

    def slack(self, options):
        """Return by how many pixels the side of an output image may differ."""
        return BLOCK

    def run(self, source, options, folder, name):
        """Run gltfpack on SOURCE in a folder and write the file `name`. source: None without images and UVs."""
        words = PACK_WORDS[options["texture"]] if source and source.images else []
        if words:
            shrink = ["-ts", repr(1 / options["shrink"])] if options["shrink"] > 1 else []
            words = [*words, "-tq", str(max(round(options["quality"] / 10), 1)), "-tj", str(options["threads"]), *shrink]
        files = ["-i", str(folder / SOURCE), "-o", str(folder / name)]
        bits = ["-vp", str(options["position_bits"]), "-vt", str(options["uv_bits"])]
        program = program_of(options, self.variable, self.name)
        run_program([*program, *files, "-cc", *bits, *words], folder / LOG, options["seconds"])
        (folder / SOURCE).unlink()

    def further_facts(self, folder):
        """Return the bytes of WHOLE after gzip, a further entry for the dict of encode()."""
        return {"gzip_bytes": len(gzip.compress((folder / WHOLE).read_bytes(), 9, mtime=0))}


@lru_cache(maxsize=8)
def refused(program, words):
    """Return the error of a program that is run with these arguments on an image of 4 x 4 pixels; None if it succeeds."""
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
