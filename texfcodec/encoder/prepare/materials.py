"""Reduction of materials to what has to be coded: decided by values, channel by channel, and reported (encoder only).

A map whose texels on the surface are all alike becomes a factor. If the factor has its default value, even that is left out, and
so is a map that no effect reads. All other maps have to be coded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import InputError
from ...field.extents import MAX_SIDE
from ...field.morton import decode_morton
from ...field.texel_set import MAX_UV, count_rows, referenced_texels
from ...geometry.draco import MAX_UV_BITS
from ...scene.channels import BY_NAME, COLOURS, MAPS, binary32
from ...scene.effects import BY_NAME as EFFECT_BY_NAME
from ...scene.effects import EFFECT_OF, EFFECTS, without
from ...scene.factors import TOLERANCE, absorb, says_nothing
from ...scene.scene import ALPHA_OPAQUE, Material, Scene
from ...scene.srgb import linear_to_srgb
from ..caches import Cache
from ..decision import Decision

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Texture

MOST_ROWS = 1 << 26  # of texels that the faces of a material go over; beyond, the whole image is looked at
MOST_REASONS = 4  # in the report of one channel
QUICK_LOOK = 1 << 12  # texels that are looked at before all are
DECISIONS = ("coded", "constant", "absent")
VARIES = "the value varies"
KEPT = ("lit", "mask", "blend", "double_sided")  # effects that are flags and no channel's


@dataclass(frozen=True)
class Needs:
    """scene: with the materials to be coded, alpha left out if it is opaque everywhere; materials: as the stream holds them."""

    scene: Scene
    materials: list[Material]


class _Row(NamedTuple):
    """The decision on a channel of one material, and its reason. decision: of DECISIONS."""

    channel: str
    decision: str
    reason: str


def needed_scene(scene: Scene, surface: Surface, effects: str) -> Decision[Needs]:
    """Return the Decision on the Needs of a scene: the maps that have to be coded, without those that are constant or that
    nothing reads. Its evidence is a dict for each channel that any material in use has. surface: the scene on its lattice;
    effects: as of EncodeOptions. Raises InputError for an unknown effect."""
    wanted, used = _wanted(effects), set(np.unique(surface.material).tolist())
    usage, rows = _TexelUsage(scene, surface), []
    coded, stream = [], []
    for number, material in enumerate(scene.materials):
        kept = replace(material, parameters={name: binary32(value) for name, value in material.parameters.items()})
        if number in used:
            if wanted is not None:
                rows += [_Row(name, "absent", "not requested") for name in _unwanted(kept, wanted)]
                kept = _without_effects(kept, wanted)
            kept, decided = _needed(kept, number, usage, effects == "all")
            rows += decided
        stream.append(kept)
        seen = number in used and kept.alpha_mode != ALPHA_OPAQUE and usage.alpha_is_full(number)
        if number in used and kept.alpha_mode != ALPHA_OPAQUE:
            rows.append(_Row("alpha", "absent", "255 everywhere") if seen else _Row("alpha", "coded", VARIES))
        coded.append(replace(kept, alpha_mode=ALPHA_OPAQUE) if seen else kept)
    return Decision(Needs(replace(scene, materials=coded), stream), _counted(rows))


def _wanted(requested):
    """Return the effects of EncodeOptions.effects, None for all that are used; "none" leaves out the map of roughness, too, but
    keeps light."""
    if requested in ("auto", "all"):
        return None
    names = [name.strip() for name in str(requested).split(",") if name.strip()]
    unknown = [name for name in names if name not in EFFECT_BY_NAME and name != "none"]
    if unknown:
        raise InputError("TXF-I50", "unknown effect", value=", ".join(unknown),
                         allowed="auto, all, none, " + ", ".join(effect.name for effect in EFFECTS if effect.name not in KEPT))
    return {*names, *KEPT} - ({"lit"} if names == ["none"] else set())


def _needed(material, number, usage, is_all):
    """Return (a Material with the maps that have to be coded and the parameters that replace the others, _Rows). is_all: whether
    every map is coded, whatever it holds."""
    maps, parameters, rows = {}, dict(material.parameters), []
    for name, texture in material.maps.items():
        reason = "" if is_all else _idle_reason(material, name)
        value = None if reason or is_all else usage.constant(number, name)
        if reason:
            rows.append(_Row(name, "absent", reason))
        elif value is None or not absorb(parameters, BY_NAME[name], value):
            maps[name] = texture
            rows.append(_Row(name, "coded", VARIES if value is None else "the value is constant, but no parameter can hold it"))
        else:
            decision = "absent" if says_nothing(BY_NAME[name], value) else "constant"
            rows.append(_Row(name, decision, f"the surface shows only {', '.join(str(round(float(v))) for v in value)}"))
    return replace(material, maps=maps, parameters=parameters), rows


def _unwanted(material, wanted):
    """Return channels of a material's maps that only unwanted effects read, by effect."""
    return [name for effect in EFFECTS if effect.name not in wanted for name in set(effect.channels) & {*material.maps}]


def _without_effects(material, wanted):
    """Return a Material without the maps and parameters of unwanted effects."""
    for effect in EFFECTS:
        if effect.name not in wanted:
            material = without(material, effect)
    return material


def _idle_reason(material, name):
    """Return why nothing reads a map, or ""."""
    if material.unlit:
        return "the material is unlit"
    effect = EFFECT_OF[name]
    return "" if effect.used(material) else f"no {effect.name.replace('_', ' ')}: its factor is 0"


def _counted(rows):
    """Return the rows of the report by channel, in the order of the channels: the number of materials with each decision, and the
    reasons."""
    channels: dict[str, dict] = {}
    for row in rows:
        entry = channels.setdefault(row.channel, {"channel": row.channel, **dict.fromkeys(DECISIONS, 0), "reasons": []})
        entry[row.decision] += 1
        if row.reason not in entry["reasons"] and len(entry["reasons"]) < MOST_REASONS:
            entry["reasons"].append(row.reason)
    order = [channel.name for channel in (*COLOURS, *MAPS)]
    return sorted(channels.values(), key=lambda entry: order.index(entry["channel"]))


class _TexelUsage:
    """Texels that the faces of a material show of its images, found once for all maps that share UVs."""

    def __init__(self, scene: Scene, surface: Surface) -> None:
        self.scene, self.surface = scene, surface
        self._shown = Cache()

    def constant(self, number: int, name: str) -> np.ndarray | None:
        """Return the constant value of a map wherever the surface shows it, float64 [C] in 0..255, or None if it varies. number:
        of the material; name: channel of the map."""
        place = self.scene.materials[number].maps[name]
        if place < 0:
            return _corner_value(self.scene.corner_map[name][self._faces(number)], name)
        texture = self.scene.textures[place]
        columns = list(BY_NAME[name].columns)
        few = texture.image[:: max(1, texture.image.shape[0] // 64), :: max(1, texture.image.shape[1] // 64), columns]
        whole = _one_value(few.reshape(-1, len(columns)))
        if whole is not None:
            whole = _one_value(texture.image[..., columns].reshape(-1, len(columns)))
        if whole is not None:
            return whole
        shown = self._texels(number, self.scene.map_uv.get(name, self.scene.corner_uv), texture)
        if shown is None:
            return None
        for texels in (shown[:: max(1, len(shown) // QUICK_LOOK)], shown):
            value = _one_value(texture.image[texels[:, 1], texels[:, 0]][:, columns])
            if value is None:
                return None
        return value

    def alpha_is_full(self, number: int) -> bool:
        """Return whether alpha is 255 wherever the surface shows a material. number: of the material."""
        material, faces = self.scene.materials[number], self._faces(number)
        colour = self.scene.corner_color
        if material.factor[3] < 1 or (colour is not None and (colour[faces, :, 3] < 1).any()):
            return False
        if material.texture < 0:
            return True
        texture = self.scene.textures[material.texture]
        if (texture.image[..., 3] == 255).all():
            return True
        shown = self._texels(number, self.scene.corner_uv, texture)
        return shown is not None and bool((texture.image[shown[:, 1], shown[:, 0], 3] == 255).all())

    def _faces(self, number):
        return self.surface.origin_face[self.surface.material == number]

    def _texels(self, number, corner_uv, texture):
        """Return (column, row) of the texels that the faces of a material show, int64 [N, 2]; None if that takes too long."""
        key = (number, id(corner_uv), texture.image.shape[:2], tuple(texture.wrap))
        return self._shown.get(key, lambda: shown_texels(corner_uv[self._faces(number)], texture))


def shown_texels(uv: np.ndarray, texture: Texture, fraction_bits: int = 0) -> np.ndarray | None:
    """Return the distinct texels of a Texture that faces show, (column, row) int64 [N, 2], wrapped into the image; None if UVs
    or image are too large, or the faces go over more than MOST_ROWS rows of texels. uv: float64 [F, 3, 2], UVs of their corners,
    which are rounded to 2**-fraction_bits texels."""
    height, width = texture.image.shape[:2]
    steps = uv * np.array([width, height], np.float64) * (1 << fraction_bits)
    if max(width, height) > MAX_SIDE or not (np.abs(steps) < min(MAX_UV, 1 << MAX_UV_BITS + 5)).all():
        return None
    steps, corners = np.floor(steps + 0.5).astype(np.int64).reshape(-1, 2), np.arange(3 * len(uv)).reshape(-1, 3)
    if count_rows(steps, corners, fraction_bits) > MOST_ROWS:
        return None
    return decode_morton(referenced_texels(steps, corners, fraction_bits, (width, height), tuple(texture.wrap)))[:, :2]


def _corner_value(values, name):
    """Return _one_value() of a channel's values at corners, float32 [F, 3, C], as an image would hold them."""
    coded = linear_to_srgb(values) if BY_NAME[name].srgb else values
    return _one_value(255 * coded.reshape(-1, coded.shape[2])) if len(values) else None


def _one_value(values):
    """Return the middle of values in 0..255 [N, C], float64 [C], if none is further off than TOLERANCE; else None."""
    low, high = values.min(axis=0).astype(np.float64), values.max(axis=0).astype(np.float64)
    return (low + high) / 2 if (high - low).max() <= 2 * TOLERANCE else None

