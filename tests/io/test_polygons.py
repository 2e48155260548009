"""Polygons with many corners become triangles that cover what the polygon covers, whatever its shape and plane."""

import subprocess
import sys

import numpy as np
import pytest
from format_files import FACES, ascii_ply

from texfcodec.io.load import load
from texfcodec.io.polygons import MAX_CORNERS, triangulate


class Warnings(list):
    """The methods of Notes that triangulation calls."""

    warn = list.append

    def lose(self, name, sentence):
        self.append(sentence)


def star(rng, corners, tight=0.05):
    """A polygon around its centre whose radius jumps: float64 [corners, 2], counter-clockwise."""
    angles = np.sort((np.arange(corners) + rng.uniform(0, 0.8, corners)) * (2 * np.pi / corners))
    return np.stack([np.cos(angles), np.sin(angles)], axis=1) * rng.uniform(tight, 1.0, (corners, 1))


def comb(teeth):
    """A bar with teeth, many reflex corners: float64 [4 * teeth, 2], counter-clockwise."""
    points = [[2 * teeth - 1, 1], [0, 1]]
    for tooth in range(teeth):
        points += [[2 * tooth, 0], [2 * tooth + 1, 0], [2 * tooth + 1, 0.9], [2 * tooth + 2, 0.9]]
    return np.array(points[:-2] + [[2 * teeth - 1, 0]], np.float64)[:-1]


def spiral():
    """66 corners: a thin arm rolled up twice, which a fan covers many times over."""
    angles = np.linspace(0, 4 * np.pi, 33)
    radius = 0.1 + angles / (4 * np.pi)
    outer = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([outer * radius[:, None], (outer * (radius - 0.04)[:, None])[::-1]])


def shoelace(points):
    x, y = points.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def random_frame(rng):
    """Three orthonormal vectors [3, 3] and a shift [3]."""
    return np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3) * 10


def in_space(flat, rng):
    """(points [n, 3] of a flat polygon in a random plane, vector area of it [3])."""
    frame, shift = random_frame(rng)
    return flat @ frame[:2] + shift, shoelace(flat) * np.cross(frame[0], frame[1])


def split(points, sizes=None):
    """Triangles of polygons whose corners are the points in order -> (faces, polygon of each, warnings)."""
    notes = Warnings()
    sizes = np.array([len(points)] if sizes is None else sizes)
    return *triangulate(points, np.arange(len(points)), sizes, notes), notes


def vector_areas(points, faces):
    a, b, c = (points[faces[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def assert_covers(points, faces, area):
    """The triangles add up to the polygon's area and all face its way."""
    found = vector_areas(points, faces)
    np.testing.assert_allclose(found.sum(axis=0), area, atol=1e-9 * np.linalg.norm(area))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1).sum(), np.linalg.norm(area), rtol=1e-9)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("corners", [4, 5, 9, 40, 66])
def test_stars_in_any_plane_keep_their_area_and_side(seed, corners):
    rng = np.random.default_rng(seed)
    flat = star(rng, corners)[:: -1 if seed % 2 else 1]
    points, area = in_space(np.roll(flat, rng.integers(corners), axis=0), rng)
    faces, _, warnings = split(points)
    assert len(faces) == corners - 2 and sorted(set(faces.reshape(-1))) == list(range(corners))
    assert_covers(points, faces, area)
    assert warnings == []


@pytest.mark.parametrize("teeth", [2, 3, 16])
def test_combs_keep_their_area_and_every_corner(teeth):
    points, area = in_space(comb(teeth), np.random.default_rng(teeth))
    faces, _, warnings = split(points)
    assert_covers(points, faces, area)
    assert sorted(set(faces.reshape(-1))) == list(range(len(points))) and warnings == []


def test_corners_on_a_straight_edge_stay():
    """Ear cutting leaves them out, but a neighbour's corner stands there: without it the surface would come apart."""
    flat = np.array([[0, 0], [1, 0], [2, 0], [4, 0], [4, 1], [2, 1], [2, 3], [2, 4], [0, 4], [0, 1]], np.float64)
    points, area = in_space(flat, np.random.default_rng(0))
    faces, _, warnings = split(points)
    assert_covers(points, faces, area)
    assert len(faces) == 8 and sorted(set(faces.reshape(-1))) == list(range(10)) and warnings == []


def test_the_arm_of_66_corners_does_not_swell(tmp_path):
    flat = spiral()
    lines = [f"v {x:.17g} {y:.17g} 0" for x, y in flat] + ["f " + " ".join(map(str, range(1, 67)))]
    (tmp_path / "arm.obj").write_text("\n".join(lines))
    scene = load(tmp_path / "arm.obj")
    fan = np.array([[0, i, i + 1] for i in range(1, 65)])
    assert np.abs(vector_areas(np.pad(flat, ((0, 0), (0, 1))), fan)).sum() > 10 * shoelace(flat)
    assert_covers(scene.positions, scene.faces, np.array([0, 0, shoelace(flat)]))


@pytest.mark.parametrize("start", range(4))
def test_concave_quads_are_cut_from_their_reflex_corner(start):
    flat = np.roll([[0, 0], [2, 0], [0.5, 0.5], [0, 2]], start, axis=0)
    points, area = in_space(flat.astype(np.float64), np.random.default_rng(start))
    faces, polygon, warnings = split(points)
    assert_covers(points, faces, area)
    assert polygon.tolist() == [0, 0] and warnings == []


def test_faces_of_one_or_two_corners_are_left_out_with_a_warning():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)[[0, 1, 2, 0, 1, 2, 3]]
    faces, polygon, warnings = split(points, [2, 1, 4])
    assert faces.tolist() == [[3, 4, 5], [3, 5, 6]] and polygon.tolist() == [2, 2]
    assert warnings == ["2 faces with fewer than three corners are left out"]


def test_triangles_and_convex_polygons_are_fans_as_before():
    ring = np.array([[np.cos(a), np.sin(a), 0] for a in np.arange(6) * np.pi / 3])
    points = np.concatenate([ring, ring[:3], ring[:4]])
    faces, polygon, warnings = split(points, [6, 3, 4])
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [6, 7, 8], [9, 10, 11], [9, 11, 12]]
    assert polygon.tolist() == [0, 0, 0, 0, 1, 2, 2] and warnings == []


def test_saddles_keep_their_first_diagonal():
    points = np.array([[0, 0, 0], [1, 0, 0.4], [1, 1, 0], [0, 1, 0.4]], np.float64)
    faces, _, warnings = split(points)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]] and warnings == []


def test_many_polygons_are_told_apart():
    rng = np.random.default_rng(5)
    sizes = rng.integers(3, 12, 200)
    pieces = [in_space(star(rng, size), rng) for size in sizes]
    points = np.concatenate([piece for piece, _ in pieces])
    faces, polygon, warnings = split(points, sizes)
    starts = np.cumsum(sizes) - sizes
    assert (np.diff(polygon) >= 0).all() and warnings == []
    for number, (_, area) in enumerate(pieces):
        own = faces[polygon == number]
        assert (own >= starts[number]).all() and (own < starts[number] + sizes[number]).all()
        assert_covers(points, own, area)


@pytest.mark.parametrize("flat", [
    [[0, 0], [1, 1], [1, 0], [0, 1]],  # a bow-tie whose halves cancel
    [[0, 0], [2, 2], [2, 0], [0, 1]],
    [[0, 0], [3, 0], [3, 2], [1, 2], [1, -1], [0, -1]],
    [[np.cos(a), np.sin(a)] for a in np.arange(5) * 4 * np.pi / 5],  # a pentagram: every corner turns left
])
def test_self_crossing_polygons_are_named(flat):
    points, _ = in_space(np.array(flat, np.float64), np.random.default_rng(1))
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces, polygon, warnings = split(np.concatenate([square, points, points]), [4, len(flat), len(flat)])
    assert faces[polygon == 0].tolist() == [[0, 1, 2], [0, 2, 3]] and {0, 1, 2} == set(polygon)
    assert len(warnings) == 1 and warnings[0].startswith("2 polygons cross themselves") and "polygon 1 " in warnings[0]


def test_a_ring_that_goes_round_twice_is_named():
    """All its corners turn left and its fan from the inner round folds nowhere: only the angle tells."""
    angles = np.arange(16) * (4 * np.pi / 16)
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * np.linspace(0.3, 1.0, 16)[:, None]
    assert "crosses itself" in split(points)[2][0]


def test_degenerate_polygons_are_named_and_keep_their_fan():
    line = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3], [1.5, 1.5, 1.5]], np.float64)
    faces, _, warnings = split(np.concatenate([line, np.zeros((4, 3))]), [5, 4])
    assert len(faces) == 5 and warnings == ["2 polygons have no area (degenerate); the first is polygon 0 of the file"]


@pytest.mark.parametrize("scale", [1e-150, 1e-12, 1e12, 1e150])
def test_the_size_of_the_model_changes_nothing(scale):
    flat = star(np.random.default_rng(3), 12)
    points = np.pad(flat, ((0, 0), (0, 1)))
    expected = split(points)[0]
    assert split(points * scale)[0].tolist() == expected.tolist() and split(points * scale)[2] == []


def test_polygons_too_large_for_ear_cutting_stay_fans_and_are_named():
    points = np.pad(star(np.random.default_rng(0), MAX_CORNERS + 1), ((0, 0), (0, 1)))
    faces, _, warnings = split(points)
    assert len(faces) == MAX_CORNERS - 1 and (faces[:, 0] == 0).all()
    assert len(warnings) == 1 and f"more than {MAX_CORNERS} corners" in warnings[0]


def test_corners_that_do_not_exist_are_left_to_the_check_of_faces():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, np.nan]], np.float64)
    for corners in ([0, 1, 2, 9, 1], [0, 1, -1, 2, 0], [0, 1, 2, 0, 1]):
        faces, _ = triangulate(points, np.array(corners), np.array([5]), Warnings())
        assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]


def test_attributes_travel_with_their_corners(tmp_path):
    """A concave OBJ polygon with UVs equal to its positions, and PLY corners with colours."""
    flat = star(np.random.default_rng(8), 15)
    (tmp_path / "m.mtl").write_text("newmtl m\nmap_Kd t.png\n")
    import PIL.Image

    PIL.Image.new("RGB", (2, 2)).save(tmp_path / "t.png")
    lines = ["mtllib m.mtl", "usemtl m", *(f"v {x} {y} 0" for x, y in flat), *(f"vt {x} {y}" for x, y in flat[::-1])]
    lines.append("f " + " ".join(f"{i + 1}/{15 - i}" for i in range(15)))
    (tmp_path / "a.obj").write_text("\n".join(lines))
    scene = load(tmp_path / "a.obj")
    np.testing.assert_allclose(scene.corner_uv[..., 0], scene.positions[scene.faces][..., 0])
    np.testing.assert_allclose(1 - scene.corner_uv[..., 1], scene.positions[scene.faces][..., 1])
    rows = [f"{x} {y} 0 {i} 0 0" for i, (x, y) in enumerate(flat)]
    more = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    text = ascii_ply(FACES, "15 " + " ".join(map(str, range(15))), rows, more).replace("float", "double")
    (tmp_path / "a.ply").write_text(text)
    scene = load(tmp_path / "a.ply")
    assert_covers(scene.positions, scene.faces, np.array([0, 0, shoelace(flat)]))
    order = np.argsort(scene.corner_color[..., 0].reshape(-1)).reshape(-1)
    assert (np.diff(scene.faces.reshape(-1)[order]) >= 0).all()


def test_ear_cutting_is_imported_only_where_a_fan_folds(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.9 0.1 0\nf 1 2 3 4\nf 1 5 3 4\n")
    program = (f"import sys; from texfcodec.io.load import load; load({str(tmp_path / 'a.obj')!r}); "
               "print('mapbox_earcut' in sys.modules)")
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False"]
