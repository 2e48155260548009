"""The GPU-resident rival UV-Source/BC7: as astc.py, with colours and data in BC7 and normal maps in BC5, what desktop GPUs hold.

A block of 4 x 4 texels takes 16 bytes in either, whatever is in it; smaller payloads are images of half the size, and half again.

Needs etcpak, `pip install "texfcodec[baselines]"`. Its own decoders of version 0.9.15 end the process, so Pillow decodes.
"""

import numpy as np
from PIL import Image

from tools.bench.methods import checked_options, method
from tools.bench.methods.astc import HANDLING, Astc, texture_bytes
from tools.bench.methods.packed_maps import COLOUR, NORMAL, three_components, two_components

DEFAULTS = {"halvings": 0, "uber": 4, "uv_bytes": "uint16", "maps": "none", "parametrisation": "source"}
BLOCK = (4, 4)
BC5, BC7 = 5, 7  # as Pillow numbers them
RANGES = {"halvings": (0, 7), "uber": (0, 4)}


@method("bc7")
class Bc7(Astc):
    """The source's textures in BC7 and BC5. Options, with defaults in DEFAULTS: halvings of the images' sides; uber 0 to 4, the
    encoder's effort; uv_bytes, maps and parametrisation as of astc."""

    options = tuple(DEFAULTS)
    packages = ("etcpak", "pillow")

    def codec(self, options, threads):
        """Return the Codec of single images under these options. Raises LookupError, ValueError as Codec."""
        return Codec(options)


class Codec:
    """BC7 and BC5 for single images, under a method's options. Raises LookupError if the library is not installed, ValueError if
    an option is out of range."""

    def __init__(self, options):
        self.options = checked_options(options, DEFAULTS, RANGES, HANDLING)
        try:
            import etcpak
        except ImportError as error:
            raise LookupError(f"bc7 needs etcpak, pip install \"texfcodec[baselines]\" brings it: {error}") from error
        self._lib, self._effort = etcpak, etcpak.BC7CompressBlockParams()
        self._effort.init_linear_weights()
        self._effort.m_uber_level = self.options["uber"]

    def shipped(self, image):
        """Return a source image uint8 [H, W, 4] with its sides halved options["halvings"] times, by means of texels."""
        for _ in range(self.options["halvings"]):
            if min(image.shape[:2]) < 2:
                break
            even = image[: image.shape[0] & ~1, : image.shape[1] & ~1].astype(np.float32)
            image = np.rint((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4).astype(np.uint8)
        return image

    def enc_image(self, image, kind=COLOUR):
        """Return the blocks (bytes) of an RGBA image uint8 [H, W, 4], padded to whole blocks. kind: COLOUR, NORMAL or DATA."""
        height, width = image.shape[:2]
        image = two_components(image)[..., [0, 3, 0, 3]] if kind == NORMAL else image
        image = np.pad(image, ((0, -height % BLOCK[1]), (0, -width % BLOCK[0]), (0, 0)), mode="edge")
        data, size = np.ascontiguousarray(image).tobytes(), (image.shape[1], image.shape[0])
        return self._lib.compress_bc5(data, *size) if kind == NORMAL else self._lib.compress_bc7(data, *size, self._effort)

    def dec_image(self, blocks, width, height, kind=COLOUR):
        """Return the RGBA image uint8 [H, W, 4] that blocks (bytes) hold. Raises ValueError if their number is wrong."""
        if len(blocks) != texture_bytes(width, height, BLOCK):
            raise ValueError(f"{len(blocks)} bytes are no image of {width} x {height} in blocks of 4 x 4")
        size = (width + -width % BLOCK[0], height + -height % BLOCK[1])
        mode, form = ("RGB", BC5) if kind == NORMAL else ("RGBA", BC7)
        decoded = np.asarray(Image.frombytes(mode, size, blocks, "bcn", (form,)))[:height, :width]
        return three_components(decoded[..., [0, 0, 0, 1]]) if kind == NORMAL else decoded
