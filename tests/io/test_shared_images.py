"""Images of a decoded stream that materials share stand in its GLB once: equal ones, and tints of one image."""

import json

import numpy as np
import pytest
from shapes import mapped_sheet, noise
from test_materials_back import tree_of, waves

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.load import load
from texfcodec.io.save import save
from texfcodec.options import EncodeOptions
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_OPAQUE, Material, Scene, Texture
from texfcodec.scene.srgb import linear_to_srgb, srgb_to_linear

OPAQUE = np.array([0, 0, 0, 255], np.uint8)
EXACT = {"support": "texels", "max_error": 0, "effort": "fast"}


def side_by_side(materials, images):
    """A wavy sheet for every Material, all with the images of one list."""
    one = mapped_sheet({}, images[0])
    count, faces = len(materials), len(one.faces)
    positions = np.concatenate([one.positions + (1.25 * n, 0, 0) for n in range(count)])
    return Scene(positions=positions, faces=np.concatenate([one.faces + n * len(one.positions) for n in range(count)]),
                 face_material=np.repeat(np.arange(count), faces), corner_uv=np.tile(one.corner_uv, (count, 1, 1)),
                 corner_color=None, materials=materials,
                 textures=[Texture(image, name=f"image {n}") for n, image in enumerate(images)])


def tints(count=6, **more):
    rng = np.random.default_rng(5)
    return [Material(f"m{n}", texture=0, factor=np.append(rng.uniform(0.2, 1, 3), 1.0), **more) for n in range(count)]


def back_and_forth(scene, folder, **options):
    """(Texf, glTF JSON, Scene that the GLB loads as, bytes of the GLB)."""
    texf = decode(encode_scene(scene, EncodeOptions(**(options or EXACT))).data)
    save(texf, folder / "a.glb", texture_format="png")
    return texf, tree_of(folder / "a.glb"), load(folder / "a.glb"), (folder / "a.glb").stat().st_size


def shown(scene, number):
    """Levels 0..255 of a material's image with its factor."""
    material = scene.materials[number]
    light = srgb_to_linear(scene.textures[material.texture].image[..., :3] / 255) * material.factor[:3]
    return 255 * linear_to_srgb(light)


def test_tints_of_one_image_are_one_image_and_factors(tmp_path):
    scene = side_by_side(tints(maps={"normal": 1, "roughness": 2}), [waves(1) | OPAQUE, waves(2), waves(3)])
    texf, tree, back, _ = back_and_forth(scene, tmp_path)
    assert len(texf.fields) == 6 and len(tree["images"]) == 3 and len(tree["materials"]) == 6
    for number in range(6):
        assert np.abs(shown(back, number) - shown(scene, number)).max() < 4
        assert np.sqrt(np.mean((shown(back, number) - shown(scene, number)) ** 2)) < 1


def test_a_glb_of_many_tints_is_hardly_larger_than_of_one_at_a_lossy_rate(tmp_path):
    image = waves(1, 128, 128) | OPAQUE
    sizes = {}
    for name, materials in (("plain", [Material(f"m{n}", texture=0) for n in range(6)]), ("tints", tints())):
        *_, sizes[name] = back_and_forth(side_by_side(materials, [image]), tmp_path, support="texels", qp=28)
    assert sizes["tints"] < 1.5 * sizes["plain"]


@pytest.mark.parametrize("change", ["patch", "faint patch", "alpha", "other image", "wrap"])
def test_images_that_are_no_multiples_stay_apart(tmp_path, change):
    image = waves(1, 64, 64) | OPAQUE
    if change == "alpha":
        image[:, :32, 3] = 128
    other = image.copy()
    if change == "alpha":
        other[..., 3] = image[:, ::-1, 3]
    elif change == "faint patch":  # too faint for the error of the whole image
        other[8:16, 8:16, :3] ^= 16
    elif change == "patch":
        other[8:16, 8:16, :3] = 255 - other[8:16, 8:16, :3]
    elif change == "other image":
        other = noise(3, 64, 64)
    scene = side_by_side(tints(2, alpha_mode=ALPHA_BLEND if change == "alpha" else ALPHA_OPAQUE), [image, other])
    scene.materials[1].texture = 1
    if change == "wrap":
        scene.textures[1].wrap = (1, 1)
    _, tree, back, _ = back_and_forth(scene, tmp_path)
    assert len(tree["images"]) == 2
    for number in range(2):
        assert np.abs(shown(back, number) - shown(scene, number)).max() < 2.1


def test_factors_that_are_no_colour_share_fields_and_images_in_the_stream(tmp_path):
    maps = {"roughness": 1, "metallic": 1, "emissive": 2, "clearcoat": 1}
    factors = [{"roughness": (0.3 + 0.1 * n,), "metallic": (0.9 - 0.1 * n,), "emissive": (0.1 * n + 0.1, 0.5, 0.0),
                "clearcoat": (0.1 * n + 0.2,), "ior": (1.31 + 0.1 * n,)} for n in range(6)]
    materials = [Material(f"m{n}", texture=0, maps=dict(maps), parameters=factors[n], double_sided=bool(n % 2)) for n in range(6)]
    scene = side_by_side(materials, [waves(1) | OPAQUE, waves(2), waves(3)])
    texf, tree, back, _ = back_and_forth(scene, tmp_path)
    assert len(texf.fields) == 1 and len(tree["images"]) == 4 and len(tree["materials"]) == 6
    for number, material in enumerate(back.materials):
        assert material.parameters["ior"] == pytest.approx(materials[number].parameters["ior"])
        assert material.parameters["emissive"] == pytest.approx(materials[number].parameters["emissive"])


def test_alpha_modes_of_an_opaque_image_share_its_field(tmp_path):
    materials = [Material(f"m{n}", texture=0, alpha_mode=n % 3) for n in range(6)]
    texf, tree, *_ = back_and_forth(side_by_side(materials, [waves(1) | OPAQUE]), tmp_path)
    assert len(texf.fields) == 1 and len(tree["images"]) == 1


def test_gltf_beside_its_images_names_each_once(tmp_path):
    scene = side_by_side(tints(3), [waves(1) | OPAQUE])
    texf = decode(encode_scene(scene, EncodeOptions(**EXACT)).data)
    report = save(texf, tmp_path / "a.gltf")
    assert len(json.loads((tmp_path / "a.gltf").read_text())["images"]) == 1 and len(report["files"]) == 3
