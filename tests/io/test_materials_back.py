"""Whole materials from GLB to stream to GLB: every map in its slot, factors, packing, names, and what they show."""

import json
import struct

import numpy as np
import pytest
from shapes import mapped_sheet, noise, plain_image

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.load import load
from texfcodec.io.save import save
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.scene.channels import BY_NAME, EXTENSIONS, MAPS, PACKED_IMAGES, PARAMETERS
from texfcodec.scene.fetch import values_of_map
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, WRAP_CLAMP, Material

CLAMPED = (WRAP_CLAMP, WRAP_CLAMP)
EXACT = {"support": "texels", "max_error": 0, "effort": "fast"}  # which measures no weights of channels
NORMALS = ("normal", "clearcoat_normal")
FACTORS = {p.name: tuple(0.5 + 0.125 * k for k in range(p.count)) for p in PARAMETERS}
FACTORS |= {"ior": (1.25,), "iridescence_ior": (1.5,)}


def waves(seed, height=32, width=32):
    """Smooth in all four columns, uint8 [height, width, 4]; as normals, they face up."""
    rng = np.random.default_rng(seed)
    y, x = (np.mgrid[:height, :width] + 0.5) / np.array([height, width]).reshape(2, 1, 1) * 2 * np.pi
    turns = [np.sin(x * rng.integers(1, 3) * 0.5 + 0.5 * y + 7 * rng.random()) for _ in range(4)]
    image = np.stack([128 + 90 * turns[0], 128 + 80 * turns[1], 200 + 50 * turns[2], 150 + 90 * turns[3]], axis=-1)
    return np.rint(image).astype(np.uint8)


def everything(size=32):
    """A sheet with a map of every channel and a value of every parameter."""
    maps = {channel.name: waves(channel.semantic, size, size) for channel in MAPS}
    return mapped_sheet(maps, waves(99, size, size), wrap=CLAMPED, parameters=dict(FACTORS), double_sided=True)


def there_and_back(scene, folder, lod=0, **options):
    """(Texf, the glTF JSON that it is saved as, the Scene that this loads as)."""
    texf = decode(encode_scene(scene, EncodeOptions(**options)).data, DecodeOptions(lod=lod))
    save(texf, folder / "back.glb", texture_size=None if options.get("support") == "texels" else 128)
    return texf, tree_of(folder / "back.glb"), load(folder / "back.glb", strict=True)


def tree_of(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def slots_of(entry):
    """{(extension, slot): index of the texture} of a glTF material."""
    places = {"": entry, "pbrMetallicRoughness": entry["pbrMetallicRoughness"]} | entry.get("extensions", {})
    return {(place, key): info["index"] for place, table in places.items() for key, info in table.items()
            if key.endswith("Texture")}


# Slots, factors and packing.


@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_every_map_and_factor_comes_back_in_its_slot(tmp_path, support):
    options = EXACT if support == "texels" else {"support": "voxels", "resolution": 48, "qp": 16}
    _, tree, back = there_and_back(everything(), tmp_path, **options)
    (entry,), (material,) = tree["materials"], back.materials
    slots = slots_of(entry)
    assert set(slots) == {(c.extension, c.slot) for c in MAPS} | {("pbrMetallicRoughness", "baseColorTexture")}
    assert len(tree["textures"]) == len(tree["images"]) == len(PACKED_IMAGES) == len(set(slots.values()))
    for sheet in PACKED_IMAGES:
        assert len({slots[BY_NAME[name].extension, BY_NAME[name].slot] for name in sheet}) == 1, sheet
    assert set(material.maps) == {c.name for c in MAPS} and material.double_sided and material.name == "sheet"
    given = dict(FACTORS)
    if support == "voxels":
        del given["normal_scale"], given["clearcoat_normal_scale"]  # these are in the values
    assert material.parameters == given and back.dropped == back.warnings == []
    assert set(tree["extensionsUsed"]) == set(EXTENSIONS) and "extensionsRequired" not in tree
    assert "TANGENT" in tree["meshes"][0]["primitives"][0]["attributes"]


@pytest.mark.parametrize("name", [channel.name for channel in MAPS])
def test_one_map_alone_takes_one_image_its_extension_and_tangents_only_for_normals(tmp_path, name):
    channel = BY_NAME[name]
    given = {k: v for k, v in FACTORS.items() if PARAMETERS_OF.get(k) in ("", "pbrMetallicRoughness", channel.extension)}
    scene = mapped_sheet({name: waves(1)}, plain_image(100, 150, 200), wrap=CLAMPED, parameters=given)
    _, tree, back = there_and_back(scene, tmp_path, **EXACT)
    assert set(slots_of(tree["materials"][0])) == {(channel.extension, channel.slot)} and len(tree["images"]) == 1
    assert tree.get("extensionsUsed", []) == [channel.extension] * (channel.extension in EXTENSIONS)
    assert name in back.materials[0].maps and back.materials[0].texture == -1
    assert ("TANGENT" in tree["meshes"][0]["primitives"][0]["attributes"]) == (name in NORMALS)
    expected = np.append((np.array([100, 150, 200]) / 255 + 0.055) / 1.055, 1)
    np.testing.assert_allclose(back.materials[0].factor, np.append(expected[:3] ** 2.4, 1), atol=2e-3)


PARAMETERS_OF = {p.name: p.extension for p in PARAMETERS}


def test_constant_maps_are_factors_and_a_flat_material_has_no_uvs(tmp_path):
    maps = {"roughness": plain_image(0, 51, 0), "metallic": plain_image(0), "emissive": plain_image(255, 0, 0)}
    scene = mapped_sheet(maps, plain_image(255), parameters={"emissive": (0.5,) * 3})
    _, tree, back = there_and_back(scene, tmp_path, **EXACT)
    assert tree["materials"][0]["pbrMetallicRoughness"] == {"roughnessFactor": pytest.approx(0.2), "metallicFactor": 0.0}
    assert tree["materials"][0]["emissiveFactor"] == [0.5, 0, 0] and not {"images", "textures"} & set(tree)
    assert set(tree["meshes"][0]["primitives"][0]["attributes"]) <= {"POSITION", "NORMAL", "TEXCOORD_0"}
    assert back.textures == [] and back.materials[0].parameters.keys() == {"roughness", "metallic", "emissive"}


def test_an_orm_image_is_packed_with_255_where_a_channel_is_not_there(tmp_path):
    scene = mapped_sheet({"occlusion": waves(1), "metallic": waves(2)}, waves(3), wrap=CLAMPED)
    texf, tree, back = there_and_back(scene, tmp_path, **EXACT)
    pbr = tree["materials"][0]["pbrMetallicRoughness"]
    assert pbr["metallicRoughnessTexture"]["index"] == tree["materials"][0]["occlusionTexture"]["index"]
    image = back.textures[back.materials[0].maps["metallic"]].image
    asked = texf.fields[0].support.rank >= 0
    assert np.array_equal(image[asked][:, 0], waves(1)[asked][:, 0]) and np.array_equal(image[asked][:, 2], waves(2)[asked][:, 2])
    assert (image[..., 1] == 255).all()


def test_names_modes_and_flags_come_back(tmp_path):
    clear = noise(0)
    clear[..., 3] = waves(1)[..., 3]
    scene = mapped_sheet({"roughness": waves(2)}, clear, wrap=CLAMPED, cells=6)
    modes = {"leaf": (ALPHA_MASK, 0.25, True), "glass": (ALPHA_BLEND, 0.5, False)}
    scene.materials = [Material(name, texture=0, maps={"roughness": 1}, alpha_mode=mode, alpha_cutoff=cutoff, double_sided=both)
                       for name, (mode, cutoff, both) in modes.items()]
    scene.materials.append(Material("sign", texture=0, maps={"roughness": 1}, unlit=True))
    scene.face_material = np.arange(len(scene.faces)) % 3
    _, tree, back = there_and_back(scene, tmp_path, **EXACT)
    found = {m.name: m for m in back.materials}
    for name, (mode, cutoff, both) in modes.items():
        assert (found[name].alpha_mode, found[name].double_sided) == (mode, both)
        assert set(found[name].maps) == {"roughness", "metallic"}  # one slot, whose blue is white
        assert mode != ALPHA_MASK or abs(found[name].alpha_cutoff - cutoff) < 2**-15
    assert found["sign"].unlit and found["sign"].maps == {} and found["sign"].alpha_mode == 0
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]


# What the maps show.


@pytest.mark.parametrize("name", [channel.name for channel in MAPS])
def test_texels_without_loss_are_the_sources_texels(tmp_path, name):
    scene = mapped_sheet({name: waves(5)}, waves(6), wrap=CLAMPED, parameters=dict(FACTORS))
    texf, _, back = there_and_back(scene, tmp_path, **EXACT)
    first = values_of_map(name, back.textures[back.materials[0].maps[name]].image)
    asked = texf.fields[0].support.rank >= 0
    apart = np.abs(first - values_of_map(name, waves(5)))[asked]
    assert apart.max() <= (2 if name in NORMALS else 0)  # a normal is rounded again, as three numbers
    _, _, again = there_and_back(back, tmp_path, **EXACT)
    second = values_of_map(name, again.textures[again.materials[0].maps[name]].image)
    assert np.abs(first - second)[asked].max() <= (1.5 if name in NORMALS else 0)


def at_points(scene, name, count=3000):
    """(x and y of points on a Scene, float64 [M, 2]; what its map shows there, float32 [M, C])."""
    from texfcodec.scene.fetch import pack_map, sample_source, sampled_values

    rng = np.random.default_rng(0)
    face, bary = rng.integers(0, len(scene.faces), count), rng.dirichlet((1, 1, 1), count)
    points = np.einsum("mk,mkc->mc", bary, scene.positions[scene.faces[face]])
    return points[:, :2], sampled_values(name, sample_source(pack_map(scene, name), face, bary))


@pytest.mark.parametrize("support, bound", [("texels", 4), ("voxels", 6)])
def test_maps_that_were_coded_with_loss_stay_within_a_bound(tmp_path, support, bound):
    names = ("roughness", "metallic", "occlusion", "emissive", "transmission", "specular")
    scene = mapped_sheet({name: waves(BY_NAME[name].semantic) for name in names}, waves(9), wrap=CLAMPED,
                         parameters={"emissive": (1.0,) * 3, "transmission": (1.0,)})
    _, _, back = there_and_back(scene, tmp_path, support=support, resolution=128, qp=16)
    for name in names:
        places, got = at_points(back, name)
        image = values_of_map(name, waves(BY_NAME[name].semantic))
        column, row = ((places * [1, -1] + [0, 1]) * 32).astype(int).clip(0, 31).T
        apart = got - image[row, column]  # of the texel that the point is in: half a texel off at most
        steepest = max(np.abs(np.diff(image, axis=axis)).max() for axis in (0, 1))
        assert np.sqrt((apart**2).mean()) < bound + steepest / 2 and abs(apart.mean()) < 2, name


def test_normals_over_voxels_come_back_in_the_atlas_and_point_the_same_way(tmp_path):
    from texfcodec.geometry.tangents import corner_tangents

    scene = mapped_sheet({"normal": waves(4)}, waves(5), wrap=CLAMPED, cells=1)
    scene.positions[:, 2] = 0  # flat: the tangent space is the same everywhere
    scene.corner_normal = np.broadcast_to(np.float32([0, 0, 1]), (*scene.faces.shape, 3)).copy()
    _, tree, back = there_and_back(scene, tmp_path, support="voxels", resolution=128, qp=12)
    assert "TANGENT" in tree["meshes"][0]["primitives"][0]["attributes"] and back.corner_tangent.any(axis=2).all()
    places, _ = at_points(scene, "normal")
    tangent = corner_tangents(scene.positions, scene.faces, scene.corner_uv, scene.corner_normal)[0, 0]
    assert np.allclose(tangent, [1, 0, 0, 1], atol=1e-6)  # u along x, v against y: the map's y is the world's
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(back.faces), 3000)
    frame = back.corner_tangent[face, 0]
    places, xy = at_points(back, "normal")
    xy = xy / 127.5 - 1
    bitangent = np.cross([0, 0, 1], frame[:, :3]) * frame[:, 3:]
    world = (xy[:, :1] * frame[:, :3] + xy[:, 1:] * bitangent)[:, :2]
    image = values_of_map("normal", waves(4)) / 127.5 - 1
    column, row = ((places * [1, -1] + [0, 1]) * 32).astype(int).clip(0, 31).T
    assert np.sqrt(((world - image[row, column]) ** 2).sum(axis=1).mean()) < 0.12  # a texel is 0.1 from the next
    assert np.abs((world - image[row, column]).mean(axis=0)).max() < 0.02


# Coarser levels and the validator.


@pytest.mark.parametrize("lod", [1, 2])
def test_coarser_levels_of_odd_images_keep_all_slots(tmp_path, lod):
    maps = {"normal": waves(1, 37, 29), "roughness": waves(2, 37, 29), "occlusion": waves(3, 37, 29), "emissive": waves(4, 8, 8)}
    scene = mapped_sheet(maps, waves(5, 37, 29), wrap=CLAMPED, parameters={"emissive": (1.0,) * 3})
    _, tree, back = there_and_back(scene, tmp_path, lod, **EXACT)
    assert set(back.materials[0].maps) == {*maps, "metallic"} and len(tree["images"]) == 4
    width, height = -(-29 >> lod), -(-37 >> lod)
    assert back.textures[back.materials[0].texture].image.shape[:2] == (height, width)
    rough = back.textures[back.materials[0].maps["roughness"]].image[..., 1]
    side, full = 1 << lod, waves(2, 37, 29)[..., 1].astype(float)
    means = [[full[side * r : side * (r + 1), side * c : side * (c + 1)].mean() for c in range(width)] for r in range(height)]
    assert np.sqrt(((rough - np.array(means)) ** 2).mean()) < 2
