"""The front door: what it takes, what it warns of, and what editors see of it."""

import io
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from interrupts import TETRAHEDRON

import texfcodec
from texfcodec import DecodeOptions, EncodeOptions, InputError, LossWarning, Report, decode, inspect
from texfcodec.precompile import small_scene

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = {"resolution": 16, "qp": 30, "effort": "fast", "threads": 1, "no_check": True}
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
OFF = b"OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n"


@pytest.fixture(scope="module")
def glb():
    texf = texfcodec.decode(texfcodec.encode(TETRAHEDRON.encode(), SMALL))
    held = io.BytesIO()
    texf.save(held, format="glb")
    return held.getvalue()


def lit(scene):
    """The scene with normals that no rule makes again."""
    scene.corner_normal = np.tile(np.array([0.6, 0.0, 0.8], np.float32), (len(scene.faces), 3, 1))
    return scene


def lossy_scene():
    scene = small_scene()
    scene.warnings, scene.dropped, scene.remarks = ["an image is missing"], ["animation 'walk'"], ["two names are alike"]
    return scene


def test_what_is_lost_is_warned_of_and_stands_in_the_result_and_in_the_report():
    report = Report()
    report.warnings.append("of an encode before")
    with pytest.warns(LossWarning) as said:
        made = texfcodec.encode_to_result(lossy_scene(), SMALL, report)
    assert [str(one.message) for one in said][:2] == ["an image is missing", "not coded: animation 'walk'"]
    assert {Path(one.filename) for one in said} == {Path(__file__)} and issubclass(LossWarning, UserWarning)
    assert (made.warnings, made.dropped) == (["an image is missing"], ["animation 'walk'"])
    assert report.warnings == ["of an encode before", *made.warnings] and report.dropped == made.dropped
    assert made.remarks[:1] == ["two names are alike"] and "2 losses" in repr(made) and "1 dropped" in repr(report)
    with pytest.warns(LossWarning, match="animation"):
        assert texfcodec.encode(lossy_scene(), SMALL) == made.data
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "loss" not in repr(texfcodec.encode_to_result(small_scene(), SMALL))


def test_what_a_format_cannot_hold_is_warned_of_and_the_command_lines_print_it(call, tmp_path):
    scene = small_scene()
    scene.metadata = {"name": "sheets"}
    data = texfcodec.encode(scene, SMALL)
    with pytest.warns(LossWarning, match="PLY cannot hold metadata"):
        texfcodec.decode(data).save(tmp_path / "a.ply")
    (tmp_path / "a.texf").write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        code, _, err = call("texf-dec", tmp_path / "a.texf", tmp_path / "b.ply")
        assert code == 0 and "warning: PLY cannot hold metadata" in err
        (tmp_path / "a.obj").write_bytes(b"mtllib gone.mtl\n" + OBJ)
        code, _, err = call("texf-enc", tmp_path / "a.obj", tmp_path / "o.texf", "--resolution", 16, "--qp", 30)
        assert code == 0 and "warning: " in err and "gone.mtl" in err


def test_report_says_what_it_holds():
    report = Report()
    assert repr(report) == "<Report: 0.00 s, 0 warnings, 0 dropped, 0 remarks>"
    report.seconds = {"load": 0.1, "supports": 2.25, "write": 0.01, "attributes": 1.0}
    report.remarks.append("x")
    assert repr(report) == "<Report: 3.36 s (supports 2.25, attributes 1.00, load 0.10, ...), 0 warnings, 0 dropped, 1 remarks>"


@pytest.mark.parametrize("kind", ["glb", "ply", "obj", "off"])
def test_bytes_and_file_objects_are_coded_as_the_file_is(glb, kind, tmp_path):
    data = {"glb": glb, "ply": TETRAHEDRON.encode(), "obj": OBJ, "off": OFF}[kind]
    path = tmp_path / f"a.{kind}"
    path.write_bytes(data)
    wanted = texfcodec.encode(path, SMALL)
    named = io.BytesIO(data)
    named.name = f"somewhere/of.{kind.upper()}"
    with open(path, "rb") as file:
        assert texfcodec.encode(file, SMALL) == texfcodec.encode(named, SMALL) == wanted
    with tempfile.TemporaryFile() as file:  # its name is a number
        file.write(data)
        file.seek(0)
        assert texfcodec.encode(file, SMALL) == wanted
    assert texfcodec.encode(bytearray(data), SMALL) == texfcodec.encode(io.BytesIO(data), SMALL) == wanted


def test_the_first_bytes_tell_the_format():
    from texfcodec.io.magic import suffix_of

    heads = {".stl": b"solid a\nfacet", ".gltf": b"\xef\xbb\xbf \n{}", ".dae": b'<?xml version="1.0"?>\n<COLLADA xmlns="x">',
             ".3mf": b"PK\x03\x04..", ".off": b"COFF\n", ".ply": b"ply\r\n", ".glb": b"glTF\x02", ".obj": b"# made\n\nv 0 0 0"}
    assert {suffix: suffix_of(head) for suffix, head in heads.items()} == {suffix: suffix for suffix in heads}
    assert suffix_of(bytes(80) + (2).to_bytes(4, "little") + bytes(100)) == ".stl"
    assert suffix_of("{}".encode("utf-16")) == ".gltf"
    nothing = (b"", b"very 0 0 0", b"\x89PNG\r\n", b"<html>", b"\xff\xfe{", bytes(84))
    assert [suffix_of(head) for head in nothing] == [None] * 6


def test_files_beside_an_object_with_a_name_are_found(tmp_path):
    (tmp_path / "a.obj").write_bytes(b"mtllib a.mtl\nusemtl c\n" + OBJ)
    (tmp_path / "a.mtl").write_text("newmtl c\nKd 1 0 0\n")
    with open(tmp_path / "a.obj", "rb") as file:
        texf = texfcodec.decode(texfcodec.encode(file, SMALL))
    assert (texf.fields[0].rgba[0] == (255, 0, 0, 255)).all()


def test_objects_that_are_no_files_of_bytes_are_refused_by_a_sentence(tmp_path):
    closed = io.BytesIO(b"x")
    closed.close()
    for given in (None, 3, {"a": 1}, ()):
        for read in (inspect, decode):
            with pytest.raises(InputError, match="TXF-I05"):
                read(given)
    for given, code in ((io.StringIO("v 0 0 0"), "TXF-I03"), (closed, "TXF-I03"), (b"", "TXF-I04"), (3, "TXF-I05"),
                        (io.BytesIO(b"GIF89a"), "TXF-I05")):
        with pytest.raises(InputError) as refused:
            texfcodec.encode(given, SMALL)
        assert refused.value.code == code
        with pytest.raises(texfcodec.TexfError):
            texfcodec.decode(given)
        with pytest.raises(texfcodec.TexfError):
            texfcodec.inspect(given)


def test_a_stream_comes_from_a_file_object_and_goes_into_one(glb, tmp_path):
    data = texfcodec.encode(glb, SMALL)
    texf = texfcodec.decode(io.BytesIO(data), {"lod": 1, "threads": 1})
    assert texf.fields[0].level_shift == 1 and texfcodec.inspect(io.BytesIO(data)) == texfcodec.inspect(data)
    with pytest.raises(texfcodec.LimitError):
        texfcodec.decode(io.BytesIO(data), {"limits": {"file_bytes": 10}})
    for form in ("glb", "ply", "npz"):
        texf.save(tmp_path / f"a.{form}")
        held = io.BytesIO()
        assert texf.save(held, format=form)["files"] == []
        if form == "npz":  # a ZIP archive, which holds the time
            with np.load(tmp_path / "a.npz") as wanted, np.load(io.BytesIO(held.getvalue())) as got:
                assert all((wanted[name] == got[name]).all() for name in wanted.files) and wanted.files == got.files
        else:
            assert held.getvalue() == (tmp_path / f"a.{form}").read_bytes()
    with open(tmp_path / "named.glb", "wb") as file:
        texf.save(file, appearance="vertex")
    assert (tmp_path / "named.glb").read_bytes()[:4] == b"glTF"
    texf.save(held := io.BytesIO(), format=".obj", appearance="vertex")
    assert held.getvalue().startswith(b"#") or b"v " in held.getvalue()
    for file, form in ((io.BytesIO(), None), (io.BytesIO(), "gltf"), (io.BytesIO(), "obj"), (io.BytesIO(), "xyz"),
                       (io.StringIO(), "glb"), (tmp_path / "b.ply", "glb"), (3, "glb")):
        with pytest.raises(InputError) as refused:
            texf.save(file, format=form)
        assert refused.value.code in ("TXF-O04", "TXF-O05") and not (tmp_path / "b.ply").exists()


def test_a_dict_of_options_is_as_good_and_unknown_names_are_refused_with_the_nearest():
    data = texfcodec.encode(small_scene(), EncodeOptions(**SMALL))
    assert texfcodec.encode(small_scene(), SMALL) == data
    for call, given, word in ((texfcodec.encode, {"resolutoin": 16}, "the nearest is 'resolution'"),
                              (texfcodec.encode, {"limits": {"voxel": 3}}, "the nearest is 'voxels'"),
                              (texfcodec.encode, {"zzz": 1}, "rate, "),
                              (texfcodec.encode, "r03", "neither EncodeOptions nor a dict"),
                              (texfcodec.encode, DecodeOptions(), "neither EncodeOptions nor a dict"),
                              (texfcodec.decode, {"threds": 1}, "the nearest is 'threads'"),
                              (texfcodec.encode, {"rate": "r99"}, "unknown rate")):
        with pytest.raises(InputError) as refused:
            call(small_scene() if call is texfcodec.encode else data, given)
        assert refused.value.code == "TXF-I50" and word in str(refused.value)


def test_a_callback_that_says_no_ends_in_cancelled():
    with pytest.raises(texfcodec.Cancelled):
        texfcodec.encode(small_scene(), SMALL, Report(lambda stage, done, total: stage != "geometry"))
    assert texfcodec.Scene is type(small_scene())


def test_long_stages_say_how_far_they_are_and_never_go_back():
    """Stages that last more than two seconds on large assets, on a small one."""
    seen = {}

    def note(stage, done, total):
        assert 0 <= done <= total
        seen.setdefault(stage, []).append(done / total)

    def run(call, given, options, stages):
        seen.clear()
        got = call(given, options, Report(note))
        for stage in stages:
            assert any(0 < share < 1 for share in seen[stage]), (stage, seen[stage])
        assert all(shares == sorted(shares) and shares[-1] == 1 for shares in seen.values()), seen
        return got

    free = {"rate": "r01", "effort": "fast", "threads": 1, "no_check": True}
    run(texfcodec.encode, lit(small_scene()), free, ("supports", "normals", "geometry", "attributes"))
    data = run(texfcodec.encode, lit(small_scene()), SMALL,
               ("normals", "partition", "geometry", "voxelise", "transfer", "attributes"))
    run(texfcodec.decode, data, {"threads": 1, "engine": "numba"}, ("geometry", "voxelise", "attributes"))


PUBLIC = "import io\nimport texfcodec\n" + "".join(f"reveal_type(texfcodec.{name})\n" for name in texfcodec.__all__) + """\
reveal_type(texfcodec.encode(io.BytesIO(), {"rate": "r03"}))
reveal_type(texfcodec.decode(b""))
texfcodec.decode("a.texf").save(io.BytesIO(), format="glb")
texfcodec.nonsense
texfcodec.encode(3)
"""
FACES = """\
from dataclasses import replace
import numpy as np
from texfcodec.encoder.faces import source_faces
from texfcodec.encoder.mesh.candidates import kept
from texfcodec.encoder.place.geometry_units import code_geometry
from texfcodec.encoder.shading.frame_choice import fit_frames
from texfcodec.encoder.stages import Meshed, Shaded
from texfcodec.encoder.values.shown_maps import with_folded_normals

def mixed(meshed: Meshed, shaded: Shaded, price, cache) -> None:
    sent, scene, usual, number = meshed.mesh.value, meshed.prepared.scene, meshed.usual, np.zeros(1)
    with_folded_normals(scene, sent.surface, meshed.plans[0].group.faces)
    with_folded_normals(scene, sent.surface, sent.source_face)  # mixed
    with_folded_normals(scene, sent.source_on_mesh, meshed.plans[0].group.faces)  # mixed
    source_faces(usual, meshed.supports.plans[0].group.faces)
    source_faces(usual, meshed.plans[0].group.faces)  # mixed
    source_faces(usual, sent.source_face)  # mixed
    source_faces(sent.surface)  # mixed
    code_geometry(sent.surface, number, dict(enumerate(meshed.plans)))
    code_geometry(sent.surface, number, dict(enumerate(meshed.supports.plans)))  # mixed
    code_geometry(sent.source_on_mesh, number, {})  # mixed
    fit_frames(scene, sent.surface, shaded.shading, meshed.supports.plans, price, cache)  # mixed
    replace(sent, source_face=meshed.plans[0].group.faces)  # mixed
    kept(scene, sent.surface)  # mixed
"""


@pytest.fixture(scope="module")
def by_mypy(tmp_path_factory, pytestconfig):
    """What mypy writes of the package, set up by pyproject.toml, and of PUBLIC and FACES."""
    folder = tmp_path_factory.mktemp("typed")
    (folder / "public.py").write_text(PUBLIC)
    (folder / "mixed.py").write_text(FACES)
    command = [sys.executable, "-m", "mypy", "--no-color-output", "--cache-dir", str(pytestconfig.cache.mkdir("mypy")),
               "texfcodec", str(folder / "public.py"), str(folder / "mixed.py")]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False).stdout


def test_mypy_finds_nothing_and_sees_every_public_name(by_mypy):
    """What it reveals of each name is no Any; two faults of a program that uses them are found."""
    said = "\n".join(line for line in by_mypy.splitlines() if "mixed.py" not in line)
    revealed = [line.split("Revealed type is ")[1] for line in said.splitlines() if "Revealed type is " in line]
    assert len(revealed) == len(texfcodec.__all__) + 2 and not any(text in ('"Any"', '"object"') for text in revealed), said
    assert "texfcodec.texf.Texf" in revealed[-1] and "bytes" in revealed[-2]
    assert said.count(": error: ") == 2 and 'no attribute "nonsense"' in said and 'incompatible type "int"' in said, said


def test_mypy_refuses_faces_of_the_source_where_those_of_the_sent_mesh_are_due_and_the_reverse(by_mypy):
    refused = [int(number) for number in re.findall(r"mixed\.py:(\d+): error: ", by_mypy)]
    assert refused == [number for number, line in enumerate(FACES.splitlines(), 1) if line.endswith("# mixed")], by_mypy


def test_public_names_are_there_and_what_they_say_has_sections():
    for name in texfcodec.__all__:
        assert getattr(texfcodec, name).__doc__ and name in dir(texfcodec)
    with pytest.raises(AttributeError):
        texfcodec.nonsense  # noqa: B018
    for function, sections in ((texfcodec.encode, "Parameters Returns Raises Warns Notes"),
                               (texfcodec.encode_to_result, "Parameters Returns Raises Warns"),
                               (texfcodec.decode, "Parameters Returns Raises Notes"),
                               (texfcodec.inspect, "Parameters Returns Raises"), (Report, "Parameters Attributes Notes"),
                               (DecodeOptions, "Parameters Raises"), (texfcodec.Texf.save, "Parameters Returns Raises Warns"),
                               (texfcodec.Texf.query, "Parameters Returns Raises Notes"),
                               (texfcodec.Texf.bake, "Parameters Returns")):
        for section in sections.split():
            assert f"{section}\n" in function.__doc__ and "-" * len(section) in function.__doc__
