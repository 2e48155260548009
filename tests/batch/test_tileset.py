"""texf-enc --batch tileset.json: glTF contents are coded, the JSON keeps all but URIs that change, other files are copied."""

import json

import pytest
from gltf_scenes import spinning

from texfcodec.api import expand
from texfcodec.cli.enc import main
from texfcodec.cli.tileset import Tileset
from texfcodec.errors import InputError

SPHERE = {"sphere": [0, 0, 0, 9]}
TEXT = """{"asset": {"version": "1.1", "url": "tiles/a.gltf.txt"}, "geometricError": 1e-7,
  "root": {"boundingVolume": {"sphere": [0, 0, 0, 9.50]}, "content": {"uri": "tiles/a%20b.gltf?v=1"},
    "children": [{"contents": [{ "uri" : "./tiles/c.glb"}, {"uri": "old.b3dm"}]},
                 {"content": {"uri": "deep/more.json"}},
                 {"content": {"uri": "tree/{level}/{x}.glb"}, "implicitTiling": {"subtrees": {"uri": "tree/s.subtree"}}}]}}"""


def a_tileset(folder, uri="tiles/c.glb"):
    folder.mkdir(exist_ok=True)
    (folder / "tileset.json").write_text(json.dumps({"asset": {"version": "1.1"}, "root": {"content": {"uri": uri}}}))
    return folder / "tileset.json"


@pytest.fixture
def tiles(tmp_path):
    """A folder with a tileset of every kind of content."""
    folder = tmp_path / "tiles3d"
    for name in ("tiles/a b.gltf", "tiles/c.glb", "old.b3dm", "tree/0/0.glb", "tree/s.subtree", "deep/d.gltf", "deep/d.glb"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"source of {name}")
    (folder / "tileset.json").write_text(TEXT)
    more = {"root": {"content": {"uri": "d.gltf"}, "children": [{"content": {"uri": "../tileset.json"}}]}}
    (folder / "deep/more.json").write_text(json.dumps(more))
    return folder


def test_contents_that_change_their_name_are_renamed_in_the_json_and_nothing_else_changes(tiles, tmp_path):
    notes, out = [], tmp_path / "out"
    tileset = Tileset(tiles / "tileset.json", notes.append)
    assert {asset.name: asset.out for asset in tileset.assets} == {
        "deep/d.gltf": "deep/d.gltf.glb", "tiles/a b.gltf": "tiles/a b.glb", "tiles/c.glb": "tiles/c.glb"}
    assert [kind in " ".join(notes) for kind in (".b3dm", "implicit tiles")] == [True, True] and len(notes) == 2
    for asset in tileset.assets:
        (out / asset.out).parent.mkdir(parents=True, exist_ok=True)
        (out / asset.out).write_text("coded")
    tileset.finish(out, set())
    assert (out / "tileset.json").read_text() == TEXT.replace("a%20b.gltf?", "a%20b.glb?")
    assert '"d.gltf.glb"' in (out / "deep/more.json").read_text()
    files = {path.relative_to(out).as_posix(): path.read_text() for path in out.rglob("*") if path.is_file()}
    kept = {name for name, text in files.items() if text.startswith("source")}
    assert kept == {"old.b3dm", "tree/0/0.glb", "tree/s.subtree", "deep/d.glb"}


def test_a_content_that_cannot_be_coded_is_copied_under_its_name(tiles, tmp_path):
    tileset, out = Tileset(tiles / "tileset.json", print), tmp_path / "out"
    tileset.finish(out, {asset.name for asset in tileset.assets})
    assert (out / "tileset.json").read_text() == TEXT
    assert (out / "tiles/a b.gltf").read_text() == "source of tiles/a b.gltf"


@pytest.mark.parametrize("uri", ["../c.glb", "tiles/../../c.glb", "/etc/c.glb", "https://example.org/c.glb", "%2e%2e/c.glb",
                                 "link/c.glb", 7, None])
def test_a_tileset_that_names_files_outside_its_folder_is_refused(uri, tmp_path):
    source = a_tileset(tmp_path / "in", uri)
    (source.parent / "link").symlink_to(tmp_path)
    with pytest.raises(InputError) as refused:
        Tileset(source, print)
    assert refused.value.code == "TXF-I57"


@pytest.mark.parametrize("text", ["{", "[]", '{"root": 7}', '{"root": {"children": [7]}}', '{"root": {}}', "[" * 100_000])
def test_what_is_no_tileset_is_refused(text, tmp_path):
    (tmp_path / "tileset.json").write_text(text)
    with pytest.raises(InputError) as refused:
        Tileset(tmp_path / "tileset.json", print)
    assert refused.value.code == "TXF-I57"


def test_the_tool_codes_a_tileset_names_what_is_missing_and_goes_on(tmp_path, capsys):
    source, out = a_tileset(tmp_path / "in"), tmp_path / "out"
    (source.parent / "tiles").mkdir()
    words = ["--batch", str(source), "--out", str(out), "--resolution", "16", "--qp", "30", "--effort", "fast", "--no-check"]
    for content, code, said in ((None, 7, "TXF-I01"), (spinning().glb(), 0, "1 encoded"), (None, 0, "1 already encoded")):
        if content:
            (source.parent / "tiles/c.glb").write_bytes(content)
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == code and said in "".join(capsys.readouterr())
        assert (out / "tileset.json").read_bytes() == source.read_bytes()
    assert b"TEXF_stream" in (out / "tiles/c.glb").read_bytes() and expand((out / "tiles/c.glb").read_bytes())
    with pytest.raises(SystemExit) as ended:
        main([*words[:3], str(source.parent)])
    assert ended.value.code == 2 and "TXF-O07" in capsys.readouterr().err
