"""What is bent: conformance vectors that are small enough, and what the loaders' own tests are made of."""

import os
from functools import lru_cache
from pathlib import Path

from texfcodec.bitstream.inspect import inspect
from texfcodec.limits import Limits

REPOSITORY = Path(__file__).resolve().parents[2]
VECTORS = REPOSITORY / "conformance"
SLOW = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")  # kernels run as plain Python: everything is smaller
MOST_VALUES, MOST_BYTES = (80, 1000) if SLOW else (600, 4500)
# A lying resolution may cost some milliseconds, no more.
SMALL = Limits(file_bytes=1 << 20, vertices=1 << 12, faces=1 << 12, voxels=1 << 12 if SLOW else 1 << 16,
               texels=1 << 12 if SLOW else 1 << 18, samples=1 << 13 if SLOW else 1 << 18, latents=1 << 10 if SLOW else 1 << 16,
               metadata_bytes=1 << 16)


@lru_cache(maxsize=1)
def vectors() -> list[bytes]:
    """Good vectors, the smallest first; compiled or not decides how large they may be."""
    found = []
    for folder in ("subset", "uncommon"):
        for path in sorted((VECTORS / folder).glob("*/in.texf")):
            data = path.read_bytes()
            facts = inspect(data)
            values = facts["voxels"] + facts["texels"]
            resolution = max(facts["resolution"] or 1, 1)
            if values <= MOST_VALUES and len(data) <= MOST_BYTES and resolution <= 64:
                found.append((values, len(data), path.parent.name, data))
    return [data for *_, data in sorted(found)]


@lru_cache(maxsize=8)
def vectors_with(codec: str = "", marks: bool = False) -> list[bytes]:
    """Those vectors with an attribute unit of a codec, or with marks of sharp edges."""
    chosen = []
    for data in vectors():
        facts = inspect(data)
        if (not codec or any(group["codec"] == codec for group in facts["groups"])) and (not marks or facts["sharp_edges"]):
            chosen.append(data)
    return chosen
