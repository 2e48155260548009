"""Compiling the kernels before their use, and detecting compiled kernels without numba."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from .sandbox.engines import ENTRIES, kernels_compiled

if TYPE_CHECKING:
    from .scene.scene import Scene

# Seconds, roughly: with an empty cache the first run took 21 to 34 s more than the second in texf-enc, which compiles on two
# processors, and 22 in texf-dec without the sandbox (demo asset, a slow machine); --warmup compiles what both need, and more.
ENCODING, DECODING, ALL = 30, 20, 60
_FIRST_RUN = "first run: compiling the kernels takes about {} s, once"


def first_run(seconds: int) -> str | None:
    """Return a line that announces the compilation of kernels; None if they are compiled. seconds: about how long it takes,
    ENCODING, DECODING or ALL."""
    return None if kernels_compiled() else _FIRST_RUN.format(seconds)


class Stage(NamedTuple):
    """Kernels that are compiled together. compile_them: compiles them; entries: files whose kernels it compiles last, so that
    their presence in the cache means that all are there."""

    compile_them: Callable[[], None]
    entries: tuple[str, ...] = ENTRIES


def compile_encoding() -> None:
    """Compiles the kernels of a usual encode in another order than it needs them: coding and decoding before pictures."""
    import numpy as np

    from .api import encode_loaded
    from .codecs import codec_of
    from .encoder.place.contacts import find_contacts
    from .options import DEFAULT_CODEC, EncodeOptions
    from .report import Report
    from .scene.scene import Texture

    codec_of(DEFAULT_CODEC).run_kernels()
    scene = small_scene()
    scene.textures = [Texture(np.full((16, 16, 4), 200, np.uint8))]
    encode_loaded(scene, EncodeOptions(resolution=16), Report())  # one colour, so nothing goes through the transform
    find_contacts(np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]]), np.array([[0, 1, 2]]), 8, 16)


def compile_decoding() -> None:
    """Compiles the kernels that a decoder needs last: the levels of the transform. Meanwhile a decode begins with supports."""
    from .codecs import codec_of
    from .options import DEFAULT_CODEC

    codec_of(DEFAULT_CODEC).run_kernels(encoding=False)


def compile_saving() -> None:
    """Compiles the kernels of saving as a GLB: those that fill an atlas, then those that build it. No stream is involved."""
    import numpy as np

    from .field.voxels import VoxelSupport
    from .geometry.canonical import CanonicalCube
    from .geometry.geometry_unit import GeometryUnit
    from .io.atlas.bake import bake
    from .io.atlas.unwrap import Atlas
    from .io.save import as_glb
    from .scene.scene import Material
    from .texf import Field, Texf

    voxels, corners = VoxelSupport(16, np.arange(16**3)), np.array([[0, 0, 0], [255, 0, 0], [255, 255, 255], [0, 255, 255]])
    faces, side = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    colours = np.random.default_rng(0).integers(0, 256, (len(voxels.keys), 3), np.uint8)
    texf = Texf(cube=CanonicalCube((0.0, 0.0, 0.0), 1.0, 8), units=[GeometryUnit(0, 0, corners, faces)],
                fields=[Field(voxels, {"base_colour": colours})], materials=[Material()])
    bake(texf, atlas=Atlas(side[faces], 64, 64, "fast", 1.0))
    as_glb(texf, texture_size=64)


def warm_up() -> None:
    """Encodes, measures, decodes, renders, bakes and saves a small mesh, so that every kernel is compiled and cached."""
    from .api import decode, encode_loaded, measure
    from .codecs import our_codecs
    from .geometry.mesh import Mesh
    from .io.save import as_glb
    from .metrics.surface_distance import surface_distance
    from .metrics.views import compare_views
    from .options import DecodeOptions, EncodeOptions
    from .report import Report

    scene, texf_of = small_scene(), {}
    for codec in our_codecs():
        for settings in codec.small:
            encoded = encode_loaded(scene, EncodeOptions(codec=codec.name, **settings), Report())
            measure(scene, encoded)
            texf = decode(encoded.data, DecodeOptions(engine="numba"))
            compare_views(scene, texf, views=1, size=64, ssim=True)
            surface_distance(Mesh(scene.positions, scene.faces), Mesh(texf.positions, texf.faces), samples=100)
            texf_of[texf.fields[0].over_texels] = texf
    _simplify_small()
    for atlas in ("fast", "quality"):
        as_glb(texf_of[False], texture_size=64, atlas=atlas)
    as_glb(texf_of[True])


def _simplify_small():
    """Runs the steps that an encode takes for a mesh of more faces than the small scene has."""
    import numpy as np

    from .encoder.mesh.drawn_source import draw_onto
    from .encoder.mesh.joint_lattice import joint_lattice
    from .encoder.mesh.simplify import simplify
    from .encoder.mesh.vertex_fit import MatchedLines, fit_vertices
    from .geometry.canonical import fit_cube
    from .geometry.mesh import Mesh

    places = np.arange(25).reshape(5, 5)
    a, b, c, d = (part.ravel() for part in (places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:]))
    x, y = np.divmod(np.arange(25.0), 5)
    sheet = Mesh(np.stack([x, y, np.sin(x)], axis=1), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))
    order = simplify(sheet)
    some = order.at(16)
    fit = fit_vertices(sheet, some.mesh, MatchedLines(order.lines, some.lines), samples=100, rounds=1)
    joint_lattice(fit, fit_cube(sheet.positions, 10))
    draw_onto(sheet, np.zeros(len(sheet.faces), np.int64), fit.mesh, np.zeros(len(fit.mesh.faces), np.int64))


def small_scene() -> Scene:
    """Two crossing sheets, one of them transparent, so that fields split and both channel groups are coded."""
    import numpy as np

    from .scene.scene import ALPHA_BLEND, Material, Scene, Texture

    side = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    flat, upright = np.insert(side, 2, 0.5, axis=1), np.insert(side, 0, 0.5, axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    image = np.random.default_rng(0).integers(0, 256, (16, 16, 4), np.uint8)
    return Scene(
        positions=np.concatenate([flat, upright]), faces=np.concatenate([faces, faces + 4]),
        face_material=np.array([0, 0, 1, 1]), corner_uv=np.concatenate([side[faces], side[faces]]), corner_color=None,
        materials=[Material(texture=0), Material(texture=0, alpha_mode=ALPHA_BLEND)], textures=[Texture(image)],
    )


STAGES = {"encode": Stage(compile_encoding), "decode": Stage(compile_decoding),
          "save": Stage(compile_saving, ("io/atlas/chart_padding.py", "io/atlas/chart_packing.py"))}

if __name__ == "__main__":
    for name in sys.argv[1:]:
        STAGES[name].compile_them()
