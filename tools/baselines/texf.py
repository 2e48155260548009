"""Our own codec as a method of rate_points.py."""

import hashlib
from dataclasses import fields

import numpy as np

from baselines import Method, method
from texfcodec.options import EncodeOptions

STREAM, FACE_FIELD = "stream.texf", "face_field.npz"
NOT_SETTINGS = {"threads", "measure", "limits", "checkpoint"}
WARM_RESOLUTION = 64
KEPT_FACTS = ("voxels", "faces", "vertices", "fields", "texels_per_voxel_edge", "resolution", "qp", "refinement")


@method("texf")
class TexfMethod(Method):
    """Options are the fields of EncodeOptions; the defaults are the package's. Bytes are those of the stream, of a 3DNTC payload
    those that a GPU keeps."""

    options = tuple(f.name for f in fields(EncodeOptions) if f.name not in NOT_SETTINGS)

    def warm_up(self, options, threads):
        """Codes and decodes two small sheets under the same options, but with few voxels, without a target, and with a fit where
        the asset may get one."""
        from texfcodec.api import decode, encode
        from texfcodec.warmup import small_scene

        kept = {k: v for k, v in options.items() if k not in ("target_bytes", "target_psnr")}
        kept |= {"resolution": WARM_RESOLUTION, "threads": threads, "refine_iterations": 1, "steps": 1}
        if kept.get("refine", "auto") == "auto" and kept.get("effort") != "fast" and kept.get("codec") != "3dntc":
            kept["refine"] = "fit"
        decode(encode(small_scene(), EncodeOptions(**kept)))

    def encode(self, scene, options, folder, threads, report):
        """Writes STREAM and FACE_FIELD."""
        from texfcodec.api import encode

        settings = EncodeOptions(**options, threads=threads)
        data, made = encode(scene, settings, report), report.facts
        (folder / STREAM).write_bytes(data)
        np.savez_compressed(folder / FACE_FIELD, face_field=made["scene_face_field"])
        asked, sizes = {"resolution": settings.resolution, "qp": settings.qp}, made["bytes"]
        if settings.codec == "3dntc":
            asked = {"resolution": settings.resolution, "fit": made["fit"], "file_bytes": sizes}
            sizes = {"geometry": sizes["geometry"], **made["resident"]}
            sizes["total"] += sizes["geometry"]
        return {"bytes": sizes, "reconstruction_sha256": made["reconstruction_sha256"],
                **asked, **{name: made[name] for name in KEPT_FACTS if name in made}}

    def decode(self, folder, options, threads, report):
        """The Texf of STREAM."""
        from texfcodec.api import decode
        from texfcodec.options import DecodeOptions

        return decode((folder / STREAM).read_bytes(), DecodeOptions(threads=threads), report)

    def values_sha256(self, decoded):
        """As report.facts["reconstruction_sha256"] of the encoder: field by field and channel group by channel group, the keys
        as 64-bit little-endian numbers, then the uint8 values [N, C]."""
        total = hashlib.sha256()
        for field in decoded.fields:
            for channels in (slice(0, 3), slice(3, 4))[: 2 if decoded.has_alpha else 1]:
                total.update(np.ascontiguousarray(field.keys, "<i8"))
                total.update(np.ascontiguousarray(field.rgba[:, channels]))
        return total.hexdigest()

    def face_field(self, folder):
        """What the encoder said."""
        with np.load(folder / FACE_FIELD) as file:
            return file["face_field"]
