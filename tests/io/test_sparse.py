"""Channels at vertices, sparse voxels, functions of points and arrays: what reaches the Scene, and what is refused."""

import io

import numpy as np
import pytest
import trimesh
from format_files import XYZ
from mesh_files import RED_BLUE, SQUARE, SQUARE_UV, Builder, encoded, load_bytes, refusal
from voxel_files import RADIUS, bent, shell, write_vxz

import texfcodec
from texfcodec.errors import InputError, LimitError
from texfcodec.geometry.mesh import Mesh
from texfcodec.geometry.nearest_points import NearestPoints
from texfcodec.io.load import load
from texfcodec.io.parts import Notes
from texfcodec.io.sparse.dual_grid import dual_surface
from texfcodec.io.sparse.sampler import SparseVoxels
from texfcodec.io.sparse.subdivide import subdivided
from texfcodec.io.sparse.vxz import vxz_arrays
from texfcodec.limits import Limits
from texfcodec.scene.fetch import map_columns, pack_map, sample_source
from texfcodec.scene.srgb import linear_to_srgb

QUAD = {"vertices": SQUARE, "faces": np.array([[0, 1, 2], [0, 2, 3]])}
RAMP = np.array([0.0, 1.0, 0.5, 0.25], np.float32)


def with_attributes(material=None, **attributes):
    b = Builder()
    number = b.material(**(material or {}))
    b.primitive(uv=SQUARE_UV, material=number, attributes={name: b.accessor(values) for name, values in attributes.items()})
    return b


def code_of(call):
    with pytest.raises((InputError, LimitError)) as info:
        call()
    return info.value.code


def test_named_attributes_of_gltf_replace_the_factors(tmp_path):
    colour = np.stack([RAMP] * 3, axis=1)
    b = with_attributes({"pbr": {"metallicFactor": 0.0, "roughnessFactor": 0.5}}, _METALNESS=RAMP, _EMISSIVE=colour)
    scene = load_bytes(tmp_path, b)
    material = scene.materials[0]
    assert material.maps == {"metallic": -1, "emissive": -1}
    assert material.parameters == {"roughness": (0.5,), "emissive": (1.0,) * 3} and len(scene.remarks) == 1
    assert np.array_equal(scene.corner_map["metallic"][..., 0], RAMP[scene.faces])


def test_faces_without_the_attribute_keep_the_factor_and_an_image_goes_before(tmp_path):
    b = with_attributes({"pbr": {"metallicFactor": 0.25}}, _METALLIC=RAMP)
    b.primitive(SQUARE + 2, material=0)
    scene = load_bytes(tmp_path, b)
    assert set(scene.corner_map["metallic"][2:].ravel().tolist()) == {0.25} and not scene.materials[0].parameters
    b = Builder()
    number = b.material(pbr={"metallicRoughnessTexture": {"index": b.texture(encoded(RED_BLUE))}})
    b.primitive(uv=SQUARE_UV, material=number, attributes={"_ROUGHNESS": b.accessor(RAMP)})
    scene = load_bytes(tmp_path, b)
    assert scene.corner_map == {} and any("the material has an image of it" in remark for remark in scene.remarks)


@pytest.mark.parametrize("name", ["metallic", "emissive"])
def test_a_corner_map_is_sampled_as_an_image_of_it_would_be(name):
    values = np.stack([RAMP] * (3 if name == "emissive" else 1), axis=1)
    scene = load({**QUAD, name: linear_to_srgb(values) if name == "emissive" else values})
    bary = np.random.default_rng(0).dirichlet((1, 1, 1), 50)
    sampled = sample_source(pack_map(scene, name), np.zeros(50, np.int64), bary)[:, map_columns(name)]
    share = bary @ RAMP[[0, 1, 2]]
    expected = 255 * (linear_to_srgb(share) if name == "emissive" else share)
    assert np.abs(sampled - expected[:, None]).max() < 0.02


def test_properties_of_ply_and_attributes_of_trimesh_are_read_alike():
    head = ("ply\nformat ascii 1.0\nelement vertex 4\n" + XYZ + "property float metallic\nproperty uchar roughness\n"
            "element face 2\nproperty list uchar int vertex_indices\nend_header\n")
    rows = "".join(f"{x} {y} {z} {m} {int(255 * m)}\n" for (x, y, z), m in zip(SQUARE.tolist(), RAMP, strict=True))
    ply = load((head + rows + "3 0 1 2\n3 0 2 3\n").encode())
    mesh = trimesh.Trimesh(SQUARE, QUAD["faces"], process=False, vertex_attributes={"_METALLIC": RAMP, "roughness": RAMP})
    for scene in (ply, load(mesh)):
        assert scene.materials[0].maps == {"metallic": -1, "roughness": -1} and not scene.dropped
        assert np.abs(scene.corner_map["roughness"][..., 0] - RAMP[scene.faces]).max() < 1 / 255
    assert "metallic" not in ply.materials[0].parameters  # a factor of 0 would take the values away


@pytest.mark.parametrize("filtered", ["none", "parent", "neighbor"])
@pytest.mark.parametrize("method, interleave", [("none", "as_is"), ("deflate", "all"), ("lzma", "none")])
def test_every_form_of_vxz_gives_the_voxels_back(filtered, method, interleave):
    arrays = shell(12)
    got = vxz_arrays(write_vxz(arrays, 8, method, filtered, interleave), Notes())
    order, own = np.lexsort(got["voxels"].T), np.lexsort(arrays["voxels"].T)
    assert got.keys() == arrays.keys()
    assert all(np.array_equal(got[name][order], values[own]) for name, values in arrays.items())


def test_the_dual_grid_of_a_sphere_is_closed_and_faces_outwards():
    arrays = shell(24)
    vertices, faces = dual_surface(arrays["voxels"], arrays["dual_vertices"], arrays["intersected"])
    mesh = trimesh.Trimesh(vertices / 24 - 0.5, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert abs(mesh.volume / (4 / 3 * np.pi * RADIUS**3) - 1) < 0.02


def test_voxels_become_fields_without_a_texture_and_come_back_at_vertices(tmp_path):
    scene = load(write_vxz(shell(8)))
    assert scene.materials[0].maps == {"metallic": -1, "roughness": -1} and not scene.textures and not scene.warnings
    assert any("voxel of its own" in remark for remark in scene.remarks)
    texf = texfcodec.decode(texfcodec.encode(scene, {"rate": "r04", "effort": "fast", "keep_mesh": True}))
    texf.save(tmp_path / "a.glb", appearance="vertex")
    back = load(tmp_path / "a.glb")
    nearest = NearestPoints(Mesh(back.positions, back.faces)).find(scene.positions)
    for name in ("metallic", "roughness"):
        corners = np.einsum("nk,nkc->nc", nearest.bary, back.corner_map[name][nearest.face])[:, 0]
        at_vertices = np.zeros(len(scene.positions))
        at_vertices[scene.faces] = scene.corner_map[name][..., 0]
        assert np.sqrt(np.square(corners - at_vertices).mean()) < 0.06


def test_values_are_interpolated_between_present_voxels_alone():
    voxels = SparseVoxels(np.array([[0, 0, 0], [1, 0, 0]]), {"metallic": np.array([[0.0], [1.0]], np.float32)}, np.zeros(3),
                          np.ones(3))
    points = np.array([[0.5, 0.5, 0.5], [1.0, 0.9, 0.6], [3.5, 0.5, 0.5], [90.0, 0.0, 0.0]])
    assert voxels.at(points)["metallic"][:, 0].tolist() == [0.0, 0.5, 1.0, 1.0]
    assert voxels.counts["nearest"] == 2 and "50.0 % of 4 vertices have no voxel of their own" in voxels.fit(points)


def test_cut_faces_hold_an_edge_of_values_and_leave_no_crack():
    points, faces = np.array([[0, 0, 0], [8, 0, 0], [0, 8, 0], [8, 8, 0.0]]), np.array([[0, 1, 2], [1, 3, 2]])
    step = lambda at: (at[:, :1] > 3.3).astype(np.float32)  # noqa: E731
    positions, cut, values, ended = subdivided(points, faces, step(points), step, np.ones(3), 10_000)
    mesh = trimesh.Trimesh(positions, cut, process=False)
    assert not ended and 20 < len(cut) < 200 and (mesh.face_normals[:, 2] > 0.99).all() and abs(mesh.area - 64) < 1e-9
    sides, count = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    outer = sides[count == 1]
    assert np.isclose(np.linalg.norm(positions[outer[:, 0]] - positions[outer[:, 1]], axis=1).sum(), 32)
    assert np.array_equal(values, step(positions))
    assert subdivided(points, faces, step(points), step, np.ones(3), 3)[3]


class OnlyDlpack:
    """An array of another library."""

    def __init__(self, values):
        self.values = values

    def __dlpack__(self, **more):
        return self.values.__dlpack__(**more)

    def __dlpack_device__(self):
        return self.values.__dlpack_device__()


def test_arrays_come_by_dlpack_and_functions_give_values():
    at_vertices = load({name: OnlyDlpack(np.array(values)) for name, values in {**QUAD, "roughness": RAMP}.items()})
    by_function = load({**QUAD, "values": lambda points: {"roughness": points[:, 0], "base_color": np.abs(points)}})
    assert np.array_equal(at_vertices.corner_map["roughness"][..., 0], RAMP[at_vertices.faces])
    assert np.array_equal(by_function.corner_map["roughness"][..., 0], SQUARE[:, 0][by_function.faces])


def raises(points):
    raise RuntimeError("out of memory")


VOXELS = {"voxels": np.zeros((1, 3), np.int64), "resolution": 4, "metallic": np.zeros(1)}


@pytest.mark.parametrize("arrays, code", [
    ({**VOXELS}, "TXF-I43"),
    ({**QUAD, **VOXELS, "voxels": np.zeros((1, 2), np.int64)}, "TXF-I44"),
    ({**QUAD, **VOXELS, "voxels": np.full((1, 3), 4)}, "TXF-I44"),
    ({**QUAD, **VOXELS, "metallic": np.full(1, np.nan)}, "TXF-I44"),
    ({**QUAD, **VOXELS, "metallic": np.zeros(2)}, "TXF-I44"),
    ({**QUAD, **VOXELS, "metallic": np.array(["a"])}, "TXF-I44"),
    ({**QUAD, **VOXELS, "resolution": 0}, "TXF-I44"),
    ({**QUAD, **VOXELS, "resolution": "big"}, "TXF-I44"),
    ({**QUAD, "voxels": np.zeros((1, 3), np.int64), "resolution": 4}, "TXF-I44"),
    ({**QUAD, "values": raises}, "TXF-I45"),
    ({**QUAD, "values": lambda points: {"metallic": np.zeros(3)}}, "TXF-I45"),
    ({**QUAD, "values": lambda points: {"metallic": np.full(len(points), np.inf) - np.inf}}, "TXF-I45"),
    ({**QUAD, "values": lambda points: points}, "TXF-I45"),
    ({**QUAD, "faces": np.array([[0, 1, 9]]), "metallic": RAMP}, "TXF-I13"),
])
def test_arrays_that_do_not_fit_are_refused(arrays, code):
    assert code_of(lambda: load(arrays)) == code


def test_voxels_outside_the_cube_and_nan_are_left_out_with_a_warning():
    arrays = {**QUAD, "voxels": np.array([[0, 0, 0], [1, 1, 1], [-1, 0, 0], [9, 0, 0]]), "resolution": 4,
              "metallic": np.array([0.5, np.nan, 1, 1])}
    scene = load(arrays)
    assert np.unique(scene.corner_map["metallic"]).tolist() == [0.5] and len(scene.warnings) == 2
    assert code_of(lambda: load(arrays, strict=True)) == "TXF-I44"
    assert load(QUAD).dropped == ["the appearance (no values)"]


def npz(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def test_npz_is_read_by_content_and_never_unpickled(tmp_path):
    data = npz(**QUAD, **VOXELS)
    assert np.unique(load(data).corner_map["metallic"]).tolist() == [0.0]
    assert refusal(tmp_path, npz(**QUAD, roughness=np.array([{}], object)), "a.npz").code == "TXF-I42"
    assert refusal(tmp_path, data[:-40], "a.npz").code == "TXF-I42"
    swollen = data.replace(b"'shape': (4, 3)", b"'shape': (9, 9)")
    assert refusal(tmp_path, swollen, "a.npz").code == "TXF-I42"
    with pytest.raises(LimitError, match="TXF-I41"):
        load(npz(**QUAD, **{**VOXELS, "voxels": np.zeros((2, 3), np.int64), "metallic": np.zeros(2)}), limits=Limits(voxels=1))


@pytest.mark.parametrize("change", [
    lambda h: h.update(num_voxel=10**9), lambda h: h.update(num_voxel=h["num_voxel"] - 1), lambda h: h.update(chunk_size=12),
    lambda h: h.update(chunk_size=1 << 40), lambda h: h["chunks"][0].update(ptr=[0, 10**9]), lambda h: h.update(attr=[]),
    lambda h: h["chunks"][0].update(svo=[-1, 4]), lambda h: h["chunks"].pop(), lambda h: h.update(compression="rar"),
    lambda h: h.update(attr=[["metallic", 10**9]]), lambda h: h["chunks"][0].update(idx=[-9, 0, 0]), lambda h: h.pop("filter"),
])
def test_vxz_files_that_lie_about_their_chunks_are_refused(change):
    assert code_of(lambda: load(bent(write_vxz(shell(8)), change))) in ("TXF-I42", "TXF-I41")


def test_a_vxz_without_a_dual_grid_takes_its_surface_from_beside(tmp_path):
    arrays = {name: values for name, values in shell(8).items() if name not in ("dual_vertices", "intersected")}
    assert refusal(tmp_path, write_vxz(arrays), "a.vxz").code == "TXF-I43"
    (tmp_path / "a.mesh.npz").write_bytes(npz(**QUAD))
    assert len(load(tmp_path / "a.vxz").faces) >= 2
