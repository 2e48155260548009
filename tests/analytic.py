"""A stand-in for a decoded stream whose field is an analytic colour, and the meshes that it stands on."""

from types import SimpleNamespace

import numpy as np

from texfcodec.geometry.shading_normals import corner_normals
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, Material


def grid_mesh(n=24, height=0.0):
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    points = np.stack([u, v, height * np.sin(7 * u) * np.cos(5 * v)], -1).reshape(-1, 3)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return points, np.vstack([np.stack([a, a + n, a + 1], 1), np.stack([a + 1, a + n, a + n + 1], 1)])


def sphere_mesh(n=32):
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, n), np.linspace(0, np.pi, n), indexing="ij")
    points = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1).reshape(-1, 3)
    return points, grid_mesh(n)[1]


def soup_mesh(count=3000, seed=1):
    rng = np.random.default_rng(seed)
    points = rng.random((count, 1, 3)) + rng.normal(size=(count, 3, 3)) * 0.02
    return points.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def decoded(positions, faces, **changes):
    """A stand-in for Texf: lattice-exact geometry and a smooth analytic field."""
    positions, faces = np.asarray(positions, np.float64), np.asarray(faces, np.int64)
    origin = positions.min(0) if len(positions) else np.zeros(3)
    side = float((positions - origin).max()) if len(positions) else 0.0
    lattice = np.rint((positions - origin) / (side or 1.0) * 16383).astype(np.int64)
    texf = SimpleNamespace(
        threads=1,
        positions=origin + side * (lattice / 16383), lattice_positions=lattice, faces=faces, origin=origin, side=side,
        position_bits=14, resolution=200, has_alpha=False, metadata={"title": "härtetest"}, materials=[Material("clay")],
        face_material=np.zeros(len(faces), np.int64), face_field=np.zeros(len(faces), np.int64), evaluators=None,
        fields=[SimpleNamespace(over_texels=False, planes={}, steps={},
                                support=SimpleNamespace(planar=False, resolution=200, level_shift=0))],
    )  # fmt: skip
    texf.query = lambda points, face_index=None: smooth_colour((points - texf.origin) / (texf.side or 1.0))
    texf.voxels = lambda centers=True: voxel_arrays(texf)
    texf.shading_normals = lambda: corner_normals(texf.lattice_positions, texf.faces)
    for name, value in changes.items():
        setattr(texf, name, value)
    return texf


def smooth_colour(unit):
    colour = 127.5 + 100 * np.sin(unit @ np.array([[9.0, 2, 4], [3, 8, 5], [6, 7, 3]]))
    return np.hstack([colour, np.full((len(unit), 1), 255.0)]).astype(np.float32)


def voxel_arrays(texf, count=500):
    count = count if len(texf.faces) else 0
    unit = np.random.default_rng(3).random((count, 3))
    rgba = np.rint(smooth_colour(unit)).astype(np.uint8)
    center = texf.origin + texf.side * unit
    return {"xyz": (unit * 200).astype(np.int32), "field": np.zeros(count, np.int32), "rgba": rgba, "center": center}


def two_materials(texf):
    texf.materials = [Material("a b", alpha_mode=ALPHA_MASK, alpha_cutoff=0.25, double_sided=True), Material("漢", unlit=True)]
    texf.materials.append(Material("unused", alpha_mode=ALPHA_BLEND))
    texf.face_material = np.arange(len(texf.faces), dtype=np.int64) % 2
    return texf


def surface_samples(texf, uv, count=20000, on_edges=False):
    """Area-weighted random surface points: (world points, uv, face)."""
    rng = np.random.default_rng(5)
    corner = texf.positions[texf.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / texf.side**2, axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    weight = rng.dirichlet([1, 1, 1], count)
    if on_edges:
        weight[:, 2] = 0
        weight /= weight.sum(1, keepdims=True)
    return (corner[face] * weight[..., None]).sum(1), (uv[face] * weight[..., None]).sum(1), face


def empty_mesh():
    return np.zeros((0, 3)), np.zeros((0, 3), np.int64)


def bilinear(image, uv):
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - top)[:, None]

    def texel(dx, dy):
        return image[np.clip(top + dy, 0, height - 1), np.clip(left + dx, 0, width - 1)].astype(float)

    return (texel(0, 0) * (1 - fx) + texel(1, 0) * fx) * (1 - fy) + (texel(0, 1) * (1 - fx) + texel(1, 1) * fx) * fy


def surface(texf):
    corner = texf.positions[texf.faces]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum() / 2
