"""Statements of an MTL entry beyond Kd, d and map_Kd, read and written: those of physically based materials.

Blender, three.js and assimp know Pr, Pm and their maps, and norm. Numbers of Ke are coded like those of Kd.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..scene.channels import BASE_COLOUR
from ..scene.scene import ALPHA_BLEND, WRAP_CLAMP, WRAP_REPEAT, Material
from ..scene.srgb import linear_to_srgb
from .file_search import read_file
from .images import TextureShelf, read_image

if TYPE_CHECKING:
    from .parts import Notes

MAP_STATEMENTS = {"emissive": ("map_Ke",), "roughness": ("map_Pr",), "metallic": ("map_Pm",), "normal": ("norm", "map_Bump")}
MTL_CHANNELS = (BASE_COLOUR.name, *MAP_STATEMENTS)  # those that an OBJ shows, each by an image of its own
_NUMBERS = {"ke": 3, "pr": 1, "pm": 1}
_CHANNEL_OF = {"map_ke": "emissive", "map_pr": "roughness", "map_pm": "metallic", "norm": "normal", "map_bump": "bump",
               "bump": "bump", "map_d": "alpha"}
STATEMENTS = frozenset(_NUMBERS) | frozenset(_CHANNEL_OF)
_BLUE, _GREY = 160.0, 16.0  # least mean blue of a normal map, and its least distance from red and green: heights are grey


@dataclass
class MtlMap:
    """An image that an entry names. options: [(option, values)] before its name."""

    statement: str
    name: str
    options: list = field(default_factory=list)

    def numbers(self, option: str, usual: tuple[float, ...]) -> tuple[float, ...]:
        """Return the values of an option such as "-s", as many as usual has. usual: defaults of absent values."""
        values: list = next((values for name, values in self.options if name == option), [])
        return (*map(float, values[: len(usual)]), *usual)[: len(usual)]

    @property
    def place(self) -> tuple:
        """(scale, offset, wrap) of its UVs."""
        clamped = any(name == "-clamp" and values[:1] == ["on"] for name, values in self.options)
        return self.numbers("-s", (1.0, 1.0)), self.numbers("-o", (0.0, 0.0)), (WRAP_CLAMP if clamped else WRAP_REPEAT,) * 2


@dataclass
class MtlStatements:
    """Statements of an entry on light. numbers: float64 by statement in lower case, those of ke linear once the file is read and
    divided by peak; maps: MtlMap by channel, `bump` and `alpha` among them; peak: largest number of ke, at least 1."""

    numbers: dict[str, np.ndarray] = field(default_factory=dict)
    maps: dict[str, MtlMap] = field(default_factory=dict)
    peak: float = 1.0

    def put(self, key: str, options: list, rest: str) -> None:
        """Store a statement: an image or up to three numbers. key: one of STATEMENTS; options: as of MtlMap; rest: the text
        behind them. Raises ValueError if it cannot be read."""
        lower = key.lower()
        if lower in _CHANNEL_OF:
            if not rest:
                raise ValueError(f"{key} without a file")
            self.maps[_CHANNEL_OF[lower]] = MtlMap(key, rest, options)
            return
        values = [float(value) for value in rest.split()[:3]]
        self.numbers[lower] = np.array((values * 3)[:3] if len(values) < 3 else values)[: _NUMBERS[lower]]
        if not np.isfinite(self.numbers[lower]).all():
            raise ValueError(f"{key} is NaN or infinite")
        np.clip(self.numbers[lower], 0.0, None, out=self.numbers[lower])

    def coded_emission(self) -> list[np.ndarray]:
        """The numbers of Ke for linearise_factors(), in 0..1; [] if Ke is black or absent. Sets peak."""
        if "ke" not in self.numbers:
            return []
        if not self.numbers["ke"].any():
            del self.numbers["ke"]
            return []
        self.peak = max(1.0, float(self.numbers["ke"].max()))
        self.numbers["ke"] /= self.peak
        return [self.numbers["ke"]]


def complete(material: Material, statements: MtlStatements, place: tuple, folder: Path, shelf: TextureShelf) -> None:
    """Add the maps and parameters of an MTL entry to its Material, in place. statements: of the entry; place: (scale, offset,
    wrap) of its faces' UVs; folder: folder of the images, which go to the shelf. If a map has another place, its options are
    named as dropped."""
    for channel, mtl_map in statements.maps.items():
        if channel == "alpha" or channel == "bump" and "normal" in statements.maps:
            continue
        if _put(material, channel, mtl_map, (folder, place[2]), shelf) and mtl_map.place != place:
            shelf.notes.drop(f"-s, -o or -clamp of {mtl_map.statement} of material '{material.name}', which differ from those of "
                             "its first image")
    _set_parameters(material, statements)


def _put(material, channel, mtl_map, where, shelf):
    """Put an image on the shelf and into the material's maps, if it can be used; returns whether it is."""
    folder, wrap = where
    at = shelf.put(mtl_map.name, lambda: read_file(folder, mtl_map.name, shelf.notes), mtl_map.name, wrap,
                   "normal" if channel == "bump" else channel)
    if at < 0:
        return False
    if channel == "bump" and not _is_normal_map(shelf.textures[at].image):
        shelf.notes.drop(f"{mtl_map.statement} of material '{material.name}', a map of heights")
        return False
    name = "normal" if channel == "bump" else channel
    material.maps[name] = at
    scale = mtl_map.numbers("-bm", (1.0,))
    if name == "normal" and scale != (1.0,):
        material.parameters["normal_scale"] = scale
    return True


def _is_normal_map(image):
    """Return whether an image of `bump`, uint8 [H, W, 4], holds normals, as Blender writes, or heights."""
    red, green, blue = image[..., :3].reshape(-1, 3).mean(axis=0)
    return bool(blue >= _BLUE and blue - max(red, green) >= _GREY)


def _set_parameters(material, statements):
    """Set roughness, metalness and emission. A factor of 0 beside a map is ignored, because its exporters mean the map alone."""
    for statement, name, usual in (("pr", "roughness", 1.0), ("pm", "metallic", 1.0)):
        value = float(min(statements.numbers.get(statement, np.array([usual]))[0], 1.0))
        if name in material.maps and value == 0:
            value = usual
        if statement in statements.numbers and value != usual:
            material.parameters[name] = (value,)
        elif name == "metallic" and (statement in statements.numbers or name in material.maps):
            material.parameters[name] = (usual,)
    if "ke" in statements.numbers or "emissive" in material.maps:
        material.parameters["emissive"] = tuple(statements.numbers.get("ke", np.ones(3)).tolist())
    if statements.peak > 1:
        material.parameters["emissive_strength"] = (statements.peak,)


def with_alpha(texture: str | None, statements: MtlStatements, folder: Path, notes: Notes) -> tuple[tuple, Callable] | None:
    """Return (key, fetch) for TextureShelf.put(): the image of map_Kd with the alpha of map_d. None without map_d, or if both are
    the same image, which has its own alpha. texture: file name of map_Kd, or None; folder: of the images. fetch raises InputError
    TXF-I16, TXF-I17."""
    opacity = statements.maps.get("alpha")
    if opacity is None or opacity.name == texture:
        return None

    def fetch():
        from PIL import Image

        alpha = _alpha_of(read_image(read_file(folder, opacity.name, notes), opacity.name, notes, is_colour=False))
        if texture is None:
            rgba = np.full((*alpha.shape, 4), 255, np.uint8)
        else:
            rgba = read_image(read_file(folder, texture, notes), texture, notes)
        size = max(alpha.shape, rgba.shape[:2])
        image = Image.fromarray(rgba).convert("RGB").resize(size[::-1], Image.Resampling.BILINEAR)
        image.putalpha(Image.fromarray(alpha).resize(size[::-1], Image.Resampling.BILINEAR))
        return image

    return (texture, opacity.name), fetch


def _alpha_of(image):
    """Opacity in an image of map_d, uint8 [H, W]: its alpha if any is below 255, else its grey."""
    alpha = image[..., 3]
    return np.ascontiguousarray(alpha if (alpha < 255).any() else image[..., :3].mean(axis=2).round().astype(np.uint8))


def alpha_mode_with(statements: MtlStatements, image: np.ndarray | None, by_factor: int) -> int:
    """Return the alpha mode of a material: it blends if its image has alpha from map_d. image: of its base colour, uint8 [H, W,
    4], or None; by_factor: the mode by `d` alone, which is returned otherwise."""
    if "alpha" in statements.maps and image is not None and (image[..., 3] < 255).any():
        return ALPHA_BLEND
    return by_factor


def number_lines(material: Material) -> list[str]:
    """Return the MTL lines Kd, d, Ke, Pr and Pm of a decoded Material. Emission above 1 is divided by its peak before sRGB
    coding, which clips, and multiplied after it."""
    lines = [f"Kd {_text(linear_to_srgb(material.factor[:3]))}", f"d {material.factor[3]:.6g}"]
    if material.unlit:
        return lines
    strength = material.parameters.get("emissive_strength", (1.0,))[0]
    emission = np.array(material.parameters.get("emissive", (0.0,) * 3)) * strength
    if emission.any() and np.isfinite(emission).all():
        peak = max(1.0, float(emission.max()))
        lines.append(f"Ke {_text(linear_to_srgb(emission / peak) * peak)}")
    for statement, name in (("Pr", "roughness"), ("Pm", "metallic")):
        lines.append(f"{statement} {material.parameters.get(name, (1.0,))[0]:.6g}")
    return lines


def map_lines(material: Material, channel: str, target: str) -> list[str]:
    """Return the MTL lines that name the image of a channel other than base colour. target: the image's file name, behind -clamp
    if needed."""
    scale = material.parameters.get("normal_scale", (1.0,))[0]
    option = f"-bm {scale:.6g} " if channel == "normal" and scale != 1 else ""
    return [f"{statement} {option}{target}" for statement in MAP_STATEMENTS[channel]]


def _text(values):
    return " ".join(f"{value:.6g}" for value in values)
