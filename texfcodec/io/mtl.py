"""MTL material libraries: Kd, d/Tr and map_Kd become a base colour, the statements of mtl_maps.py become maps and parameters, and
all others are named as dropped. Also writes the library of a decoded stream, beside its OBJ."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..scene.channels import BASE_COLOUR
from ..scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material
from .colour_range import unit_colours
from .file_search import read_file
from .images import TextureShelf
from .magic import as_utf8
from .mtl_maps import STATEMENTS, MtlStatements, alpha_mode_with, complete, map_lines, number_lines, with_alpha
from .parts import alpha_mode_of, linearise_factors
from .visibility import vanishes

if TYPE_CHECKING:
    from ..texf import Texf
    from .output_textures import Textured
    from .parts import Notes

# Option -> most values it takes; the list of a texture statement ends where its file name begins.
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-clamp": 1,
            "-bm": 1, "-imfchan": 1, "-type": 1, "-cc": 1, "-colorspace": 1}
# Options that change no picture here: whether and how fine an image is filtered, what bump maps take of it.
_OPTION = re.compile(r"-[A-Za-z]+(?: |\Z)")
_HARMLESS_OPTIONS = {"-blendu", "-blendv", "-boost", "-bm", "-texres", "-imfchan", "-type", "-cc", "-colorspace"}
# Statements of the shading model that MTL was made for, which nearly every exporter writes and viewers in physical shading leave
# out: whether they light at all, how sharp highlights are, ambient light, refraction.
_MATTE = {"illum", "ns", "ka", "ni", "sharpness"}
_GREY = {"ks", "tf"}  # a colour where they are not grey
_ZERO = {"ps", "pc", "pcr", "aniso", "anisor"}  # nothing where they are 0
_LINE_END, _COMMENT = re.compile(rb"\r\n|\n|\r"), re.compile(rb"(?:^|[ \t])#.*", re.DOTALL)
_HEAD = 400  # characters in which an exporter names itself
_SAME = 1e-3  # of numbers that are written with three digits


@dataclass
class ObjMaterial:
    """An entry of a library (newmtl). factor: float64 [4], linear once the file is read; texture: file name or None; uv_scale,
    uv_offset: float64 [2], with v upwards; dissolve, transparency: numbers of `d` and `Tr`, or None; ambient_map: file name of
    `map_Ka`; statements: those of mtl_maps.py."""

    name: str
    factor: np.ndarray
    texture: str | None = None
    wrap: tuple = (WRAP_REPEAT, WRAP_REPEAT)
    uv_scale: tuple = (1.0, 1.0)
    uv_offset: tuple = (0.0, 0.0)
    dissolve: float | None = None
    transparency: float | None = None
    ambient_map: str | None = None
    statements: MtlStatements = field(default_factory=MtlStatements)

    @property
    def has_image(self) -> bool:
        """True if its faces need UVs."""
        return bool(self.texture or self.statements.maps)


def read_mtl(data: bytes, notes: Notes) -> dict[str, ObjMaterial]:
    """Parse the bytes of an .mtl file: {name: ObjMaterial}. Raises InputError TXF-I20 with the line."""
    library: dict[str, ObjMaterial] = {}
    current, coding = None, _coding_of(data := as_utf8(data))
    head = data[:_HEAD].decode("latin-1")
    for number, line in enumerate(_LINE_END.split(data), 1):
        key, _, rest = _COMMENT.sub(b"", line).replace(b"\t", b" ").strip().partition(b" ")
        if not key:
            continue
        word, text = key.decode("latin-1"), rest.strip().decode(coding)
        if word.lower() == "newmtl":
            current = library.setdefault(text, ObjMaterial(text, np.ones(4)))
        elif current is not None:
            try:
                _statement(current, word, text, notes)
            except (ValueError, IndexError) as error:
                raise InputError("TXF-I20", "an MTL statement cannot be read", line=number,
                                 value=line.strip().decode(coding)[:80]) from error
    materials = list(library.values())
    _set_alpha(materials, "meshlab" in head.lower(), notes)
    _set_range(materials, notes)
    for material in materials:
        _finish(material, notes)
    emission = [ke for material in materials for ke in material.statements.coded_emission()]
    linearise_factors([material.factor for material in materials] + emission, head, "MTL file", notes)
    return library


def _coding_of(data):
    """Encoding of a text: UTF-8, else Latin-1, a character a byte, which file_search.readings() decodes by other encodings."""
    try:
        bytes(data).decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def decode_text(data: bytes) -> str:
    """Bytes -> str: UTF-8, else Latin-1, which old exporters write and which never fails."""
    return bytes(data).removeprefix(b"\xef\xbb\xbf").decode(_coding_of(data))


def _statement(material, key, rest, notes):
    lower = key.lower()
    if lower == "kd":
        if rest.split()[0] in ("spectral", "xyz"):
            notes.drop(f"Kd {rest.split()[0]} of material '{material.name}'")
            return
        values = [float(value) for value in rest.split()[:3]]
        material.factor[:3] = values if len(values) == 3 else values[0]
    elif lower in ("d", "tr"):
        number = float(rest.split()[-1])  # "-halo" may precede it
        if lower == "d":
            material.dissolve = number
        else:
            material.transparency = number
    elif lower == "map_kd":
        _base_map(material, rest, notes)
    elif lower in STATEMENTS:
        material.statements.put(key, *_split_options(rest))
    elif lower in _MATTE or (lower in _GREY and _is_grey(rest)) or (lower in _ZERO and not any(map(_number, rest.split()))):
        notes.remark(f"{key} in the MTL file is left out")
    elif lower == "map_ka":
        material.ambient_map = _split_options(rest)[1]
    else:
        notes.drop(f"{key} of material '{material.name}'")


def _is_grey(rest):
    values = [_number(value) for value in rest.split()]
    return all(math.isfinite(value) for value in values) and max(values, default=0.0) - min(values, default=0.0) <= _SAME


def _number(text):
    """The number in a text, NaN if there is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _set_alpha(materials, from_meshlab, notes):
    """Set alpha by `d`, else by `Tr`. Tr is transparency, but MeshLab and others write opacity; the reading that leaves some
    material invisible and no material opaque is rejected."""
    by_tr = [material for material in materials if material.dissolve is None and material.transparency is not None]
    readings = [(True, [m.transparency for m in by_tr]), (False, [1.0 - m.transparency for m in by_tr])]
    if not from_meshlab:
        readings.reverse()
    as_dissolve, alphas = readings[0]
    if len(by_tr) == len(materials) and vanishes(alphas):
        as_dissolve, alphas = readings[1]
    if as_dissolve and any(material.transparency != 0.5 for material in by_tr):
        notes.remark("Tr in the MTL file is read as opacity, as MeshLab writes it, not as transparency")
    for material, alpha in zip(by_tr, alphas, strict=True):
        material.factor[3] = alpha
    for material in materials:
        if material.dissolve is not None:
            material.factor[3] = material.dissolve
            if material.transparency is not None and abs(material.dissolve + material.transparency - 1.0) > _SAME:
                notes.remark(f"d {material.dissolve:g} and Tr {material.transparency:g} of material '{material.name}' "
                             "disagree; d is used")


def _base_map(material, rest, notes):
    options, material.texture = _split_options(rest)
    for name, values in options:
        if name == "-s":
            material.uv_scale = (*map(float, values[:2]),)
        elif name == "-o":
            material.uv_offset = (*map(float, values[:2]),)
        elif name == "-clamp":
            material.wrap = (WRAP_CLAMP,) * 2 if values[:1] == ["on"] else (WRAP_REPEAT,) * 2
        elif name not in _HARMLESS_OPTIONS and not (name == "-mm" and [*map(_number, values)] == [0, 1][: len(values)]) \
                and not (name == "-t" and not any(map(_number, values))):
            notes.drop(f"map_Kd option {name} of material '{material.name}'")
    material.uv_scale = (*material.uv_scale, 1.0, 1.0)[:2]
    material.uv_offset = (*material.uv_offset, 0.0, 0.0)[:2]
    if not material.texture:
        notes.lose(f"map_Kd of material '{material.name}' (no file name)",
                   f"map_Kd of material '{material.name}' names no file; the material has no texture")


def _split_options(rest):
    """("-s 2 2 -clamp on my file.png") -> ([("-s", ["2", "2"]), ("-clamp", ["on"])], "my file.png").

    Blanks alone end a word: in Latin-1 others are halves of characters."""
    options = []
    while _OPTION.match(rest):
        name, _, rest = rest.partition(" ")
        values: list[str] = []
        most = _OPTIONS.get(name.lower(), 1)
        while len(values) < most and rest.strip(" "):
            value, _, after = rest.strip(" ").partition(" ")
            if most > 1 and values and math.isnan(_number(value)):
                break
            values.append(value)
            rest = after
        options.append((name.lower(), values))
        rest = rest.strip(" ")
    return options, rest.strip(" ").strip("\"'")


def _set_range(materials, notes):
    """Scale the colours of a file to 0..1, with a remark on those that do not fit."""
    colours = [material.factor[:3] for material in materials]
    rgb = unit_colours(np.array(colours).reshape(-1, 3), notes, "Kd in the MTL file")
    for material, value in zip(materials, rgb, strict=True):
        material.factor[:3] = value


def _finish(material, notes):
    if not material.texture and material.statements.maps:
        material.uv_scale, material.uv_offset, material.wrap = next(iter(material.statements.maps.values())).place
    if material.texture and not material.factor[:3].any():
        notes.lose(f"Kd of material '{material.name}' (black under a texture)",
                   f"material '{material.name}' has a texture and a black Kd; a white Kd is used instead")
        material.factor[:3] = 1.0
    elif material.texture and (material.factor[:3] != 1.0).any():
        factors = " ".join(f"{value:g}" for value in material.factor[:3])
        notes.remark(f"material '{material.name}' multiplies its texture by Kd {factors}, as the format says; some viewers do "
                     "not")
    if not np.isfinite(material.factor).all():
        notes.lose(f"colour of material '{material.name}' (NaN or infinite)",
                   f"material '{material.name}' has a NaN or infinite colour; white is used instead")
        material.factor[:] = 1.0
    np.clip(material.factor, 0.0, 1.0, out=material.factor)
    if material.ambient_map and material.ambient_map == material.texture:
        notes.remark("map_Ka in the MTL file has the image of map_Kd; it is left out")
    elif material.ambient_map:
        notes.drop(f"map_Ka of material '{material.name}'")


def scene_material(material: ObjMaterial, folder: Path, shelf: TextureShelf) -> Material:
    """Return the Material of an MTL entry, whose textures go to the shelf. folder: folder of the images."""
    texture, name = -1, material.texture
    joined = with_alpha(name, material.statements, folder, shelf.notes)
    if joined:
        texture = shelf.put(joined[0], joined[1], name or "map_d", material.wrap)
    if texture < 0 and name:
        texture = shelf.put(name, lambda: read_file(folder, name, shelf.notes), name, material.wrap)
    image = shelf.textures[texture].image if texture >= 0 else None
    mode = alpha_mode_with(material.statements, image, alpha_mode_of(material.factor))
    out = Material(name=material.name, factor=material.factor, texture=texture, alpha_mode=mode)
    complete(out, material.statements, (material.uv_scale, material.uv_offset, material.wrap), folder, shelf)
    return out


def write_mtl(texf: Texf, mesh: Textured, image_names: list[str]) -> tuple[list[bytes], list[str]]:
    """Return (the MTL file as pieces of bytes, an entry for each of mesh.materials; warnings on images that OBJ shows otherwise
    than the stream). image_names: file names of mesh.textures."""
    written, lines = [_write_map(mesh, n, name) for n, name in enumerate(image_names)], ["# texfcodec"]
    maps = [text for text, _ in written]
    for name, saved, images in zip(material_names(texf, mesh), mesh.materials.rows, mesh.images, strict=True):
        lines += [f"newmtl {name}", "Ka 1 1 1", "Ks 0 0 0", "illum 1", *number_lines(saved.material)]
        for channel, image in images.items():
            if channel != BASE_COLOUR.name:
                lines += map_lines(saved.material, channel, maps[image])
                continue
            lines.append(f"map_Kd {maps[image]}")
            if mesh.textures[image].image.shape[2] == 4 and saved.material.alpha_mode != ALPHA_OPAQUE:
                lines.append(f"map_d {maps[image]}")
    return [("\n".join(lines) + "\n").encode()], [text for _, texts in written for text in texts]


def _write_map(mesh, number, name):
    """(text behind a map's statement, warnings). OBJ repeats an image or clamps it along both axes. If UVs stay within the image,
    the option is left out, because some readers take it for a part of the file name."""
    shown = np.array([number in images.values() for images in mesh.images], bool)[mesh.materials.face_row]
    uv = mesh.corner_uv[shown]
    beyond = ((uv < 0) | (uv > 1)).any(axis=(0, 1))
    needed = {mode for mode, reached in zip(mesh.textures[number].wrap, beyond, strict=True) if reached}
    warnings = []
    if WRAP_MIRROR in needed or len(needed) > 1:
        warnings.append(f"OBJ can neither mirror an image nor repeat it along one axis only: {name} repeats along both")
    if mesh.textures[number].nearest:
        warnings.append(f"OBJ cannot hold how an image is filtered: texels of {name}, which are squares, are blended")
    return (f"-clamp on {name}" if needed == {WRAP_CLAMP} else name), warnings


def material_names(texf: Texf, mesh: Textured) -> list[str]:
    """Return a distinct name without blanks for each of mesh.materials.rows: the material's number and its name in the stream,
    and more numbers where these are not distinct."""
    shared = np.bincount([saved.number for saved in mesh.materials.rows], minlength=len(texf.materials)) > 1
    names = ["_".join(material.name.split()) or "material" for material in texf.materials]
    distinct: list[str] = []
    for saved in mesh.materials.rows:
        number = saved.number
        name = f"{number}_{names[number]}" + f"_{saved.skin}" * bool(shared[number])
        distinct.append(name + f"_{len(distinct)}" * (name in distinct))
    return distinct
