"""Fields over texels from end to end: what a decoder gives back, what the tools say of them, and UVs of real assets."""

import json

import numpy as np
import pytest
from conftest import REPOSITORY

from texfcodec import EncodeOptions, decode, inspect
from texfcodec.encoder.encode import encode_scene
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

