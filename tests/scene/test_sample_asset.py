"""The bundled sample: closed, varied, the same everywhere, made without a network, and carried by its GLB without loss."""

import hashlib
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mesh_files import accessor, read_glb

from texfcodec.demo import asset as sample_asset
from texfcodec.demo.__main__ import main as demo_main
from texfcodec.errors import SupportError
from texfcodec.io.load import load
from texfcodec.scene.scene import WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT

GEOMETRY_SHA256 = "0a33649dc696aab6ba69ea9b3af2e23a62893ce527ba0520074d7d1c68c55aaf"


def parts_of(scene):
    """Faces grouped by connected part, by plain label spreading."""
    label = np.arange(len(scene.positions))
    while True:
        lowest = label[scene.faces].min(axis=1)
        spread = label.copy()
        for corner in range(3):
            np.minimum.at(spread, scene.faces[:, corner], lowest)
        if np.array_equal(spread, label):
            return [scene.faces[label[scene.faces[:, 0]] == part] for part in np.unique(label)]
        label = spread[spread]


def test_every_part_is_closed_oriented_and_faces_outwards(sample_scene):
    parts = parts_of(sample_scene)
    assert len(parts) == 7
    for faces in parts:
        edges = [tuple(edge) for i in range(3) for edge in faces[:, [i, (i + 1) % 3]].tolist()]
        assert len(set(edges)) == len(edges)  # no directed edge twice
        assert set(edges) == {(b, a) for a, b in edges}  # each met from the other side
        a, b, c = np.moveaxis(sample_scene.positions[faces], 1, 0)
        assert (a * np.cross(b, c)).sum() > 0
    euler = sorted(len(np.unique(f)) - len(f) // 2 for f in parts)
    assert euler == [0, 2, 2, 2, 2, 2, 2]  # one torus, the knot; the rest spheres


def test_size_is_that_of_a_small_asset(sample_scene):
    assert 10_000 <= len(sample_scene.faces) <= 20_000
    assert sample_scene.positions[:, 1].min() == 0
    corners = sample_scene.positions[sample_scene.faces]
    assert np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).min() > 1e-6
    assert np.array_equal(np.unique(sample_scene.faces), np.arange(len(sample_scene.positions)))


def test_sample_shows_what_a_loader_has_to_handle(sample_scene):
    s = sample_scene
    used = [set(np.unique(s.face_material)), {m.texture for m in s.materials if m.texture >= 0}]
    assert used == [set(range(6)), set(range(4))]
    assert {t.wrap[0] for t in s.textures} == {WRAP_REPEAT, WRAP_CLAMP, WRAP_MIRROR}
    brick = s.corner_uv[s.face_material == sample_asset.PLINTH]
    assert brick.min() < 0 and brick.max() > 1 and s.textures[2].wrap == (WRAP_REPEAT, WRAP_REPEAT)
    assert s.materials[sample_asset.PLINTH].factor[0] < 1  # texture and factor together
    assert s.materials[sample_asset.GLAZE].texture == -1 and s.materials[sample_asset.GLAZE].factor[0] < 1
    feet = s.face_material == sample_asset.FEET
    assert (s.corner_color[~feet] == 1).all() and np.ptp(s.corner_color[feet][..., :3]) > 0.8
    assert s.corner_color.min() >= 0 and s.corner_color.max() <= 1


def test_sample_is_the_same_on_every_machine(sample_scene):
    again = sample_asset.make_sample()
    digest = hashlib.sha256()
    for name in ("positions", "faces", "face_material", "corner_uv", "corner_color"):
        first, second = getattr(sample_scene, name), getattr(again, name)
        assert np.array_equal(first, second)
        digest.update(np.ascontiguousarray(second + 0, dtype=second.dtype.newbyteorder("<")).tobytes())  # + 0 drops -0.0
    assert digest.hexdigest() == GEOMETRY_SHA256


def test_sample_is_made_without_a_network(monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("the sample reached for the network")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setitem(sys.modules, "pooch", None)  # scikit-image downloads through pooch; importing it now fails
    assert len(sample_asset.make_sample().textures) == 4


def test_loader_brings_the_sample_back(tmp_path, sample_scene):
    """Its container is what glTF says too, seen by another reader than ours."""
    path = tmp_path / "花瓶 sample.glb"
    sample_asset.write_sample(path)
    document, binary = read_glb(path)
    corners = [accessor(document, binary, part["indices"]).size for part in document["meshes"][0]["primitives"]]
    assert sum(corners) == sample_scene.faces.size and [v["byteOffset"] % 4 for v in document["bufferViews"]].count(0) > 10
    assert all(len(accessor(document, binary, i)) > 3 for i in range(len(document["accessors"])))  # with their bounds
    loaded = load(path, strict=True)
    order = np.argsort(sample_scene.face_material, kind="stable")  # the GLB holds one primitive per material
    assert np.array_equal(loaded.face_material, sample_scene.face_material[order])
    assert np.array_equal(loaded.positions[loaded.faces], sample_scene.positions[sample_scene.faces][order])
    assert np.array_equal(loaded.corner_uv, sample_scene.corner_uv[order])
    assert np.array_equal(loaded.corner_color, sample_scene.corner_color[order])
    for material, expected in zip(loaded.materials, sample_scene.materials, strict=True):
        assert (material.name, material.texture) == (expected.name, expected.texture)
        assert np.array_equal(material.factor, expected.factor)
    for texture, expected in zip(loaded.textures, sample_scene.textures, strict=True):
        assert texture.wrap == expected.wrap and np.array_equal(texture.image, expected.image)


def test_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    def fail(_self):
        raise OSError("disk full")

    monkeypatch.setattr(sample_asset._Glb, "tobytes", fail)
    with pytest.raises(OSError, match="disk full"):
        sample_asset.write_sample(tmp_path / "out.glb")
    assert list(tmp_path.iterdir()) == []


def test_module_runs_as_a_command(tmp_path):
    command = [sys.executable, "-m", "texfcodec.demo.asset"]
    out, root = tmp_path / "out.glb", Path(__file__).resolve().parents[2]
    assert subprocess.run([*command, str(out)], cwd=root, check=False).returncode == 0
    assert out.read_bytes()[:4] == b"glTF"
    usage = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert usage.returncode != 0 and "OUT.glb" in usage.stderr and "Traceback" not in usage.stderr


@pytest.mark.parametrize("command", [sample_asset.write_or_explain, demo_main])
def test_sample_without_its_photographs_names_the_extra(monkeypatch, capsys, tmp_path, command):
    monkeypatch.setitem(sys.modules, "skimage.data", None)  # importing it now fails
    with pytest.raises(SystemExit) as ended:
        command(tmp_path / "out")
    out, err = capsys.readouterr()
    assert ended.value.code == SupportError.exit_code and err.count("\n") == 1 and out == ""
    assert 'pip install "texfcodec[demo]"' in err and [path for path in tmp_path.rglob("*") if path.is_file()] == []
