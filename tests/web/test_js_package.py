"""The npm package: its own tests in node, and vectors through its WebAssembly module there."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from conformance import run as runner
from conformance import run_containers as scenes

REPOSITORY = Path(__file__).resolve().parents[2]
NODE = shutil.which("node")
VERSION = subprocess.run([NODE, "--version"], capture_output=True, text=True).stdout if NODE else "v0"
needs_node = pytest.mark.skipif(int(VERSION[1:].split(".")[0]) < 20, reason="there is no node of version 20 or newer on the PATH")


@needs_node
@pytest.mark.parametrize("name", ["index", "bad_input", "gltf", "container", "blocks", "gltf_transform"])
def test_the_package_passes_its_own_tests(name):
    run = subprocess.run([NODE, "--test", f"js/test/{name}.test.mjs"], cwd=REPOSITORY, capture_output=True, text=True,
                         timeout=300)
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-1000:]


@needs_node
@pytest.mark.parametrize("case", ["subset/texels/", "subset/k33/", "uncommon/dct_blocks/", "uncommon/normals_coded/",
                                  "uncommon/neural_alpha/", "faulty/values_crc/", "faulty/version/"])
def test_vectors_in_node(case, monkeypatch):
    if case in ("subset/k33/", "faulty/version/"):
        monkeypatch.setenv("TEXF_WASM", "texf.wasm")  # of older browsers, without vectors
    decoder = runner.CommandDecoder(f"{NODE} {REPOSITORY}/js/test/decode_arrays.mjs", 120)
    folders = runner.cases([case])
    assert folders
    for folder in folders:
        assert runner.faults_of(decoder, folder) == []


@needs_node
@pytest.mark.parametrize("name", sorted({path.parent.name for path in scenes.HOME.glob("*/expected.json")}))
def test_vectors_of_scenes_in_node(name):
    expand = scenes.by_command(f"{NODE} {REPOSITORY}/js/test/expand_file.mjs")
    assert scenes.faults_of(expand, scenes.HOME / name) == []


def test_the_package_holds_the_module_of_the_python_package():
    assert (REPOSITORY / "js/src/texf_simd.wasm").read_bytes() == (REPOSITORY / "texfcodec/sandbox/texf_simd.wasm").read_bytes()


def test_every_export_is_there():
    package = json.loads((REPOSITORY / "js/package.json").read_text(encoding="utf-8"))
    files = [entry["default"] if isinstance(entry, dict) else entry for entry in package["exports"].values()]
    assert all((REPOSITORY / "js" / path).is_file() for path in files)
    typed = [entry for entry in package["exports"].values() if isinstance(entry, dict)]  # npm run types writes types/
    expected = [entry["default"].replace("src/", "types/").replace(".js", ".d.ts") for entry in typed]
    assert typed and [entry["types"] for entry in typed] == expected


@needs_node
def test_the_packed_package_has_types():
    run = subprocess.run([NODE, "--test", "js/test/types.test.mjs"], cwd=REPOSITORY, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-1000:]
