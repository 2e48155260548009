"""What is one colour is known before anything is probed; what is nearly one colour is not taken for it."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import scene_of, sphere

from texfcodec import EncodeOptions, Report, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.prepare.uniform_colour import material_colours, uniform_colour
from texfcodec.encoder.search import encode_to_target
from texfcodec.encoder.supports.choice import COARSEST_K
from texfcodec.encoder.verify import encode_checked
from texfcodec.geometry.surface import make_surface
from texfcodec.options import RATES
from texfcodec.scene.channels import BASE_COLOUR
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Scene, Texture

RED = np.array([0.6, 0.1, 0.05, 1.0])
ONE_COLOUR = "the surface has one colour"


def red_ball(**material):
    """A sphere with a factor and no image."""
    return scene_of(*sphere(), materials=[Material("red", **{"factor": RED, **material})])


def textured_ball(image, wrap=WRAP_REPEAT, uv=None, **material):
    """A sphere that shows an image, uint8 [H, W, 4], with UVs that go around it once, or the given ones."""
    positions, faces = sphere()
    around = np.stack([np.arctan2(positions[:, 1], positions[:, 0]) / (2 * np.pi) + 0.5, positions[:, 2] / 2 + 0.5], axis=1)
    return Scene(positions, faces, np.zeros(len(faces), np.int64), around[faces] if uv is None else uv, None,
                 [Material("skin", texture=0, **material)], [Texture(image, (wrap, wrap))])


def image_of(value=(200, 40, 30, 255), size=64):
    return np.tile(np.array(value, np.uint8), (size, size, 1))


def half_image(size=64):
    """Red in its first half of rows, blue in the others."""
    image = image_of(size=size)
    image[size // 2 :] = (0, 0, 255, 255)
    return image


def colour_of(scene):
    """What a scene's materials all show; None where they differ."""
    surface = make_surface(scene, EncodeOptions())
    return uniform_colour(material_colours(scene, surface), surface.material)


@pytest.fixture
def nothing_probed(monkeypatch):
    """No probe, trial or fit may run."""
    def refuse(*_, **__):
        raise AssertionError("one colour was probed")

    for place in ("encoder.supports.probe.SampleRegion.__init__", "encoder.values.surface_fit.FieldSurface.sample",
                  "encoder.supports.probe.probe_voxels", "encoder.supports.probe.probe_texels",
                  "encoder.place.partition.uncoded_errors",
                  "encoder.values.source_field.transfer", "encoder.values.refinement.fit_surface"):
        monkeypatch.setattr(f"texfcodec.{place}", refuse)


BALLS = {
    "a factor": red_ball(),
    "white vertex colours": scene_of(*sphere(), np.ones((len(sphere()[0]), 4))),
    "vertex colours that are alike": scene_of(*sphere(), np.tile([0.2, 0.4, 0.6, 1.0], (len(sphere()[0]), 1))),
    "an image of one colour": textured_ball(image_of()),
    "an image of one colour whose alpha varies unseen": textured_ball(np.dstack([image_of()[..., :3], half_image()[..., 0]])),
    "the one colour that is shown of an image": textured_ball(half_image(), uv=np.full((len(sphere()[1]), 3, 2), 0.3)),
    "constant alpha": red_ball(factor=np.array([0.6, 0.1, 0.05, 0.4]), alpha_mode=ALPHA_BLEND),
    "two materials of one colour": scene_of(*sphere(), materials=[Material("a", factor=RED), Material("b", factor=RED)],
                                            face_material=np.arange(len(sphere()[1])) % 2),
}


@pytest.mark.parametrize("name", BALLS)
def test_one_colour_is_coded_without_a_probe_and_the_report_says_why(nothing_probed, name):
    scene, report = BALLS[name], Report()
    made = encode_scene(scene, EncodeOptions(rate="r03", threads=1), report)
    for stage in ("supports", "partition", "refinement"):
        assert made.choices[stage]["reason"].startswith(ONE_COLOUR)
    assert {row["codec"] for row in made.choices["channels"]} == {"constant"} and made.counts["fields"] == 1
    assert made.resolution == COARSEST_K and made.counts["texels"] == 0
    values = decode(made.data).fields[0].planes[BASE_COLOUR.name]
    assert (values == np.rint(colour_of(scene)[:3])).all()


@pytest.mark.parametrize("rate", RATES)
def test_one_colour_has_the_same_k_and_so_the_same_stream_at_any_rate(nothing_probed, rate):
    made = encode_scene(red_ball(), EncodeOptions(rate=rate, threads=1))
    assert made.resolution == COARSEST_K


@pytest.mark.parametrize("options", [{"resolution": 64, "qp": 20}, {"rate": "r03", "exact_rate": True},
                                     {"rate": "r03", "lossless": True}])
def test_k_that_was_asked_for_stays(nothing_probed, monkeypatch, options):
    monkeypatch.setitem(RATES, "r03", (200, 28))
    wanted = EncodeOptions(threads=1, **options)
    assert encode_scene(red_ball(), wanted).resolution == wanted.resolution


def one_off(image, row, column):
    image = image.copy()
    image[row, column, 0] ^= 1
    return image


CORNER = np.array([[0.26, 0.26], [0.26, 0.49], [0.49, 0.26]])  # of UVs: inside the first quarter, away from its border
VARIED = {
    "one texel by one level": textured_ball(one_off(image_of(), 30, 30)),
    "a texel between the corners of a face": textured_ball(
        one_off(image_of(), 22, 22), uv=np.tile(CORNER, (len(sphere()[1]), 1, 1))),
    "a texel beyond the border that is blended in": textured_ball(
        one_off(image_of(), 63, 0), uv=np.full((len(sphere()[1]), 3, 2), 0.001)),
    "one corner's vertex colour": replace(red_ball(), corner_color=np.ones((len(sphere()[1]), 3, 4), np.float32)
                                          - np.eye(len(sphere()[1]) * 3, 1, -77).reshape(-1, 3, 1).astype(np.float32) / 64),
    "alpha under a mask": textured_ball(np.dstack([image_of()[..., :3], half_image()[..., 0]]), alpha_mode=ALPHA_MASK),
    "two colours of two materials": scene_of(*sphere(), materials=[Material("a", factor=RED), Material("b", factor=RED / 2)],
                                             face_material=np.arange(len(sphere()[1])) % 2),
    "UVs that are no numbers": textured_ball(half_image(), uv=np.full((len(sphere()[1]), 3, 2), np.nan)),
}


@pytest.mark.parametrize("name", VARIED)
def test_what_is_nearly_one_colour_is_not_taken_for_it(name):
    assert colour_of(VARIED[name]) is None


@pytest.mark.parametrize("wrap, place, is_one", [
    (WRAP_REPEAT, 5.25, True), (WRAP_REPEAT, -0.25, False), (WRAP_CLAMP, -3.0, True), (WRAP_CLAMP, 9.0, False),
    (WRAP_MIRROR, 1.75, True), (WRAP_MIRROR, 2.75, False), (WRAP_MIRROR, -0.25, True),
])
def test_wrap_modes_decide_which_half_of_an_image_is_shown(wrap, place, is_one):
    """With the faces' corners in one row: of the red half, or, with one of them in the middle of it, of both."""
    uv = np.full((len(sphere()[1]), 3, 2), 0.25)
    uv[..., 1] = place
    uv[7, 0, 1] = place if is_one else 0.25
    shown = colour_of(textured_ball(half_image(), wrap, uv))
    assert (shown is not None) is is_one


def test_a_map_leaves_the_choice_of_supports_open_but_colours_need_no_partition(monkeypatch):
    monkeypatch.setitem(RATES, "r03", (128, 28))
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 4), np.uint8)
    scene = replace(textured_ball(image_of(), maps={"roughness": 1}), textures=[Texture(image_of()), Texture(noise)])
    made = encode_scene(scene, EncodeOptions(rate="r03", effort="fast", threads=1))
    assert made.choices["supports"]["groups"]
    made = encode_scene(scene, EncodeOptions(resolution=64, qp=28, threads=1))
    assert all(made.choices[stage]["reason"].startswith(ONE_COLOUR) for stage in ("partition", "refinement"))
    assert [row["codec"] for row in made.choices["channels"]] == ["constant", "raht"]


def test_a_nearest_sampler_of_one_colour_loses_nothing():
    scene, report = textured_ball(image_of()), Report()
    scene.textures[0].nearest = True
    encode_scene(scene, EncodeOptions(rate="r03", threads=1), report)
    assert not report.dropped


@pytest.mark.parametrize("has_normals", [False, True])
def test_the_check_draws_one_colour_only_where_it_has_normals_of_its_own(has_normals):
    scene = red_ball()
    if has_normals:
        scene.corner_normal = scene.positions[scene.faces].astype(np.float32)
    made = encode_checked(scene, EncodeOptions(rate="r03", threads=1), Report())
    assert ("lit" in made.check) is has_normals
    assert made.check["visible"] and made.check["decoded_units"][1] == 1
    assert made.check["worst"] is None or made.check["worst"]["rgb"] > 50


@pytest.mark.parametrize("target", [{"target_bytes": 100_000}, {"target_psnr": 40.0}])
def test_a_target_takes_one_trial_where_no_qp_changes_anything(nothing_probed, monkeypatch, target):
    monkeypatch.setattr("texfcodec.encoder.search.SEARCH_SAMPLES", 20_000)
    made = encode_to_target(red_ball(), EncodeOptions(threads=1, **target), Report())
    assert len(made.choices["search"]) == 1
