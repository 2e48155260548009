"""Still images by the codecs that rivals take: real encoders and decoders, and no byte that such an encoder does not need.

CODECS names them with what `quality` means, the range it may have and the step by which one gets better:

    hevc  QP of the one I frame. libx265 through PyAV: preset slow without psychovisual terms, which gives 7 % fewer bytes for
          0.1 dB on bball_0001 (about 4 % at equal PSNR); ipratio=1.0, without which the I frame has a lower QP than asked for;
          info=0, without which 2.3 KB of SEI stand in the stream. Bytes are those of the raw Annex B stream.
    av1   CQ level. libaom through Pillow's AVIF: speed 3, tuned for PSNR, with the filters CDEF and loop restoration, which
          libaom leaves out for still images. On a crop of bball_0001 its BD-rate (PSNR Y) against hevc is +20 % as Pillow has it
          (tune=iq, speed 4), -1 % tuned for PSNR, -6 % with both filters; -4 % without them at speed 3. Bytes are those of the
          temporal unit in the AVIF file, decoded by libdav1d.
    avif  the same with the bytes of the file; alpha is AVIF's own.
    webp  quality; Pillow, method 6; chroma is always 4:2:0.
    avif6, webp4  quality; as Pillow users have them, speed 6 and method 4; an image of equal columns is coded as grey.
    jpeg  quality; Pillow, progressive with optimised Huffman tables.
    jxl   Butteraugli distance, smaller is better; libjxl through imagecodecs, effort 7, a bare codestream; chroma always 4:4:4.
    etc1s, uastc  quality; KTX2 by Basis Universal's encoder through alktx2, effort 3, the largest level alone, UASTC under
          Zstandard; chroma 4:2:0 marks colours, whose errors are weighed by luma.

HEVC gets BT.709 with full range; Pillow's AVIF writes BT.601 with full range. Matrices are applied in float32; chroma is halved
and doubled by Pillow's Lanczos filter with samples in the middle of their four (47.41 dB on a crop of bball_0001 that is not
coded, against 47.01 with means and bilinear look-ups). AV1's chroma is halved by libavif, and doubled as here. Sides that are
odd, or shorter than what an encoder takes, are continued by repetition of the border.

Alpha of hevc, av1, jpeg and jxl is a grey image of its own, of the same codec and quality: RGBA_MARK, the length of the colour
as 32-bit little-endian number, colour, alpha. All of these count.
"""

import io
from fractions import Fraction
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from PIL import Image, features

from tools.bench.methods import versions_of

RIVALS = 'pip install "texfcodec[rivals]" brings it'


class Codec(NamedTuple):
    """An image codec. quality: what the number means; low, high: its range; needs: what codes; alpha: whether it codes alpha."""

    quality: str
    low: float
    high: float
    needs: str
    alpha: bool = False


CODECS = {
    "hevc": Codec("QP", 0, 51, "x265"),
    "av1": Codec("CQ level", 0, 63, "aom and dav1d"),
    "avif": Codec("CQ level", 0, 63, "aom", True),
    "webp": Codec("quality", 0, 100, "webp", True),
    "avif6": Codec("quality", 0, 100, "aom", True),
    "webp4": Codec("quality", 0, 100, "webp", True),
    "jpeg": Codec("quality", 1, 95, "jpeg"),
    "jxl": Codec("distance", 0, 25, "jxl"),
    "etc1s": Codec("quality", 1, 100, "basisu", True),
    "uastc": Codec("quality", 1, 100, "basisu", True),
}
CHROMAS = ("420", "444")
# What codes slower or faster, where enc_image() is not given another.
EFFORTS = {"hevc": "slow", "av1": 3, "avif": 3, "webp": 6, "avif6": 6, "webp4": 4, "jxl": 7, "etc1s": 3, "uastc": 3}
ZSTD_LEVEL = 18
AV1_TUNING = {"tune": "psnr", "enable-cdef": "1", "enable-restoration": "1"}
LEAST_SIDE = 16  # texels
RGBA_MARK = b"RGBA"
BT709, BT601 = (0.2126, 0.0722), (0.299, 0.114)  # weights of red and blue
NEUTRAL = 128


def missing(codec):
    """Return a sentence on what a codec of CODECS needs that is not installed, and how to get it; None if nothing is missing."""
    needs = CODECS[codec].needs
    try:
        if needs in ("x265", "aom and dav1d"):
            import av

            wanted = "libx265" if needs == "x265" else "libdav1d"
            if wanted not in av.codecs_available:
                return f"{codec} needs a PyAV with {wanted}: its own wheels have it"
        if needs == "jxl":
            import imagecodecs

            if not imagecodecs.JPEGXL.available:
                return f"{codec} needs imagecodecs with libjxl: its own wheels have it"
        if needs == "basisu":
            import alktx2  # noqa: F401
            import opengl_basisu  # noqa: F401
    except ImportError as error:
        return f"{codec} needs {error.name}; {RIVALS}: {error}"
    if needs.startswith("aom") and not (features.check("avif") and _encodes_by_aom()):
        return f"{codec} needs a Pillow with AVIF by libaom, version 11.3 or later; {RIVALS}"
    if needs == "webp" and not features.check("webp"):
        return f"{codec} needs a Pillow with WebP: its own wheels have it"
    return None


def _encodes_by_aom():
    from PIL import _avif

    return bool(_avif.encoder_codec_available("aom"))


def versions(codec):
    """Return the names and versions of the libraries that the bytes of a codec depend on."""
    packages = {"x265": ("av",), "aom and dav1d": ("pillow", "av"), "jxl": ("imagecodecs",), "basisu": ("alktx2",)}
    return versions_of(*packages.get(CODECS[codec].needs, ("pillow",)))


def check(codec, quality, chroma="420"):
    """Raise ValueError if an argument of enc_image() is out of range, LookupError if something is not installed."""
    if codec not in CODECS:
        raise ValueError(f"codec must be one of {', '.join(CODECS)}, not {codec!r}")
    meaning, low, high = CODECS[codec][:3]
    whole = codec == "jxl" or isinstance(quality, int)
    if isinstance(quality, bool | str) or not whole or not low <= quality <= high:
        raise ValueError(f"quality of {codec} must be a {meaning} from {low} to {high}, not {quality!r}")
    if chroma not in CHROMAS:
        raise ValueError(f"chroma must be one of {', '.join(CHROMAS)}, not {chroma!r}")
    if sentence := missing(codec):
        raise LookupError(sentence)


def enc_image(image, codec, quality, chroma="420", threads=1, effort=None):
    """Return the bytes of an image in a codec.

    image: uint8 [H, W, 3 or 4], alpha straight; codec: of CODECS, which says what quality is; chroma: "420" or "444", if the
    codec has a choice; threads: of libaom and libjxl, without effect on the bytes. Raises ValueError, LookupError as check().
    """
    check(codec, quality, chroma)
    image = np.ascontiguousarray(image, np.uint8)
    enc = partial(_ENC[codec], effort=EFFORTS.get(codec) if effort is None else effort)
    if image.shape[2] == 3 or CODECS[codec].alpha:
        return enc(image, quality, chroma, threads)
    colour = enc(np.ascontiguousarray(image[..., :3]), quality, chroma, threads)
    alpha = enc(np.ascontiguousarray(image[..., 3]), quality, chroma, threads)
    return RGBA_MARK + len(colour).to_bytes(4, "little") + colour + alpha


def dec_image(data, codec, width, height):
    """Return the image uint8 [height, width, 4] of enc_image()'s bytes, with alpha 255 if it had none."""
    dec = _DEC[codec]
    if data[:4] != RGBA_MARK:
        image = dec(data)[:height, :width]
        rows = image if image.shape[2] == 4 else np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])
        return np.ascontiguousarray(rows)
    end = 8 + int.from_bytes(data[4:8], "little")
    colour, alpha = dec(data[8:end])[:height, :width], dec(data[end:])[:height, :width, :1]
    return np.dstack([colour, alpha])


def grown(image):
    """Return an image [H, W, ...] padded to even sides of at least LEAST_SIDE by repetition of its border."""
    after = [max(side + side % 2, LEAST_SIDE) - side for side in image.shape[:2]]
    return np.pad(image, [(0, n) for n in after] + [(0, 0)] * (image.ndim - 2), mode="edge")


# Colours.


def to_yuv(rgb, weights, chroma):
    """Return full-range planes uint8 of an image uint8 [H, W, 3]. weights: of red and blue in luma; chroma: "420" or "444"."""
    red, blue = weights
    rgb = rgb.astype(np.float32)
    y = rgb @ np.float32([red, 1 - red - blue, blue])
    planes = [y, (rgb[..., 2] - y) / (2 - 2 * blue) + NEUTRAL, (rgb[..., 0] - y) / (2 - 2 * red) + NEUTRAL]
    if chroma == "420":
        planes[1:] = [_resized(plane, (y.shape[0] // 2, y.shape[1] // 2)) for plane in planes[1:]]
    return [_bytes(plane) for plane in planes]


def from_yuv(planes, weights):
    """Return the image uint8 [H, W, 3] of to_yuv()'s planes, or of luma alone. weights: those of to_yuv()."""
    y = planes[0].astype(np.float32)
    if len(planes) == 1:
        return np.repeat(planes[0][..., None], 3, axis=2)
    u, v = (_resized(plane.astype(np.float32), y.shape) - NEUTRAL for plane in planes[1:])
    red, blue = weights
    r, b = y + (2 - 2 * red) * v, y + (2 - 2 * blue) * u
    return _bytes(np.dstack([r, (y - red * r - blue * b) / (1 - red - blue), b]))


def _resized(plane, shape):
    """A plane float32 [H, W] of another shape; the same where it has that already."""
    if plane.shape == shape:
        return plane
    return np.asarray(Image.fromarray(plane).resize(shape[::-1], Image.Resampling.LANCZOS))


def _bytes(values):
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


# Video codecs.


def _enc_hevc(image, quality, chroma, threads, effort):
    """image: uint8 [H, W, 3], or [H, W] for luma alone. One thread: several would change the bytes."""
    import av

    image = grown(image)
    planes, form = ([image], "gray") if image.ndim == 2 else (to_yuv(image, BT709, chroma), f"yuv{chroma}p")
    context = av.CodecContext.create("libx265", "w")
    context.width, context.height, context.pix_fmt = image.shape[1], image.shape[0], form
    context.time_base, context.thread_count = Fraction(1), 1
    x265_params = f"qp={quality}:ipratio=1.0:info=0:keyint=1:psy-rd=0:psy-rdoq=0:pools=none:frame-threads=1:log-level=none"
    context.options = {"preset": effort, "x265-params": x265_params}
    return b"".join(bytes(packet) for packet in [*context.encode(_frame(planes, form)), *context.encode(None)])


def _dec_hevc(data):
    return from_yuv(_planes(data, "hevc"), BT709)


def _frame(planes, form):
    import av

    frame = av.VideoFrame(planes[0].shape[1], planes[0].shape[0], form)
    for to, plane in zip(frame.planes, planes, strict=True):
        rows = np.zeros((plane.shape[0], to.line_size), np.uint8)
        rows[:, : plane.shape[1]] = plane
        to.update(rows)
    return frame


def _planes(data, decoder):
    """The planes, uint8 [H, W], of the one frame of a stream."""
    import av

    context = av.CodecContext.create(decoder, "r")
    frames = [*context.decode(av.Packet(data)), *context.decode(None)]
    if len(frames) != 1:
        raise ValueError(f"{decoder} decoded {len(frames)} frames in place of one")
    return [np.frombuffer(p, np.uint8).reshape(-1, p.line_size)[: p.height, : p.width] for p in frames[0].planes]


def _enc_avif(image, quality, chroma, threads, effort):
    """image: uint8 [H, W], [H, W, 3] or [H, W, 4]. quality: CQ level, which libavif derives from its own of 0 to 100."""
    own = next(q for q in range(101) if ((100 - q) * 63 + 50) // 100 == quality)
    sampling = "4:0:0" if image.ndim == 2 else ":".join(chroma)
    return _saved(image, "AVIF", quality=own, speed=effort, subsampling=sampling, codec="aom", max_threads=threads,
                  autotiling=False, advanced=AV1_TUNING)


def _enc_av1(image, quality, chroma, threads, effort):
    return av1_payload(_enc_avif(grown(image), quality, chroma, threads, effort))


def _dec_av1(data):
    return from_yuv(_planes(data, "libdav1d"), BT601)


def av1_payload(avif):
    """Return the AV1 temporal unit (bytes of the mdat box) of an AVIF file with one image and no alpha."""
    at = 0
    while at + 8 <= len(avif):
        size, kind = int.from_bytes(avif[at : at + 4], "big"), avif[at + 4 : at + 8]
        if kind == b"mdat":
            return avif[at + 8 : at + size if size else None]
        at += max(size, 8)
    raise ValueError("the AVIF file has no mdat box")


# Codecs of still images.


def _enc_webp(image, quality, chroma, threads, effort):
    return _saved(image, "WEBP", quality=quality, method=effort)


def _enc_avif6(image, quality, chroma, threads, effort):
    image = _as_grey(image)
    sampling = "4:0:0" if image.ndim == 2 else ":".join(chroma)
    return _saved(image, "AVIF", quality=quality, speed=effort, subsampling=sampling, max_threads=threads)


def _enc_webp4(image, quality, chroma, threads, effort):
    return _saved(_as_grey(image), "WEBP", quality=quality, method=effort)


def _as_grey(image):
    """One column of an image of equal ones, [H, W]; the image where it has others or alpha."""
    is_grey = image.ndim == 3 and image.shape[2] == 3 and (image[..., :1] == image[..., 1:]).all()
    return np.ascontiguousarray(image[..., 0]) if is_grey else image


def _enc_jpeg(image, quality, chroma, threads, effort):
    return _saved(image, "JPEG", quality=quality, optimize=True, progressive=True, subsampling=0 if chroma == "444" else 2)


def _saved(image, form, **options):
    out = io.BytesIO()
    Image.fromarray(image).save(out, form, **options)
    return out.getvalue()


def _dec_pillow(data):
    picture = Image.open(io.BytesIO(data))
    return np.asarray(picture.convert("RGBA" if "A" in picture.mode else "RGB"))


def _enc_jxl(image, quality, chroma, threads, effort):
    import imagecodecs

    return bytes(imagecodecs.jpegxl_encode(image, distance=quality, effort=effort, usecontainer=False, numthreads=threads))


def _dec_jxl(data):
    import imagecodecs

    image = imagecodecs.jpegxl_decode(data)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def _enc_basisu(image, quality, chroma, threads, effort, codec):
    import alktx2

    height, width, columns = image.shape
    rgba = np.full((height, width, 4), 255, np.uint8)
    rgba[..., :columns] = image
    return alktx2.encode_raw_rgba_to_ktx2(rgba.tobytes(), width, height, columns == 4, codec=codec, quality=quality,
                                          effort=effort, threads=threads, srgb=chroma == "420", linear=chroma != "420",
                                          zstd_supercompression_level=ZSTD_LEVEL)


def _dec_basisu(data):
    from texfcodec.io.ktx2 import read_ktx2

    return read_ktx2(data, "", SimpleNamespace(warn=str, check_pixels=lambda *_: None))


_ENC = {"hevc": _enc_hevc, "av1": _enc_av1, "avif": _enc_avif, "avif6": _enc_avif6, "webp": _enc_webp, "webp4": _enc_webp4,
        "jpeg": _enc_jpeg, "jxl": _enc_jxl, **{codec: partial(_enc_basisu, codec=codec) for codec in ("etc1s", "uastc")}}
_DEC = dict.fromkeys(("avif", "avif6", "webp", "webp4", "jpeg"), _dec_pillow) | dict.fromkeys(("etc1s", "uastc"), _dec_basisu) | {
    "hevc": _dec_hevc, "av1": _dec_av1, "jxl": _dec_jxl}
