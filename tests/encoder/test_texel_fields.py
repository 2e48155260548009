"""Fields over texels from end to end: what a decoder gives back, what the tools say of them, and UVs of real assets."""

import json

import numpy as np
import pytest
from conftest import REPOSITORY

from texfcodec import EncodeOptions, decode, inspect
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.geometry import draco
from texfcodec.geometry.draco import UvCoding, counts_of, dec_textured, enc_textured
from texfcodec.io.load import load
from texfcodec.scene.scene import Material, Scene, Texture

TEXELS = EncodeOptions(support="texels", lossless=True, partition="off", refine="off")


def vector(name):
    return (REPOSITORY / "conformance" / name / "in.texf").read_bytes()


def tiled(scale=1.0, shift=0.0, repeats=(3, -2)):
    """A folded strip of two faces under a tiled image of noise."""
    side = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    positions = np.column_stack([side, side[:, 0] * 0.3]) * scale + shift
    image = np.random.default_rng(2).integers(0, 256, (11, 14, 4), np.uint8)
    image[..., 3] = 255
    uv = (side * repeats + 0.21)[faces]
    return Scene(positions, faces, np.zeros(2, np.int64), uv, None, [Material("wall", texture=0)], [Texture(image, (0, 2))])


@pytest.mark.parametrize("scale, shift", [(1.0, 0.0), (1e140, 3e141), (1e-280, 0.0), (7.0, 1e6)])
def test_lossless_texels_answer_as_the_texture_does_at_any_scale(scale, shift):
    from texfcodec.scene.fetch import pack_source, sample_source

    scene = tiled(scale, shift)
    texf = decode(encode_scene(scene, TEXELS).data)
    assert [f.over_texels for f in texf.fields] == [True] and len(texf.fields[0].support) == 11 * 14
    bary = np.random.default_rng(0).dirichlet([1, 1, 1], 300)
    for face in range(2):
        wanted = sample_source(pack_source(scene), np.full(300, face), bary)
        points = bary @ scene.positions[scene.faces[face]]
        got = texf.query(points, np.array([_same_face(texf, scene, face)] * 300))
        steps = 2.0 ** -texf.fields[0].support.fraction_bits
        slack = 255 * 2 * (steps + 3 * 14 / (1 << texf.position_bits) + 3 * 14 * abs(shift) / scale * 2e-16)
        assert np.abs(got - wanted).max() < slack < 80, (np.abs(got - wanted).max(), slack)


def _same_face(texf, scene, face):
    """The decoded face with the corners of a face of the scene."""
    wanted = {tuple(p) for p in texf.cube.to_lattice(scene.positions)[scene.faces[face]].tolist()}
    (found,) = [i for i, f in enumerate(texf.faces) if {tuple(p) for p in texf.lattice_positions[f].tolist()} == wanted]
    return found


def test_lossless_texels_are_the_texture():
    scene = tiled()
    texf = decode(encode_scene(scene, TEXELS).data)
    support = texf.fields[0].support
    assert np.array_equal(support.image(texf.fields[0].planes["base_colour"]), scene.textures[0].image[..., :3])


# What the tools say


def test_inspect_counts_voxels_and_texels_apart():
    facts = inspect(vector("uncommon/texels_mixed"))
    assert (facts["voxels"], facts["texels"], facts["resolution"]) == (4, 13 * 9 + 8 * 8, 6)
    first, second, third = facts["fields"]
    assert (first["support"], first["width"], first["height"], first["resolution"]) == (1, 13, 9, None)
    assert (second["support"], second["resolution"], second["width"]) == (0, 6, None)
    assert [f["geometry_units"] for f in facts["fields"]] == [1, 1, 1] and third["uv_fraction_bits"] == 2
    json.dumps(facts)
    only = inspect(vector("subset/texels_repeat"))
    assert (only["voxels"], only["texels"], only["resolution"]) == (0, 24 * 16, None)
    assert inspect(vector("subset/k3"))["texels"] == 0


def test_info_says_of_a_field_over_texels_what_it_is(call, tmp_path):
    lines = {name: call("texf-info", REPOSITORY / "conformance" / name / "in.texf")[1].splitlines()
             for name in ("uncommon/texels_mixed", "subset/texels_repeat", "subset/k3", "uncommon/empty")}
    mixed = lines["uncommon/texels_mixed"]
    assert mixed[1].startswith("180 vertices") or "4 voxels, 181 texels, 10 bits" in mixed[1]
    assert "attribute bits per voxel or texel" in mixed[1]
    assert mixed[3] == "field 0: 117 texels of 13 x 9, clamp x clamp, UVs in 1/16 texel"
    assert mixed[4] == "field 1: K 6, 4 voxels"
    assert mixed[5] == "field 2: 64 texels of 8 x 8, mirror x mirror, UVs in 1/4 texel"
    assert "384 texels, 10 bits" in lines["subset/texels_repeat"][1] and "per texel" in lines["subset/texels_repeat"][1]
    assert "voxels, 14 bits" in lines["subset/k3"][1] and "per voxel" in lines["subset/k3"][1]
    assert "0 voxels, " in lines["uncommon/empty"][1] and "per" not in lines["uncommon/empty"][1]


# Real assets


@pytest.mark.parametrize("name", ["cat_webp", "damaged_helmet", "avocado", "vintage_fan", "house_mask"])
def test_uvs_of_real_assets_come_back_exactly(shared_dir, name):
    """Both codings, a unit per material, UVs in 1/16 of a texel of an image of 2048, with their charts, seams and turns."""
    path = shared_dir / "assets" / f"{name}.glb"
    if not path.is_file():
        pytest.skip(f"{path.name} is not among the shared assets")
    scene = load(path)
    low, side = scene.positions.min(axis=0), np.ptp(scene.positions, axis=0).max()
    lattice = np.floor((scene.positions - low) / side * 16383 + 0.5).astype(np.int64)
    for material in np.unique(scene.face_material)[:3]:
        faces = scene.faces[scene.face_material == material]
        area = np.cross(*(lattice[faces[:, k]] - lattice[faces[:, 0]] for k in (1, 2))).any(axis=1)
        uv = np.floor(scene.corner_uv[scene.face_material == material][area] * 2048 * 16 + 0.5).astype(np.int64)
        uv -= uv.min(axis=(0, 1))
        faces = faces[area]
        near = (uv < 1 << draco.MAX_UV_BITS).all(axis=(1, 2))
        assert near.mean() > 0.5
        corners = np.column_stack([lattice[faces[near].reshape(-1)], uv[near].reshape(-1, 2)])
        unique, local = np.unique(corners, axis=0, return_inverse=True)
        wanted = faces_of(unique[local.reshape(-1, 3)])
        data, coding = enc_textured(unique[:, :3], local.reshape(-1, 3), unique[:, 3:] - unique[:, 3:].min(axis=0), 14)
        other = UvCoding(0, coding.range) if coding.bits else UvCoding(draco._exact_bits(coding.range), coding.range)
        both = [(data, coding)]
        if other.bits <= draco.MAX_UV_BITS:
            more = {"tex_coord": unique[:, 3:].astype(np.float64), "tex_coord_quantization_bits": other.bits} if other.bits else \
                {"generic_attributes": {1: unique[:, 3:].astype(np.uint32)}}
            both.append((draco._encode(unique[:, :3], local.reshape(-1, 3), **more), other))
        for bytes_, how in both:
            points, decoded, uv_back = dec_textured(bytes_, *counts_of(bytes_), how, 14)
            assert np.array_equal(faces_of(np.column_stack([points, uv_back])[decoded]), wanted), (name, material, how)


def faces_of(corners):
    """Rows [F, 15] of faces of corners int64 [F, 3, 5], each from its least corner on, in ascending order."""
    order = np.lexsort(corners.reshape(-1, 5).T)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    values = corners.reshape(-1, 5)[order]
    same = np.concatenate([[0], np.cumsum((values[1:] != values[:-1]).any(axis=1))])
    rank = same[rank].reshape(-1, 3)
    first = rank.argmin(axis=1)
    turned = np.take_along_axis(corners, ((first[:, None] + np.arange(3)) % 3)[:, :, None], axis=1).reshape(len(corners), -1)
    return turned[np.lexsort(turned.T[::-1])]
