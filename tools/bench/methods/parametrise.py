"""A new parametrisation of a scene for rivals that code images, by UVAtlas or xatlas, and the source's colours in it.

Both run in a process of their own, because their native code may crash or hang, on the mesh that the rival's decoder has:
positions on the lattice, equal ones merged, as Draco gives it back. Draco splits vertices where the surface is no manifold, which
UVAtlas needs: on other meshes it refuses or crashes. Colours are those whose bilinear picture is closest to the source's (bake):
least squares over four points a texel and more along chart borders. Texels off the charts go on over the borders for two texels
and are then filled with the means of what is known around them, so that blocks of codecs see no edges there.
"""

import hashlib
import importlib.util
import io
import math
import os
import shutil
import subprocess
import sys
import time
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import texfcodec
from texfcodec.core import cleanup
from texfcodec.geometry.surface import make_surface
from texfcodec.io.atlas.bake import bake
from texfcodec.io.atlas.quality import QualityFailed, run_xatlas
from texfcodec.io.atlas.unwrap import Atlas
from texfcodec.options import EncodeOptions
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, Material, Scene, Texture
from tools.bench.methods import versions_of
from tools.bench.methods.draco_mesh import enc_mesh
from tools.bench.methods.image_codecs import RIVALS

SOURCE_UVS, PARAMETRISATIONS = "source", ("source", "uvatlas", "xatlas")
POSITION_BITS = 14
SECONDS = 1800.0
PADDING = 4  # texels between charts, as io/atlas/quality.py asks xatlas for
LEAST_SIDE, MOST_SIDE = 16, 16384
NOT_LOADED = 3  # status of the child process
_CHILD = "from tools.bench.methods.parametrise import _child; _child()"


class NoAtlas(Exception):
    """A parametrisation could not be made; the message is a sentence that says why."""


class Request(NamedTuple):
    """A new parametrisation. parametrisation: "uvatlas" or "xatlas"; side: of the square image in texels; seconds: time limit of
    the child process."""

    parametrisation: str
    side: int
    seconds: float = SECONDS


def missing(parametrisation):
    """Return a sentence on what a parametrisation needs that is not installed, and how to get it; None if nothing is missing."""
    if parametrisation == "uvatlas" and importlib.util.find_spec("open3d") is None:  # to import it takes seconds
        return f"uvatlas needs open3d; {RIVALS}"
    return None


def versions():
    """What new parametrisations depend on, in words."""
    return versions_of("open3d", "xatlas", "DracoPy")


def used_texels(scene):
    """Return the number of texels of the base-colour images that faces use, each once. Raises LookupError without a texture."""
    used = {scene.materials[m].texture for m in np.unique(scene.face_material)} - {-1}
    if not used:
        raise LookupError("no texture: no face has a base-colour image, and UV rivals code no vertex colours")
    images = {(i.shape, i.tobytes()) for i in (scene.textures[t].image for t in used)}
    return sum(shape[0] * shape[1] for shape, _ in images)


def side_of(scene):
    """Return the even side in texels of a square atlas with as many texels as the images that faces use."""
    return int(np.clip(2 * round(math.sqrt(used_texels(scene)) / 2), LEAST_SIDE, MOST_SIDE))


def reparametrised(scene, request, keep, threads=1):
    """Return (the Scene with new UVs and its base colour, factors and vertex colours included, in one image; the seconds taken).

    keep: folder of atlases for further jobs of the same asset, because UVAtlas takes long and differs each time, while rate
    points of a curve should differ in rate alone. Geometry is that on the lattice of POSITION_BITS; alpha modes and sides of
    materials stay, maps do not. Raises NoAtlas, LookupError.
    """
    if sentence := missing(request.parametrisation):
        raise LookupError(sentence)
    surface = make_surface(scene, EncodeOptions(position_bits=POSITION_BITS))
    materials, number = _plain_materials(scene)
    placed = Scene(surface.cube.to_world(surface.lattice), surface.faces, number[surface.material],
                   np.zeros((len(surface.faces), 3, 2)), None, materials, [])

    def make():
        begin = time.perf_counter()
        corner_uv = new_uv(surface.lattice, surface.faces, request)
        shown = _Source(placed, scene, surface.origin_face, threads)
        baked = bake(shown, atlas=Atlas(corner_uv, request.side, request.side, request.parametrisation, 0.0))
        return {"corner_uv": corner_uv, "image": baked.image, "seconds": time.perf_counter() - begin}

    atlas = _kept(keep / f"atlas-{_key(scene, request)}.npz", make)
    textures = [Texture(atlas["image"], (WRAP_CLAMP, WRAP_CLAMP), request.parametrisation)]
    return replace(placed, corner_uv=atlas["corner_uv"], textures=textures), round(float(atlas["seconds"]), 6)


def _kept(path, make):
    """What make() gives, a dict of arrays, from a file where an earlier call has left it. Of two that make it at a time, both
    take what was first there."""
    if not path.exists():
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        with open(part, "wb") as file:
            np.savez_compressed(file, **make())
        try:
            os.link(part, path)
        except FileExistsError:
            pass
        except OSError:  # a file system without links
            shutil.copyfile(part, path)
        part.unlink()
    with np.load(path) as file:
        return dict(file)


def _key(scene, request):
    """16 digits over all that an atlas depends on."""
    total = hashlib.sha256(repr((request.parametrisation, request.side, versions(), texfcodec.__version__)).encode())
    total.update(Path(__file__).read_bytes())
    used = np.unique(scene.face_material)
    total.update(repr([(m, scene.materials[m]) for m in used]).encode())
    for values in (scene.positions, scene.faces, scene.face_material, scene.corner_uv, scene.corner_color,
                   *(t.image for t in scene.textures)):
        total.update(b"" if values is None else np.ascontiguousarray(values))
    return total.hexdigest()[:16]


def new_uv(lattice, faces, request):
    """Return new UVs of a mesh, float64 [F, 3, 2] in 0..1. lattice: distinct positions int64 [V, 3] of POSITION_BITS; faces:
    int64 [F, 3]. Raises NoAtlas with the reason."""
    points, decoded = draco_mesh(enc_mesh(lattice, faces))
    face, turn = matched(lattice[faces], points[decoded])
    unit = points / (1 << POSITION_BITS)
    uv = _UNWRAP[request.parametrisation](unit, decoded, request.side, request.seconds)
    if uv.shape != (len(faces), 3, 2) or not np.isfinite(uv).all():
        raise NoAtlas(f"{request.parametrisation} gave UVs that are no numbers")
    uv, out = np.clip(uv, 0, 1), np.empty((len(faces), 3, 2))
    out[face[:, None], (np.arange(3) + turn[:, None]) % 3] = uv
    return out


def draco_mesh(data):
    """Return (lattice points int64 [V, 3], faces int64 [F, 3]) of Draco bytes; vertices that Draco has split stay split."""
    import DracoPy

    mesh = DracoPy.decode(data)
    return np.asarray(mesh.points).astype(np.int64), np.asarray(mesh.faces, np.int64)


def matched(source, decoded):
    """Return each decoded face's source face, int64 [F], and rotation turn, int64 [F]: its corner k is the source's (k + turn) %
    3.

    source, decoded: int64 [F, 3, C], the same faces in another order and rotation, columns of positions or of more. Among
    identical faces any may be chosen. Raises ValueError if the faces differ.
    """
    if source.shape != decoded.shape:
        raise ValueError(f"Draco gave {len(decoded)} faces back in place of {len(source)}")
    corners, number = np.unique(np.concatenate([source, decoded]).reshape(-1, source.shape[2]), axis=0, return_inverse=True)
    key = number.reshape(-1, 3)
    first = key.argmin(axis=1)
    key = np.take_along_axis(key, (np.arange(3) + first[:, None]) % 3, axis=1)
    count = len(source)
    ours, theirs = np.lexsort(key[:count].T), np.lexsort(key[count:].T)
    if (key[:count][ours] != key[count:][theirs]).any():
        raise ValueError("Draco gave other faces back")
    face = np.empty(count, np.int64)
    face[theirs] = ours
    return face, (first[:count][face] - first[count:]) % 3


def _plain_materials(scene):
    """(Materials that show an image as it is, number of its new one by material of the scene): alike ones become one."""
    kinds = [(m.alpha_mode, m.alpha_cutoff if m.alpha_mode != ALPHA_OPAQUE else 0.5, m.double_sided, m.unlit)
             for m in scene.materials]
    kept = list(dict.fromkeys(kinds))
    materials = [Material("atlas", texture=0, alpha_mode=mode, alpha_cutoff=cutoff, double_sided=double, unlit=unlit)
                 for mode, cutoff, double, unlit in kept]
    return materials, np.array([kept.index(kind) for kind in kinds], np.int64)


@dataclass
class _Source:
    """What bake() asks of a decoded field, answered by the source. placed: Scene on the lattice; origin: source face by face."""

    placed: Scene
    source: Scene
    origin: np.ndarray
    threads: int

    def __post_init__(self):
        for name in ("positions", "faces", "face_material", "materials"):
            setattr(self, name, getattr(self.placed, name))
        self._packed = pack_source(self.source)
        self.has_alpha = any(m.alpha_mode != ALPHA_OPAQUE for m in (self.source.materials[i]
                                                                    for i in np.unique(self.source.face_material)))

    def query(self, points, face):
        """Colours float32 [M, 4] of points float64 [M, 3] on faces int64 [M]."""
        bary = barycentric(points, self.positions[self.faces[face]])
        return sample_source(self._packed, self.origin[face], bary, self.threads)


def barycentric(points, corners):
    """Return barycentric weights float64 [M, 3], each 0..1, of points [M, 3] on triangles [M, 3, 3]; (1, 0, 0) without area."""
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(u, v)
    area = (normal * normal).sum(axis=1)
    safe = np.where(area > 0, area, 1)
    second, third = ((np.cross(a, b) * normal).sum(axis=1) / safe for a, b in ((w, v), (u, w)))
    bary = np.clip(np.column_stack([1 - second - third, second, third]), 0, 1)
    bary[area <= 0] = 1, 0, 0
    return bary / bary.sum(axis=1, keepdims=True)


# The programs.


def _by_xatlas(points, faces, side, seconds):
    try:
        ((flat, _, canvas),) = run_xatlas([(points, faces)], side, seconds)
    except QualityFailed as reason:
        raise NoAtlas(f"xatlas made no atlas: {reason}") from None
    return flat / float(canvas.max())


def _by_uvatlas(points, faces, side, seconds):
    """open3d's UVAtlas in a child process."""
    request = io.BytesIO()
    np.savez(request, points=points.astype(np.float32), faces=faces, side=side)
    here = str(Path(__file__).resolve().parents[3])
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([here, *(p for p in sys.path if p)]))
    try:
        done = cleanup.run_child([sys.executable, "-c", _CHILD], request.getvalue(), seconds, environment)
        said = (done.stderr.decode(errors="replace").strip().splitlines() or ["it said nothing"])[-1].strip()
        if done.returncode == NOT_LOADED:
            raise LookupError(f"uvatlas needs open3d, which cannot be loaded (it wants libusb-1.0 and libGL): {said}")
        if done.returncode:
            raise NoAtlas(f"UVAtlas ended with status {done.returncode} on {len(faces)} faces, as it does where they are no "
                          f"manifold: {said}")
        with np.load(io.BytesIO(done.stdout)) as reply:
            return reply["uv"].astype(np.float64)
    except subprocess.TimeoutExpired:
        raise NoAtlas(f"UVAtlas took more than {seconds:g} s for {len(faces)} faces") from None
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise NoAtlas(f"UVAtlas could not be run ({type(error).__name__}: {error})") from None


def _child():
    """Entry point of the child process: an npz request on stdin, an npz reply on stdout."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever native code prints must not reach the reply
    try:
        import open3d
    except (ImportError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(NOT_LOADED)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as request:
        points, faces, side = request["points"], request["faces"], int(request["side"])
    mesh = open3d.t.geometry.TriangleMesh(open3d.core.Tensor(points), open3d.core.Tensor(faces))
    mesh.compute_uvatlas(size=side, gutter=float(PADDING))
    reply = io.BytesIO()
    np.savez(reply, uv=mesh.triangle["texture_uvs"].numpy())
    replies.write(reply.getvalue())
    replies.flush()


_UNWRAP = {"uvatlas": _by_uvatlas, "xatlas": _by_xatlas}
