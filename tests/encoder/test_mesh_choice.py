"""Which mesh is sent: smaller where pictures show no more of it than coding costs, the source's wherever that is asked for."""

import numpy as np
import pytest

from texfcodec.api import decode, encode_to_result
from texfcodec.encoder.caches import Cache
from texfcodec.encoder.mesh import picture_error
from texfcodec.encoder.mesh.choice import MeshChoice
from texfcodec.encoder.mesh.drawn_source import FetchedNormals, draw_onto
from texfcodec.encoder.mesh.picture_error import SMOOTH, PictureComparison, PictureError
from texfcodec.encoder.price import Lagrangian
from texfcodec.encoder.requests import Requests
from texfcodec.encoder.supports import reference_density
from texfcodec.errors import InputError
from texfcodec.geometry.canonical import CanonicalCube, finer_cube
from texfcodec.geometry.mesh import Mesh
from texfcodec.geometry.nearest_points import NearestPoints
from texfcodec.geometry.shading_normals import corner_normals
from texfcodec.geometry.surface import make_surface
from texfcodec.metrics.psnr_3d import measure
from texfcodec.options import EncodeOptions
from texfcodec.scene.normal_rule import FLAT
from texfcodec.scene.scene import Material, Scene, Texture

SIDE = 96


def bowl(side=SIDE):
    """A smooth sheet of 2 (side - 1)**2 faces with a smooth picture."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij"), axis=-1).reshape(-1, 2)
    positions = np.column_stack([grid, 0.3 * (grid**2).sum(axis=1)])
    place = np.arange(side * side).reshape(side, side)
    a, b, c, d = place[:-1, :-1].ravel(), place[1:, :-1].ravel(), place[1:, 1:].ravel(), place[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    y, x = np.mgrid[:256, :256]
    image = np.full((256, 256, 4), 255, np.uint8)
    image[..., :3] = (128 + 60 * np.sin(x / 7) + 50 * np.sin(y / 9))[..., None]
    material = Material(texture=0, unlit=True)
    return Scene(positions, faces, np.zeros(len(faces), np.int64), (grid[faces] + 1) / 2, None, [material], [Texture(image)])


def encoded(scene, **options):
    return encode_to_result(scene, EncodeOptions(**{"rate": "r02", "support": "voxels", **options}))


@pytest.fixture(scope="module")
def smaller():
    return encoded(bowl())


def test_a_smooth_sheet_is_sent_with_fewer_faces_and_looks_the_same(smaller):
    scene, kept = bowl(), encoded(bowl(), keep_mesh=True)
    before, after = (decode(one.data) for one in (kept, smaller))
    assert len(before.faces) == len(scene.faces) and len(after.faces) < 0.5 * len(before.faces)
    assert smaller.sizes["geometry"] < 0.6 * kept.sizes["geometry"]  # outlines count
    there, here = (measure(scene, texf, 20_000)["y"] for texf in (before, after))
    assert here > there - 0.5


@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_a_large_mesh_without_images_is_taken_without_a_search(monkeypatch, effort):
    monkeypatch.setattr("texfcodec.encoder.mesh.choice.LARGE", 2 * (SIDE - 1) ** 2)
    scene = bowl()
    colour = np.ones((len(scene.positions), 4), np.float32)
    colour[:, :3] = (0.5 + 0.2 * np.sin(5 * scene.positions[:, :2].sum(axis=1)))[:, None]
    scene.textures, scene.materials, scene.corner_color = [], [Material()], colour[scene.faces]
    result = encoded(scene, effort=effort)
    mesh = result.choices["mesh"]
    assert mesh["reason"] == "the fewest faces that suit the error of colours" and len(mesh["tried"]) <= 3
    assert len(decode(result.data).faces) == mesh["faces"][1] < 0.5 * mesh["faces"][0]


def test_facets_stay_facets():
    """Of a file whose normals are those of its faces a smaller mesh has the normals of its own, and theirs are compared."""
    scene, options = bowl(48), EncodeOptions(rate="r03")
    scene.materials[0] = Material(texture=0)
    usual = make_surface(scene, options)
    seen = []
    for rule in (FLAT, SMOOTH):
        scene.corner_normal = corner_normals(usual.lattice, usual.faces, [rule])
        choice = MeshChoice(scene, usual, Requests.of(options).price, Requests.of(options).mesh, 1.0, Cache())
        candidate = choice._meshes(usual, np.zeros(len(usual.faces), np.int64), False).trial(4, 12)
        surface = candidate.sent.surface
        own = corner_normals(surface.lattice, surface.faces, [rule])
        apart = np.linalg.norm(candidate.sent.scene.corner_normal - own, axis=2)
        assert choice.pictures.is_flat == (rule == FLAT) and np.median(apart) < (1e-6 if rule == FLAT else 0.05)
        seen.append(candidate.moved.mse)
    assert seen[0] > 2 * seen[1]


def test_more_bits_are_taken_by_what_is_seen_at_each(monkeypatch):
    """The error does not fall evenly where layers lie close: a peak at 16 bits hides nothing behind it."""
    scene, seen = bowl(24), {14: 3.0, 15: 2.5, 16: 8.0, 17: 0.1, 18: 0.1, 19: 0.1, 20: 0.1}
    error_at = lambda self, surface: PictureError(seen[surface.cube.position_bits], 0.0, 0.0)
    monkeypatch.setattr(MeshChoice, "picture_error", error_at)
    monkeypatch.setattr(Lagrangian, "byte", 1e-4)
    options = EncodeOptions(rate="r03")
    usual = make_surface(scene, options)
    finer = MeshChoice(scene, usual, Requests.of(options).price, Requests.of(options).mesh, 1.0, Cache()).finer()
    assert finer.cube.position_bits == 17


def test_a_few_of_the_pixels_tell_the_error_of_a_moved_surface(monkeypatch):
    """Two layers close to each other, so that some pixels show another face on a coarse lattice: those all count."""
    low, high = bowl(16), bowl(16)
    faces = np.concatenate([low.faces, high.faces + len(low.positions)])
    scene = Scene(np.concatenate([low.positions, high.positions + [0, 0, 3e-3]]), faces, np.repeat([0, 1], len(low.faces)),
                  np.concatenate([low.corner_uv, 1 - high.corner_uv]), None, [Material(texture=0, unlit=True)] * 2, low.textures)
    coarse, drawn, errors, pixels = make_surface(scene, EncodeOptions(position_bits=9)), [], [], []
    colour = picture_error.colour_fragments
    monkeypatch.setattr(picture_error, "colour_fragments", lambda *given: drawn.append(len(given[1].pixel)) or colour(*given))
    for every in (1, picture_error.EVERY):
        monkeypatch.setattr(picture_error, "EVERY", every)
        pictures = PictureComparison(scene, make_surface(scene, EncodeOptions()), 0.0, 1)
        drawn.clear()
        errors.append(pictures.of(coarse, pictures.normals_of(coarse)).mse)
        pixels.append(sum(drawn))
    assert errors[0] > 1 and abs(errors[1] / errors[0] - 1) < 0.05 and pixels[1] < 0.6 * pixels[0]


def test_the_report_says_what_was_tried_and_what_it_cost(smaller):
    said = smaller.choices["mesh"]
    assert said["faces"] == [2 * (SIDE - 1) ** 2, smaller.counts["faces"]]
    assert said["distance"]["d1"]["psnr"] > 45 and 0 < said["distance"]["hausdorff"]["share"] < 0.02
    assert said["tried"][0]["faces"] == said["faces"][0] and len(said["tried"]) >= 3
    best = min((one for one in said["tried"] if "refused" not in one), key=lambda one: one["cost"])
    assert (best["faces"], best["position_bits"]) == (said["faces"][1], said["position_bits"])


@pytest.mark.parametrize("options", [{"keep_mesh": True}, {"position_bits": 14}, {"exact_rate": True}, {"lossless": True},
                                     {"resolution": 256, "qp": 30}])
def test_whoever_asks_for_precision_gets_the_source_s_mesh_at_the_nearest_places(options):
    scene, given = bowl(24), {"support": "auto"} if options.get("exact_rate") else {}
    texf = decode(encoded(scene, **given, **options).data)
    assert len(texf.faces) == len(scene.faces)
    want = np.unique(texf.cube.to_lattice(scene.positions), axis=0)
    assert np.array_equal(np.unique(texf.lattice_positions, axis=0), want)


def test_a_budget_that_the_source_s_geometry_takes_up_is_met_by_a_smaller_mesh_or_refused_with_keep_mesh():
    scene = bowl()
    kept = encoded(scene, keep_mesh=True)
    budget = round(0.9 * kept.sizes["geometry"])
    made = encode_to_result(scene, EncodeOptions(target_bytes=budget, support="voxels", effort="fast"))
    assert len(made.data) <= budget and made.sizes["geometry"] < 0.5 * kept.sizes["geometry"]
    with pytest.raises(InputError) as refused:
        encode_to_result(scene, EncodeOptions(target_bytes=budget, support="voxels", keep_mesh=True))
    assert refused.value.code == "TXF-I51"


def test_faces_over_texels_go_with_their_uvs():
    scene = bowl()
    kept, smaller = (encoded(scene, support="texels", keep_mesh=keep) for keep in (True, False))
    texf = decode(smaller.data)
    assert len(texf.faces) < 0.5 * len(scene.faces) and smaller.sizes["geometry"] < 0.5 * kept.sizes["geometry"]
    assert measure(scene, texf, 20_000)["y"] > measure(scene, decode(kept.data), 20_000)["y"] - 1.5


def test_vertex_colours_in_texels_keep_every_face():
    scene = bowl(48)
    scene.corner_color = np.ones((len(scene.faces), 3, 4), np.float32)
    scene.corner_color[:, :, 0] = 0.5
    assert len(decode(encoded(scene, support="texels").data).faces) == len(scene.faces)


def test_tangents_go_with_the_faces_and_keep_their_side_of_the_image():
    """Where tangents of the file are not those that follow from UVs, a normal map may be read with no others."""
    scene, options = bowl(48), EncodeOptions(rate="r03")
    scene.materials[0] = Material(texture=0)
    usual = make_surface(scene, options)
    scene.corner_normal = corner_normals(usual.lattice, usual.faces, [SMOOTH])
    along = np.cross(np.array([0.6, 0.8, 0.0]), scene.corner_normal)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    scene.corner_tangent = np.concatenate([along, np.full((*along.shape[:2], 1), -1.0)], axis=2).astype(np.float32)
    choice = MeshChoice(scene, usual, Requests.of(options).price, Requests.of(options).mesh, 1.0, Cache())
    sent = choice._meshes(usual, np.zeros(len(usual.faces), np.int64), True).trial(4, 12).sent.scene
    wanted = np.cross(np.array([0.6, 0.8, 0.0]), sent.corner_normal)
    wanted /= np.linalg.norm(wanted, axis=2, keepdims=True)
    assert len(sent.faces) < 0.3 * len(scene.faces)
    assert (sent.corner_tangent[..., 3] == -1).all()
    assert np.abs(sent.corner_tangent[..., :3] - wanted).max() < 0.05


def test_a_mesh_of_which_a_coarser_lattice_leaves_nothing_stays_as_it_is():
    """Tiny faces that are far apart: at 12 bits each falls into one place."""
    scene, random = bowl(24), np.random.default_rng(2)
    corners = scene.positions[scene.faces]
    centre = random.uniform(-1, 1, (len(corners), 1, 3))
    scene.positions = (centre + 2e-4 * (corners - corners.mean(axis=1, keepdims=True)) * 20).reshape(-1, 3)
    scene.faces = np.arange(len(scene.positions)).reshape(-1, 3)
    made = encoded(scene)
    assert len(decode(made.data).faces) > 0.9 * len(scene.faces)


def test_two_sheets_that_face_apart_are_not_drawn_onto_each_other():
    scene = bowl(12)
    upper, lower = Mesh(scene.positions, scene.faces), Mesh(scene.positions - [0, 0, 0.01], scene.faces[:, ::-1])
    faces = np.concatenate([upper.faces, lower.faces + len(upper.positions)])
    both = Mesh(np.concatenate([upper.positions, lower.positions]), faces)
    group, moved = np.zeros(len(both.faces), np.int64), Mesh(both.positions - [0, 0, 0.008], both.faces)
    drawn = draw_onto(moved, group, both, group)  # the upper sheet lies nearer to the lower one now
    sheet = drawn.place[drawn.mesh.faces] >= len(upper.faces)
    assert not sheet[: len(upper.faces)].any() and sheet[len(upper.faces) :].all()


def test_normals_are_fetched_from_the_side_that_a_face_is_on():
    corner = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, -1], [1, 1, -1]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    mesh = Mesh(corner, faces)
    flat = np.repeat(np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]], np.float32)[:, None], 3, axis=1)
    assert np.allclose(FetchedNormals(mesh, lambda: NearestPoints(mesh), mesh).of(flat), flat, atol=1e-6)


@pytest.mark.parametrize("bits", [8, 11, 14, 20])
def test_a_finer_lattice_has_the_grid_coordinates_of_the_one_it_was_made_of(bits):
    cube = CanonicalCube((1.0, 2.0, 3.0), 7.0, bits)
    points = np.random.default_rng(1).uniform([1, 2, 3], [8, 9, 10], (100, 3))
    assert np.allclose(finer_cube(cube).to_grid(points, 1024), cube.to_grid(points, 1024), atol=1e-9)
    assert finer_cube(cube).to_lattice(points).max() <= finer_cube(cube).last


def test_colours_that_take_next_to_nothing_do_not_sell_the_mesh(monkeypatch):
    """Faces of flat colours out of a large image: a few hundred bytes of geometry are no reason to move what is seen."""
    scene, random = bowl(24), np.random.default_rng(3)
    scene.positions += random.normal(scale=0.01, size=scene.positions.shape)
    scene.textures[0].image[..., :3] = np.kron(random.integers(100, 140, (16, 16, 3)), np.ones((16, 16, 1)))
    spots = (random.integers(0, 2, (len(scene.faces), 1, 2)) * 16 + 8) / 256
    scene.corner_uv = np.repeat(spots, 3, axis=1)
    bits = [decode(encoded(scene, support="auto", rate=rate).data).position_bits for rate in ("r01", "r04")]
    assert 14 <= bits[1] >= bits[0]
    monkeypatch.setattr(reference_density, "LEAST_K", 1)
    assert decode(encoded(scene, support="auto", rate="r04").data).position_bits < 14
