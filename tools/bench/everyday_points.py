"""Our side of everyday.py: an asset coded at each rate preset and looked at in the metric's views."""

import time
from dataclasses import fields

from texfcodec.api import decode, encode_to_result
from texfcodec.core.json_text import json_ready
from texfcodec.io.load import load
from texfcodec.metrics.views import compare_views
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report

VIEWS, SIZE = 16, 1024
TRUTHS = {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}


def setting_of(text):
    """(name, value) of "name=value" for EncodeOptions, the value of the type that its option takes. Ends the program where there
    is no such option or it takes no such value."""
    name, equals, value = text.partition("=")
    option = {f.name: f for f in fields(EncodeOptions)}.get(name)
    if not equals or option is None:
        raise SystemExit(f"{text!r} sets no option of EncodeOptions: write name=value")
    told = option.metadata
    try:
        if "switch" in told:
            return name, TRUTHS[value.lower()]
        if "range" in told:
            return name, (int if isinstance(told["range"][0], int) else float)(value)
    except (KeyError, ValueError):
        raise SystemExit(f"{name} cannot be {value!r}") from None
    return name, value


def measured_asset(path, rates, settings, threads):
    """The record of one asset: {"asset", "settings", "points"}; settings: dict for EncodeOptions beside the rate."""
    scene = load(str(path))
    return {"asset": path.stem, "settings": settings, "points": [point(scene, rate, settings, threads) for rate in rates]}


def point(scene, rate, settings, threads):
    """One rate of a Scene: {"rate", "total", "geometry", "attributes", "y", "rgb", "yuv", "encode_seconds"}. total is the length
    of the stream; PSNR in dB, None where the pictures are exact."""
    begin = time.perf_counter()
    made = encode_to_result(scene, EncodeOptions(rate=rate, threads=threads, **settings))
    seconds = time.perf_counter() - begin
    texf = decode(made.data, DecodeOptions(threads=threads), Report())
    psnr = compare_views(scene, texf, views=VIEWS, size=SIZE, threads=threads)["psnr"]
    sizes = {"total": len(made.data), **{name: made.sizes[name] for name in ("geometry", "attributes")}}
    return {"rate": rate, **sizes, **rounded(psnr), "encode_seconds": round(seconds, 1)}


def rounded(psnr):
    """{"y", "rgb", "yuv"} in dB to three digits, None where a match is exact; psnr: dict that holds them."""
    psnr = json_ready({name: psnr[name] for name in ("y", "rgb", "yuv")})
    return {name: None if value is None else round(value, 3) for name, value in psnr.items()}
