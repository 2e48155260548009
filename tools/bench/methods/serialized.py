"""The rivals Serialized-Morton and Serialized-Hilbert: the colours of our voxels in the order of a space-filling curve, laid into
a square image along the same curve in two dimensions, which is coded by HEVC or, for GPUs, in ASTC blocks.

The voxels and their colours are those that our encoder would code (voxel_values.py), all fields of a mesh one after the other.
The decoder has the mesh and so the voxels; what counts beside the geometry is the image, alpha included where there is any, and
what a stream without values takes (materials, counts, checksums, one mesh more per field and material: from 100 bytes on).

A GPU looks a voxel up without walking the mesh, so that ASTC's image needs a structure that gives the rank of a voxel: an
octree, built for every field, which on smooth surfaces is smaller than the DAG that the paper names. It is one mask of 8 bits a
node, level by level, in records of 64 bytes: the number of bits set in all earlier records, then 60 masks. Node n + 1 is the one
that the n-th set bit of the whole list leads to, so that counting bits is all there is to do, on the last level too, where it
gives the rank.
"""

from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np

from texfcodec.field.extents import octree_depth
from tools.bench.methods import checked_options, image_codecs, method, source_hash, space_filling, texf
from tools.bench.methods import voxel_values as voxels
from tools.bench.methods.astc import Astc, Codec
from tools.bench.methods.space_filling import CURVES, curve_keys, from_image, image_size, to_image
from tools.bench.methods.texf import TexfMethod
from tools.bench.methods.voxel_values import rgba_of, voxel_values, with_values, write_mesh

DEFAULTS = {"resolution": 2048, "curve": "hilbert", "tile": 64, "codec": "hevc", "qp": 31, "chroma": "444",
            "block": "6x6", "quality": 98, "profile": "ldr", "position_bits": None}
ASTC_OPTIONS = ("block", "quality", "profile")
CODECS, CHROMA, TILES = ("hevc", "av1", "astc"), ("444", "420"), tuple(1 << bits for bits in range(3, 11))
IMAGE, ADDRESSES = "image.bin", "addresses{}.bin"
WARM_SIDE = 64
RECORD_MASKS = 60  # of the octree


@method("serialized")
class Serialized(TexfMethod):
    """Voxel colours along a space-filling curve as an image. Options, with defaults in DEFAULTS: resolution K of the voxels;
    curve one of CURVES, in tiles of `tile` pixels a side; codec one of CODECS, with qp (of av1 the CQ level) and chroma, or with
    block, quality and profile as of astc; position_bits as of texf."""

    options = tuple(DEFAULTS)

    def version(self):
        """The versions of the image codecs, and a hash of further files that results depend on."""
        versions = [image_codecs.versions(codec) for codec in CODECS if codec != "astc"]
        files = (module.__file__ for module in (image_codecs, space_filling, texf, voxels))
        return " ".join([Astc().version(), *versions, source_hash(*files)])

    def missing(self, options):
        """Return a sentence if the image codec is not installed; else None."""
        options = DEFAULTS | options
        if options["codec"] != "astc":
            return image_codecs.missing(options["codec"]) if options["codec"] in CODECS else None
        spec = find_spec("astc_encoder")
        return None if spec else "astc needs astc-encoder-py; pip install \"texfcodec[baselines]\" brings it"

    def warm_up(self, options, threads):
        """Load the image codec and the kernels that make voxels, with a small scene."""
        from texfcodec.precompile import small_scene
        from texfcodec.report import Report

        chosen = checked(options)
        coder = image_coder(chosen, threads)
        coder.dec(coder.enc(np.zeros((WARM_SIDE, WARM_SIDE, 4), np.uint8)), WARM_SIDE, WARM_SIDE)
        voxel_values(small_scene(), {"resolution": WARM_SIDE, "threads": threads}, Report())

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into STREAM without values, IMAGE, and for ASTC also ADDRESSES of every field.

        Raises ValueError if an option is out of range or the image is decoded in another size.
        """
        chosen = checked(options)
        given = {"resolution": chosen["resolution"], "threads": threads, "position_bits": chosen["position_bits"]}
        prepared = voxel_values(scene, given, report)
        with report.stage("geometry"):
            sizes = dict(zip(("geometry", "other"), write_mesh(prepared, folder, report), strict=True))
        coder = image_coder(chosen, threads)
        with report.stage("serialise"):
            order = orders(prepared.fields, chosen["curve"])
            values = np.concatenate([rgba_of(part)[along] for part, (along, _) in zip(prepared.fields, order, strict=True)])
            image = to_image(values, chosen["tile"], chosen["curve"])
        with report.stage("image"):
            has_alpha = chosen["codec"] == "astc" or any("alpha" in part.planes for part in prepared.fields)
            coded = {IMAGE: coder.enc(image if has_alpha else image[..., :3])}
        if chosen["codec"] == "astc":
            with report.stage("addressing"):
                coded |= {ADDRESSES.format(number): enc_octree(keys, octree_depth(part.support.size))
                          for number, ((_, keys), part) in enumerate(zip(order, prepared.fields, strict=True))}
        for name, data in coded.items():
            (folder / name).write_bytes(data)
        with report.stage("reconstruction"):
            fields = self._fields(prepared.fields, folder, chosen, coder)
        sizes["texture"] = len(coded[IMAGE])
        sizes["addressing"] = sum(map(len, coded.values())) - sizes["texture"]
        return {"bytes": {"total": sum(sizes.values()), **sizes}, **chosen,
                "reconstruction_sha256": self.values_sha256(SimpleNamespace(fields=fields)), "image": list(image.shape[1::-1]),
                "voxels": len(values), "fields": len(fields)}

    def decode(self, folder, options, threads, report):
        """Return the Texf of STREAM with the decoded image's values in its voxels."""
        decoded, chosen = super().decode(folder, options, threads, report), checked(options)
        with report.stage("image"):
            decoded.fields = self._fields(decoded.fields, folder, chosen, image_coder(chosen, threads))
        return decoded

    def _fields(self, parts, folder, chosen, coder):
        """Fields over the supports of parts with what the coded images hold."""
        layout = chosen["tile"], chosen["curve"]
        count = sum(len(part.support) for part in parts)
        size = image_size(count, chosen["tile"])
        values = from_image(coder.dec((folder / IMAGE).read_bytes(), *size), count, *layout)
        rgba, begin = [], 0
        for along, _ in orders(parts, chosen["curve"]):
            rgba.append(np.empty((len(along), 4), np.uint8))
            rgba[-1][along] = values[begin : begin + len(along)]
            begin += len(along)
        return with_values(parts, rgba)


def checked(options):
    """Return all options with defaults. Raises ValueError with the name of one that is out of range."""
    return checked_options(options, DEFAULTS, {}, {"curve": CURVES, "tile": TILES, "codec": CODECS, "chroma": CHROMA})


def orders(parts, curve):
    """Return for every field (order of its voxels along the curve, as indices into the Morton order; their curve keys,
    ascending), int64 [N] each."""
    out = []
    for part in parts:
        keys = curve_keys(part.support.xyz(), octree_depth(part.support.size), curve)
        along = np.argsort(keys)
        out.append((along, keys[along]))
    return out


def enc_octree(keys, bits):
    """Return the bytes of the octree of voxels. keys: their curve keys, int64 [N], ascending, N >= 1, each below 8**bits."""
    levels = []
    for level in range(bits):
        cells = np.unique(keys >> 3 * level)
        first = np.flatnonzero(np.diff(cells >> 3, prepend=-1))
        levels.append(np.bitwise_or.reduceat(np.int64(1) << (cells & 7), first))
    masks = np.concatenate(levels[::-1]).astype(np.uint8)
    masks = np.pad(masks, (0, -len(masks) % RECORD_MASKS)).reshape(-1, RECORD_MASKS)
    before = np.cumsum(np.unpackbits(masks, axis=1).sum(axis=1, dtype=np.int64))
    counts = np.append(0, before[:-1]).astype("<u4")
    return np.hstack([counts[:, None].view(np.uint8), masks]).tobytes()


def image_coder(chosen, threads):
    """Return functions enc(image uint8 [H, W, 4]) -> bytes and dec(bytes, width, height) -> image. Raises LookupError if a codec
    is not installed."""
    if chosen["codec"] == "astc":
        blocks = Codec({name: chosen[name] for name in ASTC_OPTIONS}, threads)
        return SimpleNamespace(enc=blocks.enc_image, dec=blocks.dec_image)
    codec, qp, chroma = chosen["codec"], chosen["qp"], chosen["chroma"]
    return SimpleNamespace(enc=lambda image: image_codecs.enc_image(image, codec, qp, chroma, threads),
                           dec=lambda data, width, height: image_codecs.dec_image(data, codec, width, height))
