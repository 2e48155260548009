"""The one home of every option: its default, its range and what it is for. The command lines and the Python API read these."""

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, dataclass, field, fields
from difflib import get_close_matches
from functools import partial
from typing import Any, Self, TypeVar

from .codecs import codec_names, codec_of, our_codecs
from .codecs.base import Codec
from .codecs.neural.operating_points import DEFAULT_POINT, DEFAULT_STEPS, FIT_ENGINES, LATENT_INDICES, POINTS
from .errors import InputError, SupportError
from .limits import Limits

# The paper's rate points: grid resolution K and QP.
RATES = {
    "r01": (1024, 36),
    "r02": (1024, 32),
    "r03": (1024, 28),
    "r04": (1024, 24),
    "r05": (1536, 26),
    "r06": (2048, 26),
}
FREE_QPS = {"r05": 22, "r06": 20}  # where the encoder may take texels or a smaller K: a finer K alone would buy nothing there
DEFAULT_RATE = "r04"
DEFAULT_CODEC = "raht"
EFFORTS = ("fast", "balanced", "best")
PARTITIONS = ("auto", "off")
SUPPORTS = ("auto", "voxels", "texels")
MOST_RESOLUTION = 8192
FINEST_POSITIONS = 20  # bits of a coordinate that "auto" goes up to
OF_PLANES = frozenset({"support", "exact_rate", "texel_size"})  # no part in codecs that code all fields together
TARGETS_OF_PSNR = ("surface", "flat", "lit")
REFINEMENTS = ("auto", "off", "fit", "render")


def default_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# Any, as dataclasses.field() says of itself: what stands beside a field must have its type.
def choice(default: Any, allowed: Iterable[str] | Callable[[], Iterable[str]], text: str = "", metavar: str | None = None) -> Any:
    """A field of options that takes one of the words that allowed holds, or that calling it gives."""
    return field(default=default, metadata={"allowed": allowed, "text": text, "metavar": metavar})


def ranged(default: Any, low: float, high: float, text: str = "", metavar: str = "N") -> Any:
    """A field of options that takes a number in low..high: a whole one, or any where low is a float."""
    return field(default=default, metadata={"range": (low, high), "text": text, "metavar": metavar})


def switch(text: str = "") -> Any:
    """A field of options that is True or False, at first False."""
    return field(default=False, metadata={"switch": True, "text": text})


def words_of(option: Field) -> tuple[str, ...]:
    """The words that a choice() takes."""
    allowed = option.metadata["allowed"]
    return tuple(allowed() if callable(allowed) else allowed)


def check_options(options: "EncodeOptions | DecodeOptions") -> None:
    """Compares every field of options with what it takes. Raises InputError TXF-I50."""
    for option in fields(options):
        value, metadata = getattr(options, option.name), option.metadata
        if value is None and option.default is None:
            continue
        if "allowed" in metadata and value not in (allowed := words_of(option)):
            raise InputError("TXF-I50", f"unknown {option.name.replace('_', ' ')}", value=value, allowed=", ".join(allowed))
        if "range" in metadata:
            _check_number(option.name, value, *metadata["range"])
        if "switch" in metadata and not isinstance(value, bool):
            raise InputError("TXF-I50", f"{option.name} is neither True nor False", value=value)


def _check_number(name, value, low, high):
    whole = isinstance(low, int)
    try:
        number = value.__index__() if whole else float(value)
        sound = not isinstance(value, bool | str) and math.isfinite(number)
    except (AttributeError, TypeError, ValueError):
        sound = False
    if not sound:
        raise InputError("TXF-I50", f"{name} is not {'an integer' if whole else 'a number'}", value=repr(value)[:80],
                         allowed=f"{low}..{high}")
    if not low <= number <= high:
        raise InputError("TXF-I50", f"{name} is out of range", value=value, allowed=f"{low}..{high}")


Options = TypeVar("Options", "EncodeOptions", "DecodeOptions")


def options_of(kind: type[Options], given: Options | Mapping[str, Any] | None) -> Options:
    """The options that a caller gave: a kind, or a dict of its fields, whose "limits" may be a dict too; None: the defaults.
    Raises InputError TXF-I50 for a name that is none, with the nearest, and for anything else."""
    if given is None:
        return kind()
    if isinstance(given, kind):
        return given
    if not isinstance(given, Mapping):
        raise InputError("TXF-I50", f"options are neither {kind.__name__} nor a dict", value=type(given).__name__)
    given = dict(given)
    if isinstance(given.get("limits"), Mapping):
        given["limits"] = Limits(**_known_names(Limits, given["limits"]))
    return kind(**_known_names(kind, given))


def _known_names(kind, given):
    """The dict. Raises InputError TXF-I50 where a name is no field of the class."""
    known = [option_field.name for option_field in fields(kind)]
    for name in given:
        if name not in known:
            near = get_close_matches(str(name), known, 1)
            raise InputError("TXF-I50", f"{kind.__name__} has no option {str(name)[:80]!r}" +
                             (f"; the nearest is {near[0]!r}" if near else ""), allowed=None if near else ", ".join(known))
    return given


def strange_options(codec: Codec) -> frozenset[str]:
    """Names of those EncodeOptions that other codecs read and this one does not."""
    others = frozenset().union(*(other.options for other in our_codecs())) - codec.options
    return others | OF_PLANES if codec.joint else others


@dataclass(frozen=True, kw_only=True)
class EncodeOptions:
    """resolution/qp override the rate preset; qp follows G-PCC: step = 2**((qp - 4) / 6).

    lossless: code the voxels' rounded values exactly; max_error: None for lossy, 0 the same as lossless, 1..127 for values that
    are at most so far off; the encoder then sets the QPs, and qp stays None.

    chroma_qp_offset: added to the QP of both chroma components; None: -1 over voxels, 2 over texels. area_threshold: voxels
    holding less surface than this many 1/256 voxel faces are dropped where coverage allows. partition: "auto" splits the mesh
    into fields where surfaces meet, "off" keeps one. refine: what brings the voxels' colours closer to the source before they are
    coded: "fit" least squares on the surface, "render" inverse rendering on top of it with so many refine_iterations, "auto" a
    fit where it will show and effort is not fast. allow_empty: code a mesh whose faces all collapse as an empty stream instead of
    refusing it.

    target_psnr_of: "surface" for the PSNR of Y at points of the surface, "flat" for that of 8 pictures of 512 pixels a side
    without light, as metrics.views draws them, "lit" for that of pictures in daylight.

    support: "auto" takes the texels of an image, a smaller K or more position bits than were asked for where bytes and error of
    the picture cost less so, and only where resolution, max_error and exact_rate leave it free to.

    keep_mesh: send the source's faces, each vertex rounded to the lattice; else a mesh of fewer faces or position bits is sent
    where pictures show no more of it than coding costs anyway, and resolution, position_bits, max_error and exact_rate leave
    that free.

    codec "3dntc" fits latents and a network for GPU-resident use instead; resolution is then only that of the voxels which a
    decoder makes of it, and refine "render" improves the fit on pictures, which "auto" leaves out. point: one of the paper's;
    resident_bytes: in its place, a budget of bytes on the GPU; latent_index: "surface" gives every touched voxel of a coarse
    grid its own latents, as fine a grid as the point's bytes allow, "mixed" spends half of them on a hash table over finer
    cells, "hash" takes the point's hash tables; transport: entropy-code the latents in the stream; steps, seed: of the fit;
    checkpoint: path that its state is kept in and taken up from; fit_engine: "auto" takes torch where it sees a GPU, else
    compiled kernels.

    no_check: leave out the look at what was made, and with it the second try at parts that came out worse than the rate promises.

    codec_options: settings of a plug-in's codec, by name. An option of another codec than the chosen one is refused. Raises
    InputError TXF-I50 for what makes no sense, SupportError for a codec that is not installed.
    """

    rate: str = choice(DEFAULT_RATE, RATES, "The paper's rate points: "
                       + ", ".join(f"{name} K {k} QP {qp}" for name, (k, qp) in RATES.items())
                       + "; " + ", ".join(f"{name} QP {qp}" for name, qp in FREE_QPS.items())
                       + " where the encoder may choose texels or a smaller K.")
    resolution: int | None = ranged(None, 1, MOST_RESOLUTION, "Voxels along the longest side, 1..8192; usually with --qp.", "K")
    qp: int | None = ranged(None, 0, 63, "Quantisation parameter, 0..63, with step 2^((QP-4)/6); usually with --resolution.")
    target_bytes: int | None = ranged(None, 1, 1 << 62, "Search for the QP that gives the best picture in at most B bytes.", "B")
    target_psnr: float | None = ranged(None, 1.0, 100.0, "Search for the QP that gives the fewest bytes at this PSNR of Y.", "DB")
    target_psnr_of: str = choice(TARGETS_OF_PSNR[0], TARGETS_OF_PSNR, "Where to measure --target-psnr: at points of the surface "
                                 "(3D-PSNR), or in 8 pictures, flat or lit.")
    lossless: bool = switch("Code the 8-bit colours of voxels or texels exactly. --rate or --resolution sets K.")
    max_error: int | None = ranged(None, 0, 127, "As --lossless, but with an error of at most D per value, 1..127.", "D")
    position_bits: int | None = ranged(None, 8, 20, "Bits of a vertex coordinate, 8..20.", "B")
    keep_mesh: bool = switch("Keep the source's vertices and faces, and round each vertex to the position lattice. Implied "
                             "by --lossless, --exact-rate, --resolution and --position-bits.")
    effort: str = choice("balanced", EFFORTS, "Encoding time spent on a smaller stream.")
    chroma_qp_offset: int | None = ranged(None, -63, 63)
    area_threshold: int = ranged(77, 0, 65535)
    partition: str = choice("auto", PARTITIONS)
    refine: str = choice("auto", REFINEMENTS, "Bring colours closer to the source before coding. fit: a surface fit. render: "
                         "inverse rendering as well (a minute). auto: a fit where it is visible, unless --effort is fast. With "
                         "3dntc, render refines the fit on pictures (a minute); auto does not.")
    refine_iterations: int = ranged(30, 1, 10_000)
    support: str = choice("auto", SUPPORTS, "Store colours in voxels, or in the texels of the mesh's own images. auto: for "
                          "each image, whichever takes fewer bytes; voxels where K or an error bound is given.")
    effects: str = field(default="auto", metadata={"text": "Material maps to code: auto (those that are visible), all, none "
                                                           "(base colour and alpha only), or a list of effects.",
                                                   "metavar": "LIST"})
    exact_rate: bool = switch("Use voxels at the K of the rate, as in the paper, even where texels or a smaller K take fewer "
                              "bytes.")
    texel_size: int | None = ranged(None, 1, 16384, "Shrink images stored as texels to N along their longer side, 1..16384.", "N")
    codec: str = choice(DEFAULT_CODEC, codec_names, "Codec of the values:")
    codec_options: dict = field(default_factory=dict)
    point: str | None = choice(None, POINTS, "Size of the payload as in the paper, mpeg1..mpeg6 or aom1..aom5.  "
                               f"[default: {DEFAULT_POINT}]", "POINT")
    resident_bytes: int | None = ranged(None, 1, 1 << 40, "Maximum bytes on the GPU, instead of --point.", "B")
    latent_index: str = choice("mixed", LATENT_INDICES, "Where to store latents. surface: in a grid along the surface. mixed: "
                               "in that and a hash table of finer cells. hash: in the hash tables of the point.")
    transport: bool = switch("Entropy-code the latents in the stream; a decoder unpacks them.")
    steps: int = ranged(DEFAULT_STEPS, 1, 10_000_000, "Number of fit steps.")
    seed: int = ranged(0, 0, (1 << 31) - 1, "Random seed of the fit.", "S")
    checkpoint: str | None = field(default=None, metadata={"text": "Save the state of the fit in FILE, and resume from it.",
                                                           "metavar": "FILE"})
    fit_engine: str = choice("auto", FIT_ENGINES)
    threads: int = ranged(0, 0, 1024, "Maximum threads; 0 for all processors.")
    measure: bool = switch("Decode the stream and report its 3D-PSNR at 1,000,000 surface points.")
    no_check: bool = switch("Do not check the stream against the source.")
    strict: bool = switch("Refuse a mesh that would cause a warning or lose a property.")
    allow_empty: bool = switch()
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self):
        try:
            codec = codec_of(self.codec)
        except SupportError as error:
            if error.code != "TXF-U06":
                raise
            raise InputError("TXF-I50", "unknown codec", value=self.codec, allowed=error.details["allowed"]) from None
        if not codec.chosen:
            raise InputError("TXF-I50", f"the codec {self.codec} cannot be chosen: the encoder uses it where it is suitable",
                             value=self.codec, allowed=", ".join(codec_names()))
        check_options(self)
        self._refuse_strange(codec)
        codec.check_options(self)
        resolve = partial(object.__setattr__, self)  # frozen from here on
        resolve("_given", {option.name: getattr(self, option.name) for option in fields(self)})
        resolve("threads", self.threads or default_threads())
        resolve("position_bits", codec.position_bits if self.position_bits is None else self.position_bits)
        self._refuse_bounds()
        if self.target_psnr is None and self.target_psnr_of != TARGETS_OF_PSNR[0]:
            raise InputError("TXF-I50", "target_psnr_of has no effect without target_psnr", value=self.target_psnr_of)
        resolve("max_error", 0 if self.lossless else self.max_error)
        if self.max_error is None and "qp" in codec.options:
            resolve("qp", self.reckoned_qp)
        resolve("resolution", RATES[self.rate][0] if self.resolution is None else self.resolution)
        resolve("lossless", self.max_error == 0)

    @property
    def given(self) -> dict[str, Any]:
        """All fields as they were given, before any was resolved."""
        return self.__dict__["_given"]

    def changed(self, **changes: Any) -> Self:
        """The request with changes. What it left to the encoder, and nothing changed, is left to it still, which
        dataclasses.replace() would not do: it starts from what was resolved."""
        return type(self)(**{**self.given, **changes})

    def without_target(self) -> Self:
        """The request without a target, whose rate is then the default."""
        return self.changed(target_bytes=None, target_psnr=None, target_psnr_of=TARGETS_OF_PSNR[0])

    @property
    def rate_is_free(self) -> bool:
        """Whether K and supports are the encoder's to choose."""
        return self.given["resolution"] is None and not self.exact_rate and self.given["max_error"] is None \
            and not self.given["lossless"]

    @property
    def mesh_is_free(self) -> bool:
        """Whether a mesh of fewer faces or of fewer position bits is the encoder's to choose."""
        return self.rate_is_free and self.position_bits_are_free and not self.keep_mesh

    @property
    def position_bits_are_free(self) -> bool:
        """Whether more bits of positions than usual are the encoder's to choose."""
        return self.given["position_bits"] is None

    def _refuse_strange(self, codec):
        """Options that only other codecs read are a mistake, not to be passed over."""
        strange = strange_options(codec)
        for option in fields(self):
            if option.name in strange and getattr(self, option.name) != option.default:
                raise InputError("TXF-I50", f"{option.name} does not apply to codec {self.codec}",
                                 value=getattr(self, option.name))
        if not isinstance(self.codec_options, dict):
            raise InputError("TXF-I50", "codec_options is not a dict", value=repr(self.codec_options)[:80])
        if self.codec_options and codec in our_codecs():
            raise InputError("TXF-I50", f"codec_options does not apply to codec {self.codec}, whose options have their own names",
                             value=", ".join(self.codec_options))

    def _refuse_bounds(self):
        """Error bounds that exclude each other, or what else sets the quality."""
        if self.lossless and self.max_error:
            raise InputError("TXF-I50", "lossless and max_error cannot be combined", value=self.max_error)
        if self.lossless or self.max_error is not None:
            for name in ("qp", "target_bytes", "target_psnr"):
                if getattr(self, name) is not None:
                    raise InputError("TXF-I50", f"max_error and {name} cannot be combined: an error bound sets the QP",
                                     value=getattr(self, name))

    @property
    def reckoned_qp(self) -> int:
        """The QP whose error the choices before coding reckon with."""
        if self.qp is not None:
            return self.qp
        return FREE_QPS.get(self.rate, RATES[self.rate][1]) if self.rate_is_free else RATES[self.rate][1]

    @property
    def may_choose_texels(self) -> bool:
        """Whether fields over texels may come of these options."""
        return not codec_of(self.codec).joint and (self.support == "texels" or (self.support == "auto" and self.rate_is_free))

    @property
    def may_fit(self) -> bool:
        """Whether a surface fit may follow the transfer."""
        return self.max_error is None and (self.refine in ("fit", "render") or (self.refine == "auto" and self.effort != "fast"))


ENGINES = ("auto", "numba", "wasm")


@dataclass(frozen=True, kw_only=True)
class DecodeOptions:
    """Settings of decode().

    Parameters
    ----------
    lod : int
        Octree levels to stop early, 0..14; 0 is the full field.
    threads : int
        Most threads; 0: all processors.
    isolate : bool
        Decode where memory and time are capped: in a WebAssembly sandbox, or a child process where there is none.
    engine : str
        "numba": kernels, compiled at their first use; "wasm": the sandbox; "auto": the sandbox as long as kernels are not
        compiled, and with isolate where it can. Values are the same.
    limits : Limits
        What a stream may ask for.

    Raises
    ------
    InputError
        TXF-I50 for a value that is out of range.
    """

    lod: int = ranged(0, 0, 14, "Stop L octree levels before the finest.", "L")
    threads: int = ranged(0, 0, 1024, "Maximum threads; 0 for all processors.")
    isolate: bool = switch("Decode with limited memory and time: in a WebAssembly sandbox, else in a child process.")
    engine: str = choice(ENGINES[0], ENGINES, "Decode with kernels that numba compiles at their first use, or in a "
                                              "WebAssembly sandbox without compilation. auto chooses the sandbox with "
                                              "--isolate and at a first run.")
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self):
        check_options(self)
        object.__setattr__(self, "threads", self.threads or default_threads())
