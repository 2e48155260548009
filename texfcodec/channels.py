"""What coded values mean: one table of channels (spec clause 5.3.1), read by transfer, syntax, codecs, fields and writers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

TRANSFER_LINEAR, TRANSFER_SRGB = 0, 1
OPAQUE = 0  # alpha_mode (5.4.1) of materials that need no alpha


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One meaning of values. semantic, transfer, components: as in the stream's channel group; columns: which of red, green, blue
    and alpha (0..3) its components are where a surface point is asked; needed: whether materials in use ask for it."""

    name: str
    semantic: int
    transfer: int
    components: int
    columns: tuple[int, ...]
    needed: Callable[[list], bool]

    @property
    def group(self) -> dict:
        """Syntax values of the channel group (5.3.1)."""
        return {"group_semantic": self.semantic, "group_transfer": self.transfer, "group_components": self.components}


BASE_COLOUR = Channel(name="base_colour", semantic=0, transfer=TRANSFER_SRGB, components=3, columns=(0, 1, 2),
                      needed=lambda materials: True)
ALPHA = Channel(name="alpha", semantic=1, transfer=TRANSFER_LINEAR, components=1, columns=(3,),
                needed=lambda materials: any(m.alpha_mode != OPAQUE for m in materials))
CHANNELS = (BASE_COLOUR, ALPHA)
BY_SEMANTIC = {channel.semantic: channel for channel in CHANNELS}
BY_NAME = {channel.name: channel for channel in CHANNELS}
COLUMNS = 4  # of what a surface point answers
FULL = 255  # what a column holds that no channel gives


def channels_of(groups: list) -> tuple[Channel, ...]:
    """The channels of a stream's channel groups, in their order. groups: syntax values, already checked."""
    return tuple(BY_SEMANTIC[group["group_semantic"]] for group in groups)


def columns_of(channels: Sequence[Channel]) -> list[int]:
    """The RGBA columns of several channels, one component after the other."""
    return [column for channel in channels for column in channel.columns]


def join_planes(planes: dict, count: int) -> np.ndarray:
    """RGBA uint8 [count, 4] of planes by channel name, uint8 [count, C]; columns that none of them gives are FULL."""
    out = np.full((count, COLUMNS), FULL, np.uint8)
    for name, plane in planes.items():
        out[:, list(BY_NAME[name].columns)] = plane
    return out


def split_values(values: np.ndarray, channels: Sequence[Channel]) -> dict:
    """Planes by channel name of values [N, all components], the channels' components one after the other."""
    ends = np.cumsum([channel.components for channel in channels]).tolist()
    return {c.name: values[:, end - c.components : end] for c, end in zip(channels, ends, strict=True)}
