"""Tables of the formats that are read and written, for the loader, save(), the command lines and the guide.

This module imports nothing heavy, so that a --help does not import numpy.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """A suffix and its reader.

    module, function: the reader in this room, (bytes, folder, Notes) -> Scene; code: error code of malformed files, unless the
    reader raises a better one; name: for people; starts: bytes with which every such file begins, or (); text: whether files may
    be UTF-16; package: what must be installed beside texfcodec's own dependencies.
    """

    suffix: str
    module: str
    function: str
    code: str
    name: str
    starts: tuple = ()
    text: bool = False
    package: str = ""


FORMATS = (
    Format(".glb", "gltf.reader", "read_gltf", "TXF-I09", "binary glTF 2.0", (b"glTF",)),
    Format(".gltf", "gltf.reader", "read_gltf", "TXF-I09", "glTF 2.0", text=True),
    Format(".obj", "obj", "read_obj", "TXF-I20", "Wavefront OBJ", text=True),
    Format(".ply", "ply", "read_ply", "TXF-I21", "Stanford PLY", (b"ply", b"PLY"), text=True),
    Format(".stl", "trimesh_files", "read_stl", "TXF-I23", "STL"),
    Format(".off", "trimesh_files", "read_off", "TXF-I23", "OFF", text=True),
    Format(".3mf", "trimesh_files", "read_3mf", "TXF-I24", "3MF", (b"PK\x03\x04",), package="lxml"),
    Format(".dae", "dae", "read_dae", "TXF-I24", "COLLADA", package="pycollada"),
    Format(".npz", "sparse.npz_file", "read_npz", "TXF-I42", "arrays of numpy: a surface with voxels", (b"PK\x03\x04",)),
    Format(".vxz", "sparse.vxz", "read_vxz", "TXF-I42", "O-Voxel of TRELLIS.2", (b"VXZ",)),
)

SUFFIXES = tuple(entry.suffix for entry in FORMATS)


def format_of(suffix: str) -> Format | None:
    """Return the Format that a suffix such as ".obj" stands for, or None if no reader knows it."""
    return next((entry for entry in FORMATS if entry.suffix == suffix), None)


@dataclass(frozen=True)
class ImageFormat:
    """A format that textures are written in. mime, suffix: of its files; extension: the glTF extension that it requires, or None
    if every viewer reads it; quality: default, 1..100, or None if the format has no quality."""

    name: str
    mime: str
    suffix: str
    extension: str | None = None
    quality: int | None = None


IMAGE_FORMATS = {entry.name: entry for entry in (
    ImageFormat("png", "image/png", ".png"),
    ImageFormat("jpeg", "image/jpeg", ".jpg", None, 92),
    ImageFormat("webp", "image/webp", ".webp", "EXT_texture_webp", 90),
    ImageFormat("avif", "image/avif", ".avif", "EXT_texture_avif", 85),
    ImageFormat("ktx2", "image/ktx2", ".ktx2", "KHR_texture_basisu", 90),
)}  # fmt: skip
AUTO = "auto"  # automatic_image.py
TEXTURE_FORMATS = (AUTO, *IMAGE_FORMATS)

# What save() takes
SAVED_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".npz")
APPEARANCES = ("texture", "vertex", "voxels")
ATLAS_METHODS = (AUTO, "quality", "fast")
COMPRESSIONS = ("none", "draco", "meshopt")  # of a glTF's meshes
