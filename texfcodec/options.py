"""All options: default, range and purpose of each. The command lines and the Python API read them from here."""

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
EFFORTS = ("fast", "balanced")
PARTITIONS = ("auto", "off")
SUPPORTS = ("auto", "voxels", "texels")
MOST_RESOLUTION = 8192
FINEST_POSITIONS = 20  # bits of a coordinate that "auto" goes up to
OF_PLANES = frozenset({"support", "exact_rate", "texel_size"})  # no part in codecs that code all fields together
TARGETS_OF_PSNR = ("surface", "flat", "lit")
REFINEMENTS = ("auto", "off", "fit", "render")


def default_threads() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# Any, as dataclasses.field() says of itself: what stands beside a field must have its type.
def choice(default: Any, allowed: Iterable[str] | Callable[[], Iterable[str]], text: str = "", metavar: str | None = None) -> Any:
    """Return a dataclass field for an option that takes one of several words.

    Parameters
    ----------
    default : str or None
        Its default.
    allowed : iterable of str, or function () -> iterable of str
        The words.
    text : str
        Help of its flag.
    metavar : str, optional
        Value of its flag, in the help.

    Returns
    -------
    dataclasses.Field
        With the arguments in its metadata.
    """
    return field(default=default, metadata={"allowed": allowed, "text": text, "metavar": metavar})


def ranged(default: Any, low: float, high: float, text: str = "", metavar: str = "N") -> Any:
    """Return a dataclass field for an option that takes a number within a range.

    Parameters
    ----------
    default : float or None
        Its default.
    low, high : float
        The range, ends included. If low is an int, only integers are taken.
    text, metavar : str
        As of choice().

    Returns
    -------
    dataclasses.Field
        With the arguments in its metadata.
    """
    return field(default=default, metadata={"range": (low, high), "text": text, "metavar": metavar})


def switch(text: str = "") -> Any:
    """Return a dataclass field for an option that is True or False, by default False.

    Parameters
    ----------
    text : str
        Help of its flag.

    Returns
    -------
    dataclasses.Field
        With the text in its metadata.
    """
    return field(default=False, metadata={"switch": True, "text": text})


def words_of(option: Field) -> tuple[str, ...]:
    """Return the words that a field of choice() allows.

    Parameters
    ----------
    option : dataclasses.Field
        Of choice().

    Returns
    -------
    tuple of str
        The words.
    """
    allowed = option.metadata["allowed"]
    return tuple(allowed() if callable(allowed) else allowed)


def check_options(options: "EncodeOptions | DecodeOptions") -> None:
    """Checks every field of options against its range or its words.

    Parameters
    ----------
    options : EncodeOptions or DecodeOptions
        Any values.

    Raises
    ------
    InputError
        TXF-I50 for a value that is not allowed.
    """
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
    """Return what a caller gives as options as an object of EncodeOptions or DecodeOptions.

    Parameters
    ----------
    kind : type
        EncodeOptions or DecodeOptions.
    given : kind or mapping, optional
        A mapping holds fields of kind by name, and "limits" may be a mapping too; None for the defaults.

    Returns
    -------
    kind
        The options.

    Raises
    ------
    InputError
        TXF-I50 for an unknown name, which it reports with the nearest known name, and for any other type.
    """
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
    """The dict, unchanged. Raises InputError TXF-I50 if a name is not a field of the class."""
    known = [option_field.name for option_field in fields(kind)]
    for name in given:
        if name not in known:
            near = get_close_matches(str(name), known, 1)
            raise InputError("TXF-I50", f"{kind.__name__} has no option {str(name)[:80]!r}" +
                             (f"; the nearest is {near[0]!r}" if near else ""), allowed=None if near else ", ".join(known))
    return given


def strange_options(codec: Codec) -> frozenset[str]:
    """Return the names of the EncodeOptions that other codecs read and this codec does not.

    Parameters
    ----------
    codec : Codec
        Any of ours.

    Returns
    -------
    frozenset of str
        The names.
    """
    others = frozenset().union(*(other.options for other in our_codecs())) - codec.options
    return others | OF_PLANES if codec.joint else others


@dataclass(frozen=True, kw_only=True)
class EncodeOptions:
    """Settings of encode(). An option of another codec than the chosen one is refused.

    Parameters
    ----------
    rate : str
        Preset of resolution and qp, which override it.
    resolution : int, optional
        Voxels along the longest side.
    qp : int, optional
        As in G-PCC: step = 2**((qp - 4) / 6).
    target_bytes, target_psnr
        A target, for which the QP is searched.
    target_psnr_of : str
        "surface": PSNR of Y at points of the surface; "flat": of 8 pictures of 512 pixels a side without light, as metrics.views
        draws them; "lit": of pictures in daylight.
    lossless, max_error
        lossless codes the voxels' rounded values exactly. max_error: None for lossy, 0 the same as lossless, 1..127 for the
        largest error of a value. The encoder then sets the QPs, and qp stays None.
    position_bits, keep_mesh
        keep_mesh sends the source's faces, each vertex rounded to the lattice. Else the encoder may send a mesh of fewer faces or
        position bits if pictures show no more of it than coding costs anyway, and resolution, position_bits, max_error and
        exact_rate leave that free.
    keep_animations : bool
        Of encode_gltf(): keep every keyframe. Otherwise those are left out that interpolation gives within 1e-5.
    chroma_qp_offset : int, optional
        Added to the QP of both chroma components; None: -1 over voxels, 2 over texels.
    area_threshold : int
        Voxels with less surface than this many 1/256 voxel faces are dropped where coverage allows.
    partition : str
        "auto" splits the mesh into fields where surfaces meet, "off" keeps a single field.
    refine, refine_iterations
        Brings the voxels' colours closer to the source before coding. "fit": least squares on the surface; "render": inverse
        rendering on top of it, with refine_iterations; "auto": a fit if it will be visible and effort is not fast.
    support, exact_rate
        "auto" takes the texels of an image, a smaller K or more position bits than requested if bytes and error of the picture
        cost less, and only if resolution, max_error and exact_rate leave it free.
    codec : str
        "3dntc" fits latents and a network for GPU-resident use. resolution is then only that of the voxels which a decoder
        derives, and refine "render" improves the fit on pictures, which "auto" leaves out.
    point, resident_bytes
        Of 3dntc: a point of the paper, or in its place a budget of bytes on the GPU.
    latent_index : str
        Of 3dntc. "surface": every touched voxel of a coarse grid has its own latents, with as fine a grid as the point's bytes
        allow; "mixed": half of the bytes go to a hash table over finer cells; "hash": the point's hash tables.
    transport, steps, seed, checkpoint, fit_engine
        Of 3dntc. transport entropy-codes the latents in the stream; steps and seed are those of the fit; checkpoint is the path
        at which its state is saved and resumed; fit_engine "auto" takes torch if there is a GPU, else compiled kernels.
    no_check : bool
        Leave out the check of the stream, and with it the second try at parts that are worse than the rate promises.
    allow_empty : bool
        Code a mesh whose faces all collapse as an empty stream instead of refusing it.
    codec_options : dict
        Settings of a plug-in's codec, by name.

    Raises
    ------
    InputError
        TXF-I50 for values or combinations that make no sense.
    SupportError
        The codec is not installed.
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
    keep_animations: bool = switch("With OUT.glb: keep every keyframe. Otherwise those go that interpolation gives within 1e-5.")
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
        """All fields as the caller gave them, before any was resolved."""
        return self.__dict__["_given"]

    def changed(self, **changes: Any) -> Self:
        """The request with changes. Fields that it left to the encoder stay so unless they are changed.

        dataclasses.replace() would start from the resolved values instead.
        """
        return type(self)(**{**self.given, **changes})

    def without_target(self) -> Self:
        """The request without a target; its rate is then the default."""
        return self.changed(target_bytes=None, target_psnr=None, target_psnr_of=TARGETS_OF_PSNR[0])

    @property
    def rate_is_free(self) -> bool:
        """True if the encoder may choose K and supports."""
        return self.given["resolution"] is None and not self.exact_rate and self.given["max_error"] is None \
            and not self.given["lossless"]

    @property
    def mesh_is_free(self) -> bool:
        """True if the encoder may choose a mesh of fewer faces or of fewer position bits."""
        return self.rate_is_free and self.position_bits_are_free and not self.keep_mesh

    @property
    def position_bits_are_free(self) -> bool:
        """True if the encoder may choose more position bits than usual."""
        return self.given["position_bits"] is None

    def _refuse_strange(self, codec):
        """Refuses options that only other codecs read: they are a mistake that must not be ignored."""
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
        """Refuses error bounds that exclude each other or another setting of the quality."""
        if self.lossless and self.max_error:
            raise InputError("TXF-I50", "lossless and max_error cannot be combined", value=self.max_error)
        if self.lossless or self.max_error is not None:
            for name in ("qp", "target_bytes", "target_psnr"):
                if getattr(self, name) is not None:
                    raise InputError("TXF-I50", f"max_error and {name} cannot be combined: an error bound sets the QP",
                                     value=getattr(self, name))

    @property
    def reckoned_qp(self) -> int:
        """The QP that the choices before coding assume for the error."""
        if self.qp is not None:
            return self.qp
        return FREE_QPS.get(self.rate, RATES[self.rate][1]) if self.rate_is_free else RATES[self.rate][1]

    @property
    def may_choose_texels(self) -> bool:
        """True if these options allow fields over texels."""
        return not codec_of(self.codec).joint and (self.support == "texels" or (self.support == "auto" and self.rate_is_free))

    @property
    def may_fit(self) -> bool:
        """True if a surface fit may follow the transfer."""
        return self.max_error is None and (self.refine in ("fit", "render") or (self.refine == "auto" and self.effort != "fast"))


ENGINES = ("auto", "native", "numba", "wasm")


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
        Cap memory and time: decode in a WebAssembly sandbox, or in a child process if there is none.
    engine : str
        "native": the C++ library, if `make native` or a platform's wheel has installed it; "numba": kernels, compiled at their
        first use; "wasm": the sandbox; "auto": the sandbox with isolate, else the library, else the sandbox as long as kernels
        are not compiled. Values are the same.
    limits : Limits
        Limits on the stream.

    Raises
    ------
    InputError
        TXF-I50 for a value that is out of range.
    """

    lod: int = ranged(0, 0, 14, "Stop L octree levels before the finest.", "L")
    threads: int = ranged(0, 0, 1024, "Maximum threads; 0 for all processors.")
    isolate: bool = switch("Decode with limited memory and time: in a WebAssembly sandbox, else in a child process.")
    engine: str = choice(ENGINES[0], ENGINES, "Decode with the native library, with kernels that numba compiles at "
                                              "their first use, or in a WebAssembly sandbox. auto chooses the sandbox with "
                                              "--isolate, else the library if it is installed, else the sandbox at a first run.")
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self):
        check_options(self)
        object.__setattr__(self, "threads", self.threads or default_threads())
