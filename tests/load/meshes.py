"""Meshes of any number of faces as GLB, for tests/load: a scan with an image or with vertex colours, and inputs that are
hard for an encoder. All are made by code from the number of faces; the same number gives the same bytes."""

from io import BytesIO
from typing import NamedTuple

import numpy as np

from texfcodec.io.gltf.packing import ARRAY, INDEX
from texfcodec.io.gltf.writer import Document, glb

IMAGE_SIDE = 4096  # of the scan's image at most, in texels; smaller meshes have as many texels a face, down to the least
LEAST_SIDE, TEXELS_PER_FACE = 256, 12


class FaceMesh(NamedTuple):
    """positions: float64 [V, 3]; faces: int64 [F, 3]; colours: float64 [V, 3] in 0..1, linear, or None; uv: float64 [V, 2] or
    None; image: uint8 [H, W, 3] or None."""

    positions: np.ndarray
    faces: np.ndarray
    colours: np.ndarray | None = None
    uv: np.ndarray | None = None
    image: np.ndarray | None = None


def _grid_faces(rows, columns):
    """int64 [2 * rows * columns, 3]: two faces for each cell of a grid of (rows + 1) * (columns + 1) vertices."""
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    return np.stack([a, a + columns + 1, a + columns + 2, a, a + columns + 2, a + 1], 1).reshape(-1, 3)


def _colours(positions):
    """Waves over space, float64 [V, 3]."""
    waves = np.random.default_rng(0).normal(0, 4, (3, 3))
    return 0.5 + 0.45 * np.sin(positions @ waves)


def _image(side):
    """Waves and noise, uint8 [side, side, 3]."""
    x, image = np.arange(side) * (12 / side), np.empty((side, side, 3), np.uint8)
    for c in range(3):
        wave = 128 + 70 * np.outer(np.cos(x * (c + 1)), np.sin(x + c))
        image[..., c] = np.clip(wave + np.random.default_rng(c).normal(0, 6, (side, side)), 0, 255)
    return image


def _bumpy_cube_sphere(count):
    """(positions, faces, uv) of a closed bumpy sphere: six charts, whose border vertices stand at the same places."""
    n = max(int(np.sqrt(count / 12)), 1)
    s, t = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    sides = []
    for axis in range(3):
        for sign in (1, -1):
            p = np.empty((n + 1, n + 1, 3))
            p[..., axis], p[..., (axis + 1) % 3], p[..., (axis + 2) % 3] = sign, sign * s, t
            sides.append(p.reshape(-1, 3))
    p = np.concatenate(sides)
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    bumps = sum(np.sin(p @ direction) / length for direction, length in _bump_waves())
    positions = p * (1 + bumps)[:, None]
    unit = np.stack([s, t], -1).reshape(-1, 2) * 0.49 + 0.5
    uv = np.concatenate([(unit + [k % 3, k // 3]) / [3, 2] for k in range(6)])
    faces = _grid_faces(n, n)
    return positions, np.concatenate([faces + k * (n + 1) ** 2 for k in range(6)]), uv


def _bump_waves():
    directions = np.random.default_rng(1).normal(0, 1, (24, 3))
    for k, direction in enumerate(directions):
        length = 3 * 1.25**k
        yield direction * length / np.linalg.norm(direction), 4 * length


def scan_with_image(count, side=None):
    """A closed bumpy sphere in six charts with an image. side: texels, where not as many a face as usual."""
    positions, faces, uv = _bumpy_cube_sphere(count)
    side = side or int(2 ** np.floor(np.log2(np.clip(np.sqrt(TEXELS_PER_FACE * count), LEAST_SIDE, IMAGE_SIDE))))
    return FaceMesh(positions, faces, uv=uv, image=_image(side))


def scan_with_vertex_colours(count):
    """The same surface with colours of its vertices, which the charts do not share."""
    positions, faces, _ = _bumpy_cube_sphere(count)
    return FaceMesh(positions, faces, _colours(positions))


def slivers(count):
    """A sheet with bumps whose faces are some 100 times as long as wide."""
    columns = max(int(np.sqrt(count / 2) / 10), 1)
    rows = max(count // (2 * columns), 1)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij"))
    positions = np.stack([x, y, 0.1 * np.sin(9 * x) * np.cos(7 * y)], 1)
    return FaceMesh(positions, _grid_faces(rows, columns), _colours(positions))


def one_hub(count):
    """A disc with a jagged rim, all of whose faces share the vertex in the middle."""
    angle = np.arange(count) * 2 * np.pi / count
    radius = 0.5 + np.random.default_rng(0).uniform(0, 0.5, count)
    positions = np.concatenate([np.zeros((1, 3)), np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], 1)])
    k = np.arange(count)
    return FaceMesh(positions, np.stack([0 * k, 1 + k, 1 + (k + 1) % count], 1), _colours(positions))


CUBE_FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                       [0, 6, 4], [1, 5, 7], [1, 7, 3]])


def overlapping_components(count):
    """Boxes of twelve faces anywhere in a cube, of a tenth of its side, each with a colour: 120,000 faces are 10,000 boxes."""
    boxes, rng = max(count // 12, 1), np.random.default_rng(0)
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    positions = rng.uniform(0, 0.9, (boxes, 1, 3)) + corner * rng.uniform(0.05, 0.1, (boxes, 1, 3))
    faces = CUBE_FACES + 8 * np.arange(boxes)[:, None, None]
    return FaceMesh(positions.reshape(-1, 3), faces.reshape(-1, 3), np.repeat(rng.uniform(0, 1, (boxes, 3)), 8, axis=0))


def lone_triangles(count):
    """Triangles anywhere near a sphere that share no vertex, each of two mean distances' length."""
    rng = np.random.default_rng(0)
    centre = rng.normal(0, 1, (count, 1, 3))
    centre *= (1 + rng.normal(0, 0.01, (count, 1, 1))) / np.linalg.norm(centre, axis=2, keepdims=True)
    positions = (centre + rng.normal(0, 2 / np.sqrt(count), (count, 3, 3))).reshape(-1, 3)
    return FaceMesh(positions, np.arange(3 * count).reshape(-1, 3), _colours(positions))


def one_scroll(count):
    """One component: a sheet rolled up four times, with nothing but a hundredth of its length between the layers."""
    n = max(int(np.sqrt(count / 2)), 1)
    s, t = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij"))
    radius, angle = 0.3 + 0.04 * s + 0.002 * np.sin(40 * t), 8 * np.pi * s
    positions = np.stack([radius * np.cos(angle), radius * np.sin(angle), t], 1)
    return FaceMesh(positions, _grid_faces(n, n), _colours(positions))


GENERATORS = {function.__name__.replace("_", " "): function for function in
              (scan_with_image, scan_with_vertex_colours, slivers, one_hub, overlapping_components, lone_triangles, one_scroll)}


def _png(image):
    from PIL import Image

    file = BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=1)
    return file.getvalue()


def glb_of(mesh: FaceMesh) -> bytes:
    """The GLB of a FaceMesh: one primitive, one material without metal."""
    document, material = Document({}), {"pbrMetallicRoughness": {"metallicFactor": 0}}
    attributes = {"POSITION": document.add_accessor(mesh.positions.astype("<f4"), "VEC3", ARRAY, bounds=True)}
    if mesh.colours is not None:
        attributes["COLOR_0"] = document.add_accessor(mesh.colours.astype("<f4"), "VEC3", ARRAY)
    if mesh.image is not None:
        attributes["TEXCOORD_0"] = document.add_accessor(mesh.uv.astype("<f4"), "VEC2", ARRAY)
        image = document.add("images", {"bufferView": document.add_view(_png(mesh.image)), "mimeType": "image/png"})
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": document.add("textures", {"source": image})}
    indices = document.add_accessor(mesh.faces.reshape(-1).astype("<u4"), "SCALAR", INDEX)
    primitive = {"attributes": attributes, "indices": indices, "material": document.add("materials", material)}
    document.add_mesh([primitive], None, None)
    return b"".join(glb(document))
