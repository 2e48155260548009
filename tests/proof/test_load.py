"""tools/proof/load.py: memory over many calls and of refused files, and that what goes wrong under load is seen."""

import json
import mmap
import sys

import numpy as np
import pytest
from shapes import painted_sphere

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.load import load as load_mesh
from texfcodec.limits import Limits
from texfcodec.options import DecodeOptions, EncodeOptions
from tools.proof import load, load_batch, load_cluster, load_faces, load_levels, load_together
from tools.proof.face_meshes import GENERATORS, glb_of
from tools.proof.load_refused import FAULTY, TARGET, by_tool, in_forks, refused_faults
from tools.proof.load_slope import measured, slope_of

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory of processes is looked up in /proc")


@pytest.mark.slow
def test_memory_does_not_grow_over_60_encodes_and_decodes():
    found = measured("encode and decode", 60)
    assert found["calls"] == 60 and found["bytes a call"] < 100_000, found  # of so few calls the slope is known to 50 kB


def test_a_leak_is_seen():
    """In pages of its own, because what the process has freed before would be taken up again."""
    kept, block = [], b"\1" * 300_000

    def leak(i):
        kept.append(mmap.mmap(-1, len(block)))
        kept[-1].write(block)

    found = slope_of(leak, 60)
    assert 250_000 < found["bytes a call"] < 350_000 and found["error"] < 20_000
    assert load.PARTS["slope"]({"decode": found}) == [f"decode: {found['bytes a call']:,} bytes a call"]


def test_refusing_a_vector_takes_no_more_memory_than_a_process_may_have():
    paths = [path for path in sorted(FAULTY.glob("*/in.texf"))[::9]]
    idle, rows = in_forks(paths)
    assert set(rows) == set(paths) and all(row["code"] in (3, 5, 6) and row["peak"] < TARGET for row in rows.values()), rows
    assert 30 << 20 < idle < TARGET
    alone = by_tool(paths[0])
    assert alone["code"] == rows[paths[0]]["code"] and 30 << 20 < alone["peak"] < TARGET


def test_a_vector_that_is_decoded_or_takes_too_much_is_told():
    good = {"code": 3, "peak": 1 << 20}
    found = {"rows": {"a": good, "b": good | {"peak": 300 << 20}}, "tool": {"a": good | {"code": 0}}, "fallen": ["c"]}
    assert refused_faults(found) == ["b: 300 MB", "a: decoded", "c: its process fell"]


def test_a_process_that_answers_something_else_or_falls_is_told():
    row = {"stream": "s", "arrays": {"keys": "k"}}
    sound = {"exit code": 0, "said": "", "rows": {"a": row}}
    bent = {"exit code": 0, "said": "", "rows": {"a": row | {"stream": "t"}}}
    fallen = {"exit code": -11, "said": "segfault", "rows": {}}
    assert list(load_together.wrong([sound], {"a": row})) == []
    assert list(load_together.wrong([sound, bent, fallen], {"a": row})) == [
        "process 2, a: another result", "process 3 ended with -11: segfault", "process 3, a: another result"]


@pytest.fixture
def day(tmp_path):
    """A load_batch.Day of which one good asset is done, and the bad ones are told."""
    load_batch.write_catalogue(tmp_path / "meshes", 2)
    made = load_batch.Day(tmp_path / "meshes", tmp_path / "out")
    place = tmp_path / "out" / "part 0"
    place.mkdir(parents=True)
    (place / "000.texf").write_bytes(encode_scene(painted_sphere(3), EncodeOptions(resolution=8, qp=30, threads=1)).data)
    rows = [{"asset": "part 0/000.ply", "stream": {}}]
    rows += [{"asset": name, "error": {"code": code or "TXF-I07", "exit_code": 2}} for name, code in load_batch.CODES.items()]
    (tmp_path / "out" / "results.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n")
    return made


def test_what_a_batch_leaves_wrong_is_told(day):
    assert list(load_batch.unsound(day.out)) == [] and list(load_batch.wrong_lines(day, ["part 0/000.ply"])) == []
    stream = day.out / "part 0" / "000.texf"
    stream.write_bytes(stream.read_bytes()[:-1])
    assert list(load_batch.unsound(day.out)) == ["000.texf"]
    with (day.out / "results.jsonl").open("a") as file:
        file.write(json.dumps({"asset": "huge.ply", "stream": {}}) + "\n")
    assert list(load_batch.wrong_lines(day, ["part 0/001.glb"])) == ["no line, or an error, of part 0/001.glb",
                                                                     "huge.ply has the answer None"]


def test_the_page_is_made_of_the_parts_that_were_measured(tmp_path, capsys):
    row = {"calls": 500, "bytes a call": 30_000, "error": 10, "first": 1 << 20, "last": 2 << 20}
    (tmp_path / "slope.json").write_text(json.dumps({"decode": row}))
    assert load.main(["--page-only", "--out", str(tmp_path), "--page", str(tmp_path / "page.md")]) == 7
    text = (tmp_path / "page.md").read_text()
    assert "| decode | 500 | 30,000 ± 10 | 1.0 | 2.0 |" in text and "- decode: 30,000 bytes a call" in text
    assert "at once" not in text and text == capsys.readouterr().out[:-1]


def test_a_stream_that_is_not_near_its_bound_is_told():
    row = {"level": 1, "kind": "faces", "count": 200, "bound": 262144}
    assert load_levels.levels_faults({"rows": [row]}) == ["the stream for faces of level 1 has 200 of 262,144"]
    assert load_levels.levels_faults({"rows": [row | {"count": 222720}]}) == []


def test_streams_come_near_a_bound_by_what_they_are_for():
    bounds = Limits(voxels=20_000, samples=200_000)
    small, large = load_levels.streams_of("samples", bounds)
    made = decode(large, DecodeOptions(limits=bounds))
    assert 0.5 < load_levels.samples_of(made, made.fields[0].support.size) / bounds.samples <= 1 and len(small) < len(large)
    bounds = Limits(faces=4096)
    assert 0.5 < len(decode(load_levels.streams_of("faces", bounds)[1], DecodeOptions(limits=bounds)).faces) / bounds.faces <= 1


@pytest.mark.parametrize("kind", GENERATORS)
def test_a_mesh_has_as_many_faces_as_it_was_to_have_and_is_read_as_it_was_made(kind):
    mesh = GENERATORS[kind](3000)
    assert 0.8 * 3000 < len(mesh.faces) <= 3000
    scene = load_mesh(glb_of(mesh))
    np.testing.assert_allclose(scene.positions[scene.faces], mesh.positions[mesh.faces], atol=1e-6)
    assert (scene.corner_color is None) == (mesh.colours is None) and len(scene.textures) == (mesh.image is not None)


def test_what_grows_faster_than_the_faces_is_told():
    rows = [{"kind": "fan", "of": "faces", "count": n, "encode": {"seconds": 1e-6 * n**1.5}, "save": {"seconds": 1e-3 * n}}
            for n in (1000, 4000, 16000)]
    assert load_faces.slopes({"rows": rows})["fan"] == pytest.approx({"encode": 1.5, "save": 1.0})
    assert load_faces.faces_faults({"rows": rows}) == ["fan: seconds of encode grow with the power 1.50 of the faces"]
def cluster_row(**changed):
    """A row of a cluster that did all well."""
    return {"workers": 2, "tasks": 10, "seconds": 1.0, "scheduler": 0.1, "client": 0.1, "helpers": 1.0, "twice": 0, "wrong": [],
            "lost": []} | changed


def test_what_a_cluster_loses_changes_or_takes_too_long_for_is_told():
    alone = {"seconds": 1.0, "processor": 1.0, "failed": []}
    sound = {"alone": alone, "encodes": [cluster_row()], "naps": [cluster_row()]}
    assert load_cluster.cluster_faults(sound) == []
    bent = {"alone": alone | {"failed": ["z"]}, "encodes": [cluster_row(lost=["a"], wrong=["b"])],
            "naps": [cluster_row(twice=1), cluster_row(workers=8, scheduler=0.5)]}
    assert load_cluster.cluster_faults(bent) == [
        "z was not encoded alone", "encodes, 2 workers, a: lost", "encodes, 2 workers, b: another result",
        "naps, 2 workers: 1 tasks ended twice", "8 workers: client and scheduler take 0.060 s a task"]


def test_the_page_computes_a_million_assets_from_the_busier_process_and_the_sample():
    naps = [cluster_row(tasks=1000, scheduler=3.6, client=1.0, seconds=50.0)]
    found = {"alone": {"seconds": 1.0, "processor": 1.0, "failed": []}, "encodes": [cluster_row()], "naps": naps,
             "sample": {"seconds": 36.0, "bytes": 2000}, "load": 0.5}
    page = " ".join(load.page_of({"cluster": found}, {"cluster": []}).split())
    assert "36 s of the processor each" in page and "10,000 core hours" in page and "2 GB of streams" in page
    assert "3.6 ms a task, 0.0 days" in page and "feeds 10,000 cores" in page
    assert "| naps | 2 | 1000 | 50 | 20.0 | 50% | 3.6 | 1.0 | 1.0 |" in page


def test_naps_through_a_cluster_come_back_once_each_and_a_wrong_stream_is_seen(tmp_path):
    pytest.importorskip("distributed", reason='pip install "texfcodec[cluster]"')
    (tmp_path / "a.ply").write_text("asset")
    tasks = [load_cluster.Task(name=f"nap {i}", commands=(), input=tmp_path / "a.ply") for i in range(12)]
    expected = {task.name: (load_cluster.DONE, b"x" if task.name == "nap 3" else None) for task in tasks}
    with load_cluster.patch.object(load_cluster.cluster, "work", load_cluster.nap):
        row = load_cluster.on_cluster(tasks, 2, tmp_path / "out", expected)
    assert row["wrong"] == ["nap 3"] and row["lost"] == [] and row["twice"] == 0
    assert row["seconds"] > 12 / 2 * load_cluster.NAP_SECONDS and 0 < load_cluster.overhead_of(row) < 2
