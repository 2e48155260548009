"""tests/load: every part in small hits its targets, and what goes wrong under load is seen."""

import json
import mmap
import sys

import numpy as np
import pytest
from shapes import painted_sphere

from load import many, parts, run
from load.meshes import GENERATORS, glb_of
from load.run import PARTS
from texfcodec.api import decode
from texfcodec.io.load import load as load_mesh
from texfcodec.limits import Limits
from texfcodec.options import DecodeOptions

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory of processes is looked up in /proc")
SMALL = {
    "slope": lambda: parts.run_slopes(60, ["encode and decode"]),
    "together": lambda: parts.run_together(2, ("tiny sphere",), ("subset/k33",)),
    "batch": lambda: many.run_batch(3, 1, 1),
    "refused": lambda: parts.run_refused(paths=sorted(parts.FAULTY.glob("*/in.texf"))[::30]),
    "faces": lambda: parts.run_faces((1000, 3000), ["slivers"], (64, 128), (32, 64)),
    "cluster": lambda: many.run_cluster(2, 20, (2,))}


@pytest.mark.slow
@pytest.mark.parametrize("part", SMALL)
def test_a_small_part_misses_no_target_and_makes_its_section(part):
    if part == "cluster":
        pytest.importorskip("distributed", reason='pip install "texfcodec[cluster]"')
    found = json.loads(json.dumps(SMALL[part]()))
    faults = PARTS[part].faults(found)
    if part == "slope":  # of so few calls it is known to 50 kB
        assert found["encode and decode"]["bytes a call"] < 100_000
    elif part == "faces":  # small meshes are all start
        assert {row["of"] for row in found["rows"]} == {"faces", "texels", "voxels"}
    elif part == "cluster":
        assert not [fault for fault in faults if "a task" not in fault], faults
    else:
        assert faults == []
    assert f"## {PARTS[part].title}\n" in run.page_of({part: found})


def test_a_leak_is_seen():
    """In pages of its own, because what the process has freed before would be taken up again."""
    kept, block = [], b"\1" * 300_000

    def leak(i):
        kept.append(mmap.mmap(-1, len(block)))
        kept[-1].write(block)

    found = parts.slope_of(leak, 60)
    assert 250_000 < found["bytes a call"] < 350_000 and found["error"] < 20_000
    assert PARTS["slope"].faults({"decode": found}) == [f"decode: {found['bytes a call']:,} bytes a call"]


def test_refusing_a_vector_takes_no_more_memory_than_a_process_may_have():
    paths = sorted(parts.FAULTY.glob("*/in.texf"))[::9]
    idle, rows = parts.in_forks(paths)
    assert set(rows) == set(paths) and all(row["code"] in (3, 5, 6) and row["peak"] < run.PEAK for row in rows.values()), rows
    assert 30 << 20 < idle
    alone = parts.by_tool(paths[0])
    assert alone["code"] == rows[paths[0]]["code"] and 30 << 20 < alone["peak"] < run.PEAK


GOOD = {"code": 3, "peak": 1 << 20}
ROW = {"stream": "s", "arrays": {"keys": "k"}}
SOUND = {"exit code": 0, "said": "", "rows": {"a": ROW}}
WRONG = ["process 2, a: another result", "process 3 ended with -11: segfault", "process 3, a: another result"]
LEVEL = {"level": 1, "kind": "faces", "count": 200, "bound": 262144}
FAN = [{"kind": "fan", "of": "faces", "count": n, "encode": {"seconds": 1e-6 * n**1.5}, "save": {"seconds": 1e-3 * n}}
       for n in (1000, 4000, 16000)]


def cluster_row(**changed):
    """A row of a cluster that did all well."""
    return {"workers": 2, "tasks": 10, "seconds": 1.0, "scheduler": 0.1, "client": 0.1, "helpers": 1.0, "twice": 0, "wrong": [],
            "lost": []} | changed


@pytest.mark.parametrize("part, found, faults", [
    ("refused", {"rows": {"a": GOOD, "b": GOOD | {"peak": 300 << 20}}, "tool": {"a": GOOD | {"code": 0}}, "fallen": ["c"]},
     ["b: 300 MB", "a: decoded", "c: its process fell"]),
    ("levels", {"rows": [LEVEL]}, ["the stream for faces of level 1 has 200 of 262,144"]),
    ("levels", {"rows": [LEVEL | {"count": 222720}]}, []),
    ("faces", {"rows": FAN}, ["fan: seconds of encode grow with the power 1.50 of the faces"]),
    ("cluster", {"alone": {"failed": []}, "encodes": [cluster_row()], "naps": [cluster_row()]}, []),
    ("cluster", {"alone": {"failed": ["z"]}, "encodes": [cluster_row(lost=["a"], wrong=["b"])],
                 "naps": [cluster_row(twice=1), cluster_row(workers=8, scheduler=0.5)]},
     ["z was not encoded alone", "encodes, 2 workers, a: lost", "encodes, 2 workers, b: another result",
      "naps, 2 workers: 1 tasks ended twice", "8 workers: client and scheduler take 0.060 s a task"])])
def test_a_missed_target_is_named(part, found, faults):
    assert PARTS[part].faults(found) == faults


def test_a_process_that_answers_something_else_or_falls_is_named():
    bent = SOUND | {"rows": {"a": ROW | {"stream": "t"}}}
    fallen = {"exit code": -11, "said": "segfault", "rows": {}}
    assert list(parts.wrong([SOUND, bent, fallen], {"a": ROW})) == WRONG


def test_what_a_batch_leaves_wrong_is_named(tmp_path):
    day = many.Day(tmp_path / "meshes", tmp_path / "out")
    stream = day.out / "part 0" / "000.texf"
    stream.parent.mkdir(parents=True)
    stream.write_bytes(parts.coded(painted_sphere(3), resolution=8, qp=30))
    rows = [{"asset": "part 0/000.ply", "stream": {}}, *(
        {"asset": name, "error": {"code": code or "TXF-I07", "exit_code": 2}} for name, code in many.CODES.items())]
    (day.out / "results.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n")
    assert list(day.unsound()) == [] and list(day.wrong_lines(["part 0/000.ply"])) == []
    stream.write_bytes(stream.read_bytes()[:-1])
    assert list(day.unsound()) == ["a stream is cut short: 000.texf"]
    with (day.out / "results.jsonl").open("a") as file:
        file.write(json.dumps({"asset": "huge.ply", "stream": {}}) + "\n")
    lines = ["no line, or an error, of part 0/001.glb", "huge.ply has the answer None"]
    assert list(day.wrong_lines(["part 0/001.glb"])) == lines


def test_the_page_is_made_of_the_parts_that_were_measured(tmp_path, capsys):
    row = {"calls": 500, "bytes a call": 30_000, "error": 10, "first": 1 << 20, "last": 2 << 20}
    (tmp_path / "slope.json").write_text(json.dumps({"decode": row}))
    assert run.main(["--page-only", "--out", str(tmp_path), "--page", str(tmp_path / "page.md")]) == 7
    text = (tmp_path / "page.md").read_text()
    assert "| decode | 500 | 30,000 ± 10 | 1.0 | 2.0 |" in text and "- decode: 30,000 bytes a call" in text
    assert "at once" not in text and text == capsys.readouterr().out[:-1]


def test_the_page_computes_a_million_assets_from_the_busier_process_and_the_sample():
    naps = [cluster_row(tasks=1000, scheduler=3.6, client=1.0, seconds=50.0)]
    found = {"alone": {"seconds": 1.0, "processor": 1.0, "failed": []}, "encodes": [cluster_row()], "naps": naps,
             "sample": {"seconds": 36.0, "bytes": 2000}, "load": 0.5}
    page = " ".join(run.page_of({"cluster": found}).split())
    assert "10,000 core hours" in page and "2 GB of streams" in page and "feeds 10,000 cores" in page
    assert "| naps | 2 | 1000 | 50 | 20.0 | 50% | 3.6 | 1.0 | 1.0 |" in page


def test_streams_come_near_a_bound_by_what_they_are_for():
    bounds = Limits(voxels=20_000, samples=200_000)
    small, large = parts.streams_of("samples", bounds)
    made = decode(large, DecodeOptions(limits=bounds))
    assert 0.5 < parts.samples_of(made, made.fields[0].support.size) / bounds.samples <= 1 and len(small) < len(large)
    bounds = Limits(faces=4096)
    assert 0.5 < len(decode(parts.streams_of("faces", bounds)[1], DecodeOptions(limits=bounds)).faces) / bounds.faces <= 1


@pytest.mark.parametrize("kind", GENERATORS)
def test_a_mesh_has_as_many_faces_as_it_was_to_have_and_is_read_as_it_was_made(kind):
    mesh = GENERATORS[kind](3000)
    assert 0.8 * 3000 < len(mesh.faces) <= 3000
    scene = load_mesh(glb_of(mesh))
    np.testing.assert_allclose(scene.positions[scene.faces], mesh.positions[mesh.faces], atol=1e-6)
    assert (scene.corner_color is None) == (mesh.colours is None) and len(scene.textures) == (mesh.image is not None)


def test_naps_through_a_cluster_come_back_once_each_and_a_wrong_stream_is_seen(tmp_path):
    pytest.importorskip("distributed", reason='pip install "texfcodec[cluster]"')
    (tmp_path / "a.ply").write_text("asset")
    tasks = [many.Task(name=f"nap {i}", commands=(), input=tmp_path / "a.ply") for i in range(12)]
    expected = {task.name: (many.DONE, b"x" if task.name == "nap 3" else None) for task in tasks}
    with many.patch.object(many.cluster, "work", many.nap):
        row = many.on_cluster(tasks, 2, tmp_path / "out", expected)
    assert row["wrong"] == ["nap 3"] and row["lost"] == [] and row["twice"] == 0
    assert row["seconds"] > 12 / 2 * many.NAP_SECONDS and 0 < run.overhead_of(row) < 2
