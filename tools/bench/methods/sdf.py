"""The rival "SDF + marching cubes with the same field": geometry as signed distances on a grid, and our field over the mesh that
marching cubes makes of them.

What counts: the distances as geometry, and the stream of the field without its mesh, which the decoder makes again and puts back
in its place. Distances are libigl's, whose signs are those of generalised winding numbers (Jacobson and others, 2013): small
holes and faces that run through each other do no harm. They are quantised in a narrow band around the surface; only the corners
of cells that the surface crosses need theirs, all others no more than their sign. They are coded without loss as one image, slice
after slice, by JPEG XL, which took 29 % fewer bytes than a range coder of our own on three scans. Colours of the field's voxels
are means of the source's at the points nearest to those of the new surface that face the same way; they are not refined, because
a refinement compares with the source's own surface. Base colour and alpha alone.

A sheet has no inside: a scene of which more than MOST_LOST of the surface is seen with nothing behind it is refused. Needs
libigl, imagecodecs and scikit-image, `pip install "texfcodec[rivals]"`.
"""

import struct
from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from texfcodec.encoder.encode import Encoder
from texfcodec.encoder.values.map_planes import with_grey
from texfcodec.encoder.values.source_field import colour_planes
from texfcodec.encoder.write import write
from texfcodec.field.morton import encode_morton
from texfcodec.field.samples import surface_samples
from texfcodec.field.transfer import fill_uncoloured
from texfcodec.geometry.areas import sample_surface
from texfcodec.geometry.draco import enc_geometry
from texfcodec.geometry.mesh import face_normals
from texfcodec.geometry.surface import make_surface
from texfcodec.metrics.views import MeshColours
from texfcodec.options import EncodeOptions
from texfcodec.scene.scene import ALPHA_OPAQUE, Material, Scene
from tools.bench.methods import checked_options, method, source_hash, texf, versions_of, voxel_values
from tools.bench.methods.image_codecs import RIVALS
from tools.bench.methods.texf import TexfMethod
from tools.bench.methods.voxel_values import PREPARED

DEFAULTS = {"grid": 128, "steps": 8, "resolution": 1024, "qp": 28, "position_bits": 14, "effort": "balanced"}
RANGES = {"grid": (16, 512), "steps": (2, 60)}
BAND = 1.8  # cells: corners of crossed cells are at most the square root of 3 away
PAD, PROBES, EFFORT = 2, 20_000, 7  # cells around the mesh; points whose inside is looked for; of JPEG XL
HEAD = struct.Struct("<4d3HB")  # corner of the grid and side of a cell, points along the axes, steps
PLACE = struct.Struct("<I")
DISTANCES, FIELD = "distances.bin", "field.bin"
MOST_LOST, LOOK = 0.05, 0.25  # LOOK: cells
SAMPLES_PER_VOXEL_EDGE = 1
WARM_GRID = 16


@method("sdf")
class Sdf(TexfMethod):
    """A signed distance field with colours in voxels. Options, with defaults in DEFAULTS: grid: cells along the longest side;
    steps: per cell of a distance; resolution K, qp and effort of the colours; position_bits of the lattice on which voxels are
    computed, which costs nothing here."""

    options = tuple(DEFAULTS)

    def version(self):
        """The versions of the libraries, and a hash of further files that results depend on."""
        files = (module.__file__ for module in (texf, voxel_values))
        return f"{versions_of('scikit-image', 'libigl', 'imagecodecs')} {super().version()} {source_hash(*files)}"

    def missing(self, options):
        """Return a sentence on the packages of the method that are not installed; None if all are."""
        absent = [name for name in ("igl", "imagecodecs", "skimage") if not find_spec(name)]
        return f"sdf needs {', '.join(absent)}; {RIVALS}" if absent else None

    def warm_up(self, options, threads):
        """Load kernels and libraries by coding a coarse sphere."""
        import tempfile
        from pathlib import Path

        import trimesh

        from texfcodec.report import Report

        checked(options)
        ball = trimesh.creation.icosphere(subdivisions=1)
        few = {"grid": WARM_GRID, "resolution": 4 * WARM_GRID}
        with tempfile.TemporaryDirectory() as folder:
            self.encode(scene_of(ball.vertices, ball.faces), options | few, Path(folder), threads, Report())
            self.decode(Path(folder), options | few, threads, Report())

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into DISTANCES and FIELD. Raises ValueError for an option out of range or a solid thinner than a cell,
        LookupError without an inside."""
        chosen = checked(options)
        if any(m.alpha_mode != ALPHA_OPAQUE for m in scene.materials):
            report.warnings.append("the surface of a solid is opaque: what shines through in the source does not here")
        with report.stage("distances"):
            data, lost = enc_solid(scene, chosen["grid"], chosen["steps"])
        with report.stage("marching cubes"):
            mesh = dec_solid(data)
        settings = settings_of(chosen, threads)
        prepared = Encoder(scene=mesh).filled(settings, report)
        with report.stage("colours"):
            colours = colour_planes(fetched(scene, prepared, threads), prepared.source)
            fields = [prepared.fields[0].with_planes(colours)]
            source = prepared.source._replace(groups=with_grey(prepared.source.groups, fields))
        written = write(replace(prepared, fields=fields, source=source), report)
        field = without_mesh(written.data, prepared.geometry[0]["draco_data"])
        (folder / DISTANCES).write_bytes(data)
        (folder / FIELD).write_bytes(field)
        return {"bytes": {"total": len(data) + len(field), "geometry": len(data), "attributes": written.sizes["attributes"],
                          "other": len(field) - written.sizes["attributes"]},
                "reconstruction_sha256": written.reconstruction_sha256, **chosen, **written.counts, "lost_share": lost,
                "draco_bytes": written.sizes["geometry"]}

    def decode(self, folder, options, threads, report):
        """Return the Texf whose mesh marching cubes extract from DISTANCES and whose colours are in FIELD."""
        from texfcodec.api import decode
        from texfcodec.options import DecodeOptions

        with report.stage("marching cubes"):
            mesh = dec_solid((folder / DISTANCES).read_bytes())
        with report.stage("geometry"):
            data = with_mesh((folder / FIELD).read_bytes(), draco_of(mesh, settings_of(checked(options), threads)))
        return decode(data, DecodeOptions(threads=threads), report)


def checked(options):
    """Return all options with defaults. Raises ValueError with the name of one that is out of range."""
    return checked_options(options, DEFAULTS, RANGES, {})


def settings_of(chosen, threads):
    """Return the EncodeOptions for the colours under these options."""
    kept = {name: chosen[name] for name in ("resolution", "qp", "position_bits", "effort")}
    return EncodeOptions(**PREPARED, partition="off", threads=threads, **kept)


def scene_of(positions, faces):
    """Return a Scene of a mesh with one white opaque material."""
    return Scene(np.asarray(positions, np.float64), np.asarray(faces, np.int64), np.zeros(len(faces), np.int64),
                 np.zeros((len(faces), 3, 2)), None, [Material("solid")], [])


def enc_solid(scene, cells, steps):
    """Return (bytes of a Scene's signed distances on a grid with `cells` cells along the longest side, lost_share() of it).
    steps: per cell. Raises LookupError if it has no inside."""
    low, high = scene.positions[scene.faces].min(axis=(0, 1)), scene.positions[scene.faces].max(axis=(0, 1))
    side = float((high - low).max()) / cells
    if not side > 0:
        raise LookupError("the scene is a single point, which has no inside")
    shape = tuple(int(n) for n in np.ceil((high - low) / side).astype(int) + 1 + 2 * PAD)
    corner = low - PAD * side
    placed = (scene.positions - corner) / side
    lost = lost_share(placed, scene.faces)
    if lost > MOST_LOST:
        raise LookupError(f"{100 * lost:.0f} % of the surface is seen from outside and has no inside behind it: sheets and open "
                         "meshes are no solids, and signed distances cannot hold them")
    values, needed = quantised(signed_distances(placed, scene.faces, shape), steps)
    return HEAD.pack(*corner, side, *shape, steps) + enc_distances(values, needed, steps), lost


def lost_share(positions, faces):
    """Return the share of the surface that has the outside on both sides, tested at PROBES points, LOOK away from it."""
    import igl

    face, bary = sample_surface(positions, faces, PROBES)
    corners = positions[faces[face]]
    points, normals = np.einsum("mk,mkc->mc", bary, corners), face_normals(corners)
    before, behind = (igl.fast_winding_number(np.ascontiguousarray(positions), np.ascontiguousarray(faces),
                                              points + side * LOOK * normals) for side in (1, -1))
    return float(((before < 0.5) & (behind < 0.5)).mean())


def signed_distances(positions, faces, shape):
    """Return signed distances in cells, float64 [X, Y, Z] = shape, negative inside. positions: in grid units."""
    import igl

    points = np.argwhere(np.ones(shape, bool)).astype(np.float64)
    kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    return igl.signed_distance(points, np.ascontiguousarray(positions), np.ascontiguousarray(faces), kind)[0].reshape(shape)


def quantised(distances, steps):
    """Return distances in steps per cell, int64 [X, Y, Z], where n means (n + 1/2) / steps so that no sign is lost, and the
    corners of cells that the surface crosses, bool [X, Y, Z]."""
    most = most_steps(steps)
    values = np.clip(np.floor(distances * steps), -most, most - 1).astype(np.int64)
    inside, mixed = values < 0, np.zeros(values.shape, bool)
    places = [tuple(slice(k, n - 1 + k) for k, n in zip(at, inside.shape, strict=True)) for at in np.ndindex(2, 2, 2)]
    crossed = np.logical_or.reduce([inside[p] for p in places]) & ~np.logical_and.reduce([inside[p] for p in places])
    for place in places:
        mixed[place] |= crossed
    return values, mixed


def most_steps(steps):
    """Return the largest magnitude of a quantised distance: values are in -most..most - 1, so that 256 are enough for RANGES."""
    return int(np.ceil(BAND * steps))


def enc_distances(values, needed, steps):
    """Return the bytes of quantised() values: exact where needed (bool [X, Y, Z]), of the same sign elsewhere."""
    import imagecodecs

    most = most_steps(steps)
    flat = np.where(needed, values, np.where(values < 0, -most, most - 1)) + most
    image = np.ascontiguousarray(flat.transpose(0, 2, 1).reshape(-1, flat.shape[1]), np.uint8)
    return bytes(imagecodecs.jpegxl_encode(image, lossless=True, effort=EFFORT, usecontainer=False))


def dec_distances(data, shape, steps):
    """Return the values int64 [X, Y, Z] = shape of enc_distances()'s bytes."""
    import imagecodecs

    image = imagecodecs.jpegxl_decode(data).reshape(shape[0], shape[2], shape[1])
    return image.transpose(0, 2, 1).astype(np.int64) - most_steps(steps)


def dec_solid(data):
    """Return the Scene that marching cubes extract from enc_solid()'s bytes. Raises ValueError if they have no surface."""
    from skimage.measure import marching_cubes

    *corner, side, x, y, z, steps = HEAD.unpack_from(data)
    values = dec_distances(data[HEAD.size :], (x, y, z), steps)
    if not (values < 0).any():
        raise ValueError("no point of the grid is inside: the solid is thinner than a cell, and a finer grid would be needed")
    positions, faces, _, _ = marching_cubes((values.astype(np.float32) + np.float32(0.5)) / np.float32(steps), 0.0)
    return scene_of(np.array(corner) + side * positions.astype(np.float64), faces)


def draco_of(mesh, settings):
    """Return Draco's bytes of a Scene of one material in one field, as the encoder makes them. settings: EncodeOptions."""
    surface = make_surface(mesh, settings)
    used, local = np.unique(surface.faces, return_inverse=True)
    return enc_geometry(surface.lattice[used], local.reshape(-1, 3), surface.cube.position_bits)


def without_mesh(stream, draco):
    """Return a stream without the Draco bytes of its only geometry unit, and their position."""
    place = stream.index(draco)
    return PLACE.pack(place) + stream[:place] + stream[place + len(draco) :]


def with_mesh(field, draco):
    """Return the whole stream from what without_mesh() returned and the Draco bytes."""
    (place,), rest = PLACE.unpack_from(field), field[PLACE.size :]
    return rest[:place] + draco + rest[place:]


def fetched(scene, prepared, threads):
    """Return the colours of the voxels of Prepared's only field, float32 [N, 4] in 0..255: means of the Scene's surface."""
    surface, part = prepared.surface, prepared.fields[0]
    lattice, faces = prepared.source.surfaces[0]
    corners, colours = surface.cube.to_world(lattice)[faces], MeshColours(scene, threads)
    normals, keys, size = face_normals(corners), part.keys, part.support.size
    sums = np.zeros((len(keys), 5))
    for points, face, bary, share in surface_samples(lattice, faces, surface.cube.position_bits, size, SAMPLES_PER_VOXEL_EDGE):
        key = encode_morton(np.clip(np.floor(points), 0, size - 1).astype(np.int64))
        rank = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        kept = keys[rank] == key
        rank, face, share = rank[kept], face[kept], share[kept]
        colour = colours.query(np.einsum("mk,mkc->mc", bary[kept], corners[face]), normals[face])
        for column in range(4):
            sums[:, column] += np.bincount(rank, share * colour[:, column], len(keys))
        sums[:, 4] += np.bincount(rank, share, len(keys))
    values = (sums[:, :4] / np.maximum(sums[:, 4:], 1e-30)).astype(np.float32)
    fill_uncoloured(keys, values, sums[:, 4])
    return values
