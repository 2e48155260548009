"""The rival that keeps colours at vertices: the mesh subdivided, and Draco with colours.

Edges are halved until none is longer than the asset's longest side / density. Neighbours share the new vertices, so that
nothing cracks. A vertex gets the mean of the source around it, weighted by area and by how much of a point's colour it would
give, which a few steps of a least-squares fit sharpen (8 dB on noise, 10 on a smooth ball, against the mean alone). Colours stay
sRGB-coded, which suits few bits, and are made linear before they are interpolated, as glTF's are.

What a user pays beside geometry is all that Draco needs more than for the positions of the mesh as it was, as one mesh.
"""

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from texfcodec.geometry.canonical import CanonicalCube
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_OPAQUE, Material, Scene
from texfcodec.scene.srgb import srgb_to_linear
from tools.bench.methods import Method, checked_options, draco_mesh, hash_of, method, source_hash, versions_of

DEFAULTS = {"density": 256, "colour_bits": 8, "position_bits": 14}
RANGES = {"density": (1, 8192), "colour_bits": (1, 8), "position_bits": (8, 20)}
MOST_FACES = 1 << 22
MESH = "mesh.bin"
HEAD, PART = struct.Struct("<4d3B"), struct.Struct("<BBfBI")  # cube, bits of both, parts; MaterialKind, alpha, bytes
POINTS = 4  # a side: samples of a face are POINTS * (POINTS + 1) / 2
BLOCK = 1 << 16  # faces sampled at a time
FIT_STEPS, PACE = 8, 1.5  # the matrix's eigenvalues are between 1 / 4 and 1


@method("vertex_colours")
class VertexColours(Method):
    """A subdivided mesh with vertex colours by Draco. Options, with defaults in DEFAULTS and ranges in RANGES."""

    options = tuple(DEFAULTS)

    def version(self):
        """The version of DracoPy, and a hash of the file that codes meshes."""
        return f"{versions_of('DracoPy')} {source_hash(draco_mesh.__file__)}"

    def warm_up(self, options, threads):
        """Load kernels and Draco with a small scene."""
        from texfcodec.precompile import small_scene

        chosen, scene = checked(options) | {"density": 2}, small_scene()
        dec_parts(enc_parts(painted(scene, surface_of(scene, chosen["position_bits"]), chosen, threads)))

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into MESH. Raises ValueError if an option is out of range or for more than MOST_FACES faces."""
        chosen = checked(options)
        with report.stage("subdivide"):
            surface = surface_of(scene, chosen["position_bits"])
            mesh = painted(scene, surface, chosen, threads)
        with report.stage("draco"):
            data, plain = enc_parts(mesh), draco_mesh.positions_alone(surface.lattice, surface.faces)
        (folder / MESH).write_bytes(data)
        return {"bytes": {"total": len(data), "geometry": plain, "colours": len(data) - plain}, **chosen,
                "faces": sum(len(faces) for _, _, faces, _ in mesh.parts), "source_faces": len(scene.faces),
                "vertices": sum(len(lattice) for _, lattice, _, _ in mesh.parts),
                "reconstruction_sha256": self.values_sha256(dec_parts(data).scene())}

    def decode(self, folder, options, threads, report):
        """Return the Scene with vertex colours, decoded from MESH."""
        with report.stage("draco"):
            return dec_parts((folder / MESH).read_bytes()).scene()

    def values_sha256(self, decoded):
        """Return the hash of a decoded Scene's positions, faces and colours."""
        return hash_of(decoded.positions, decoded.faces, decoded.corner_color)


def checked(options):
    """Return all options with defaults. Raises ValueError with the name of one that is out of range."""
    return checked_options(options, DEFAULTS, RANGES, {})


def surface_of(scene, position_bits):
    """Return the Scene's surface on a lattice of position_bits."""
    return make_surface(scene, EncodeOptions(position_bits=position_bits))


# Subdivision. A Patchwork is the mesh on its way: faces of faces of the source, and where their corners are on those.


@dataclass
class Patchwork:
    """A subdivided mesh and where it lies on the source. positions: float64 [V, 3] in lattice steps; faces: int64 [F, 3];
    origin: int64 [F], source face of each; bary: float64 [F, 3, 3], barycentric coordinates of its corners there."""

    positions: np.ndarray
    faces: np.ndarray
    origin: np.ndarray
    bary: np.ndarray


def subdivided(work, longest):
    """Return the Patchwork with no edge longer than `longest` lattice steps. Raises ValueError for more than MOST_FACES
    faces."""
    while True:
        ends = np.sort(np.stack([work.faces, np.roll(work.faces, -1, axis=1)], axis=2), axis=2)
        code = ends[..., 0] * len(work.positions) + ends[..., 1]
        edges, number = np.unique(code, return_inverse=True)
        number = number.reshape(-1, 3)
        a, b = np.divmod(edges, len(work.positions))
        split = ((work.positions[a] - work.positions[b]) ** 2).sum(axis=1) > longest * longest
        if not split.any():
            return work
        if len(work.faces) + 2 * np.count_nonzero(split) > MOST_FACES:
            raise ValueError(f"the mesh would have more than {MOST_FACES} faces: ask for a smaller density")
        middle = np.cumsum(split) - 1 + len(work.positions)
        positions = np.concatenate([work.positions, (work.positions[a] + work.positions[b])[split] / 2])
        work = _halved(work, positions, np.where(split, middle, -1)[number])


def _halved(work, positions, middle):
    """The Patchwork with the edges split that have a new vertex. middle: int64 [F, 3], that of the edge from each corner to the
    next, -1 for none."""
    count = (middle >= 0).sum(axis=1)
    first = np.where(count == 1, np.argmax(middle >= 0, axis=1), (np.argmin(middle >= 0, axis=1) + 1) % 3)
    turn = (first[:, None] + np.arange(3)) % 3  # the first split edge starts at corner 0, an unsplit one at corner 2
    faces, middle = np.take_along_axis(work.faces, turn, axis=1), np.take_along_axis(middle, turn, axis=1)
    bary = np.take_along_axis(work.bary, turn[..., None], axis=1)
    corners = np.concatenate([faces, middle], axis=1)  # 0..2 and the middles 3, 4, 5 of edges 01, 12, 20
    places = np.concatenate([bary, (bary + np.roll(bary, -1, axis=1)) / 2], axis=1)
    parts = []
    for splits, pieces in SPLIT.items():
        own = np.flatnonzero(count == splits)
        parts += [(corners[own][:, piece], work.origin[own], places[own][:, piece]) for piece in pieces]
    return Patchwork(positions, *(np.concatenate(column) for column in zip(*parts, strict=True)))


SPLIT = {0: [[0, 1, 2]], 1: [[0, 3, 2], [3, 1, 2]], 2: [[3, 1, 4], [0, 3, 4], [0, 4, 2]],
         3: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}


# Colours.


def corner_weights():
    """Barycentric coordinates of the samples of a face, float64 [POINTS * (POINTS + 1) / 2, 3]."""
    i, j = np.array([(i, j) for i in range(POINTS) for j in range(POINTS - i)]).T
    return np.stack([i + 1 / 3, j + 1 / 3, POINTS - i - j - 2 / 3], axis=1) / POINTS


def sampled(source, work, faces, threads):
    """Return the source's colours at the sample points of some faces of a Patchwork, float32 [N, S, 4] in 0..255."""
    bary = np.einsum("sk,nkc->nsc", corner_weights(), work.bary[faces])
    origin = np.repeat(work.origin[faces], bary.shape[1])
    return sample_source(source, origin, bary.reshape(-1, 3), threads).reshape(*bary.shape[:2], 4)


def fitted_colours(source, work, threads):
    """Return vertex colours float64 [V, 4] in 0..255: means over the adjacent faces, then FIT_STEPS steps towards those whose
    interpolation is closest to the source (Richardson iteration on the triangles' mass matrix)."""
    weights, sums = corner_weights(), np.zeros((len(work.positions), 5))
    corners = work.positions[work.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) + 1e-9
    for begin in range(0, len(work.faces), BLOCK):
        faces = np.arange(begin, min(begin + BLOCK, len(work.faces)))
        colour = np.einsum("sk,nsc->nkc", weights, sampled(source, work, faces, threads)) * area[faces, None, None]
        rows = work.faces[faces].ravel()
        for column in range(4):
            sums[:, column] += np.bincount(rows, colour[..., column].ravel(), len(sums))
        sums[:, 4] += np.bincount(rows, np.repeat(area[faces], 3) * weights.sum(axis=0)[0], len(sums))
    target = sums[:, :4] / np.maximum(sums[:, 4:], 1e-30)
    colour, rows = target.copy(), work.faces.ravel()
    around = np.maximum(np.bincount(rows, np.repeat(area, 3), len(sums)), 1e-30)
    for _ in range(FIT_STEPS):
        for column in range(4):
            corner = colour[:, column][work.faces]
            shown = (corner + corner.sum(axis=1, keepdims=True)) * (area[:, None] / 4)
            colour[:, column] += PACE * (target[:, column] - np.bincount(rows, shown.ravel(), len(sums)) / around)
    return np.clip(colour, 0, 255)


# Files.


class MaterialKind(NamedTuple):
    """Properties of a material that has vertex colours alone."""

    alpha_mode: int
    double_sided: bool
    alpha_cutoff: float


@dataclass
class Painted:
    """Meshes to code. cube: CanonicalCube; bits: of a colour component; parts: (MaterialKind, lattice int64 [V, 3], faces int64
    [F, 3], colour int64 [V, 4] in 0..2**bits - 1), one for every kind that a face has."""

    cube: CanonicalCube
    bits: int
    parts: list

    def scene(self):
        """The Scene that this is."""
        corners, linear, face_kind = [], [], []
        for number, (_, lattice, faces, colour) in enumerate(self.parts):
            share = colour[faces] / ((1 << self.bits) - 1)
            corners.append(lattice[faces])
            linear.append(np.concatenate([srgb_to_linear(share[..., :3]), share[..., 3:]], axis=2).astype(np.float32))
            face_kind.append(np.full(len(faces), number))
        lattice, faces = np.unique(np.concatenate(corners).reshape(-1, 3), axis=0, return_inverse=True)
        faces, materials = faces.reshape(-1, 3), [Material(**part[0]._asdict()) for part in self.parts]
        return Scene(self.cube.to_world(lattice), faces, np.concatenate(face_kind), np.zeros((len(faces), 3, 2)),
                     np.concatenate(linear), materials, [])


def kinds_of(scene, material):
    """Return (index of its kind per face, int64 [F]; the distinct MaterialKinds). material: of the faces, int64 [F]."""
    of = [MaterialKind(m.alpha_mode, m.double_sided, float(np.float32(m.alpha_cutoff))) for m in scene.materials]
    kinds = sorted({of[m] for m in np.unique(material)})
    return np.array([kinds.index(kind) if kind in kinds else -1 for kind in of])[material], kinds


def painted(scene, surface, chosen, threads):
    """Return the Painted of a Scene. surface: of surface_of(); chosen: the options."""
    source = pack_source(scene, surface.origin_face)
    work = Patchwork(surface.lattice.astype(np.float64), surface.faces, np.arange(len(surface.faces)),
                     np.tile(np.eye(3), (len(surface.faces), 1, 1)))
    work = subdivided(work, surface.cube.last / chosen["density"])
    face_kind, kinds = kinds_of(scene, surface.material[work.origin])
    most = (1 << chosen["colour_bits"]) - 1
    colour = np.rint(fitted_colours(source, work, threads) / 255 * most).astype(np.int64)
    lattice = np.rint(work.positions).astype(np.int64)
    packed = lattice[work.faces] @ np.array([1, 1 << 20, 1 << 40])
    whole = (packed != np.roll(packed, -1, axis=1)).all(axis=1)  # rounding may collapse a face
    parts = []
    for number, kind in enumerate(kinds):
        used, faces = np.unique(work.faces[whole & (face_kind == number)], return_inverse=True)
        own_colour = colour[used]
        if kind.alpha_mode == ALPHA_OPAQUE:
            own_colour[:, 3] = most  # nobody sees it
        parts.append((kind, lattice[used], faces.reshape(-1, 3), own_colour))
    return Painted(surface.cube, chosen["colour_bits"], parts)


def enc_parts(coded):
    """Return the bytes of a Painted: HEAD, then for every kind a PART with Draco's bytes."""
    out = [HEAD.pack(*coded.cube.origin, coded.cube.side, coded.cube.position_bits, coded.bits, len(coded.parts))]
    for kind, lattice, faces, colour in coded.parts:
        data = draco_mesh.enc_mesh(lattice, faces, {"colour": colour[faces]})  # without alpha where it is constant
        out += [PART.pack(*kind, int(colour[0, 3]), len(data)), data]
    return b"".join(out)


def dec_parts(data):
    """Return the Painted decoded from enc_parts()'s bytes."""
    import DracoPy

    *origin, side, position_bits, bits, count = HEAD.unpack_from(data)
    place, parts = HEAD.size, []
    for _ in range(count):
        mode, sides, cutoff, alpha, length = PART.unpack_from(data, place)
        place += PART.size + length
        mesh = DracoPy.decode(data[place - length : place])
        colour = np.full((len(mesh.points), 4), alpha, np.int64)
        colour[:, : mesh.colors.shape[1]] = mesh.colors
        parts.append((MaterialKind(mode, bool(sides), cutoff), np.asarray(mesh.points).astype(np.int64),
                      np.asarray(mesh.faces).astype(np.int64), colour))
    return Painted(CanonicalCube(tuple(origin), side, position_bits), bits, parts)
