"""All targets, in the order of the rooms: what runs, on which modules.

A target is a function of bytes. It may return, or raise a TexfError; whatever else happens is a finding.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz import bitstream_targets as bitstream
from fuzz import codec_targets as codecs
from fuzz import container_targets as containers
from fuzz import loader_targets as loaders
from fuzz import stage_targets as stages
from fuzz import voxel_targets as voxels
from texfcodec.errors import InputError, LimitError, StreamError, SupportError, TexfError

FLOORS_FILE = Path(__file__).with_name("floors.json")  # written by run.py --floors alone
FLOORS: dict[str, int] = json.loads(FLOORS_FILE.read_text(encoding="utf-8"))
OF_STREAMS, OF_FILES = (StreamError, LimitError, SupportError), (InputError, LimitError, SupportError)


@dataclass(frozen=True)
class Target:
    """run: what is tried; modules: of the package, or some of their functions, whose branches it is to reach (branches.py);
    families: of errors that it may end in; bytes: of an input at most."""

    name: str
    run: Callable[[bytes], None]
    modules: tuple[str, ...]
    families: tuple = OF_STREAMS
    bytes: int = 400

    @property
    def floor(self) -> int:
        """The share of its branches, in per cent, below which a guided run of some seconds fails."""
        return FLOORS[self.name]

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


_WALKERS = "core/syntax_walk.py#Reader#read_structure#_read_scalar#_read_blob#check_range"
_RAHT = tuple(f"codecs/raht/{name}.py" for name in (
    "raht_codec", "raht_values", "attribute_coder", "codewords", "coefficients/blocks", "coefficients/dct_blocks",
    "coefficients/direct", "coefficients/following", "coefficients/mixed", "coefficients/mixed_contexts", "coefficients/planar",
    "coefficients/residual", "transform/filter", "transform/octree", "transform/prediction", "transform/quantise",
    "transform/raht", "transform/colour"))
_NEURAL = tuple(f"codecs/neural/{name}.py" for name in ("neural_codec", "payload", "infer"))
_GLTF = tuple(f"io/gltf/{name}.py" for name in ("reader", "document", "properties", "accessor", "mesh", "material"))
_IMAGES = "io/images.py#TextureShelf#read_image#_to_rgba"
_LOAD = ("io/load.py", "io/parts.py")
_CONTAINER = tuple(f"io/container/{name}.py" for name in ("layout", "references", "rewritten", "packed_accessors"))
_SCENES = tuple(f"encoder/container/{name}.py" for name in ("plan", "encode", "line_up", "keyframes"))

TARGETS = {target.name: target for target in (
    Target("numbers", bitstream.numbers, ("core/syntax_walk.py#Reader#write_v",), bytes=40),
    Target("framing", bitstream.framing, ("bitstream/units.py",), bytes=160),
    Target("header", bitstream.header, ("bitstream/stream.py", _WALKERS), bytes=60),
    Target("materials", bitstream.materials, ("bitstream/appearance.py", _WALKERS), bytes=60),
    Target("field", bitstream.field, ("bitstream/stream.py", "decoder.py"), bytes=60),
    Target("geometry_unit", bitstream.geometry_unit, ("decoder.py#_decode_unit#_decode_draco", "geometry/draco.py"), bytes=60),
    Target("attribute_unit", bitstream.attribute_unit, ("decoder.py", "bitstream/stream.py"), bytes=80),
    Target("metadata", bitstream.metadata, ("decoder.py#_metadata",), bytes=80),
    Target("units", bitstream.geometry_counts, ("bitstream/stream.py", "bitstream/units.py"), bytes=40),
    Target("restated", bitstream.restated, ("core/syntax_walk.py", "bitstream/stream.py"), bytes=60),
    Target("stream", bitstream.stream, ("decoder.py", "bitstream/stream.py", "bitstream/units.py"), bytes=120),
    Target("inspect", bitstream.described, ("bitstream/inspect.py", "bitstream/stream.py"), bytes=80),
    Target("answer", bitstream.answer, ("sandbox/answer.py",), bytes=60),
    Target("appearance", bitstream.appearance, ("bitstream/appearance.py",), bytes=200),
    Target("voxels", stages.voxels, ("field/voxelise.py", "field/surface_walk.py", "field/keyed.py"), bytes=160),
    Target("texels", stages.texels, ("field/texel_set.py", "field/texels.py"), bytes=160),
    Target("geometry", stages.geometry, ("geometry/draco.py",), (*OF_STREAMS, InputError), bytes=120),
    Target("range_coder", stages.range_coder, ("codecs/raht/entropy/range_coder.py",), bytes=200),
    Target("contexts", stages.contexts, ("codecs/raht/entropy/contexts.py",), bytes=200),
    Target("mixing", stages.mixing, ("codecs/raht/entropy/mixing.py",), bytes=300),
    Target("raht", codecs.raht, _RAHT, bytes=600),
    Target("raht_twice", codecs.raht_twice, _RAHT, bytes=400),
    Target("constant", codecs.constant, ("codecs/constant.py", "field/keyed.py"), bytes=140),
    Target("neural", codecs.neural, _NEURAL, bytes=500),
    Target("transport", codecs.transport, ("codecs/neural/transport.py",), bytes=200),
    Target("coded_normals", codecs.coded_normals, ("codecs/coded_normals.py", "geometry/corner_groups.py"), bytes=300),
    Target("sharp_edges", codecs.sharp_edges, ("codecs/sharp_edges.py", "geometry/edges.py#shared_edges#folds#coded_edges"),
           bytes=300),
    Target("gltf", loaders.gltf, _GLTF, OF_FILES, 60),
    Target("glb", loaders.glb, ("io/gltf/document.py#open_document#_read_glb#_chunks#_parse",), OF_FILES, 60),
    Target("container", containers.container, (*_CONTAINER, "io/container/expand.py", "io/gltf/deflated.py"),
           (*OF_FILES, StreamError), 60),
    Target("scene_file", containers.scene_file, (*_SCENES, *_CONTAINER), OF_FILES, 60),
    Target("obj", loaders.obj, ("io/obj.py", *_LOAD), OF_FILES, 60),
    Target("mtl", loaders.mtl, ("io/mtl.py",), OF_FILES, 60),
    Target("ply", loaders.ply, ("io/ply.py", *_LOAD), OF_FILES, 60),
    Target("stl", loaders.stl_file, ("io/trimesh_files.py#read_stl#_whole_binary#_whole_text#_paint",), OF_FILES, 60),
    Target("off", loaders.off, ("io/trimesh_files.py#read_off#_check_polygons",), OF_FILES, 60),
    Target("threemf", loaders.threemf, ("io/trimesh_files.py#read_3mf#_survey#_references#_placed_faces",), OF_FILES, 60),
    Target("dae", loaders.dae_file, ("io/dae.py",), OF_FILES, 60),
    Target("npz", voxels.npz, ("io/sparse/npz_file.py", "io/sparse/arrays.py", "io/sparse/sampler.py#channel_values#_unit"),
           OF_FILES, 60),
    Target("vxz", voxels.vxz, ("io/sparse/vxz.py#vxz_arrays#_header#_chunk#_slice#_unpacked#_unfiltered",
                               "io/sparse/dual_grid.py#with_surface#_guessed_place#dual_surface"), OF_FILES, 60),
    Target("image", loaders.image, (_IMAGES, "io/ktx2.py"), OF_FILES, 60),
    Target("scene", loaders.scene, ("io/trimesh_object.py#check_scene#_check_arrays",), OF_FILES, 60),
)}
