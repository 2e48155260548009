"""What the tools may write over and what not, stdin and stdout in all of them, and what they say of sizes and progress."""

import io
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from texfcodec import DecodeOptions, EncodeOptions, InputError, Report, Texf, decode, encode, inspect
from texfcodec.cli import console, interrupts, progress
from texfcodec.cli.flags import direction_of
from texfcodec.cli.inputs import load_asset, say_losses
from texfcodec.demo.asset import make_sample
from texfcodec.io.load import load
from texfcodec.render.camera import fibonacci_direction
from texfcodec.scene.scene import Scene

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = ("--resolution", "32", "--qp", "24")
OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"


def process(name, *arguments, **settings):
    """A command line in a process of its own, as users start it."""
    program = [sys.executable, "-m", "texfcodec.cli." + name.removeprefix("texf-"), *(str(a) for a in arguments)]
    return subprocess.run(program, cwd=REPOSITORY, capture_output=True, check=False, timeout=300, **settings)


@pytest.fixture
def house(tmp_path):
    """A folder with an OBJ, its MTL and its texture."""
    (tmp_path / "a.obj").write_text(OBJ)
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    Image.new("RGB", (4, 4), (200, 100, 50)).save(tmp_path / "a.png")
    return tmp_path


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The paths of a GLB and of its stream."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "s.texf").write_bytes(encode(make_sample(), EncodeOptions(resolution=32, qp=30)))
    decode((folder / "s.texf").read_bytes()).save(folder / "s.glb", appearance="vertex")
    return folder / "s.glb", folder / "s.texf"


@pytest.fixture(scope="module")
def atlas_stream(tmp_path_factory):
    """The path of a stream without fields over texels: one image goes with its mesh, the atlas."""
    path = tmp_path_factory.mktemp("atlas") / "s.texf"
    path.write_bytes(encode(make_sample(), EncodeOptions(resolution=32, qp=30, support="voxels")))
    return path


def held(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


# Files that were read


def test_loader_names_what_it_opened(house):
    files = load(house / "a.obj").files
    assert files == {str(house / name): (house / name).stat().st_size for name in ("a.obj", "a.mtl", "a.png")}


@pytest.mark.parametrize("out", ["a.obj", "./a.obj", "sub/../a.obj", "a.mtl", "a.png", "hard.texf", "soft.texf", "soft_mtl.texf"])
def test_encoder_replaces_no_file_that_it_read(call, house, monkeypatch, out):
    (house / "sub").mkdir()
    os.link(house / "a.obj", house / "hard.texf")
    (house / "soft.texf").symlink_to("a.obj")
    (house / "soft_mtl.texf").symlink_to("a.mtl")
    (house / "sub").rmdir() if "sub" not in out else None
    monkeypatch.chdir(house)
    before = {name: path.read_bytes() for name, path in ((p.name, p) for p in house.iterdir() if p.is_file())}
    code, said, err = call("texf-enc", house / "a.obj", out, *SMALL, "--json")
    assert code in (1, 2) and json.loads(said)["error"]["code"] in ("TXF-O07", "TXF-C01") and err == ""
    assert {p.name: p.read_bytes() for p in house.iterdir() if p.is_file()} == before
    if out.endswith((".texf", ".obj")):
        assert code == 2 and json.loads(said)["error"]["code"] == "TXF-O07"


@pytest.mark.parametrize("out", ["a.gltf", "a", "a.texf.bak", "b.mtl"])
def test_encoder_writes_streams_only(call, house, out):
    before = held(house)
    code, _, err = call("texf-enc", house / "a.obj", house / out, *SMALL)
    assert code == 1 and "must end in .texf" in err and err.count("\n") == 1 and held(house) == before


def test_encoder_replaces_an_old_stream_and_takes_devices(call, house):
    (house / "a.texf").write_bytes(b"old")
    assert call("texf-enc", house / "a.obj", house / "a.texf", *SMALL)[0] == 0
    assert inspect((house / "a.texf").read_bytes())["faces"] == 1
    if os.path.exists("/dev/null"):
        assert call("texf-enc", house / "a.obj", "/dev/null", *SMALL)[0] == 0


def test_a_gltf_with_its_buffer_is_protected(call, atlas_stream, tmp_path):
    decode(atlas_stream.read_bytes()).save(tmp_path / "b.gltf", texture_size=64, atlas="fast")
    for name in ("b.bin", "b.jpg"):
        (tmp_path / (name + ".texf")).symlink_to(name)
        code, said, _ = call("texf-enc", tmp_path / "b.gltf", tmp_path / (name + ".texf"), *SMALL, "--json")
        assert (code, json.loads(said)["error"]["code"]) == (2, "TXF-O07"), name


def test_decoder_does_not_replace_its_stream(call, made, tmp_path):
    (tmp_path / "s.glb").write_bytes(made[1].read_bytes())
    (tmp_path / "s.bin").write_bytes(made[1].read_bytes())
    before = held(tmp_path)
    for source, out, *more in (("s.glb", "s.glb"), ("s.bin", "s.gltf", "--overwrite")):
        code, said, _ = call("texf-dec", tmp_path / source, tmp_path / out, "--json", *more)
        assert (code, json.loads(said)["error"]["code"]) == (2, "TXF-O07") and held(tmp_path) == before


def test_picture_does_not_replace_what_is_drawn(call, house):
    before = held(house)
    for arguments in ((house / "a.obj", house / "a.png"), (house / "a.obj", house / "a.png", "--compare", house / "a.obj")):
        code, said, _ = call("texf-render", *arguments, "--size", "32", "--json")
        assert (code, json.loads(said)["error"]["code"]) == (2, "TXF-O07") and held(house) == before


# Files that were not named


@pytest.mark.parametrize("out, sides", [("a.obj", ("a.mtl", "a.jpg")), ("a.gltf", ("a.bin", "a.jpg"))])
def test_files_beside_the_output_stay_unless_asked(call, atlas_stream, tmp_path, out, sides):
    flags = ("--texture-size", "64", "--atlas", "fast")
    for side in sides:
        for path in tmp_path.iterdir():
            path.unlink()
        (tmp_path / side).write_bytes(b"mine")
        (tmp_path / out).write_bytes(b"old")
        before = held(tmp_path)
        code, said, _ = call("texf-dec", atlas_stream, tmp_path / out, *flags, "--json")
        error = json.loads(said)["error"]
        assert (code, error["code"]) == (2, "TXF-O08") and error["path"].endswith(side) and held(tmp_path) == before
        with pytest.raises(InputError) as raised:
            decode(atlas_stream.read_bytes()).save(tmp_path / out, texture_size=64, atlas="fast")
        assert raised.value.code == "TXF-O08" and held(tmp_path) == before
    code, said, _ = call("texf-dec", atlas_stream, tmp_path / out, *flags, "--json", "--overwrite")
    assert code == 0 and set(json.loads(said)["files"]) == set(held(tmp_path)) == {out, *sides}
    assert not {b"mine", b"old"} & set(held(tmp_path).values())


def test_the_output_itself_is_replaced(call, made, tmp_path):
    (tmp_path / "a.glb").write_bytes(b"old")
    assert call("texf-dec", made[1], tmp_path / "a.glb", "--appearance", "vertex")[0] == 0
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"


def test_a_side_file_that_appears_during_the_work_stays(made, tmp_path, monkeypatch):
    from texfcodec.io import save_build
    from texfcodec.io.save import save

    def built(*_):
        (tmp_path / "a.bin").write_bytes(b"mine")
        return [("a.bin", [b"new"]), ("a.gltf", [b"{}"])], save_build.SaveReport()

    monkeypatch.setitem(save_build._BUILDERS, ".gltf", built)
    with pytest.raises(InputError) as raised:
        save(decode(made[1].read_bytes()), tmp_path / "a.gltf")
    assert raised.value.code == "TXF-O08" and held(tmp_path) == {"a.bin": b"mine"}


# stdin and stdout


def test_a_dash_is_stdin_and_stdout_in_every_tool(made, tmp_path):
    glb, stream = (path.read_bytes() for path in made)
    enc_ = process("texf-enc", "-", "-", *SMALL, input=glb)
    assert enc_.returncode == 0 and inspect(enc_.stdout)["faces"] > 100
    dec_ = process("texf-dec", "-", "-", "--appearance", "vertex", "--json", input=stream)
    assert dec_.stdout[:4] == b"glTF" and dec_.stdout == glb and json.loads(dec_.stderr)["files"] == []
    assert b"sequence_header" in process("texf-info", "-", input=stream).stdout
    assert process("texf-validate", "-", input=stream).stdout.startswith(b"valid: 0 errors, ")
    for data, other in ((stream, made[0]), (glb, made[1])):
        drawn = process("texf-render", "-", "-", "--size", "64", "--compare", other, input=data)
        assert np.asarray(Image.open(io.BytesIO(drawn.stdout))).shape[2] == 3 and b"-: " in drawn.stderr
        drawn = process("texf-render", other, tmp_path / "a.png", "--size", "64", "--compare", "-", input=data)
        assert drawn.returncode == 0 and b"PSNR" in drawn.stdout
    views = ("--views", "1", "--size", "32", "--no-3d", "--json")
    for source, other, data in (("-", made[1], glb), (made[0], "-", stream), (made[0], "-", glb)):
        told = process("texf-eval", source, other, *views, input=data)
        assert told.returncode == 0 and json.loads(told.stdout)["pixels"] > 10


@pytest.fixture
def piped(monkeypatch):
    """piped(data): data on stdin, and what will hold the bytes that go to stdout."""

    def put(data):
        out = io.TextIOWrapper(io.BytesIO())
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data)))
        monkeypatch.setattr(sys, "stdout", out)
        return out.buffer

    return put


def test_the_decoders_mesh_goes_to_stdout_and_its_report_to_stderr(call, made, piped):
    out = piped(made[1].read_bytes())
    code, _, err = call("texf-dec", "-", "-", "--appearance", "vertex", "--json")
    assert (code, out.getvalue()) == (0, made[0].read_bytes()) and json.loads(err)["files"] == []


@pytest.mark.parametrize("number, kind", [(0, Scene), (1, Texf)])
def test_a_mesh_on_stdin_is_told_from_a_stream_by_its_first_bytes(made, piped, number, kind):
    data, inputs = made[number].read_bytes(), []
    piped(data)
    asset = load_asset("-", DecodeOptions(threads=1), inputs, Report())
    assert isinstance(asset, kind) and len(asset.faces) == len(load(made[0]).faces) and inputs == []


@pytest.mark.parametrize("data, code", [(b"neither fish nor mesh\n", "TXF-I05"), (b"", "TXF-I04"), (b"glTF", "TXF-I07"),
                                        (b"\x89TXF\r\n\x1a\n", "TXF-I05")])
def test_a_mesh_on_stdin_is_of_a_known_format_or_a_coded_error(tmp_path, data, code):
    run = process("texf-enc", "-", tmp_path / "a.texf", *SMALL, "--json", input=data)
    assert (run.returncode, json.loads(run.stdout)["error"]["code"], run.stderr) == (2, code, b"")


@pytest.mark.parametrize("name, arguments", [("texf-eval", ("-", "-")), ("texf-render", ("-", "a.png", "--compare", "-"))])
def test_stdin_is_read_once(call, name, arguments):
    code, _, err = call(name, *arguments)
    assert code == 1 and "stdin" in err


def test_info_can_be_quiet(call, made, tmp_path):
    assert call("texf-info", made[1], "--quiet", "--verify") == (0, "", "")
    code, out, err = call("texf-info", tmp_path / "none.texf", "--quiet")
    assert code == 2 and out == "" and "TXF-I01" in err


@pytest.mark.parametrize("flags, count", [([], 3), (["--json"], 0), (["--quiet"], 0)])
def test_losses_are_said_to_people(capsys, flags, count):
    report = Report()
    report.remarks, report.warnings, report.dropped = ["one"], ["two"], ["a", "b"]
    say_losses(console.Console(flags), report)
    said = ["note: one", "warning: two", "2 properties are not read and not drawn; --json names them"]
    assert capsys.readouterr().err.splitlines() == said[:count]


# Sizes


def test_encoder_compares_the_stream_with_all_it_read(call, house):
    total = sum((house / name).stat().st_size for name in ("a.obj", "a.mtl", "a.png"))
    code, out, _ = call("texf-enc", house / "a.obj", house / "a.texf", *SMALL, "--json")
    facts, size = json.loads(out), (house / "a.texf").stat().st_size
    names = [str(house / name) for name in ("a.obj", "a.mtl", "a.png")]
    assert code == 0 and facts["source"] == {"bytes": total, "files": 3, "names": names}
    assert facts["ratio"] == round(total / size, 3)
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (4, 4, 3), np.uint8)).save(house / "a.png")
    total = sum((house / name).stat().st_size for name in ("a.obj", "a.mtl", "a.png"))
    code, out, _ = call("texf-enc", house / "a.obj", house / "a.texf", *SMALL, "--json")
    assert json.loads(out)["ratio"] == round(total / (house / "a.texf").stat().st_size, 3) < 1
    _, out, err = call("texf-enc", house / "a.obj", house / "a.texf", *SMALL)
    assert f"source: {total} bytes in 3 files" in out and f"is larger than its source ({total} bytes)" in err
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)).save(house / "a.png")
    out = call("texf-enc", house / "a.obj", house / "a.texf", *SMALL)[1]
    assert "larger" not in out and "times the stream" in out
    facts = json.loads(call("texf-enc", house / "a.obj", "--dry-run", "--json")[1])
    assert facts["source"]["files"] == 3 and facts["ratio"] is None


# Progress where there is no terminal


def test_a_line_now_and_then_says_where_a_long_run_is(capsys, monkeypatch):
    monkeypatch.setattr(progress, "LINE_SECONDS", 0.05)
    with console.Console([]).progress() as report, report.stage("attributes"):
        report.progress("attributes", 1, 4)
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 7 and lines[0].startswith("progress: attributes 25 %, 0 s")
    assert all(re.match(r"progress: attributes (25|100) %, 0 s", line) for line in lines)  # the last may come as the stage ends
    for flags in (["--quiet"], ["--json"]):
        with console.Console(flags).progress() as report, report.stage("attributes"):
            time.sleep(0.2)
        assert capsys.readouterr().err == ""


def test_a_terminal_has_a_bar_for_every_stage(capsys, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with console.Console([]).progress() as report:
        for stage in ("geometry", "attributes"):
            with report.stage(stage):
                report.progress(stage, 1, 4)
                report.progress(stage, 4, 4)
        assert interrupts.Talk.bar
    err = capsys.readouterr().err
    assert "geometry" in err and "attributes" in err and err.count("\x1b[?25l") == err.count("\x1b[?25h") == 1
    assert "progress:" not in err and not interrupts.Talk.bar


def test_lines_are_ten_seconds_apart():
    assert progress.LINE_SECONDS == 10


# Pictures


@pytest.mark.parametrize("told, direction", [("top", (0, 1, 0)), ("0,90", (0, 1, 0)), ("90,0", (1, 0, 0)),
                                             ("fibonacci:5", fibonacci_direction(5, 16))])
def test_a_view_is_named_numbered_or_two_angles(told, direction):
    assert direction_of(None, None, told) == pytest.approx(tuple(direction))


def test_an_exact_match_has_one_word(call, made, tmp_path):
    drawn = call("texf-render", made[0], tmp_path / "a.png", "--compare", made[0], "--size", "32")[1]
    told = call("texf-eval", made[0], made[0], "--views", "1", "--size", "32", "--no-3d")[1]
    assert "RGB exact, Y exact" in drawn and "RGB exact, Y exact" in told
    said = [path.read_text(encoding="utf-8") for path in (REPOSITORY / "texfcodec").rglob("*.py")]
    assert [word for text in said for word in ('"lossless" if', '"equal" if', '"exact" if') if word in text] == ['"lossless" if']
