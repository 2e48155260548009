"""The neutral in-memory form of a textured mesh: io/ makes it and the encoder takes it."""

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

    Parameters
    ----------
    image : uint8 [H, W, 4]
        RGBA, colour sRGB-coded, alpha straight, data unchanged, row 0 at v = 0 (glTF convention).
    wrap : (int, int)
        Of s and t, each one of WRAP_*.
    srgb : bool
        Whether it is written as colour.
    nearest : bool
        Whether a texel is shown as a square of one colour (glTF's NEAREST), not blended with its neighbours.
    lossy_bytes : int, optional
        Size of the image file if its format is lossy.
    """

    image: np.ndarray
    wrap: tuple = (WRAP_REPEAT, WRAP_REPEAT)
    name: str = ""
    srgb: bool = True
    nearest: bool = False
    lossy_bytes: int | None = None


@dataclass
class Material:
    """Appearance of faces.

    Parameters
    ----------
    factor : float64 [4]
        Linear RGBA multiplier (glTF baseColorFactor).
    texture : int
        Index of the base colour into Scene.textures, or -1.
    maps : dict of str to int
        The same for other channels that have a map, by name (channels.MAPS); -1 if the values are in Scene.corner_map or, in a
        decoded material, in the field of the faces.
    parameters : dict
        Those that are not the default, by name (channels.PARAMETERS).
    normals : NormalRule
        Rule of a decoded material's shading normals, which the encoder chooses.
    """

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

    Parameters
    ----------
    positions : float64 [V, 3]
        Vertices.
    faces : int64 [F, 3]
        Indices into positions.
    face_material : int64 [F]
        Indices into materials.
    corner_uv : float64 [F, 3, 2]
        UVs of the base colour, or of a material's first map if it has no image of its own. The texture transform is applied, v is
        downwards (glTF); zeros if unused.
    corner_color : float32 [F, 3, 4] or None
        Linear RGBA multiplier; None if no face has vertex colours.
    materials, textures : list of Material, list of Texture
        Appearance.
    metadata : dict
        JSON-able (names, extras); it travels opaquely.
    warnings, dropped : list of str
        Visible differences, a sentence each; names of the maps and properties that are not coded.
    remarks : list of str
        A sentence each on things that are left out or repaired and change no picture.
    files : dict of str to int
        {path: bytes} of every file that was read, the mesh file first; empty for a scene from memory.
    map_uv : dict of str to float64 [F, 3, 2]
        UVs by channel, for channels whose maps have other UVs on some face.
    weights : dict of str to float
        Effect of a squared error of a channel's values on the shaded picture, by name; empty if it was not measured.
    corner_normal : float32 [F, 3, 3] or None
        Shading normals of length 1; None if the file has none.
    corner_map : dict of str to float32 [F, 3, C]
        Values at face corners in 0..1, linear, by channel (channels.CORNER_MAPS), for materials whose map of the channel is -1;
        1 on faces of other materials.
    corner_tangent : float32 [F, 3, 4] or None
        glTF's TANGENT, zero where there is none.
    flat : bool
        Meaning of absent normals: flat shading (glTF), else smooth (all other formats).
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
    corner_map: dict = field(default_factory=dict)

    def __repr__(self):
        counts = (plural(len(self.faces), "face", "faces"), plural(len(self.materials), "material", "materials"),
                  plural(len(self.textures), "texture", "textures"))
        return f"<Scene: {', '.join(counts)}>"
