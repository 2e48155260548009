"""The interface of a codec: it codes values on the keys of a support (spec clause 5.7).

A codec is a folder of this package, or a class of another package that a plug-in registers (codecs/__init__.py). The codec holds
all that is specific to it: syntax, both directions, its lines in texf-info and texf-enc. Modules that define a codec load no
numba; they import kernels at first use.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
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
    from ..scene.scene import Material, Scene

Settings = Any  # of Codec.settings(): a dataclass of each codec's own
PROFILES = ("base", "lossless", "neural")  # spec 10.3, each with what those before it have
PRIVATE_IDS = range(192, 256)  # for codecs of others; their units name them (5.7)


class Group(NamedTuple):
    """Channels that are coded together.

    Attributes
    ----------
    channels : tuple of Channel
        Of scene.channels.CHANNELS.
    grey : bool
        Whether one component stands for all of them.
    """

    channels: tuple[Channel, ...]
    grey: bool = False

    @property
    def components(self) -> int:
        """Number of components of the group."""
        return 1 if self.grey else sum(channel.components for channel in self.channels)

    def join(self, planes: dict) -> np.ndarray:
        """Concatenates planes to the values of the group.

        Parameters
        ----------
        planes : dict of array [N, C], by channel name

        Returns
        -------
        array [N, components]
            Contiguous; the first component alone if the group is grey.
        """
        joined = np.concatenate([planes[channel.name] for channel in self.channels], axis=1)
        return np.ascontiguousarray(joined[:, : self.components])

    def split(self, values: np.ndarray) -> dict:
        """Split values of the group into planes by channel; the mirror of join().

        Parameters
        ----------
        values : array [N, components]

        Returns
        -------
        dict of array [N, C], planes by channel name
        """
        if self.grey:
            return {self.channels[0].name: np.repeat(values, self.channels[0].components, axis=1)}
        ends = np.cumsum([channel.components for channel in self.channels]).tolist()
        return {c.name: np.ascontiguousarray(values[:, end - c.components : end])
                for c, end in zip(self.channels, ends, strict=True)}


class Source(NamedTuple):
    """Input of a joint codec.

    Attributes
    ----------
    scene : Scene
        The source asset.
    surface : Surface
        The source on its lattice.
    face_field : int64 [F]
        Field of each face of surface.
    surfaces : list of LatticeMesh, decoded, by field
    groups : tuple of Group
        The channels to code.
    maps : callable, optional
        (channel name, faces int64 [M] that have the map, weights of their corners float64 [M, 3], threads) -> float32 [M, C] in
        0..255, the values of the materials' maps. None if no material has a map.
    on_pictures : callable, optional
        Improves a fit by comparing rendered pictures (encoder.values.picture_refinement.refine_by_pictures); this room cannot
        render.
    """

    scene: Scene
    surface: Surface
    face_field: np.ndarray
    surfaces: list[LatticeMesh]
    groups: tuple[Group, ...]
    maps: Callable[[str, np.ndarray, np.ndarray, int], np.ndarray] | None = None
    on_pictures: Callable[..., tuple[list[dict], int]] | None = None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of all groups, in order."""
        return tuple(channel for group in self.groups for channel in group.channels)

    def mapped(self, channel: Channel) -> np.ndarray:
        """Select the faces whose material has a map, such as a texture, of a channel.

        Parameters
        ----------
        channel : Channel

        Returns
        -------
        bool [F], over the faces of surface
        """
        return np.array([channel.material_name in m.maps for m in self.scene.materials], bool)[self.surface.material]

    def materials_of(self, field: int) -> list[Material]:
        """Lists the materials of a field's faces.

        Parameters
        ----------
        field : int

        Returns
        -------
        list of Material
        """
        return [self.scene.materials[m] for m in np.unique(self.surface.material[self.face_field == field])]


def split_groups(values: np.ndarray, groups: Sequence[Group]) -> dict:
    """Splits the values of several groups into planes.

    Parameters
    ----------
    values : array [N, C]
        Components of all groups, one group after the other.
    groups : sequence of Group, in that order

    Returns
    -------
    dict of array [N, c], planes by channel name
    """
    ends = np.cumsum([group.components for group in groups]).tolist()
    parts = [group.split(values[:, end - group.components : end]) for group, end in zip(groups, ends, strict=True)]
    return {name: plane for planes in parts for name, plane in planes.items()}


class Reading(NamedTuple):
    """Findings of a watched decode of one unit, beside its values."""

    unread: int = 0  # bytes of codewords that no symbol needed (spec 7.6.2)
    wrong_levels: int = 0  # counts of bytes by level (spec 5.7.2) that differ from the bytes that were read


class Evaluator(Protocol):
    """Evaluates one field of a joint codec. Its results hold the components of all groups, one group after the other."""

    def values(self, support: VoxelSupport, threads: int) -> np.ndarray:
        """Return the field's values at the centres of a support's voxels.

        Parameters
        ----------
        support : VoxelSupport
        threads : int

        Returns
        -------
        uint8 [N, components]
        """

    def query(self, cube: CanonicalCube, points: np.ndarray, threads: int) -> np.ndarray:
        """Return the field's values at any surface points.

        Parameters
        ----------
        cube : CanonicalCube
        points : float64 [M, 3] in world space
        threads : int

        Returns
        -------
        float32 [M, components] in 0..255
        """


class Joint(NamedTuple):
    """Result of JointCodec.enc()."""

    values: dict  # syntax values of the unit
    evaluators: list  # of Evaluator, by field
    choices: dict  # JSON-ready entries for the report


class Codec(ABC):
    """A way to code values in the cells (voxels or texels) of a support. In all methods, `values` are the syntax values of an
    attribute unit (spec 5.7)."""

    id: int  # codec_id in the stream
    name: str  # value of --codec
    purpose: str = ""  # half a sentence for the help
    structures: tuple[Structure, ...] = ()  # syntax tables, the codec's parameters first
    options: frozenset[str] = frozenset()  # names of the EncodeOptions that only this codec, and others that list them, read
    position_bits: int = 14  # default bits of a vertex coordinate
    joint: bool = False  # whether one unit holds all fields and channel groups
    chosen: bool = True  # whether users may choose the codec; False if only the encoder selects it
    checksum_clause: str = "7.10"  # of the specification, about the checksum of decoded values
    small: tuple[dict, ...] = ()  # EncodeOptions of short runs that compile the codec's kernels
    kernels: tuple[str, ...] = ()  # files of the package with kernels that every run enters
    settings_type: type[Any] | None = None  # frozen dataclass of the settings of enc(): its fields are EncodeOptions

    @property
    def parameters(self) -> Structure:
        """Syntax table of the codec's parameters, which follow the attribute unit's own elements."""
        return self.structures[0]

    def write_parameters(self, values: dict) -> bytes:
        """Return the codec's own part of an attribute unit as bytes, by the codec's structures.

        Parameters
        ----------
        values : dict

        Returns
        -------
        bytes
        """
        return write_structure(self.parameters, values)

    def read_parameters(self, reader: Reader, values: dict, trace: list | None = None) -> None:
        """Read the codec's own part of an attribute unit into values; the mirror of write_parameters().

        Parameters
        ----------
        reader : Reader, at the codec's parameters
        values : dict
            Syntax values read so far; extended in place.
        trace : list, optional, as in read_structure()

        Raises
        ------
        StreamError
            The parameters are invalid.
        """
        read_structure(self.parameters, reader, values, trace)

    def settings(self, options: EncodeOptions) -> Settings:
        """Pick the settings of enc() from the options of a whole encode.

        Parameters
        ----------
        options : EncodeOptions

        Returns
        -------
        Settings
            An object of settings_type. A plane codec's has "qp", "max_error" and "chroma_qp_offset". Without a settings_type
            the options unchanged.
        """
        if self.settings_type is None:
            return options
        names = {field.name for field in fields(self.settings_type)} & options.given.keys()
        return self.settings_type(**{name: getattr(options, name) for name in names})

    def check_options(self, options: EncodeOptions) -> None:
        """Refuse options of an encode with this codec that contradict each other.

        Parameters
        ----------
        options : EncodeOptions

        Raises
        ------
        InputError
            Names the options.
        """
        return None

    def check(self, values: dict) -> None:
        """Check relations between the syntax values of a unit that ranges of single elements cannot express.

        Parameters
        ----------
        values : dict

        Raises
        ------
        StreamError
            A relation is broken.
        """
        return None

    def describe(self, values: dict) -> dict:
        """Describe an attribute unit's coding, such as QP and bytes, for inspect().

        Parameters
        ----------
        values : dict

        Returns
        -------
        dict, JSON-ready entries beside those of every unit
        """
        return {}

    def profile(self, values: dict) -> str:
        """Return the profile of the specification (10.3) that a decoder of this attribute unit needs.

        Parameters
        ----------
        values : dict

        Returns
        -------
        str, one of PROFILES
        """
        return PROFILES[0]

    def count_latents(self, values: dict) -> int:
        """Number of latents in an attribute unit (spec 10.1).

        Parameters
        ----------
        values : dict

        Returns
        -------
        int, 0 without latents
        """
        return 0

    def info_lines(self, group: dict) -> Iterator[str]:
        """Yield the lines of text that texf-info prints about one attribute unit of this codec.

        Parameters
        ----------
        group : dict, an entry of inspect()'s groups

        Yields
        ------
        str
        """
        place = f"field {group['field_index']}, group {group['group_index']} ({group['semantic']})"
        yield f"{place}: {group['bytes']} bytes, {self.name}"

    def suits(self, plane: np.ndarray) -> bool:
        """Return whether the encoder should use this codec for a plane, whichever codec was requested.

        Parameters
        ----------
        plane : float32 [N, C] in 0..255

        Returns
        -------
        bool, False by default
        """
        return False

    def run_kernels(self, encoding: bool = True) -> None:
        """Runs the codec's usual kernels on a few values, so that their compiled code is in the cache.

        Parameters
        ----------
        encoding : bool
            Whether to run an encoder's kernels too. A decoder's come first, the longest to compile at the head.
        """
        return None

    def seconds(self, options: EncodeOptions) -> float:
        """Estimate the seconds that an encode takes longer because of this codec.

        Parameters
        ----------
        options : EncodeOptions

        Returns
        -------
        float
            Seconds beyond those of any codec.
        """
        return 0.0


class PlaneCodec(Codec):
    """A codec of one channel group of one field at a time."""

    has_levels = True  # whether dec() can leave out levels by itself; else a decoder takes means of what it gives

    @abstractmethod
    def enc(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, options: Settings) -> tuple[dict, np.ndarray]:
        """Codes a plane. Threads call enc() and dec() concurrently for several planes.

        Parameters
        ----------
        plane : float32 [N, C]
            In 0..255 on the support's keys.
        support : VoxelSupport or TexelSupport
            Cells of the plane.
        options : Settings

        Returns
        -------
        values : dict
            Syntax values of the codec's parameters.
        decoded : uint8 [N, C], as dec() returns it
        """

    @abstractmethod
    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """Decode the plane that enc() coded, or a coarser one.

        Parameters
        ----------
        values : dict
            Syntax values of the unit, with NumComponents and the file offset.
        support : VoxelSupport or TexelSupport
            Cells of the full plane.
        levels : int, octree levels to omit
        threads : int

        Returns
        -------
        uint8 [n, C]
            On support.coarser(levels).

        Raises
        ------
        StreamError
            The parameters are invalid.
        """

    def step(self, values: dict) -> float | None:
        """Return the quantiser's step that the decoded values of a unit were coded with.

        Parameters
        ----------
        values : dict

        Returns
        -------
        float or None
            In levels of 255; 0 for exact values, None if the unit does not contain it.
        """
        return None

    def dec_watched(self, values: dict, support: VoxelSupport, threads: int) -> tuple[np.ndarray, Reading]:
        """Decode all levels of a plane as dec() does, and report which bytes were read, for validation.

        Parameters
        ----------
        values, support, threads
            As in dec().

        Returns
        -------
        decoded : uint8 [N, C]
        reading : Reading

        Raises
        ------
        StreamError
            As dec().
        """
        return self.dec(values, support, 0, threads), Reading()


class JointCodec(Codec):
    """A codec of all fields and channel groups in one unit. A surface point queries an Evaluator instead of the voxels."""

    joint = True

    @abstractmethod
    def enc(self, source: Source, options: Settings, report: Report) -> Joint:
        """Code all fields and channel groups of a source in one unit.

        Parameters
        ----------
        source : Source
        options : Settings
        report : Report
            Receives seconds by stage, progress and warnings.

        Returns
        -------
        Joint
        """

    def count_samples(self, values: dict, surfaces: list[LatticeMesh], position_bits: int) -> int:
        """Number of surface samples that dec() takes beside those of the fields (spec 6.3), computed before any is taken.

        Parameters
        ----------
        values : dict
        surfaces : list of LatticeMesh, by field
        position_bits : int

        Returns
        -------
        int, 0 by default
        """
        return 0

    @abstractmethod
    def dec(self, values: dict, surfaces: list[LatticeMesh], position_bits: int, groups: tuple[Group, ...],
            options: DecodeOptions, report: Report) -> list[Evaluator]:
        """Decode the unit and return one Evaluator for each field, which answers points instead of voxels.

        Parameters
        ----------
        values : dict
        surfaces : list of LatticeMesh, by field
        position_bits : int
        groups : tuple of Group
        options : DecodeOptions
        report : Report

        Returns
        -------
        list of Evaluator, by field

        Raises
        ------
        StreamError, LimitError
            The parameters are invalid, or exceed options.limits.
        """

    @abstractmethod
    def pack(self, evaluators: list) -> tuple[dict, dict]:
        """Turn evaluators into plain values and arrays that another process can rebuild them from.

        Parameters
        ----------
        evaluators : list of Evaluator, by field

        Returns
        -------
        facts : dict, JSON-ready
        arrays : dict of array, by name
        """

    @abstractmethod
    def unpack(self, facts: dict, arrays: dict, groups: tuple[Group, ...], fields: int) -> list[Evaluator]:
        """Rebuild the evaluators from what pack() returned in another process, trusting none of it.

        Parameters
        ----------
        facts, arrays
            As pack() returns them.
        groups : tuple of Group
        fields : int

        Returns
        -------
        list of Evaluator, by field

        Raises
        ------
        TexfError, ValueError, KeyError, TypeError
            The arguments are invalid.
        """

    @abstractmethod
    def result_lines(self, facts: dict) -> Iterator[str]:
        """Yield the lines of text that texf-enc prints about this codec's choices in an encode.

        Parameters
        ----------
        facts : dict, the document of --json

        Yields
        ------
        str
        """
