"""Our own codec as a method of rate_points.py."""

import hashlib
from dataclasses import fields

import numpy as np

from baselines import Method, method
from texfcodec.codecs import codec_of
from texfcodec.options import DEFAULT_CODEC, EncodeOptions

STREAM, FACE_FIELD, BAKED = "stream.texf", "face_field.npz", "baked.glb"
NOT_SETTINGS = {"threads", "measure", "limits", "checkpoint"}
WARM_RESOLUTION = 64


@method("texf")
class TexfMethod(Method):
    """Options are the fields of EncodeOptions; the defaults are the package's. Bytes are those of the stream, of a 3DNTC payload
    those that a GPU keeps. "geometry" is what positions alone would take, as it is for rivals that need UVs; what the stream's
    geometry takes beyond, for UVs, finer positions and further units, is "placement" and counts with the texture."""

    options = tuple(f.name for f in fields(EncodeOptions) if f.name not in NOT_SETTINGS)

    def warm_up(self, options, threads):
        """Codes and decodes two small sheets under the same options, but with few voxels, without a target, and with a fit where
        the asset may get one; and over texels, where the asset may get them."""
        from texfcodec.api import decode, encode
        from texfcodec.warmup import small_scene

        kept = {k: v for k, v in options.items() if k not in ("target_bytes", "target_psnr")}
        kept |= {"resolution": WARM_RESOLUTION, "threads": threads, "refine_iterations": 1}
        if codec_of(kept.get("codec", DEFAULT_CODEC)).joint:
            kept["steps"] = 1
        elif kept.get("refine", "auto") == "auto" and kept.get("effort") != "fast":
            kept["refine"] = "fit"
        decode(encode(small_scene(), EncodeOptions(**kept)))
        if EncodeOptions(**options).may_choose_texels:
            decode(encode(small_scene(), EncodeOptions(**kept | {"support": "texels"})))

    def encode(self, scene, options, folder, threads, report):
        """Writes STREAM and FACE_FIELD."""
        from texfcodec.api import encode_to_result

        settings = EncodeOptions(**options, threads=threads)
        made = encode_to_result(scene, settings, report)
        (folder / STREAM).write_bytes(made.data)
        np.savez_compressed(folder / FACE_FIELD, face_field=made.face_field)
        asked, sizes = {"resolution": made.resolution, "qp": made.qp}, made.sizes
        if "resident" in made.choices:
            asked = {"resolution": made.resolution, "fit": made.choices["fit"], "file_bytes": sizes}
            sizes = {"geometry": sizes["geometry"], **made.choices["resident"]}
            sizes["total"] += sizes["geometry"]
        elif made.counts["texels"] or made.counts["fields"] > 1:
            alone = min(positions_alone(scene, settings.position_bits), sizes["geometry"])
            sizes = sizes | {"geometry": alone, "placement": sizes["geometry"] - alone}
        return {"bytes": sizes, "reconstruction_sha256": made.reconstruction_sha256, **made.counts,
                "texels_per_voxel_edge": made.texels_per_voxel_edge, "refinement": made.choices["refinement"],
                "supports": [group["chosen"] for group in made.choices["supports"]["groups"]], **asked}

    def decode(self, folder, options, threads, report):
        """The Texf of STREAM."""
        from texfcodec.api import decode
        from texfcodec.options import DecodeOptions

        return decode((folder / STREAM).read_bytes(), DecodeOptions(threads=threads), report)

    def values_sha256(self, decoded):
        """As Encoded.reconstruction_sha256 of the encoder: field by field and channel by channel, the keys
        as 64-bit little-endian numbers, then the uint8 values [N, C]."""
        total = hashlib.sha256()
        for field in decoded.fields:
            for plane in field.planes.values():
                total.update(np.ascontiguousarray(field.keys, "<i8"))
                total.update(np.ascontiguousarray(plane))
        return total.hexdigest()

    def face_field(self, folder):
        """What the encoder said."""
        with np.load(folder / FACE_FIELD) as file:
            return file["face_field"]


@method("texf_baked")
class TexfBakedMethod(TexfMethod):
    """The same stream as a viewer shows it that knows images alone: baked into a GLB with an atlas of its own, which costs
    nothing, because the receiver makes it."""

    def decode(self, folder, options, threads, report):
        """The Scene of the baked GLB."""
        from texfcodec.asset.load.files import load

        self._texf = super().decode(folder, options, threads, report)
        with report.stage("bake"):
            self._texf.save(folder / BAKED)
        return load(str(folder / BAKED))

    def values_sha256(self, decoded):
        """Of what was decoded before it was baked."""
        return super().values_sha256(self._texf)

    def face_field(self, folder):
        """None: a mesh has no fields."""
        return None


def positions_alone(scene, position_bits):
    """Draco bytes of a Scene's positions and faces without UVs and colours: one mesh, or one per material, whichever is less."""
    from tools.everyday_rivals import draco_bytes, rival_of

    return draco_bytes(rival_of(scene, position_bits), None, None)
