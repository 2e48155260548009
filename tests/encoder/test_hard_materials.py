"""Materials that make no sense, or hardly any: defined results or coded errors."""

import math

import numpy as np
import pytest
from mesh_files import SQUARE, TWO, Builder, encoded, load_bytes, textured
from shapes import mapped_sheet, noise

from texfcodec.api import decode, encode
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError, TexfError
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import LARGEST, PARAMETERS
from texfcodec.scene.scene import ALPHA_OPAQUE

QUICK = {"resolution": 32, "qp": 24}
BOTH = pytest.mark.parametrize("support", ["texels", "voxels"])


def coded(scene, **options):
    return decode(encode_scene(scene, EncodeOptions(**(QUICK | options))).data)


def refused(scene):
    with pytest.raises(InputError) as caught:
        encode(scene, EncodeOptions(**QUICK))
    return caught.value


# Alpha, and normal maps.


def test_alpha_without_an_alpha_mode_is_not_seen():
    clear = noise(0)
    clear[..., 3] = noise(1)[..., 0]
    texf = coded(mapped_sheet({"roughness": noise(2)}, clear, factor=np.array([1, 1, 1, 0.25])), support="texels")
    assert not texf.has_alpha and texf.materials[0].alpha_mode == ALPHA_OPAQUE and (texf.fields[0].rgba[:, 3] == 255).all()


@BOTH
def test_a_normal_map_without_uvs_or_with_uvs_of_no_area_is_coded(tmp_path, support):
    for uv in (None, np.zeros((4, 2), np.float32), np.float32([[0.5, 0], [0.5, 1], [0.5, 0.2], [0.5, 0.7]])):
        builder = Builder()
        material = builder.material(builder.texture(encoded(noise(0, 8, 8)[..., :3])))
        builder.tree["materials"][0]["normalTexture"] = {"index": builder.texture(encoded(noise(1, 8, 8)[..., :3]))}
        builder.primitive(positions=SQUARE, indices=TWO, uv=uv, material=material)
        scene = load_bytes(tmp_path, builder)
        assert bool(scene.warnings) == (uv is None)
        texf = coded(scene, support=support)
        assert np.isfinite(texf.shading_normals()).all() and len(texf.faces) == 2


# Parameters and maps of a Scene made in memory.


@pytest.mark.parametrize("parameters", [
    {"roughness": (math.nan,)}, {"roughness": (math.inf,)}, {"roughness": (0.5, 0.5)}, {"emissive": (1.0,)}, {"roughness": ()},
    {"shininess": (1.0,)}, {"roughness": ("rough",)}, {"roughness": None}, {"roughness": 0.5}, {7: (1.0,)}], ids=str)
def test_parameters_that_are_none_are_refused(parameters):
    error = refused(mapped_sheet({"roughness": noise(1)}, parameters=parameters))
    assert error.code in ("TXF-I14", "TXF-I22") and "parameter" in error.message


@pytest.mark.parametrize("maps", [{"roughness": 9}, {"roughness": -2}, {"gloss": 0}, {"base_colour": 0}, {"normal_object": 0},
                                  {"roughness": "0"}, {"roughness": None}], ids=str)
def test_maps_that_name_no_texture_or_no_channel_are_refused(maps):
    scene = mapped_sheet({})
    scene.materials[0].maps = maps
    error = refused(scene)
    assert error.code == "TXF-I22" and "map" in error.message


@pytest.mark.parametrize("name", ["positions", "faces", "face_material", "corner_uv", "corner_color", "corner_normal"])
@pytest.mark.parametrize("change", [lambda a: 3, lambda a: "a", lambda a: a.tolist(), lambda a: a.astype("U3"),
                                    lambda a: a.astype(complex), lambda a: a.astype(object), lambda a: np.float64(1)],
                         ids=range(7))
def test_what_is_no_array_of_numbers_is_refused_by_its_name(name, change):
    scene = mapped_sheet({})
    corners = (len(scene.faces), 3)
    scene.corner_color, scene.corner_normal = np.ones((*corners, 4), np.float32), np.zeros((*corners, 3), np.float32)
    setattr(scene, name, change(getattr(scene, name)))
    error = refused(scene)
    assert error.code == "TXF-I22" and name in error.message


def test_uvs_of_maps_have_to_fit_the_faces():
    scene = mapped_sheet({"roughness": noise(1)})
    scene.map_uv = {"roughness": scene.corner_uv[:-1]}
    assert refused(scene).code == "TXF-I22"
    scene.map_uv = {"roughness": np.full_like(scene.corner_uv, np.nan)}
    assert refused(scene).code == "TXF-I14"


@BOTH
@pytest.mark.parametrize("value", [-1.0, 1e9, 1e300, -1e300, 1e-300])
def test_numbers_beyond_their_range_travel_as_far_as_binary32_goes(support, value):
    given = {p.name: (value,) * p.count for p in PARAMETERS}
    scene = mapped_sheet({"roughness": noise(1), "normal": noise(2)}, parameters=given)
    (material,) = coded(scene, support=support).materials
    expected = float(np.float32(min(max(value, -LARGEST), LARGEST)))
    for parameter in PARAMETERS:
        got = material.parameters.get(parameter.name, parameter.default)
        assert got == (expected,) * parameter.count, parameter.name


def test_huge_numbers_of_a_file_are_the_largest_that_a_stream_holds(tmp_path):
    builder = textured()
    builder.tree["materials"][0] |= {"emissiveFactor": [1e300, -1e300, 1e-60]}
    scene = load_bytes(tmp_path, builder)
    assert scene.materials[0].parameters == {"emissive": (LARGEST, -LARGEST, 0.0)}


@pytest.mark.parametrize("slot, wrong", [
    ("normalTexture", {"index": 99}), ("normalTexture", {"index": -1}), ("normalTexture", {"index": 0, "scale": "1"}),
    ("occlusionTexture", {"index": 0, "strength": []}), ("occlusionTexture", []), ("normalTexture", {"texCoord": 0}),
    ("extensions", []), ("extensions", {"KHR_materials_clearcoat": 3}),
    ("extensions", {"KHR_materials_sheen": {"sheenColorFactor": [1]}}),
    ("extensions", {"KHR_materials_ior": {"ior": None}}), ("alphaMode", 3), ("alphaCutoff", "x"), ("doubleSided", 1),
    ("emissiveFactor", [1, 2, None]), ("emissiveFactor", 10**400)], ids=str)
def test_bent_materials_load_or_end_in_a_code(tmp_path, slot, wrong):
    builder = textured()
    builder.tree["materials"][0][slot] = wrong
    try:
        scene = load_bytes(tmp_path, builder)
    except TexfError as error:
        assert error.code == "TXF-I09"
        return
    assert len(scene.faces) == 2 and scene.materials[0].double_sided is False
