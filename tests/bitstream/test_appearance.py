"""Materials, effects and the maps of fields: what is written of them, and what a surface point is answered (clauses 5.4.2
and 8.2)."""

import math
from fractions import Fraction

import numpy as np
import pytest
from conftest import REPOSITORY
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import crossing_sheets

from conformance.reference import materials as naive
from conformance.reference.bits import Reader
from conformance.reference.texels import bilinear
from oracles import kernels as oracles
from texfcodec import DecodeOptions, EncodeOptions, decode, encode, inspect
from texfcodec.bitstream.appearance import material_of, parameter_values
from texfcodec.bitstream.syntax import MATERIAL
from texfcodec.bitstream.values import material_values
from texfcodec.core.syntax_walk import write_structure
from texfcodec.errors import InputError
from texfcodec.scene.channels import BY_NAME, LARGEST, MAPS, PARAMETER_BY_NAME, PARAMETERS
from texfcodec.scene.effects import EFFECTS, effects_mask, in_words
from texfcodec.scene.factors import set_factor
from texfcodec.scene.scene import Material

SMALL = EncodeOptions(resolution=12, qp=40, support="voxels", refine="off")


def with_parameters(**parameters):
    """A small scene whose materials have these parameters."""
    scene = crossing_sheets()
    for material in scene.materials:
        material.parameters = {name: value if isinstance(value, tuple) else (value,) for name, value in parameters.items()}
    return scene


# What is written


@pytest.mark.parametrize("name, value, kept", [
    ("ior", 1.5, None), ("ior", 1.5 + 1e-9, None), ("ior", 1.25, 1.25), ("iridescence_ior", 1.3, None),
    ("dispersion", -0.0, None), ("attenuation_distance", math.inf, None), ("attenuation_distance", 1e60, LARGEST),
    ("thickness", 1e-60, None), ("normal_scale", -1e300, -LARGEST), ("roughness", 0.1, float(np.float32(0.1))),
])
def test_parameters_are_kept_in_binary32_and_their_defaults_are_not(name, value, kept):
    (material, *_) = decode(encode(with_parameters(**{name: value}), SMALL)).materials
    assert material.parameters == ({} if kept is None else {name: (kept,)})


def test_effects_are_those_of_what_a_decoder_sees():
    """A number that binary32 takes for its default has no effect, and one that it does not has."""
    told = lambda **parameters: set(inspect(encode(with_parameters(**parameters), SMALL))["effects"])
    usual = told()
    assert told(emissive=(1e-60, 0.0, 0.0), transmission=1e-50, ior=1.5 + 1e-9) == usual
    assert told(emissive=(1e-40, 0.0, 0.0), transmission=0.5, ior=1.6) - usual == {"emission", "transmission", "ior"}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, (1.0, 1.0)])
def test_parameters_that_no_stream_holds_are_refused(value):
    with pytest.raises(InputError) as caught:
        encode(with_parameters(roughness=value), SMALL)
    assert caught.value.code == ("TXF-I22" if isinstance(value, tuple) else "TXF-I14") and "roughness" in str(caught.value)


def number():
    return st.one_of(st.sampled_from([0.0, -0.0, 1.0, 1e-50, 0.5, -2.0]), st.floats(-1e39, 1e39))


@st.composite
def any_material(draw):
    names = draw(st.sets(st.sampled_from([p.name for p in PARAMETERS])))
    values = {name: tuple(draw(number()) for _ in PARAMETER_BY_NAME[name].default) for name in sorted(names)}
    maps = dict.fromkeys(draw(st.sets(st.sampled_from([c.name for c in MAPS]))), -1)
    return Material(draw(st.text(max_size=5)), alpha_mode=draw(st.integers(0, 2)), double_sided=draw(st.booleans()),
                    unlit=draw(st.booleans()), maps=maps, parameters=values)


def naive_effects(material):
    """Names of the effects of a naive decoder's material, by docs/design/materials.md."""
    value = lambda name: material["parameters"].get(PARAMETER_BY_NAME[name].number, list(PARAMETER_BY_NAME[name].default))
    above = lambda *names: all(max(value(name)) > 0 for name in names)
    mapped = lambda name, scale: BY_NAME[name].semantic in material["channels"] and value(scale) != [0]
    given = lambda *names: any(PARAMETER_BY_NAME[name].number in material["parameters"] for name in names)
    lit = {"lit": True, "metal": above("metallic"), "normal_map": mapped("normal", "normal_scale"),
           "occlusion": mapped("occlusion", "occlusion_strength"), "emission": above("emissive", "emissive_strength"),
           "clearcoat": above("clearcoat"),
           "clearcoat_normal_map": above("clearcoat") and mapped("clearcoat_normal", "clearcoat_normal_scale"),
           "sheen": above("sheen_colour"), "transmission": above("transmission"), "volume": above("thickness"),
           "specular": given("specular", "specular_colour") or {14, 15} & material["channels"],
           "iridescence": above("iridescence"), "anisotropy": above("anisotropy"), "ior": given("ior"),
           "diffuse_transmission": above("diffuse_transmission"), "dispersion": above("thickness", "dispersion")}
    always = {"mask": material["alpha_mode"] == 1, "blend": material["alpha_mode"] == 2, "double_sided": material["flags"] & 1}
    return {name for name, on in (always if material["flags"] & 2 else always | lit).items() if on}


@settings(deadline=None, max_examples=200)
@given(any_material())
def test_materials_and_their_effects_are_those_of_the_naive_decoder(material):
    values = material_values(material)
    ours, theirs = material_of(values), naive.read_material(Reader(write_structure(MATERIAL, values)))
    assert {PARAMETER_BY_NAME[name].number: list(v) for name, v in ours.parameters.items()} == theirs["parameters"]
    assert {c.semantic for c in MAPS if c.name in ours.maps} == theirs["channels"] and ours.maps.keys() == material.maps.keys()
    assert set(in_words(effects_mask([ours]))) == naive_effects(theirs)
    assert material_values(ours) == values


def test_an_unlit_material_has_no_effect_but_those_of_its_alpha_and_sides():
    rich = {"maps": dict.fromkeys((c.name for c in MAPS), -1), "alpha_mode": 1, "double_sided": True,
            "parameters": {p.name: tuple(0.5 for _ in p.default) for p in PARAMETERS}}
    names = lambda **changes: {effect.name for effect in EFFECTS if effect.used(Material(**rich | changes))}
    assert names(unlit=True) == {"mask", "double_sided"} and names() == {effect.name for effect in EFFECTS} - {"blend"}


# What a point is answered


def vector(name):
    return (REPOSITORY / "conformance" / "uncommon" / name / "in.texf").read_bytes()


def points_on(texf, count, seed=0):
    """(points, faces, shares of their corners) on random faces."""
    rng = np.random.default_rng(seed)
    faces, shares = rng.integers(0, len(texf.faces), count), rng.dirichlet(np.ones(3), count)
    return (texf.positions[texf.faces[faces]] * shares[:, :, None]).sum(axis=1), faces, shares


@pytest.mark.parametrize("lod", [0, 1, 2, 4])
def test_points_ask_coarser_voxels_at_their_own_level(lod):
    texf = decode(vector("maps_shift_voxels"), DecodeOptions(lod=lod))
    points, faces, _ = points_on(texf, 40)
    (field,) = texf.fields
    names = sorted(field.planes)
    answers = texf.query_planes(0, names, points, faces)
    levels = {"base_colour": 0, "occlusion": 1, "roughness": 1, "emissive": 3, "metallic": 4}
    assert levels.keys() == {*names}
    for name in names:
        level = min(max(lod, levels[name]), 4)
        support, plane = field.support_of(name), field.planes[name].astype(int)
        assert support.level_shift == level and len(plane) == len(support)
        cells = [tuple(v) for v in support.xyz().tolist()]
        for point, answer in zip(texf.cube.to_grid(points, 13) / 2.0**level, answers[name].tolist(), strict=True):
            bounds = [oracles.query(point, dict(zip(cells, column.tolist(), strict=True))) for column in plane.T]
            assert all(low - 0.01 <= one <= high + 0.01 for one, (low, high) in zip(answer, bounds, strict=True))


@pytest.mark.parametrize("lod", [0, 2, 5])
def test_points_ask_coarser_texels_at_their_own_level(lod):
    texf = decode(vector("maps_shift_texels"), DecodeOptions(lod=lod))
    points, faces, shares = points_on(texf, 40, seed=1)
    uv = (texf.uv[texf.faces[faces]] * shares[:, :, None]).sum(axis=1)
    (field,) = texf.fields
    answers = texf.query_planes(0, sorted(field.planes), points, faces)
    image = {"width": 21, "height": 13, "wrap_s": 0, "wrap_t": 0}
    levels = {"base_colour": 0, "occlusion": 1, "roughness": 1, "emissive": 3, "metallic": 5}
    for name, plane in field.planes.items():
        support = field.support_of(name)
        values = dict(zip(map(tuple, support.xy().tolist()), plane.tolist(), strict=True))
        for place, answer in zip(uv.tolist(), answers[name].tolist(), strict=True):
            exact = bilinear([Fraction(v) for v in place], image, values, max(lod, levels[name]))
            assert np.abs(np.array(exact, float) - answer).max() <= 0.01, (name, place)


def test_networks_answer_maps_as_their_voxels_do():
    """At the centres of voxels, grey ones among them."""
    texf = decode(vector("maps_neural"))
    for number, field in enumerate(texf.fields):
        xyz = field.support.xyz()
        centres = texf.voxels()["center"][texf.voxels()["field"] == number]
        answers = texf.query_planes(number, sorted(field.planes), centres, np.zeros(len(xyz), np.int64))
        for name, plane in field.planes.items():
            assert answers[name].shape == plane.shape and np.abs(answers[name] - plane).max() <= 2.0, name
        assert (field.planes["emissive"] == field.planes["emissive"][:, :1]).all()


def test_parameters_that_are_no_numbers_of_their_count_are_refused():
    for value in ((1.0, 2.0), (float("inf"),), (float("nan"),)):
        with pytest.raises(InputError, match="TXF-I14"):
            parameter_values(Material("skin", parameters={"roughness": value}))
    parameters = {"roughness": (0.5,)}
    set_factor(parameters, "roughness", (1.0,))
    assert parameters == {}  # the default is not kept
