"""Effects of materials: which are used, that the others cost nothing, and what bad input gives."""

import math

import numpy as np
import pytest
from lit import COUNT, directions, lit, material_of, table_of
from numpy.testing import assert_allclose, assert_array_equal

from texfcodec.render import material as shading
from texfcodec.render import terms
from texfcodec.render.environment import DAYLIGHT, Environment, furnace
from texfcodec.render.material import expose, shade
from texfcodec.render.material_effects import TERMS as CALLED
from texfcodec.render.material_effects import ShadingTable, shading_effects, sound_parameters
from texfcodec.render.shading_points import ShadingPoints
from texfcodec.scene.channels import BY_NAME, PARAMETERS
from texfcodec.scene.srgb import linear_to_srgb

# What is off is absent, and costs nothing.

FAINT = {"occlusion": ({"occlusion": [1 - 1e-5]}, {}), "emission": ({}, {"emissive": (1e-5,) * 3}),
         "specular": ({}, {"specular": 1 - 1e-5}), "ior": ({}, {"ior": 1.50001}),
         "clearcoat": ({}, {"clearcoat": 1e-5}), "sheen": ({}, {"sheen_colour": (1e-5,) * 3, "sheen_roughness": 0.3}),
         "transmission": ({}, {"transmission": 1e-5}), "volume": ({}, {"transmission": 1e-5, "thickness": 1}),
         "dispersion": ({}, {"transmission": 1e-5, "thickness": 1, "dispersion": 1}), "iridescence": ({}, {"iridescence": 1e-5}),
         "anisotropy": ({}, {"anisotropy": 1e-4}), "diffuse_transmission": ({}, {"diffuse_transmission": 1e-5})}
DEFAULTS = {parameter.name: parameter.default for parameter in PARAMETERS}


def test_every_effect_has_a_faint_form():
    assert set(FAINT) == CALLED - {"lit"}


@pytest.mark.parametrize("name", FAINT)
def test_a_faint_effect_is_hardly_seen_and_one_that_is_off_is_absent(name):
    channels, parameters = FAINT[name]
    for metallic, roughness in ((0, 0.3), (1, 0.7), (0.5, 0.5)):
        bare = lit(metallic=metallic, roughness=roughness)
        # the stretched lobe takes its squares of lengths in another order: its highlight differs by rounding, hence the share
        assert_allclose(lit(channels=channels, metallic=metallic, roughness=roughness, **parameters), bare, atol=1e-3, rtol=2e-3)
        off = {p: np.zeros(len(DEFAULTS[p])) for p in parameters if p not in ("ior", "specular")}
        assert_array_equal(lit(metallic=metallic, roughness=roughness, **off), bare)


TERMS = {"occlusion": "occlusion", "emission": "emission", "specular": "specular", "ior": "specular", "clearcoat": "clearcoat",
         "sheen": "sheen", "transmission": "transmission", "volume": "volume", "dispersion": "dispersed",
         "iridescence": "iridescence", "anisotropy": "anisotropic_gloss", "diffuse_transmission": "diffuse_transmission"}


@pytest.mark.parametrize("name", TERMS)
def test_a_term_is_evaluated_only_at_points_whose_material_uses_it(name, monkeypatch):
    asked = {term: 0 for term in (*TERMS.values(), "gloss", "diffuse")}

    def count(term, real):
        def counted(surface, *more):
            asked[term] += len(surface.material)
            return real(surface, *more)

        monkeypatch.setattr(terms, term, counted)

    for term in asked:
        count(term, getattr(terms, term))
    channels, parameters = FAINT[name]
    n, v = directions()
    material = np.arange(COUNT) % 3
    user = material_of({"metallic": 0, **parameters}, channels)
    table = ShadingTable([material_of({"metallic": 0.5}), user, material_of({"clearcoat": 1}, unlit=True)])
    values = {c: np.broadcast_to(np.float32(x), (COUNT, len(x))) for c, x in channels.items()}
    shade(ShadingPoints(material=material, normal=n, view=v, values=values), table, DAYLIGHT)
    used = {TERMS[effect] for effect in table.effects[1] & set(TERMS)}
    users = int((material == 1).sum())
    assert asked["gloss"] + asked["anisotropic_gloss"] == asked["diffuse"] == int((material < 2).sum())
    assert {term: asked[term] for term in TERMS.values()} == {term: users if term in used else 0 for term in TERMS.values()}


def test_unlit_materials_give_their_base_colour_and_ask_nothing(monkeypatch):
    for term in ("gloss", "diffuse", "emission", "clearcoat"):
        monkeypatch.setattr(terms, term, None)
    monkeypatch.setattr(Environment, "build", None)
    base = np.random.default_rng(0).random((COUNT, 3)).astype(np.float32)
    bright = Environment(gradient=DAYLIGHT.gradient, exposure=4.0)
    got = expose(lit(bright, base=base, unlit=True, emissive=(1, 1, 1), clearcoat=1), bright.exposure)
    assert_allclose(got, 255 * linear_to_srgb(base), atol=1e-3)


# Effects and their table.


def seen(parameters=None, channels=(), unlit=False):
    return shading_effects(material_of(parameters, channels, unlit)) - {"lit", "metal"}


def test_only_what_shows_is_an_effect():
    assert seen() == frozenset() and shading_effects(material_of()) == {"lit", "metal"}
    assert shading_effects(material_of({"clearcoat": 1, "emissive": (1, 1, 1)}, {"occlusion"}, unlit=True)) == frozenset()
    off = {"clearcoat": 0, "sheen_roughness": 1, "iridescence_ior": 2}
    assert seen(off, {"clearcoat", "sheen_colour"}) == frozenset()
    assert seen({"thickness": 1, "dispersion": 1}) == frozenset()  # nothing goes through
    assert seen({"thickness": 1, "dispersion": 1, "diffuse_transmission": 1}) == {"volume", "diffuse_transmission"}
    assert seen({"thickness": 1, "dispersion": 1, "transmission": 1}) == {"volume", "transmission", "dispersion"}
    assert seen({"occlusion_strength": 0}, {"occlusion"}) == frozenset()
    assert seen({}, {"specular_colour"}) == {"specular"} and seen({"ior": 1.3}) == {"ior"}


def test_parameters_that_make_no_sense_count_as_something_that_does():
    got = sound_parameters({"clearcoat": (math.nan,), "ior": (1, 2), "emissive_strength": (1e9,), "transmission": (-1,),
                            "anisotropy_rotation": (-1.5,), "attenuation_distance": (math.inf,), "unheard_of": (1,),
                            "metallic": (-1,)})
    assert got == {"emissive_strength": (65504.0,), "anisotropy_rotation": (-1.5,), "metallic": (0.0,)}


def test_table_wants_the_channels_of_its_effects_and_no_others():
    maps = {"roughness", "normal", "emissive", "clearcoat", "sheen_roughness", "occlusion", "thickness"}
    lit_one, plain = material_of({"emissive": (1, 1, 1), "thickness": 1}, maps), material_of({"clearcoat": 1}, maps, unlit=True)
    table = ShadingTable([lit_one, plain, material_of({"clearcoat": 1}, {"clearcoat", "clearcoat_normal", "metallic"})])
    assert table.wanted_channels([0, 1]) == {"roughness", "normal", "emissive", "occlusion"}
    assert table.wanted_channels() == {*table.wanted_channels([0]), "clearcoat", "clearcoat_normal", "metallic"}
    assert table.is_lit
    dark = ShadingTable([plain])
    assert dark.wanted_channels() == frozenset() and not dark.is_lit


def test_final_values_are_map_times_factor():
    table = ShadingTable([material_of(), material_of({"roughness": 0.5, "occlusion_strength": 0.25, "anisotropy": 0.5})])
    material = np.array([0, 1])
    assert table.final("roughness", material, np.full((2, 1), 0.5)).tolist() == [[0.5], [0.25]]
    assert table.final("occlusion", material, np.zeros((2, 1))).tolist() == [[0.0], [0.75]]
    assert table.final("anisotropy", material, np.full((2, 3), 0.5)).tolist() == [[0.5, 0.5, 0.0], [0.5, 0.5, 0.25]]
    assert table.final("iridescence_thickness", material, np.full((2, 1), 0.5)).tolist() == [[0.5], [0.5]]
    assert table.constant("roughness", material).tolist() == [[1.0], [0.5]]
    assert table.constant("occlusion", material).tolist() == [[1.0], [1.0]]
    assert table.constant("anisotropy", material).tolist() == [[1.0, 0.5, 0.0], [1.0, 0.5, 0.5]]


def test_a_material_that_is_not_there_is_an_error():
    n, v = directions(3)
    with pytest.raises(IndexError, match="outside the table"):
        shade(ShadingPoints(material=np.array([0, 1, 0]), normal=n, view=v), table_of(), DAYLIGHT)


# Bad input and threads.


WIDTHS = {name: BY_NAME[name].components for name in (
    "base_colour", "roughness", "metallic", "occlusion", "emissive", "clearcoat", "clearcoat_roughness", "sheen_colour",
    "sheen_roughness", "specular", "specular_colour", "transmission", "thickness", "iridescence", "iridescence_thickness",
    "anisotropy", "diffuse_transmission", "diffuse_transmission_colour")}


def everything(rng, count):
    """Points and a table of materials that use all effects, none, and some."""
    every = {name: tuple(2 * rng.random(len(default))) for name, default in DEFAULTS.items()}
    glass = {"dispersion": 1, "transmission": 1, "thickness": 1}
    table = ShadingTable([material_of(every, set(WIDTHS)), material_of(), material_of({"clearcoat": 1}, {"occlusion"}),
                          material_of(glass), material_of(glass, unlit=True)])
    values = {name: rng.random((count, width)).astype(np.float32) for name, width in WIDTHS.items()}
    n, v, coat = (rng.normal(size=(count, 3)).astype(np.float32) for _ in range(3))
    tangent = rng.normal(size=(count, 4)).astype(np.float32)
    material = rng.integers(0, 5, count)
    return ShadingPoints(material=material, normal=n, view=v, values=values, tangent=tangent, coat_normal=coat), table


@pytest.mark.parametrize("seed", range(4))
def test_extreme_input_gives_finite_colours(seed):
    rng = np.random.default_rng(seed)
    points, table = everything(rng, 4000)
    odd = np.array([np.nan, np.inf, -np.inf, 0, -0.0, 1e-40, 1e-20, 1e20, 3e38, -3e38, 1, -1, 0.5], np.float32)
    for array in (points.normal, points.view, points.tangent, points.coat_normal, *points.values.values()):
        hit = rng.random(array.shape) < 0.2
        array[hit] = rng.choice(odd, hit.sum())
    points.normal[:50], points.view[25:75] = points.view[:50], -points.normal[25:75]  # straight on, and from straight behind
    got = shade(points, table, DAYLIGHT)
    assert np.isfinite(got).all() and got.min() >= 0
    coded = expose(got)
    assert coded.min() >= 0 and coded.max() <= 255


@pytest.mark.parametrize("parameters", [
    {"ior": 0}, {"ior": 65504, "transmission": 1, "thickness": 1, "dispersion": 65504},
    {"attenuation_distance": 0, "transmission": 1, "thickness": 65504},
    {"iridescence": 1, "iridescence_ior": 0, "iridescence_thickness_minimum": 65504, "iridescence_thickness_maximum": 0},
    {"iridescence": 1, "iridescence_ior": 65504},
    {"emissive": (65504,) * 3, "emissive_strength": 65504}, {"sheen_colour": (65504,) * 3},
    {"specular": 65504, "specular_colour": (65504,) * 3}, {"anisotropy": 65504, "anisotropy_rotation": 65504},
    {"clearcoat": 65504, "clearcoat_roughness": 65504}, {"roughness": 65504, "metallic": 65504},
], ids=str)
def test_extreme_parameters_give_finite_colours(parameters):
    """Factors above 1 without a map count as 1, as in a map."""
    for metallic in {0, 0.5, parameters.get("metallic", 1)}:
        got = lit(**{**parameters, "metallic": metallic})
        assert np.isfinite(got).all() and got.min() >= 0
        if "emissive" not in parameters:
            assert lit(furnace(), **{**parameters, "metallic": metallic}).max() <= 1.02


@pytest.mark.parametrize("kind", ["normal", "view", "both"])
def test_directions_without_a_direction_count_as_the_view_or_as_z(kind):
    n, v = directions(4)
    z = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    for bad in (0, np.nan):
        broken = np.full_like(n, bad)
        got = lit(seen=(n if kind == "view" else broken, v if kind == "normal" else broken))
        assert_array_equal(got, lit(seen=(v if kind == "normal" else z if kind == "both" else n, v if kind == "normal" else z)))


def test_groups_blocks_and_threads_do_not_change_a_point(monkeypatch):
    points, table = everything(np.random.default_rng(8), 700)
    together = shade(points, table, DAYLIGHT)
    monkeypatch.setattr(shading, "BLOCK", 100)
    assert_allclose(shade(points, table, DAYLIGHT), together, rtol=1e-5, atol=1e-6)
    assert_array_equal(shade(points, table, DAYLIGHT, threads=1), shade(points, table, DAYLIGHT, threads=4))


def test_no_points_are_no_colours():
    none = np.zeros((0, 3), np.float32)
    got = shade(ShadingPoints(material=np.zeros(0, np.int64), normal=none, view=none), table_of(), DAYLIGHT)
    assert got.shape == (0, 3) and expose(got).shape == (0, 3)


def test_exposure_multiplies_before_coding_and_clamps():
    light = np.array([[0, 0.5, 1], [2, np.nan, -1], [np.inf, 0.25, 1e-3]], np.float32)
    assert_allclose(expose(light, 2), 255 * linear_to_srgb([[0, 1, 1], [1, 0, 0], [1, 0.5, 2e-3]]), atol=2e-3)
