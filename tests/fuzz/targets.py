"""All targets, in the order of the rooms: what runs, on which modules, and how much of them it must reach.

A target is a function of bytes. It may return, or raise a TexfError; whatever else happens is a finding.
"""

from collections.abc import Callable
from dataclasses import dataclass

from fuzz import bitstream_targets as bitstream
from fuzz import codec_targets as codecs
from fuzz import loader_targets as loaders
from fuzz import stage_targets as stages

from texfcodec.errors import InputError, LimitError, StreamError, SupportError, TexfError

OF_STREAMS, OF_FILES = (StreamError, LimitError, SupportError), (InputError, LimitError, SupportError)


@dataclass(frozen=True)
class Target:
    """run: what is tried; modules: of the package, whose branches it is to reach; floor: the share of them, in per cent, below
    which a run of some seconds fails; families: of errors that it may end in; bytes: of an input at most."""

    name: str
    run: Callable[[bytes], None]
    modules: tuple[str, ...]
    floor: int
    families: tuple = OF_STREAMS
    bytes: int = 400

    def outcome(self, data: bytes) -> str:
        """"value", or the code of the error. Whatever else is raised passes through, and so does an error of another family."""
        try:
            self.run(data)
        except TexfError as error:
            if not isinstance(error, self.families):
                raise AssertionError(f"ends in an error of another family: {error}") from error
            assert error.code.startswith("TXF-") and str(error) and error.as_dict()["code"] == error.code
            return error.code
        return "value"


_RAHT = tuple(f"codecs/raht/{name}.py" for name in (
    "unit", "values", "codec", "layout", "coefficients/blocks", "coefficients/direct", "coefficients/mixed",
    "coefficients/mixed_contexts", "coefficients/planar", "coefficients/residual", "transform/filter", "transform/octree",
    "transform/prediction", "transform/quantise", "transform/raht", "transform/colour"))
_GLTF = tuple(f"asset/load/gltf_{name}.py" for name in ("read", "document", "accessor", "mesh", "material"))
_LOAD = ("asset/load/files.py", "asset/load/parts.py")

TARGETS = {target.name: target for target in (
    Target("numbers", bitstream.numbers, ("ground/walk.py",), 0, bytes=40),
    Target("framing", bitstream.framing, ("bitstream/units.py",), 0, bytes=160),
    Target("header", bitstream.header, ("bitstream/stream.py", "ground/walk.py"), 0, bytes=60),
    Target("materials", bitstream.materials, ("bitstream/appearance.py", "ground/walk.py"), 0, bytes=60),
    Target("field", bitstream.field, ("bitstream/stream.py", "decoder.py"), 0, bytes=60),
    Target("geometry_unit", bitstream.geometry_unit, ("decoder.py", "geometry/draco.py"), 0, bytes=60),
    Target("attribute_unit", bitstream.attribute_unit, ("decoder.py", "bitstream/stream.py"), 0, bytes=80),
    Target("metadata", bitstream.metadata, ("decoder.py",), 0, bytes=80),
    Target("units", bitstream.geometry_counts, ("bitstream/stream.py", "bitstream/units.py"), 0, bytes=40),
    Target("restated", bitstream.restated, ("ground/walk.py", "bitstream/stream.py"), 0, bytes=60),
    Target("stream", bitstream.stream, ("decoder.py", "bitstream/stream.py", "bitstream/units.py"), 0, bytes=120),
    Target("inspect", bitstream.described, ("bitstream/inspect.py", "bitstream/stream.py"), 0, bytes=80),
    Target("answer", bitstream.answer, ("isolate.py",), 0, bytes=60),
    Target("appearance", bitstream.appearance, ("bitstream/appearance.py",), 0, bytes=200),
    Target("voxels", stages.voxels, ("support/voxelise.py", "support/keyed.py"), 0, bytes=160),
    Target("texels", stages.texels, ("support/texel_set.py", "support/texels.py"), 0, bytes=160),
    Target("geometry", stages.geometry, ("geometry/draco.py",), 0, (*OF_STREAMS, InputError), bytes=120),
    Target("range_coder", stages.range_coder, ("codecs/raht/entropy/range_coder.py",), 0, bytes=200),
    Target("contexts", stages.contexts, ("codecs/raht/entropy/contexts.py",), 0, bytes=200),
    Target("mixing", stages.mixing, ("codecs/raht/entropy/mixing.py",), 0, bytes=300),
    Target("raht", codecs.raht, _RAHT, 0, bytes=600),
    Target("raht_twice", codecs.raht_twice, _RAHT, 0, bytes=400),
    Target("constant", codecs.constant, ("codecs/constant/unit.py", "support/keyed.py"), 0, bytes=140),
    Target("neural", codecs.neural, tuple(f"codecs/neural/{name}.py" for name in ("unit", "payload", "infer")), 0, bytes=500),
    Target("transport", codecs.transport, ("codecs/neural/transport.py",), 0, bytes=200),
    Target("sharp_edges", codecs.sharp_edges, ("codecs/sharp_edges.py", "geometry/edges.py"), 0, bytes=300),
    Target("gltf", loaders.gltf, _GLTF, 0, OF_FILES, 60),
    Target("glb", loaders.glb, ("asset/load/gltf_document.py",), 0, OF_FILES, 60),
    Target("obj", loaders.obj, ("asset/load/obj_read.py", *_LOAD), 0, OF_FILES, 60),
    Target("mtl", loaders.mtl, ("asset/load/mtl_read.py",), 0, OF_FILES, 60),
    Target("ply", loaders.ply, ("asset/load/ply_read.py", *_LOAD), 0, OF_FILES, 60),
    Target("stl", loaders.stl_file, ("asset/load/stl_read.py",), 0, OF_FILES, 60),
    Target("off", loaders.off, ("asset/load/off_read.py",), 0, OF_FILES, 60),
    Target("threemf", loaders.threemf, ("asset/load/threemf_read.py", "asset/load/threemf_model.py"), 0, OF_FILES, 60),
    Target("dae", loaders.dae_file, ("asset/load/dae_read.py",), 0, OF_FILES, 60),
    Target("image", loaders.image, ("asset/load/image_read.py", "asset/load/ktx2_read.py"), 0, OF_FILES, 60),
    Target("scene", loaders.scene, ("asset/load/trimesh_read.py",), 0, OF_FILES, 60),
)}
