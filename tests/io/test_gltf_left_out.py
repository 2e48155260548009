"""Nothing of a glTF file is lost without a word: glTF 2.0's schema and the ratified extensions, place by place."""

import json

import numpy as np
import pytest
from mesh_files import RED_BLUE, SQUARE_UV, Builder, encoded, load_bytes, read_glb, textured
from shapes import painted_sphere

from texfcodec import EncodeOptions, InputError, Report, decode
from texfcodec.api import encode
from texfcodec.io.gltf.left_out import CARRIED, LABEL, LAYOUT, NAMED, READ, TABLE
from texfcodec.scene.channels import MAPS, PARAMETERS, PBR
from texfcodec.scene.scene import Material


def sparse(builder):
    """An accessor of positions whose second row is replaced."""
    rows, values = builder.view(np.array([1], np.uint8).tobytes()), builder.view(np.array([[1, 0, 0]], np.float32).tobytes())
    builder.tree["accessors"][0]["sparse"] = {"count": 1, "indices": {"bufferView": rows, "componentType": 5121},
                                              "values": {"bufferView": values}}


def whole():
    """A file with something of every kind of TABLE."""
    builder = textured(magFilter=9729)
    builder.tree["materials"][0]["normalTexture"] = {"index": 0}
    sparse(builder)
    return builder


# Where a file has an entry of each kind.
PLACES = {
    "file": lambda tree: tree, "asset": lambda tree: tree["asset"], "scenes": lambda tree: tree["scenes"][0],
    "nodes": lambda tree: tree["nodes"][0], "meshes": lambda tree: tree["meshes"][0],
    "primitives": lambda tree: tree["meshes"][0]["primitives"][0], "materials": lambda tree: tree["materials"][0],
    "parts of materials": lambda tree: tree["materials"][0]["pbrMetallicRoughness"],
    "texture infos": lambda tree: tree["materials"][0]["normalTexture"], "textures": lambda tree: tree["textures"][0],
    "images": lambda tree: tree["images"][0], "samplers": lambda tree: tree["samplers"][0],
    "accessors": lambda tree: tree["accessors"][0], "sparse accessors": lambda tree: tree["accessors"][0]["sparse"],
    "parts of sparse accessors": lambda tree: tree["accessors"][0]["sparse"]["indices"],
    "bufferViews": lambda tree: tree["bufferViews"][0],
}


def all_words(scene):
    """Everything that a load says, and what it keeps as metadata."""
    return "\n".join([*scene.warnings, *scene.dropped, *scene.remarks, json.dumps(scene.metadata)])


def test_the_table_knows_every_place():
    assert set(PLACES) == set(TABLE) - {"buffers"}  # the builder writes buffers last
    fates = {fate for row in TABLE.values() for fate in row.values()}
    assert {fate for fate in fates if fate[0] != ">"} == {CARRIED, LAYOUT, LABEL, NAMED}
    assert {fate[1:] for fate in fates if fate[0] == ">"} | {"file"} == set(TABLE)


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("key, value, shown", [
    ("acmeGloss", 7, "acmeGloss"), ("extensions", {"ACME_wax": {"thick": 1}}, "ACME_wax"), ("extras", {"shelf": 7}, "xtras")])
def test_what_is_of_no_known_kind_is_named_wherever_it_stands(tmp_path, kind, key, value, shown):
    assert shown not in all_words(load_bytes(tmp_path, whole()))
    builder = whole()
    PLACES[kind](builder.tree)[key] = value
    assert shown in all_words(load_bytes(tmp_path, builder))


@pytest.mark.parametrize("key, value, says", [
    ("animations", [{"name": "walk", "channels": []}], "animation 'walk'"), ("cameras", [{"type": "perspective"}], "cameras"),
    ("skins", [{"joints": [0]}], "skin"), ("nodes", {"camera": 0}, "cameras"), ("nodes", {"weights": [1]}, "morph weights"),
    ("nodes", {"skin": 0}, "skin"), ("samplers", {"minFilter": 9984}, "minFilter"),
    ("primitives", {"targets": [{"POSITION": 0}]}, "morph targets"), ("nodes", {"children": [1]}, "their tree does not"),
])
def test_what_the_table_calls_named_is_named(tmp_path, key, value, says):
    builder = whole()
    if isinstance(value, list):
        builder.tree[key] = value
    else:
        PLACES[key](builder.tree).update(value)
    if "children" in value:
        builder.tree["nodes"].append({"mesh": 0})
    assert says in all_words(load_bytes(tmp_path, builder))
    row = TABLE["file"] if isinstance(value, list) else TABLE[key]
    assert row[key if isinstance(value, list) else next(iter(value))] == NAMED


# Extensions that Khronos has ratified or several vendors share; of those that are not carried, where each stands.
CARRIED_EXTENSIONS = {
    "KHR_draco_mesh_compression", "KHR_mesh_quantization", "KHR_texture_basisu", "KHR_texture_transform", "EXT_texture_webp",
    "EXT_texture_avif", "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_materials_unlit",
    "KHR_materials_pbrSpecularGlossiness", "TEXF_stream", *(f"KHR_materials_{name}" for name in (
        "anisotropy", "clearcoat", "diffuse_transmission", "dispersion", "emissive_strength", "ior", "iridescence", "sheen",
        "specular", "transmission", "volume"))}
NAMED_EXTENSIONS = {
    "KHR_materials_variants": "file", "KHR_lights_punctual": "file", "KHR_xmp_json_ld": "asset", "KHR_animation_pointer": "nodes",
    "KHR_node_visibility": "nodes", "EXT_mesh_gpu_instancing": "nodes", "EXT_lights_image_based": "scenes",
    "EXT_mesh_manifold": "meshes", "EXT_mesh_features": "primitives", "EXT_structural_metadata": "file", "MSFT_lod": "nodes",
    "KHR_materials_volume_scatter": "materials", "EXT_texture_video": "textures"}


@pytest.mark.parametrize("name, kind", NAMED_EXTENSIONS.items())
def test_extensions_that_are_not_carried_are_named(tmp_path, name, kind):
    builder = whole()
    value = {"variants": [{"name": "night"}]} if name == "KHR_materials_variants" else {"any": 1}
    PLACES[kind](builder.tree)["extensions"] = {name: value}
    said = all_words(load_bytes(tmp_path, builder))
    assert ("material variants 'night'" if name == "KHR_materials_variants" else name) in said


def test_extensions_that_are_carried_are_those_of_the_readers_tables():
    places = {row.extension for row in (*MAPS, *PARAMETERS)} - {"", PBR}
    in_read = {name for names in READ.values() for name in names} - {"MSFT_texture_dds"}  # a copy beside an image that is read
    assert places <= CARRIED_EXTENSIONS and in_read <= CARRIED_EXTENSIONS
    elsewhere = {"KHR_draco_mesh_compression", "KHR_mesh_quantization", "KHR_materials_unlit",
                 "KHR_materials_pbrSpecularGlossiness"}
    assert CARRIED_EXTENSIONS == places | in_read | elsewhere


def variants():
    builder = whole()
    other = builder.material(builder.texture(encoded(RED_BLUE)))
    builder.tree["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "night"}, {"name": "day"}]}}
    PLACES["primitives"](builder.tree)["extensions"] = {
        "KHR_materials_variants": {"mappings": [{"material": other, "variants": [0]}]}}
    return builder


def test_variants_are_dropped_by_name_and_strict_refuses_them(tmp_path):
    scene = load_bytes(tmp_path, variants())
    assert scene.dropped == ["material variants 'night', 'day'"] and scene.warnings == []
    with pytest.raises(InputError, match="TXF-I52"):
        encode(tmp_path / "a.glb", EncodeOptions(strict=True))


def test_joined_nodes_and_meshes_are_a_note(tmp_path):
    builder = Builder()
    builder.primitive(uv=SQUARE_UV)
    builder.tree["meshes"].append(dict(builder.tree["meshes"][0], name="other"))
    builder.tree["nodes"] = [{"mesh": 0, "children": [1, 2]}, {"mesh": 1}, {"mesh": 0, "scale": [2, 2, 2]}]
    scene = load_bytes(tmp_path, builder)
    assert [remark for remark in scene.remarks if "3 nodes that show 2 meshes become one mesh" in remark]
    assert scene.warnings == [] and scene.dropped == []


def test_anisotropy_without_a_direction_is_a_named_loss_and_no_white_face(tmp_path):
    """Viewers make its direction of UVs, and draw what has none white."""
    scene = painted_sphere(8)
    scene.materials = [Material("brushed", parameters={"anisotropy": (0.8,), "metallic": (1.0,), "roughness": (0.4,)})]
    scene.corner_normal = np.ascontiguousarray(scene.positions[scene.faces], np.float32)
    report = Report()
    data = encode(scene, EncodeOptions(resolution=64), report=report)
    assert any("anisotropy" in warning for warning in report.warnings)
    saved = decode(data).save(tmp_path / "a.glb", appearance="vertex")
    assert any("anisotropy" in warning for warning in saved["warnings"])
    document = read_glb(tmp_path / "a.glb")[0]
    assert not any("KHR_materials_anisotropy" in one.get("extensions", {}) for one in document["materials"])
