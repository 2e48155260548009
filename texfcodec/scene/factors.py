"""Factors of maps: a map of one value is equivalent to a parameter of its material, and a final value is a map's value times its
factor."""

from __future__ import annotations

import numpy as np

from .channels import BY_NAME, PARAMETER_BY_NAME, Channel
from .srgb import srgb_to_linear

TOLERANCE = 2.0  # levels of 255 that a value may be off and count as the same
FLAT = 127.5  # of a normal map's x and y where the normal is the surface's own, and of a deviation where there is none
NEUTRAL = {"anisotropy": (255.0, FLAT, 255.0)}  # values, but 255, of a map that says as much as none


def factor_of(parameters: dict, name: str) -> tuple[float, ...]:
    """Return a parameter of a material, or its default.

    Parameters
    ----------
    parameters : dict
        Those that are not the default, by name.
    name : str
        Of a row of channels.PARAMETERS.

    Returns
    -------
    tuple of float
        Its value, or the default.
    """
    return parameters.get(name, PARAMETER_BY_NAME[name].default)


def set_factor(parameters: dict, name: str, value: tuple[float, ...]) -> None:
    """Set a parameter in a material's dict, rounded to binary32 as in a stream, or remove it if it is the default.

    Parameters
    ----------
    parameters : dict
        Those that are not the default, by name; changed.
    name : str
        Of a row of channels.PARAMETERS.
    value : sequence of float
        Components of the parameter.
    """
    value = tuple(float(np.float32(v)) for v in value)
    parameters.pop(name, None)
    if value != PARAMETER_BY_NAME[name].default:
        parameters[name] = value


def says_nothing(channel: Channel, value: np.ndarray) -> bool:
    """Return whether a map that has the same value everywhere has no effect on the picture, within TOLERANCE.

    Parameters
    ----------
    channel : Channel
        As in a material: over texels.
    value : float64 [C]
        0..255.

    Returns
    -------
    bool
        True if the map can be left out.
    """
    if channel.unit == "degrees":
        return bool(np.abs(value - FLAT).max() <= TOLERANCE)
    neutral = np.array(NEUTRAL.get(channel.name, (255.0,) * channel.components))
    return bool(np.abs(value - neutral).max() <= TOLERANCE / 2)


def absorb(parameters: dict, channel: Channel, value: np.ndarray) -> bool:
    """Replace a map that has the same value everywhere by a factor: multiply the channel's parameter by it, if glTF has one.

    Parameters
    ----------
    parameters : dict
        Those that are not the default, by name; changed.
    channel : Channel
        As in a material: over texels.
    value : float64 [C]
        0..255.

    Returns
    -------
    bool
        True if the map can now be left out, also because it has no effect; False if it must stay.
    """
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
    """Return the value that a map must have to have no effect.

    Parameters
    ----------
    name : str
        Of the channel, as in a material.

    Returns
    -------
    tuple of float
        0..255, one for each component.
    """
    channel = BY_NAME[name]
    return (FLAT,) * channel.components if channel.unit == "degrees" else NEUTRAL.get(name, (255.0,) * channel.components)


def linear_values(name: str, values: np.ndarray) -> np.ndarray:
    """Convert a map's values to 0..1, and colours from sRGB to linear light.

    Parameters
    ----------
    name : str
        Of the channel.
    values : float32 [M, C]
        0..255.

    Returns
    -------
    float32 [M, C]
        0..1, linear.
    """
    share = values / np.float32(255)
    return srgb_to_linear(share).astype(np.float32) if BY_NAME[name].srgb else share


def with_factor(name: str, share: np.ndarray, factor: np.ndarray | None) -> np.ndarray:
    """Return the values that shading uses: those of a map times the factor of its channel.

    Parameters
    ----------
    name : str
        Of the channel.
    share : float32 [M, C]
        The map's values, linear, 0..1.
    factor : float32 [M, c] or [c], optional
        Of the channel's parameter; None if it has none.

    Returns
    -------
    float32 [M, C]
        The product. Occlusion is mixed with 1 instead, by the factor; of anisotropy only the strength is multiplied.
    """
    if factor is None:
        return share
    if name == "occlusion":
        return 1 + factor * (share - 1)
    if name == "anisotropy":
        return np.concatenate([share[..., :2], share[..., 2:] * factor], axis=-1)
    return share * factor
