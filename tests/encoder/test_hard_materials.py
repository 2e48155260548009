"""Materials that make no sense, or hardly any: defined results or coded errors."""

import math

import numpy as np
import pytest
from mesh_files import RED_BLUE, SQUARE, SQUARE_UV, TWO, Builder, encoded, load_bytes, refusal, textured
from PIL import Image
from shapes import mapped_sheet, noise, plain_image

from texfcodec.api import decode, encode
from texfcodec.bitstream.stream import read_stream, write_stream
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError, StreamError, TexfError
from texfcodec.limits import Limits
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import LARGEST, MAPS, PARAMETERS
from texfcodec.scene.scene import ALPHA_OPAQUE

QUICK = {"resolution": 32, "qp": 24}
BOTH = pytest.mark.parametrize("support", ["texels", "voxels"])


def coded(scene, **options):
    return decode(encode_scene(scene, EncodeOptions(**(QUICK | options))).data)


def refused(scene):
    with pytest.raises(InputError) as caught:
        encode(scene, EncodeOptions(**QUICK))
    return caught.value


# Images.


def forms():
    grey = np.random.default_rng(3).integers(0, 256, (8, 8), np.uint8)
    palette = Image.fromarray(grey).convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE)
    return {"grey": (encoded(grey), grey), "grey with alpha": (encoded(np.dstack([grey, 255 - grey])), grey),
            "16 bits": (encoded(Image.fromarray(grey.astype(np.uint16) * 256 + 77)), grey),
            "palette": (encoded(palette), np.asarray(palette.convert("RGB"))[..., 0]),
            "1 bit": (encoded(Image.fromarray(grey).point(lambda v: 255 * (v > 99), "1")), np.where(grey > 99, 255, 0)),
            "RGB": (encoded(np.dstack([grey] * 3)), grey)}


@pytest.mark.parametrize("form", forms())
def test_maps_in_any_form_of_png_have_the_same_values(tmp_path, form):
    data, grey = forms()[form]
    builder = textured()
    slot = {"index": builder.texture(data)}
    builder.tree["materials"][0] |= {"occlusionTexture": slot, "emissiveTexture": slot, "emissiveFactor": [1, 1, 1]}
    builder.tree["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"] = slot
    scene = load_bytes(tmp_path, builder, strict=True)
    assert len(scene.textures) == 2 and set(scene.materials[0].maps.values()) == {1}
    part = coded(scene, support="texels", max_error=0, qp=None).fields[0]
    support = part.support_of("roughness")
    xy = support.xy()
    for name in ("occlusion", "roughness", "metallic"):
        assert part.support_of(name).size == (8, 8) and np.array_equal(part.planes[name][:, 0], grey[xy[:, 1], xy[:, 0]])
    assert (np.ptp(part.planes["emissive"], axis=1) == 0).all()


def test_maps_of_different_sizes_in_one_material(tmp_path):
    builder = textured()
    sizes = {"occlusionTexture": 7, "normalTexture": 33, "emissiveTexture": 16}
    for slot, side in sizes.items():
        builder.tree["materials"][0][slot] = {"index": builder.texture(encoded(noise(side, side, side)[..., :3]))}
    builder.tree["materials"][0]["emissiveFactor"] = [1, 1, 1]
    scene = load_bytes(tmp_path, builder, strict=True)
    for support in ("texels", "voxels"):
        texf = coded(scene, support=support)
        assert set(texf.materials[0].maps) == {"occlusion", "normal", "emissive"}
        assert {c.material_name for c in texf.channels} == {"base_colour", "occlusion", "normal", "emissive"}
    assert coded(scene, support="texels").fields[0].support.size == (33, 33)


@BOTH
def test_a_map_that_cannot_be_read_leaves_the_factor(tmp_path, support):
    builder = textured()
    builder.tree["images"].append({"uri": "nowhere.png"})
    broken = {"index": builder.add("textures", {"source": 1})}
    builder.tree["materials"][0] |= {"normalTexture": broken, "emissiveTexture": broken, "emissiveFactor": [0, 0.5, 0]}
    scene = load_bytes(tmp_path, builder)
    assert sorted(scene.warnings) == ["texture file 'nowhere.png' is missing or unreadable; "
                                      f"{name} is drawn without it (TXF-I16)" for name in ("emissive", "normal")]
    material = coded(scene, support=support).materials[0]
    assert material.maps == {} and material.parameters == {"emissive": (0.0, 0.5, 0.0)}
    assert refusal(tmp_path, builder, strict=True).code == "TXF-I16"


def test_alpha_without_an_alpha_mode_is_not_seen():
    clear = noise(0)
    clear[..., 3] = noise(1)[..., 0]
    texf = coded(mapped_sheet({"roughness": noise(2)}, clear, factor=np.array([1, 1, 1, 0.25])), support="texels")
    assert not texf.has_alpha and texf.materials[0].alpha_mode == ALPHA_OPAQUE and (texf.fields[0].rgba[:, 3] == 255).all()


# Normals and tangents.


@BOTH
@pytest.mark.parametrize("bad", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [1e-30, 0, 0]])
def test_broken_normals_and_tangents_are_mended_and_coded(tmp_path, support, bad):
    normal, tangent = np.tile(np.float32([0, 0, 1]), (4, 1)), np.tile(np.float32([1, 0, 0, 1]), (4, 1))
    normal[1], tangent[2, :3], tangent[3, 3] = bad, bad, 0
    builder = Builder()
    material = builder.material(builder.texture(encoded(RED_BLUE)))
    builder.tree["materials"][0]["normalTexture"] = {"index": builder.texture(encoded(noise(1, 8, 8)[..., :3]))}
    builder.primitive(uv=SQUARE_UV, material=material,
                      attributes={"NORMAL": builder.accessor(normal), "TANGENT": builder.accessor(tangent)})
    scene = load_bytes(tmp_path, builder, strict=True)
    assert np.isfinite(scene.corner_normal).all() and np.isfinite(scene.corner_tangent).all()
    assert len(scene.remarks) == 1 and scene.warnings == scene.dropped == []
    texf = coded(scene, support=support)
    assert set(texf.materials[0].maps) == {"normal"} and np.isfinite(texf.shading_normals()).all()


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
    for wrong in ("bright", [1, 2], [1, 2, None], 10**400, {}):
        builder.tree["materials"][0]["emissiveFactor"] = wrong
        assert refusal(tmp_path, builder).code == "TXF-I09"


@pytest.mark.parametrize("slot, wrong", [
    ("normalTexture", {"index": 99}), ("normalTexture", {"index": -1}), ("normalTexture", {"index": 0, "scale": "1"}),
    ("occlusionTexture", {"index": 0, "strength": []}), ("occlusionTexture", []), ("normalTexture", {"texCoord": 0}),
    ("extensions", []), ("extensions", {"KHR_materials_clearcoat": 3}),
    ("extensions", {"KHR_materials_sheen": {"sheenColorFactor": [1]}}),
    ("extensions", {"KHR_materials_ior": {"ior": None}}), ("alphaMode", 3), ("alphaCutoff", "x"), ("doubleSided", 1)], ids=str)
def test_bent_materials_load_or_end_in_a_code(tmp_path, slot, wrong):
    builder = textured()
    builder.tree["materials"][0][slot] = wrong
    try:
        scene = load_bytes(tmp_path, builder)
    except TexfError as error:
        assert error.code == "TXF-I09"
        return
    assert len(scene.faces) == 2 and coded(scene).materials[0].double_sided is False


# Streams whose tables lie.


@pytest.mark.parametrize("lie", ["channel that no group holds", "group that no material names", "twice"])
def test_tables_of_channels_that_lie_are_refused(lie):
    scene = mapped_sheet({"roughness": noise(1)}, plain_image(9))
    stream = read_stream(encode_scene(scene, EncodeOptions(support="voxels", **QUICK)).data, Limits())
    if lie == "channel that no group holds":
        stream.materials[0]["material_channels"] |= 1 << next(c.semantic for c in MAPS if c.name == "occlusion")
    elif lie == "group that no material names":
        stream.materials[0]["material_channels"] = 0
    else:
        stream.header["channel_groups"][1] = stream.header["channel_groups"][0]
    with pytest.raises(StreamError) as caught:
        decode(write_stream(stream)[0])
    assert caught.value.code in ("TXF-S04", "TXF-S07", "TXF-S11", "TXF-S14")
