"""What the library's functions refuse, each with its code, and the small cases around them."""

import contextlib
import errno
import io
import json
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from conftest import REPOSITORY
from shapes import painted_sphere, scene_of, square

from texfcodec import EncodeOptions, InputError, LimitError, Limits, Report, SupportError, TexfError, decode
from texfcodec.api import encode_loaded, inspect
from texfcodec.bitstream.appearance import parameter_values
from texfcodec.bitstream.values import metadata_bytes
from texfcodec.cli.info import main as run_info
from texfcodec.codecs import codec_of
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.geometry.canonical import fit_cube
from texfcodec.geometry.edges import folds, shared_edges
from texfcodec.geometry.shading_normals import corner_normals
from texfcodec.io import images
from texfcodec.io.atlas.unwrap import _unit_points
from texfcodec.io.save import as_input_error
from texfcodec.sandbox import isolate
from texfcodec.sandbox.limited_process import (
    FACTS,
    FACTS_BYTES,
    LEAST_BYTES,
    NO_CAP,
    cap_memory,
    is_memory,
    read_facts,
    within_cap,
)
from texfcodec.scene.factors import set_factor
from texfcodec.scene.normal_rule import ANGLE, JOINED, NormalRule
from texfcodec.scene.scene import Material


@pytest.fixture(scope="module")
def texf():
    return decode(encode_scene(painted_sphere(4), EncodeOptions(resolution=8, qp=40, threads=1)).data)


@pytest.mark.parametrize("options", [
    {"resolution": "wide"}, {"resolution": 2.5}, {"qp": True}, {"qp": float("nan")}, {"qp": 64}, {"resolution": 0},
    {"lossless": 1}, {"effort": "great"}, {"lossless": True, "max_error": 2}, {"max_error": 2, "qp": 20},
    {"max_error": 2, "target_psnr": 40.0}, {"codec": "3dntc", "refine": "fit"},
    {"codec": "3dntc", "point": "mpeg1", "resident_bytes": 40_000},
    {"codec": "3dntc", "resident_bytes": 40_000, "latent_index": "hash"}], ids=str)
def test_options_that_mean_nothing_are_refused(options):
    with pytest.raises(InputError, match="TXF-I50"):
        encode_scene(painted_sphere(4), EncodeOptions(**options))


def test_questions_that_have_no_answer_are_refused(texf):
    points = texf.positions[:3]
    for wrong in ("here", [[1, 2]], [1, 2, 3, 4], object()):
        with pytest.raises(InputError, match="TXF-I72"):
            texf.query(wrong)
    for faces in ([0, 1], [0.0, 1.0, 2.0], [0, 1, len(texf.faces)], [0, 1, -1]):
        with pytest.raises(InputError, match="TXF-I72"):
            texf.query(points, faces)
    with pytest.raises(InputError, match="TXF-I71"):
        texf.query([[0, 0, np.inf]])
    assert texf.query(np.zeros((0, 3))).shape == (0, 4) and texf.query(points, [0, 1, 2]).shape == (3, 4)


def test_an_empty_asset_answers_nothing():
    empty = decode(encode_scene(scene_of(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), EncodeOptions(allow_empty=True)).data)
    for ask in (empty.query, empty.nearest_face):
        with pytest.raises(InputError, match="TXF-I70"):
            ask(np.zeros((1, 3)))
    assert fit_cube(np.zeros((0, 3)), 12).side == 0 and empty.side == 0


@pytest.mark.parametrize("given", [None, 3, {"a": 1}, ()], ids=str)
def test_what_is_neither_bytes_nor_a_path_is_refused(given):
    for read in (inspect, decode):
        with pytest.raises(InputError, match="TXF-I05"):
            read(given)


def test_parameters_that_are_no_numbers_of_their_count_are_refused():
    for value in ((1.0, 2.0), (float("inf"),), (float("nan"),)):
        with pytest.raises(InputError, match="TXF-I14"):
            parameter_values(Material("skin", parameters={"roughness": value}))
    parameters = {"roughness": (0.5,)}
    set_factor(parameters, "roughness", (1.0,))
    assert parameters == {}  # the default is not kept


def test_metadata_over_the_limit_are_left_out_and_said():
    report, options = Report(), EncodeOptions(limits=Limits(metadata_bytes=10))
    assert metadata_bytes({"copyright": "somebody"}, options, report) is None and "left out" in report.remarks[0]
    assert metadata_bytes({}, options, report) is None and metadata_bytes({"a": 1}, options, report) == b'{"a":1}'


def test_an_answer_that_is_too_long_is_not_read(tmp_path):
    with open(tmp_path / FACTS, "wb") as file:
        file.truncate(FACTS_BYTES + 1)
    with pytest.raises(ValueError, match="too long"):
        read_facts(tmp_path)


def test_want_of_memory_is_known_in_whatever_it_is_wrapped():
    wrapped = ValueError("no")
    wrapped.__cause__ = OSError(errno.ENOMEM, "x")
    assert is_memory(MemoryError()) and is_memory(wrapped) and is_memory(RuntimeError("std::bad_alloc"))
    assert not is_memory(None) and not is_memory(ValueError("no"))
    assert cap_memory(None)


@pytest.mark.parametrize("number, code", [(errno.ENOENT, "TXF-O01"), (errno.ENOTDIR, "TXF-O01"), (errno.EROFS, "TXF-O02"),
                                          (errno.ENOSPC, "TXF-O03"), (errno.EIO, "TXF-O04")])
def test_an_output_that_fails_has_a_code(number, code):
    assert as_input_error(OSError(number, "no"), Path("folder/a.glb")).code == code


def test_a_pillow_without_a_format_is_told(monkeypatch):
    from PIL import features

    monkeypatch.setattr(features, "check", lambda name: False)
    with pytest.raises(SupportError, match="TXF-O15"):
        images.check_image_format("webp", None)


def test_edges_that_nothing_shares_have_no_fold():
    faces = np.array([[0, 1, 2]])
    assert len(folds(shared_edges(faces), np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]]), faces)) == 0


def test_a_joined_rule_goes_round_a_prism():
    prism = trimesh.creation.cylinder(1, 2, sections=6)
    lattice = np.rint(prism.vertices * 1000).astype(np.int64) + 3000
    hard, soft = (corner_normals(lattice, prism.faces, [NormalRule(JOINED, ANGLE, angle)]) for angle in (20, 80))
    turned = np.degrees(np.arccos(np.clip((hard * soft).sum(-1), -1, 1))).ravel()
    assert np.isclose(hard[..., None, :] @ soft[..., None], 1, atol=1e-5).any() and 25 < turned.max() < 35


def test_points_of_any_scale_come_into_the_unit_cube():
    faces = np.array([[0, 1, 2]])
    for scale in (1e-300, 1.0, 1.7e308):
        points = _unit_points(np.array([[-1, -1, 0], [1, 0, 0], [0, 1, 0]]) * scale, faces)
        assert points.min() == 0 and 0.99 < points.max() <= 1
    assert not _unit_points(np.ones((3, 3)), faces).any() and not _unit_points(np.ones((3, 3)), faces[:0]).any()


@pytest.fixture(scope="module")
def veil():
    """A decoded square of a material without a name that is see-through here and there."""
    positions, faces = square()
    colours = np.array([[0.5, 0.4, 0.3, 0.5], [0.5, 0.1, 0.3, 1.0], [0.1, 0.4, 0.3, 0.0], [0.9, 0.4, 0.3, 0.7]])
    scene = scene_of(positions, faces, colours, materials=[Material("", alpha_mode=2)])
    return decode(encode_scene(scene, EncodeOptions(resolution=8, qp=30)).data)


def test_vertex_colours_with_alpha_lose_it_in_an_obj(veil, tmp_path):
    assert any("no alpha" in text for text in veil.save(tmp_path / "a.obj", appearance="vertex")["warnings"])


def test_alpha_is_kept_by_a_texture_of_an_obj_and_by_points(veil, tmp_path):
    veil.save(tmp_path / "a.obj", texture_size=16)
    assert "map_d a" in (tmp_path / "a.mtl").read_text()
    veil.save(tmp_path / "a.gltf", appearance="voxels")
    (points,) = json.loads((tmp_path / "a.gltf").read_text())["materials"]
    assert points["alphaMode"] == "BLEND"
    veil.save(tmp_path / "b.gltf", texture_size=16, overwrite=True)
    (material,) = json.loads((tmp_path / "b.gltf").read_text())["materials"]
    assert "name" not in material and material["alphaMode"] == "BLEND"


@pytest.mark.parametrize("raised, code", [
    (MemoryError(), "TXF-L07"), (ImportError("no room for a module"), "TXF-L07"), (SyntaxError("expected ':'"), "TXF-L07"),
    (SupportError("TXF-U03", "no"), "TXF-U03")])
def test_what_fails_within_a_cap_has_a_code(monkeypatch, raised, code):
    def work():
        raise raised

    monkeypatch.setattr("texfcodec.sandbox.limited_process.cap_memory", lambda size: True)
    with pytest.raises(TexfError) as found:
        within_cap(Limits(), work)
    assert found.value.code == code


def test_a_module_that_is_missing_where_nothing_is_capped_is_no_want_of_memory():
    def work():
        raise ImportError("no such module")

    with pytest.raises(ImportError, match="no such module"):
        within_cap(Limits(isolate_bytes=None), work)


def test_work_within_a_cap_gives_what_it_gives_and_later_threads_have_their_usual_stack(monkeypatch):
    monkeypatch.setattr("texfcodec.sandbox.limited_process.cap_memory", lambda size: size is None)
    before = threading.stack_size()
    assert within_cap(Limits(isolate_bytes=None), lambda: 7) == (7, True) and within_cap(Limits(), lambda: 8) == (8, False)
    assert threading.stack_size() == before


def test_too_little_memory_to_begin_is_refused_before_the_work():
    with pytest.raises(LimitError) as raised:
        within_cap(Limits(isolate_bytes=LEAST_BYTES - 1), pytest.fail)
    assert raised.value.code == "TXF-L07" and raised.value.details["allowed"] == LEAST_BYTES - 1


def test_a_child_says_what_went_wrong_in_it(monkeypatch, tmp_path):
    """In this process, whose memory is not capped."""
    request = {"limits": asdict(Limits())}
    stream = io.BytesIO((REPOSITORY / "conformance/uncommon/one_voxel/in.texf").read_bytes())
    monkeypatch.setattr("texfcodec.sandbox.limited_process.cap_memory", lambda size: False)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=stream))
    isolate._child(tmp_path, dict(request))
    assert read_facts(tmp_path)["warnings"] == [NO_CAP]

    def fails(error):
        def decode_stream(*_):
            raise error

        monkeypatch.setattr("texfcodec.decoder.decode_stream", decode_stream)
        isolate._child(tmp_path, dict(request))

    fails(MemoryError())
    assert read_facts(tmp_path)["error"]["code"] == "TXF-L07"
    with pytest.raises(ZeroDivisionError):
        fails(ZeroDivisionError())


RESIDENT = {"resident": {"total": 9, "latents": 5, "network": 3, "index": 1}, "fields": 2, "fit": {
    "levels": [{"rows": 3, "resolution": 8}], "steps": 5, "asked_steps": 9, "seconds": 1.0, "psnr_rgb": 30.0,
    "psnr_channels": {"base_colour": 30.0, "roughness": 41.0}}}


@pytest.mark.parametrize("told, last", [
    ({"kind": "render", "asked": "auto", "iterations": [{"iteration": 0, "held_out_psnr": 30.0},
                                                        {"iteration": 4, "held_out_psnr": 33.0}],
      "kept_iteration": 4, "psnr_rgb": 31.0}, "refined on pictures: 30.00 dB to 33.00 dB"),
    ({"kind": "off", "asked": "render", "reason": "it gained nothing"}, "not refined on pictures: it gained nothing"),
    ({"kind": "off", "asked": "off"}, "there, in 0 to 255: roughness 41.00 dB")])
def test_a_fit_is_told_in_lines(told, last):
    lines = list(codec_of("3dntc").result_lines(RESIDENT | {"refinement": told}))
    assert "2 fields" in lines[0] and "5 steps of 9" in lines[1] and lines[-1].startswith(last)
    alone = RESIDENT | {"fit": RESIDENT["fit"] | {"psnr_channels": {"base_colour": 30.0}}, "refinement": told}
    assert not any(line.startswith("there, ") for line in codec_of("3dntc").result_lines(alone))


def test_bytes_by_level_are_told(call):
    code, out, _ = call("texf-info", REPOSITORY / "conformance/uncommon/level_index/in.texf")
    assert code == 0 and "bytes by level, coarse to fine: " in out


def test_a_first_run_is_said_and_streams_of_any_kind_take_text(call, monkeypatch, tmp_path):
    monkeypatch.setattr("texfcodec.precompile.kernels_compiled", lambda: False)
    code, _, said = call("texf-dec", REPOSITORY / "conformance/uncommon/one_voxel/in.texf", tmp_path / "a.ply")
    assert code == 0 and "compil" in said
    with contextlib.redirect_stdout(io.StringIO()) as out, pytest.raises(SystemExit) as ended:
        run_info([str(REPOSITORY / "conformance/uncommon/one_voxel/in.texf")])
    assert ended.value.code == 0 and "446 bytes" in out.getvalue()


def test_a_budget_of_bytes_is_searched_for():
    made = encode_loaded(painted_sphere(4), EncodeOptions(target_bytes=3000, resolution=16, threads=1), Report())
    assert len(made.data) <= 3000
