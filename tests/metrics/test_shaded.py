"""texf-eval --shaded compares like with like: normals and TANGENTs as a side has them, frames of UVs where it has none."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import domed, mapped_sheet

from texfcodec import EncodeOptions, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.geometry.tangents import corner_tangents
from texfcodec.io.load import load
from texfcodec.metrics.shaded import compare_channels, compare_shaded
from texfcodec.render.lighting import Lighting
from texfcodec.scene.scene import WRAP_CLAMP, Texture

TEXELS = EncodeOptions(support="texels", lossless=True, partition="off", refine="off")
VOXELS = EncodeOptions(resolution=96, qp=8, partition="off", refine="off")
SIDE = 10


def waves(side=64):
    """A normal map of waves along u and v that lean by up to 30 degrees, uint8 [side, side, 4]."""
    v, u = (np.mgrid[:side, :side] + 0.5) / side
    x, y = 0.5 * np.sin(6 * np.pi * u), 0.4 * np.cos(4 * np.pi * v + 1)
    return np.rint(127.5 * (1 + np.stack([x, y, np.sqrt(1 - x * x - y * y), np.ones_like(x)], -1))).astype(np.uint8)


@pytest.fixture
def dome():
    """A bent sheet with a normal map, and normals that no rule makes: all lean towards +x."""
    colours = np.roll(waves(32), 1, axis=2)
    colours[..., 3] = 255
    scene = domed(mapped_sheet({"normal": waves()}, colours, SIDE, (WRAP_CLAMP, WRAP_CLAMP),
                               parameters={"roughness": (0.4,), "metallic": (0.5,)}))
    normal = np.insert(1.6 * (scene.positions[:, :2] - 0.5) + [0.4, 0], 2, 1, axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return replace(scene, corner_normal=normal[scene.faces].astype(np.float32))


def made(scene, uv=None):
    """TANGENTs of a scene's UVs."""
    return corner_tangents(scene.positions, scene.faces, scene.corner_uv if uv is None else uv, scene.corner_normal)


def across(scene):
    """TANGENTs a quarter turn from those of the UVs."""
    tangent = made(scene)
    return np.concatenate([np.cross(scene.corner_normal, tangent[..., :3]), tangent[..., 3:]], axis=2).astype(np.float32)


def apart(one, other):
    """Median degrees between shading normals, (without the map, with it)."""
    found = compare_channels(one, other, 4000)["normals"]
    return found["without_map"]["median_degrees"], found["with_map"]["median_degrees"]


def test_normals_are_the_files_on_either_side(dome):
    smooth = replace(dome, corner_normal=None)
    assert min(apart(dome, smooth)) > 5 and min(apart(smooth, dome)) > 5
    assert max(apart(dome, replace(dome))) == 0


def test_tangents_are_the_files_on_either_side_and_made_of_uvs_where_there_are_none(dome):
    given, turned = replace(dome, corner_tangent=made(dome)), replace(dome, corner_tangent=across(dome))
    assert max(apart(dome, given)) < 1e-3 and max(apart(given, dome)) < 1e-3
    for one, other in ((dome, turned), (turned, dome)):
        plain, mapped = apart(one, other)
        assert plain == 0 and mapped > 5
    half = turned.corner_tangent.copy()
    half[::2] = 0
    mixed = Lighting(replace(dome, corner_tangent=half)).maps.corner_tangent("normal")
    np.testing.assert_array_equal(mixed[1::2], half[1::2])
    whole = made(dome)
    assert (np.einsum("fck,fck->fc", mixed[::2, :, :3], whole[::2, :, :3]) > 0.9).mean() > 0.9  # averaged over fewer faces


def test_a_mirrored_tangent_with_a_mirrored_map_is_the_same_surface(dome):
    mirrored = replace(dome, corner_tangent=made(dome) * np.float32([1, 1, 1, -1]), textures=list(dome.textures))
    image = waves()
    image[..., 1] = 255 - image[..., 1]
    mirrored.textures[-1] = Texture(image, (WRAP_CLAMP, WRAP_CLAMP))
    assert max(apart(dome, mirrored)) < 1e-3


def test_tangents_of_the_file_hold_for_maps_with_uvs_of_their_own(dome):
    own = np.stack([dome.corner_uv[..., 1], 1 - dome.corner_uv[..., 0]], axis=2)
    scene = replace(dome, map_uv={"normal": own}, corner_tangent=across(dome))
    lighting = Lighting(scene)
    np.testing.assert_array_equal(lighting.maps.corner_tangent("normal"), scene.corner_tangent)
    free = replace(scene, corner_tangent=None)
    np.testing.assert_allclose(Lighting(free).maps.corner_tangent("normal"), made(dome, own), atol=1e-6)
    texf = decode(encode_scene(scene, VOXELS).data)
    assert apart(scene, texf)[1] < 4 < apart(free, texf)[1]


@pytest.mark.parametrize("options", [TEXELS, VOXELS], ids=["texels", "voxels"])
@pytest.mark.parametrize("tangents", [None, made, across], ids=["none", "of the UVs", "others"])
def test_a_stream_and_its_mesh_are_lit_as_each_other_and_as_their_source(dome, tmp_path, options, tangents):
    dome.corner_tangent = tangents(dome) if tangents else None
    texf = decode(encode_scene(dome, options).data)
    texf.save(tmp_path / "back.glb")
    back = load(tmp_path / "back.glb")
    assert back.corner_normal is not None and back.corner_tangent is not None
    streamed, meshed = (compare_shaded(dome, side, views=2, size=128)["psnr"]["y"] for side in (texf, back))
    assert min(streamed, meshed) > (40 if options is TEXELS else 33) and abs(streamed - meshed) < 3
    assert max(apart(dome, texf)) < 3 and max(apart(dome, back)) < 4
