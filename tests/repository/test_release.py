"""A release, without building one: one version everywhere, the same bytes twice, and workflows that can be read."""

import gzip
import io
import json
import re
import shutil
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from test_house import tracked_files

import texfcodec
from texfcodec.io.load import load
from tools.release import npm_package, parts_list, public_streams, try_wheel
from tools.release.add_ons import pack_add_ons
from tools.release.make_release import _keep_what_is_the_same, _write_sums
from tools.release.same_bytes import normalised_tar
from tools.release.wheel_contents import DESCRIPTION, faults_of_contents

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((REPOSITORY / ".github" / "workflows").glob("*.yml"))


def text_of(name):
    return (REPOSITORY / name).read_text(encoding="utf-8")


# The version.


def test_one_version_stands_everywhere():
    version = PROJECT["version"]
    assert texfcodec.__version__ == version
    assert json.loads(text_of("js/package.json"))["version"] == version
    assert re.findall(r"^version: (.+)$", text_of("CITATION.cff"), re.M) == [version]
    assert tomllib.loads(text_of("integrations/blender/blender_manifest.toml"))["version"] == version


def test_first_version_of_the_changelog_is_this_one_and_says_when():
    heads = re.findall(r"^## (.+)$", text_of("CHANGELOG.md"), re.M)
    numbered = [head for head in heads if head != "Unreleased"]
    assert heads[0] in ("Unreleased", numbered[0])
    assert re.fullmatch(re.escape(PROJECT["version"]) + r" \(\d{4}-\d\d-\d\d\)", numbered[0])
    assert re.findall(r"^date-released: (.+)$", text_of("CITATION.cff"), re.M) == [numbered[0][-11:-1]]


def test_licence_is_the_same_everywhere():
    assert json.loads(text_of("js/package.json"))["license"] == PROJECT["license"]
    assert f"license: {PROJECT['license']}\n" in text_of("CITATION.cff")


def test_release_tools_and_the_demo_have_an_extra_and_no_job_needs_their_packages():
    extras = PROJECT["optional-dependencies"]
    name_of = re.compile(r"[\w-]+(\[[\w,]+\])?")
    assert {name_of.match(line).group() for line in extras["release"]} == {"build", "twine", "cyclonedx-bom"}
    assert any(line.startswith("scikit-image") for line in extras["demo"])
    needed = {name_of.match(line).group() for line in PROJECT["dependencies"]}
    assert needed & {"scikit-image", "scipy", "rtree", "build", "twine"} == set()


# The bytes.


def tar_of(members, **more):
    """.tar.gz of {name: bytes, or None for a folder}, in that order; more: attributes of every member."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as archive:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.type, member.size = (tarfile.DIRTYPE, 0) if data is None else (tarfile.REGTYPE, len(data))
            for key, value in more.items():
                setattr(member, key, value)
            archive.addfile(member, io.BytesIO(data or b""))
    return out.getvalue()


def test_order_times_and_owners_of_an_sdist_do_not_show_in_its_bytes():
    files = {"p-1": None, "p-1/b.py": b"b", "p-1/a.py": b"a" * 1000}
    one = tar_of(files, mtime=1, uid=1000, uname="me", mode=0o664)
    other = tar_of(dict(reversed(files.items())), mtime=2_000_000_000, gid=7, gname="us", mode=0o600)
    assert one != other and normalised_tar(one, 99) == normalised_tar(other, 99) == normalised_tar(normalised_tar(one, 99), 99)


def test_a_normalised_sdist_holds_what_it_held():
    files = {"p-1": None, "p-1/name that is long " + "x" * 120: b"1", "p-1/ä": b"", "p-1/run": b"#!"}
    made = normalised_tar(tar_of(files, mode=0o755), 1_700_000_000)
    with tarfile.open(fileobj=io.BytesIO(made)) as archive:
        members = archive.getmembers()
        held = {m.name: archive.extractfile(m).read() if m.isfile() else None for m in members}
    assert held == files and [m.name for m in members] == sorted(files)
    assert {(m.mtime, m.uid, m.gid, m.uname, m.gname, m.mode) for m in members} == {(1_700_000_000, 0, 0, "", "", 0o755)}
    assert int.from_bytes(made[4:8], "little") == 1_700_000_000 and not made[3] & 8  # gzip's time; no name of a file


def test_an_sdist_with_other_bytes_stays_another():
    assert normalised_tar(tar_of({"a": b"1"}), 1) != normalised_tar(tar_of({"a": b"2"}), 1)
    assert gzip.decompress(normalised_tar(tar_of({"a": b"1"}), 1)) != gzip.decompress(normalised_tar(tar_of({"a": b"1"}), 2))


def test_links_and_devices_are_refused():
    with pytest.raises(ValueError, match="neither a file nor a folder"):
        normalised_tar(tar_of({"a": b""}, type=tarfile.SYMTYPE, linkname="b"), 1)


@pytest.mark.parametrize("second, fault", [({"a.whl": b"2"}, "different bytes"), ({"b.whl": b"1"}, "different files"),
                                           ({}, "different files")])
def test_two_builds_that_differ_stop_the_release(tmp_path, second, fault):
    for folder, files in (("first", {"a.whl": b"1"}), ("second", second)):
        (tmp_path / folder).mkdir()
        for name, data in files.items():
            (tmp_path / folder / name).write_bytes(data)
    built = [sorted((tmp_path / folder).iterdir()) for folder in ("first", "second")]
    with pytest.raises(SystemExit, match=fault):
        _keep_what_is_the_same(built, tmp_path)


def test_sums_are_read_by_sha256sum(tmp_path):
    (tmp_path / "a.whl").write_bytes(b"abc")
    _write_sums([tmp_path / "a.whl"], tmp_path / "SHA256SUMS")
    assert (tmp_path / "SHA256SUMS").read_text() == \
        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  a.whl\n"


# What is in it.


def test_a_wheel_holds_the_package_and_nothing_else():
    tracked = ["texfcodec/__init__.py", "texfcodec/viewer/web/viewer.js", "tests/test_x.py", "conformance/subset/k33/in.texf"]
    right = tracked[:2] + [f"texfcodec-1.dist-info/{name}" for name in DESCRIPTION]
    assert faults_of_contents(right, tracked) == []
    wrong = ["tests/test_x.py", "texfcodec/__pycache__/x.pyc", "texfcodec/_x.so", "texfcodec-1.data/scripts/x"]
    assert len(faults_of_contents([*right, *wrong], tracked)) == len(wrong)
    assert faults_of_contents(right[1:], tracked) == ["texfcodec/__init__.py is missing from the wheel"]


def test_every_file_of_the_package_is_code_or_named_as_its_data():
    """What setuptools puts into a wheel: modules, and the patterns of package-data. Nothing else may be tracked there."""
    patterns = tomllib.loads(text_of("pyproject.toml"))["tool"]["setuptools"]["package-data"]["texfcodec"]
    names = [path.relative_to(REPOSITORY).as_posix() for path in tracked_files()]
    package = [path.removeprefix("texfcodec/") for path in names if path.startswith("texfcodec/")]
    data = [path for path in package if not path.endswith(".py")]
    assert len(package) > 300 and len(data) > 15
    assert [path for path in data if not any(Path(path).match(pattern) for pattern in patterns)] == []
    assert {Path(path).suffix for path in data} == {".typed", ".wasm", ".js", ".mjs", ".html", ".css"}


def test_parts_that_are_compiled_or_bundled_have_the_versions_that_they_are_made_with():
    made = re.findall(r"^ZIG_VERSION \?= (\S+)$", text_of("native/Makefile"), re.M)
    zig, three = parts_list.PARTS_BUNDLED
    assert [zig["version"]] == made
    assert three["version"] == json.loads(text_of("js/package.json"))["devDependencies"]["three"]


def test_what_is_tried_is_there(tmp_path):
    assert npm_package.VECTOR.read_bytes() and "decode" in npm_package.PROGRAM
    (tmp_path / "mesh.obj").write_text(try_wheel.TETRAHEDRON)
    assert try_wheel.main(["only.whl"]) == 2 and len(load(tmp_path / "mesh.obj").faces) == 4


# Workflows.


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflow_is_yaml_and_its_actions_name_a_major_version(path):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: pip install pyyaml")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# UNTESTED: ")
    read = yaml.safe_load(text)
    assert read["name"] == path.stem and read[True] and read["permissions"] == {"contents": "read"}  # YAML's `on` is true
    steps = [step for job in read["jobs"].values() for step in job.get("steps", [])]
    actions = [step["uses"] for step in steps if "uses" in step]
    assert len(actions) > 3 and [one for one in actions if not re.fullmatch(r"[\w-]+/[\w-]+@(release/)?v\d+", one)] == []
    assert all(("uses" in step) != ("run" in step) for step in steps)
    needed = [job.get("needs", []) for job in read["jobs"].values()]
    assert {one for names in needed for one in ([names] if isinstance(names, str) else names)} <= set(read["jobs"])


def test_workflows_try_every_python_that_is_promised():
    assert [path.name for path in WORKFLOWS] == ["release.yml", "tests.yml"]
    for path in WORKFLOWS:
        assert 'python: ["3.11", "3.12", "3.13", "3.14"]' in path.read_text(encoding="utf-8")
        assert "system: [ubuntu-latest, macos-latest, windows-latest]" in path.read_text(encoding="utf-8")
    assert PROJECT["requires-python"] == ">=3.11"


def test_no_workflow_reads_a_stored_secret():
    for path in WORKFLOWS:
        assert "secrets." not in path.read_text(encoding="utf-8")


def test_no_module_imports_what_only_extras_bring():
    """scipy comes with most environments of developers, so that only a user would meet the missing one."""
    found = [path.relative_to(REPOSITORY).as_posix() for path in (REPOSITORY / "texfcodec").rglob("*.py")
             if re.search(r"^\s*(from|import) (scipy|rtree|networkx|lxml|imageio)\b", path.read_text(encoding="utf-8"), re.M)]
    assert found == []


def test_add_ons_become_the_same_zips_whenever_their_files_were_written(tmp_path):
    later = tmp_path / "tree" / "integrations"
    shutil.copytree(REPOSITORY / "integrations", later)  # with times of its own
    one, other = pack_add_ons(REPOSITORY, tmp_path / "one"), pack_add_ons(later.parent, tmp_path / "other")
    assert [path.name for path in one] == ["texf-blender.zip", "texf-comfyui.zip"]
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]
    assert zipfile.ZipFile(one[0]).read("blender_manifest.toml") and zipfile.ZipFile(one[1]).read("texf/__init__.py")


# Streams of public models.


def test_streams_of_public_models_are_listed_by_hashes_alone():
    listed = public_streams.read_list()
    hashes = [*listed, *(values for _, values in listed.values())]
    assert len(listed) >= 100 and all(re.fullmatch(r"[0-9a-f]{64}", value) for value in hashes)


def test_a_listed_stream_matches_differs_or_is_absent(tmp_path, monkeypatch, capsys):
    vectors = {name: (REPOSITORY / "conformance" / name / "in.texf").read_bytes()
               for name in ("subset/k2", "subset/texels", "uncommon/empty", "faulty/version")}
    for name, data in vectors.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.texf").write_bytes(data)
    monkeypatch.setattr(public_streams, "LIST", tmp_path / "list.json")
    streams = public_streams.streams_below(tmp_path)
    newer = next(key for key, path in streams.items() if path.stem == "version")
    good = {key: [path.stem, public_streams.decoded_hash(path.read_bytes())] for key, path in streams.items() if key != newer}
    for change, code, line in (({}, 0, "3 matched, 0 differing, 0 absent, of 3 listed"),
                               ({"0" * 64: ["gone", "0"]}, 0, "3 matched, 0 differing, 1 absent, of 4 listed"),
                               ({next(iter(good)): ["other", "0"]}, 7, "2 matched, 1 differing, 0 absent, of 3 listed"),
                               ({newer: ["of another version", "0"]}, 7, "3 matched, 1 differing")):
        public_streams.LIST.write_text(json.dumps(good | change))
        assert public_streams.main([str(tmp_path)]) == code and line in capsys.readouterr().out
    assert public_streams.main([str(tmp_path / "subset" / "none")]) == 7
    sizes = [streams[key].stat().st_size for key in public_streams.chosen(streams, 3)]
    assert len(sizes) == 3 and sizes[0] == len(vectors["faulty/version"])
