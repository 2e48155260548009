"""Factors: a map of one value is what a material's parameter can say, and a value is what a map and its factor say together."""

from __future__ import annotations

import numpy as np

from .channels import BY_NAME, PARAMETER_BY_NAME, Channel
from .srgb import srgb_to_linear

TOLERANCE = 2.0  # levels of 255 that a value may be off and count as the same
FLAT = 127.5  # of a normal map's x and y where the normal is the surface's own, and of a deviation where there is none
NEUTRAL = {"anisotropy": (255.0, FLAT, 255.0)}  # values, but 255, of a map that says as much as none


def factor_of(parameters: dict, name: str) -> tuple[float, ...]:
    """A parameter among those of a material that are not the default."""
    return parameters.get(name, PARAMETER_BY_NAME[name].default)


def set_factor(parameters: dict, name: str, value: tuple[float, ...]) -> None:
    """Puts a parameter's value among those that are not the default, as a stream holds it, in binary32."""
    value = tuple(float(np.float32(v)) for v in value)
    parameters.pop(name, None)
    if value != PARAMETER_BY_NAME[name].default:
        parameters[name] = value


def says_nothing(channel: Channel, value: np.ndarray) -> bool:
    """Whether a map of one value, float64 [C] in 0..255, is as good as none, within TOLERANCE. channel: as materials name it."""
    if channel.unit == "degrees":
        return bool(np.abs(value - FLAT).max() <= TOLERANCE)
    neutral = np.array(NEUTRAL.get(channel.name, (255.0,) * channel.components))
    return bool(np.abs(value - neutral).max() <= TOLERANCE / 2)


def absorb(parameters: dict, channel: Channel, value: np.ndarray) -> bool:
    """Brings a map's one value, float64 [C] in 0..255, into the parameters, or leaves it out where it says nothing: whether that
    can be done. channel: as a material names it."""
    name = channel.name
    if says_nothing(channel, value):
        return True
    if channel.unit == "degrees" or name in ("occlusion", *NEUTRAL):
        return False
    if name == "iridescence_thickness":
        low, high = (factor_of(parameters, f"{name}_{end}")[0] for end in ("minimum", "maximum"))
        set_factor(parameters, f"{name}_maximum", (low + (high - low) * float(value[0]) / 255,))
        return True
    share = srgb_to_linear(value / 255) if channel.srgb else value / 255
    factor = factor_of(parameters, channel.parameter)
    set_factor(parameters, channel.parameter, tuple(float(f * s) for f, s in zip(factor, share, strict=True)))
    return True


def neutral_values(name: str) -> tuple[float, ...]:
    """Values 0..255 of a map, of a channel as a material names it, that says as much as none."""
    channel = BY_NAME[name]
    return (FLAT,) * channel.components if channel.unit == "degrees" else NEUTRAL.get(name, (255.0,) * channel.components)


def linear_values(name: str, values: np.ndarray) -> np.ndarray:
    """A map's values, float32 [M, C] in 0..255, as 0..1, linear."""
    share = values / np.float32(255)
    return srgb_to_linear(share).astype(np.float32) if BY_NAME[name].srgb else share


def with_factor(name: str, share: np.ndarray, factor: np.ndarray | None) -> np.ndarray:
    """What a material has where its map of a channel has share, float32 [M, C], linear, 0..1. factor: float32 [M, c] or [c] of
    the channel's parameter, None where it has none. Occlusion is mixed with 1; of anisotropy only the strength has a factor."""
    if factor is None:
        return share
    if name == "occlusion":
        return 1 + factor * (share - 1)
    if name == "anisotropy":
        return np.concatenate([share[..., :2], share[..., 2:] * factor], axis=-1)
    return share * factor
