"""A GLB file whose images a GPU holds without unpacking them: vertices by Draco, and images in KTX2 with Basis Universal data,
ETC1S, or UASTC under Zstandard.

Both are coded in this process: by DracoPy, with the bits that gltf-transform takes, and by alktx2, which has the encoder of Basis
Universal's authors. The commands of KTX-Software, which gltf-transform calls, use the same encoder. No mip levels are written, as
other rivals have none. Bytes are those of glb.facts_of; a loader that transcodes decodes what was counted.

Needs `pip install "texfcodec[formats]"`.
"""

from importlib.util import find_spec

import numpy as np

from tools.bench.methods import checked_options, method, versions_of
from tools.bench.methods.glb import (
    BARE,
    WHOLE,
    GlbMethod,
    checked,
    document_of,
    facts_of,
    ktx2_missing,
    source_of,
    write_document,
)

DEFAULTS = {"codec": "etc1s", "quality": 80, "shrink": 1, "uv_bits": 12, "zstd": 18}
CHOICES = {"codec": ("etc1s", "uastc")}
RANGES = {"quality": (1, 100), "shrink": (1, 64), "uv_bits": (1, 16), "zstd": (1, 22)}


@method("ktx2")
class Ktx2(GlbMethod):
    """Options and their defaults stand in DEFAULTS: codec "etc1s" or "uastc"; quality 1 to 100, below which UASTC is made
    easier for Zstandard; shrink: sides of images are divided by it; zstd: level of Zstandard, for uastc."""

    options = tuple(DEFAULTS)

    def encoder(self):
        """The versions of alktx2 and DracoPy."""
        return versions_of("alktx2", "DracoPy")

    def missing(self, options):
        """A sentence: which package is not there."""
        if not find_spec("alktx2"):
            return 'KTX2 is written by the package alktx2: pip install "texfcodec[formats]"'
        return ktx2_missing()

    def encode(self, scene, options, folder, threads, report):
        """Writes WHOLE and BARE. ValueError: an option is out of range, or the file is not what it should be."""
        from texfcodec.io.formats import IMAGE_FORMATS
        from texfcodec.io.gltf.packing import Draco

        options = checked_options(options, DEFAULTS, RANGES, CHOICES)
        source = source_of(scene)
        source.images = {content: fitted(image, options["shrink"], report.warnings) for content, image in source.images.items()}
        with report.stage("textures"):
            images = {content: (IMAGE_FORMATS["ktx2"], coded_image(image, options, threads))
                      for content, image in source.images.items()}
        with report.stage("geometry"):
            for name, coded in ((WHOLE, images), (BARE, None)):
                document = document_of(source, coded, Draco(options["uv_bits"]))
                report.warnings += document.warnings
                write_document(document, folder / name)
        with report.stage("check"):
            made = checked(folder / WHOLE, source)
        return facts_of(folder, made)


def fitted(image, shrink, warnings):
    """An image uint8 [H, W, 3 or 4] with its sides divided by shrink, and rounded to multiples of 4, which glTF asks for."""
    from PIL import Image

    height, width = image.shape[:2]
    size = [max(4, 4 * round(side / shrink / 4)) for side in (width, height)]
    if size == [width, height]:
        return image
    if shrink == 1:
        warnings.append(f"an image of {width} x {height} is coded as one of {size[0]} x {size[1]}: glTF asks for multiples of 4")
    return np.ascontiguousarray(Image.fromarray(image).resize(size, Image.Resampling.LANCZOS))


def coded_image(image, options, threads):
    """The bytes of a KTX2 file with an image, uint8 [H, W, 3 or 4]."""
    import alktx2

    height, width, columns = image.shape
    rgba = np.full((height, width, 4), 255, np.uint8)
    rgba[..., :columns] = image
    told = {"zstd_supercompression_level": options["zstd"]} if options["codec"] == "uastc" else {}
    return alktx2.encode_raw_rgba_to_ktx2(rgba.tobytes(), width, height, columns == 4, codec=options["codec"],
                                          quality=options["quality"], srgb=True, mipmaps=False, threads=threads, **told)
