"""Many primitives on one vertex buffer: each takes what its faces use, and the Scene is the same as from one primitive."""

import tracemalloc

import numpy as np
import pytest
from format_files import dae
from mesh_files import Builder, load_bytes

from texfcodec.io.vertex_pools import VertexPools, used_rows


def grid(side):
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    points = np.stack([x, y, np.sin(x)], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1)
    return points, np.concatenate([np.stack([corner, corner + 1, corner + side + 1], 1),
                                   np.stack([corner, corner + side + 1, corner + side], 1)]).astype(np.uint32)


def shared(count, side=64, sparse=False):
    """A Builder whose faces are in `count` primitives on the same accessors."""
    points, faces = grid(side)
    builder = Builder()
    color = np.tile(np.linspace(0, 1, len(points), dtype=np.float32)[:, None], (1, 3))
    attributes = {"POSITION": builder.accessor(points), "NORMAL": builder.accessor(points + 1),
                  "COLOR_0": builder.accessor(color)}
    if sparse:
        view = builder.tree["accessors"][attributes["POSITION"]]
        view["sparse"] = {"count": 1, "indices": {"bufferView": builder.view(np.uint16([5]).tobytes()), "componentType": 5123},
                          "values": {"bufferView": builder.view(np.float32([7, 8, 9]).tobytes())}}
    for part in np.array_split(faces, count):
        builder.tree["meshes"][0]["primitives"].append({"attributes": attributes, "indices": builder.accessor(part.reshape(-1))})
    return builder


@pytest.mark.parametrize("sparse", [False, True])
def test_the_surface_of_many_primitives_is_that_of_one(tmp_path, sparse):
    one, many = (load_bytes(tmp_path, shared(count, sparse=sparse), strict=True) for count in (1, 37))
    np.testing.assert_array_equal(many.positions[many.faces], one.positions[one.faces])
    np.testing.assert_array_equal(many.corner_color, one.corner_color)
    np.testing.assert_array_equal(many.corner_normal, one.corner_normal)
    assert not any("no face uses" in text for text in many.remarks)


def test_memory_goes_with_the_faces_and_not_with_the_primitives(tmp_path):
    peaks = []
    for count in (1, 400):
        data = shared(count, 128).glb()
        tracemalloc.start()
        load_bytes(tmp_path, data)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0] + 2e6


def test_vertices_that_no_primitive_uses_are_counted_once(tmp_path):
    builder = shared(4)
    builder.tree["meshes"][0]["primitives"].pop()
    builder.tree["meshes"][0]["primitives"].pop(0)
    used = np.unique(np.concatenate(np.array_split(grid(64)[1], 4)[1:3]))
    assert load_bytes(tmp_path, builder).remarks[0] == f"{64 * 64 - len(used)} vertices that no face uses are left out"


def test_a_collada_mesh_of_many_materials_takes_the_vertices_of_each(tmp_path):
    pytest.importorskip("collada", reason="pycollada is not installed: pip install 'texfcodec[formats]'")
    points, faces = grid(20)
    surface = "".join(f'<triangles count="{len(part)}" material="skin"><input semantic="VERTEX" source="#v" offset="0"/>'
                      f"<p>{' '.join(map(str, part.reshape(-1)))}</p></triangles>" for part in np.array_split(faces, 19))
    scene = load_bytes(tmp_path, dae(surface, points.astype(float), diffuse="<color>1 1 1 1</color>"), "a.dae", strict=True)
    np.testing.assert_allclose(scene.positions[scene.faces], points[faces], atol=1e-6)
    assert len(scene.positions) < 3 * len(points) and not any("no face uses" in text for text in scene.remarks)


@pytest.mark.parametrize("indices, count", [([[0, 1, 2]], 3), ([[0, 1, 3]], 3), ([[0, -1, 2]], 3), (np.zeros((0, 3), int), 3)])
def test_pools_that_are_used_whole_or_wrongly_are_left_as_they_are(indices, count):
    assert used_rows(np.array(indices), count) is None
    pools = VertexPools()
    assert pools.take(0, np.zeros((count, 3)), np.array(indices))[0] is None and pools.unused()[0] in (0, 1, 3)


@pytest.mark.parametrize("count", [5, 9, 10_000])
def test_used_rows_by_mark_and_by_sort_agree(count):
    rng = np.random.default_rng(count)
    for size in (1, 5, 40):
        indices = rng.integers(0, count, (size, 3)).astype(np.uint32)
        taken = used_rows(indices, count)
        if taken is not None:
            rows, inside = taken
            assert rows.tolist() == sorted(set(indices.reshape(-1).tolist())) and (rows[inside] == indices).all()
