"""The knobs of accuracy: for each the settings to measure, where they have a part, and which of them is the default.

A knob is a row of KNOBS. Settings are dicts, JSON-ready: {"kind": "encode", "options": EncodeOptions, with "density" for the
transfer's samples per voxel edge, which is none} or, for the metrics, {"kind": "views", ...} and {"kind": "samples", ...}. The
same setting under two knobs is measured once.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

from texfcodec.codecs.neural.operating_points import DEFAULT_POINT, DEFAULT_STEPS
from texfcodec.encoder.values.source_field import FITTED_DENSITY, TRANSFER_DENSITY
from texfcodec.metrics.psnr_3d import SAMPLES
from texfcodec.metrics.views import SIZE, VIEWS
from texfcodec.options import DEFAULT_RATE, EFFORTS, RATES, EncodeOptions, default_threads

DEFAULTS = EncodeOptions()
QP = 28  # at which one knob after the other is turned
REFERENCE_VIEWS, REFERENCE_SIZE, REFERENCE_SAMPLES = 64, 2048, 8_000_000
# Where a knob is turned. HOME is VOXELS or TEXELS, whichever the encoder chooses by itself for the asset.
AUTO, HOME, VOXELS, TEXELS, NEURAL, STREAM = "auto", "home", "voxels", "texels", "neural", "stream"


@dataclass(frozen=True)
class Place:
    """What knobs have to know of an asset. home: VOXELS or TEXELS; k: the K at which voxels are tried; side: the longest side of
    its images in pixels, 0 for none; neural: whether 3DNTC is fitted to it."""

    home: str
    k: int
    side: int = 0
    neural: bool = False

    def base(self, over):
        """Options at which a knob over `over` is turned."""
        over = self.home if over in (HOME, STREAM) else over
        return {AUTO: {}, VOXELS: {"resolution": self.k, "qp": QP}, TEXELS: {"support": "texels", "qp": QP},
                NEURAL: {"codec": "3dntc", "steps": 1000}}[over]

    def curve(self, over):
        """Where the rate curve stands that settings over `over` are compared with; None: they have none."""
        return {VOXELS: VOXELS, TEXELS: TEXELS, NEURAL: None}.get(over, self.home)


@dataclass(frozen=True)
class Knob:
    """One row. values: what it is turned to, from cheap to dear, those of --quick in quick; default: the package's own; over:
    AUTO, HOME, VOXELS, TEXELS, NEURAL or STREAM; change: function (value, Place) -> what it changes in the base; options:
    EncodeOptions that it stands for; image: quality is image PSNR, not 3D-PSNR; costly: not turned where over is not the asset's
    home; asked: measured only where it is named; hindsight: the default chooses among the other values, and pays for it."""

    name: str
    text: str
    values: tuple
    quick: tuple
    default: object
    over: str
    change: Callable
    options: tuple = ()
    image: bool = False
    costly: bool = False
    asked: bool = False
    hindsight: bool = False

    def applies(self, place):
        """Whether the knob has a part in an asset."""
        if self.over == NEURAL:
            return place.neural
        if self.over == TEXELS:
            return place.side > 0 and not (self.costly and place.home != TEXELS)
        return not (self.costly and self.over == VOXELS and place.home != VOXELS)

    def settings(self, place, quick=False):
        """{value: setting}, none where the knob does not apply."""
        if not self.applies(place):
            return {}
        values = [value for value in self.values if not quick or value in self.quick]
        return {value: self._setting(value, place) for value in values}

    def _setting(self, value, place):
        change = self.change(value, place)
        if self.over == STREAM:
            return change
        return encode_setting(place.base(self.over) | change, self.image)


def encode_setting(options, image=False):
    """The setting of an encode; options that are as ever are left out, so that one setting has one form."""
    usual = {field.name: field.default for field in fields(EncodeOptions)}
    options = {name: value for name, value in options.items() if name not in usual or value != usual[name]}
    return {"kind": "encode", "options": options, **({"image": True} if image else {})}


def _option(name):
    return lambda value, place: {name: value}


def _refined(value, place):
    return {} if value == "auto" else {"refine": value}


def _bounded(value, place):
    """In place of the QP; the base says where."""
    return {"max_error": value, "qp": None}


def _views(value, place):
    views, size = value
    return {"kind": "views", "views": views, "size": size}


QPS = Knob("QP", "quantisation", (44, 36, 32, 28, 24, 20, 12), (44, 36, 28, 24), QP, HOME, _option("qp"), ("qp",), image=True)
PRESETS_WITH_EFFORT = ("r02 fast", "r04 fast", "r05 fast", "r06 fast", "r02 best", "r04 best")
VIEW_VALUES = tuple((views, size) for size in (512, 1024, 2048) for views in (4, 8, 16, 32))
KNOBS = (
    Knob("preset", "rate preset, all else left to the encoder", tuple(RATES), ("r02", "r04"), DEFAULT_RATE, AUTO, _option("rate"),
         ("rate", "exact_rate")),
    Knob("preset with effort", "as the presets, at another effort", PRESETS_WITH_EFFORT, ("r04 fast",), None, AUTO,
         lambda value, place: dict(zip(("rate", "effort"), value.split(), strict=True))),
    Knob("effort", "tools of the coder, partition and weights", EFFORTS, EFFORTS, DEFAULTS.effort, HOME, _option("effort"),
         ("effort",)),
    QPS,
    Knob("K", "voxels along the longest side, times the usual", (0.5, 0.75, 1, 1.5, 2), (0.5, 1), 1, VOXELS,
         lambda value, place: {"resolution": round(place.k * value)}, ("resolution",)),
    Knob("texel size", "texels along an image's side, times the source's", (0.25, 0.5, 0.75, 1), (0.5, 1), 1, TEXELS,
         lambda value, place: {} if value == 1 else {"texel_size": max(round(place.side * value), 1)}, ("texel_size",),
         costly=True),
    Knob("support", "voxels or texels, at r03", ("voxels", "texels", "auto"), ("voxels", "auto"), DEFAULTS.support, AUTO,
         lambda value, place: {"rate": "r03"} | ({} if value == "auto" else {"support": value}), ("support",), hindsight=True),
    Knob("refinement", "of the colours before coding", ("off", "auto", "render"), ("off", "auto"), DEFAULTS.refine, VOXELS,
         _refined, ("refine",)),
    Knob("iterations", "of inverse rendering", (10, 30, 100), (), DEFAULTS.refine_iterations, VOXELS,
         lambda value, place: {"refine": "render"} | ({} if value == 30 else {"refine_iterations": value}),
         ("refine_iterations",), costly=True),
    Knob("density", "the transfer's samples per voxel edge, no fit after it", (2, 3, 4, 6, 8), (2, 4),
         TRANSFER_DENSITY[DEFAULTS.effort], VOXELS, lambda value, place: {"refine": "off", "density": value}),
    Knob("density before a fit", "the same where a surface fit follows", (2, 3, 4), (), FITTED_DENSITY, VOXELS,
         lambda value, place: {} if value == FITTED_DENSITY else {"density": value}, costly=True),
    Knob("area threshold", "1/256 voxel faces of surface below which a voxel goes", (0, 77, 154), (), DEFAULTS.area_threshold,
         VOXELS, _option("area_threshold"), ("area_threshold",), costly=True),
    Knob("partition", "of the mesh into fields where surfaces meet", ("off", "auto"), ("off", "auto"), DEFAULTS.partition, VOXELS,
         _option("partition"), ("partition",)),
    Knob("position bits", "of a vertex coordinate", (10, 12, 14, 16), (12, 14), 14, HOME, _option("position_bits"),
         ("position_bits",), image=True),
    Knob("near-lossless D", "largest error of a coded value, 0: lossless; no fit", (8, 4, 2, 1, 0), (4,), None, HOME, _bounded,
         ("max_error", "lossless")),
    Knob("3DNTC steps", f"of the fit, {DEFAULT_POINT}", (250, 1000, 4000, DEFAULT_STEPS), (), DEFAULT_STEPS, NEURAL,
         _option("steps"), ("codec", "steps")),
    Knob("3DNTC size", "points of the paper, 1000 steps", ("mpeg1", "mpeg3", "mpeg6"), (), DEFAULT_POINT, NEURAL,
         lambda value, place: {} if value == DEFAULT_POINT else {"point": value}, ("point", "resident_bytes")),
    Knob("views of the metric", "views x pixels a side", VIEW_VALUES, ((4, 512), (16, 512)), (VIEWS, SIZE), STREAM, _views),
    Knob("samples of 3D-PSNR", "surface points", (10_000, 100_000, SAMPLES, 4_000_000), (10_000, 100_000), SAMPLES, STREAM,
         lambda value, place: {"kind": "samples", "samples": value}, ("measure",)),
    Knob("threads", "most threads; read the wall clock", tuple(dict.fromkeys((1, default_threads()))), (), 1, HOME,
         _option("threads"), ("threads",), asked=True),
)
BY_NAME = {knob.name.replace(" ", "-"): knob for knob in KNOBS}  # as a command line names them
# Every other field of EncodeOptions, and why it has no row.
NO_KNOB = {
    "target_bytes": "searches the QP, whose rows say what it costs",
    "target_psnr": "searches the QP, whose rows say what it costs",
    "target_psnr_of": "says what a PSNR is of",
    "chroma_qp_offset": "moves bits between brightness and colour, at no cost in time",
    "keep_mesh": "the mesh that is sent has knobs of its own; it takes back what choosing one gained",
    "effects": "which maps are coded, not how exactly",
    "codec_options": "a plug-in's",
    "latent_index": "measured with its alternatives in docs/design/neural.md",
    "transport": "without loss; measured in docs/design/neural.md",
    "seed": "changes which fit is found, not how good it is on average",
    "checkpoint": "a file that a fit goes on from",
    "fit_engine": "which program fits, by the machine",
    "no_check": "leaves out a look at what was made, 5 to 13 % of the time",
    "strict": "refuses, and changes nothing else",
    "allow_empty": "refuses, and changes nothing else",
    "limits": "refuse, and change nothing else",
}


def name_of(value):
    """A value as people read it."""
    if isinstance(value, tuple):
        return " x ".join(map(str, value))
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else f"{value}"


def curve_settings(place, over, quick=False):
    """Settings of the rate curve over QP at VOXELS or TEXELS, and at the asset's home those of the knob QP itself."""
    home = over == place.home
    values = QPS.values if home and not quick else QPS.quick
    return [encode_setting(place.base(over) | {"qp": qp}, home) for qp in values]
