"""The three command lines: text, JSON, exit codes, and that nothing half-written stays.

The golden texts are rewritten by hand: `texf-enc --help > tests/golden/texf-enc.txt`, and so on.
"""

import contextlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from texfcodec import EncodeOptions, Limits, Report, encode, encode_to_result, inspect
from texfcodec.bitstream.stream import write_stream
from texfcodec.bitstream.units import write_unit
from texfcodec.cli import dec, enc, eval, info, render, validate, view
from texfcodec.report import Cancelled

REPOSITORY = Path(__file__).resolve().parents[2]
GOLDEN = Path(__file__).parents[1] / "golden"
COMMANDS = {"texf-enc": enc.main, "texf-dec": dec.main, "texf-info": info.main, "texf-render": render.main,
            "texf-eval": eval.main, "texf-validate": validate.main, "texf-view": view.main}
SMALL = ("--resolution", "32", "--qp", "24")


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """The word about the first run belongs to a test of its own, not to whichever test comes first."""
    from texfcodec.precompile import kernels_compiled, warm_up

    if not kernels_compiled():
        warm_up()


@pytest.fixture(scope="session")
def mesh(tmp_path_factory):
    """A tetrahedron with vertex colours as PLY; the quality of its vertices is not coded."""
    path = tmp_path_factory.mktemp("mesh") / "tetra.ply"
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    rows = [f"{x} {y} {z} {1.0} {250 * x} {250 * y} {250 * z}" for x, y, z in vertices]
    floats = "".join(f"property float {name}\n" for name in ("x", "y", "z", "quality"))
    bytes_ = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    faces = ["3 0 2 1", "3 0 1 3", "3 0 3 2", "3 1 2 3"]
    head = f"ply\nformat ascii 1.0\nelement vertex 4\n{floats}{bytes_}element face 4\n"
    path.write_text(head + "property list uchar int vertex_indices\nend_header\n" + "\n".join(rows + faces) + "\n")
    return path


@pytest.fixture(scope="session")
def stream(mesh):
    return encode(mesh, EncodeOptions(resolution=32, qp=24))


def process(*arguments, **settings):
    """A command line in a process of its own, as users start it."""
    name, *rest = [str(a) for a in arguments]
    program = [sys.executable, "-m", "texfcodec.cli." + name.removeprefix("texf-"), *rest]
    return subprocess.run(program, cwd=REPOSITORY, capture_output=True, check=False, timeout=120, **settings)


# Text


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_the_golden_text(call, name):
    code, out, err = call(name, "--help")
    assert (code, err) == (0, "")
    golden = (GOLDEN / f"{name}.txt").read_text(encoding="utf-8")
    assert "".join(out.split()) == "".join(golden.split())  # a line may break anywhere, by the width of the terminal


STREAMS = {"file_bytes", "vertices", "faces", "voxels", "texels", "samples", "latents", "metadata_bytes"}
SANDBOX = {"isolate_bytes", "isolate_seconds"}
LIMITED = {"texf-enc": {"vertices", "faces", "voxels", "samples", "metadata_bytes", "image_pixels"},
           "texf-dec": STREAMS | SANDBOX, "texf-validate": STREAMS | SANDBOX, "texf-view": STREAMS | SANDBOX | {"image_pixels"},
           "texf-info": STREAMS, "texf-render": {"texels", "image_pixels"}, "texf-eval": {"texels", "image_pixels"}}


@pytest.mark.parametrize("tool", COMMANDS)
def test_every_limit_of_a_tool_is_in_its_help_and_any_other_is_refused(call, tool):
    code, out, _ = call(tool, "--help")
    for name in Limits.__dataclass_fields__:
        shown = f"{name.replace('_', '-')}={getattr(Limits(), name)}"
        assert (shown in out) == (name in LIMITED[tool]), name
    for name in {"bytes", *Limits.__dataclass_fields__} - LIMITED[tool]:
        code, _, err = call(tool, "a.texf", "b", "--limit", f"{name}=5")
        assert code == 1 and f"'{name}' is not a limit; choose" in err, name
    assert code == 1 and "--max-" not in out


def test_version_is_the_packages(call):
    import texfcodec

    assert call("texf-enc", "--version") == (0, f"texf-enc {texfcodec.__version__}\n", "")


# texf-enc


def test_encoder_reports_by_the_schema(call, mesh, tmp_path):
    out_path = tmp_path / "a.texf"
    code, out, err = call("texf-enc", mesh, out_path, *SMALL, "--json", "--measure")
    facts = json.loads(out)
    assert code == 0 and err == "" and out.count("\n") == 1
    assert set(facts) == {"schema", "bytes", "resolution", "qp", "max_error", "voxels", "faces", "vertices", "fields",
                          "effects", "dropped", "remarks", "channels",
                          "refinement", "codec", "seconds", "peak_memory_bytes", "psnr_3d", "psnr_samples", "warnings",
                          "texels_per_voxel_edge", "source", "ratio", "partition", "supports", "texels", "normals", "check",
                          "mesh"}
    assert facts["supports"]["asked"] == "auto" and facts["supports"]["groups"] == [] and facts["texels"] == 0
    assert facts["source"] == {"bytes": mesh.stat().st_size, "files": 1, "names": [str(mesh)]}
    assert set(facts["bytes"]) == {"total", "geometry", "attributes", "other"}
    total = facts["bytes"].pop("total")
    assert total == sum(facts["bytes"].values()) == out_path.stat().st_size
    assert (facts["resolution"], facts["qp"], facts["faces"], facts["schema"]) == (32, 24, 4, 1)
    assert set(facts["psnr_3d"]) == {"y", "yuv611", "rgb"} and facts["psnr_3d"]["y"] > 30
    assert facts["dropped"] == facts["effects"] == []
    assert [text.split(" (")[0] for text in facts["warnings"]] == ["the stream"]  # larger than these few bytes
    for number, channel in enumerate(facts["channels"]):
        assert set(channel) == {"field", "codec", "level_shift", "qp_offset", "encode_ms", "channels", "psnr", "bytes"}
        assert (channel["field"], channel["channels"]) == (number, ["base_colour"]) and channel["bytes"] > 0
    assert sum(channel["bytes"] for channel in facts["channels"]) <= facts["bytes"]["attributes"]
    assert len(facts["channels"]) == facts["fields"]
    assert facts["psnr_samples"] == 1_000_000 and facts["peak_memory_bytes"] > 1 << 20
    assert {"load", "geometry", "voxelise", "transfer", "attributes", "measure", "total"} <= set(facts["seconds"])
    assert facts["remarks"] == ["PLY property 'quality' of vertex is left out"] and list(tmp_path.iterdir()) == [out_path]


def test_encoder_says_what_it_did_and_what_it_left_out(call, mesh, tmp_path):
    code, out, err = call("texf-enc", mesh, tmp_path / "a.texf", *SMALL)
    assert code == 0 and "K 32, QP 24" in out and "attribute bits per voxel" in out
    assert "note: PLY property 'quality' of vertex is left out\n" in err
    assert call("texf-enc", mesh, tmp_path / "a.texf", *SMALL, "--quiet") == (0, "", "")


def test_stream_on_stdout_is_clean_and_the_report_is_on_stderr(mesh, tmp_path):
    run = process("texf-enc", mesh, "-", *SMALL, "--json")
    assert run.returncode == 0
    assert inspect(run.stdout)["faces"] == 4 and json.loads(run.stderr)["bytes"]["total"] == len(run.stdout)


@pytest.mark.parametrize("flags", [
    ("--rate", "r01", "--qp", "3"), ("--rate", "r01", "--resolution", "64"), ("--target-bytes", "9", "--target-psnr", "30"),
    ("--resolution", "64", "--qp", "3", "--target-bytes", "9"),
])  # fmt: skip
def test_conflicting_choices_are_one_sentence_and_exit_1(call, mesh, tmp_path, flags):
    code, out, err = call("texf-enc", mesh, tmp_path / "a.texf", *flags)
    assert code == 1 and out == "" and "cannot be combined" in err and err.count("\n") == 1


@pytest.mark.parametrize("flags", [("--rate", "r09"), ("--qp", "64"), ("--resolution", "0"), ("--nonsense",), ("--qp", "x"),
                                   ("--position-bits", "21"), ("--threads", "-1"), ("--max-voxels", "9"), ("--limit", "voxels"),
                                   ("--limit", "voxels=-1"), ("--limit", f"voxels={10**18}")])  # fmt: skip
def test_wrong_command_line_is_exit_1_and_json_if_asked(call, mesh, tmp_path, flags):
    code, out, err = call("texf-enc", mesh, tmp_path / "a.texf", *flags, "--json")
    error = json.loads(out)["error"]
    assert (code, error["code"], error["exit_code"], err) == (1, "TXF-C01", 1, "")
    assert call("texf-enc", mesh)[0] == 1


def test_dry_run_estimates_and_writes_nothing(call, mesh, tmp_path):
    code, out, _ = call("texf-enc", mesh, tmp_path / "a.texf", "--resolution", "32", "--dry-run", "--json")
    facts = json.loads(out)
    real = encode_to_result(mesh, EncodeOptions(resolution=32))
    assert code == 0 and list(tmp_path.iterdir()) == [] and facts["dry_run"] and facts["bytes"] is None
    assert (facts["faces"], facts["vertices"], facts["materials"]) == (4, 4, 1) and facts["remarks"]
    assert 0.4 < facts["estimated"]["voxels"] / real.counts["voxels"] < 2.5
    code, out, _ = call("texf-enc", mesh, "--dry-run")
    assert code == 0 and "nothing was written" in out and "note: PLY property" in out


def test_strict_refuses_what_would_be_lost_before_writing(call, mesh, tmp_path):
    path = tmp_path / "line.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n")
    for more in ([tmp_path / "a.texf"], ["--dry-run"]):
        code, out, _ = call("texf-enc", path, *more, *SMALL, "--strict", "--json")
        error = json.loads(out)["error"]
        assert (code, error["code"]) == (2, "TXF-I52") and error["dropped"] == ["1 line"]
        assert list(tmp_path.iterdir()) == [path]


def test_strict_passes_what_no_picture_shows(call, mesh, tmp_path):
    code, out, _ = call("texf-enc", mesh, tmp_path / "a.texf", *SMALL, "--strict", "--json")
    assert code == 0 and json.loads(out)["remarks"]


def test_strict_refuses_none_of_the_assets(shared_dir, call):
    for path in sorted((shared_dir / "assets").glob("*.glb")):
        code, out, _ = call("texf-enc", path, "--strict", "--dry-run", "--json")
        facts = json.loads(out)
        assert code == 0 and facts["warnings"] == facts["dropped"] == [], path.name


# Output that cannot be


@pytest.mark.parametrize("target, code", [("missing/a.texf", "TXF-O01"), (".", "TXF-O02")])
def test_hopeless_output_is_refused_before_the_work(call, mesh, tmp_path, monkeypatch, target, code):
    monkeypatch.setattr("texfcodec.io.load.load", lambda *a, **k: pytest.fail("loaded all the same"))
    ended, out, err = call("texf-enc", mesh, tmp_path / target, *SMALL, "--json")
    assert (ended, json.loads(out)["error"]["code"], err) == (2, code, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_full_disk_is_exit_2(call, mesh):
    code, _, err = call("texf-enc", mesh, "/dev/full", *SMALL)
    assert code == 2 and "TXF-O03" in err


def test_failing_rename_leaves_the_old_file_and_no_temporary(call, mesh, tmp_path, monkeypatch):
    target = tmp_path / "a.texf"
    target.write_bytes(b"old")
    for failure, code in ((OSError(28, "No space left on device"), 2), (KeyboardInterrupt(), 130)):
        def fail(*_, failure=failure):
            raise failure

        with monkeypatch.context() as patch:
            patch.setattr("texfcodec.io.output_files.os.replace", fail)
            assert call("texf-enc", mesh, target, *SMALL)[0] == code
        assert target.read_bytes() == b"old" and list(tmp_path.iterdir()) == [target]


def test_progress_callback_cancels_the_api(mesh):
    stages = []

    def watch(stage, done, total):
        stages.append(stage)
        return stage != "voxelise"

    with pytest.raises(Cancelled):
        encode(mesh, EncodeOptions(resolution=32), Report(watch))
    assert stages[-1] == "voxelise" and "load" in stages


def test_progress_bar_shows_on_a_terminal_only(mesh, tmp_path):
    pty = pytest.importorskip("pty")
    main_end, terminal = pty.openpty()
    program = [sys.executable, "-m", "texfcodec.cli.enc", str(mesh), str(tmp_path / "a.texf"), *SMALL]
    run = subprocess.Popen(program, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=terminal, env={**os.environ, "TERM": "xterm"})
    os.close(terminal)
    shown = b""
    while True:
        try:
            part = os.read(main_end, 4096)
        except OSError:
            break
        if not part:
            break
        shown += part
    out, _ = run.communicate(timeout=60)
    os.close(main_end)
    assert run.returncode == 0 and b"voxelise" in shown and b"\x1b" in shown and b"\x1b" not in out


# Internal errors, other exit codes


@pytest.mark.parametrize("error", [ZeroDivisionError, EOFError])  # of the second, click makes the abort of an interrupt
def test_internal_error_is_one_line_and_the_traceback_is_on_request(call, mesh, tmp_path, monkeypatch, error):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("texfcodec.encoder.verify.encode_checked", fail)
    code, out, err = call("texf-enc", mesh, tmp_path / "a.texf", *SMALL)
    lines = [line for line in err.splitlines() if line and "not coded" not in line]
    assert code == 4 and out == "" and len(lines) == 1 and error.__name__ in lines[0] and "TEXF_TRACEBACK" in lines[0]
    monkeypatch.setenv("TEXF_TRACEBACK", "1")
    with pytest.raises(error):
        enc.main([str(mesh), str(tmp_path / "a.texf"), *SMALL])


def test_memory_error_is_exit_6(call, mesh, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise MemoryError

    monkeypatch.setattr("texfcodec.encoder.verify.encode_checked", fail)
    assert call("texf-enc", mesh, tmp_path / "a.texf", *SMALL)[0] == 6


def test_limits_are_exit_6(call, mesh, stream, tmp_path):
    path = tmp_path / "a.texf"
    path.write_bytes(stream)
    assert call("texf-enc", mesh, tmp_path / "b.texf", *SMALL, "--limit", "voxels=5")[0] == 6
    for name in ("file-bytes", "vertices", "faces", "voxels", "samples"):
        for flags in (("--limit", f"{name}=2"), ("--limit", "latents=9", "--limit", f"{name.replace('-', '_')}=2")):
            code, _, err = call("texf-dec", path, tmp_path / "a.ply", *flags)
            assert code == 6 and "TXF-L0" in err, flags
        command = ("texf-info", path, "--verify", "--limit")
        assert call(*command, f"{name}=2")[0] == 6 and call(*command, f"{name}=0")[0] == 0, name
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["texf-dec", "texf-info"])
@pytest.mark.parametrize("what, expected", [
    (None, (2, "TXF-I01")), ("folder", (2, "TXF-I02")), (b"", (3, "TXF-S01")), (b"TexF....", (3, "TXF-S01")),
    (b"glTF....", (2, "TXF-I07")),
    ("prefix", (3, "TXF-S02")), ("tail", (3, "TXF-S08")), ("flip", (3, "TXF-S03")), ("critical", (5, "TXF-U01")),
])  # fmt: skip
def test_bad_stream_is_a_coded_error(call, stream, tmp_path, name, what, expected):
    path = tmp_path / "a.texf"
    first = 8 + 2 + stream[9] + 4  # behind the header unit
    data = {"prefix": stream[:-3], "tail": stream + b"\0", "flip": stream[:12] + bytes([stream[12] ^ 1]) + stream[13:],
            "critical": stream[:first] + write_unit(77, b"") + stream[first:]}.get(what, what)  # fmt: skip
    if what == "folder":
        path.mkdir()
    elif what is not None:
        path.write_bytes(data)
    arguments = (path, tmp_path / "out.ply") if name == "texf-dec" else (path,)
    code, out, err = call(name, *arguments, "--json")
    assert (code, json.loads(out)["error"]["code"]) == expected and err == "" and not (tmp_path / "out.ply").exists()
    code, out, err = call(name, *arguments)
    assert code == expected[0] and out == "" and err.startswith(f"error {expected[1]}: ") and err.count("\n") == 1


# texf-dec


@pytest.mark.parametrize("suffix, flags", [
    ("ply", ("--appearance", "voxels")), ("ply", ()), ("npz", ("--lod", "2")), ("glb", ("--appearance", "vertex")),
    ("glb", ("--texture-size", "64", "--atlas", "fast")), ("obj", ("--appearance", "vertex")),
])  # fmt: skip
def test_decoder_writes_and_reports(call, stream, tmp_path, suffix, flags):
    path, target = tmp_path / "a.texf", tmp_path / f"out.{suffix}"
    path.write_bytes(stream)
    code, out, err = call("texf-dec", path, target, *flags, "--json")
    facts = json.loads(out)
    assert code == 0 and err == "" and target.stat().st_size > 100
    assert set(facts) == {"schema", "bytes", "resolution", "voxels", "texels", "faces", "vertices", "fields", "files", "seconds",
                          "peak_memory_bytes", "warnings", "dropped", "remarks", "seams", "carried"}
    assert (facts["seams"] is None) == ("--texture-size" not in flags)
    assert facts["faces"] == 4 and facts["bytes"]["total"] == len(stream) and facts["files"] == [target.name]
    assert facts["resolution"] == (8 if "--lod" in flags else 32)


def test_decoder_names_the_suffixes_it_knows(call, tmp_path):
    code, _, err = call("texf-dec", "a.texf", tmp_path / "a.stl")
    assert code == 1 and ".glb" in err


def test_decoder_reads_stdin(stream, tmp_path):
    run = process("texf-dec", "-", tmp_path / "a.npz", input=stream)
    assert run.returncode == 0
    with np.load(tmp_path / "a.npz") as file:
        assert len(file["voxel_rgba"]) == inspect(stream)["voxels"]


# texf-info


def test_info_names_every_byte_once(stream):
    facts = inspect(stream)
    rows = [row for unit in facts["units"] for row in unit["elements"]]
    assert rows[0]["offset"] == 8 and rows[-1]["offset"] + rows[-1]["size"] == len(stream)
    assert all(a["offset"] + a["size"] == b["offset"] for a, b in zip(rows[:-1], rows[1:], strict=True))
    assert facts["bytes"]["total"] == len(stream) == sum(facts["bytes"][k] for k in ("geometry", "attributes", "other"))


def test_info_passes_over_unknown_ancillary_units_and_says_so(stream):
    odd = stream[:-6] + write_unit(200, b"x" * 300) + stream[-6:]
    facts = inspect(odd)
    rows = [row for unit in facts["units"] for row in unit["elements"]]
    assert facts["skipped"] == [{"type": 200, "offset": len(stream) - 6, "bytes": 307}]
    assert sum(row["size"] for row in rows) + 8 == len(odd)


def test_info_tells_bytes_by_level(sample_scene):
    from texfcodec.encoder.encode import encode_scene

    made = encode_scene(sample_scene, EncodeOptions(resolution=128, qp=20, partition="off", support="voxels"))
    data, sizes = made.data, made.sizes
    (group,) = inspect(data)["groups"]
    assert group["semantic"] == "base_colour" and len(group["level_bytes"]) == 7 and min(group["level_bytes"]) > 0
    assert abs(sum(group["level_bytes"]) - sum(group["codeword_bytes"])) <= 8  # the coder trims the tail of a codeword
    assert sum(group["codeword_bytes"]) < sizes["attributes"] == group["bytes"]


def test_bytes_by_level_are_told(call):
    code, out, _ = call("texf-info", REPOSITORY / "conformance/uncommon/level_index/in.texf")
    assert code == 0 and "bytes by level, coarse to fine: " in out


def test_info_text_and_verification(call, stream, tmp_path):
    path = tmp_path / "a.texf"
    path.write_bytes(stream)
    code, out, err = call("texf-info", path, "--verify")
    assert code == 0 and err == "" and "sequence_header" in out and "draco_data" in out and out.endswith("verified: OK\n")
    assert json.loads(call("texf-info", path, "--json")[1])["units"][0]["name"] == "sequence_header"


def test_info_verification_finds_what_a_parser_cannot(call, stream, tmp_path):
    from texfcodec.bitstream.stream import read_stream

    parsed = read_stream(stream, Limits())
    parsed.attributes[0]["values_crc"] ^= 1
    path = tmp_path / "a.texf"
    path.write_bytes(write_stream(parsed)[0])
    assert call("texf-info", path)[0] == 0
    code, _, err = call("texf-info", path, "--verify")
    assert code == 3 and "TXF-S32" in err


def test_info_keeps_control_characters_off_the_terminal(call, mesh, tmp_path):
    path = tmp_path / "a\x1b[31m.texf"
    code, _, err = call("texf-info", path)
    assert code == 2 and "\x1b" not in err


def test_info_is_quick_and_knows_no_numba(stream, tmp_path):
    path = tmp_path / "a.texf"
    path.write_bytes(stream)
    program = ("import sys, time\nfrom texfcodec.cli import info\ntry:\n    info.main([sys.argv[1]])\nexcept SystemExit as e:\n"
               "    met = [m for m in ('numba', 'scipy', 'rich', 'PIL') if m in sys.modules]\n"
               "    print(met, time.process_time(), e.code)")
    lines = []
    for _ in range(3):
        command = [sys.executable, "-c", program, str(path)]
        run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
        lines.append(run.stdout.splitlines()[-1])
    assert all(re.fullmatch(r"\[\] [\d.]+ 0", line) for line in lines), lines
    assert min(float(line.split()[1]) for line in lines) < 0.5


# Kernels that are not compiled yet


def test_missing_kernel_cache_is_noticed_without_numba(monkeypatch, tmp_path):
    from texfcodec.core.kernel import PACKAGE, cache_folder
    from texfcodec.sandbox.engines import ENTRIES, kernels_compiled

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with monkeypatch.context() as without:
        without.setenv("NUMBA_DISABLE_JIT", "1")
        assert kernels_compiled()  # nothing will be
    assert not kernels_compiled()
    for name in ENTRIES:
        *_, room, file = name.split("/")
        place = cache_folder(PACKAGE / name) / f"{room}_0123"
        place.mkdir(parents=True, exist_ok=True)
        version = f"{sys.version_info.major}{sys.version_info.minor}"
        (place / f"{file.removesuffix('.py')}._kernel-1.py{version}.nbi").touch()
    assert kernels_compiled()


def test_a_first_run_is_said_and_streams_of_any_kind_take_text(call, monkeypatch, tmp_path):
    monkeypatch.setattr("texfcodec.precompile.kernels_compiled", lambda *_: False)
    stream = REPOSITORY / "conformance/uncommon/one_voxel/in.texf"
    code, _, said = call("texf-dec", "--engine", "numba", stream, tmp_path / "a.ply")
    assert code == 0 and "compil" in said
    assert "compil" not in call("texf-dec", "--isolate", stream, tmp_path / "b.ply")[2]
    with contextlib.redirect_stdout(io.StringIO()) as out, pytest.raises(SystemExit) as ended:
        info.main([str(REPOSITORY / "conformance/uncommon/one_voxel/in.texf")])
    assert ended.value.code == 0 and "437 bytes" in out.getvalue()
