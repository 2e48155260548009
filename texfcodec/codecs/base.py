"""What a codec is: one way to code values on the keys of a support (spec clause 5.7).

A codec is a folder here, or a class of another package that a plug-in registers (codecs/__init__.py). All that knows it stands in
there: syntax, both directions, what texf-info and texf-enc say of it. Modules that define one load no numba; what does is
imported when it is used."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from ..core.syntax_table import Structure
from ..core.syntax_walk import Reader, read_structure, write_structure

if TYPE_CHECKING:
    from ..field.texels import TexelSupport
    from ..field.voxels import VoxelSupport
    from ..geometry.canonical import CanonicalCube
    from ..geometry.geometry_unit import LatticeMesh
    from ..geometry.surface import Surface
    from ..options import DecodeOptions, EncodeOptions
    from ..report import Report
    from ..scene.channels import Channel
    from ..scene.scene import Scene

Settings = Any  # of Codec.settings(): a dataclass of each codec's own
PROFILES = ("base", "lossless", "neural")  # spec 10.3, each with what those before it have
PRIVATE_IDS = range(192, 256)  # for codecs of strangers; their units name them (5.7)


class Group(NamedTuple):
    """Channels that are coded together. channels: of channels.CHANNELS; grey: whether one component stands for all of them."""

    channels: tuple[Channel, ...]
    grey: bool = False

    @property
    def components(self) -> int:
        """Values of a cell."""
        return 1 if self.grey else sum(channel.components for channel in self.channels)

    def join(self, planes: dict) -> np.ndarray:
        """Values [N, components] of planes [N, C] by channel name."""
        joined = np.concatenate([planes[channel.name] for channel in self.channels], axis=1)
        return np.ascontiguousarray(joined[:, : self.components])

    def split(self, values: np.ndarray) -> dict:
        """Mirror of join(): planes by channel name."""
        if self.grey:
            return {self.channels[0].name: np.repeat(values, self.channels[0].components, axis=1)}
        ends = np.cumsum([channel.components for channel in self.channels]).tolist()
        return {c.name: np.ascontiguousarray(values[:, end - c.components : end])
                for c, end in zip(self.channels, ends, strict=True)}


class Source(NamedTuple):
    """What a joint codec fits. scene: Scene; surface: geometry.surface.Surface; face_field: int64 [F] over its faces; surfaces:
    decoded, by field; groups: what is coded; maps: what the maps of materials say, a
    function of (name of a channel, faces int64 [M] that have it, weights of their corners float64 [M, 3], threads) that returns
    float32 [M, C] in 0..255; None where no material has a map; on_pictures: what brings a fit closer to rendered pictures, which
    this room cannot draw (encoder.values.picture_refinement.refine_by_pictures), for codecs that fit."""

    scene: Scene
    surface: Surface
    face_field: np.ndarray
    surfaces: list[LatticeMesh]
    groups: tuple[Group, ...]
    maps: Callable[[str, np.ndarray, np.ndarray, int], np.ndarray] | None = None
    on_pictures: Callable[..., tuple[list[dict], int]] | None = None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of all groups."""
        return tuple(channel for group in self.groups for channel in group.channels)

    def mapped(self, channel: Channel) -> np.ndarray:
        """The surface's faces whose material has a map of a channel, bool [F]."""
        return np.array([channel.material_name in m.maps for m in self.scene.materials], bool)[self.surface.material]


def split_groups(values: np.ndarray, groups: Sequence[Group]) -> dict:
    """Planes by channel name of values [N, components of all groups], the groups' components one after the other."""
    ends = np.cumsum([group.components for group in groups]).tolist()
    parts = [group.split(values[:, end - group.components : end]) for group, end in zip(groups, ends, strict=True)]
    return {name: plane for planes in parts for name, plane in planes.items()}


class Reading(NamedTuple):
    """What decoding a unit has shown beside its values. unread: bytes of codewords that no symbol needed (7.6.2); wrong_levels:
    counts of bytes by level (5.7.2) that are not those that were read."""

    unread: int = 0
    wrong_levels: int = 0


class Evaluator(Protocol):
    """What answers for one field of a joint codec: components of all groups, one after the other."""

    def values(self, support: VoxelSupport, threads: int) -> np.ndarray:
        """Of the support's voxels: uint8 [N, components]."""

    def query(self, cube: CanonicalCube, points: np.ndarray, threads: int) -> np.ndarray:
        """At world points, float64 [M, 3]: float32 [M, components] on 0..255."""


class Joint(NamedTuple):
    """What a joint codec made. values: of its syntax elements; evaluators: an Evaluator per field; choices: what the report
    says of it."""

    values: dict
    evaluators: list
    choices: dict


class Codec(ABC):
    """id: codec_id in the stream; name: what --codec takes; purpose: half a sentence for the help; structures: syntax tables, its
    parameters first; options: names of those EncodeOptions that no other codec but those that list them reads; position_bits:
    usual bits of a vertex coordinate; small: EncodeOptions of a run that compiles its kernels;
    kernels: files of the package with kernels that every run enters."""

    id: int
    name: str
    purpose: str = ""
    structures: tuple[Structure, ...] = ()
    options: frozenset[str] = frozenset()
    position_bits: int = 14
    joint: bool = False
    chosen: bool = True  # by a user; False where only the encoder takes it
    checksum_clause: str = "7.10"
    small: tuple[dict, ...] = ()
    kernels: tuple[str, ...] = ()

    @property
    def parameters(self) -> Structure:
        """Table of what follows the attribute unit's own elements."""
        return self.structures[0]

    def write_parameters(self, values: dict) -> bytes:
        """Its part of an attribute unit, of the unit's values."""
        return write_structure(self.parameters, values)

    def read_parameters(self, reader: Reader, values: dict, trace: list | None = None) -> None:
        """Mirror of write_parameters(): adds to values. trace: as read_structure(). Raises StreamError."""
        read_structure(self.parameters, reader, values, trace)

    def settings(self, options: EncodeOptions) -> Settings:
        """What enc() takes of EncodeOptions: a frozen dataclass of the codec's own, with "qp", "max_error" and "chroma_qp_offset"
        where it codes planes; all of them where it has none."""
        return options

    def check_options(self, options: EncodeOptions) -> None:
        """Refuses EncodeOptions that do not go together. Raises InputError."""
        return None

    def check(self, values: dict) -> None:
        """Relations between syntax values that a range cannot say. Raises StreamError."""
        return None

    def describe(self, values: dict) -> dict:
        """What inspect() says of an attribute unit beside what every unit has: JSON-ready."""
        return {}

    def profile(self, values: dict) -> str:
        """Which of PROFILES an attribute unit is of."""
        return PROFILES[0]

    def count_latents(self, values: dict) -> int:
        """Latents of an attribute unit (spec 10.1)."""
        return 0

    def info_lines(self, group: dict) -> Iterator[str]:
        """Lines of texf-info on an entry of inspect()'s groups."""
        place = f"field {group['field_index']}, group {group['group_index']} ({group['semantic']})"
        yield f"{place}: {group['bytes']} bytes, {self.name}"

    def suits(self, plane: np.ndarray) -> bool:
        """Whether the encoder should take this codec for the plane whatever was asked for. plane: float32 [N, C], 0..255."""
        return False

    def run_kernels(self, encoding: bool = True) -> None:
        """Runs the compiled functions that usual units need on a few values, so that they are in the cache: a decoder's, the
        longest to compile first, and with `encoding` an encoder's."""
        return None

    def seconds(self, options: EncodeOptions) -> float:
        """A guess of what encoding takes beside what it takes with any codec."""
        return 0.0


class PlaneCodec(Codec):
    """Codes one channel group of one field at a time."""

    has_levels = True  # whether dec() can leave out levels by itself; else a decoder takes means of what it gives

    @abstractmethod
    def enc(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, options: Settings) -> tuple[dict, np.ndarray]:
        """Codes values. plane: float32 [N, C] in 0..255 on the support's keys; support: VoxelSupport; options: of settings().
        Returns (values of its syntax elements, what dec() makes of them: uint8 [N, C]). Threads call it for several planes at
        the same time, as they call dec()."""

    @abstractmethod
    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """Mirror of enc(). values: of its syntax elements, with NumComponents and the file offset; levels: octree levels to leave
        out. Returns uint8 [n, C] on support.coarser(levels). Raises StreamError."""

    def step(self, values: dict) -> float | None:
        """Levels of 255 that the decoded values were quantised to, 0 where they are exact; None where the unit does not say."""
        return None

    def dec_watched(self, values: dict, support: VoxelSupport, threads: int) -> tuple[np.ndarray, Reading]:
        """dec() of all levels, and what has been seen of the unit on the way, for whoever validates it."""
        return self.dec(values, support, 0, threads), Reading()


class JointCodec(Codec):
    """Codes all fields and channel groups in one unit; a surface point then asks an Evaluator instead of the voxels."""

    joint = True

    @abstractmethod
    def enc(self, source: Source, options: Settings, report: Report) -> Joint:
        """Codes a source. options: of settings(); report: Report."""

    def count_samples(self, values: dict, surfaces: list[LatticeMesh], position_bits: int) -> int:
        """Surface samples that dec() takes beside those of the fields (6.3), known before any is taken."""
        return 0

    @abstractmethod
    def dec(self, values: dict, surfaces: list[LatticeMesh], position_bits: int, groups: tuple[Group, ...],
            options: DecodeOptions, report: Report) -> list[Evaluator]:
        """Evaluators by field. surfaces: decoded, by field. Raises StreamError, LimitError."""

    @abstractmethod
    def pack(self, evaluators: list) -> tuple[dict, dict]:
        """(JSON-ready facts, arrays) that the codec's own evaluators can be made of again in another process."""

    @abstractmethod
    def unpack(self, facts: dict, arrays: dict, groups: tuple[Group, ...], fields: int) -> list[Evaluator]:
        """Mirror of pack(); nothing in its arguments is trusted. Raises TexfError, ValueError, KeyError, TypeError."""

    @abstractmethod
    def result_lines(self, facts: dict) -> Iterator[str]:
        """Lines of texf-enc on what was made. facts: what --json prints."""
