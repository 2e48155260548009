"""Maps of materials on their way into fields: groups, sizes, frames of normal maps, and what stays over voxels."""

from types import SimpleNamespace

import numpy as np
import pytest
from shapes import mapped_sheet, noise, plain_image

from texfcodec.api import decode
from texfcodec.codecs.base import Group
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.supports.image_groups import image_groups
from texfcodec.encoder.values.map_planes import groups_of, joined, with_grey
from texfcodec.encoder.values.shown_maps import frame_rotation, rotate_xy
from texfcodec.field.texels import TexelSupport
from texfcodec.geometry.shading_normals import corner_normals
from texfcodec.geometry.surface import make_surface
from texfcodec.geometry.tangents import corner_tangents
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import BY_NAME, CHANNELS
from texfcodec.scene.fetch import values_of_map
from texfcodec.scene.scene import ALPHA_BLEND, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Texture

EXACT = {"support": "texels", "max_error": 0}
CLAMPED = (WRAP_CLAMP, WRAP_CLAMP)


def coded(scene, **options):
    return decode(encode_scene(scene, EncodeOptions(**(EXACT | options))).data)


def smooth(height, width, seed=0):
    """Waves in all columns but alpha, uint8 [height, width, 4]; normals of the upper half."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] * 2 * np.pi
    image = np.full((height, width, 4), 255, np.uint8)
    for c in range(3):
        image[..., c] = np.rint(150 + 90 * np.sin(x / width * rng.integers(1, 3) + y / height + 7 * rng.random()))
    return image


# Groups.


def test_roughness_and_metal_are_one_group_and_all_others_stand_alone():
    names = [channel.name for channel in CHANNELS[2:]]
    found = [[c.name for c in group.channels] for group in groups_of(set(names), alpha=True)]
    assert [name for group in found for name in group] == [channel.name for channel in CHANNELS]
    assert [group for group in found if len(group) > 1] == [["roughness", "metallic"]]
    assert [[c.name for c in g.channels] for g in groups_of({"metallic"}, alpha=False)] == [["base_colour"], ["metallic"]]


def part_of(planes, shifts=None, side=8):
    keys = np.arange(side * side, dtype=np.int64)
    keys = np.sort(sum(((keys >> b & 1) << 3 * (b // 2) + b % 2 for b in range(6)), 0 * keys))
    support = TexelSupport(keys=keys, width=side, height=side, wrap=CLAMPED, fraction_bits=0)
    return SimpleNamespace(support=support, planes=planes, shifts=shifts or {})


def test_a_field_without_one_channel_of_a_group_has_255_there():
    group = Group((BY_NAME["roughness"], BY_NAME["metallic"]))
    rough = np.arange(64, dtype=np.float32)[:, None]
    plane, shift = joined(part_of({"roughness": rough}), group)
    assert shift == 0 and plane.dtype == np.float32 and np.array_equal(plane, np.hstack([rough, np.full((64, 1), 255)]))


def test_channels_of_a_group_meet_at_the_finer_of_their_levels():
    group = Group((BY_NAME["roughness"], BY_NAME["metallic"]))
    rough, metal = np.arange(16, dtype=np.float32)[:, None], np.arange(4, dtype=np.float32)[:, None]
    part = part_of({"roughness": rough, "metallic": metal}, {"roughness": 1, "metallic": 2})
    plane, shift = joined(part, group)
    assert shift == 1 and np.array_equal(plane[:, 0], rough[:, 0]) and np.array_equal(plane[:, 1], np.repeat(metal[:, 0], 4))


def test_colours_are_grey_where_they_are_in_every_field():
    group = Group((BY_NAME["emissive"],))
    grey = np.repeat(np.arange(64, dtype=np.float32)[:, None], 3, axis=1)
    tinted = grey + np.array([0, 0, 0.6], np.float32)
    mark = lambda *planes: with_grey((group,), [part_of({"emissive": plane}) for plane in planes])[0].grey
    assert mark(grey) and mark(grey, grey) and not mark(tinted) and not mark(grey, tinted)
    normal = Group((BY_NAME["normal"],))
    assert not with_grey((normal,), [part_of({"normal": grey[:, :2]})])[0].grey


@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_grey_maps_take_one_component_and_come_back_as_three(support):
    image = noise(1)
    image[..., :3] = image[..., :1]
    texf = coded(mapped_sheet({"emissive": image}, parameters={"emissive": (1.0, 0.5, 0.2)}), support=support, resolution=48)
    (group,) = [g for g in texf.groups if g.channels[0].name == "emissive"]
    plane = texf.fields[0].planes["emissive"]
    assert group.grey and plane.shape[1] == 3 and (np.ptp(plane, axis=1) == 0).all() and plane.std() > 10


# Sizes over texels.


SIZES = {"same": (32, 32), "half": (16, 16), "quarter": (8, 8), "odd": (24, 24), "half one way": (32, 16), "tiny": (1, 1),
         "double": (64, 64), "larger one way": (32, 64), "prime": (37, 13)}


@pytest.mark.parametrize("name", ["roughness", "emissive", "specular", "normal"])
@pytest.mark.parametrize("size", SIZES)
def test_maps_of_any_size_share_a_field_with_their_base_colour(name, size):
    height, width = SIZES[size]
    image = smooth(height, width)
    image[..., 3] = image[..., 0] if name == "specular" else 255
    scene = mapped_sheet({name: image}, smooth(32, 32, 1), wrap=CLAMPED, parameters={"emissive": (1.0,) * 3})
    texf = coded(scene, effects="all")
    (part,) = texf.fields
    assert part.over_texels and set(part.planes) == {"base_colour", name}
    full, columns = part.support, np.linspace(0.06, 0.94, 9)
    assert full.size == (max(width, 32), max(height, 32))
    u, v = (a.ravel() for a in np.meshgrid(columns, columns))
    places = np.stack([u, v], axis=1)
    got = part.support_of(name).query(places * full.size, part.planes[name])
    expected = bilinear(values_of_map(name, image), places)
    shift = {"half": 1, "quarter": 2, "tiny": 5}.get(size, 0)
    assert part.shifts.get(name, 0) == shift
    exact = size in ("same", "half", "quarter", "tiny", "double", "larger one way")
    apart = np.abs(got - expected)
    assert apart.max() <= 0.51 if exact else np.sqrt((apart**2).mean()) < 4  # another raster rounds the waves' crests off


def bilinear(values, places):
    """values float32 [H, W, C] at places [M, 2] in 0..1, borders repeated."""
    height, width = values.shape[:2]
    x, y = places[:, 0] * width - 0.5, places[:, 1] * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    at = lambda dx, dy: values[np.clip(top + dy, 0, height - 1), np.clip(left + dx, 0, width - 1)]
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    return (1 - fy) * ((1 - fx) * at(0, 0) + fx * at(1, 0)) + fy * ((1 - fx) * at(0, 1) + fx * at(1, 1))


def test_a_material_without_base_colour_image_takes_the_size_of_its_maps():
    scene = mapped_sheet({"roughness": noise(1, 16, 16), "normal": smooth(32, 32)}, texture=-1, wrap=CLAMPED,
                         factor=np.array([0.2, 0.4, 0.6, 1]))
    texf = coded(scene)
    (part,) = texf.fields
    assert part.over_texels and part.support.size == (32, 32) and (np.ptp(part.planes["base_colour"], axis=0) == 0).all()
    assert part.support_of("roughness").size == (16, 16)


# What goes together.


def groups_found(scene):
    return image_groups(scene, make_surface(scene, EncodeOptions()))


def test_maps_with_other_uvs_or_wraps_stay_over_voxels():
    scene = mapped_sheet({"roughness": noise(1)})
    assert len(groups_found(scene)) == 1
    scene.map_uv["roughness"] = scene.corner_uv + 0.25
    assert groups_found(scene) == [] and not coded(scene, resolution=32).fields[0].over_texels
    scene.map_uv["roughness"] = scene.corner_uv.copy()  # other sets with the same numbers are the same
    assert len(groups_found(scene)) == 1
    scene.textures[1].wrap = (WRAP_REPEAT, WRAP_MIRROR)
    assert groups_found(scene) == [] and not coded(scene, resolution=32).fields[0].over_texels


def test_materials_share_a_field_where_all_of_their_images_are_the_same():
    scene = mapped_sheet({"roughness": noise(1)})
    other = Material("twin", texture=0, maps={"roughness": 2}, parameters={"roughness": (0.5,)})
    scene.materials.append(other)
    scene.textures.append(Texture(noise(1), name="the same by content"))
    scene.face_material[::2] = 1
    assert len(groups_found(scene)) == 1
    scene.textures[2].image = noise(2)
    assert len(groups_found(scene)) == 2
    other.maps = {}
    assert len(groups_found(scene)) == 2


@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_fields_have_planes_of_the_channels_that_their_own_materials_name(support):
    scene = mapped_sheet({"roughness": noise(1)}, cells=6)
    scene.materials.append(Material("other", texture=1, maps={"metallic": 0, "occlusion": 0}))
    scene.face_material[len(scene.face_material) // 2 :] = 1
    texf = coded(scene, support=support, resolution=48)
    assert [set(m.maps) for m in texf.materials] == [{"roughness"}, {"metallic", "occlusion"}]
    planes = [set(part.planes) for part in texf.fields]
    if support == "texels":
        joint = {"base_colour", "roughness", "metallic"}
        assert sorted(planes, key=len) == [joint, joint | {"occlusion"}]
        plain = next(part for part in texf.fields if "occlusion" not in part.planes)
        assert (plain.planes["metallic"] == 255).all() and np.ptp(plain.planes["roughness"]) > 200
    else:
        assert planes == [{"base_colour", "roughness", "metallic", "occlusion"}]


def test_alpha_of_a_blended_material_stays_with_its_maps():
    clear = noise(0)
    clear[..., 3] = noise(5)[..., 0]
    texf = coded(mapped_sheet({"roughness": noise(1)}, clear, alpha_mode=ALPHA_BLEND))
    xy = texf.fields[0].support.xy()
    assert np.array_equal(texf.fields[0].planes["alpha"][:, 0], clear[xy[:, 1], xy[:, 0], 3])
    assert np.array_equal(texf.fields[0].planes["roughness"][:, 0], noise(1)[xy[:, 1], xy[:, 0], 1])


# Normal maps.


def with_tangents(scene, change):
    """The scene with smooth normals, and tangents as change makes them of the right ones, float32 [F, 3, 4]."""
    lattice = np.rint(scene.positions * 16000).astype(np.int64)
    scene.corner_normal = corner_normals(lattice, scene.faces)
    scene.corner_tangent = change(corner_tangents(scene.positions, scene.faces, scene.corner_uv, scene.corner_normal),
                                  scene.corner_normal)
    return scene


def flipped(tangent, _):
    return tangent * np.array([1, 1, 1, -1], np.float32)


def quarter(tangent, normal):
    """Tangents where the bitangents were."""
    out = tangent.copy()
    out[..., :3] = np.cross(normal, tangent[..., :3]) * tangent[..., 3:]
    return out


@pytest.mark.parametrize("change, expected", [
    (lambda t, n: t, None), (flipped, [[1, 0], [0, -1]]), (quarter, [[0, -1], [1, 0]])])
def test_normal_maps_are_turned_from_the_files_frame_into_the_decoders(change, expected):
    scene = with_tangents(mapped_sheet({"normal": smooth(32, 32)}, wrap=CLAMPED), change)
    surface = make_surface(scene, EncodeOptions())
    rotation = frame_rotation(scene, surface, np.arange(len(surface.faces)))
    part = coded(scene).fields[0]
    xy = part.support.xy()
    values = values_of_map("normal", scene.textures[1].image)[xy[:, 1], xy[:, 0]]
    if expected is None:
        assert rotation is None
    else:
        np.testing.assert_allclose(rotation, expected, atol=0.02)
        assert np.abs(rotate_xy(values, rotation) - values).max() > 50
    assert np.abs(part.planes["normal"] - rotate_xy(values, None if expected is None else np.array(expected, float))).max() < 3


def test_tangents_that_say_nothing_leave_the_map_as_it_is():
    scene = with_tangents(mapped_sheet({"normal": smooth(32, 32)}, wrap=CLAMPED), lambda t, n: 0 * t)
    surface = make_surface(scene, EncodeOptions())
    assert frame_rotation(scene, surface, np.arange(0)) is None
    xy = (part := coded(scene).fields[0]).support.xy()
    values = values_of_map("normal", scene.textures[1].image)[xy[:, 1], xy[:, 0]]
    assert np.abs(part.planes["normal"] - values).max() < 0.51


def test_normals_without_length_or_below_the_surface_count_as_something_that_is():
    texels = np.array([[128, 128, 255], [127, 128, 128], [255, 128, 0], [0, 0, 0], [255, 255, 128]], np.uint8)
    xy = values_of_map("normal", texels) / 127.5 - 1
    assert np.isfinite(xy).all() and (np.linalg.norm(xy, axis=1) <= 1.001).all()
    assert np.abs(xy[:2]).max() < 0.9 and xy[2, 0] > 0.99 and np.allclose(xy[3], -np.sqrt(0.5), atol=0.01)


def test_flat_normal_maps_and_white_maps_of_many_materials_leave_no_channel():
    scene = mapped_sheet({"normal": plain_image(128, 128, 255), "roughness": plain_image(255)})
    texf = coded(scene)
    assert [channel.name for channel in texf.channels] == ["base_colour"] and texf.materials[0].parameters == {}
