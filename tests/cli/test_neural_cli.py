"""The command lines with --codec 3dntc."""

import json
from dataclasses import replace

import pytest

from texfcodec import decode
from texfcodec.codecs import codec_of
from texfcodec.demo.asset import write_sample

SMALL = ("--codec", "3dntc", "--resolution", "48", "--resident-bytes", "60000", "--steps", "20")


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "sample.glb"
    write_sample(path)
    return path


def test_a_payload_is_made_described_and_decoded(call, mesh, tmp_path):
    code, out, _ = call("texf-enc", mesh, tmp_path / "a.texf", *SMALL, "--json", "--measure")
    facts = json.loads(out)
    assert code == 0 and facts["codec"] == "3dntc" and facts["resident"]["total"] <= 60_000 and facts["fit"]["steps"] == 20
    assert facts["psnr_3d"]["rgb"] > 10
    code, out, _ = call("texf-info", tmp_path / "a.texf", "--verify")
    assert code == 0 and "3DNTC, all fields" in out and "resident form" in out and "verified: OK" in out
    code, out, _ = call("texf-dec", tmp_path / "a.texf", tmp_path / "a.ply", "--json")
    assert code == 0 and (tmp_path / "a.ply").stat().st_size > 1000


def test_people_read_what_the_gpu_keeps_and_what_the_fit_reached(call, mesh, tmp_path):
    code, out, _ = call("texf-enc", mesh, tmp_path / "a.texf", *SMALL)
    assert code == 0 and "resident" in out and "fit: 20 steps" in out and "dB at held-out points" in out


def test_people_read_what_pictures_gained(call, mesh, tmp_path, monkeypatch):
    from texfcodec.encoder.values import picture_refinement, pictures

    real, few = picture_refinement.refine_by_pictures, pictures.Schedule(iterations=1, size=64)
    short = lambda fit, source, bits, schedule, **named: real(fit, source, bits, replace(few, seed=schedule.seed), **named)
    monkeypatch.setattr(picture_refinement, "refine_by_pictures", short)
    code, out, _ = call("texf-enc", mesh, tmp_path / "a.texf", *SMALL, "--refine", "render")
    assert code == 0 and "refined on pictures" in out
    code, out, _ = call("texf-enc", mesh, tmp_path / "b.texf", *SMALL, "--refine", "fit", "--json")
    assert code == 2 and json.loads(out)["error"]["code"] == "TXF-I50" and not (tmp_path / "b.texf").exists()


def test_a_checkpoint_is_taken_up_and_that_of_another_fit_refused(call, mesh, tmp_path):
    kept = ("--checkpoint", tmp_path / "fit.ckpt", "--json")
    first, second = (json.loads(call("texf-enc", mesh, tmp_path / name, *SMALL, *kept)[1]) for name in ("a.texf", "b.texf"))
    assert (tmp_path / "a.texf").read_bytes() == (tmp_path / "b.texf").read_bytes()
    assert second["fit"]["seconds"] == first["fit"]["seconds"]  # nothing was left to do
    code, out, _ = call("texf-enc", mesh, tmp_path / "c.texf", *SMALL, "--seed", "5", *kept)
    assert code == 2 and json.loads(out)["error"]["code"] == "TXF-I55" and not (tmp_path / "c.texf").exists()


@pytest.mark.parametrize("flags", [
    ("--codec", "3dntc", "--qp", "20"), ("--codec", "3dntc", "--rate", "r03"), ("--codec", "3dntc", "--lossless"),
    ("--codec", "3dntc", "--effort", "fast"), ("--point", "mpeg1"), ("--steps", "10"), ("--transport",),
    ("--codec", "raht", "--resident-bytes", "10000"), ("--checkpoint", "x"),
])
def test_flags_of_the_other_codec_are_a_mistake(call, mesh, tmp_path, flags):
    code, _, err = call("texf-enc", mesh, tmp_path / "a.texf", *flags)
    assert code == 1 and "does not apply to" in err and not (tmp_path / "a.texf").exists()


def test_isolated_decoding_gives_the_same_file(call, mesh, tmp_path):
    call("texf-enc", mesh, tmp_path / "a.texf", *SMALL, "--quiet")
    for name, flags in (("a.npz", ()), ("b.npz", ("--isolate",))):
        assert call("texf-dec", tmp_path / "a.texf", tmp_path / name, *flags)[0] == 0
    assert decode((tmp_path / "a.texf").read_bytes()).evaluators
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


RESIDENT = {"resident": {"total": 9, "latents": 5, "network": 3, "index": 1}, "fields": 2, "fit": {
    "levels": [{"rows": 3, "resolution": 8}], "steps": 5, "asked_steps": 9, "seconds": 1.0, "psnr_rgb": 30.0,
    "psnr_channels": {"base_colour": 30.0, "roughness": 41.0}}}


@pytest.mark.parametrize("told, last", [
    ({"kind": "render", "asked": "auto", "iterations": [{"iteration": 0, "held_out_psnr": 30.0},
                                                        {"iteration": 4, "held_out_psnr": 33.0}],
      "kept_iteration": 4, "psnr_rgb": 31.0}, "refined on pictures: 30.00 dB to 33.00 dB"),
    ({"kind": "off", "asked": "render", "reason": "it gained nothing"}, "not refined on pictures: it gained nothing"),
    ({"kind": "off", "asked": "off"}, "maps at held-out points, in 0 to 255: roughness 41.00 dB")])
def test_a_fit_is_told_in_lines(told, last):
    lines = list(codec_of("3dntc").result_lines(RESIDENT | {"refinement": told}))
    assert "2 fields" in lines[0] and "5 steps of 9" in lines[1] and lines[-1].startswith(last)
    alone = RESIDENT | {"fit": RESIDENT["fit"] | {"psnr_channels": {"base_colour": 30.0}}, "refinement": told}
    assert not any(line.startswith("there, ") for line in codec_of("3dntc").result_lines(alone))
