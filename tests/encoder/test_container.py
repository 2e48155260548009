"""glTF scenes through encode_gltf() and expand(): what no stream holds is unchanged, and what a stream holds looks the same."""

import json
from copy import deepcopy

import numpy as np
import pytest
from gltf_scenes import INSTANCES, SCENES, bumpy_mesh, checker, skinned, textured, tree_of, with_tree
from mesh_files import Builder, load_bytes

import texfcodec
from texfcodec.encoder.container.fallback import with_fallbacks
from texfcodec.encoder.container.keyframes import TOLERANCE, kept_keys
from texfcodec.encoder.container.plan import plan_of
from texfcodec.io.container.references import texture_infos
from texfcodec.io.gltf.accessor import read_accessor
from texfcodec.io.gltf.document import open_document
from texfcodec.io.parts import Notes
from texfcodec.metrics.views import compare_views

LAYOUT = ("accessors", "bufferViews", "buffers", "images", "textures", "samplers")
OPTIONS = {"rate": "r06", "no_check": True, "effort": "fast"}


@pytest.fixture(scope="module")
def coded():
    """{name: (source, GLB with streams, expanded GLB)}, made as they are looked up."""

    class Made(dict):
        def __missing__(self, name):
            source = SCENES[name]().glb()
            data = texfcodec.encode_gltf(source, OPTIONS).data
            self[name] = source, data, texfcodec.expand(data)
            return self[name]

    return Made()


def kept_json(root):
    """The tree without what the container may change: layout, attributes, indices and targets, and references to textures."""
    root = deepcopy({key: value for key, value in root.items() if key not in LAYOUT})
    for mesh in root["meshes"]:
        for primitive in mesh["primitives"]:
            for key in ("attributes", "indices", "targets"):
                primitive.pop(key, None)
    for entry in root.get("materials", []):
        for info in texture_infos(entry):
            for key in ("index", "texCoord", "extensions"):
                info.pop(key, None)
    references = [(sampler, key) for animation in root.get("animations", []) for sampler in animation["samplers"]
                  for key in ("input", "output")]
    references += [(skin, "inverseBindMatrices") for skin in root.get("skins", [])]
    references += [(node["extensions"]["EXT_mesh_gpu_instancing"], "attributes") for node in root.get("nodes", [])
                   if "EXT_mesh_gpu_instancing" in node.get("extensions", {})]
    for owner, key in references:
        owner.pop(key, None)
    return root


@pytest.mark.parametrize("name", SCENES)
def test_all_json_but_the_layout_of_data_comes_back(name, coded):
    source, data, expanded = coded[name]
    assert "TEXF_stream" in tree_of(data)["extensionsRequired"]
    assert kept_json(tree_of(expanded)) == kept_json(tree_of(source))


@pytest.mark.parametrize("name", sorted(SCENES.keys() - {"instanced_on_gpu"}))  # which the loader refuses
def test_a_scene_looks_the_same(name, coded, tmp_path):
    source, data, expanded = coded[name]
    scenes = [load_bytes(tmp_path, file, f"{n}.glb") for n, file in enumerate((source, expanded, data))]
    for other in scenes[1:]:
        psnr = compare_views(scenes[0], other, views=4, size=192)["psnr"]["y"]
        assert psnr is None or psnr > 36, psnr


@pytest.mark.parametrize("name", ["skinned", "morphing", "spinning", "strange", "instanced_on_gpu"])
def test_animations_skins_and_tables_keep_every_number(name, coded):
    """Accessors by what refers to them: they may move, but not change."""
    source, _, expanded = (open_document(file, None, Notes()) for file in coded[name])
    pairs = [(owner, key) for owner, key in _numbers_of(source)]
    others = _numbers_of(expanded)
    assert len(pairs) == len(others) > 0
    kinds = ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT4")
    for (owner, key), (other, _) in zip(pairs, others, strict=True):
        assert np.array_equal(read_accessor(source, owner[key], kinds), read_accessor(expanded, other[key], kinds))


def _numbers_of(document):
    root = document.root
    found = [(sampler, key) for animation in root.get("animations", []) for sampler in animation["samplers"]
             for key in ("input", "output")]
    found += [(skin, "inverseBindMatrices") for skin in root.get("skins", []) if "inverseBindMatrices" in skin]
    for node in root["nodes"]:
        attributes = node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {}).get("attributes", {})
        found += [(attributes, key) for key in attributes]
    table = root.get("extensions", {}).get("ACME_curves")
    return found + ([(table, "table")] if table else [])


def test_vertices_at_one_position_keep_their_own_weights(coded):
    """For every face of the source there is one with the same positions and weights, two vertices at one position apart."""
    source, _, expanded = coded["skinned"]
    corners = [_corners(file) for file in (source, expanded)]
    assert np.array_equal(*corners)


def _corners(data):
    """Sorted corners of the second mesh's faces: positions to a hundredth of the box, and weights."""
    document = open_document(data, None, Notes())
    primitive = document.root["meshes"][1]["primitives"][0]
    index = read_accessor(document, primitive["indices"], ("SCALAR",))[:, 0]
    position = read_accessor(document, primitive["attributes"]["POSITION"], ("VEC3",))[index]
    weights = read_accessor(document, primitive["attributes"]["WEIGHTS_0"], ("VEC4",))[index]
    rows = np.concatenate([np.rint(position * 100), np.rint(weights * 1e4)], axis=1).reshape(-1, 3, 7)
    turned = [np.roll(face, -int(np.lexsort(face.T[::-1])[0]), axis=0).reshape(-1) for face in rows]
    return np.array(sorted(map(tuple, turned)))


def test_a_mesh_that_100_nodes_show_is_coded_once(coded):
    alone = SCENES["instances"]()
    alone.tree |= {"nodes": [{"mesh": 0, "scale": [3, 3, 3]}], "scenes": [{"nodes": [0]}]}
    streams = [texfcodec.encode_gltf(source, OPTIONS).sizes["streams"] for source in (coded["instances"][0], alone.glb())]
    assert streams[0] == streams[1]


def test_a_mesh_is_coded_for_the_largest_of_its_instances():
    """By EXT_mesh_gpu_instancing as by a node with the scale of that instance."""
    placed = []
    scales = np.array([[1, 1, 1], [-8, 8, 4], [2, 2, 2], [np.nan, 9, 9]], np.float32)
    for bend in (lambda b: b.tree["nodes"][1].update(scale=[8, 8, 4]), lambda b: b.tree["nodes"][1].update(
            extensions={INSTANCES: {"attributes": {"SCALE": b.accessor(scales)}}})):
        plan = plan_of(open_document(bent("spinning", bend), None, Notes()))
        placed.append([part.place for parts in plan.streams for part in parts])
    assert np.array_equal(*placed) and np.allclose(np.linalg.det(placed[0][1]), 256)


def pair(*nodes):
    """A Builder of two meshes with an image each, and its nodes."""
    builder = Builder()
    builder.tree["meshes"] = [{"primitives": []}, {"primitives": []}]
    for mesh in (0, 1):
        bumpy_mesh(builder, textured(builder), mesh=mesh)
    builder.tree["images"][1]["bufferView"] = builder.view(checker((9, 200, 40)))  # equal images would be in one stream
    builder.tree["nodes"] = list(nodes)
    return builder


def test_meshes_too_far_apart_for_one_stream_are_in_two():
    coded = texfcodec.encode_gltf(pair({"mesh": 0}, {"mesh": 1, "translation": [1e200, 0, 0]}).glb(), OPTIONS)
    said = [mesh["primitives"][0]["extensions"]["TEXF_stream"]["stream"] for mesh in tree_of(coded.data)["meshes"]]
    assert said == [0, 1] and coded.remarks == []


@pytest.mark.filterwarnings("error::texfcodec.LossWarning")
@pytest.mark.parametrize("far", [0.0, 1e200], ids=["in a stream with others", "alone"])
def test_a_mesh_that_cannot_be_coded_stays_as_it_is_with_its_image(far):
    builder = pair({"mesh": 0}, {"mesh": 1, "translation": [far, 0, 0]})
    sliver = np.array([[0, 0, 0], [1, 0, 0], [1, 1e-9, 0]], np.float32)
    builder.tree["meshes"][1]["primitives"] = []
    builder.primitive(sliver, np.array([0, 1, 2], np.uint16), sliver[:, :2], mesh=1, material=1)
    coded = texfcodec.encode_gltf(builder.glb(), {**OPTIONS, "strict": True})
    root = tree_of(coded.data)
    assert ["extensions" in mesh["primitives"][0] for mesh in root["meshes"]] == [True, False]
    assert [set(texture) for texture in root["textures"]] == [{"source"}, set()] and len(coded.streams) == 1
    assert coded.remarks[-1].startswith("primitive 0 of mesh 1 stays as it is") and "TXF-I63" in coded.remarks[-1]


def bent(name, bend):
    """The GLB of a scene after bend(builder)."""
    builder = SCENES[name]()
    bend(builder)
    return builder.glb()


def not_a_number(builder):
    """Make the first UV of the first primitive NaN."""
    accessor = builder.tree["accessors"][builder.tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
    at = builder.tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
    builder.blob = builder.blob[:at] + np.float32("nan").tobytes() + builder.blob[at + 4 :]


def test_what_is_repaired_is_a_loss_and_strict_refuses_it():
    source, report = bent("spinning", not_a_number), texfcodec.Report()
    with pytest.warns(texfcodec.LossWarning):
        coded = texfcodec.encode_gltf(source, OPTIONS, report)
    assert coded.warnings == report.warnings and "NaN" in coded.warnings[0] and coded.dropped == report.dropped != []
    with pytest.raises(texfcodec.InputError, match="TXF-I52"):
        texfcodec.encode_gltf(source, {**OPTIONS, "strict": True})


@pytest.mark.filterwarnings("error::texfcodec.LossWarning")
def test_an_image_that_is_not_here_stays_named_and_is_no_loss():
    source = bent("spinning", lambda builder: builder.tree["images"].__setitem__(0, {"uri": "gone.png"}))
    coded = texfcodec.encode_gltf(source, {**OPTIONS, "strict": True})
    assert coded.warnings == coded.dropped == [] and "stays in the file" in coded.remarks[0]
    assert [image["uri"] for image in tree_of(texfcodec.expand(coded.data))["images"]] == ["gone.png"]


def test_an_image_shown_at_a_single_place_keeps_its_uvs():
    """Where all UVs are 0, too: a viewer needs the set that the material names."""
    source = bent("spinning", lambda builder: setattr(builder, "blob", zeroed(builder, "TEXCOORD_0")))
    root = tree_of(texfcodec.expand(texfcodec.encode_gltf(source, OPTIONS).data))
    assert "TEXCOORD_0" in root["meshes"][0]["primitives"][0]["attributes"]


def zeroed(builder, name):
    """The buffer with the values of an attribute of the first primitive 0."""
    view = builder.tree["bufferViews"][builder.tree["accessors"][builder.tree["meshes"][0]["primitives"][0]["attributes"][name]][
        "bufferView"]]
    begin, end = view["byteOffset"], view["byteOffset"] + view["byteLength"]
    return builder.blob[:begin] + bytes(end - begin) + builder.blob[end:]


def test_a_stream_gives_the_uvs_that_no_image_of_another_variant_shows(coded):
    """Under their own number: hosts name UV sets by it."""
    primitive = tree_of(coded["variants"][1])["meshes"][0]["primitives"][0]
    assert "texCoord" not in primitive["extensions"]["TEXF_stream"]
    assert {name for name in primitive["attributes"] if name.startswith("TEXCOORD_")} == {"TEXCOORD_0", "TEXCOORD_1"}


def test_an_image_format_that_nothing_uses_any_more_is_not_declared():
    source = SCENES["spinning"]()
    source.tree["textures"][0] = {"extensions": {"EXT_texture_webp": {"source": 0}}}
    source.tree |= {"extensionsUsed": ["EXT_texture_webp", "KHR_lights_punctual"], "extensionsRequired": ["EXT_texture_webp"]}
    root = tree_of(texfcodec.expand(texfcodec.encode_gltf(source.glb(), OPTIONS).data))
    assert root["extensionsUsed"] == ["KHR_lights_punctual"] and "extensionsRequired" not in root


def test_a_material_with_images_of_two_fields_is_refused():
    source = SCENES["skinned"]()
    source.tree["textures"][1]["source"] = source.add("images", {"bufferView": source.view(checker((0, 200, 0))),
                                                                  "mimeType": "image/png"})
    data = texfcodec.encode_gltf(source.glb(), {**OPTIONS, "support": "texels"}).data
    root = tree_of(data)
    first, second = (mesh["primitives"][0] for mesh in root["meshes"])
    second["material"] = first["material"]
    with pytest.raises(texfcodec.InputError, match="several streams or fields"):
        texfcodec.expand(with_tree(data, root))


def fallbacks(data, **options):
    """(A coded file with fallbacks, the remarks)."""
    report = texfcodec.Report()
    document = open_document(data, None, Notes())
    return with_fallbacks(document, lambda stream: texfcodec.decode(stream, {"lod": 1}), report, **options), report.remarks


def without_extension(data):
    """A GLB as viewers see it that do not know TEXF_stream."""
    root = tree_of(data)
    for owner in (root, *root["textures"], *(primitive for mesh in root["meshes"] for primitive in mesh["primitives"])):
        owner.get("extensions", {}).pop("TEXF_stream", None)
    return with_tree(data, root)


@pytest.mark.parametrize("name, support", [("many_materials", "texels"), ("spinning", "voxels")])
def test_a_fallback_looks_alike_and_leaves_no_trace_where_the_stream_is_read(name, support, tmp_path):
    source = SCENES[name]().glb()
    data = texfcodec.encode_gltf(source, {**OPTIONS, "support": support}).data
    both, remarks = fallbacks(data)
    assert remarks == [] and "extensionsRequired" not in tree_of(both) and texfcodec.expand(both) == texfcodec.expand(data)
    scenes = [load_bytes(tmp_path, file, f"{n}.glb") for n, file in enumerate((source, without_extension(both)))]
    assert compare_views(*scenes, views=4, size=192)["psnr"]["y"] > 25


@pytest.mark.parametrize("name", ["skinned", "morphing", "variants", "strange"])
def test_a_primitive_with_stored_values_has_no_fallback_and_a_remark_says_so(name, coded):
    both, remarks = fallbacks(coded[name][1])
    assert "TEXF_stream" in tree_of(both)["extensionsRequired"] and texfcodec.expand(both) == coded[name][2]
    assert remarks and all("has no fallback" in remark for remark in remarks) and len(both) < len(coded[name][1]) + 200


@pytest.mark.parametrize("name, value", [("spinning", 1), ("skinned", True), ("morphing", True)])  # a number, splits, targets
def test_a_fallback_that_cannot_be_one_is_refused(name, value, coded):
    root = tree_of(coded[name][1])
    root["meshes"][-1]["primitives"][0]["extensions"]["TEXF_stream"]["fallback"] = value
    with pytest.raises(texfcodec.InputError, match="fallback"):
        texfcodec.expand(with_tree(coded[name][1], root))


def test_fallbacks_share_the_faces_that_are_allowed_and_none_is_empty(coded):
    for faces, expected in ((20, [10, 10]), (1, [1, 1])):
        root = tree_of(fallbacks(coded["spinning"][1], faces=faces)[0])
        assert [root["accessors"][mesh["primitives"][0]["indices"]]["count"] // 3 for mesh in root["meshes"]] == expected


@pytest.mark.parametrize("options", [("--target-bytes", "3000"), ("--explain-time",)])
def test_options_of_a_single_stream_are_refused(options, call, tmp_path):
    (tmp_path / "a.glb").write_bytes(skinned().glb())
    code, _, said = call("texf-enc", tmp_path / "a.glb", tmp_path / "b.glb", *options)
    assert code in (1, 2) and ("scene" in said or "OUT.glb" in said)
    assert not (tmp_path / "b.glb").exists()


def test_options_of_an_atlas_do_not_apply_to_a_scene(call, tmp_path, coded):
    (tmp_path / "a.glb").write_bytes(coded["skinned"][1])
    assert call("texf-dec", tmp_path / "a.glb", tmp_path / "b.glb", "--compress", "draco")[0] == 1
    assert call("texf-dec", tmp_path / "a.glb", tmp_path / "b.glb", "--texture-format", "png", "--json")[0] == 0


def test_the_tools_code_and_expand_a_scene(call, tmp_path):
    source, coded_file, plain = (tmp_path / name for name in ("source.glb", "coded.glb", "plain.glb"))
    source.write_bytes(skinned().glb())
    code, out, _ = call("texf-enc", source, coded_file, "--effort", "fast", "--json")
    assert code == 0
    assert all(stream["supports"]["groups"] and stream["channels"][0]["bytes"] for stream in json.loads(out)["streams"])
    assert "everything else" in call("texf-enc", source, tmp_path / "again.glb", "--effort", "fast")[1]
    code, out, _ = call("texf-dec", coded_file, plain)
    assert code == 0 and "ordinary glTF" in out
    assert kept_json(tree_of(plain.read_bytes())) == kept_json(tree_of(source.read_bytes()))
    assert call("texf-dec", coded_file, tmp_path / "plain.obj")[0] == 1
    code, _, said = call("texf-dec", coded_file, tmp_path / "both.glb", "--carry-stream", "--fallback-faces", 9)
    assert code == 0 and "primitive 0 of mesh 1 has no fallback: JOINTS_0, WEIGHTS_0" in said
    out = call("texf-dec", coded_file, tmp_path / "as_json.glb", "--carry-stream", "--json")[1]
    assert json.loads(out)["carried"]["stream"] > 0


@pytest.mark.parametrize(("mode", "is_rotation"), [("LINEAR", False), ("STEP", False), ("LINEAR", True)])
def test_keyframes_that_stay_give_the_others_within_the_tolerance(mode, is_rotation):
    """By interpolation as glTF defines it, between the keys that stay; a straight run keeps its ends alone."""
    random = np.random.default_rng(2)
    times = np.cumsum(random.random(200) + 0.1)
    values = np.cumsum(random.random((200, 4)) * (random.random((200, 1)) < 0.1), axis=0)
    values[50:120] = values[50] + np.linspace(0, 1, 70)[:, None] * (values[119] - values[50]) if mode == "LINEAR" else values[50]
    if is_rotation:
        values = values + 1
        values /= np.linalg.norm(values, axis=1, keepdims=True)
    kept = kept_keys(times, values, mode, is_rotation)
    tolerance = TOLERANCE * (1 if is_rotation else np.ptp(values, axis=0).max()) * (1 + 1e-9)
    shown = np.empty_like(values)
    for first, last in zip(kept[:-1], kept[1:], strict=True):
        share = ((times[first : last + 1] - times[first]) / (times[last] - times[first]))[:, None]
        shown[first : last + 1] = values[first] if mode == "STEP" else _between(values[first], values[last], share, is_rotation)
        shown[last] = values[last]
    assert kept[0] == 0 and kept[-1] == 199 and 2 < len(kept) < 160
    assert np.abs(shown - values).max() <= tolerance


def _between(first, last, share, is_rotation):
    if not is_rotation:
        return first + share * (last - first)
    angle = np.arccos(np.clip(first @ last, -1, 1))
    return first + share * (last - first) if angle < 1e-9 else \
        (np.sin((1 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)


def test_keep_animations_keeps_every_keyframe(coded):
    source = SCENES["spinning"]().glb()
    every = texfcodec.expand(texfcodec.encode_gltf(source, {**OPTIONS, "keep_animations": True}).data)
    assert [_keys(file) for file in (source, every, coded["spinning"][2])] == [5, 5, 5]


def _keys(data):
    root = tree_of(data)
    return root["accessors"][root["animations"][0]["samplers"][0]["input"]]["count"]
