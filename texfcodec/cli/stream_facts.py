"""Facts about an encoded stream for --json: of OUT.texf, and of each stream of a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..encoder.write import Encoded
    from ..options import EncodeOptions


def stream_facts(encoded: Encoded, options: EncodeOptions) -> dict[str, Any]:
    """Return counts, bytes, PSNR and check of a stream, and every choice of the encoder with its evidence (Encoded.choices)."""
    from ..bitstream.inspect import inspect

    psnr = encoded.psnr_3d
    facts = {"bytes": encoded.sizes, "resolution": encoded.resolution, "qp": encoded.qp, "max_error": options.max_error,
             **encoded.counts, "codec": options.codec, "texels_per_voxel_edge": round(encoded.texels_per_voxel_edge, 3),
             "psnr_3d": psnr and {name: psnr[name] for name in ("y", "yuv611", "rgb")}, "psnr_samples": psnr and psnr["samples"],
             "check": encoded.check, **encoded.choices}
    for channel, group in zip(facts.get("channels", []), inspect(encoded.data)["groups"], strict=False):
        channel["bytes"] = group["bytes"]
    return facts
