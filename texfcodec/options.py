"""The one home of every default: the command lines and the Python API read these."""

import os
from dataclasses import dataclass, field

from .errors import InputError
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
DEFAULT_RATE = "r04"
EFFORTS = ("fast", "balanced", "best")
REFINEMENTS = ("auto", "off", "fit", "render")
ATLAS_METHODS = ("auto", "quality", "fast")
CODECS = ("raht", "3dntc")
# Of a vertex coordinate. A payload of 50 dB shows what 14 do to a picture: water bottle 45.6 dB over 4 views, 50.1 with exact
# geometry.
POSITION_BITS = {"raht": 14, "3dntc": 16}
LATENT_INDICES = ("mixed", "surface", "hash")
FIT_ENGINES = ("auto", "numba", "torch")
# The paper's operating points of 3DNTC: latents a row, then one table a level: voxels of a grid of 2048 that a cell of latents
# spans, log2 of the rows.
POINTS = {
    "mpeg1": (16, ((6, 15), (12, 14))), "mpeg2": (16, ((6, 16), (12, 15))), "mpeg3": (20, ((6, 16), (12, 15))),
    "mpeg4": (16, ((4, 17), (8, 16))), "mpeg5": (20, ((4, 17), (8, 16))), "mpeg6": (24, ((4, 17), (8, 16))),
    "aom1": (16, ((6, 16), (12, 15))), "aom2": (24, ((6, 16), (12, 15))), "aom3": (32, ((6, 16), (12, 15))),
    "aom4": (24, ((6, 17), (12, 16))), "aom5": (32, ((6, 17), (12, 16))),
}
DEFAULT_POINT = "mpeg1"
DEFAULT_STEPS = 15_000  # the end of the bend: docs/neural.md
APPEARANCES = ("texture", "vertex", "voxels")


def default_threads():
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass
class EncodeOptions:
    """resolution/qp override the rate preset; qp follows G-PCC: step = 2**((qp - 4) / 6).

    max_error: None for lossy, 0 for lossless coding of the voxels' rounded values, 1..127 for values that are at most so far
    off; the encoder then sets the QPs, and qp stays None.

    chroma_qp_offset: added to the QP of both chroma components. area_threshold: voxels holding less surface than this many
    1/256 voxel faces are dropped where coverage allows. partition: "auto" splits the mesh into fields where surfaces meet,
    "off" keeps one. refine: what brings the voxels' colours closer to the source before they are coded: "fit" least squares on
    the surface, "render" inverse rendering on top of it with so many refine_iterations, "auto" a fit where it will show and
    effort is not fast. allow_empty: code a mesh whose faces all collapse as an empty stream instead of refusing it.

    codec "3dntc" fits latents and a network for GPU-resident use instead; rate, qp and effort then have no influence, resolution
    is only that of the voxels which a decoder makes of it, and refine "render" improves the fit on pictures, which "auto" leaves
    out. point: one of the paper's; resident_bytes: in its place, a
    budget of bytes on the GPU; latent_index: "surface" gives every touched voxel of a coarse grid its own latents, as fine a
    grid as the point's bytes allow, "mixed" spends half of them on a hash table over finer cells, "hash" takes the point's hash
    tables; transport: entropy-code the latents in the stream; steps, seed: of the fit; checkpoint: path that its state is kept
    in and taken up from; fit_engine: "auto" takes torch where it sees a GPU, else compiled kernels.
    """

    rate: str = DEFAULT_RATE
    resolution: int | None = None
    qp: int | None = None
    target_bytes: int | None = None
    target_psnr: float | None = None
    max_error: int | None = None
    position_bits: int | None = None
    effort: str = "balanced"
    chroma_qp_offset: int = -1
    area_threshold: int = 77
    partition: str = "auto"
    refine: str = "auto"
    refine_iterations: int = 30
    codec: str = "raht"
    point: str | None = None
    resident_bytes: int | None = None
    latent_index: str = "mixed"
    transport: bool = False
    steps: int = DEFAULT_STEPS
    seed: int = 0
    checkpoint: str | None = None
    fit_engine: str = "auto"
    threads: int = 0
    measure: bool = False
    strict: bool = False
    allow_empty: bool = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self):
        self.threads = self.threads or default_threads()
        if self.rate not in RATES:
            raise InputError("TXF-I50", "unknown rate preset", value=self.rate, allowed=", ".join(RATES))
        if self.effort not in EFFORTS:
            raise InputError("TXF-I50", "unknown effort", value=self.effort, allowed=", ".join(EFFORTS))
        if self.refine not in REFINEMENTS:
            raise InputError("TXF-I50", "unknown refinement", value=self.refine, allowed=", ".join(REFINEMENTS))
        self._check_codec()
        self.position_bits = POSITION_BITS[self.codec] if self.position_bits is None else self.position_bits
        preset = RATES[self.rate]
        self.resolution = preset[0] if self.resolution is None else self.resolution
        if self.max_error is None:
            self.qp = preset[1] if self.qp is None else self.qp
        else:
            self._check_max_error()
        for name, low, high in (("resolution", 1, 8192), ("qp", 0, 63), ("position_bits", 8, 20), ("threads", 1, 1024),
                                ("refine_iterations", 1, 10_000), ("steps", 1, 10_000_000), ("seed", 0, (1 << 31) - 1),
                                ("resident_bytes", 1, 1 << 40)):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise InputError("TXF-I50", f"{name} is out of range", value=value, allowed=f"{low}..{high}")

    @property
    def may_fit(self):
        """Whether a surface fit may follow the transfer."""
        return self.max_error is None and (self.refine in ("fit", "render") or (self.refine == "auto" and self.effort != "fast"))

    def _check_codec(self):
        for name, allowed in (("codec", CODECS), ("latent_index", LATENT_INDICES), ("fit_engine", FIT_ENGINES),
                              ("point", (None, *POINTS))):
            if getattr(self, name) not in allowed:
                raise InputError("TXF-I50", f"unknown {name}", value=getattr(self, name),
                                 allowed=", ".join(a for a in allowed if a))
        if self.codec != "3dntc" and (self.point or self.resident_bytes):
            raise InputError("TXF-I50", "point and resident_bytes belong to codec 3dntc", value=self.codec, allowed="3dntc")
        if self.codec == "3dntc":
            if self.refine == "fit":
                raise InputError("TXF-I50", "refine fit is for voxels; codec 3dntc has auto, off and render", value=self.refine)
            for name in ("target_bytes", "target_psnr", "max_error"):
                if getattr(self, name) is not None:
                    raise InputError("TXF-I50", f"codec 3dntc has no {name}; its size is set by point or resident_bytes",
                                     value=getattr(self, name))
            if self.point and self.resident_bytes:
                raise InputError("TXF-I50", "point and resident_bytes exclude each other", value=self.point)
            if self.resident_bytes and self.latent_index == "hash":
                raise InputError("TXF-I50", "hash tables come with a point; resident_bytes needs latent_index mixed or surface",
                                 value=self.resident_bytes)

    def _check_max_error(self):
        if not 0 <= self.max_error <= 127:
            raise InputError("TXF-I50", "max_error is out of range", value=self.max_error, allowed="0..127")
        for name in ("qp", "target_bytes", "target_psnr"):
            if getattr(self, name) is not None:
                raise InputError("TXF-I50", f"max_error and {name} exclude each other: an error bound sets the QP by itself",
                                 value=getattr(self, name))


@dataclass
class DecodeOptions:
    """lod: octree levels to stop early (0 = full field); isolate: decode in a child process with capped memory and time."""

    lod: int = 0
    threads: int = 0
    isolate: bool = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self):
        self.threads = self.threads or default_threads()
        if not 0 <= self.lod <= 13:
            raise InputError("TXF-I50", "lod is out of range", value=self.lod, allowed="0..13")
