"""The neutral in-memory form of a textured mesh: what load/ makes and the encoder takes."""

from dataclasses import dataclass, field

import numpy as np

from ..report import plural
from .normal_rule import USUAL, NormalRule

WRAP_REPEAT, WRAP_CLAMP, WRAP_MIRROR = 0, 1, 2
WRAP_NAMES = ("repeat", "clamp", "mirror")
ALPHA_OPAQUE, ALPHA_MASK, ALPHA_BLEND = 0, 1, 2
ALPHA_NAMES = ("OPAQUE", "MASK", "BLEND")  # as glTF calls them
NEAREST_FIELDS = "nearest_fields"  # key of a stream's metadata: numbers of fields over texels whose Texture is nearest


@dataclass
class Texture:
    """One image.

    image: uint8 [H, W, 4] RGBA, colour sRGB-coded, alpha straight, data as they stand, row 0 at v = 0 (glTF convention).
    wrap: (s, t), each one of WRAP_*; srgb: whether it is written as colour; nearest: whether a texel shows as a square of one
    colour (glTF's NEAREST) and is not blended with its neighbours; lossy_bytes: of the image file, where its format had given up
    exactness already, else None.
    """

    image: np.ndarray
    wrap: tuple = (WRAP_REPEAT, WRAP_REPEAT)
    name: str = ""
    srgb: bool = True
    nearest: bool = False
    lossy_bytes: int | None = None


@dataclass
class Material:
    """factor: float64 [4] linear RGBA multiplier (glTF baseColorFactor); texture: index of the base colour into Scene.textures or
    -1; maps: the same of other channels by name (channels.MAPS), where there is one, -1 in a decoded material, whose faces
    have it in their field; parameters: by name (channels.PARAMETERS), those that are not the default; normals: the rule of a
    decoded one's shading normals, which the encoder chooses."""

    name: str = ""
    factor: np.ndarray = field(default_factory=lambda: np.ones(4))
    texture: int = -1
    alpha_mode: int = ALPHA_OPAQUE
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False
    maps: dict[str, int] = field(default_factory=dict)
    parameters: dict[str, tuple[float, ...]] = field(default_factory=dict)
    normals: NormalRule = USUAL


@dataclass(repr=False)
class Scene:
    """A triangle soup with shared positions, everything in world space.

    positions: float64 [V, 3]; faces: int64 [F, 3] into positions; face_material: int64 [F] into materials.
    corner_uv: float64 [F, 3, 2], texture transform already applied, v downwards (glTF); zeros where unused. Those of the base
    colour, or of a material's first map where it has no image of its own.
    map_uv: the same by channel, for channels whose maps have other UVs on some face.
    corner_color: float32 [F, 3, 4] linear RGBA multiplier, or None where no face has vertex colours.
    corner_normal: float32 [F, 3, 3] shading normals of length 1, or None where the file says nothing of them; flat: what that
    means then, faces that are shaded flat (glTF), or smooth ones (all other formats).
    corner_tangent: float32 [F, 3, 4] of glTF's TANGENT, zero where there is none, or None.
    weights: what a squared error of a channel's values does to the shaded picture, by name; empty where it was not measured.
    metadata: JSON-able dict (names, extras) that travels opaquely.
    warnings / dropped: what will look different, one sentence each / names of the maps and properties that are not coded.
    remarks: one sentence each on what is left out or mended and changes no picture.
    files: {path: its bytes} of every file it was read from, the mesh file first; empty for one made in memory.
    """

    positions: np.ndarray
    faces: np.ndarray
    face_material: np.ndarray
    corner_uv: np.ndarray
    corner_color: np.ndarray | None
    materials: list
    textures: list
    metadata: dict = field(default_factory=dict)
    warnings: list = field(default_factory=list)
    dropped: list = field(default_factory=list)
    remarks: list = field(default_factory=list)
    files: dict = field(default_factory=dict)
    map_uv: dict = field(default_factory=dict)
    weights: dict = field(default_factory=dict)
    corner_normal: np.ndarray | None = None
    corner_tangent: np.ndarray | None = None
    flat: bool = False

    def __repr__(self):
        counts = (plural(len(self.faces), "face", "faces"), plural(len(self.materials), "material", "materials"),
                  plural(len(self.textures), "texture", "textures"))
        return f"<Scene: {', '.join(counts)}>"
