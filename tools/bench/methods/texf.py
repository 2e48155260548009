"""Our own codec as a method of rate_points.py."""

from dataclasses import fields

from texfcodec.codecs import codec_of
from texfcodec.geometry.surface import make_surface
from texfcodec.options import DEFAULT_CODEC, EncodeOptions
from tools.bench.methods import Method, draco_mesh, hash_of, method, source_hash, versions_of

STREAM, BAKED = "stream.texf", "baked.glb"
NOT_SETTINGS = {"threads", "measure", "limits", "checkpoint"}
WARM_RESOLUTION = 64


@method("texf")
class TexfMethod(Method):
    """texfcodec. Options are the fields of EncodeOptions. Bytes are those of the stream; of a 3DNTC payload those that a GPU
    keeps. "geometry" is what positions alone take as one mesh at the requested bits, as for UV rivals; the rest of the stream's
    geometry, for UVs, finer positions and further units, is "placement" and counts as texture. A GPU keeps its mesh in no
    stream: beside a 3DNTC payload all of the stream's geometry is "geometry"."""

    options = tuple(f.name for f in fields(EncodeOptions) if f.name not in NOT_SETTINGS)

    def version(self):
        """The version of DracoPy, and a hash of the file that counts positions."""
        return f"{versions_of('DracoPy')} {source_hash(draco_mesh.__file__)}"

    def warm_up(self, options, threads):
        """Code and decode two small sheets with these options, but with few voxels, no target, and one fit if the options allow
        fits; again over texels if they allow texels."""
        from texfcodec.api import decode, encode
        from texfcodec.precompile import small_scene

        kept = {k: v for k, v in options.items() if k not in ("target_bytes", "target_psnr", "target_psnr_of")}
        kept |= {"resolution": WARM_RESOLUTION, "threads": threads, "refine_iterations": 1}
        if codec_of(kept.get("codec", DEFAULT_CODEC)).joint:
            kept["steps"] = 1
        elif kept.get("refine", "auto") == "auto" and kept.get("effort") != "fast":
            kept["refine"] = "fit"
        decode(encode(small_scene(), EncodeOptions(**kept)))
        if EncodeOptions(**options).may_choose_texels:
            decode(encode(small_scene(), EncodeOptions(**kept | {"support": "texels"})))

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into STREAM."""
        from texfcodec.api import encode_to_result

        settings = EncodeOptions(**options, threads=threads)
        encoded = encode_to_result(scene, settings, report)
        (folder / STREAM).write_bytes(encoded.data)
        chosen, sizes = {"resolution": encoded.resolution, "qp": encoded.qp}, encoded.sizes
        if "resident" in encoded.choices:
            chosen = {"resolution": encoded.resolution, "fit": encoded.choices["fit"], "file_bytes": sizes}
            sizes = {"geometry": sizes["geometry"], **encoded.choices["resident"]}
            sizes["total"] += sizes["geometry"]
        elif encoded.counts["faces"]:
            alone = min(geometry_bytes(scene, settings.position_bits), sizes["geometry"])
            sizes = sizes | {"geometry": alone, "placement": sizes["geometry"] - alone}
        return {"bytes": sizes, "reconstruction_sha256": encoded.reconstruction_sha256, **encoded.counts,
                "texels_per_voxel_edge": encoded.texels_per_voxel_edge, "refinement": encoded.choices["refinement"],
                "supports": [group["chosen"] for group in encoded.choices["supports"]["groups"]], **chosen}

    def decode(self, folder, options, threads, report):
        """Return the Texf decoded from STREAM."""
        from texfcodec.api import decode
        from texfcodec.options import DecodeOptions

        return decode((folder / STREAM).read_bytes(), DecodeOptions(threads=threads), report)

    def values_sha256(self, decoded):
        """Return the hash that the encoder gives as Encoded.reconstruction_sha256: by field and channel, the keys as 64-bit
        little-endian numbers, then the values uint8 [N, C]."""
        return hash_of(*(part for field in decoded.fields for plane in field.planes.values() for part in (field.keys, plane)))


@method("texf_baked")
class TexfBakedMethod(TexfMethod):
    """The stream of texf, decoded as for a viewer that has images alone: baked into a GLB with an atlas, which costs no bytes,
    because the receiver makes it."""

    def decode(self, folder, options, threads, report):
        """Return the Scene of the GLB baked from STREAM."""
        from texfcodec.io.load import load

        self._texf = super().decode(folder, options, threads, report)
        with report.stage("bake"):
            self._texf.save(folder / BAKED)
        return load(str(folder / BAKED))

    def values_sha256(self, decoded):
        """Return the hash of the Texf that was decoded before it was baked."""
        return super().values_sha256(self._texf)


def geometry_bytes(scene, position_bits):
    """Return the bytes of draco_mesh.positions_alone() for a Scene on a lattice of position_bits."""
    surface = make_surface(scene, EncodeOptions(position_bits=position_bits))
    return draco_mesh.positions_alone(surface.lattice, surface.faces)
