"""glTF, and objects in memory: every feature on small files made here, every fault with its code, and the 20 real assets where
they are."""

import base64
import json
import struct
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from mesh_files import COMPONENTS, RED_BLUE, SQUARE, SQUARE_UV, TWO, Builder, encoded, facing, outcome, textured
from PIL import Image

from texfcodec.errors import InputError, LimitError, TexfError
from texfcodec.io.load import load
from texfcodec.scene.channels import MAPS
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Scene

# glTF: geometry.


def test_square_arrives_as_declared(loaded):
    scene = loaded(textured())
    assert scene.positions.dtype == np.float64 and scene.faces.dtype == np.int64 and scene.corner_uv.dtype == np.float64
    np.testing.assert_array_equal(scene.positions[scene.faces], SQUARE[TWO])
    np.testing.assert_array_equal(scene.corner_uv, SQUARE_UV[TWO])
    assert scene.textures[0].image.shape == (1, 2, 4) and scene.textures[0].image.dtype == np.uint8
    assert scene.textures[0].image[0].tolist() == [[255, 0, 0, 255], [0, 0, 255, 255]]
    assert scene.face_material.tolist() == [0, 0] and scene.materials[0].texture == 0 and scene.corner_color is None
    assert scene.metadata == {"generator": "test", "nodes": ["node"], "meshes": ["mesh"]}
    assert scene.warnings == [] and scene.dropped == [] and scene.remarks == []


@pytest.mark.parametrize("mode, indices, faces", [
    (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
    (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
    (4, [0, 1, 2, 0, 2, 3, 1], [[0, 1, 2], [0, 2, 3]]),
    (6, None, [[1, 2, 0], [2, 3, 0]]),
])
def test_strips_fans_and_missing_indices(loaded, mode, indices, faces):
    builder = Builder()
    builder.primitive(indices=None if indices is None else np.array(indices, np.uint8), mode=mode)
    scene = loaded(builder)
    assert scene.faces.tolist() == faces
    assert bool(scene.remarks) == (mode == 4) and scene.warnings == []


def test_points_and_lines_are_left_out_with_a_warning(loaded):
    builder = Builder()
    for mode in range(5):
        builder.primitive(mode=mode)
    scene = loaded(builder)
    assert len(scene.faces) == 2 and len(scene.positions) == 4
    assert sum("not made of triangles" in warning for warning in scene.warnings) == 4


def test_interleaved_and_strided_attributes(loaded):
    builder = Builder()
    rows = np.hstack([SQUARE, SQUARE_UV, np.full((4, 1), 9, np.float32)])
    view = builder.view(rows.tobytes(), byteStride=24)
    builder.tree["accessors"] = [
        {"bufferView": view, "componentType": 5126, "type": "VEC3", "count": 4},
        {"bufferView": view, "byteOffset": 12, "componentType": 5126, "type": "VEC2", "count": 4}]
    material = builder.material(builder.texture(encoded(RED_BLUE)))
    builder.tree["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": material,
                                                "indices": builder.accessor(TWO.astype(np.uint32).reshape(-1))}]
    scene = loaded(builder)
    np.testing.assert_array_equal(scene.positions, SQUARE)
    np.testing.assert_array_equal(scene.corner_uv, SQUARE_UV[TWO])


def sparse(builder, rows, values):
    return {"count": len(rows), "values": {"bufferView": builder.view(values.tobytes())},
            "indices": {"bufferView": builder.view(rows.tobytes()), "componentType": COMPONENTS[rows.dtype.str[1:]]}}


def test_sparse_accessors_with_and_without_a_base(loaded):
    builder = Builder()
    primitive = builder.primitive()
    accessors = builder.tree["accessors"]
    accessors[primitive["attributes"]["POSITION"]]["sparse"] = sparse(
        builder, np.array([2], np.uint8), np.array([[5, 6, 7]], np.float32))
    scene = loaded(builder)
    assert scene.positions[2].tolist() == [5, 6, 7] and scene.positions[1].tolist() == [1, 0, 0]
    del accessors[primitive["attributes"]["POSITION"]]["bufferView"]
    assert loaded(builder).positions.tolist() == [[0, 0, 0], [0, 0, 0], [5, 6, 7], [0, 0, 0]]


@pytest.mark.parametrize("kind, full", [("u1", 255), ("u2", 65535), ("i1", 127), ("i2", 32767)])
def test_normalized_integers_become_fractions(loaded, kind, full):
    builder = textured()
    uv = builder.accessor((SQUARE_UV * full).astype(kind), normalized=True)
    builder.tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uv
    np.testing.assert_allclose(loaded(builder).corner_uv, SQUARE_UV[TWO], atol=1e-12)


def test_quantized_positions_are_scaled_by_their_node(loaded):
    builder = Builder()
    builder.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    builder.primitive(positions=np.hstack([SQUARE * 100, np.zeros((4, 1))])[:, :3].astype(np.int16))
    builder.tree["nodes"][0]["scale"] = [0.01] * 3
    np.testing.assert_allclose(loaded(builder).positions, SQUARE, atol=1e-12)


def test_nodes_place_instance_and_mirror(loaded):
    builder = Builder()
    builder.primitive()
    turn = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # a quarter turn about z
    builder.tree["nodes"] = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "rotation": turn, "scale": [2, 1, 1], "translation": [0, 0, 5]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]
    scene = loaded(builder)
    assert len(scene.positions) == 8 and scene.faces.tolist()[2:] == [[4, 6, 5], [4, 7, 6]]
    np.testing.assert_allclose(scene.positions[1], [10, 2, 5], atol=1e-12)
    np.testing.assert_allclose(scene.positions[5], [9, 0, 0], atol=1e-12)
    assert (facing(scene)[:, 2] > 0).all()


def test_only_the_default_scene_is_loaded(loaded):
    builder = Builder()
    builder.primitive()
    builder.tree["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [7, 0, 0]}]
    builder.tree |= {"scenes": [{"nodes": [0]}, {"nodes": [1], "name": "second"}], "scene": 1}
    scene = loaded(builder)
    assert scene.positions[0].tolist() == [7, 0, 0]
    assert scene.remarks == ["scene 0 is not the default and is left out"] and scene.dropped == []
    del builder.tree["scene"], builder.tree["scenes"]
    assert len(loaded(builder).faces) == 4


def test_morph_defaults_are_applied(loaded):
    builder = Builder()
    builder.primitive(targets=[{"POSITION": builder.accessor(np.ones((4, 3), np.float32))}])
    builder.tree["meshes"][0]["weights"] = [0.5]
    scene = loaded(builder)
    np.testing.assert_allclose(scene.positions, SQUARE + 0.5)
    assert "morph targets" in scene.dropped


def test_draco_primitives(loaded, refused):
    DracoPy = pytest.importorskip("DracoPy")
    packed = DracoPy.encode(SQUARE, TWO.astype(np.uint32), tex_coord=SQUARE_UV.astype(float), quantization_bits=16)
    ids = {entry["attribute_type"]: entry["unique_id"] for entry in DracoPy.decode(packed).attributes}
    builder = textured()
    primitive = builder.tree["meshes"][0]["primitives"][0]
    draco = {"bufferView": builder.view(packed), "attributes": {"POSITION": ids[0], "TEXCOORD_0": ids[3]}}
    primitive["extensions"] = {"KHR_draco_mesh_compression": draco}
    builder.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    for index in primitive["attributes"].values():
        del builder.tree["accessors"][index]["bufferView"]
    scene = loaded(builder)
    assert len(scene.faces) == 2
    expected = np.hstack([SQUARE[:, :2], SQUARE_UV])[TWO.reshape(-1)]
    found = np.hstack([scene.positions[scene.faces.reshape(-1), :2], scene.corner_uv.reshape(-1, 2)])
    np.testing.assert_allclose(np.unique(found.round(2), axis=0), np.unique(expected, axis=0))
    draco["bufferView"] = builder.view(b"DRACO, not really")
    assert refused(builder).code == "TXF-I12"


# glTF: appearance.


@pytest.mark.parametrize("code, wrap", [(10497, WRAP_REPEAT), (33071, WRAP_CLAMP), (33648, WRAP_MIRROR)])
def test_wrap_modes(loaded, code, wrap):
    assert loaded(textured(wrapS=code)).textures[0].wrap == (wrap, WRAP_REPEAT)
    assert loaded(textured(wrapT=code)).textures[0].wrap == (WRAP_REPEAT, wrap)


def test_one_image_under_two_samplers_is_two_textures_and_one_array(loaded):
    builder = textured(wrapS=33071)
    other = builder.add("textures", {"source": 0})
    builder.primitive(uv=SQUARE_UV, material=builder.material(other))
    builder.primitive(uv=SQUARE_UV, material=builder.material(builder.add("textures", {"source": 0})))
    scene = loaded(builder)
    assert len(scene.textures) == 2 and scene.textures[0].image is scene.textures[1].image
    assert [material.texture for material in scene.materials] == [0, 1, 1]
    assert scene.face_material.tolist() == [0, 0, 1, 1, 2, 2]


def test_texture_transform_scales_turns_and_moves(loaded):
    builder = textured()
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.25]}
    info = builder.tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    info["extensions"] = {"KHR_texture_transform": transform}
    u, v = SQUARE_UV[TWO][..., 0], SQUARE_UV[TWO][..., 1]
    np.testing.assert_allclose(loaded(builder).corner_uv, np.stack([0.25 * v, 1 - 0.5 * u], axis=2), atol=1e-12)


def test_texture_transform_may_choose_the_uv_set(loaded):
    builder = textured()
    attributes = builder.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_1"] = builder.accessor(SQUARE_UV * 3)
    info = builder.tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    scene = loaded(builder)
    assert scene.remarks == ["no image uses TEXCOORD_1; it is left out"] and scene.dropped == []
    info["texCoord"] = 1
    scene = loaded(builder)
    assert scene.corner_uv.max() == 3 and scene.remarks == ["no image uses TEXCOORD_0; it is left out"]
    info |= {"texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    assert loaded(builder).corner_uv.max() == 3


@pytest.mark.parametrize("array, expected", [
    (np.array([[0.25, 0.5, 1, 0.5]] * 4, np.float32), [0.25, 0.5, 1, 0.5]),
    (np.array([[0, 51, 255]] * 4, np.uint8), [0, 0.2, 1, 1]),
    (np.array([[0, 13107, 65535, 13107]] * 4, np.uint16), [0, 0.2, 1, 0.2]),
    (np.array([[2, -1, np.nan]] * 4, np.float32), [1, 0, 1, 1]),
])
def test_vertex_colors_stay_linear(loaded, array, expected):
    builder = textured()
    builder.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = builder.accessor(
        array, normalized=array.dtype.kind == "u")
    builder.primitive()
    scene = loaded(builder)
    assert scene.corner_color.dtype == np.float32
    np.testing.assert_allclose(scene.corner_color[0], [expected] * 3, atol=1e-6)
    assert (scene.corner_color[2:] == 1).all() and len(scene.textures) == 1
    assert scene.materials[1].texture == -1 and scene.materials[1].factor.tolist() == [1] * 4


def test_material_properties_are_kept_and_the_rest_is_named_once(loaded):
    builder = textured()
    extra = builder.texture(encoded(RED_BLUE))
    builder.tree["materials"][0] |= {
        "name": "bottle", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True, "normalTexture": {"index": extra},
        "emissiveFactor": [1, 0, 0], "extras": {"shelf": 7}, "gloss": 1,
        "extensions": {"KHR_materials_unlit": {}, "KHR_materials_clearcoat": {"clearcoatTexture": {"index": extra}, "wax": 2},
                       "ACME_paint": {"paintTexture": {"index": extra}}}}
    builder.tree["materials"][0]["pbrMetallicRoughness"] |= {
        "baseColorFactor": [0.5, 0.25, 1, 0.75], "metallicRoughnessTexture": {"index": extra}, "metallicFactor": 1}
    builder.add("materials", {"name": "spare"})
    attributes = builder.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes |= {"NORMAL": attributes["POSITION"], "_HEAT": attributes["POSITION"]}
    builder.tree |= {"animations": [{"name": "walk"}], "skins": [{}], "cameras": [{}],
                     "extensions": {"KHR_lights_punctual": {"lights": []}, "KHR_materials_variants": {"variants": []}}}
    builder.tree["nodes"][0] |= {"skin": 0, "camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}
    scene = loaded(builder)
    material = scene.materials[0]
    assert material.factor.tolist() == [0.5, 0.25, 1, 0.75] and material.name == "bottle"
    assert (material.alpha_mode, material.alpha_cutoff, material.double_sided, material.unlit) == (ALPHA_MASK, 0.25, True, True)
    assert material.maps == {"normal": 1, "roughness": 1, "metallic": 1, "clearcoat": 1}
    assert material.parameters == {"emissive": (1.0, 0.0, 0.0)}  # factors that are the default are none
    assert sorted(scene.dropped) == sorted([
        "gloss of material 'bottle'", "KHR_materials_clearcoat.wax of material 'bottle'",
        "extension ACME_paint of material 'bottle'", "ACME_paint.paintTexture of material 'bottle'", "skin", "animation 'walk'",
        "KHR_lights_punctual"])
    assert sorted(scene.remarks[:-1]) == sorted([
        "attribute _HEAT is left out", "no face uses material 'spare'; it is left out", "cameras are left out",
        "extension KHR_materials_variants of the file is left out"]) and "normals that are zero" in scene.remarks[-1]
    assert scene.metadata["extras"] == {"materials": {"bottle": {"shelf": 7}}}


def test_specular_glossiness_diffuse_becomes_base_color(loaded):
    builder = textured()
    info = builder.tree["materials"][0].pop("pbrMetallicRoughness")["baseColorTexture"]
    builder.tree["materials"][0]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": {
        "diffuseTexture": info, "diffuseFactor": [1, 0.5, 0, 1], "glossinessFactor": 0.5}}
    scene = loaded(builder)
    assert scene.materials[0].texture == 0 and scene.materials[0].factor.tolist() == [1, 0.5, 0, 1]
    assert "SpecularGlossiness" in scene.warnings[0] and "glossinessFactor" in scene.dropped[0]


def test_specular_glossiness_without_an_image_has_none(loaded):
    builder = textured()
    builder.tree["materials"][0]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [1, 0.5, 0, 1]}}
    material = loaded(builder).materials[0]
    assert material.texture == -1 and material.factor.tolist() == [1, 0.5, 0, 1] and material.parameters["metallic"] == (0.0,)


def test_an_alpha_mode_that_is_none_is_opaque_with_a_warning(loaded):
    scene = loaded(bent(materials__0__alphaMode="GLASS"))
    assert scene.warnings == ["material 'm' has the unknown alphaMode 'GLASS'; OPAQUE is used instead"]
    assert scene.materials[0].alpha_mode == ALPHA_OPAQUE


def test_a_map_has_uvs_of_its_own_where_its_material_is_and_those_of_the_others_elsewhere(loaded):
    builder = textured()
    first = builder.tree["meshes"][0]["primitives"][0]
    first["attributes"]["TEXCOORD_1"] = builder.accessor(SQUARE_UV * 3)
    builder.tree["materials"][0]["occlusionTexture"] = {"index": 0, "texCoord": 1}
    builder.primitive(uv=SQUARE_UV, material=builder.material(0))
    builder.primitive(uv=SQUARE_UV, material=0, attributes={"TEXCOORD_1": builder.accessor(SQUARE_UV * 5)})
    scene = loaded(builder)
    assert list(scene.map_uv) == ["occlusion"]
    np.testing.assert_array_equal(scene.map_uv["occlusion"], np.concatenate([SQUARE_UV[TWO] * factor for factor in (3, 1, 5)]))
    np.testing.assert_array_equal(scene.corner_uv, np.tile(SQUARE_UV[TWO], (3, 1, 1)))


def images():
    palette = Image.fromarray(RED_BLUE).convert("P", palette=Image.Palette.ADAPTIVE)
    clear = Image.new("P", (2, 1))
    clear.putpalette([255, 0, 0, 0, 0, 255])
    clear.putpixel((1, 0), 1)
    deep = Image.fromarray(np.array([[0x1234, 0xFEDC]], np.uint16))
    return {
        "palette": (encoded(palette), [[255, 0, 0, 255], [0, 0, 255, 255]]),
        "palette with alpha": (encoded(clear, transparency=b"\xff\x40"), [[255, 0, 0, 255], [0, 0, 255, 64]]),
        "grey": (encoded([[10, 200]]), [[10, 10, 10, 255], [200, 200, 200, 255]]),
        "grey with alpha": (encoded([[[10, 20], [200, 100]]]), [[10, 10, 10, 20], [200, 200, 200, 100]]),
        "RGBA": (encoded([[[1, 2, 3, 4], [5, 6, 7, 0]]]), [[1, 2, 3, 4], [5, 6, 7, 0]]),
        "colour key": (encoded(RED_BLUE, transparency=(0, 0, 255)), [[255, 0, 0, 255], [0, 0, 255, 0]]),
        "bits": (encoded(Image.fromarray(np.array([[0, 255]], np.uint8)).convert("1")), [[0, 0, 0, 255], [255] * 4]),
        "grey 16": (encoded(deep), [[0x12, 0x12, 0x12, 255], [0xFE, 0xFE, 0xFE, 255]]),
        "webp": (encoded(RED_BLUE, "WEBP", lossless=True), [[255, 0, 0, 255], [0, 0, 255, 255]]),
    }


@pytest.mark.parametrize("kind", images())
def test_images_become_rgba(loaded, kind):
    data, expected = images()[kind]
    builder = Builder()
    builder.primitive(uv=SQUARE_UV, material=builder.material(builder.texture(data)))
    scene = loaded(builder, strict=True)
    assert scene.textures[0].image[0].tolist() == expected
    assert any("16-bit" in remark for remark in scene.remarks) == (kind == "grey 16") and scene.warnings == []


def test_cmyk_becomes_rgb_with_a_warning(loaded):
    builder = Builder()
    image = encoded(Image.new("CMYK", (8, 8), (0, 255, 255, 0)), "JPEG")
    builder.primitive(uv=SQUARE_UV, material=builder.material(builder.texture(image)))
    scene = loaded(builder)
    np.testing.assert_allclose(scene.textures[0].image[4, 4], [255, 0, 0, 255], atol=3)
    assert scene.warnings == ["image 'image 0' is CMYK; it is converted to RGB without its colour profile"]


def test_large_images_pass_through_the_strips_whole(loaded):
    pixels = np.random.default_rng(1).integers(0, 256, (600, 33, 3), np.uint8)
    builder = Builder()
    builder.primitive(uv=SQUARE_UV, material=builder.material(builder.texture(encoded(pixels))))
    np.testing.assert_array_equal(loaded(builder).textures[0].image[..., :3], pixels)


def test_webp_extension_is_preferred_and_a_texture_without_an_image_that_is_read_is_a_loss(loaded, refused):
    builder = textured()
    webp = builder.add("images", {"bufferView": builder.view(encoded(RED_BLUE[:, ::-1], "WEBP", lossless=True))})
    builder.tree["textures"][0]["extensions"] = {"EXT_texture_webp": {"source": webp}}
    assert loaded(builder).textures[0].image[0, 0].tolist() == [0, 0, 255, 255]
    builder.tree["textures"][0] = {"extensions": {"ACME_pictures": {"source": 0}}}
    assert "texture 0 of base colour" in loaded(builder).dropped
    error = refused(builder, strict=True)
    assert isinstance(error, InputError) and error.code == "TXF-I28" and "ACME_pictures" in str(error)


def test_dds_is_read_where_nothing_else_is_there(loaded):
    builder = textured()
    square = np.full((4, 4, 3), [200, 100, 50], np.uint8)
    builder.tree["images"][0]["bufferView"] = builder.view(encoded(square, "DDS"))
    builder.tree["textures"][0] = {"extensions": {"MSFT_texture_dds": {"source": 0}}}
    scene = loaded(builder, strict=True)
    assert scene.textures[0].image[0, 0].tolist() == [200, 100, 50, 255] and scene.dropped == []


def test_unused_images_are_not_decoded(loaded):
    builder = textured()
    builder.material(builder.texture(b"not an image at all"))
    assert loaded(builder, strict=True).warnings == []


@pytest.mark.parametrize("name", ["é 漢.png", "a%20b.png", "plain.png"])
def test_gltf_with_external_files_and_data_uris(tmp_path, name):
    from urllib.parse import quote

    builder = textured()
    builder.tree["images"] = [{"uri": quote(name)}]
    builder.tree["buffers"] = [{"byteLength": len(builder.blob), "uri": "mesh%20data.bin"}]
    (tmp_path / name).write_bytes(encoded(RED_BLUE))
    (tmp_path / "mesh data.bin").write_bytes(builder.blob)
    path = tmp_path / "漢字.gltf"
    path.write_text(json.dumps(builder.tree), encoding="utf-8-sig")
    scene = load(str(path), strict=True)
    assert len(scene.faces) == 2 and scene.textures[0].image[0, 1].tolist() == [0, 0, 255, 255]
    uri = "data:application/octet-stream;base64," + base64.b64encode(builder.blob).decode()
    builder.tree["buffers"][0]["uri"] = uri
    builder.tree["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(encoded(RED_BLUE)).decode()}]
    path.write_text(json.dumps(builder.tree), encoding="utf-8")
    np.testing.assert_array_equal(load(path, strict=True).textures[0].image, scene.textures[0].image)


# glTF: faults.


@pytest.mark.parametrize("data", [None, b"\x89PNG\r\n\x1a\nbroken", encoded(np.zeros((64, 64, 3)))[:70]])
def test_missing_and_broken_images_leave_the_factor(loaded, refused, data):
    code = "TXF-I16" if data is None else "TXF-I17"
    builder = textured()
    builder.tree["images"][0] = {"uri": "nowhere.png"} if data is None else {"bufferView": builder.view(data)}
    scene = loaded(builder)
    assert scene.materials[0].texture == -1 and code in scene.warnings[0] and not scene.corner_uv.any()
    error = refused(builder, strict=True)
    assert isinstance(error, InputError) and error.code == code


def test_a_broken_map_is_named_with_each_channel_that_goes_without(loaded, refused):
    builder = textured()
    packed = builder.texture(b"not an image at all")
    builder.tree["materials"][0] |= {"occlusionTexture": {"index": packed}, "normalTexture": {"index": 0}}
    pbr = builder.tree["materials"][0]["pbrMetallicRoughness"]
    pbr |= {"metallicRoughnessTexture": {"index": packed}, "roughnessFactor": 0.5}
    scene = loaded(builder)
    assert [text.partition("; ")[2] for text in scene.warnings] == [
        f"{name} is drawn without it (TXF-I17)" for name in ("occlusion", "roughness", "metallic")]
    assert scene.materials[0].maps == {"normal": 0} and scene.materials[0].parameters == {"roughness": (0.5,)}
    assert scene.materials[0].texture == 0
    assert scene.dropped == [f"texture 'image 1' of {name}" for name in ("occlusion", "roughness", "metallic")]
    assert refused(builder, strict=True).code == "TXF-I17"


def test_broken_vertices_count_only_where_faces_use_them(loaded, refused):
    positions = np.vstack([SQUARE, [[np.nan, 0, 0], [np.inf, 0, 0]]]).astype(np.float32)
    builder = Builder()
    builder.primitive(positions=positions)
    scene = loaded(builder, strict=True)
    assert len(scene.positions) == 4 and "2 vertices that no face uses" in scene.remarks[0]
    builder = Builder()
    builder.primitive(positions=positions, indices=np.array([[0, 1, 5], [0, 4, 5]], np.uint16))
    error = refused(builder)
    assert error.code == "TXF-I14" and error.details == {"count": 2, "first": 4}


def test_broken_and_far_uvs(loaded, refused):
    builder = textured()
    uv = SQUARE_UV.copy()
    uv[1], uv[3] = np.nan, [3e7, 0]
    builder.tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = builder.accessor(uv)
    scene = loaded(builder)
    assert scene.corner_uv[0, 1].tolist() == [0, 0] and scene.corner_uv[1, 2].tolist() == [3e7, 0]
    assert scene.warnings[0].startswith("1 face corner has NaN") and "beyond 1e+06" in scene.warnings[1]
    assert refused(builder, strict=True).code == "TXF-I18"


def test_degenerate_and_duplicate_faces_stay(loaded):
    builder = Builder()
    builder.primitive(indices=np.array([[0, 1, 2], [0, 1, 2], [1, 1, 2]], np.uint16))
    scene = loaded(builder)
    assert scene.faces.tolist() == [[0, 1, 2], [0, 1, 2], [1, 1, 2]]
    assert any("1 face uses the same" in text for text in scene.remarks) and scene.warnings == []


def bent(**changes):
    """A textured square whose JSON has been changed: path with dots -> value."""
    builder = textured()
    for path, value in changes.items():
        *way, last = path.split("__")
        place = builder.tree
        for key in way:
            place = place[int(key) if key.isdigit() else key]
        place[int(last) if last.isdigit() else last] = value
    return builder


@pytest.mark.parametrize("changes, code", [
    ({"meshes__0__primitives": []}, "TXF-I15"), ({"nodes__0__mesh": 3}, "TXF-I09"), ({"nodes__0__mesh": -1}, "TXF-I09"),
    ({"nodes__0__mesh": True}, "TXF-I09"), ({"nodes__0__scale": [1, 2]}, "TXF-I09"),
    ({"nodes__0__translation": [1, None, 2]}, "TXF-I09"), ({"nodes__0__translation": [1, 10**400, 2]}, "TXF-I09"),
    ({"nodes__0__translation": [1e308, 0, 0], "nodes__0__scale": [1e308, 1e308, 1e308]}, "TXF-I14"),
    ({"nodes": {"0": 1}}, "TXF-I09"), ({"nodes__0__children": [0]}, "TXF-I19"), ({"scenes__0__nodes": [0, 0]}, "TXF-I19"),
    ({"materials__0__pbrMetallicRoughness__baseColorFactor": "red"}, "TXF-I09"),
    ({"materials__0__pbrMetallicRoughness__baseColorTexture": {}}, None),
    ({"materials__0__pbrMetallicRoughness__baseColorTexture": {"index": 9}}, "TXF-I09"),
    ({"textures__0__sampler": 4}, "TXF-I09"), ({"accessors__0__count": 5}, "TXF-I11"),
    ({"accessors__0__count": 10**15}, "TXF-I11"), ({"accessors__0__count": 10**15, "accessors__0__bufferView": None}, "TXF-I09"),
    ({"accessors__0__byteOffset": 4}, "TXF-I11"), ({"accessors__0__type": "VEC9"}, "TXF-I09"),
    ({"accessors__0__componentType": []}, "TXF-I09"), ({"accessors__2__count": 3}, None),
    ({"bufferViews__0__byteLength": 10**9}, "TXF-I11"), ({"bufferViews__0__buffer": 1}, "TXF-I09"),
    # Without the package the plain copy in the file is taken.
    pytest.param({"bufferViews__0__extensions": {"EXT_meshopt_compression": {}}}, "TXF-I09", marks=pytest.mark.skipif(
        find_spec("meshoptimizer") is None, reason="meshoptimizer is not installed: pip install 'texfcodec[formats]'")),
    ({"extensionsRequired": ["EXT_mesh_gpu_instancing"]}, "TXF-I31"), ({"asset": {"version": "1.0"}}, "TXF-I33"),
    ({"meshes__0__primitives__0__material": []}, "TXF-I09"), ({"meshes__0__primitives__0__mode": "x"}, "TXF-I09"),
])
def test_bent_structures_end_in_their_code(loaded, refused, changes, code):
    if code is None:
        assert len(loaded(bent(**changes)).faces)
    else:
        assert refused(bent(**changes)).code == code


@pytest.mark.parametrize("changes, code, words", [
    ({"images__0": {"uri": 7}}, "TXF-I09", "a uri is not a string"),
    ({"images__0": {"uri": "data:image/png;base64"}}, "TXF-I10", "a data URI has no data"),
    ({"samplers": [{"wrapS": 5}], "textures__0__sampler": 0}, "TXF-I09", "a sampler has an unknown wrap mode"),
])
def test_references_that_lead_nowhere_are_named(refused, changes, code, words):
    error = refused(bent(**changes))
    assert error.code == code and words in error.message


def test_containers_that_are_too_long_or_too_short_are_told_apart(loaded, refused):
    data = textured().glb()
    assert loaded(data + b"abc").remarks == ["3 bytes after the end of the GLB container, ignored"]
    error = refused(b"glTF" + struct.pack("<IIII", 2, 24, 99, 0x4E4F534A) + b"{}  ")
    assert (error.code, error.message) == ("TXF-I07", "a GLB chunk exceeds the file") and error.details["allowed"] == 4
    builder = textured()
    error = refused(builder.with_buffers([{"byteLength": len(builder.blob), "uri": "data:,abc"}]))
    assert (error.code, error.message) == ("TXF-I10", "buffer 0 is shorter than its byteLength") and error.details["value"] == 3
    assert refused(builder.with_buffers([{"byteLength": 3, "uri": 7}])).code == "TXF-I09"


def test_more_faces_than_any_machine_follows_are_over_the_limit(refused, monkeypatch):
    monkeypatch.setattr("texfcodec.io.parts.MAX_FACES", 1)
    error = refused(textured())
    assert isinstance(error, LimitError) and error.code == "TXF-I41" and error.details == {"value": 2, "allowed": 1}


def test_face_index_out_of_range_and_implicit_zeros(refused):
    builder = Builder()
    builder.primitive(indices=np.array([0, 1, 4], np.uint16))
    error = refused(builder)
    assert error.code == "TXF-I13" and error.details["face"] == 0
    del builder.tree["accessors"][0]["bufferView"]
    builder.tree["accessors"][0]["count"] = 10**12
    assert isinstance(refused(builder), LimitError)


def test_sparse_index_out_of_range(refused):
    builder = Builder()
    primitive = builder.primitive()
    builder.tree["accessors"][primitive["attributes"]["POSITION"]]["sparse"] = sparse(
        builder, np.array([4], np.uint8), np.zeros((1, 3), np.float32))
    assert refused(builder).code == "TXF-I11"
    builder.tree["accessors"][primitive["attributes"]["POSITION"]]["sparse"]["indices"]["componentType"] = 5126
    assert refused(builder).code == "TXF-I09"


@pytest.mark.parametrize("name, data, code", [
    ("a.glb", b"", "TXF-I04"), ("a.fbx", b"solid", "TXF-I05"), ("a", b"glTF", "TXF-I05"), ("a.glb", b"PK\x03\x04", "TXF-I06"),
    ("a.ply", b"{}", "TXF-I06"), ("a.glb", b"glTF" + struct.pack("<II", 2, 400), "TXF-I07"),
    ("a.glb", b"glTF" + struct.pack("<IIII", 2, 20, 0, 7), "TXF-I07"), ("a.gltf", b"\xff\xfe garbage", "TXF-I08"),
    ("a.gltf", b"[" * 100000, "TXF-I08"), ("a.gltf", b"[]", "TXF-I09"), ("a.gltf", b"{}", "TXF-I15"),
    ("a.obj", b"v 0 0 0\n", "TXF-I15"),
    ("a.gltf", b'{"buffers":[{"byteLength":9,"uri":"x.bin"}],"bufferViews":[{"buffer":0,"byteLength":9}],"accessors":'
               b'[{"bufferView":0,"count":1,"type":"VEC3","componentType":5126}],"nodes":[{"mesh":0}],"meshes":'
               b'[{"primitives":[{"attributes":{"POSITION":0}}]}]}', "TXF-I10"),
])
def test_files_that_cannot_be_read(refused, name, data, code):
    assert refused(data, name).code == code


@pytest.mark.parametrize("text, line, column, says", [
    ('{"a": 1,\n "b": [1, 2,]}', 2, 14, "a comma precedes a closing bracket"), ('{"a": 1,}', 1, 9, "a comma precedes"),
    ('{"a": 1, // note\n}', 1, 10, "a comment"), ("# note\n{}", 1, 1, "a comment"), ('{"a": 1', 1, 8, "the text ends early"),
    ("{'a': 1}", 1, 2, "single quotes"), ('\ufeff{"a" 1}', 1, 6, "expecting ':'"), ('{"a": [1 2]}', 1, 10, "expecting ','"),
])
def test_text_that_is_no_json_says_where_and_why(refused, text, line, column, says):
    error = refused(text, "a.gltf")
    assert error.code == "TXF-I08" and says in error.message
    assert error.details["line"] == line and abs(error.details["column"] - column) <= 1


def test_paths_that_cannot_be_read(tmp_path):
    for path, code in ((tmp_path / "no.glb", "TXF-I01"), (tmp_path, "TXF-I02"), ("a\0.glb", "TXF-I03"), (3.5, "TXF-I05")):
        with pytest.raises(InputError) as caught:
            load(path)
        assert caught.value.code == code


def test_every_prefix_of_a_glb_is_refused(tmp_path):
    data = textured().glb()
    found = [outcome(tmp_path / "a.glb", data[:length]) for length in range(len(data))]
    assert all(isinstance(error, InputError) for error in found)
    assert {error.code for error in found} == {"TXF-I04", "TXF-I06", "TXF-I07"}


def test_flipped_bytes_end_in_a_scene_or_a_coded_error(tmp_path):
    data = textured().glb()
    size = struct.unpack_from("<I", data, 12)[0]
    rng = np.random.default_rng(7)
    for position in range(20, 20 + size):
        damaged = bytearray(data)
        damaged[position] = rng.integers(32, 127) if position % 2 else damaged[position] ^ (1 << int(rng.integers(8)))
        found = outcome(tmp_path / "a.glb", bytes(damaged))
        assert isinstance(found, (Scene, TexfError))


# Objects in memory.


def test_trimesh_objects(tmp_path):
    import trimesh

    flipped = SQUARE_UV * [1, -1] + [0, 1]
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(RED_BLUE), name="m", alphaMode="BLEND",
                                                   baseColorFactor=[255, 51, 0, 255])
    mesh = trimesh.Trimesh(SQUARE, TWO, process=False, visual=trimesh.visual.TextureVisuals(uv=flipped, material=material))
    scene = load(mesh)
    np.testing.assert_allclose(scene.corner_uv, SQUARE_UV[TWO])
    assert scene.textures[0].image[0, 1].tolist() == [0, 0, 255, 255] and scene.materials[0].alpha_mode == ALPHA_BLEND
    np.testing.assert_allclose(scene.materials[0].factor, [1, 0.2, 0, 1])
    painted = trimesh.Trimesh(SQUARE, TWO, process=False, vertex_colors=[[188, 0, 255, 255]] * 4)
    both = trimesh.Scene([mesh])
    both.add_geometry(painted, transform=np.diag([-1, 1, 1, 1.0]))
    scene = load(both)
    assert len(scene.faces) == 4 and scene.faces[2].tolist() == [4, 6, 5] and scene.positions[:, 0].min() == -1
    np.testing.assert_allclose(scene.corner_color[2, 0], [0.5029, 0, 1, 1], atol=1e-4)
    assert (scene.corner_color[0] == 1).all() and len(scene.metadata["meshes"]) == 2


def test_a_scene_passes_through_when_it_is_sound(loaded):
    scene = loaded(textured())
    assert load(scene) is scene
    scene.faces[0, 0] = 99
    with pytest.raises(InputError) as caught:
        load(scene)
    assert caught.value.code == "TXF-I13"


def test_importing_the_loader_imports_neither_pillow_nor_trimesh():
    program = "import sys, texfcodec.io; print(*{'PIL', 'trimesh', 'scipy', 'DracoPy'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


# The real assets.


def assets(shared_dir):
    return json.loads((shared_dir / "assets" / "index.json").read_text(encoding="utf-8"))


def test_all_assets_have_the_counts_of_their_index(shared_dir):
    for expected in assets(shared_dir):
        scene = load(shared_dir / "assets" / f"{expected['name']}.glb", strict=True)
        unused = 200 if expected["name"] == "hard_broken" else 0
        assert len(scene.faces) == expected["faces"], expected["name"]
        assert len(scene.positions) == expected["vertices"] - unused, expected["name"]
        assert len(scene.materials) == max(expected["materials"], 1), expected["name"]
        images = {image for images in expected["textures"].values() for image in images}
        assert len(scene.textures) == len(images), expected["name"]
        assert (scene.corner_color is not None) == ("COLOR_0" in expected["attributes"]), expected["name"]
        if not unused:  # the index counts unused vertices into the box
            np.testing.assert_allclose([scene.positions.min(axis=0), scene.positions.max(axis=0)], expected["bbox"], rtol=1e-6,
                                       atol=1e-9)


def test_assets_keep_their_uv_range_and_all_of_their_maps(shared_dir):
    for expected in assets(shared_dir):
        scene = load(shared_dir / "assets" / f"{expected['name']}.glb")
        whole = all(material.texture >= 0 for material in scene.materials)
        if whole and expected["uv_range"] and expected["name"] != "sheen_cloth":
            found = scene.corner_uv.reshape(-1, 2)
            np.testing.assert_allclose([found.min(axis=0), found.max(axis=0)], expected["uv_range"], atol=6e-5)
        for kind in expected["textures"].keys() - {"baseColor"}:
            slot = kind if "." in kind else f"{kind}Texture"
            names = {c.name for c in MAPS if slot in (c.slot, f"{c.extension}.{c.slot}")}
            assert names and names <= {name for material in scene.materials for name in material.maps}, (expected["name"], kind)
        assert scene.dropped == [] and scene.warnings == [], expected["name"]
        assert len(scene.remarks) == len(set(scene.remarks))
        json.dumps(scene.metadata)


def test_sheen_cloth_tiles_thirty_times_and_terrain_clamps(shared_dir):
    cloth = load(shared_dir / "assets" / "sheen_cloth.glb")
    assert np.ptp(cloth.corner_uv[..., 0]) > 29 and cloth.textures[0].wrap == (WRAP_REPEAT, WRAP_REPEAT)
    assert load(shared_dir / "assets" / "mars_terrain16.glb").textures[0].wrap == (WRAP_CLAMP, WRAP_CLAMP)
