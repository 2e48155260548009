"""encoder/prepare/materials.py: what of its materials a scene needs, decided by values, and what the report says of it."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from shapes import mapped_sheet, noise, plain_image, scene_of

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.prepare.materials import needed_scene
from texfcodec.errors import InputError
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import MAPS
from texfcodec.scene.effects import EFFECTS, effects_mask
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, ALPHA_OPAQUE, WRAP_CLAMP, Material, Texture
from texfcodec.scene.srgb import srgb_to_linear


def needs(scene, effects="auto"):
    decision = needed_scene(scene, make_surface(scene, EncodeOptions(resolution=64)), effects)
    return SimpleNamespace(**vars(decision.value), evidence=decision.evidence)


def decided(scene, effects="auto"):
    """({channel: its one decision}, the one material of the stream)."""
    found = needs(scene, effects)
    for entry in found.evidence:
        assert sum(entry[d] > 0 for d in ("coded", "constant", "absent")) == 1
    words = {e["channel"]: next(d for d in ("coded", "constant", "absent") if e[d]) for e in found.evidence}
    return words, found.materials[0]


SHARE = 128 / 255
USED = {"clearcoat": (1.0,), "sheen_colour": (1.0,) * 3, "transmission": (1.0,), "thickness": (1.0,), "iridescence": (1.0,),
        "anisotropy": (1.0,), "diffuse_transmission": (1.0,), "emissive": (1.0,) * 3}


# Maps of one value.


@pytest.mark.parametrize("name, image, given, expected", [
    ("roughness", plain_image(0, 128, 0), {}, {"roughness": (SHARE,)}),
    ("roughness", plain_image(0, 128, 0), {"roughness": (0.5,)}, {"roughness": (SHARE / 2,)}),
    ("metallic", plain_image(0, 0, 0), {}, {"metallic": (0.0,)}),
    ("emissive", plain_image(188, 255, 0), {"emissive": (1.0, 0.5, 1.0)},
     {"emissive": (float(srgb_to_linear(188 / 255)), 0.5, 0.0)}),
    ("clearcoat_roughness", plain_image(0, 128, 0), {"clearcoat": (1.0,), "clearcoat_roughness": (1.0,)},
     {"clearcoat": (1.0,), "clearcoat_roughness": (SHARE,)}),
    ("sheen_colour", plain_image(188), {"sheen_colour": (0.5,) * 3}, {"sheen_colour": (srgb_to_linear(188 / 255) / 2,) * 3}),
    ("thickness", plain_image(0, 128, 0), {"thickness": (3.0,)}, {"thickness": (3 * SHARE,)}),
    ("iridescence_thickness", plain_image(0, 128, 0), {"iridescence": (1.0,), "iridescence_thickness_minimum": (200.0,)},
     {"iridescence": (1.0,), "iridescence_thickness_minimum": (200.0,), "iridescence_thickness_maximum": (200 + 200 * SHARE,)}),
    ("specular", plain_image(1, 1, 1, 0), {}, {}),
])
def test_a_constant_map_becomes_its_factor(name, image, given, expected):
    if name == "specular":  # in the alpha of its image
        image[..., 3], expected = 128, {"specular": (SHARE,)}
    words, material = decided(mapped_sheet({name: image}, parameters=given))
    assert words == {name: "constant"} and material.maps == {}
    assert material.parameters.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_allclose(material.parameters[key], value, rtol=1e-6)


@pytest.mark.parametrize("name", [channel.name for channel in MAPS])
def test_a_map_that_equals_its_default_is_absent(name):
    image = plain_image(128, 128, 255) if name.endswith("normal") else plain_image(255)
    image = plain_image(255, 128, 255) if name == "anisotropy" else image
    words, material = decided(mapped_sheet({name: image}, parameters=dict(USED)))
    assert words == {name: "absent"} and material.maps == {} and material.parameters == USED


@pytest.mark.parametrize("name, image", [
    ("occlusion", plain_image(128)), ("normal", plain_image(150, 128, 253)), ("anisotropy", plain_image(128, 255, 128))])
def test_one_value_that_no_parameter_can_say_is_coded(name, image):
    found = needs(mapped_sheet({name: image}, parameters=dict(USED)))
    assert found.materials[0].maps == {name: 1} and found.materials[0].parameters == USED
    assert found.evidence[0]["coded"] == 1
    assert found.evidence[0]["reasons"] == ["the value is constant, but no parameter can hold it"]


@pytest.mark.parametrize("spread, decision", [(4, "constant"), (5, "coded")])
def test_values_count_as_one_within_two_levels_of_their_middle(spread, decision):
    image = plain_image(0, 100, 0, size=80)
    image[3, 77, 1] = 100 + spread  # where a look at every other texel would miss it
    words, material = decided(mapped_sheet({"roughness": image}))
    assert words == {"roughness": decision}
    assert decision == "coded" or material.parameters["roughness"] == (float(np.float32(102 / 255)),)


def test_only_what_the_surface_shows_counts():
    image = plain_image(0, 64, 0, size=32)
    image[:12, 20:] = noise(1, 12, 12)  # the sheet has u 0..0.5, and v 0.5..1
    scene = mapped_sheet({"roughness": image}, span=0.5, wrap=(WRAP_CLAMP, WRAP_CLAMP))
    scene.corner_uv[..., 1] += 0.5
    assert decided(scene)[0] == {"roughness": "constant"}
    scene.corner_uv[..., 1] -= 0.5
    scene.corner_uv[..., 0] += 0.5
    assert decided(scene)[0] == {"roughness": "coded"}
    scene.map_uv["roughness"] = scene.corner_uv - [0.5, -0.5]  # a map with UVs of its own
    assert decided(scene)[0] == {"roughness": "constant"}


# What nothing reads.


def test_maps_that_nothing_reads_are_absent_with_the_reason():
    maps = {"normal": noise(1), "clearcoat": noise(2), "metallic": noise(3), "emissive": noise(4), "occlusion": noise(5)}
    off = {"metallic": (0.0,), "normal_scale": (0.0,), "occlusion_strength": (0.0,)}
    found = needs(mapped_sheet(maps, parameters=off))
    assert found.materials[0].maps == {} and all(entry["absent"] == 1 for entry in found.evidence)
    assert {e["channel"]: e["reasons"] for e in found.evidence}["metallic"] == ["no metal: its factor is 0"]
    found = needs(mapped_sheet(maps, unlit=True))
    assert found.materials[0].maps == {} and {text for e in found.evidence for text in e["reasons"]} == {"the material is unlit"}
    assert decided(mapped_sheet({"emissive": noise(4)}, parameters={"emissive": (0.0, 0.1, 0.0)}))[0] == {"emissive": "coded"}


def test_alpha_that_is_255_wherever_it_is_seen_is_absent_and_the_mode_stays():
    for mode in (ALPHA_BLEND, ALPHA_MASK):
        found = needs(mapped_sheet({}, alpha_mode=mode))
        assert found.materials[0].alpha_mode == mode and found.scene.materials[0].alpha_mode == ALPHA_OPAQUE
        assert [(e["channel"], e["absent"], e["reasons"]) for e in found.evidence] == [("alpha", 1, ["255 everywhere"])]
    clear = noise(0)
    clear[:8, 24:, 3] = 0
    scene = mapped_sheet({}, clear, alpha_mode=ALPHA_BLEND, span=0.5, wrap=(WRAP_CLAMP, WRAP_CLAMP))
    scene.corner_uv[..., 1] += 0.5
    assert decided(scene)[0] == {"alpha": "absent"}
    for seen in (replace(scene, corner_uv=scene.corner_uv + [0.5, -0.5]),
                 replace(scene, materials=[replace(scene.materials[0], factor=np.array([1, 1, 1, 0.5]))]),
                 replace(scene, corner_color=np.full((len(scene.faces), 3, 4), 0.9, np.float32))):
        found = needs(seen)
        assert found.evidence[0]["coded"] == 1 and found.scene.materials[0].alpha_mode == ALPHA_BLEND


@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_a_blended_material_without_alpha_costs_no_plane_and_stays_blended(support):
    scene = mapped_sheet({}, alpha_mode=ALPHA_BLEND)
    texf = decode(encode_scene(scene, EncodeOptions(rate="r01", support=support)).data)
    assert not texf.has_alpha and texf.materials[0].alpha_mode == ALPHA_BLEND


def test_vertex_colours_are_no_map_and_leave_maps_alone():
    scene = mapped_sheet({"roughness": noise(1)})
    scene.corner_color = np.random.default_rng(0).random((len(scene.faces), 3, 4)).astype(np.float32)
    assert decided(scene)[0] == {"roughness": "coded"}


# --effects.


FULL = {"roughness": noise(1), "metallic": noise(2), "normal": noise(3), "emissive": plain_image(200), "clearcoat": noise(4)}
GIVEN = {"emissive": (1.0,) * 3, "ior": (1.25,)}


@pytest.mark.parametrize("asked, maps, parameters", [
    ("auto", {"roughness", "metallic", "normal"}, {"emissive", "ior"}),
    ("all", set(FULL), {"emissive", "ior"}),
    ("none", set(), {"metallic"}),
    ("metal", {"roughness", "metallic"}, set()),
    (" normal_map , emission ", {"roughness", "normal"}, {"emissive", "metallic"}),
    ("ior,lit", {"roughness"}, {"ior", "metallic"}),
])
def test_effects_that_are_asked_for(asked, maps, parameters):
    found = needs(mapped_sheet(FULL, parameters=dict(GIVEN)), asked)
    material = found.materials[0]
    assert set(material.maps) == maps and set(material.parameters) == parameters
    assert material.parameters.get("metallic", (0.0,)) == (0.0,)  # without metal nothing is one
    told = {entry["channel"] for entry in found.evidence if "not requested" in entry["reasons"]}
    assert told == (set() if asked in ("auto", "all") else set(FULL) - maps - (parameters - {"metallic"}))


@pytest.mark.parametrize("asked", ["bogus", "metal,bogus", "Metal", "auto,metal", 7, None])
def test_unknown_effects_are_refused_with_the_names_of_all(asked):
    with pytest.raises(InputError) as caught:
        needs(mapped_sheet({}), asked)
    assert caught.value.code == "TXF-I50" and all(
        effect.name in caught.value.details["allowed"] for effect in EFFECTS if effect.channels and effect.name != "lit")


@pytest.mark.parametrize("asked", ["auto", "all", "none", "normal_map", "metal,clearcoat"])
@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_streams_hold_what_was_asked_for_and_decode(asked, support):
    maps = FULL | {"occlusion": plain_image(128)}
    scene = mapped_sheet(maps, parameters=GIVEN | {"clearcoat": (0.5,)})
    texf = decode(encode_scene(scene, EncodeOptions(resolution=64, qp=32, support=support, effects=asked)).data)
    expected = needs(scene, asked).materials[0]
    assert set(texf.materials[0].maps) == set(expected.maps) and texf.materials[0].parameters == expected.parameters
    assert {channel.material_name for channel in texf.channels} == {"base_colour", *expected.maps}


def test_a_scan_without_light_has_no_effect_and_one_channel():
    data = encode_scene(mapped_sheet({"normal": noise(1)}, unlit=True), EncodeOptions(rate="r01")).data
    texf = decode(data)
    assert effects_mask(texf.materials) == 0 and [channel.name for channel in texf.channels] == ["base_colour"]


# Many materials.


def city(materials=167, textures=20):
    """A row of squares, a material each, which share images of their colour and occlusion."""
    x = np.arange(materials)[:, None]
    corners = np.stack([np.concatenate([x, x + 0.9, x + 0.9, x], 1), np.tile([0, 0, 1, 1], (materials, 1)),
                        np.zeros((materials, 4))], axis=-1)
    faces = (4 * np.arange(materials)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    uv = np.tile(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64), (materials, 1))
    look = [Material(f"house {i}", texture=i % textures, maps={"occlusion": i % textures},
                     parameters={"roughness": (i / materials,)}) for i in range(materials)]
    scene = scene_of(corners, faces, materials=look, face_material=np.repeat(np.arange(materials), 2))
    scene.corner_uv = uv[faces]
    scene.textures = [Texture(noise(i, 256, 256)) for i in range(textures)]
    return scene


def test_167_materials_are_decided_in_seconds_and_told_in_one_line():
    needs(city(2, 2))  # compiles
    begin = time.process_time()
    found = needs(city())
    assert time.process_time() - begin < 5
    assert [(e["channel"], e["coded"], e["reasons"]) for e in found.evidence] == [("occlusion", 167, ["the value varies"])]
    assert len(found.materials) == 167


def test_167_materials_arrive():
    scene = city()
    texf = decode(encode_scene(scene, EncodeOptions(resolution=64, qp=36, effort="fast")).data)
    assert [m.name for m in texf.materials] == [m.name for m in scene.materials]
    assert all(m.parameters == ({"roughness": (float(np.float32(i / 167)),)}) and set(m.maps) == {"occlusion"}
               for i, m in enumerate(texf.materials))
