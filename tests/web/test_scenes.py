"""glTF files with coded primitives on a page: expand() of the npm package, and its plug-in for GLTFLoader in Chromium."""

import io
import json
import os
import subprocess

import numpy as np
import pytest
from browser import BROWSER, needs_browser
from gltf_scenes import SCENES
from PIL import Image
from test_chromium import MODULES, REPOSITORY
from test_js_package import NODE, needs_node

import texfcodec
from texfcodec.io.container.layout import streams_of
from texfcodec.io.gltf.accessor import read_accessor
from texfcodec.io.gltf.document import open_document
from texfcodec.io.parts import Notes

pytestmark = needs_node
OPTIONS = {"rate": "r06", "no_check": True, "effort": "fast", "support": "texels"}
KINDS = ("SCALAR", "VEC2", "VEC3", "VEC4")
HIGHEST = 50.0  # dB, from which on pictures count as equally good


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """{name: paths of (source, coded file, file expanded by the npm package)}, made as they are looked up."""
    folder = tmp_path_factory.mktemp("scenes")

    class Files(dict):
        def __missing__(self, name):
            paths = self[name] = [folder / f"{name}.{kind}.glb" for kind in ("source", "coded", "expanded")]
            paths[0].write_bytes(SCENES[name]().glb())
            paths[1].write_bytes(texfcodec.encode_gltf(paths[0].read_bytes(), OPTIONS).data)
            run = subprocess.run([NODE, REPOSITORY / "js/test/expand_file.mjs", *paths[1:]], capture_output=True, text=True)
            assert run.returncode == 0, run.stderr
            return paths

    return Files()


def corner_values(document, primitive):
    """{attribute or (n, name) of a target: values at the corners of the faces}."""
    numbers = primitive["attributes"] | {(n, name): number for n, target in enumerate(primitive.get("targets", ()))
                                         for name, number in target.items()}
    index = read_accessor(document, primitive["indices"], ("SCALAR",))[:, 0] if "indices" in primitive else slice(None)
    return {name: read_accessor(document, number, KINDS)[index] for name, number in numbers.items()}


def pixels(document):
    return [np.asarray(Image.open(io.BytesIO(bytes(document.image_bytes(n)))).convert("RGBA"))
            for n in range(len(document.entries("images")))]


@pytest.mark.parametrize("name", sorted(SCENES.keys() - {"strange", "lit"}))
def test_a_page_expands_a_file_to_the_arrays_of_expand(name, files):
    _, coded, expanded = files[name]
    ours = open_document(texfcodec.expand(coded.read_bytes(), texture_format="png"), None, Notes())
    theirs = open_document(expanded.read_bytes(), None, Notes())
    for first, second in zip(ours.root["meshes"], theirs.root["meshes"], strict=True):
        for pair in zip(first["primitives"], second["primitives"], strict=True):
            want, got = (corner_values(*each) for each in zip((ours, theirs), pair, strict=True))
            assert want.keys() == got.keys()
            for key, values in want.items():
                assert got[key].dtype == values.dtype and np.allclose(got[key], values, rtol=1e-6, atol=4e-4), key
    assert all(map(np.array_equal, pixels(ours), pixels(theirs)))
    assert len(pixels(ours)) == len(pixels(theirs))
    layout = {"accessors", "bufferViews", "buffers", "images", "textures", "samplers", "meshes"}
    assert all(ours.root[key] == theirs.root[key] for key in (ours.root.keys() | theirs.root.keys()) - layout)


@needs_browser
@pytest.mark.skipif(not MODULES, reason="no js/node_modules: npm install in js/")
@pytest.mark.parametrize("name, facts", [
    ("skinned", {"meshes": 2, "skinned": 2, "animations": 0}), ("spinning", {"meshes": 2, "skinned": 0, "animations": 1}),
    ("morphing", {"meshes": 1, "skinned": 0, "animations": 1, "targets": ["lift", "wave"]}),
    ("instanced_on_gpu", {"meshes": 1, "skinned": 0, "animations": 0}),
])
def test_gltfloader_draws_coded_files_as_their_sources(name, facts, files, tmp_path):
    run = subprocess.run([NODE, REPOSITORY / "tests/web/scenes.mjs", tmp_path, "0 0.35 0.8", *files[name]], cwd=REPOSITORY / "js",
                         env=os.environ | {"CHROMIUM": BROWSER}, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    report = json.loads(run.stdout)
    source, coded, expanded = report["files"].values()
    assert source.items() >= facts.items() and coded == source == expanded
    drawn = np.array([[np.fromfile(tmp_path / f"{n}-{t}.rgba", np.uint8).reshape(-1, 4)[:, :3] for t in range(3)]
                      for n in range(3)])
    shown = (drawn != drawn[0, 0, 0]).any(axis=(0, 3))
    errors = [[np.mean((drawn[0, t, shown[t]] - drawn[n, t, shown[t]].astype(float)) ** 2) for t in range(3)] for n in (1, 2)]
    quality = 10 * np.log10(255**2 / np.maximum(errors, 255**2 / 10 ** (HIGHEST / 10)))
    assert quality.min() > 36, quality
    assert np.abs(quality[0] - quality[1]).max() <= 0.3 and np.abs(quality - quality[:, :1]).max() <= 0.5, quality


def bilinear(picture, uv):
    """Values of a picture, uint8 [H, W, 4], at UVs inside it: float64 [N, 4]."""
    place = uv * picture.shape[1::-1] - 0.5
    column, row = np.floor(place).astype(np.int64).T
    u, v = (place - np.floor(place)).T[:, :, None]
    upper, lower = (picture[r, column] * (1 - u) + picture[r, column + 1] * u for r in (row, row + 1))
    return upper * (1 - v) + lower * v


def test_an_atlas_of_a_page_shows_the_field_at_points_of_faces(tmp_path):
    coded, expanded = REPOSITORY / "conformance/container/voxels/in.glb", tmp_path / "expanded.glb"
    subprocess.run([NODE, REPOSITORY / "js/test/expand_file.mjs", coded, expanded], check=True)
    texf = texfcodec.decode(next(iter(streams_of(open_document(coded.read_bytes(), None, Notes())))))
    document = open_document(expanded.read_bytes(), None, Notes())
    values = corner_values(document, document.root["meshes"][0]["primitives"][0])
    weight = np.random.default_rng(5).dirichlet((1, 1, 1), (len(texf.faces), 200))
    uv, points = (np.einsum("fsc,fck->fsk", weight, corners.reshape(-1, 3, corners.shape[-1])).reshape(-1, corners.shape[-1])
                  for corners in (values["TEXCOORD_0"].astype(np.float64), texf.positions[texf.faces]))
    wanted = texf.query(points, np.repeat(np.arange(len(texf.faces)), 200))
    error = np.mean((bilinear(pixels(document)[0], uv) - wanted)[:, :3] ** 2)
    assert 10 * np.log10(255**2 / error) > 40
