"""Small assets and settings of the encoder, drawn by hypothesis: what real files have been seen to hold, mixed at random.

An asset is a GLB of one to three parts that stand apart. A part is a sheet, a single triangle or faces without area, and its
material is of a kind: one colour as a factor or as an image, invisible, a palette asked at texel centres, one texel, noise,
vertex colours, or an image without UVs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from mesh_files import Builder, encoded
from shapes import linear

FLAT_KINDS = ("factor", "one colour", "one texel")  # one colour all over, by what it is written as
KINDS = (*FLAT_KINDS, "invisible", "palette", "noise", "vertex colours", "no uv")
SHAPES = ("sheet", "triangle", "flat")  # flat: faces without area
APART = 3.0  # from part to part, each of side 1: further than two voxels of the coarsest grid
WRAPS = (10497, 33071, 33648)
NEAREST, LINEAR = 9728, 9729
ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")


@dataclass(frozen=True)
class Part:
    """kind: of KINDS; shape: of SHAPES; cells: a sheet's along a side; levels: uint8 RGBA, (4,) of each colour that it has;
    wrap, filter: of its sampler; turn: whole numbers that its UVs are off by, where they repeat; mode: of its alpha."""

    kind: str
    shape: str
    cells: int
    levels: tuple
    wrap: tuple
    filter: int
    turn: int
    mode: str
    seed: int

    @property
    def is_uniform(self) -> bool:
        """Whether it has one colour all over, which is seen."""
        return self.kind in FLAT_KINDS and self.mode == "OPAQUE"

    def grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(positions float64 [V, 3], faces [F, 3], UVs [V, 2]), no two faces with a corner in common."""
        n = self.cells if self.shape == "sheet" else 1
        line = np.linspace(0, 1, n + 1)
        x, y = (a.ravel() for a in np.meshgrid(line, line))
        a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
        faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
        faces = faces[:1] if self.shape == "triangle" else faces
        positions = np.stack([x, y, 0.1 * np.sin(5 * x) * np.cos(4 * y)], axis=1)
        if self.shape == "flat":
            positions[:, 1:] = 0
        return positions[faces.ravel()], np.arange(3 * len(faces)).reshape(-1, 3), np.stack([x, y], axis=1)[faces.ravel()]

    def colours_of_faces(self, count: int) -> np.ndarray:
        """Which of its levels each face of a palette has: int64 [count]."""
        return np.random.default_rng(self.seed).integers(0, len(self.levels), count)

    def image(self) -> np.ndarray | None:
        """uint8 [H, W, 4], or None."""
        colours = np.array(self.levels, np.uint8)
        side = 1 + self.seed % 4
        if self.kind in ("one colour", "invisible"):
            return np.broadcast_to(colours[0], (side, side, 4)).copy()
        if self.kind in ("one texel", "palette"):
            return colours[None, : 1 if self.kind == "one texel" else None].copy()
        if self.kind in ("noise", "no uv"):
            return np.random.default_rng(self.seed).integers(0, 256, (2 + side, 3 + side, 4), np.uint8)
        return None

    def uv(self, grid: np.ndarray) -> np.ndarray | None:
        """float32 [V, 2] of those of its grid, or None."""
        if self.kind in ("factor", "vertex colours", "no uv"):
            return None
        if self.kind == "palette":
            chosen = self.colours_of_faces(len(grid) // 3).repeat(3)
            grid = np.stack([(chosen + 0.5) / len(self.levels), np.full(len(chosen), 0.5)], axis=1)
        return (grid + (self.turn if self.wrap == (WRAPS[0], WRAPS[0]) else 0)).astype(np.float32)


@dataclass(frozen=True)
class Asset:
    """parts: of it; scale, offset: of its positions; offset in sides of a part."""

    parts: tuple
    scale: float = 1.0
    offset: float = 0.0

    def glb(self) -> bytes:
        builder = Builder()
        for number, part in enumerate(self.parts):
            positions, faces, grid = part.grid()
            world = (positions + [number * APART, 0, 0] + self.offset) * self.scale
            attributes = {}
            if part.kind == "vertex colours":
                colours = np.random.default_rng(part.seed).integers(0, 256, (len(positions), 4)).astype(np.uint8)
                attributes["COLOR_0"] = builder.accessor(colours, normalized=True)
            builder.primitive(world.astype(np.float32), faces.astype(np.uint16), part.uv(grid), attributes=attributes,
                              material=self._material(builder, part))
        return builder.glb()

    @staticmethod
    def _material(builder, part):
        image, texture, pbr = part.image(), None, {}
        if image is not None:
            texture = builder.texture(encoded(image), magFilter=part.filter, minFilter=part.filter, wrapS=part.wrap[0],
                                      wrapT=part.wrap[1])
        if part.kind == "factor":
            pbr["baseColorFactor"] = linear(part.levels[0])
        return builder.material(texture, pbr=pbr, alphaMode=part.mode)


def usual(kind: str, **more) -> Part:
    """A sheet of a kind, whose other fields are the usual ones where more does not set them."""
    others = {"shape": "sheet", "cells": 2, "levels": ((200, 60, 20, 255),), "wrap": (WRAPS[0],) * 2, "filter": LINEAR, "turn": 0,
             "mode": "OPAQUE", "seed": 1}
    return Part(kind=kind, **others | more)


levels = st.one_of(st.sampled_from([0, 255]), st.integers(0, 255))


@st.composite
def parts(draw):
    """A Part. What is invisible has alpha 0 and a mode that sees it; what is plain is opaque as often as not."""
    kind = draw(st.sampled_from(KINDS))
    count = draw(st.integers(2, 7)) if kind == "palette" else 1
    mode = draw(st.sampled_from(ALPHA_MODES[1:] if kind == "invisible" else ("OPAQUE", *ALPHA_MODES)))
    alpha = st.just(0) if kind == "invisible" else st.just(255) if kind == "palette" else levels
    colours = tuple(draw(st.tuples(levels, levels, levels, alpha)) for _ in range(count))
    wraps, filters = st.sampled_from(WRAPS), st.sampled_from((NEAREST, LINEAR))
    return Part(kind=kind, shape=draw(st.sampled_from(("sheet", *SHAPES))), cells=draw(st.integers(1, 3)), levels=colours,
                wrap=draw(st.tuples(wraps, wraps)), filter=draw(filters), turn=draw(st.sampled_from((0, 0, -1, 5))), mode=mode,
                seed=draw(st.integers(0, 1000)))


@st.composite
def assets(draw):
    """An Asset."""
    several = tuple(draw(st.lists(parts(), min_size=1, max_size=3)))
    scale, offset = draw(st.sampled_from(((1.0, 0.0), (1.0, 0.0), (1e-30, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e30, 0.0), (1.0, 1e6),
                                          (1.0, -3e4))))
    return Asset(several, scale, offset)


RATES = (
    *({"resolution": k, "qp": qp} for k, qp in ((8, 28), (16, 36), (16, 20), (24, 4), (1, 40))),
    {"resolution": 12, "lossless": True}, {"resolution": 12, "near_lossless": 3}, {"support": "texels", "lossless": True},
    {"support": "texels", "near_lossless": 9}, {"support": "texels", "rate": "r01"}, {"support": "texels", "rate": "r03"},
    {"support": "texels", "rate": "r06"},
)  # fmt: skip
SLOW_RATES = ({"rate": "r01"}, {"rate": "r03"}, {"rate": "r05", "exact_rate": True}, {"target_bytes": 300},
              {"target_bytes": 5000}, {"target_psnr": 30.0}, {"support": "voxels", "rate": "r02"})
SWITCHES = ("strict", "measure", "no_check")


@st.composite
def settings_of_encode(draw, rates=RATES):
    """Options of EncodeOptions by name, but near_lossless for max_error, as texf-enc has them."""
    options = dict(draw(st.sampled_from(rates)))
    if "resolution" in options and draw(st.booleans()):
        options["support"] = draw(st.sampled_from(("auto", "voxels", "texels")))
    options["effort"] = draw(st.sampled_from(("fast", "fast", "balanced")))
    options |= {name: True for name in SWITCHES if draw(st.integers(0, 3)) == 0}
    for name, values in (("effects", ("auto", "all", "none")), ("refine", ("auto", "off", "fit")), ("position_bits", (8, 14, 20)),
                         ("texel_size", (1, 3))):
        if draw(st.integers(0, 3)) == 0:
            options[name] = draw(st.sampled_from(values))
    return options


def flags_of(options: dict) -> list[str]:
    """The flags of texf-enc that set the options."""
    words = ((("--" + name.replace("_", "-")), value) for name, value in options.items())
    return [word for flag, value in words for word in ((flag,) if value is True else (flag, str(value)))]
