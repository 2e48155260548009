"""Images as JPEG if that adds hardly any error to that of the stream, else as PNG.

A stream does not state its error. A JPEG that quantises the same picture by the same step has an error of similar size, because
both drop detail below the step. Squared errors of luma in texels at r03, of the stream and of such a JPEG: 22 and 9.4 (cat_webp),
14 and 7.2 (damaged_helmet), 4.0 and 2.3 (ycb_scissors), 2.7 and 0.9 (avocado).
"""

import io
from itertools import takewhile

import numpy as np

from .formats import IMAGE_FORMATS, ImageFormat
from .images import encode_jpeg, some_rows

# The stream's error is taken for so much of that JPEG's, and so much of what its step would make in noise.
_OF_JPEG, _OF_NOISE = 1.5, 0.06
ADDED = 0.045  # of it that a JPEG may add
_SHARES = (0.3, 0.25, 0.2, 0.175, 0.15, 0.125, 0.1, 0.0)  # of the step, that are tried; a JPEG has none below 1
LEAST_STEP = 4.0  # below it the rounding of JPEG's own colour transform is too much
_TILE, _TILES = 64, 64  # texels a side of what is looked at, and how many of these
_FEW = 4  # every so manyth row and column of the tiles is looked at first: Pillow takes seconds for a picture of many colours
# Of every so manyth row and column of a whole picture, and so many times the error that is allowed: beyond it the whole, for
# which Pillow takes up to 1.4 s, is not tried
_THIN, _CLOSE = 8, 1.25
_PALETTES = (256, 128, 64, 32, 16)  # numbers of colours that are tried
_BANDS, _CLEARLY = 4, 1.5  # every fourth band of tiles tells how large a PNG gets; so many times a JPEG, fewer rows do
_LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)


def automatic_image(image: np.ndarray, step: float | None, srgb: bool = True) -> tuple[ImageFormat, bytes]:
    """Encode an image as the smaller of PNG and JPEG and return (format, bytes). JPEG must cost less than 0.2 dB.

    image: uint8 [H, W, 3 or 4]; step: quantiser step of its values in levels of 255, 0 for exact values, None if unknown; srgb:
    whether it holds colours, whose error is measured in luma. An image is PNG if it has alpha, exact values or few colours.
    """
    palette = None if image.shape[2] == 4 else palette_of(image)
    if image.shape[2] == 4 or not step:
        return IMAGE_FORMATS["png"], _png(image, palette)
    tiles = _tiles(image)
    allowed = ADDED * (_OF_JPEG * _jpeg_error(tiles, step, srgb) + _OF_NOISE * step * step / 12)
    palette = _near_palette(image, tiles, allowed, srgb) or palette
    own = _jpeg_step(tiles, allowed, step, srgb) if palette is None else None
    if own is None:
        return IMAGE_FORMATS["png"], _png(image, palette)
    packed = encode_jpeg(image, **_jpeg_settings(own))
    if _png_size(image, some_rows(len(image))) > _CLEARLY * len(packed) or _png_size(image, _bands(len(image))) > len(packed):
        return IMAGE_FORMATS["jpeg"], packed
    exact = _png(image, None)
    return (IMAGE_FORMATS["png"], exact) if len(exact) <= len(packed) else (IMAGE_FORMATS["jpeg"], packed)


def _near_palette(image, tiles, allowed, srgb):
    """Palette as of palette_of(), with the fewest colours whose mean squared error is at most `allowed`; None if 256 exceed it.
    Drawn images have few colours below the noise of coding."""
    few, thin = tiles[::_FEW, ::_FEW], image[::_THIN, ::_THIN]
    if _error(few, _quantised(few, _PALETTES[0])[1], srgb) > allowed:  # what does not do for a part, does not for the whole
        return None
    counts = list(takewhile(lambda count: _error(tiles, _quantised(tiles, count)[1], srgb) <= allowed, _PALETTES))
    for count in reversed(counts):
        if _error(thin, _quantised(thin, count)[1], srgb) > _CLOSE * allowed:
            continue
        picture, shown = _quantised(image, count)
        if _error(image, shown, srgb) <= allowed:
            return np.array(picture.getpalette(), np.uint8).reshape(-1, 3), np.asarray(picture)
    return None


def _quantised(image, count):
    """(PIL image with `count` colours, the same as uint8 [H, W, 3])."""
    from PIL import Image

    picture = Image.fromarray(image).quantize(count, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    return picture, np.asarray(picture.convert("RGB"))


def _jpeg_step(tiles, allowed, step, srgb):
    """The largest step of a JPEG whose mean squared error is at most `allowed`, or None."""
    if step < LEAST_STEP:
        return None
    for own in dict.fromkeys(max(share * step, 1.0) for share in _SHARES):
        if _jpeg_error(tiles, own, srgb) <= allowed:
            return own
    return None


def _tiles(image):
    """Square tiles from all over an image, stacked vertically: uint8 [n, _TILE, 3]. Tiles of a single colour are skipped."""
    height, width = (size // _TILE * _TILE for size in image.shape[:2])
    if not height or not width:
        return image
    split = image[:height, :width].reshape(height // _TILE, _TILE, width // _TILE, _TILE, 3).swapaxes(1, 2)
    split = split.reshape(-1, _TILE, _TILE, 3)
    busy = np.flatnonzero(np.ptp(split[:, ::4, ::4], axis=(1, 2)).any(axis=1))
    busy = busy if len(busy) else np.arange(len(split))
    return split[busy[np.linspace(0, len(busy) - 1, min(_TILES, len(busy))).astype(np.int64)]].reshape(-1, _TILE, 3)


def _jpeg_error(image, step, srgb):
    """Mean squared error of an image as JPEG with this step."""
    from PIL import Image

    plain = io.BytesIO()
    Image.fromarray(image).save(plain, "JPEG", **_jpeg_settings(step))
    return _error(image, np.asarray(Image.open(plain)), srgb)


def _error(image, other, srgb):
    """Mean squared error between two images, of luma if they hold colours."""
    off = image.astype(np.float32) - other
    return float(((off @ _LUMA) ** 2).mean() if srgb else (off**2).mean())


def _jpeg_settings(step):
    """Keywords of Pillow's save(): flat quantisation tables, which suit the squared error, finer at low frequencies if step is
    not a whole number; chroma at full resolution, because charts make edges of colour everywhere."""
    low = min(int(step), 254)
    coarse = round(64 * min(step - low, 1))
    table = [low] * (64 - coarse) + [low + 1] * coarse
    return {"qtables": [table, table], "subsampling": 0}


def _png_size(image, rows):
    """Bytes of an image as PNG, estimated by some of its rows."""
    return len(_png(image[rows], None)) * len(image) // len(rows)


def _bands(height):
    """A quarter of the rows of an image, all of a small one."""
    return np.flatnonzero((np.arange(height) // _TILE % _BANDS == 0) | (height <= _BANDS * _TILE))


def _png(image, palette):
    """PNG bytes, 17 % smaller than those of encode_image() in twice the time."""
    from PIL import Image

    picture, out = Image.fromarray(image if palette is None else palette[1]), io.BytesIO()
    if palette is not None:
        picture = Image.fromarray(palette[1], "P")
        picture.putpalette(palette[0].tobytes())
    picture.save(out, "PNG", compress_level=6)
    return out.getvalue()


def palette_of(image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the palette of an image, uint8 [H, W, 3]: (colours uint8 [n, 3], index of each texel's colour uint8 [H, W]); None if
    the image has more than 256 colours."""
    packed = image[..., 0].astype(np.int32) << 16 | image[..., 1].astype(np.int32) << 8 | image[..., 2]
    if len(np.unique(packed[:: max(1, len(packed) // 16)])) > 256:
        return None
    seen = np.zeros(1 << 24, bool)
    seen[packed] = True
    colours = np.flatnonzero(seen)
    if len(colours) > 256:
        return None
    number = np.zeros(1 << 24, np.uint8)
    number[colours] = np.arange(len(colours))
    return np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1).astype(np.uint8), number[packed]
