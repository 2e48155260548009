"""Small meshes and scenes made by code, for every test that needs one."""

from dataclasses import replace

import numpy as np

from texfcodec.scene.scene import ALPHA_BLEND, Material, Scene, Texture


def scene_of(positions, faces, colours=None, metadata=None, materials=None, face_material=None):
    """Scene without textures. colours: None (one brown material), or linear RGBA per vertex [V, 4]."""
    positions, faces = np.asarray(positions, np.float64).reshape(-1, 3), np.asarray(faces, np.int64).reshape(-1, 3)
    materials = materials or [Material("skin", factor=np.ones(4) if colours is not None else np.array([0.5, 0.2, 0.1, 1.0]))]
    corner = None if colours is None else np.asarray(colours, np.float32)[faces]
    face_material = np.zeros(len(faces), np.int64) if face_material is None else np.asarray(face_material)
    return Scene(positions, faces, face_material, np.zeros((len(faces), 3, 2)), corner, materials, [], metadata=metadata or {})


def square(z=0.5, side=1.0):
    """Two triangles: (positions [4, 3], faces [2, 3])."""
    return np.array([[0, 0, z], [side, 0, z], [side, side, z], [0, side, z]], np.float64), np.array([[0, 1, 2], [0, 2, 3]])


def sphere(rows=8):
    """Closed welded sphere of radius 1: (positions, faces)."""
    u, v = np.linspace(0, np.pi, rows + 1)[1:-1], np.arange(2 * rows) * np.pi / rows
    ring = np.stack([np.outer(np.sin(u), np.cos(v)), np.outer(np.sin(u), np.sin(v)), np.outer(np.cos(u), np.ones(2 * rows))], -1)
    positions = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    n, faces = 2 * rows, []
    for j in range(n):
        k = (j + 1) % n
        faces.append((len(positions) - 2, j, k))
        faces.append((len(positions) - 1, (rows - 2) * n + k, (rows - 2) * n + j))
        for i in range(rows - 2):
            a, b, c, d = i * n + j, i * n + k, (i + 1) * n + k, (i + 1) * n + j
            faces += [(a, c, b), (a, d, c)]
    return positions, np.array(faces)


def painted_sphere(rows=8, seed=0):
    """Sphere with smooth random vertex colours."""
    positions, faces = sphere(rows)
    waves = np.random.default_rng(seed).normal(0, 2, (3, 4))
    return scene_of(positions, faces, 0.5 + 0.45 * np.sin(positions @ waves))


def crossing_sheets():
    """Two textured sheets that cross, one of them see-through, with names and metadata: two materials, colour and alpha."""
    side = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    image = np.random.default_rng(0).integers(0, 256, (16, 16, 4), np.uint8)
    return Scene(
        positions=np.concatenate([np.insert(side, 2, 0.5, axis=1), np.insert(side, 0, 0.5, axis=1)]),
        faces=np.concatenate([faces, faces + 4]), face_material=np.array([0, 0, 1, 1]),
        corner_uv=np.concatenate([side[faces], side[faces]]), corner_color=None,
        materials=[Material("stone", texture=0), Material("glass", texture=0, alpha_mode=ALPHA_BLEND)], textures=[Texture(image)],
        metadata={"copyright": "none"},
    )


def shuffled(scene, seed):
    """The same surface with other face order, vertex order, start corners and orientation of the faces."""
    rng = np.random.default_rng(seed)
    order, place = rng.permutation(len(scene.faces)), rng.permutation(len(scene.positions))
    positions = np.empty_like(scene.positions)
    positions[place] = scene.positions
    corners = np.array([rng.permutation(3) for _ in order])
    pick = lambda a: None if a is None else np.take_along_axis(
        a[order], corners.reshape(corners.shape + (1,) * (a.ndim - 2)), axis=1)
    return Scene(positions, place[pick(scene.faces)], scene.face_material[order], pick(scene.corner_uv), pick(scene.corner_color),
                 scene.materials, scene.textures, scene.metadata)


def triangles_of(texf):
    """All triangles as sorted rows (material, three sorted lattice corners): what may not depend on Draco's order."""
    packed = texf.lattice_positions @ np.array([1, 1 << 20, 1 << 40])
    corners = np.sort(packed[texf.faces], axis=1)
    rows = np.column_stack([texf.face_material, corners])
    return rows[np.lexsort(rows.T[::-1])]


def hand(rings=64, fingers=((0.0, 0.15), (0.35, 0.08), (0.7, 0.05), (1.05, 0.08), (1.9, 0.2))):
    """A smooth closed model with five fingers, without texture: (positions [V, 3], faces [F, 3], unit normals [V, 3]).

    A ball that bulges towards each of the fingers, (angle in the palm's plane, lift out of it); the normals are exact.
    """
    directions, faces = sphere(rings)
    angles, lift = np.array(fingers).T
    towards = np.stack([np.cos(angles), np.sin(angles), lift], axis=1)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    bulges = 1.6 * np.exp(28.0 * (directions @ towards.T - 1.0))
    radius = 1.0 + bulges.sum(axis=1)
    # f(x) = |x| - r(x / |x|): its gradient is d - (slope of r along the ball) / r
    slope = 28.0 * bulges @ towards
    along = slope - (slope * directions).sum(axis=1, keepdims=True) * directions
    normals = directions - along / radius[:, None]
    return directions * radius[:, None], faces, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def noise(seed, height=32, width=32):
    """An image of random texels, uint8 [height, width, 4], opaque."""
    image = np.random.default_rng(seed).integers(0, 256, (height, width, 4), np.uint8)
    image[..., 3] = 255
    return image


def mapped_sheet(maps, colour=None, cells=4, wrap=(0, 0), span=1.0, **material):
    """A wavy sheet over the unit square, UVs 0..span, whose one material has an image of its base colour (noise) and the images
    maps, uint8 [h, w, 4] by channel name. material: more of its fields."""
    line = np.linspace(0, 1, cells + 1)
    x, y = (a.ravel() for a in np.meshgrid(line, line))
    positions = np.stack([x, y, 0.05 * np.sin(5 * x) * np.cos(4 * y)], axis=1)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + cells + 2], 1), np.stack([a, a + cells + 2, a + cells + 1], 1)])
    images = [noise(0) if colour is None else colour, *maps.values()]
    whole = {"texture": 0, "maps": {name: i for i, name in enumerate(maps, 1)}} | material
    return Scene(positions=positions, faces=faces, face_material=np.zeros(len(faces), np.int64),
                 corner_uv=span * np.stack([x, 1 - y], axis=1)[faces], corner_color=None, materials=[Material("sheet", **whole)],
                 textures=[Texture(image, wrap, f"image {i}") for i, image in enumerate(images)])


def domed(scene):
    """A Scene on the unit square, bent into a dome."""
    x, y, _ = scene.positions.T
    return replace(scene, positions=np.column_stack([x, y, 0.4 - 0.8 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)]))


def plain_image(*values, size=8):
    """An image of one colour, uint8 [size, size, 4]; one value counts for red, green and blue."""
    values = values if len(values) > 1 else values * 3
    return np.broadcast_to(np.array([*values, 255][:4], np.uint8), (size, size, 4)).copy()


def linear(levels: tuple) -> list[float]:
    """The factor of sRGB levels and an alpha of 0..255."""
    share = np.array(levels) / 255.0
    rgb = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return [*rgb[:3].tolist(), float(share[3])]
