"""PLY and OBJ out: binary little-endian PLY with sRGB vertex colours, OBJ text with an MTL beside it.

A Texf stands in a later room, so that signatures here say Any.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR
from .atlas.bake import to_bytes
from .precision import decimal_digits, float32_is_enough
from .vertex_appearance import vertex_colours

if TYPE_CHECKING:
    from .output_textures import Textured

_CHANNELS = ("red", "green", "blue", "alpha")


def ply_surface(texf: Any) -> list:
    """Pieces of a PLY file: mesh with vertex colours (u8 sRGB, alpha only if the stream has any)."""
    vertex, index, _, rgba = vertex_colours(texf, with_material=False)
    faces = np.empty(len(index), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, index
    vertices, lines = _ply_vertices(texf, texf.positions[vertex], to_bytes(rgba))
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    return [_ply_header(lines), vertices.data, faces.data]


def ply_points(texf: Any) -> list:
    """Pieces of a PLY file: voxel centres with colours."""
    voxels = texf.voxels()
    vertices, lines = _ply_vertices(texf, voxels["center"], voxels["rgba"])
    return [_ply_header(lines), vertices.data]


def _ply_vertices(texf, points, rgba):
    """Packed vertex records and their header lines; double coordinates where float would lose the lattice."""
    kind, name = ("<f4", "float") if float32_is_enough(texf) else ("<f8", "double")
    channels = _CHANNELS[: 4 if texf.has_alpha else 3]
    records = np.empty(len(points), np.dtype([("p", kind, 3), ("c", "u1", len(channels))]))
    records["p"], records["c"] = points, rgba[:, : len(channels)]
    lines = [f"element vertex {len(points)}", *(f"property {name} {axis}" for axis in "xyz")]
    return records, lines + [f"property uchar {channel}" for channel in channels]


def _ply_header(lines):
    return "\n".join(["ply", "format binary_little_endian 1.0", "comment texfcodec", *lines, "end_header", ""]).encode()


def obj_textured(texf: Any, look: Textured, mtl_name: str) -> Iterator[bytes]:
    """Pieces of an OBJ file with texture coordinates (v up, as OBJ counts)."""
    uv, index = np.unique(look.corner_uv.reshape(-1, 2), axis=0, return_inverse=True)
    uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1)
    yield f"# texfcodec\nmtllib {mtl_name}\n".encode()
    yield _rows(f"v {_number(texf)} {_number(texf)} {_number(texf)}\n", texf.positions)
    yield _rows("vt %.8g %.8g\n", uv)
    corners = np.stack([texf.faces + 1, index.reshape(-1, 3) + 1], 2).reshape(-1, 6)
    names = obj_names(texf, look)
    for number in np.unique(look.looks.face_look):
        yield f"usemtl {names[number]}\n".encode()
        yield _rows("f %d/%d %d/%d %d/%d\n", corners[look.looks.face_look == number])


def obj_coloured(texf: Any) -> Iterator[bytes]:
    """Pieces of an OBJ file with colours after the coordinates (sRGB, 0..1), as most tools read them."""
    vertex, index, _, rgba = vertex_colours(texf, with_material=False)
    yield b"# texfcodec\n"
    yield _rows(_coloured_line(texf), np.hstack([texf.positions[vertex], rgba[:, :3] / 255.0]))
    yield _rows("f %d %d %d\n", index + 1)


def obj_points(texf: Any) -> Iterator[bytes]:
    """Pieces of an OBJ file with the voxel centres as points."""
    voxels = texf.voxels()
    yield b"# texfcodec\n"
    yield _rows(_coloured_line(texf), np.hstack([voxels["center"], voxels["rgba"][:, :3] / 255.0]))
    yield _rows("p %d\n", np.arange(1, len(voxels["rgba"]) + 1)[:, None])


def mtl(texf: Any, look: Textured, image_names: list[str], warnings: list[str]) -> list[bytes]:
    """The MTL file: one entry per material and image. image_names: of the files of look.textures; warnings: gets a sentence
    where OBJ cannot wrap an image as its UVs need."""
    maps, lines = [_map(look, n, name, warnings) for n, name in enumerate(image_names)], ["# texfcodec"]
    for name, one, images in zip(obj_names(texf, look), look.looks.looks, look.images, strict=True):
        lines += [f"newmtl {name}", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "d 1", "illum 1"]
        for image in images.values():  # the base colour's
            lines.append(f"map_Kd {maps[image]}")
            if look.textures[image].image.shape[2] == 4 and one.material.alpha_mode != ALPHA_OPAQUE:
                lines.append(f"map_d {maps[image]}")
    return [("\n".join(lines) + "\n").encode()]


def _map(look, number, name, warnings):
    """What stands behind map_Kd. An image repeats in OBJ, or is clamped both ways; where UVs stay within it neither matters, and
    the option, which some readers take for a part of the name, is left out."""
    uv = look.corner_uv[look.face_image == number]
    beyond = ((uv < 0) | (uv > 1)).any(axis=(0, 1))
    needed = {mode for mode, reached in zip(look.textures[number].wrap, beyond, strict=True) if reached}
    if WRAP_MIRROR in needed or len(needed) > 1:
        warnings.append(f"OBJ can neither mirror an image nor repeat it along one side only: {name} repeats along both")
    return f"-clamp on {name}" if needed == {WRAP_CLAMP} else name


def obj_names(texf: Any, look: Textured) -> list[str]:
    """One distinct name without blanks per pair of material and image, of look.looks."""
    shared = np.bincount([one.number for one in look.looks.looks], minlength=len(texf.materials)) > 1
    names = ["_".join(material.name.split()) or "material" for material in texf.materials]
    return [f"{one.number}_{names[one.number]}" + f"_{one.skin}" * bool(shared[one.number]) for one in look.looks.looks]


def _number(texf):
    return f"%.{decimal_digits(texf)}g"


def _coloured_line(texf):
    return f"v {_number(texf)} {_number(texf)} {_number(texf)} %.4f %.4f %.4f\n"


def _rows(line, values, block=65536):
    """Format every row of values [N, k] with the same line."""
    parts = []
    for start in range(0, len(values), block):
        rows = values[start : start + block]
        parts.append((line * len(rows)) % tuple(rows.ravel().tolist()))
    return "".join(parts).encode()
