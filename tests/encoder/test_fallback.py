"""The mesh of a fallback: fewer faces, which look like the stream's from afar."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import mapped_sheet, painted_sphere, plain_image, scene_of, sphere

from texfcodec import EncodeOptions, decode, encode
from texfcodec.encoder.fallback import with_fewer_faces
from texfcodec.geometry.mesh import Mesh
from texfcodec.io.load import load
from texfcodec.io.save import as_glb
from texfcodec.metrics.surface_distance import surface_distance
from texfcodec.scene.normal_rule import JOINED


def coded(scene, **options):
    return decode(encode(scene, EncodeOptions(**({"resolution": 64, "qp": 16, "refine": "off"} | options))))


def gradient():
    """A picture whose red grows with u and whose green grows with v."""
    ramp = np.linspace(0, 255, 64).round().astype(np.uint8)
    image = np.full((64, 64, 4), 255, np.uint8)
    image[..., 0], image[..., 1], image[..., 2] = ramp[None, :], ramp[:, None], 128
    return image


def test_a_sphere_keeps_its_shape_and_colours():
    texf = coded(painted_sphere(48), support="voxels")
    few = with_fewer_faces(texf)
    assert len(few.faces) < len(texf.faces) / 2 and len(few.fields) == 1 and few.fields[0] is texf.fields[0]
    told = surface_distance(Mesh(texf.positions, texf.faces), Mesh(few.positions, few.faces), samples=2000)
    assert told.largest < 0.02 * texf.side
    assert len(load(as_glb(few)[0]).faces) == len(few.faces)


@pytest.mark.parametrize("count", [3000, 400, 100])
def test_a_count_is_kept(count):
    texf = coded(scene_of(*sphere(40)), support="voxels")
    few = with_fewer_faces(texf, count)
    assert len(few.faces) <= count and (few is texf) == (len(texf.faces) <= count)


def test_an_image_stays_where_it_was():
    texf = coded(mapped_sheet({}, gradient(), cells=12), support="texels", qp=4)
    few = with_fewer_faces(texf, 40)
    assert 2 <= len(few.faces) <= 40 < len(texf.faces)
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], len(few.faces))
    points = (few.positions[few.faces] * weights[..., None]).sum(axis=1)
    there = few.query(points, np.arange(len(few.faces))), texf.query(points)
    assert np.abs(there[0][:, :3] - there[1][:, :3]).max() < 8


def test_units_keep_their_materials_and_coded_normals_go():
    maps = {"roughness": plain_image(255, 90, 255, 255, size=32)}
    scene = mapped_sheet(maps, gradient(), cells=12)
    normal = np.zeros((len(scene.faces), 3, 3), np.float32)
    normal[..., 0], normal[..., 2] = np.random.default_rng(1).uniform(-0.5, 0.5, normal.shape[:2]), 1
    scene.corner_normal = normal / np.linalg.norm(normal, axis=2, keepdims=True)
    texf = coded(scene, support="texels")
    assert texf.coded_normals is not None or texf.sharp_edges is not None
    few = with_fewer_faces(texf, 30)
    assert [(u.field, u.material) for u in few.units] == [(u.field, u.material) for u in texf.units]
    assert few.sharp_edges is None and few.coded_normals is None and not any(m.normals.has_marks for m in few.materials)
    assert all(m.normals.is_flat or m.normals.kind == JOINED for m in few.materials)
    assert np.allclose(np.linalg.norm(few.shading_normals(), axis=2), 1, atol=1e-5)


def test_an_empty_mesh_stays_one():
    texf = decode(encode(scene_of(*sphere(4))))
    texf = replace(texf, units=[])
    assert with_fewer_faces(texf) is texf
