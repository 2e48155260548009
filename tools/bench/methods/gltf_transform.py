"""What people do to a GLB file before they publish it: the command gltf-transform of @gltf-transform/cli, a process of its own
for every step: smaller images (resize), images in WebP, AVIF or JPEG, and vertices in Draco or meshopt.

Its own defaults stand where no option says otherwise: Draco at speed 5 (at speed 0 vertices and UVs of scans take an eighth to a
fifth less), effort 4 of sharp's image encoders, AVIF with chroma at full resolution. Bytes are those of glb.facts_of. Decoded is
the file that was counted, by our loader.

Needs node and `npm install @gltf-transform/cli` (tried: 4.5.1), on PATH or named by TEXFCODEC_GLTF_TRANSFORM or by the option
program; for ETC1S and UASTC also the command ktx of KTX-Software on PATH.
"""

import shutil

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

DEFAULTS = {"mesh": "draco", "texture": "webp", "quality": 80, "shrink": 1, "position_bits": 14, "uv_bits": 12, "speed": 5,
            "program": "", "seconds": 600}
MESHES, TEXTURES, KTX = ("draco", "meshopt"), ("webp", "avif", "jpeg", "etc1s", "uastc"), ("etc1s", "uastc")
CHOICES = {"mesh": MESHES, "texture": TEXTURES}
RANGES = {"quality": (1, 100), "shrink": (1, 64), "position_bits": (1, 16), "uv_bits": (1, 16), "speed": (0, 10),
          "seconds": (1, 86400)}
ETC1S_QUALITIES, UASTC_LEVELS = 255, 4  # of its own scales
NAME, VARIABLE = "gltf-transform", "TEXFCODEC_GLTF_TRANSFORM"
SOURCE, LOG = "source.glb", "program.txt"


@method("gltf_transform")
class GltfTransform(GlbMethod):
    """Options and their defaults stand in DEFAULTS: mesh one of MESHES; texture one of TEXTURES; quality 1 to 100, of etc1s and
    uastc a share of their own scales; shrink: sides of images are divided by it; speed 0 to 10, Draco's; seconds: the limit of
    each step."""

    options = tuple(DEFAULTS)

    def encoder(self):
        """What the program says of itself; "" where it is not there."""
        program = program_of({}, VARIABLE, NAME)
        return version_of((*program, "--version")) if program else ""

    def missing(self, options):
        """A sentence: which program or package is not there."""
        options = DEFAULTS | options
        if not program_of(options, VARIABLE, NAME):
            return (f"{NAME} is not installed: install node and `npm install -g @gltf-transform/cli`, or name the command by "
                    f"{VARIABLE}")
        if options["texture"] in KTX and not shutil.which("ktx"):
            return f"{options['texture']} by {NAME} needs the command ktx on PATH: install KTX-Software of Khronos"
        return (options["mesh"] == "meshopt" and meshopt_missing()) or (options["texture"] in KTX and ktx2_missing()) or None

    def encode(self, scene, options, folder, threads, report):
        """Writes WHOLE and BARE. ValueError: an option is out of range, or a file is not what it should be. ProgramError: a step
        failed, took too long or is not there. LookupError: JPEG has no alpha."""
        options, source = checked_options(options, DEFAULTS, RANGES, CHOICES), source_of(scene)
        if options["texture"] == "jpeg" and any(image.shape[2] == 4 for image in source.images.values()):
            raise LookupError("JPEG has no alpha, and an image has some that shows")
        if reason := self.missing(options):
            raise ProgramError(reason)
        steps = [mesh_step(options)]
        with report.stage("programs"):
            write_document(document_of(source), folder / SOURCE)
            run_steps(steps, folder, BARE, options)
            write_document(document_of(source, coded_images(source, "png")), folder / SOURCE)
            run_steps(image_steps(source, options) + steps, folder, WHOLE, options)
        with report.stage("check"):
            made = checked(folder / WHOLE, source, options["shrink"], slack=int(options["shrink"] > 1))
        return facts_of(folder, made)


def run_steps(steps, folder, name, options):
    """Puts SOURCE of a folder through steps, each a list of words, one into the next, and names the last one's file. Errors:
    as GltfTransform.encode."""
    command, path = program_of(options, VARIABLE, NAME), folder / SOURCE
    for number, (verb, *words) in enumerate(steps):
        target = folder / f"step_{number}.glb"
        run_program([*command, verb, str(path), str(target), *words], folder / LOG, options["seconds"])
        if not target.is_file():
            raise ValueError(f"{NAME} {verb} ended well and wrote no file")
        path.unlink()
        path = target
    path.rename(folder / name)


def image_steps(source, options):
    """[words of a command line after the program's, without its files] for the images."""
    steps, quality = [], options["quality"]
    for width, height in sorted(set(source.sizes)) if options["shrink"] > 1 else ():
        sides = [str(max(1, round(side / options["shrink"]))) for side in (width, height)]
        steps.append(["resize", "--pattern", f"{width}x{height}", "--width", sides[0], "--height", sides[1]])
    if not source.images:
        return steps
    if options["texture"] == "etc1s":
        return [*steps, ["etc1s", "--quality", str(max(1, round(quality / 100 * ETC1S_QUALITIES))), "--mipmaps", "false"]]
    if options["texture"] == "uastc":
        return [*steps, ["uastc", "--level", str(round(quality / 100 * UASTC_LEVELS)), "--mipmaps", "false"]]
    return [*steps, [options["texture"], "--formats", "*", "--quality", str(quality)]]


def mesh_step(options):
    """The words of a command line for the vertices."""
    bits = ["--quantize-position", str(options["position_bits"]), "--quantize-texcoord", str(options["uv_bits"])]
    speed = str(options["speed"])
    return [options["mesh"], *bits, *(["--encode-speed", speed, "--decode-speed", speed] if options["mesh"] == "draco" else [])]
