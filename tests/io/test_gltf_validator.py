"""Khronos's validator finds nothing in what is saved: colours at vertices, a carried stream, and maps of every channel."""

import shutil
import subprocess

import pytest
from conftest import REPOSITORY
from shapes import mapped_sheet, noise, painted_sphere, scene_of, sphere
from test_materials_back import everything

from texfcodec.api import decode, encode
from texfcodec.options import DecodeOptions, EncodeOptions


def stream(scene, **options):
    return encode(scene, EncodeOptions(**({"resolution": 64, "qp": 16, "refine": "off"} | options)))


def colours(folder):
    for number, scene in enumerate((painted_sphere(6), scene_of(*sphere(6)))):
        decode(stream(scene, support="voxels")).save(folder / f"{number}.glb")


def carried(folder):
    data = stream(mapped_sheet({}, noise(3)), support="texels")
    decode(data, DecodeOptions(lod=3)).save(folder / "a.glb", stream=data)


def maps(folder, support):
    scene = everything()
    scene.materials[0].double_sided = False  # a volume has one side
    texf = decode(encode(scene, EncodeOptions(support=support, resolution=48, qp=16)))
    for number, options in enumerate(({}, {"texture_format": "jpeg"}, {"appearance": "vertex"})):
        texf.save(folder / f"{number}.glb", **options)


@pytest.mark.parametrize("write", [
    colours, pytest.param(carried, marks=pytest.mark.slow),
    *(pytest.param(lambda folder, support=support: maps(folder, support), marks=pytest.mark.slow, id=f"maps over {support}")
      for support in ("texels", "voxels"))])
def test_the_validator_finds_nothing(tmp_path, write):
    if shutil.which("node") is None:
        pytest.skip("node is not here")
    write(tmp_path)
    files = sorted(tmp_path.glob("*.glb"))
    run = subprocess.run(["node", str(REPOSITORY / "tools/proof/validate_glb.mjs"), *map(str, files)], cwd=REPOSITORY,
                         capture_output=True, text=True, check=False)
    if run.returncode == 2:
        pytest.skip("gltf-validator is not here: npm install in js/")
    assert run.returncode == 0 and run.stdout.count("0 errors, 0 warnings") == len(files), run.stdout
