"""Shading in GLSL: in a browser it gives what texfcodec/render gives, and holds no term that a material does not call for."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from browser import WEB, needs_browser, run_module
from lit import material_of

from texfcodec.render.environment import DAYLIGHT, furnace
from texfcodec.render.material import expose, shade
from texfcodec.render.material_effects import LARGEST, TERMS, ShadingTable
from texfcodec.render.surface import UNBOUNDED, Points
from texfcodec.render.tangent_frames import deviated_normals, tangent_space_normals, towards_viewer
from texfcodec.scene.channels import BY_NAME, MAPS, PARAMETER_BY_NAME, PARAMETERS
from texfcodec.scene.effects import BY_NAME as EFFECT_BY_NAME
from texfcodec.scene.effects import EFFECT_OF, EFFECTS
from texfcodec.scene.factors import FLAT, linear_values
from texfcodec.scene.scene import Material
from texfcodec.viewer.light import light_tables, material_look

COUNT = 600  # points of a material
DARKER = replace(DAYLIGHT, exposure=0.6)
BENT = ("normal", "clearcoat_normal")
CORE = {"roughness": 0.9, "metallic": 0.8, "emissive": (0.5, 0.2, 0.1), "emissive_strength": 1.5, "occlusion_strength": 0.7,
        "normal_scale": 1.4}
CORE_MAPS = ("roughness", "metallic", "emissive", "occlusion", "normal")
COAT = {"clearcoat": 0.8, "clearcoat_roughness": 0.6, "clearcoat_normal_scale": 0.5}
GLASS = {"metallic": 0, "transmission": 0.9, "ior": 1.33}
FILM = {"iridescence": 0.9, "iridescence_ior": 1.7, "iridescence_thickness_minimum": 0, "iridescence_thickness_maximum": 900}
THICK = {"thickness": 2, "attenuation_distance": 1.5, "attenuation_colour": (0.9, 0.4, 0.2)}
PAPER = {"metallic": 0, "diffuse_transmission": 0.8, "diffuse_transmission_colour": (0.9, 0.8, 0.3)}
CLOTH = {"metallic": 0, "sheen_colour": (0.9, 0.6, 0.4), "sheen_roughness": 0.8}
STRETCHED = {"anisotropy": 0.8, "anisotropy_rotation": 40}
ALL = {**CORE, **COAT, **CLOTH, **GLASS, **THICK, **FILM, **PAPER, **STRETCHED, "metallic": 0.7, "dispersion": 1, "specular": 0.9}
LOOKS = {  # parameters and channels with maps
    "constant": ({"metallic": 0.3, "roughness": 0.4}, ()),
    "plastic": ({"metallic": 0}, ("roughness",)),
    "mirror": ({"roughness": 0}, ()),
    "core": (CORE, CORE_MAPS),
    "coat": ({"metallic": 0.5, "roughness": 0.6, **COAT}, ("clearcoat", "clearcoat_roughness", "normal", "clearcoat_normal")),
    "bare coat": ({"metallic": 0, "roughness": 0.6, **COAT}, ("normal",)),
    "cloth": (CLOTH, ("sheen_colour", "sheen_roughness")),
    "specular": ({"metallic": 0, "specular": 0.8, "specular_colour": (0.9, 3, 0.5), "ior": 6},
                 ("specular", "specular_colour", "roughness")),
    "ior": ({"metallic": 0.2, "ior": 2.2}, ("roughness",)),
    "sheet": (GLASS, ("transmission", "roughness")),
    "glass": ({**GLASS, **THICK}, ("transmission", "thickness", "roughness")),
    "prism": ({**GLASS, **THICK, "dispersion": 60}, ("thickness",)),
    "film": (FILM, ("iridescence", "iridescence_thickness", "metallic", "roughness")),
    "film of air": ({**FILM, "metallic": 0, "iridescence_ior": 0.5}, ("iridescence_thickness",)),
    "brushed": (STRETCHED, ("anisotropy", "roughness", "metallic")),
    "brushed plainly": (STRETCHED, ("roughness",)),
    "paper": ({**PAPER, **THICK}, ("diffuse_transmission", "diffuse_transmission_colour")),
    "all": (ALL, tuple(channel.name for channel in MAPS)),
    "all constant": (ALL, ()),
}

SHADE = """
import { setShading, shadingSource } from './shading.js';

const START = '#version 300 es\\n';
const VERTEX = START + 'void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }';

export function compiled(gl, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, START + fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

export function context() {
  const gl = new OffscreenCanvas(16, 16).getContext('webgl2');
  if (!gl || !gl.getExtension('EXT_color_buffer_float')) throw new Error('WebGL2 with float framebuffers is missing');
  return gl;
}

function rowsTexture(gl, unit, rows) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, rows.shape[1], rows.shape[0], 0, gl.RGBA, gl.FLOAT, rows);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
}

function shaded(gl, { look, light, rows, main }) {
  const program = compiled(gl, shadingSource(look.effects, look.maps, look.parameters) + main);
  const unit = setShading(gl, program, light, look, 0);
  rowsTexture(gl, unit, rows);
  gl.uniform1i(gl.getUniformLocation(program, 'rows'), unit);
  const count = rows.shape[1];
  const target = gl.createRenderbuffer();
  gl.bindRenderbuffer(gl.RENDERBUFFER, target);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA32F, count, 1);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, target);
  gl.viewport(0, 0, count, 1);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const out = new Float32Array(4 * count);
  gl.readPixels(0, 0, count, 1, gl.RGBA, gl.FLOAT, out);
  if (gl.getError()) throw new Error('an error of WebGL');
  return Object.assign(out, { shape: [count, 4] });
}

export function main(data) {
  const gl = context();
  return data.map((one) => shaded(gl, one));
}
"""


# Points, shaded by the package and by a shader.


def some_points(table, look, seed, over_texels=True):
    """Columns float32 [COUNT, C] by name of random points of a material: directions, base colour and every map's coded values,
    the ends of each range often among them."""
    rng = np.random.default_rng(seed)
    at = {name: rng.normal(size=(COUNT, 3)) for name in ("normal", "geometric", "view")}
    steep = rng.random(COUNT) < 0.2  # views near the surface, on either side of it
    at["view"] = np.where(steep[:, None], np.cross(at["normal"], at["view"]) + 0.02 * at["view"], at["view"])
    at["normal"][:4] = [[0, 0, 0], [np.nan, 0, 1], [1e25, 1e25, 0], [1e-25, 0, 2e-25]]
    at["view"][4:6] = [[0, 0, 0], [0, -1e25, 1e24]]
    at["tangent"] = np.hstack([rng.normal(size=(COUNT, 3)), rng.choice([-1, 1], (COUNT, 1))])
    at["tangent"][6:40] = 0
    at["tangent"][40:50, :3] = at["normal"][40:50]
    at["base_colour"] = rng.random((COUNT, 3)) * (rng.random((COUNT, 1)) > 0.05)
    for name in look["maps"]:
        width = 3 if name in BENT and not over_texels else BY_NAME[name].components
        coded = np.clip(rng.integers(-80, 336, (COUNT, width)), 0, 255) / 255
        at[f"coded_{name}"] = np.where(rng.random((COUNT, 1)) < 0.05, FLAT / 255, coded)
    if "coded_normal" in at and not over_texels:  # a deviation that all but takes the normal away
        at["normal"][50], at["coded_normal"][50] = (0, 0, 1), (0.5 + 2e-6, 0.5, 0)
    return {name: np.ascontiguousarray(column, np.float32) for name, column in at.items()}


def shaded_here(table, look, at, environment, over_texels):
    """Colours float32 [COUNT, 3], 0..255, as the package gives them."""

    def turned(name):
        normal = at["normal"]
        if name in look["maps"]:
            coded, scale = at[f"coded_{name}"], table.values[BY_NAME[name].parameter][0, 0]
            normal = (tangent_space_normals(coded * 255, scale, normal, at["tangent"], at["geometric"]) if over_texels
                      else deviated_normals(coded * 255 / np.float32(FLAT) - 1, normal, at["geometric"]))
        return towards_viewer(normal, at["geometric"], at["view"])

    material = np.zeros(COUNT, np.int64)
    values = {name: table.final(name, material, linear_values(name, at[f"coded_{name}"] * np.float32(255)))
              for name in look["maps"] if name not in BENT}
    values["base_colour"] = linear_values("base_colour", at["base_colour"] * np.float32(255))
    points = Points(material=material, normal=turned("normal"), view=at["view"], values=values, tangent=at["tangent"],
                    coat_normal=turned("clearcoat_normal"))
    return expose(shade(points, table, environment), environment.exposure)


def main_of(look, names, over_texels):
    """GLSL of main(), which reads the columns of points, row by row of a texture, and shades them."""
    read = {name: f"texelFetch(rows, ivec2(int(gl_FragCoord.x), {row}), 0)" for row, name in enumerate(names)}
    lines = ["uniform sampler2D rows;", "out vec4 colour;", "void main() {",
             f"  Values v = constantValues({read['base_colour']}.xyz);"]
    lines += [f"  vec{4 if name == 'tangent' else 3} {name} = {read[name]}.{'xyzw'[: 4 if name == 'tangent' else 3]};"
              for name in ("normal", "geometric", "view", "tangent")]
    lines.append("  vec3 coat = normal;")
    for name in look["maps"]:
        if name not in BENT:
            lines.append(f"  v.{name} = final_{name}({read[f'coded_{name}']}.{'xyz'[: BY_NAME[name].components]});")
            continue
        target, coded = "normal" if name == "normal" else "coat", read[f"coded_{name}"]
        bent = (f"tangentSpaceNormal({coded}.xy, u_{name}_scale.x, {target}, tangent, geometric)" if over_texels
                else f"deviatedNormal({coded}.xyz, {target}, geometric)")
        lines.append(f"  {target} = {bent};")
    if "lit" in look["effects"]:
        lines += [f"  {one} = towardsViewer({one}, geometric, view);" for one in ("normal", "coat")]
    return "\n".join([*lines, "  colour = vec4(255.0 * exposed(radiance(v, normal, coat, tangent, view)), 1.0);", "}"])


def a_case(look_name, seed, environment=DAYLIGHT, over_texels=True, unlit=False):
    """What the browser shall shade, and the colours that the package gives."""
    table = ShadingTable([material_of(*LOOKS[look_name], unlit=unlit)])
    look = material_look(table, 0)
    at = some_points(table, look, seed, over_texels)
    rows = np.zeros((len(at), COUNT, 4), np.float32)
    for row, column in zip(rows, at.values(), strict=True):
        row[:, : column.shape[1]] = column
    job = {"look": look, "light": light_tables(environment), "rows": rows, "main": main_of(look, list(at), over_texels)}
    return job, shaded_here(table, look, at, environment, over_texels)


@needs_browser
def test_every_term_gives_in_a_browser_what_the_renderer_gives(tmp_path):
    """The most that is measured is 0.04 of 255 levels, under stretched highlights of smooth metal."""
    cases = {name: a_case(name, seed) for seed, name in enumerate(LOOKS)}
    cases |= {"core over voxels": a_case("core", 50, over_texels=False),
              "coat over voxels": a_case("coat", 51, over_texels=False),
              "in a furnace": a_case("all", 52, environment=furnace((0.4, 0.5, 0.6))), "unlit": a_case("core", 53, unlit=True),
              "exposed": a_case("core", 54, environment=DARKER), "unlit, exposed": a_case("core", 55, DARKER, unlit=True)}
    seen = frozenset().union(*(job["look"]["effects"] for job, _ in cases.values()))
    assert seen >= TERMS | {"metal", "normal_map", "clearcoat_normal_map"}
    answers = run_module(tmp_path, SHADE, [job for job, _ in cases.values()])
    for (name, (_, wanted)), answer in zip(cases.items(), answers, strict=True):
        error = np.abs(answer[:, :3] - wanted)
        print(f"{name:18} most {error.max():.4f}, 99 % below {np.quantile(error, 0.99):.5f}, of a range of {np.ptp(wanted):.0f}")
        assert np.ptp(wanted) > 50 and error.max() < 0.1, name


@needs_browser
def test_terms_that_a_material_does_not_call_for_change_nothing(tmp_path):
    """With the parameters' defaults, but for metal: what does not use it says so, and does not name it. A stretched lobe is left
    out; without strength it is the round one only where the normal faces the viewer."""
    neutral = {p.name: [min(v, LARGEST) for v in p.default] for p in PARAMETERS} | {"metallic": [0.0]}
    cases = {name: a_case(name, seed) for seed, name in enumerate(LOOKS)}
    for job, _ in cases.values():
        job["look"] |= {"effects": sorted(set(EFFECT_BY_NAME) - {"anisotropy"} | set(job["look"]["effects"])),
                        "parameters": neutral | job["look"]["parameters"]}
    answers = run_module(tmp_path, SHADE, [job for job, _ in cases.values()])
    for (name, (_, wanted)), answer in zip(cases.items(), answers, strict=True):
        assert np.abs(answer[:, :3] - wanted).max() < 0.1, name


# The text of shaders.


COMPILE = """
export function main(sets) {
  const gl = context();
  const finish = `out vec4 colour;
    void main() {
      Values v = constantValues(vec3(0.5));
      colour = vec4(exposed(radiance(v, vec3(0.0, 1.0, 0.0), vec3(0.0, 1.0, 0.0), vec4(1.0), vec3(0.0, 1.0, 1.0))), 1.0);
    }`;
  return sets.map(({ effects, maps, parameters }) => {
    const text = shadingSource(effects, maps, parameters);
    compiled(gl, text + finish);
    return text;
  });
}
"""


def a_set(effects, mapped):
    """A set of effects as material_look() tells it, with a map for every channel or with none."""
    read = [EFFECT_BY_NAME[name] for name in effects]
    return {"effects": sorted(effects), "parameters": sorted({name for effect in read for name in effect.parameters}),
            "maps": sorted({name for effect in read for name in effect.channels}) if mapped else []}


def functions_in(text):
    return set(re.findall(r"^\w+ (\w+)\(", text, re.MULTILINE))


@needs_browser
def test_every_set_of_effects_compiles_and_a_shader_has_no_term_of_another(tmp_path):
    every = {effect.name for effect in EFFECTS}
    sets = [frozenset(), frozenset({"lit"}), frozenset(every)]
    sets += [frozenset({"lit", name}) for name in sorted(every)] + [frozenset(every - {name}) for name in sorted(every)]
    jobs = [a_set(effects, mapped) for mapped in (False, True) for effects in sets]
    texts = run_module(tmp_path, SHADE.replace("export function main", "function unused") + COMPILE, jobs)
    functions = dict(zip(sets, map(functions_in, texts[: len(sets)]), strict=True))
    plain = functions[frozenset({"lit"})]
    assert functions[frozenset()] < plain < functions[frozenset(every)]
    own = {name: functions[frozenset({"lit", name})] - plain for name in every}
    assert {name for name in TERMS if own[name]} == TERMS - {"lit", "occlusion", "emission", "dispersion"}
    for name in every - {"lit"}:
        others = set().union(*(own[other] for other in every - {name}))
        assert not (own[name] - others) & functions[frozenset(every - {name})], name


@needs_browser
def test_channels_of_the_shader_are_those_of_the_package(tmp_path):
    module = "import { SHADED_CHANNELS } from './shading_values.js';\nexport function main() { return SHADED_CHANNELS; }"
    wanted = {}
    for channel in MAPS:
        if channel.name not in BENT:
            row = {"effect": EFFECT_OF[channel.name].name, "size": channel.components, "factor": channel.parameter}
            wanted[channel.name] = row | ({"srgb": True} if channel.srgb else {})
            wanted[channel.name] |= {"unbounded": True} if channel.name in UNBOUNDED else {}
    assert run_module(tmp_path, module) == wanted
    assert f"'{LARGEST}'" in (WEB / "shading_values.js").read_text(encoding="utf-8")


@needs_browser
def test_more_lights_than_a_shader_takes_are_refused_with_a_sentence(tmp_path):
    job, _ = a_case("constant", 0)
    job["light"]["lights"] *= 3
    with pytest.raises(AssertionError, match="an environment has 9 lights, a shader takes 8"):
        run_module(tmp_path, SHADE, [job])


# What a shader is told.


def test_a_look_is_finite_and_has_just_what_its_effects_read():
    table = ShadingTable([material_of(*LOOKS["all"]), material_of({"metallic": 0}, CORE_MAPS), material_of(unlit=True),
                          material_of({**GLASS, "thickness": 1, "anisotropy": 1, "anisotropy_rotation": -700})])
    looks = [material_look(table, number) for number in range(4)]
    assert set(looks[0]["parameters"]) == {p.name for p in PARAMETERS} and set(looks[0]["maps"]) == {c.name for c in MAPS}
    assert looks[1] == {"effects": ["lit", "normal_map", "occlusion"], "maps": ["normal", "occlusion", "roughness"],
                        "parameters": {"normal_scale": [1.0], "occlusion_strength": [1.0], "roughness": [1.0]}}
    assert looks[2] == {"effects": [], "maps": [], "parameters": {}}
    assert looks[3]["parameters"]["attenuation_distance"] == [float(np.finfo(np.float32).max)]
    turn = looks[3]["parameters"]["anisotropy_rotation"][0]
    assert abs(turn) <= np.pi and np.isclose(np.cos(turn), np.cos(700)) and np.isclose(np.sin(turn), -np.sin(700))
    assert json.loads(json.dumps(looks, allow_nan=False)) == looks


def test_tables_are_those_that_the_renderer_looks_up():
    light = light_tables()
    shapes = {name: (value.dtype.name, value.shape) for name, value in light.items() if isinstance(value, np.ndarray)}
    assert shapes == {"prefiltered": ("float32", (65, 33, 3)), "ggx": ("float32", (48, 32, 2)), "charlie": ("float32", (48, 32)),
                      "powers": ("float32", (9, 3)), "diffuse_powers": ("float32", (9, 3))}
    up = np.array([[0.0], [1.0], [0.0]], np.float32)
    assert np.allclose(light["powers"].sum(axis=0), DAYLIGHT.radiance(up)[:, 0])
    assert np.allclose(light["prefiltered"][-1, 0], DAYLIGHT.prefiltered(up, np.zeros(1, np.float32))[:, 0])
    assert [one["radius"] for one in light["lights"]] == [one.radius for one in DAYLIGHT.lights]
    assert np.allclose([one["irradiance"] for one in light["lights"]], [one.irradiance for one in DAYLIGHT.lights])


# Materials as the page makes them of a stream


@needs_browser
def test_the_page_makes_of_a_streams_materials_what_the_package_makes(tmp_path):
    rng = np.random.default_rng(5)
    materials = [_any_material(rng, number) for number in range(200)]
    told = [{"name": m.name, "alphaMode": ("OPAQUE", "MASK", "BLEND")[m.alpha_mode], "alphaCutoff": m.alpha_cutoff,
             "doubleSided": m.double_sided, "unlit": m.unlit, "channels": sorted(m.maps),
             "parameters": {name: ["inf" if v == np.inf else v for v in value] for name, value in m.parameters.items()}}
            for m in materials]
    found = run_module(tmp_path, """import { ALL_TERMS, lookOfMaterial } from './materials.js';
export function main(materials) {
  const numbers = materials.flatMap((m) => Object.values(m.parameters));
  for (const values of numbers) values.forEach((x, i) => { if (x === 'inf') values[i] = Infinity; });
  return { looks: materials.map(lookOfMaterial), all: ALL_TERMS };
}""", told)
    table = ShadingTable(materials)
    for number, look in enumerate(found["looks"]):
        want = material_look(table, number)
        assert (look["effects"], look["maps"]) == (want["effects"], want["maps"]), told[number]
        assert look["parameters"].keys() == want["parameters"].keys()
        for name, value in want["parameters"].items():
            assert look["parameters"][name] == pytest.approx(value, rel=1e-6, abs=1e-6), name
    assert found["all"]["effects"] == [effect.name for effect in EFFECTS]
    largest = float(np.finfo(np.float32).max)
    assert found["all"]["parameters"] == {p.name: [min(v, largest) for v in p.default] for p in PARAMETERS} | {"metallic": [0.0]}


def _any_material(rng, number):
    """A material with some of all parameters, zeros, defaults and values out of range among them, and some maps."""
    values = {p.name: [(0.0, 1.0, float(np.float32(rng.normal(scale=3))), 1e6)[rng.integers(4)] for _ in p.default]
              for p in PARAMETERS if rng.random() < 0.4}
    values = {name: tuple(value) for name, value in values.items() if tuple(value) != PARAMETER_BY_NAME[name].default}
    return Material(f"m{number}", alpha_mode=int(rng.integers(3)), double_sided=bool(rng.random() < 0.5),
                    unlit=bool(rng.random() < 0.1), parameters=values, maps={c.name: -1 for c in MAPS if rng.random() < 0.4})
