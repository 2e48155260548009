"""Our own codec as a method of rate_points.py."""

from contextlib import contextmanager
from dataclasses import fields

from texfcodec.codecs import codec_of
from texfcodec.geometry.surface import make_surface
from texfcodec.options import DEFAULT_CODEC, EncodeOptions
from tools.bench.methods import Method, draco_mesh, hash_of, method, source_hash, versions_of

STREAM, BAKED = "stream.texf", "baked.glb"
NOT_SETTINGS = {"threads", "measure", "limits", "checkpoint"}
WARM_RESOLUTION = 64


@contextmanager
def transfer_density(density):
    """The transfer's most samples per voxel edge, for a while; None changes nothing."""
    from texfcodec.encoder.values import source_field

    usual, fitted = dict(source_field.TRANSFER_DENSITY), source_field.FITTED_DENSITY
    if density is not None:
        source_field.TRANSFER_DENSITY.update(dict.fromkeys(usual, density))
        source_field.FITTED_DENSITY = density
    try:
        yield
    finally:
        source_field.TRANSFER_DENSITY.update(usual)
        source_field.FITTED_DENSITY = fitted


@method("texf")
class TexfMethod(Method):
    """Options are the fields of EncodeOptions, and density, the transfer's most samples per voxel edge; the defaults are the
    package's. Bytes are those of the stream, of a 3DNTC payload
    those that a GPU keeps. "geometry" is what positions alone take as one mesh at the bits asked for, as for UV rivals; what the
    stream's geometry takes beyond, for UVs, finer positions and further units, is "placement" and counts with the texture. A GPU
    keeps its mesh in no stream: beside a 3DNTC payload all of the stream's geometry is "geometry"."""

    options = (*(f.name for f in fields(EncodeOptions) if f.name not in NOT_SETTINGS), "density")

    def version(self):
        """The version of DracoPy, and a hash of the file that counts positions."""
        return f"{versions_of('DracoPy')} {source_hash(draco_mesh.__file__)}"

    def warm_up(self, options, threads):
        """Codes and decodes two small sheets under the same options, but with few voxels, without a target, and with a fit where
        the asset may get one; and over texels, where the asset may get them."""
        from texfcodec.api import decode, encode
        from texfcodec.precompile import small_scene

        kept = {k: v for k, v in options.items() if k not in ("target_bytes", "target_psnr", "target_psnr_of", "density")}
        kept |= {"resolution": WARM_RESOLUTION, "threads": threads, "refine_iterations": 1}
        if codec_of(kept.get("codec", DEFAULT_CODEC)).joint:
            kept["steps"] = 1
        elif kept.get("refine", "auto") == "auto" and kept.get("effort") != "fast":
            kept["refine"] = "fit"
        decode(encode(small_scene(), EncodeOptions(**kept)))
        if EncodeOptions(**{k: v for k, v in options.items() if k != "density"}).may_choose_texels:
            decode(encode(small_scene(), EncodeOptions(**kept | {"support": "texels"})))

    def encode(self, scene, options, folder, threads, report):
        """Writes STREAM."""
        from texfcodec.api import encode_to_result

        settings = EncodeOptions(**{k: v for k, v in options.items() if k != "density"}, threads=threads)
        with transfer_density(options.get("density")):
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
        """The Texf of STREAM."""
        from texfcodec.api import decode
        from texfcodec.options import DecodeOptions

        return decode((folder / STREAM).read_bytes(), DecodeOptions(threads=threads), report)

    def values_sha256(self, decoded):
        """As Encoded.reconstruction_sha256 of the encoder: field by field and channel by channel, the keys
        as 64-bit little-endian numbers, then the uint8 values [N, C]."""
        return hash_of(*(part for field in decoded.fields for plane in field.planes.values() for part in (field.keys, plane)))


@method("texf_baked")
class TexfBakedMethod(TexfMethod):
    """The same stream as a viewer shows it that knows images alone: baked into a GLB with an atlas of its own, which costs
    nothing, because the receiver makes it."""

    def decode(self, folder, options, threads, report):
        """The Scene of the baked GLB."""
        from texfcodec.io.load import load

        self._texf = super().decode(folder, options, threads, report)
        with report.stage("bake"):
            self._texf.save(folder / BAKED)
        return load(str(folder / BAKED))

    def values_sha256(self, decoded):
        """Of what was decoded before it was baked."""
        return super().values_sha256(self._texf)


def geometry_bytes(scene, position_bits):
    """draco_mesh.positions_alone() of a Scene."""
    surface = make_surface(scene, EncodeOptions(position_bits=position_bits))
    return draco_mesh.positions_alone(surface.lattice, surface.faces)
