"""Atlas and bake: any mesh gets an atlas, and baked colours survive bilinear lookups, at seams too."""

import sys
from pathlib import Path

import numpy as np
import pytest
from analytic import bilinear, decoded, empty_mesh, grid_mesh, soup_mesh, sphere_mesh, surface, surface_samples

from texfcodec.errors import InputError
from texfcodec.geometry.areas import face_areas
from texfcodec.io.atlas import quality
from texfcodec.io.atlas import unwrap as atlas_room
from texfcodec.io.atlas.bake import bake
from texfcodec.io.atlas.chart_packing import flat_areas
from texfcodec.io.atlas.fill_uncovered import fill_uncovered
from texfcodec.io.atlas.system import cover
from texfcodec.io.atlas.unwrap import _unit_points, make_atlas
from texfcodec.scene.scene import ALPHA_MASK, Material

ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets"


def broken_mesh():
    """Duplicate, flipped, degenerate and non-manifold faces, slivers, and points far apart."""
    points, faces = grid_mesh(8, 0.3)
    odd = np.array([[0, 0, 1], [2, 2, 2], [0, 1, 2], [0, 7, 63], [0, 7, 40], [0, 7, 33], [0, 63, 1]])
    return points, np.vstack([faces, faces[:5], faces[:5, ::-1], odd])


MESHES = {
    "triangle": lambda: (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])),
    "sheet": lambda: grid_mesh(24, 0.3),
    "sphere": sphere_mesh,
    "broken": broken_mesh,
    "soup": soup_mesh,
    "needle": lambda: (np.array([[0.0, 0, 0], [1, 1e-7, 0], [0.5, 1e-7, 1e-9]]), np.array([[0, 1, 2]])),
    "point": lambda: (np.ones((3, 3)), np.array([[0, 1, 2], [2, 1, 0]])),
}


def colour_error(texf, baked, **kind):
    points, uv, face = surface_samples(texf, baked.atlas.corner_uv, **kind)
    return np.abs(bilinear(baked.image, uv) - texf.query(points, face)).max(1)


# Atlas.


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("method", ["fast", "quality"])
def test_every_mesh_gets_an_atlas_inside_the_square(name, method):
    positions, faces = MESHES[name]()
    atlas = make_atlas(positions, faces, 256, method)
    assert atlas.corner_uv.shape == (len(faces), 3, 2) and atlas.corner_uv.dtype == np.float64
    assert (atlas.corner_uv >= 0).all() and (atlas.corner_uv <= 1).all()
    assert atlas.width == atlas.height and (atlas.width == 256 or atlas.warnings)
    assert atlas.method == method or atlas.warnings


def test_without_xatlas_the_fast_atlas_says_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "xatlas", None)
    atlas = make_atlas(*sphere_mesh(), 256, "quality")
    assert atlas.method == "fast" and any("pip install xatlas" in line for line in atlas.warnings)


def test_empty_mesh_gets_an_empty_atlas():
    atlas = make_atlas(*empty_mesh())
    assert atlas.corner_uv.shape == (0, 3, 2) and atlas.width == atlas_room.MIN_SIZE


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e7, 1e30, 1e307])
def test_atlas_does_not_depend_on_the_unit(scale):
    positions, faces = grid_mesh(12, 0.3)
    here, there = make_atlas(positions, faces, 256, "fast"), make_atlas(positions * scale, faces, 256, "fast")
    assert np.abs(here.corner_uv - there.corner_uv).max() < 0.01 or here.utilisation == pytest.approx(there.utilisation, rel=0.05)


@pytest.mark.parametrize("name", ["sphere", "broken", "soup"])
def test_fast_charts_share_no_texel_and_no_bilinear_neighbour(name):
    """Paint every face's widened footprint with its 3D position: two faces may meet in a texel only where their surfaces meet."""
    positions, faces = MESHES[name]()
    atlas = make_atlas(positions, faces, 512, "fast")
    texf = decoded(positions, faces, resolution=512)
    owner = cover(np.ascontiguousarray(atlas.corner_uv * atlas.width), atlas.width, atlas.height)
    points, uv, face = surface_samples(texf, atlas.corner_uv, on_edges=True)
    column, row = np.floor(uv[:, 0] * atlas.width - 0.5).astype(int), np.floor(uv[:, 1] * atlas.height - 0.5).astype(int)
    density = np.sqrt(atlas.utilisation) * atlas.width / np.sqrt(surface(texf))
    center = texf.positions[faces].mean(1)
    reach = np.abs(texf.positions[faces] - center[:, None]).max((1, 2))
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        shown = owner[np.clip(row + dy, 0, atlas.height - 1), np.clip(column + dx, 0, atlas.width - 1)]
        assert (shown >= 0).all()
        gap = np.linalg.norm(center[shown] - points, axis=1) - 2 * reach[shown]
        assert gap.max() * density < 8, "a bilinear lookup meets a face far away"


def test_groups_never_share_a_chart():
    positions, faces = grid_mesh(9)
    groups = (np.arange(len(faces)) % 2).astype(np.int64)
    atlas = make_atlas(positions, faces, 256, "fast", groups=groups)
    owner = cover(np.ascontiguousarray(atlas.corner_uv * 256), 256, 256)
    beside = (owner[:, 1:] >= 0) & (owner[:, :-1] >= 0)
    inside_one_group = groups[owner[:, 1:]] == groups[owner[:, :-1]]
    assert (beside & ~inside_one_group).sum() < 0.2 * beside.sum()  # rings touch, faces do not
    assert atlas.utilisation < make_atlas(positions, faces, 256, "fast").utilisation


def test_small_texture_grows_until_all_pieces_fit():
    positions, faces = soup_mesh(20000)
    atlas = make_atlas(positions, faces, 128, "fast")
    assert atlas.width > 128 and len(atlas.warnings) == 1


@pytest.mark.parametrize("program", ["import os; os.abort()", "pass", "print('noise')", "import time; time.sleep(9)"])
def test_auto_falls_back_to_fast_with_a_warning(monkeypatch, program):
    monkeypatch.setattr("texfcodec.io.atlas.quality._CHILD", program)
    monkeypatch.setitem(atlas_room._QUALITY_SECONDS, "auto", 0.5)
    atlas = make_atlas(*grid_mesh(6), 256, "auto")
    assert atlas.method == "fast" and "fast" in atlas.warnings[0]


def test_xatlas_gets_parts_and_processes_do_not_change_the_atlas(monkeypatch):
    monkeypatch.setattr(quality, "PART_FACES", 200)
    positions, faces = sphere_mesh()
    assert len(faces) > 400
    points, parts = _unit_points(positions, faces), quality._parts(positions, faces)
    assert max(map(len, parts)) <= 200 and (np.sort(np.concatenate(parts)) == np.arange(len(faces))).all()
    one, two = (quality.chart_surface(points, faces, 60, threads) for threads in (1, 2))
    assert (one[0] == two[0]).all() and (one[1] == two[1]).all()
    assert (np.unique(one[1]) == np.arange(one[1].max() + 1)).all()
    room, surface = np.bincount(one[1], flat_areas(one[0])), np.bincount(one[1], face_areas(points, faces))
    assert np.allclose(room, surface, rtol=1e-6)
    atlas = make_atlas(positions, faces, 256, "quality", threads=2)
    owner = cover(np.ascontiguousarray(atlas.corner_uv * 256), 256, 256)
    assert atlas.method == "quality" and len(np.unique(owner[owner >= 0])) > 0.95 * len(faces)  # small ones at the poles miss


def test_parts_are_cut_at_the_neck(monkeypatch):
    """Two sheets that a narrow strip joins, of 72 and 98 faces: the plane goes through the strip, where halves would not."""
    left, faces = grid_mesh(6, 0.0)
    right, more = grid_mesh(7, 0.0)
    gap = np.array([1.0 + left[:, 0].max(), 0.0, 0.0])
    a, b = np.argmax(left[:, 0] - left[:, 1]), np.argmin(right[:, 0] + right[:, 1])
    strip = np.array([[a, len(left) + b, a - 1]])
    points = np.vstack([left, right + gap])
    joined = np.vstack([faces, more + len(left), strip])
    monkeypatch.setattr(quality, "PART_FACES", 110)
    parts = sorted(quality._parts(points, joined), key=len)
    assert len(parts) == 2 and all((part < len(faces)).sum() in (0, len(faces)) for part in parts)


def test_charts_lose_the_stretch_of_the_packing():
    points, faces = grid_mesh(6, 0.0)
    corners = points[faces]
    stretched = corners[..., :2] * [3.0, 0.25] + 7.0
    chart = np.zeros(len(faces), np.int64)
    levelled = quality._levelled(stretched, chart, corners, face_areas(points, faces))
    sides = [np.linalg.norm(there[:, 1:] - there[:, :1], axis=2) for there in (levelled, corners)]
    assert np.allclose(*sides, rtol=1e-9)


@pytest.mark.parametrize("arguments", [{"method": "best"}, {"texture_size": 3}, {"texture_size": 1 << 20}])
def test_unknown_atlas_arguments_are_refused(arguments):
    with pytest.raises(InputError, match="TXF-O10"):
        make_atlas(*grid_mesh(4), **arguments)


@pytest.mark.parametrize("spoil", [lambda p, f: f.__setitem__((0, 0), 99999), lambda p, f: p.__setitem__((0, 0), np.nan)])
def test_unusable_meshes_are_refused(spoil):
    positions, faces = grid_mesh(4)
    spoil(positions, faces)
    with pytest.raises(InputError, match="TXF-O11"):
        make_atlas(positions, faces)


def test_default_size_follows_the_voxel_density():
    positions, faces = grid_mesh(6)
    sizes = [make_atlas(positions, faces, method="fast", resolution=k).width for k in (16, 400, 1024, 1 << 14)]
    assert sizes == [256, 512, 2048, 4096]


# Bake.


@pytest.mark.parametrize("name", ["triangle", "sheet", "sphere", "broken"])
@pytest.mark.parametrize("method", ["fast", "quality"])
def test_bilinear_lookups_give_the_field_back_even_at_seams(name, method):
    texf = decoded(*MESHES[name]())
    baked = bake(texf, 512, method)
    assert np.percentile(colour_error(texf, baked), 99) < 2.5
    assert colour_error(texf, baked, on_edges=True).max() < 12  # the field changes by up to 6 per texel at this size


def test_soup_is_baked_without_bleeding():
    texf = decoded(*soup_mesh())
    baked = bake(texf, 1024, "fast")
    assert colour_error(texf, baked, on_edges=True).max() < 10


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_extreme_units_bake_like_ordinary_ones(scale):
    positions, faces = grid_mesh(12, 0.3)
    texf = decoded(positions * scale, faces)
    assert colour_error(texf, bake(texf, 256, "fast"), on_edges=True).max() < 12


def test_cover_agrees_with_brute_force():
    rng = np.random.default_rng(2)
    texels = np.vstack([rng.random((6, 3, 2)) * 30 + 1, np.full((1, 3, 2), 20.25), [[[3, 3], [29, 3], [16, 3]]]])
    owner = cover(np.ascontiguousarray(texels), 32, 32)
    for row in range(32):
        for col in range(32):
            gaps = [square_gap(texels[f], col + 0.5, row + 0.5) for f in range(len(texels))]
            if abs(min(gaps) - 1.0) > 0.05:  # sampling cannot decide the rim itself
                assert (owner[row, col] >= 0) == (min(gaps) < 1.0)
            if owner[row, col] >= 0:
                assert gaps[owner[row, col]] <= 1.05
                assert min(gaps) > 0 or gaps[owner[row, col]] == 0


def square_gap(triangle, x, y, steps=400):
    """Chebyshev distance from a point to a triangle, by dense sampling of its edges and an inside test."""
    a, b, c = triangle
    sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
    if all(s > 0 for s in sides) or all(s < 0 for s in sides):
        return 0.0
    t = np.linspace(0, 1, steps)[:, None]
    rim = np.vstack([p + t * (q - p) for p, q in ((a, b), (b, c), (c, a))])
    return np.abs(rim - [x, y]).max(1).min()


def test_gaps_are_filled_with_what_mip_levels_average():
    image = np.zeros((8, 8, 1), np.uint8)
    known = np.zeros((8, 8), bool)
    image[0, 0], image[1, 1], image[5, 6] = 100, 50, 200
    known[0, 0] = known[1, 1] = known[5, 6] = True
    fill_uncovered(image, known)
    assert image[0, 1] == 75 and image[4, 7] == 200 and image[3, 3] == 75 and (image > 0).all()
    assert (image[0, 0], image[1, 1], image[5, 6]) == (100, 50, 200)  # what is known stays


def test_colour_under_invisible_texels_comes_from_visible_ones():
    texf = decoded(*grid_mesh(6), has_alpha=True, materials=[Material("leaf", alpha_mode=ALPHA_MASK)])
    texf.query = lambda p, f: np.where(p[:, :1] < 0.5, [[0, 0, 0, 0]], [[10, 200, 30, 255]]).astype(np.float32)
    image = bake(texf, 256, "fast").image
    assert {0, 255} <= set(np.unique(image[..., 3])) and (image[..., :3] == [10, 200, 30]).all()


def test_atlas_of_another_mesh_is_refused():
    atlas = make_atlas(*grid_mesh(4), 64, "fast")
    with pytest.raises(InputError, match="TXF-O10"):
        bake(decoded(*grid_mesh(6)), atlas=atlas)


# Real meshes.


@pytest.mark.parametrize("name", ["hard_broken", "waterbottle_pbr"])
def test_real_meshes_bake_cleanly(name):
    path = ASSETS / f"{name}.glb"
    if not path.exists():
        pytest.skip("the shared assets are not here")
    import trimesh

    mesh = trimesh.load(path, process=False).to_geometry()
    positions, weld = np.unique(mesh.vertices, axis=0, return_inverse=True)
    texf = decoded(positions, weld.ravel()[mesh.faces])
    error = colour_error(texf, bake(texf, 1024, "fast"), on_edges=True)
    assert np.percentile(error, 99.9) < 2.5 and error.max() < 15


def test_points_of_any_scale_come_into_the_unit_cube():
    faces = np.array([[0, 1, 2]])
    for scale in (1e-300, 1.0, 1.7e308):
        points = _unit_points(np.array([[-1, -1, 0], [1, 0, 0], [0, 1, 0]]) * scale, faces)
        assert points.min() == 0 and 0.99 < points.max() <= 1
    assert not _unit_points(np.ones((3, 3)), faces).any() and not _unit_points(np.ones((3, 3)), faces[:0]).any()
