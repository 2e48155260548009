"""Rivals that are whole GLB files: they code what is said, count the file that is decoded, and survive their programs."""

import dataclasses
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shapes import crossing_sheets, mapped_sheet, painted_sphere

from texfcodec.report import Report

REPOSITORY = Path(__file__).resolve().parents[2]
PROGRAMS = {"gltf_transform": ("gltf-transform", "TEXFCODEC_GLTF_TRANSFORM"), "gltfpack": ("gltfpack", "TEXFCODEC_GLTFPACK")}
PATIENCE = 20  # seconds until a process that should have ended counts as alive
# Called as either program: finds its two files, and does what the text that is put in for ACT says.
STAND_IN = """
import os, shutil, sys, time
words = sys.argv[1:]
source, target = (words[1], words[3]) if words[0] == "-i" else words[1:3]
ACT
"""


def found(method, **options):
    from tools.bench.methods import find

    return find(method), options


def coded(method, scene, folder, **options):
    """(facts of the encoder, decoded Scene, hash of what was decoded) of a Scene through a method."""
    rival, options = found(method, **options)
    folder.mkdir(exist_ok=True)
    facts = rival.encode(scene, options, folder, 1, Report())
    decoded = rival.decode(folder, options, 1, Report())
    return facts, decoded, rival.values_sha256(decoded)


def stand_in(folder, act):
    """The words of a command that acts as a program."""
    path = folder / "stand_in.py"
    path.write_text(STAND_IN.replace("ACT", act))
    return f"{sys.executable} {path}"


@pytest.fixture
def needs_program():
    """Skips where a method misses something."""

    def ask(method, **options):
        reason = found(method)[0].missing(options)
        if reason:
            pytest.skip(reason)

    return ask


def assert_counted(facts, folder, scene, decoded, sha256, off):
    """The bytes are those of the files; the decoded is the source, off by so much of its side."""
    sizes = facts["bytes"]
    assert sizes["total"] == (folder / "whole.glb").stat().st_size
    assert sizes["geometry"] == (folder / "geometry.glb").stat().st_size
    assert sizes["texture"] == sizes["total"] - sizes["geometry"] > sizes["images"] > 0
    assert 0 < facts["container_bytes"] < sizes["total"] and facts["reconstruction_sha256"] == sha256
    assert len(decoded.faces) == len(scene.faces) and all(not m.maps for m in decoded.materials)
    side = np.ptp(scene.positions, axis=0).max()
    for corner in (0, 1):
        ends = [getattr(s.positions[s.faces].reshape(-1, 3), ("min", "max")[corner])(axis=0) for s in (scene, decoded)]
        assert np.abs(ends[0] - ends[1]).max() <= off * side


@pytest.mark.parametrize("texture, size", [("webp", 32), ("avif", 64)])
def test_gltf_transform_codes_what_is_counted(needs_program, tmp_path, texture, size):
    needs_program("gltf_transform")
    scene = mapped_sheet({"roughness": np.full((8, 8, 4), 77, np.uint8)}, colour=smooth_image())
    facts, decoded, sha256 = coded("gltf_transform", scene, tmp_path / "a", texture=texture, shrink=64 // size)
    assert_counted(facts, tmp_path / "a", scene, decoded, sha256, 2**-14)
    assert facts["images"] == [[size, size]]
    if size == 64:
        assert np.abs(decoded.textures[0].image.astype(int) - smooth_image())[..., :3].mean() < 6


def test_gltf_transform_packs_by_meshopt_too(needs_program, tmp_path):
    needs_program("gltf_transform", mesh="meshopt")
    scene = mapped_sheet({}, colour=smooth_image())
    facts, decoded, sha256 = coded("gltf_transform", scene, tmp_path / "a", mesh="meshopt")
    assert_counted(facts, tmp_path / "a", scene, decoded, sha256, 2**-13)


@pytest.mark.parametrize("texture", ["kept_webp", "webp", "etc1s"])
def test_gltfpack_codes_what_is_counted(needs_program, tmp_path, texture):
    needs_program("gltfpack", texture=texture)
    scene = mapped_sheet({}, colour=smooth_image())
    facts, decoded, sha256 = coded("gltfpack", scene, tmp_path / "a", texture=texture)
    assert_counted(facts, tmp_path / "a", scene, decoded, sha256, 2**-13)
    assert facts["images"] == [[64, 64]] and 0 < facts["gzip_bytes"] < facts["bytes"]["total"]


def smooth_image():
    """An image of 64 x 64 texels, uint8 [64, 64, 4], opaque, that compresses well."""
    x, y = np.meshgrid(np.arange(64), np.arange(64))
    return np.stack([4 * x, 4 * y, 128 + 60 * np.sin(x / 9) * np.cos(y / 7), np.full_like(x, 255)], -1).astype(np.uint8)


def test_source_has_what_is_seen_and_nothing_else(tmp_path):
    from tools.bench.methods.glb import checked, coded_images, document_of, source_of, write_document

    scene = crossing_sheets()
    source = source_of(scene)
    assert [image.shape[2] for image in source.images.values()] == [4]  # the sheets share an image, whose alpha shows on one
    write_document(document_of(source, coded_images(source, "png")), tmp_path / "a.glb")
    read = checked(tmp_path / "a.glb", source)
    np.testing.assert_array_equal(read.positions[read.faces], scene.positions[scene.faces])
    np.testing.assert_array_equal(read.corner_uv, scene.corner_uv)
    for material in read.materials:
        np.testing.assert_array_equal(read.textures[material.texture].image, scene.textures[0].image)
    assert [m.alpha_mode for m in read.materials] == [m.alpha_mode for m in scene.materials]
    scene.textures.append(dataclasses.replace(scene.textures[0], image=scene.textures[0].image.copy()))
    scene.materials[1].texture = 1
    assert len(source_of(scene).images) == 2  # the opaque one has no alpha to code
    scene.materials[0].alpha_mode = scene.materials[1].alpha_mode
    assert len(source_of(scene).images) == 1  # the same image twice is one


def test_source_far_from_the_origin_keeps_its_shape(tmp_path):
    from tools.bench.methods.glb import checked, coded_images, document_of, source_of, write_document

    scene = mapped_sheet({})
    scene.positions = scene.positions + [4e6, -5e6, 6e6]
    source = source_of(scene)
    write_document(document_of(source, coded_images(source, "png")), tmp_path / "a.glb")
    assert np.abs(checked(tmp_path / "a.glb").positions.max(axis=0) - scene.positions.max(axis=0)).max() < 1e-6


def test_vertex_colours_are_looks_and_no_geometry(reads_meshopt, tmp_path):
    program = stand_in(tmp_path, "shutil.copy(source, target)")
    facts, decoded, _ = coded("gltf_transform", painted_sphere(6), tmp_path / "a", program=program)
    assert facts["bytes"]["images"] == 0 < facts["bytes"]["texture"]
    assert decoded.corner_color is not None and np.ptp(decoded.corner_color[..., 0]) > 0.1


@pytest.fixture
def reads_meshopt(monkeypatch):
    """What stand-ins write is no meshopt, so that nothing needs to be installed that reads it."""
    monkeypatch.setattr("tools.bench.methods.gltf_programs.reader_missing", lambda options: None)


@pytest.mark.parametrize("method", PROGRAMS)
@pytest.mark.parametrize(
    "act, sentence",
    [
        ("sys.exit('first\\nError: the file is odd\\nNode.js v20')", "exit code 1: Error: the file is odd"),
        ("os.kill(os.getpid(), 11)", "ended with exit code 139: it said nothing"),
        ("pass", "wrote no file|there is no|No such file"),
        ("open(target, 'w').write('hello')", "is no GLB file"),
        ("data = open(source, 'rb').read(); open(target, 'wb').write(data[:len(data) // 2])", "cannot be read: "),
    ],
)
def test_faults_of_programs_are_sentences(reads_meshopt, tmp_path, method, act, sentence):
    from tools.bench.methods.programs import ProgramError

    act = "if target.endswith('geometry.glb') or 'trial' in source: shutil.copy(source, target); sys.exit()\n" + act
    with pytest.raises((ProgramError, ValueError), match=sentence):
        coded(method, mapped_sheet({}, colour=smooth_image()), tmp_path / "a", program=stand_in(tmp_path, act))


@pytest.mark.parametrize("method", PROGRAMS)
def test_images_of_another_size_are_refused(reads_meshopt, tmp_path, method):
    from tools.bench.methods.glb import coded_images, document_of, source_of, write_document

    other = source_of(mapped_sheet({}, colour=np.ascontiguousarray(smooth_image()[:48])))
    write_document(document_of(other, coded_images(other, "png")), tmp_path / "other.glb")
    program = stand_in(tmp_path, f"shutil.copy({str(tmp_path / 'other.glb')!r}, target)")
    with pytest.raises(ValueError, match=r"has images of \[\(64, 48\)\], where those of \[\(64, 64\)\]"):
        coded(method, mapped_sheet({}, colour=smooth_image()), tmp_path / "a", program=program)


def test_program_that_does_nothing_is_counted_as_such(tmp_path):
    scene = mapped_sheet({}, colour=smooth_image())
    program = stand_in(tmp_path, "shutil.copy(source, target)")
    facts, decoded, sha256 = coded("gltf_transform", scene, tmp_path / "a", program=program)
    assert_counted(facts, tmp_path / "a", scene, decoded, sha256, 1e-6)
    np.testing.assert_array_equal(decoded.textures[0].image, smooth_image())


def test_hanging_program_ends_with_all_it_started(tmp_path):
    from tools.bench.methods.programs import ProgramError, run_program

    fifo = tmp_path / "alive"
    os.mkfifo(fifo)
    child = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {_holding(fifo)!r}])"
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    with pytest.raises(ProgramError, match="did not end within 3 s"):
        run_program([sys.executable, "-c", child], tmp_path / "log", 3)
    assert_let_go(reader)


def test_program_ends_with_whoever_runs_it(tmp_path):
    fifo = tmp_path / "alive"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    runs = (f"import sys; sys.path[:0] = [{str(REPOSITORY)!r}]\n"
            f"from tools.bench.methods.programs import run_program\n"
            f"run_program([sys.executable, '-c', {_holding(fifo)!r}], {str(tmp_path / 'log')!r}, 600)")
    with subprocess.Popen([sys.executable, "-c", runs]) as runner:
        wait_readable(reader)
        assert os.read(reader, 1) == b"x"
        runner.send_signal(signal.SIGKILL)
    assert_let_go(reader)


def _holding(fifo):
    """Text of a program that holds a named pipe open for an hour and says so by a letter."""
    return f"import time; pipe = open({str(fifo)!r}, 'wb', 0); pipe.write(b'x'); time.sleep(3600)"


def wait_readable(reader):
    """Waits until a pipe has something to say, be it its end."""
    assert select.select([reader], [], [], PATIENCE)[0], "nothing has happened"


def assert_let_go(reader):
    """The other end of a pipe gets closed: what held it has ended."""
    while True:
        wait_readable(reader)
        if not os.read(reader, 10):
            break
    os.close(reader)


@pytest.mark.parametrize("method", PROGRAMS)
def test_missing_programs_are_told_and_how_to_get_them(monkeypatch, tmp_path, method):
    from tools.bench.methods.programs import ProgramError

    name, variable = PROGRAMS[method]
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv(variable, raising=False)
    rival, _ = found(method)
    told = rival.missing({})
    assert told.startswith(f"{name} is not installed") and "npm install" in told and variable in told
    assert rival.encoder() == "" != rival.version()
    with pytest.raises(ProgramError, match="is not installed"):
        rival.encode(mapped_sheet({}), {}, tmp_path, 1, Report())
    monkeypatch.setenv(variable, str(tmp_path / "nowhere"))
    assert rival.missing({}) == told


def test_what_else_is_missing_is_told(monkeypatch, tmp_path):
    from tools.bench.methods import gltf_programs

    monkeypatch.setenv("PATH", str(tmp_path))
    assert "needs the command ktx" in found("gltf_transform")[0].missing({"texture": "etc1s", "program": sys.executable})
    refusing = stand_in(tmp_path, "sys.exit('Error: built without WebP support')")
    assert "cannot code images as webp" in found("gltfpack")[0].missing({"program": refusing})
    monkeypatch.setattr(gltf_programs, "find_spec", lambda name: None)
    assert "meshoptimizer" in found("gltf_transform")[0].missing({"mesh": "meshopt", "program": sys.executable})
    assert "opengl-basisu" in gltf_programs.reader_missing({"mesh": "draco", "texture": "etc1s"})


@pytest.mark.parametrize(
    "method, name, value",
    [("gltf_transform", "mesh", "zip"), ("gltf_transform", "quality", 0), ("gltf_transform", "quality", True),
     ("gltf_transform", "speed", 11), ("gltfpack", "texture", "avif"), ("gltfpack", "uv_bits", 17), ("gltfpack", "shrink", 1.5)],
)
def test_options_out_of_range_are_refused(tmp_path, method, name, value):
    with pytest.raises(ValueError, match=f"{name} must be"):
        coded(method, mapped_sheet({}), tmp_path / "a", **{name: value})


def test_jpeg_is_refused_where_alpha_shows(tmp_path):
    with pytest.raises(LookupError, match="JPEG has no alpha"):
        coded("gltf_transform", crossing_sheets(), tmp_path / "a", texture="jpeg", program=sys.executable)
