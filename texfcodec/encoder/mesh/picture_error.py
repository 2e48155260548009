"""Error of pictures because the sent surface is not where the source's is (encoder only).

The visible error comes less from the texture, which moves on the surface by a small part of a texel, than from the surface
itself: close layers come to the front of each other, and flat faces catch the light otherwise. That is hard to calculate and easy
to see, so the encoder renders a few pictures, in light if the asset is lit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...core.colour_error import ColourError
from ...core.threads import in_order
from ...geometry.areas import relative_areas
from ...geometry.canonical import MAX_BITS, fit_cube
from ...geometry.shading_normals import corner_normals
from ...render.camera import bounding_sphere, fibonacci_direction, orthographic
from ...render.depth_layers import see_through
from ...render.lighting import Lighting
from ...render.lit_scene import SceneMaps
from ...render.material_effects import ShadingTable
from ...render.raster import rasterise
from ...render.shade import colour_fragments, render_lights
from ...scene.channels import NORMAL_MAPS
from ...scene.fetch import pack_source
from ...scene.normal_rule import BOTH, FLAT, JOINED, MOST_ANGLE, NormalRule
from .small_parts import small_parts

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...render.camera import Camera
    from ...scene.fetch import PackedSource
    from ...scene.scene import Scene
    from ..faces import SentSurface, SourceFaces, SourceSurface

VIEWS, SIZE = 16, 256
# Pixels of which one is compared: where a moved surface shows the same face, that of small parts, and between other faces. The
# sides of pictures are no multiples, so that the pixels are spread in rows and columns.
EVERY, PART_EVERY, EVERY_OTHER = 13, 5, 7
LOST_ERROR = 100.0**2  # of a pixel of which the background is seen, or that covers it
OUTLINE = 0.04  # weight of pixels at the outline whose neighbours hide that: a viewer sees the line, not against what it moves
PART_VIEWS, PART_SIZE = 4, 192  # pictures of small parts alone
SMOOTH = NormalRule(JOINED, BOTH, MOST_ANGLE)  # no angle decides anything, so that rounding turns normals and no more
PART_WEIGHT = 0.25  # of a small part's error in that of all: somebody may look at it alone, and most do not


@dataclass(frozen=True)
class PictureError:
    """Error of pictures of a moved surface. mse: mean squared error of Y over pixels that show both surfaces, in flat colours or
    in light, whichever is larger; silhouette: pixels that show one surface only, over those of the source; lost: the share of
    these that have no pixel of the other surface around them; of_parts: the same of each small part, seen alone."""

    mse: float
    silhouette: float
    lost: float
    of_parts: tuple[PictureError, ...] = ()

    @property
    def error(self) -> float:
        """Mean squared error of Y, with lost and new pixels against the background; that of a small part if it is worse even at
        its lower weight."""
        own = self.mse + LOST_ERROR * max(self.lost, OUTLINE * self.silhouette)
        return max([own, *(PART_WEIGHT * part.error for part in self.of_parts)])

    @property
    def worst_part(self) -> float:
        """The largest mse of a small part, 0 without any."""
        return max((part.mse for part in self.of_parts), default=0.0)

    @property
    def worst_lost(self) -> float:
        """The largest lost share, of the whole and of small parts."""
        return max(part.lost for part in (self, *self.of_parts))


class _View:
    """A scene from one camera. fragments: visible points, None if a material lets light through; covered: bool [H, W], pixels.
    The points are coloured when their colours are asked for, once."""

    def __init__(self, scene: Scene, camera: Camera, lights: list[Lighting | None], source: PackedSource) -> None:
        self._camera, self._lights, self._source = camera, lights, source
        if see_through(scene.materials, scene.face_material):
            self.fragments, self._pictures = None, render_lights(scene, camera, lights, source=source)
            self.covered = _covered(self._pictures[0])
            return
        self.fragments = rasterise(camera, scene.positions, scene.faces)
        self.covered = _covered(self.fragments)
        self._is_coloured = np.zeros(len(self.fragments.pixel), np.bool_)
        self._colours = [np.empty((len(self._is_coloured), 3), np.float32) for _ in lights]

    @property
    def pixel(self) -> np.ndarray:
        """Numbers of the covered pixels, int64 [n]."""
        return self._pictures[0].pixel if self.fragments is None else self.fragments.pixel

    def colours(self, rows: np.ndarray) -> list[np.ndarray]:
        """Return the colours of some covered pixels in each light, float32 [m, 3]. rows: int64 [m], their places in `pixel`."""
        if self.fragments is None:
            return [picture.colour[rows] for picture in self._pictures]
        new = rows[~self._is_coloured[rows]]
        if len(new):
            pictures = colour_fragments(self._camera, self.fragments.rows(new), self._lights, self._source)
            for colour, picture in zip(self._colours, pictures, strict=True):
                colour[new] = picture.colour
            self._is_coloured[new] = True
        return [colour[rows] for colour in self._colours]


class _Shot(NamedTuple):
    """Cameras that see all of a scene or a small part of it. faces: bool [F] of the source's, None for all; views: of the source,
    by camera."""

    cameras: list[Camera]
    faces: np.ndarray | None
    views: list[_View]


class PictureComparison:
    """Comparison of pictures of a Scene with pictures of its moved surface. The source is rendered once, and small parts of it
    alone, in close-up. usual: the scene on its lattice; shown: squared error of pictures by a squared radian of its shading
    normals."""

    def __init__(self, scene: Scene, usual: SourceSurface, shown: float, threads: int) -> None:
        self.shown, self.threads = shown, threads
        self.scene = replace(scene, materials=[replace(m, double_sided=False) for m in scene.materials])
        self.lit = not all(material.unlit for material in scene.materials)
        if self.lit:
            self.scene = _with_tangents(self.scene)
        self._source, self._table = pack_source(self.scene), ShadingTable(self.scene.materials)
        self._own_lights = self._lights(self.scene)
        self._shots = [self._shot(None, VIEWS, SIZE)]
        parts = [_of_source(usual, part, len(scene.faces)) for part in small_parts(usual)]
        self._shots += [self._shot(part, PART_VIEWS, PART_SIZE) for part in parts]

    def _shot(self, faces, views, size):
        corners = self.scene.faces if faces is None else self.scene.faces[faces]
        sphere = bounding_sphere(self.scene.positions if faces is None else self.scene.positions[corners.ravel()])
        cameras = [orthographic(fibonacci_direction(i, views), *sphere, size) for i in range(views)]
        return _Shot(cameras, faces, self._views(self.scene, self._own_lights, cameras, faces))

    def _lights(self, scene):
        """Return how a scene is drawn: in flat colours and, if there is light, in light. All shots share its normals."""
        return [None, *([Lighting(scene, table=self._table)] if self.lit else [])]

    def ready(self) -> None:
        """Compute what pictures of the source in light need, which the first comparison would do else."""
        for light in self._own_lights[1:]:
            _ = light.maps.corner_normal, light.geometric

    def _views(self, scene, lights, cameras, shown, source=None):
        """Return the _Views of shown faces, bool [F], or all, by camera. lights: of _lights(scene); source: of the base colour,
        if it is not the source's."""
        source = source or self._source
        if shown is not None:
            scene = replace(scene, faces=np.where(shown[:, None], scene.faces, 0))
        first = _View(scene, cameras[0], lights, source)  # makes what all share, which two threads would make twice
        return [first, *in_order(lambda camera: _View(scene, camera, lights, source), cameras[1:], self.threads)]

    def of(self, drawn: SourceSurface, normals: np.ndarray) -> PictureError:
        """Return the PictureError of the source on another surface. drawn: faces of the source in their new places; normals: at
        their corners by normals_of() that surface, float32 [F, 3, 3]. Pictures keep the file's normals, and the error of the new
        normals is added. Halving a distance about halves the error, as the pixels that change lie along lines."""
        faces = np.zeros_like(self.scene.faces)  # of those that are not there no pixel is seen
        faces[drawn.origin_face] = drawn.faces
        scene = replace(self.scene, positions=drawn.cube.to_world(drawn.lattice), faces=faces)
        wanted = None if self.scene.corner_normal is None or not self.lit else self.normals[drawn.origin_face]
        lights = self._lights(scene)
        return self._moved(lambda shot: self._views(scene, lights, shot.cameras, shot.faces), drawn, normals, wanted, True)

    def of_mesh(self, scene: Scene, surface: SentSurface, normals: np.ndarray, wanted: np.ndarray | None,
                faces: SourceFaces) -> PictureError:
        """Return the PictureError of a simplified Scene: it has the source's materials and textures, but faces, UVs and normals
        of its own. surface: that scene on its lattice; normals: at its corners by normals_of(surface); wanted: the correct ones,
        both float32 [F, 3, 3]; faces: [F], source face that each face was simplified from."""
        scene = replace(scene, materials=self.scene.materials)
        source = self._source._replace(face_material=np.ascontiguousarray(scene.face_material, np.int64),
                                       corner_uv=np.ascontiguousarray(scene.corner_uv, np.float64))
        lights = self._lights(scene)

        def views(shot):
            return self._views(scene, lights, shot.cameras, None if shot.faces is None else shot.faces[faces], source)

        return self._moved(views, surface, normals, wanted, False)

    def _moved(self, views, surface, normals, wanted, same_faces):
        """Return the PictureError of views and of a Surface's normals. views: function that renders a _Shot; wanted: correct
        normals, None without any; same_faces: whether the surface's faces have the numbers of the source's."""
        whole, *parts = (_compared(shot.views, views(shot), self._every(shot, same_faces), self.threads) for shot in self._shots)
        turned = self.shown * _turned(surface, normals, wanted) if wanted is not None else 0.0
        return replace(whole, mse=whole.mse + turned, of_parts=tuple(parts))

    def _every(self, shot, same_faces):
        """Return (pixels of which one is compared; whether all pixels count that show another face)."""
        every = EVERY if shot.faces is None else PART_EVERY
        return (every, True) if same_faces else (min(every, EVERY_OTHER), False)

    def normals_of(self, surface: Surface) -> np.ndarray:
        """Return the normals that follow from a surface's positions, at the corners of its faces, float32 [F, 3, 3]: face
        normals if the source's are, else smooth ones."""
        return corner_normals(surface.lattice, surface.faces, [FLAT if self.is_flat else SMOOTH])

    @cached_property
    def is_flat(self) -> bool:
        """True if the file's normals are closer to face normals than to smooth ones."""
        if self.scene.corner_normal is None:
            return False
        apart = [np.square(self._of_source(rule).astype(np.float64) - self.scene.corner_normal).sum() for rule in (FLAT, SMOOTH)]
        return bool(apart[0] < apart[1])

    @cached_property
    def normals(self) -> np.ndarray:
        """Normals that follow from the source's positions, at the corners of all its faces, float32 [F, 3, 3]."""
        return self._of_source(FLAT if self.is_flat else SMOOTH)

    def _of_source(self, rule):
        lattice = fit_cube(self.scene.positions, MAX_BITS).to_lattice(self.scene.positions)
        return corner_normals(lattice, self.scene.faces, [rule])


def _with_tangents(scene):
    """Return a scene that has the tangents of its normal maps, so that they are not derived again on each moved surface."""
    names = NORMAL_MAPS & {name for material in scene.materials for name in material.maps}
    if len({id(scene.map_uv.get(name, scene.corner_uv)) for name in names}) != 1:
        return scene
    return replace(scene, corner_tangent=SceneMaps(scene).corner_tangent(min(names)))


def _of_source(surface, part, count):
    """Return the source's faces that a part of a Surface comes from, bool [count]. part: bool [F]."""
    shown = np.zeros(count, bool)
    shown[surface.origin_face[part]] = True
    return shown


def _compared(views, others, every, threads):
    """Return the PictureError of two lists of _Views, without normals. views: of the source; every: of _every()."""
    silhouette, lost, shown = np.sum([_uncovered(a.covered, b.covered) for a, b in zip(views, others, strict=True)], axis=0)

    def colours(pair):
        rows, weight = _matched(pair[0], pair[1], *every)
        return [view.colours(own) for view, own in zip(pair, rows, strict=True)], weight

    pairs, errors = list(zip(views, others, strict=True)), dict[int, ColourError]()
    for (before, after), weight in (colours(pairs[0]), *in_order(colours, pairs[1:], threads)):
        for light, (a, b) in enumerate(zip(before, after, strict=True)):
            errors.setdefault(light, ColourError()).add(a, b, weight)
    mse = max(error.mse()["y"] if error.samples else 0.0 for error in errors.values())
    return PictureError(mse, silhouette / max(shown, 1), lost / max(shown, 1))


def _matched(view, other, every, with_changed):
    """Return ((rows of a _View's pixels, those of another's), both int64 [n]; pixels that each stands for, float64 [n], None for
    equally many) of pixels to compare: one of `every`, and if with_changed all that show another face."""
    pixel, *rows = np.intersect1d(view.pixel, other.pixel, assume_unique=True, return_indices=True)
    if view.fragments is None:
        return rows, None
    some = pixel % every == 0
    if not with_changed:
        return [own[some] for own in rows], None
    changed = view.fragments.face[rows[0]] != other.fragments.face[rows[1]]
    some |= changed
    return [own[some] for own in rows], np.where(changed, 1.0, every)[some]


def _turned(surface, normals, wanted):
    """Return the mean square, over a surface, of the angles in radians between normals and others, float [F, 3, 3]."""
    apart = np.linalg.norm(wanted - normals.astype(np.float64), axis=2)
    angle = 2 * np.arcsin(np.minimum(apart / 2, 1.0))
    area = relative_areas(surface.cube.to_world(surface.lattice), surface.faces)
    return float((angle**2).mean(axis=1) @ area / (area.sum() or 1.0))


def _covered(drawn):
    """Return the pixels that a Picture or Fragments cover, bool [H, W]."""
    covered = np.zeros((drawn.height, drawn.width), bool)
    covered.ravel()[drawn.pixel] = True
    return covered


def _uncovered(a, b):
    """Return numbers of pixels, of two pictures' covered ones, bool [H, W]: those that one covers and the other does not, those
    of them that are alone, and those of the first."""
    near_a, near_b = (_grown(covered) for covered in (a, b))
    return np.array([(a ^ b).sum(), (a & ~near_b).sum() + (b & ~near_a).sum(), a.sum()])


def _grown(covered):
    """Return pixels that are covered or have a covered neighbour, of eight: bool [H, W]."""
    rows = np.pad(covered, 1)
    rows = rows[:-2] | rows[1:-1] | rows[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
