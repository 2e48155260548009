"""The scenes of the conformance vectors."""

import numpy as np

from texfcodec.scene.scene import Material, Scene, Texture

# Shapes: positions float64 [V, 3], faces int64 [F, 3], linear RGBA by vertex float32 [V, 4].


def torus(around=16, across=8, thickness=0.4):
    """A torus of radius 1 with smooth colours."""
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    radius = 1 + thickness * np.cos(v)
    positions = np.stack([radius * np.cos(u), radius * np.sin(u), thickness * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    at = lambda di, dj: ((i + di) % around * across + (j + dj) % across).reshape(-1)
    a, b, c, d = at(0, 0), at(1, 0), at(1, 1), at(0, 1)
    colours = np.stack([0.5 + 0.5 * np.cos(u), 0.5 + 0.4 * np.sin(2 * u + v), 0.5 + 0.3 * np.cos(v), 0.5 + 0.5 * np.sin(v)], -1)
    return positions, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), colours.reshape(-1, 4).astype(np.float32)


def ribbon(steps=48, turns=3, width=0.03):
    """A narrow band that winds upwards: few voxels at a high resolution."""
    angle = np.linspace(0, 2 * np.pi * turns, steps + 1)
    line = np.stack([np.cos(angle), np.sin(angle), np.linspace(0, 2, steps + 1)], 1)
    positions = np.stack([line, line + [0, 0, width]], 1).reshape(-1, 3)
    a = 2 * np.arange(steps)
    faces = np.concatenate([np.stack([a, a + 2, a + 3], 1), np.stack([a, a + 3, a + 1], 1)])
    colours = np.stack([0.5 + 0.5 * np.sin(k * np.repeat(angle, 2)) for k in (1, 2, 5)] + [np.ones(2 * steps + 2)], 1)
    return positions, faces, colours.astype(np.float32)


def scene_of(positions, faces, colours, materials=None, face_material=None, metadata=None):
    """Scene of vertex colours; the colours' alpha counts where a material is not opaque."""
    face_material = np.zeros(len(faces), np.int64) if face_material is None else face_material
    return Scene(positions, faces, face_material, np.zeros((len(faces), 3, 2)), colours[faces], materials or [Material("skin")],
                 [], metadata=metadata or {})


def noise_sheet():
    """A square with a texture of noise that goes from end to end of the range."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    image = np.random.default_rng(7).choice(np.array([0, 255], np.uint8), (24, 24, 4))
    positions = np.column_stack([corners, corners @ [0.3, 0.6]])
    return Scene(positions, faces, np.zeros(2, np.int64), corners[faces], None, [Material("noise", texture=0)], [Texture(image)])


def two_sheets():
    """Two parallel squares close together, one per material: two fields."""
    positions, faces, colours = torus(12, 6)
    inner = positions * 0.93
    face_material = np.repeat([0, 1], len(faces))
    materials = [Material("outside"), Material("inside", double_sided=True)]
    return scene_of(np.concatenate([positions, inner]), np.concatenate([faces, faces + len(positions)]),
                    np.concatenate([colours, 1 - colours]), materials, face_material)


def many_materials():
    """Five materials in one field; names beyond ASCII, an empty one, both flags."""
    positions, faces, colours = torus(15, 8)
    materials = [Material("Holz"), Material("Glasur ü", double_sided=True), Material("釉", unlit=True), Material(""),
                 Material("both", double_sided=True, unlit=True)]
    return scene_of(positions, faces, colours, materials, np.arange(len(faces)) * 5 // len(faces))


def triangle():
    """One triangle."""
    positions = np.array([[0.1, 0.2, 0.0], [1.3, 0.4, 0.6], [0.5, 1.5, 0.9]])
    return positions, np.array([[0, 1, 2]]), np.array([[1, 0.1, 0, 1], [0, 0.8, 0.2, 1], [0.1, 0, 0.9, 1]], np.float32)
