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
    from ...render.raster import Fragments
    from ...render.shade import Picture
    from ...scene.scene import Scene
    from ..faces import SentSurface, SourceFaces, SourceSurface

VIEWS, SIZE = 16, 256
EVERY = 4  # pixels of which one is compared, where a moved surface shows the same face
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


class _Seen(NamedTuple):
    """Pictures from one camera. covered: bool [H, W]; fragments: all of them, None if a material lets light through; pictures:
    one for each light; weight: float64 [n], pixels that each of theirs stands for, None for itself alone."""

    covered: np.ndarray
    fragments: Fragments | None
    pictures: list[Picture]
    weight: np.ndarray | None


class _Shot(NamedTuple):
    """Cameras that see all of a scene or a small part of it. faces: bool [F] of the source's, None for all; seen: _Seen of the
    source, by camera."""

    cameras: list[Camera]
    faces: np.ndarray | None
    seen: list[_Seen]


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
        self._shots = [self._shot(None, VIEWS, SIZE)]
        parts = [_of_source(usual, part, len(scene.faces)) for part in small_parts(usual)]
        self._shots += [self._shot(part, PART_VIEWS, PART_SIZE) for part in parts]

    def _shot(self, faces, views, size):
        corners = self.scene.faces if faces is None else self.scene.faces[faces]
        sphere = bounding_sphere(self.scene.positions if faces is None else self.scene.positions[corners.ravel()])
        cameras = [orthographic(fibonacci_direction(i, views), *sphere, size) for i in range(views)]
        return _Shot(cameras, faces, self._pictures(self.scene, cameras, faces))

    def _pictures(self, scene, cameras, shown, source=None, seen=None):
        """Return the _Seen of shown faces, bool [F], or all, by camera: in flat colours and, if there is light, in light. source:
        of the base colour, if it is not the source's; seen: of the source, if the faces are the same in other places."""
        lights, source = [None, *([Lighting(scene, table=self._table)] if self.lit else [])], source or self._source
        if shown is not None:
            scene = replace(scene, faces=np.where(shown[:, None], scene.faces, 0))

        def look(number):
            camera = cameras[number]
            if see_through(scene.materials, scene.face_material):
                pictures = render_lights(scene, camera, lights, source=source)
                return _Seen(_covered(pictures[0]), None, pictures, None)
            fragments, weight = rasterise(camera, scene.positions, scene.faces), None
            covered, coloured = _covered(fragments), fragments
            if seen is not None:
                rows, weight = _changed(seen[number].fragments, fragments)
                coloured = fragments.rows(rows)
            return _Seen(covered, fragments, colour_fragments(camera, coloured, lights, source), weight)

        first = look(0)  # makes what all share, tangents for one, which two threads would make twice
        return [first, *in_order(look, range(1, len(cameras)), self.threads)]

    def of(self, drawn: SourceSurface, normals: np.ndarray) -> PictureError:
        """Return the PictureError of the source on another surface. drawn: faces of the source in their new places; normals: at
        their corners by normals_of() that surface, float32 [F, 3, 3]. Pictures keep the file's normals, and the error of the new
        normals is added. Halving a distance about halves the error, as the pixels that change lie along lines."""
        faces = np.zeros_like(self.scene.faces)  # of those that are not there no pixel is seen
        faces[drawn.origin_face] = drawn.faces
        scene = replace(self.scene, positions=drawn.cube.to_world(drawn.lattice), faces=faces)
        wanted = None if self.scene.corner_normal is None or not self.lit else self.normals[drawn.origin_face]
        return self._moved(lambda shot: self._pictures(scene, shot.cameras, shot.faces, seen=shot.seen), drawn, normals, wanted)

    def of_mesh(self, scene: Scene, surface: SentSurface, normals: np.ndarray, wanted: np.ndarray | None,
                faces: SourceFaces) -> PictureError:
        """Return the PictureError of a simplified Scene: it has the source's materials and textures, but faces, UVs and normals
        of its own. surface: that scene on its lattice; normals: at its corners by normals_of(surface); wanted: the correct ones,
        both float32 [F, 3, 3]; faces: [F], source face that each face was simplified from."""
        scene = replace(scene, materials=self.scene.materials)
        source = self._source._replace(face_material=np.ascontiguousarray(scene.face_material, np.int64),
                                       corner_uv=np.ascontiguousarray(scene.corner_uv, np.float64))

        def pictures(shot):
            return self._pictures(scene, shot.cameras, None if shot.faces is None else shot.faces[faces], source)

        return self._moved(pictures, surface, normals, wanted)

    def _moved(self, pictures, surface, normals, wanted):
        """Return the PictureError of pictures and of a Surface's normals. pictures: function that renders a _Shot; wanted:
        correct normals, None without any."""
        whole, *parts = (_compared(shot.seen, pictures(shot)) for shot in self._shots)
        turned = self.shown * _turned(surface, normals, wanted) if wanted is not None else 0.0
        return replace(whole, mse=whole.mse + turned, of_parts=tuple(parts))

    def normals_of(self, surface: Surface) -> np.ndarray:
        """Return the normals that follow from a surface's positions, at the corners of its faces, float32 [F, 3, 3]: face
        normals if the source's are, else smooth ones."""
        return corner_normals(surface.lattice, surface.faces, [FLAT if self.is_flat else SMOOTH])

    @cached_property
    def is_flat(self) -> bool:
        """True if the file's normals are closer to face normals than to smooth ones."""
        if self.scene.corner_normal is None:
            return False
        apart = [np.square(self._of_source(rule) - self.scene.corner_normal).sum() for rule in (FLAT, SMOOTH)]
        return bool(apart[0] < apart[1])

    @cached_property
    def normals(self) -> np.ndarray:
        """Normals that follow from the source's positions, at the corners of all its faces, float64 [F, 3, 3]."""
        return self._of_source(FLAT if self.is_flat else SMOOTH)

    def _of_source(self, rule):
        lattice = fit_cube(self.scene.positions, MAX_BITS).to_lattice(self.scene.positions)
        return corner_normals(lattice, self.scene.faces, [rule]).astype(np.float64)


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


def _compared(seen, others):
    """Return the PictureError of two lists of _Seen, without normals. seen: of the source."""
    silhouette, lost, shown = np.sum([_uncovered(a.covered, b.covered) for a, b in zip(seen, others, strict=True)], axis=0)
    mse = max(_mse(seen, others, light) for light in range(len(seen[0].pictures)))
    return PictureError(mse, silhouette / max(shown, 1), lost / max(shown, 1))


def _turned(surface, normals, wanted):
    """Return the mean square, over a surface, of the angles in radians between normals and others, float [F, 3, 3]."""
    apart = np.linalg.norm(wanted - normals.astype(np.float64), axis=2)
    angle = 2 * np.arcsin(np.minimum(apart / 2, 1.0))
    area = relative_areas(surface.cube.to_world(surface.lattice), surface.faces)
    return float((angle**2).mean(axis=1) @ area / (area.sum() or 1.0))


def _changed(first, fragments):
    """Return (numbers of fragments to colour, int64 [n]; pixels that each stands for, float64 [n]) of those that first shows too:
    where another face is seen, and EVERY other one."""
    _, before, rows = np.intersect1d(first.pixel, fragments.pixel, assume_unique=True, return_indices=True)
    changed = first.face[before] != fragments.face[rows]
    some = changed | (np.arange(len(rows)) % EVERY == 0)
    return rows[some], np.where(changed, 1.0, EVERY)[some]


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


def _mse(seen, others, light):
    """Return the mean squared error of Y over pixels that both show, in one of the lights."""
    error = ColourError()
    for first, other in zip(seen, others, strict=True):
        a, b = first.pictures[light], other.pictures[light]
        both, of_a, of_b = np.intersect1d(a.pixel, b.pixel, assume_unique=True, return_indices=True)
        if len(both):
            error.add(a.colour[of_a], b.colour[of_b], None if other.weight is None else other.weight[of_b])
    return error.mse()["y"] if error.samples else 0.0
