"""Points of a source on streams whose meshes are not the source's rounded: moved vertices, fewer faces, sheets close together."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import mapped_sheet, noise, painted_sphere, scene_of, square

from texfcodec import EncodeOptions, InputError, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.mesh.simplify import simplify
from texfcodec.geometry.areas import sample_surface
from texfcodec.geometry.mesh import Mesh, points_at
from texfcodec.metrics.face_match import FaceMatch, decoded_faces
from texfcodec.metrics.parts import compare_parts
from texfcodec.metrics.psnr_3d import SourceSamples, measure
from texfcodec.metrics.shaded import compare_channels
from texfcodec.report import Report
from texfcodec.scene.scene import Material, Texture

BITS = 10
RED, BLUE = (200, 20, 20, 255), (20, 20, 200, 255)


def coded(scene, **options):
    """The decoded stream of a Scene."""
    options = {"resolution": 128, "qp": 16, "position_bits": BITS, "threads": 1} | options
    return decode(encode_scene(scene, EncodeOptions(**options), Report()).data)


def moved(scene, steps, seed=0):
    """The Scene with every vertex moved by up to so many steps of the lattice along each axis, none left where it was."""
    step = np.ptp(scene.positions, axis=0).max() / (2**BITS - 1)
    rng = np.random.default_rng(seed)
    shift = rng.integers(1, steps + 1, scene.positions.shape) * rng.choice([-1, 1], scene.positions.shape)
    return replace(scene, positions=scene.positions + step * shift)


def fewer(scene, share):
    """A painted Scene with that share of its faces, vertices with the colours that they had."""
    made = simplify(Mesh(scene.positions, scene.faces)).at(int(share * len(scene.faces)))
    colours = np.zeros((len(scene.positions), scene.corner_color.shape[-1]), np.float32)
    colours[scene.faces.ravel()] = scene.corner_color.reshape(-1, colours.shape[1])
    return scene_of(*made.mesh, colours[made.vertex])


def test_a_face_that_kept_its_corners_keeps_its_weights():
    scene = painted_sphere(8)
    names = ("faces", "corner_color", "corner_uv")
    turned = replace(scene, **{name: np.roll(getattr(scene, name), 1, axis=1)[::-1] for name in names})
    texf = coded(scene)
    face, bary = sample_surface(turned.positions, turned.faces, 500)
    assert (decoded_faces(turned, texf)[0] >= 0).all()
    places = FaceMatch(turned, texf).find(face, bary)
    source = points_at(Mesh(turned.positions, turned.faces), face, bary)
    assert np.array_equal(places.points, source)  # over voxels alone, they ask where the source has them
    there = points_at(Mesh(texf.positions, texf.faces), places.face, places.bary)
    assert np.abs(there - source).max() < 1.01 * texf.side / texf.cube.last / 2
    assert np.array_equal(np.sort(places.bary, axis=1), np.sort(bary, axis=1))


@pytest.mark.parametrize("support", ["voxels", "texels"])
@pytest.mark.parametrize("steps", [1, 2])
def test_moved_vertices_cost_little_of_the_figure(support, steps):
    sheet = mapped_sheet({}, np.kron(noise(3, 6, 6), np.ones((16, 16, 1), np.uint8)), cells=12)
    samples, texf = SourceSamples(sheet, 20_000), coded(moved(sheet, steps), support=support)
    assert (decoded_faces(sheet, texf)[0] >= 0).sum() < 10
    # Blocks of colour move along with the vertices, by up to 2 of 1023 steps: their edges are elsewhere, and all else is right.
    assert samples.compare(texf)["y"] > 24 + 3 * (steps == 1)
    assert np.median(np.abs(samples.answers(texf) - samples.colour)) < 3


@pytest.mark.parametrize("share", [0.5, 0.2])
def test_a_mesh_with_fewer_faces_is_asked_on_its_surface(share):
    scene = painted_sphere(24)
    texf = coded(fewer(scene, share), qp=10, resolution=512)
    assert len(texf.faces) <= share * len(scene.faces)
    samples = SourceSamples(scene, 20_000)
    places = FaceMatch(scene, texf).find(samples.face, samples.bary)
    on = np.linalg.norm(places.points - points_at(Mesh(texf.positions, texf.faces), places.face, places.bary), axis=1)
    off = np.linalg.norm(places.points - points_at(Mesh(scene.positions, scene.faces), samples.face, samples.bary), axis=1)
    voxel = texf.side / texf.resolution
    assert off.max() > voxel and on.max() < texf.side / texf.cube.last
    assert measure(scene, texf, 20_000)["y"] > 27 + 20 * share  # what vertex colours lose with the vertices
    assert compare_parts(scene, texf)["y"] == pytest.approx(measure(scene, texf, 20_000)["y"], abs=0.2)


def sheets(cells, gap, rough=0.0, same_way=False):
    """Two squares of cells^2 * 2 faces at height 0 and gap, red above and blue below: of two materials where both face up, else
    of one with an image, the lower one facing down. rough: how far vertices stray up and down."""
    one = mapped_sheet({}, cells=cells)
    flat = one.positions * [1, 1, 0]
    low, high = (flat + [0, 0, 1] * np.random.default_rng(s).uniform(-rough, rough, (len(flat), 1)) for s in (0, 1))
    under = one.faces if same_way else one.faces[:, ::-1]
    halves = np.concatenate([np.full((16, 16, 4), RED, np.uint8), np.full((16, 16, 4), BLUE, np.uint8)])
    v = np.array([0.25, 0.75])  # rows of the image that each sheet shows
    uv = np.stack([np.stack([one.corner_uv[..., 0], np.full(one.faces.shape, v[k])], axis=2) for k in (0, 1)])
    materials = [Material("above", texture=0), Material("below", texture=0)]
    return replace(one, positions=np.concatenate([high + [0, 0, gap], low]), faces=np.concatenate([one.faces, under + len(flat)]),
                   face_material=np.repeat([0, int(same_way)], len(one.faces)), corner_uv=uv.reshape(-1, 3, 2),
                   materials=materials[: 1 + same_way], textures=[Texture(halves, (1, 1), "two halves")])


@pytest.mark.parametrize("support, same_way", [("voxels", False), ("texels", False), ("texels", True)],
                         ids=["apart over voxels", "apart over texels", "two materials"])
def test_no_colour_comes_from_the_other_sheet(support, same_way):
    gap = 0.002
    source = sheets(2, gap, same_way=same_way)
    texf = coded(sheets(9, gap, 0.75 * gap, same_way), support=support, qp=4)
    samples = SourceSamples(source, 20_000)
    places = FaceMatch(source, texf).find(samples.face, samples.bary)
    nearest = texf.nearest_face(points_at(Mesh(source.positions, source.faces), samples.face, samples.bary))
    colour = texf.query_by_field(places.points, texf.face_field[nearest], nearest)
    assert (np.abs(colour - samples.colour).max(axis=1) > 90).mean() > 0.02  # the nearest face is often the other sheet's
    assert np.abs(samples.answers(texf) - samples.colour).max() < 20


def test_a_stream_of_something_else_answers_and_an_empty_one_is_refused():
    texf = coded(painted_sphere(6))
    assert measure(scene_of(*square()), texf, 500)["y"] < 40
    channels = compare_channels(scene_of(*square()), texf, 500)
    assert channels["samples"] == 500
    empty = coded(scene_of([[4, 5, 6]] * 3, [[0, 1, 2]]), allow_empty=True)
    with pytest.raises(InputError, match="TXF-I70"):
        measure(painted_sphere(6), empty, 100)
