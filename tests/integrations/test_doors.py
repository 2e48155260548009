"""Add-ons for other programs: what holds without the program."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import texfcodec

FOLDER = Path(__file__).parents[2] / "integrations"
MOST_LINES = {"blender": 250, "comfyui": 120}


@pytest.fixture(params=sorted(MOST_LINES))
def door(request):
    return loaded(request.param)


def loaded(name):
    """Return a door as the module that its program imports."""
    place = FOLDER / name / "__init__.py"
    spec = importlib.util.spec_from_file_location(f"texf_{name}", place, submodule_search_locations=[str(place.parent)])
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name, most", MOST_LINES.items())
def test_a_door_is_small(name, most):
    assert sum(len(path.read_text().splitlines()) for path in (FOLDER / name).glob("*.py")) <= most


def test_a_door_says_in_one_sentence_how_to_get_the_package(door, monkeypatch):
    package = getattr(door, "package", None) or sys.modules["texf_blender.codec"].package
    for stand_in, words in ((None, "texfcodec"), (SimpleNamespace(__version__="0.1"), "0.1 is too old")):
        monkeypatch.setitem(sys.modules, "texfcodec", stand_in)
        with pytest.raises(Exception, match=words) as error:
            package()
        assert "-m pip install" in str(error.value) and "\n" not in str(error.value)


def test_the_add_on_says_that_it_needs_blender():
    with pytest.raises(RuntimeError, match="inside Blender"):
        loaded("blender").register()


class Tensor(np.ndarray):
    """An array with what a torch tensor has of methods."""

    detach = cpu = lambda self: self
    float = lambda self: self.astype(np.float32)
    numpy = lambda self: np.asarray(self)


def test_a_batch_of_meshes_becomes_streams_without_its_padding():
    tensor = lambda *rows: np.array(rows).view(Tensor)
    square, padding = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0.0, 0, 0]] * 2
    mesh = SimpleNamespace(vertices=tensor(square + padding), faces=tensor([[0, 1, 2], [0, 2, 3], [0, 0, 0]]), vertex_counts=[4],
                           face_counts=[2], vertex_colors=tensor([[1.0, 0, 0]] * 6))
    (((stream, _),),) = loaded("comfyui").MeshToTexf().encode(mesh, "r01", "fast")
    texf = texfcodec.decode(stream)
    assert len(texf.positions) == 4 and len(texf.faces) == 2
    assert np.abs(texf.query(texf.positions)[:, :3] - [255, 0, 0]).max() < 8
