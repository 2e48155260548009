"""public_models of tools/proof: the list, what it fetches, a model that falls short is seen; a sample, if there is one."""

import copy
import io
import re
import shutil
import tarfile
from argparse import Namespace
from pathlib import Path, PurePosixPath

import numpy as np
import pytest
from browser import BROWSER
from mesh_files import SQUARE_UV, Builder, encoded
from PIL import Image
from shapes import scene_of, square

from texfcodec.batch.children import Children
from texfcodec.io.formats import SUFFIXES
from texfcodec.scene.scene import ALPHA_BLEND, Material
from tools.proof.public_models import fetch as fetching
from tools.proof.public_models.fetch import Unfetched, archive_of, fetch, unpack
from tools.proof.public_models.judge import (
    INTERNAL,
    INVALID,
    LARGE_MESH,
    LARGER,
    NOT_JSON,
    PICTURE,
    POOR,
    TOO_LONG,
    UNNAMED,
    UNSAID,
    changed,
    findings_of,
    least_picture,
    losses_of,
    summary,
)
from tools.proof.public_models.kinds import ERROR, FAULT, FORMATS, NAMED, OK, UNSHOWN, judged, write_kind
from tools.proof.public_models.listing import PublicModel, add_package, entries_of, read_list, write_list
from tools.proof.public_models.measure import compare
from tools.proof.public_models.page import page_of
from tools.proof.public_models.pictures import draw
from tools.proof.public_models.rows import add_row, read_rows, strict_json
from tools.proof.public_models.run import RATE, Inside, Room, code_model, node_modules

CACHE = Path(__file__).resolve().parents[2] / "out" / "public_models"
SAMPLE = {"npm": ("assimpjs", "mind-ar"), "pypi": ("jvrc-description", "compas")}  # small packages with small models


def entry_of(cache, data, path="model.glb"):
    """A PublicModel of bytes, as a package "made" that has been fetched."""
    package = {"kind": "npm", "name": "made", "version": "1"}
    entry = PublicModel(f"made/{path}", package, {"path": path, "sha256": "0" * 64, "bytes": len(data)})
    entry.path(cache).parent.mkdir(parents=True, exist_ok=True)
    entry.path(cache).write_bytes(data)
    return entry


def row_of(cache, data, room_in=Inside, modules=None):
    """The row of a model of bytes."""
    return code_model(entry_of(cache, data), Namespace(cache=cache, rate=RATE), modules, cache / "coded", room_in)


def rich_model():
    """A textured square in a glTF file that holds what a stream does not."""
    builder = Builder()
    texture = builder.texture(encoded(np.random.default_rng(0).integers(0, 256, (8, 8, 3))), magFilter=9728)
    builder.primitive(uv=SQUARE_UV, material=builder.material(texture), attributes={"TEXCOORD_1": builder.accessor(SQUARE_UV)})
    tree, times = builder.tree, builder.accessor(np.array([0, 1], np.float32))
    moves = builder.accessor(np.zeros((2, 3), np.float32))
    tree["animations"] = [{"channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
                           "samplers": [{"input": times, "output": moves}]}]
    tree["nodes"] += [{"camera": 0, "name": "eye", "mesh": 0}]
    tree["scenes"][0]["nodes"] += [1]
    tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    tree["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "red"}]}, "ACME_weather": {"rain": True}}
    return builder.glb()


@pytest.fixture(scope="module")
def row(tmp_path_factory):
    """The row of rich_model(); treat it as read-only."""
    return row_of(tmp_path_factory.mktemp("cache"), rich_model())


def altered(row, **changes):
    """A copy of a row with {"step.key": value} changed and its findings anew, {kind: sentence}. Dots descend."""
    row = copy.deepcopy(row)
    for path, value in changes.items():
        *way, last = path.split("__")
        place = row
        for key in way:
            place = place[key]
        place[last] = value
    return dict(findings_of(row))


# The list


def test_the_list_names_three_hundred_models_by_hash_in_every_format(tmp_path):
    packages = read_list()
    entries = entries_of(packages)
    assert len(entries) >= 300 and len({entry.name for entry in entries}) == len(entries)
    assert {entry.suffix for entry in entries} == set(SUFFIXES) - {".npz", ".vxz"}  # no package has values of generators
    files = [item for entry in entries for item in ((entry.model["path"], entry.model["sha256"]),
                                                    *entry.model.get("with", {}).items())]
    assert all(re.fullmatch("[0-9a-f]{64}", digest) for _, digest in files)
    assert not any(PurePosixPath(path).is_absolute() or ".." in PurePosixPath(path).parts for path, _ in files)
    assert {package["kind"] for package in packages} == {"npm", "pypi", "debian"}
    write_list(packages, tmp_path / "again.json")
    assert read_list(tmp_path / "again.json") == sorted(packages, key=lambda package: (package["kind"], package["name"]))


def archive_in(cache, files, name="made-1.tgz"):
    """A package of npm in a cache, without npm."""
    path = cache / "archives" / "npm" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, "w:gz") as file:
        for entry, data in files.items():
            info = tarfile.TarInfo(entry)
            info.size = len(data)
            file.addfile(info, io.BytesIO(data))
    return path


def test_an_archive_or_a_file_with_another_hash_is_refused(tmp_path):
    path = archive_in(tmp_path, {"package/a.stl": b"solid"})
    package = {"kind": "npm", "name": "made", "version": "1", "archive": path.name, "sha256": "0" * 64}
    with pytest.raises(Unfetched, match="another hash"):
        archive_of(package, tmp_path)
    with pytest.raises(Unfetched, match=r"a\.stl has another hash"):
        unpack(path, {"package/a.stl": "0" * 64}, tmp_path / "out")
    with pytest.raises(Unfetched, match=r"b\.stl is not in it"):
        unpack(path, {"package/b.stl": "0" * 64}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_no_file_is_unpacked_outside_its_folder(tmp_path):
    path = archive_in(tmp_path, {"../evil.stl": b"1", "/evil.stl": b"2", "package/a.stl": b"3"})
    unpack(path, None, tmp_path / "out")
    assert [file.name for file in (tmp_path / "out").rglob("*") if file.is_file()] == ["a.stl"]
    assert not (tmp_path / "evil.stl").exists()


def test_a_package_without_its_client_is_named_and_the_others_go_on(tmp_path, monkeypatch, capsys):
    data = b"solid\nendsolid\n"
    there = entry_of(tmp_path, data, "a.stl")
    model = {"path": "b.stl", "sha256": "0" * 64}
    absent = {"kind": "debian", "name": "absent", "version": "1", "archive": "a.deb", "sha256": "0" * 64, "models": [model]}
    gone = PublicModel("absent/b.stl", absent, model)
    there.package["models"] = [there.model]
    monkeypatch.setattr(fetching.shutil, "which", lambda name: None)
    here, missing = fetch([there, gone], tmp_path)
    assert here == [there] and missing == {"absent": "absent: apt-get is not installed"}
    assert "not fetched: absent: apt-get is not installed" in capsys.readouterr().err


# What a run sees


def two_squares(colour):
    """Two squares apart, each with a material of its own; colour: linear, of the second."""
    (a, faces), (b, _) = square(), square(z=3.0)
    materials = [Material("first", factor=np.array([0.2, 0.5, 0.1, 1])), Material("second", factor=np.array([*colour, 1]))]
    return scene_of(np.concatenate([a, b]), np.concatenate([faces, faces + 4]), materials=materials, face_material=[0, 0, 1, 1])


def test_a_part_that_comes_back_in_another_colour_is_seen_and_no_other():
    parts = {part["material"]: part for part in compare(two_squares((0.1, 0.1, 0.8)), two_squares((0.1, 0.3, 0.8)))}
    assert parts["first"]["rgb"] is None and parts["first"]["share"] == 0.5
    assert parts["second"]["rgb"] < 20 and parts["second"]["y"] < 20


def test_surfaces_in_each_other_are_compared_with_those_of_their_material():
    scene, turned = two_squares((0.1, 0.1, 0.8)), two_squares((0.1, 0.1, 0.8))
    for side in (scene, turned):
        side.positions[:, 2] = 0.5  # the second lies in the first
    turned.faces, turned.face_material = turned.faces[::-1], turned.face_material[::-1]
    assert [part["rgb"] for part in compare(scene, turned)] == [None, None]


def test_points_at_which_the_source_contradicts_itself_do_not_count():
    positions, faces = square()
    doubled = np.concatenate([positions, positions]), np.concatenate([faces, faces + 4])
    scene, other = (scene_of(*doubled, colours=np.repeat(np.eye(4)[pair], 4, axis=0)) for pair in ([0, 1], [1, 2]))
    (part,) = compare(scene, other)
    assert part["ambiguous"] >= 0.5 and part["points"] <= 10_000


def test_a_part_that_nobody_can_see_has_no_figure():
    materials = [Material("ghost", factor=np.array([1, 0, 0, 0.0]), alpha_mode=ALPHA_BLEND)]
    scene = scene_of(*square(), materials=materials)
    assert compare(scene, scene) == [{"material": "ghost", "share": 1.0, "points": 0, "alpha": 0.0, "ambiguous": 0.0}]


def test_losses_that_no_report_names_are_seen(row):
    things = {thing for thing, _ in row["measure"]["report"]["holds"]}
    lost = {"animations", "variants", "node tree", "cameras", "extension ACME_weather", "attribute TEXCOORD_1"}
    assert lost <= things and not {"skins", "lights", "normalTexture"} & things
    silent = {f"{step}__report__{kind}": [] for step in ("encode", "decode") for kind in ("warnings", "dropped", "remarks")}
    assert set(altered(row, **silent)[UNNAMED].split(", ")) == things
    named = altered(row, **silent | {"encode__report__dropped": ["animation 'walk'", "extension ACME_weather of the file"]})
    assert set(named[UNNAMED].split(", ")) == things - {"animations", "extension ACME_weather"}


def test_each_target_is_seen_where_it_is_missed(row):
    part = row["measure"]["report"]["parts"][0]
    poor = altered(row, measure__report__parts=[part | {"rgb": 12.3}])
    assert "12.3 dB RGB" in poor[POOR] and POOR not in altered(row)
    warning = {"encode__report__warnings": ["material 'm' comes back at 12 dB", "the stream is larger than its source"]}
    assert POOR not in altered(row, measure__report__parts=[part | {"rgb": 12.3}], **warning)
    dark = {"picture": {"flat": 12.0, "lit": 13.0, "full": None, "inner": 12.0, "cover": 1.0, "size": 0.0}}
    assert "flat 12.0, lit 13.0, inner 12.0 dB" in altered(row, **dark, encode__report__dropped=[])[PICTURE]
    assert PICTURE not in altered(row, **dark, encode__report__dropped=["normals of the file"])
    assert PICTURE in altered(row, **dark, encode__report__dropped=["animation 'walk'", "Ns of material 'm'"])
    sizes = {"bytes": {"source": 100, "stream": 101, "mesh": 2249}}
    assert {LARGER, LARGE_MESH} <= set(altered(row, **sizes)) and LARGER not in altered(row, **sizes, **warning)
    assert "1 errors" in altered(row, validator={"errors": 1, "warnings": 0, "messages": ["error X"]})[INVALID]
    assert "ended with 4" in altered(row, encode__exit=4)[INTERNAL] and "-9" in altered(row, decode__exit=-9)[INTERNAL]
    assert altered(row, encode__json="NaN is not JSON")[NOT_JSON] == "encode: NaN is not JSON"


def test_a_refused_model_is_listed_and_falls_short_of_nothing(tmp_path):
    refused = row_of(tmp_path, b"glTF and no more")
    assert refused["encode"]["exit"] == 2 and refused["findings"] == []
    text, is_short = summary([refused], {})
    assert not is_short and "1 refused" in text and "made/model.glb: TXF-I07" in text


def test_a_process_that_takes_too_long_is_stopped_and_seen(tmp_path):
    caps = Namespace(seconds=0.3, memory=1 << 32)
    row = row_of(tmp_path, rich_model(), lambda folder: Room(folder, caps, Children()))
    assert row["encode"]["exit"] is None and [kind for kind, _ in row["findings"]] == [TOO_LONG]


def test_a_report_with_nan_or_infinity_is_no_json():
    assert strict_json('{"a": 1}') == {"a": 1}
    assert "NaN" in strict_json('{"a": NaN}') and "Infinity" in strict_json('{"a": -Infinity}')
    assert strict_json("[]") == "not an object" and strict_json("no JSON at all") != ""


def test_rows_go_on_after_one_that_was_cut_off_and_the_last_of_a_name_counts(tmp_path, row):
    path = tmp_path / "rows.jsonl"
    add_row(path, row | {"findings": [[POOR, "x"]]})
    path.write_text(path.read_text() + '{"name": "cut\n')
    add_row(path, row | {"findings": []})
    assert read_rows(path) == [row | {"findings": []}] and read_rows(tmp_path / "none.jsonl") == []
    before, after = row | {"findings": [[POOR, "x"]]}, row | {"findings": [[INTERNAL, "y"]]}
    text = changed([before], [after])
    assert f"{POOR}: 1 -> 0" in text and f"{INTERNAL}: 0 -> 1" in text and f"new with {row['name']}: {INTERNAL}" in text


# Other people's programs


@pytest.fixture(scope="module")
def modules():
    """The folder with the validator and three.js."""
    folder = node_modules(CACHE) if shutil.which("node") else None
    return folder or pytest.skip("node, or npm with a network, is not here: nothing to validate or draw with")


def test_the_validator_and_three_find_nothing_to_say_of_a_good_model_and_much_of_a_bad_one(modules):
    row = row_of(CACHE, rich_model(), modules=modules)
    assert row["validator"] == {"errors": 0, "warnings": 0, "messages": []}
    if BROWSER is None:
        pytest.skip("no Chromium to draw with")
    rows_file = CACHE / "test.jsonl"
    rows_file.unlink(missing_ok=True)
    silent = {"name": "made/bad.glb", "mesh": row["source"], "source": _blue_square(), "encode": row["encode"] | {"report": {}}}
    good, bad = draw([row, row | silent], 2, CACHE, rows_file)
    assert least_picture(good["picture"]) > 30 and good["picture"]["size"] < 1e-3 and good["picture"]["cover"] > 0.98
    assert PICTURE not in dict(good["findings"]) and "flat" in dict(bad["findings"])[PICTURE]
    with Image.open(CACHE / "pictures-test" / "sheet-01.png") as sheet:
        assert len(sheet.convert("RGB").getcolors(1 << 24)) > 20
    assert read_rows(rows_file) == [good, bad]


def _blue_square():
    """A square of one colour in the cache: its path there."""
    builder = Builder()
    builder.primitive(material=builder.material(pbr={"baseColorFactor": [0, 0, 1, 1]}))
    path = CACHE / "files" / "npm" / "made-1" / "blue.glb"
    path.write_bytes(builder.glb())
    return str(path.relative_to(CACHE))


# Kinds, and the page


def test_every_kind_has_files_that_its_control_does_not_and_is_written_with_them(tmp_path):
    kinds = {f"{form}: {name}": kind for form, of in FORMATS.items() for name, kind in of().items()}
    assert len(kinds) > 150 and all(kind.files != kind.without for kind in kinds.values())
    assert all(bool(kind.expected) == (kind.like == "construction") for kind in kinds.values())
    kind = kinds["OBJ and MTL: map_Kd of other case"]
    entry, without, expected = write_kind("OBJ and MTL: map_Kd of other case", kind, tmp_path)
    assert entry.path(tmp_path).read_bytes() == kind.files["model.obj"]
    assert (entry.path(tmp_path).parent / "a.png").read_bytes() == kind.files["a.png"]
    assert (tmp_path / without).parent.name == "without" and (tmp_path / expected).read_bytes() == kind.expected


def test_a_property_that_is_lost_without_a_word_is_a_fault_and_no_other(row):
    quiet = row | {"like": "three.js"}
    for step in ("encode", "decode"):
        quiet[step] = quiet[step] | {"report": {}}
    other = {"flat": 10.0, "lit": 10.0, "full": 10.0, "size": 0.0}
    same = dict.fromkeys(other, None) | {"size": 0.0}
    named = quiet | {"encode": row["encode"] | {"report": {"dropped": ["normal map of material 'm'"]}}}
    wide = same | {"size": 0.5}
    cases = ((quiet, other, same, OK), (quiet, other, other, FAULT), (quiet, other, wide, FAULT), (named, other, other, NAMED),
             (quiet, same, same, UNSHOWN), (quiet, other, {"error": "x"}, FAULT),
             (quiet | {"encode": {**row["encode"], "exit": 4}}, other, other, ERROR))
    assert [judged(of, control, picture)["verdict"] for of, control, picture, _ in cases] == [verdict for *_, verdict in cases]


def test_a_warning_of_a_loss_beside_no_losses_is_seen(row):
    warned = {"encode__report__warnings": ["texture file 'a.png' is missing or unreadable"], "encode__report__dropped": []}
    assert UNSAID in altered(row, **warned)
    assert UNSAID not in altered(row, **warned | {"encode__report__dropped": ["texture 'a.png'"]})
    assert UNSAID not in altered(row, **warned | {"encode__report__warnings": ["the stream is larger than its source"]})


def test_files_that_a_model_names_are_listed_though_our_reader_passes_them_over(tmp_path):
    mtl = b"newmtl m\nmap_Kd -s 1 1 1 C:\\job\\A b.PNG\n"
    archive_in(tmp_path, {"package/a.obj": b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "package/m.mtl": mtl,
                          "package/maps/a b.png": b"png", "package/c.png": b"no", "package/package.json": b"{}"}, "made-2.tgz")
    text = "npm:made:2:5"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tools.proof.public_models.listing.archive_of", lambda package, cache: cache / "archives/npm/made-2.tgz")
        (package,) = add_package(text, tmp_path, [], number=2)
        assert add_package("npm:other:2:5", tmp_path, [package], number=2)[1]["models"] == []  # known by its hash
    (model,) = package["models"]
    assert package["round"] == 2 and set(model["with"]) == {"package/m.mtl", "package/maps/a b.png"}


def test_the_page_tells_counts_pairs_the_worst_and_kinds(row):
    shown = {"flat": 12.0, "lit": 40.0, "full": None, "inner": 12.0, "cover": 1.0, "size": 0.0, "absent": 0}
    dark = row | {"name": "made/dark.glb", "picture": shown}
    dark["findings"] = findings_of(dark)
    fine = row | {"name": "made/fine.glb", "picture": dict.fromkeys(shown, None) | {"cover": 1.0, "size": 0.0}, "findings": []}
    refused = {"name": "made/b.obj", "encode": {"exit": 2, "report": {"error": {"code": "TXF-I07", "message": "3 bytes"}}},
               "findings": []}
    kind = {"name": "PLY: alpha", "like": "construction", "shows": 17.0, "decoded": 17.0, "losses": ["alpha"], "verdict": "named"}
    text = page_of([dark, fine, refused], [kind], [], 1)
    assert "| pairs of pictures | 2 |" in text and "| pairs under 30 dB | 1 |" in text and "| under 20 | 1 |" in text
    assert f"| of these without a named loss | {int(not losses_of(dark))} |" in text and "| TXF-I07: n bytes | 1 |" in text
    assert "| made: dark.glb | 12.0 | 40.0 | same |" in text
    assert "| PLY: alpha | construction | 17.0 | 17.0 | named: alpha |" in text


# A sample


def sample():
    """10 small models of small packages, of more than a cube: every other of 20."""
    packages = [package for package in read_list() if package["name"] in SAMPLE.get(package["kind"], ())]
    entries = [entry for entry in entries_of(packages) if entry.model["bytes"] > 1000 or "with" in entry.model]
    return sorted(entries, key=lambda entry: entry.model["bytes"])[:20:2]


def test_a_sample_of_public_models_falls_short_of_nothing():
    here, missing = fetch(sample(), CACHE)
    if missing:
        pytest.skip(f"the packages of the sample cannot be fetched: {'; '.join(missing.values())}")
    run = Namespace(cache=CACHE, rate=RATE)
    rows = [code_model(entry, run, None, CACHE / "coded" / "test", Inside) for entry in here]
    text, is_short = summary(rows, {})
    assert len(rows) == 10 and not is_short, text
