"""Meshes of the gallery that we generate ourselves: a barrel with maps, a windmill that turns, and voxels with a surface."""

import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

BANDS, STAVES, SIDE = (0.16, 0.34, 0.66, 0.84), 18, 1024  # where iron is, along the barrel; planks around it; texels
BARREL = [(0, 0), (0.28, 0), (0.30, 0.04), (0.345, 0.2), (0.37, 0.4), (0.37, 0.5), (0.345, 0.7), (0.30, 0.86), (0.28, 0.9),
          (0.27, 0.87), (0, 0.87)]
TOWER = [(0, 0), (0.34, 0), (0.30, 0.2), (0.26, 0.6), (0.22, 1.0), (0.27, 1.02), (0.16, 1.2), (0, 1.3)]
GRID = 56  # cells along the cube of the voxels


def turned(profile, sides=64, smooth=6):
    """Return (positions [V, 3], UVs [V, 2], faces [F, 3]) of a profile of (radius, height) turned around y."""
    profile = np.asarray(profile, float)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    v = np.unique(np.concatenate([along, np.linspace(0, along[-1], smooth * len(profile))]))
    radius, height = (np.interp(v, along, column) for column in profile.T)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    positions = np.stack([radius[:, None] * np.sin(angle), height[:, None] + 0 * angle, radius[:, None] * np.cos(angle)], axis=2)
    uv = np.stack(np.broadcast_arrays(angle / angle[-1], v[:, None] / v[-1]), axis=2)
    corner = np.arange(len(v) * (sides + 1)).reshape(len(v), -1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3), np.stack([a, c, d], 2).reshape(-1, 3)])
    return positions.reshape(-1, 3), uv.reshape(-1, 2), faces


def planks():
    """Return (colour, normals, roughness with metallic) of planks and iron bands, as glTF has them, uint8 [SIDE, SIDE, 3]."""
    random = np.random.default_rng(63)
    v, u = np.indices((SIDE, SIDE)) / SIDE
    grain = sum(np.asarray(Image.fromarray(random.normal(size=(8 * n, 96 * n)).astype(np.float32)).resize((SIDE, SIDE)))
                for n in (1, 2, 4)) / 3
    plank = np.floor(u * STAVES).astype(int)
    edge = np.minimum(u * STAVES % 1, 1 - u * STAVES % 1)
    band = np.any([abs(v - middle) < 0.028 for middle in BANDS], axis=0)
    rivet = band & ((u * 2 * STAVES % 1 - 0.5) ** 2 + (abs(v[..., None] - BANDS).min(axis=2) * 28) ** 2 < 0.03)
    tint = random.uniform(0.75, 1.15, STAVES)[plank] * (1 + 0.16 * grain) * np.clip(0.35 + edge * 9, 0.35, 1)
    wood = np.array([146, 96, 54]) * tint[..., None]
    iron = np.array([120, 122, 128]) * (1 + 0.05 * grain)[..., None]
    colour = np.where(band[..., None], iron, wood)
    height = np.where(band, 1.2 + 0.8 * rivet, 0.05 * grain + np.clip(edge * 8, 0, 1)) * 4
    normal = np.stack([-np.gradient(height, axis=1), np.gradient(height, axis=0), 3 + 0 * height], axis=2)
    normal = 127.5 + 127.5 * normal / np.linalg.norm(normal, axis=2, keepdims=True)
    packed = np.stack([0 * u, np.where(band, 95 + 12 * grain, 190 + 18 * grain), 255.0 * band], axis=2)
    return [np.clip(np.rint(values), 0, 255).astype(np.uint8) for values in (colour, normal, packed)]


def write_barrel(path):
    """Write a barrel with base colour, normals, roughness and metallic as a GLB."""
    import trimesh

    positions, uv, faces = turned(BARREL)
    colour, normal, packed = map(Image.fromarray, planks())
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=colour, normalTexture=normal, metallicRoughnessTexture=packed,
                                                   metallicFactor=1.0, roughnessFactor=1.0)
    mesh = trimesh.Trimesh(positions, faces, visual=trimesh.visual.TextureVisuals(uv * [1, -1] + [0, 1], material=material),
                           process=False)
    path.write_bytes(mesh.export(file_type="glb", include_normals=True))


def write_windmill(path):
    """Write a tower and four sails, which an animation turns, as a GLB."""
    from mesh_files import Builder

    builder, png = Builder(), io.BytesIO()
    Image.fromarray(planks()[0]).save(png, "PNG")
    material = builder.material(builder.texture(png.getvalue()))
    builder.tree["meshes"] = [{"name": name, "primitives": []} for name in ("tower", "sails")]
    for number, (positions, uv, faces) in enumerate((turned(TOWER), _sails())):
        positions = positions.astype(np.float32)
        builder.primitive(positions, faces.astype(np.uint32), uv.astype(np.float32), mesh=number, material=material)
    builder.tree["nodes"] = [{"mesh": 0, "children": [1]}, {"mesh": 1, "name": "turns", "translation": [0, 1.08, 0.3]}]
    half = np.linspace(0, np.pi, 9)
    turns = builder.accessor(np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1).astype(np.float32))
    times = builder.accessor(np.linspace(0, 6, 9, dtype=np.float32), min=[0.0], max=[6.0])
    builder.tree["animations"] = [{"name": "wind", "samplers": [{"input": times, "output": turns}],
                                   "channels": [{"sampler": 0, "target": {"node": 1, "path": "rotation"}}]}]
    path.write_bytes(builder.glb())


def _sails():
    """Return four boards around z and a nave, as turned() returns a mesh."""
    parts, start = [], 0
    for turn in range(4):
        positions, uv, faces = turned([(0, 0.06), (0.02, 0.07), (0.02, 0.9), (0, 0.91)], 12, 3)
        board = positions * [7, 1, 0.6] + [0.07, 0, 0]
        angle = np.pi / 2 * turn
        c, s = np.cos(angle), np.sin(angle)
        parts.append((board @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), uv, faces + start))
        start += len(positions)
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def write_voxels(path):
    """Write a ball of tunnels as arrays: a surface of many faces, the voxels that it touches, and their colour and roughness."""
    from skimage.measure import marching_cubes

    place = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, GRID + 1)] * 3, indexing="ij"), axis=3)
    x, y, z = np.moveaxis(place * 17, 3, 0)
    tunnels = abs(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)) - 0.55
    values = np.logaddexp(2.5 * tunnels, 50 * (np.linalg.norm(place, axis=3) - 0.45)) / 50  # a round maximum
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="ascent")
    cells = np.stack([values[i:GRID + i, j:GRID + j, k:GRID + k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    voxels = np.argwhere((cells.min(axis=0) <= 0) & (cells.max(axis=0) >= 0))
    middle = (voxels + 0.5) / GRID - 0.5
    radius = np.linalg.norm(middle, axis=1) / 0.45
    hue = np.stack([0.5 + 0.45 * np.sin(6 * radius + 5 * middle[:, 1] + shift) for shift in (0, 1.7, 3.6)], axis=1)
    colour = hue * np.clip(0.3 + 0.7 * radius[:, None] ** 2, 0, 1)
    np.savez_compressed(path, vertices=vertices / GRID - 0.5, faces=faces, voxels=voxels, resolution=GRID,
                        roughness=np.clip(1.1 - radius, 0.25, 1), base_color=colour)
