"""texf-enc --batch: a catalogue becomes streams and a line an asset; it goes on where it was stopped."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from batches import environment, wait_for
from gltf_scenes import spinning, tree_of
from interrupts import TETRAHEDRON

from texfcodec.batch.folders import LOCK, WORK, only_run
from texfcodec.batch.local import run_here
from texfcodec.batch.tasks import Task
from texfcodec.cli.batch import Batch
from texfcodec.cli.catalogue import read_catalogue, words_of
from texfcodec.cli.enc import main
from texfcodec.cli.results import Results
from texfcodec.cli.totals import Totals, losses_in_words
from texfcodec.core import cleanup
from texfcodec.core.json_text import json_ready
from texfcodec.errors import InputError

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = ("--resolution", "16", "--qp", "30", "--effort", "fast")


@pytest.fixture
def call(capsys):
    """A function: texf-enc in this process with these words, as (exit code, lines of stdout as JSON, stderr)."""

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        out, err = capsys.readouterr()
        return ended.value.code, [json.loads(line) for line in out.splitlines()], err

    return run


@pytest.fixture
def catalogue(tmp_path):
    """A folder with two good meshes, a broken one, one that is not there, one of two files, and what is no mesh."""
    folder = tmp_path / "meshes"
    (folder / "deep/er").mkdir(parents=True)
    (folder / "a.ply").write_text(TETRAHEDRON)
    (folder / "deep/er/b.PLY").write_text(TETRAHEDRON)
    (folder / "deep/broken.glb").write_bytes(b"glTF and no more")
    (folder / "deep/c.obj").write_text("mtllib c.mtl\nusemtl c\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    (folder / "deep/c.mtl").write_text("newmtl c\nKd 1 0 0\n")
    (folder / "readme.txt").write_text("no mesh")
    (folder / "gone.stl").symlink_to(folder / "nowhere.stl")
    (folder / "deep/again").symlink_to(folder)
    return folder


def changed(out, before):
    """Names of the streams that are not as they were, and how they are now."""
    now = {path.relative_to(out).as_posix(): path.stat().st_mtime_ns for path in out.rglob("*.texf")}
    return {name for name, stamp in now.items() if before.get(name) != stamp}, now


def test_a_folder_is_coded_and_coded_again_only_where_something_changed(call, catalogue, tmp_path):
    out = tmp_path / "out"
    words = ("--batch", catalogue, "--out", out, "--jobs", "2")
    code, rows, err = call(*words, *SMALL)
    made = {row["asset"]: row for row in rows}
    assert code == 7 and set(made) == {"a.ply", "deep/er/b.PLY", "deep/broken.glb", "deep/c.obj", "gone.stl"}
    assert {name: row["error"]["code"] for name, row in made.items() if "error" in row} == {"deep/broken.glb": "TXF-I07",
                                                                                            "gone.stl": "TXF-I01"}
    new, stamps = changed(out, {})
    assert new == {"a.texf", "deep/er/b.texf", "deep/c.texf"} and "5 assets: 3 encoded" in err and "2 failed" in err
    assert "deep/again is a link to a folder and is skipped" in err and not (out / WORK).exists()
    assert made["a.ply"]["stream"]["bytes"] == (out / "a.texf").stat().st_size == made["a.ply"]["result"]["bytes"]["total"]
    assert set(made["deep/c.obj"]["files"]) == {"c.obj", "c.mtl"} and made["a.ply"]["options"] == list(SMALL)
    assert [json.loads(line)["asset"] for line in (out / "results.jsonl").read_text().splitlines()] == [r["asset"] for r in rows]

    code, rows, err = call(*words, *SMALL)
    assert code == 7 and sum(row.get("passed_over", False) for row in rows) == 3 and len(rows) == 5
    assert changed(out, stamps)[0] == set() and "3 already encoded" in err

    (catalogue / "deep/c.mtl").write_text("newmtl c\nKd 0 1 0\n")  # not the asset's own file
    (out / "a.texf").write_bytes(b"somebody else's")
    for name in ("deep/broken.glb", "gone.stl"):
        (catalogue / name).unlink()
    code, rows, _ = call(*words, *SMALL)
    assert code == 0 and changed(out, stamps)[0] == {"a.texf", "deep/c.texf"} and len(rows) == 3
    (catalogue / "deep/er/b.PLY").unlink()
    code, rows, _ = call(*words, "--resolution", "16", "--qp", "31", "--quiet")
    assert code == 0 and ["passed_over" in row for row in rows] == [False, False]


def test_a_manifest_gives_options_and_names_and_bad_ones_are_told(call, catalogue, tmp_path):
    manifest = tmp_path / "all.toml"
    manifest.write_text('[options]\neffort = "fast"\n[[asset]]\npath = "meshes/a.ply"\nout = "first/{x}.texf"\n[[asset]]\n'
                        'path = "meshes/a.ply"\n[asset.options]\nqp = 99\n')
    assets = read_catalogue(manifest, tmp_path / "out", print)
    assert [(a.out, a.words) for a in assets] == [("first/{x}.texf", ("--effort", "fast")),
                                                  ("meshes/a.texf", ("--effort", "fast", "--qp", "99"))]
    lines = tmp_path / "all.txt"
    lines.write_text(f"\ufeff# of everything\nmeshes/a.ply\n\n{catalogue / 'a.ply'}\n{catalogue / 'deep/c.obj'}\n")
    assets = read_catalogue(lines, tmp_path / "out", print)
    assert [(a.out, a.error and a.error.code) for a in assets] == [("meshes/a.texf", None), ("a.texf", None), ("c.texf", None)]
    for text in ("[options]\ndry-run = true\n[[asset]]\npath = 'a'\n", "[[asset]]\npath = '/'\n", "[[asset]]\n",
                 "[[asset]]\npath = 3\n", "x = 1\n", '[[asset]]\npath = "a"\nout = "../a.texf"\n', "[[asset",
                 '[[asset]]\npath = "a"\nrate = 1\n', '[[asset]]\npath = "a"\noptions = {a = [1]}\n', "", "asset = 3\n"):
        manifest.write_text(text)
        with pytest.raises(InputError) as refused:
            read_catalogue(manifest, tmp_path / "out", print)
        assert refused.value.code == "TXF-I57"
    for name, text in (("all.txt", "/\n"), ("all.txt", "\udcff"), ("all.obj", "v 0 0 0\n")):
        (tmp_path / name).write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(InputError) as refused:
            read_catalogue(tmp_path / name, tmp_path / "out", print)
        assert refused.value.code == "TXF-I57"
    assert words_of({"qp": 3, "measure": True, "strict": False}) == ("--qp", "3", "--measure")
    assert words_of({"limit": ["faces=3", "voxels=4"]}) == ("--limit", "faces=3", "--limit", "voxels=4")
    (tmp_path / "empty").mkdir()
    assert call("--batch", tmp_path / "empty", "--out", tmp_path / "out")[0] == 2
    assert call("--batch", tmp_path / "nowhere", "--out", tmp_path / "out")[0] == 2


def test_an_asset_may_become_two_streams_and_names_are_taken_as_they_are(call, tmp_path):
    (tmp_path / "a {x}[b].ply").write_text(TETRAHEDRON)
    (tmp_path / "all.toml").write_text('[options]\nresolution = 16\n' + "".join(
        f'[[asset]]\npath = "a {{x}}[b].ply"\nout = "é/{{q}} {qp}.texf"\noptions = {{qp = {qp}}}\n' for qp in (30, 40)))
    for is_old in (False, True):
        code, rows, _ = call("--batch", tmp_path / "all.toml", "--out", tmp_path / "out", "--effort", "fast", "--jobs", "2")
        assert code == 0 and sorted(row["out"] for row in rows) == ["é/{q} 30.texf", "é/{q} 40.texf"]
        assert all((tmp_path / "out" / row["out"]).stat().st_size == row["stream"]["bytes"] for row in rows)
        assert [row.get("passed_over", False) for row in rows] == [is_old] * 2


def test_an_asset_stays_coded_where_nobody_reads_its_line(call, tmp_path, monkeypatch):
    (tmp_path / "a.ply").write_text(TETRAHEDRON)
    (tmp_path / "all.txt").write_text("a.ply\n")

    def closed(*_):
        raise BrokenPipeError

    monkeypatch.setattr(Batch, "_tell", closed)
    code, _, err = call("--batch", tmp_path / "all.txt", "--out", tmp_path / "out", *SMALL)
    rows = [json.loads(line) for line in (tmp_path / "out/results.jsonl").read_text().splitlines()]
    assert code == 2 and [row.get("error") for row in rows] == [None] and (tmp_path / "out/a.texf").exists()


def names_of(folder, out, suffix=".texf"):
    """{asset: name of its stream, or its error's code} of a folder's catalogue."""
    assets = read_catalogue(folder, out, print, None, suffix)
    return {asset.name: asset.error.code if asset.error else asset.out for asset in assets}


def filled(folder, *names):
    """The folder with a file, empty, of each name."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


def test_assets_of_one_stem_get_their_whole_names_and_no_other_does(tmp_path):
    folder = filled(tmp_path / "meshes", "chair.glb", "chair.stl", "CHAIR.obj", "deep/chair.glb", "a.b.glb", "a.ply", "b.c.ply",
                    "b.c.glb.ply", "b.c.glb")
    assert names_of(folder, tmp_path / "out") == {
        "chair.glb": "chair.glb.texf", "chair.stl": "chair.stl.texf", "CHAIR.obj": "CHAIR.obj.texf",
        "deep/chair.glb": "deep/chair.texf", "a.b.glb": "a.b.texf", "a.ply": "a.texf", "b.c.ply": "b.c.ply.texf",
        "b.c.glb.ply": "b.c.glb.ply.texf", "b.c.glb": "b.c.glb.texf"}


@pytest.mark.parametrize("pair", [("chair.glb", "Chair.GLB"), ("stra\u00dfe.ply", "STRASSE.ply"), ("\u00e9.off", "e\u0301.off")])
def test_names_that_a_file_system_may_not_tell_apart_are_marked(tmp_path, pair):
    folder = filled(tmp_path / "meshes", *pair)
    if len(list(folder.iterdir())) < 2:
        pytest.skip("this file system does not tell them apart")
    found = names_of(folder, tmp_path / "out")
    assert len({name.casefold() for name in found.values()}) == 2
    assert all(re.fullmatch(re.escape(name) + r"~[0-9a-f]{6}\.texf", found[name]) for name in pair)


def test_a_name_once_given_stays_whatever_is_added_later(call, tmp_path):
    folder, out = tmp_path / "meshes", tmp_path / "out"
    folder.mkdir()
    (folder / "chair.ply").write_text(TETRAHEDRON)
    words = ("--batch", folder, "--out", out, *SMALL)
    assert call(*words)[1][0]["out"] == "chair.texf"
    (folder / "chair.off").write_text("OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")
    code, rows, _ = call(*words)
    assert code == 0 and {row["asset"]: row["out"] for row in rows} == {"chair.ply": "chair.texf", "chair.off": "chair.off.texf"}
    assert [row["asset"] for row in rows if row.get("passed_over")] == ["chair.ply"]
    code, rows, err = call(*words)
    assert code == 0 and all(row["passed_over"] for row in rows) and "2 already encoded" in err
    (folder / "chair.ply").unlink()
    assert names_of(folder, out) == {"chair.off": "chair.off.texf"}


def test_a_scene_stays_one_where_the_suffix_says_so(call, tmp_path):
    """A mesh of another format beside it becomes a stream; the same command again does nothing; names are those of streams."""
    folder, out = tmp_path / "meshes", tmp_path / "out"
    folder.mkdir()
    (folder / "fan.glb").write_bytes(spinning().glb())
    (folder / "a.ply").write_text(TETRAHEDRON)
    words = ("--batch", folder, "--out", out, "--suffix", ".glb", *SMALL)
    for is_old in (False, True):
        code, rows, err = call(*words)
        assert code == 0 and {row["asset"]: row["out"] for row in rows} == {"a.ply": "a.texf", "fan.glb": "fan.glb"}
        assert [row.get("passed_over", False) for row in rows] == [is_old] * 2 and re.search(r"worst \d.*fan.glb", err)
    assert "animations" in tree_of((out / "fan.glb").read_bytes())
    filled(folder, "fan.gltf")
    assert names_of(folder, out, ".glb") == names_of(folder, out, ".glb") == {"a.ply": "a.texf", "fan.glb": "fan.glb",
                                                                             "fan.gltf": "fan.gltf.glb"}


def test_no_scene_of_a_batch_is_written_over_its_source(tmp_path):
    folder = filled(tmp_path / "meshes", "a.glb", "b.gltf")
    assert names_of(folder, folder, ".glb") == {"a.glb": "TXF-O07", "b.gltf": "b.glb"}
    manifest = tmp_path / "all.toml"
    manifest.write_text('[[asset]]\npath = "meshes/a.glb"\n[[asset]]\npath = "meshes/b.gltf"\nout = "meshes/a.glb"\n')
    assert names_of(manifest, tmp_path) == {"meshes/a.glb": "meshes/a.texf", "meshes/b.gltf": "TXF-O07"}


def test_a_manifest_keeps_its_names_and_the_same_asset_twice_is_refused(tmp_path):
    manifest = tmp_path / "all.toml"
    manifest.write_text('[[asset]]\npath = "chair.glb"\nout = "chair.texf"\n[[asset]]\npath = "chair.stl"\n')
    assert names_of(manifest, tmp_path) == {"chair.glb": "chair.texf", "chair.stl": "chair.stl.texf"}
    manifest.write_text('[[asset]]\npath = "a.glb"\nout = "x.texf"\n[[asset]]\npath = "b.stl"\nout = "X.texf"\n')
    assert names_of(manifest, tmp_path) == {"a.glb": "TXF-O16", "b.stl": "TXF-O16"}
    (tmp_path / "all.txt").write_text("one/chair.glb\none/chair.glb\n/far/chair.glb\n/away/chair.glb\n")
    assets = read_catalogue(tmp_path / "all.txt", tmp_path, print)
    assert [asset.error and asset.error.code for asset in assets] == ["TXF-O16", "TXF-O16", None, None]
    assert len({asset.out for asset in assets[2:]}) == 2


def test_what_is_no_asset_is_counted_by_suffix_in_a_line_and_in_the_totals(call, tmp_path):
    folder = filled(tmp_path / "meshes", "._a.ply", ".DS_Store", "Thumbs.db", "__MACOSX/a.ply", "figure.vrm", "deep/b.FBX",
                    "c.fbx", "d.blend", "skin.png", "a.mtl", "README")
    (folder / "a.ply").write_text(TETRAHEDRON)
    code, rows, err = call("--batch", folder, "--out", tmp_path / "out", *SMALL, "--json")
    assert code == 0 and [row["asset"] for row in rows[:-1]] == ["a.ply"]
    assert rows[-1]["totals"]["skipped"] == {".fbx": 2, ".vrm": 1, ".blend": 1, "files of the operating system": 4,
                                                 "files without suffix": 1}
    (line,) = [line for line in err.splitlines() if "are skipped" in line]
    assert line == ("9 files are skipped: 4 files of the operating system (such as __MACOSX/), 2 .fbx (such as c.fbx), "
                    "1 .blend (d.blend), 1 .vrm (figure.vrm), 1 file without suffix (README)")


def test_flags_that_have_no_part_in_a_batch_are_refused(call, catalogue, tmp_path, capsys):
    for words in (("--batch", catalogue), ("--out", tmp_path), ("a.glb", "a.texf", "--jobs", "2"), ("--batch", catalogue, "--out",
                  tmp_path / "out", "a.glb"), ("--batch", catalogue, "--out", tmp_path / "out", "--dry-run"),
                  ("--batch", catalogue, "--out", tmp_path / "out", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), ()):
        code, rows, err = call(*words)
        assert code == 1 and not rows and "TXF-C01" in err
    assert not (tmp_path / "out").exists()


def test_time_and_memory_limits_fail_an_asset_with_a_sentence(call, catalogue, tmp_path):
    (tmp_path / "one.txt").write_text("meshes/a.ply\n")
    words = ("--batch", tmp_path / "one.txt", "--out", tmp_path / "out", *SMALL)
    code, (row,), err = call(*words, "--limit-seconds", "0.2")
    assert (code, row["error"]["code"], row["error"]["allowed"]) == (7, "TXF-L12", 0.2) and "TXF-L12" in err
    code, (row,), _ = call(*words, "--memory-limit", 20 << 20)
    assert code == 7 and row["error"]["code"] in ("TXF-L09", "TXF-C04", "TXF-C07") and not list((tmp_path / "out").glob("*.texf"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked up in /proc")
def test_an_interrupt_keeps_what_is_finished_and_leaves_nothing_half(call, tmp_path):
    folder, out = tmp_path / "meshes", tmp_path / "out"
    folder.mkdir()
    for name in "ab":
        (folder / f"{name}.ply").write_text(TETRAHEDRON)
    words = ["--batch", folder, "--out", out, *SMALL]
    run = subprocess.Popen([sys.executable, "-m", "texfcodec.cli.enc", *words], cwd=REPOSITORY, env=environment(), text=True,
                           stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                           preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    first = json.loads(run.stdout.readline())
    wait_for(lambda: encoders_in(out))
    code, rows, err = call(*words)
    assert code == 2 and not rows and "TXF-O17" in err
    run.send_signal(signal.SIGINT)
    said = run.communicate(timeout=60)[1]
    assert run.returncode == 130 and "finished work is kept" in said
    wait_for(lambda: not encoders_in(out))
    done = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]
    assert done[0] == first and {path.name for path in out.iterdir()} <= {LOCK, "results.jsonl", *(row["out"] for row in done)}
    code, rows, _ = call(*words)
    assert code == 0 and len(rows) == 2 and sum("passed_over" in row for row in rows) == len(done)


def encoders_in(out):
    """Processes that code into the working folder of a batch."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            found += [path.parent.name] if os.fsencode(out / WORK) in path.read_bytes() else []
        except OSError:
            continue
    return found


def test_children_that_the_answer_to_ctrl_c_ends_have_no_outcome(tmp_path):
    """They had: no answer of theirs was found, and results.jsonl got a line with TXF-C07."""
    tasks = [Task(name=str(i), commands=(("wait", ("-m", "timeit", "-n", "1", "import time; time.sleep(60)")),), input=tmp_path)
             for i in range(2)]
    outcomes, held = [], []

    def interrupt():
        wait_for(lambda: len(cleanup._children) == 2)
        held.append(cleanup.GATE.acquire())
        cleanup.remove_all()  # as interrupts.py does, which ends the process next

    answering = threading.Thread(target=interrupt)
    answering.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            run_here(tasks, 2, tmp_path, lambda task, outcome, folder: outcomes.append(outcome))
    finally:
        answering.join()
        if held:
            cleanup.GATE.release()
        cleanup.begin()
    assert outcomes == []


def test_a_batch_ends_with_totals_and_a_line_names_its_losses(call, tmp_path):
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / "whole.ply").write_text(TETRAHEDRON)
    (folder / "gone.obj").write_text("mtllib gone.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "broken.off").write_text("OFF\nand no more\n")
    for again in (False, True):
        code, rows, err = call("--batch", folder, "--out", tmp_path / "out", *SMALL, "--json")
        *rows, last = rows
        made, totals = {row["asset"]: row for row in rows}, last["totals"]
        assert code == 7 and totals["assets"] == 2 and totals["failed"] == 1 and totals["assets_with_warnings"] == 1
        assert totals["source_bytes"] == sum((folder / name).stat().st_size for name in ("whole.ply", "gone.obj"))
        assert totals["stream_bytes"] == sum((tmp_path / "out" / name).stat().st_size for name in ("whole.texf", "gone.texf"))
        assert "gone.mtl" in made["gone.obj"]["result"]["warnings"][0]
        assert totals["psnr"]["rgb"]["assets"] == 2 and totals["psnr"]["y"]["worst_asset"] in ("whole.ply", "gone.obj")
        assert "with warnings, 1 asset with losses" in err and "PSNR RGB: median" in err
        assert again or ("bytes, " in err and "warning" in err and "gone.mtl" in err)
    lines = (tmp_path / "out/results.jsonl").read_text().splitlines()
    assert not any("totals" in json.loads(line) for line in lines)


def test_totals_are_of_what_was_measured():
    totals, row = Totals(), {"asset": "a", "stream": {"bytes": 10}}
    totals.add(row | {"result": {"source": {"bytes": 30}, "check": {"y": 30.0, "rgb": None}, "dropped": ["a tail"]}})
    totals.add(row | {"asset": "b", "result": {"source": {"bytes": 70}, "check": {"y": 40.0, "rgb": 50.0},
                                           "warnings": ["x", "y"]}})
    totals.add(row | {"asset": "c", "result": {"source": {"bytes": 50}, "check": {"y": None, "rgb": None, "visible": False}}})
    totals.add(row | {"asset": "d", "result": {"source": {"bytes": 50}, "check": None}})
    totals.add({"asset": "e", "error": {}})
    read = "; of what was read, without the losses"
    assert list(totals.lines()) == ["200 bytes became 40, 5 times smaller", f"PSNR Y: median 35.00 dB, worst 30.00 dB (a){read}",
                                    f"PSNR RGB: median as read, worst 50.00 dB (b){read}",
                                    "1 asset with warnings, 1 asset with losses"]
    assert json_ready(totals.facts())["psnr"]["rgb"] == {"median": None, "worst": 50.0, "worst_asset": "b", "assets": 2}
    lossy = {"dropped": ["a tail", "a head"], "warnings": ["dark"]}
    assert losses_in_words(lossy) == "; 2 losses, the first: a tail; 1 warning: dark" and losses_in_words({}) == ""
    assert list(Totals().lines()) == []


def test_results_survive_a_line_that_was_cut_short(tmp_path):
    (tmp_path / "results.jsonl").write_text('{"out": "a", "n": 1}\n{"out": "b"')
    results = Results(tmp_path)
    results.append({"out": "c"})
    assert set(Results(tmp_path).lines) == {"a", "c"}


def test_two_runs_on_one_folder_are_refused_in_one_process_too(tmp_path):
    pytest.importorskip("fcntl")
    with only_run(tmp_path), pytest.raises(InputError, match="TXF-O17|another run"):
        with only_run(tmp_path):
            pytest.fail("two at once")
