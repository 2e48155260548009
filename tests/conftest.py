"""Fixtures for every room, and which tests `make check`, `make test` and `make -C tools sweeps` take. Markers: pyproject.toml."""

import importlib
import sys
import tomllib
from collections import Counter, defaultdict
from functools import partial
from pathlib import Path
from unittest.mock import patch

import pytest
from mesh_files import load_bytes, refusal
from plugins import write_plugin

from texfcodec.errors import TexfError
from texfcodec.findings import FINDINGS

REPOSITORY = Path(__file__).resolve().parents[1]
LONG_TESTS = tomllib.loads((Path(__file__).parent / "long_tests.toml").read_text(encoding="utf-8"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests of long_tests.toml are marked `long`; of their cases as many as it says, evenly spread, and the others `slow`."""
    cases = defaultdict(list)
    for item in items:
        cases[item.path.stem, getattr(item, "originalname", item.name)].append(item)
    for (module, name), found in cases.items():
        wanted = LONG_TESTS.get(module, {}).get(name)
        kept = {i * len(found) // wanted for i in range(wanted)} if wanted else set()
        for i, item in enumerate(found if wanted is not None else ()):
            item.add_marker("long" if i in kept or wanted >= len(found) else "slow")


def pytest_terminal_summary(terminalreporter):
    """Skipped tests, counted by their reason."""
    counts = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.getreports("skipped"))
    for reason, count in counts.most_common():
        terminalreporter.write_line(f"{count} skipped: {reason}")


@pytest.fixture(scope="session", autouse=True)
def raised_as_the_table_says():
    """Every error of a test is of the class that findings.py gives its code."""
    families, make = {row.code: row.family for row in FINDINGS}, TexfError.__init__

    def checked(error, code, message, **details):
        make(error, code, message, **details)
        assert isinstance(error, families[code] or TexfError), error

    with patch.object(TexfError, "__init__", checked):
        yield


@pytest.fixture(scope="session")
def shared_dir():
    """The folder of large assets and anchors beside the repository; tests that need it skip where it is not."""
    path = REPOSITORY.parent / "shared"
    if not path.is_dir():
        pytest.skip("../shared is not here: the large assets and the anchors are not part of the repository")
    return path


@pytest.fixture(scope="session")
def sample_scene():
    """The bundled sample; treat it as read-only, it is made once for the whole run."""
    from texfcodec.demo.asset import make_sample

    scene = make_sample()
    for array in (scene.positions, scene.faces, scene.face_material, scene.corner_uv, scene.corner_color):
        array.flags.writeable = False
    return scene


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Puts plug-ins on the path as their packages would: install(points, folder="plugins", module=text, ...)."""
    from texfcodec import codecs

    before = set(sys.modules)

    def forget():
        importlib.invalidate_caches()
        for cached in (codecs._plugins, codecs._plugin):
            cached.cache_clear()
        for name in set(sys.modules) - before:
            if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]

    def put(points, folder="plugins", **modules):
        monkeypatch.syspath_prepend(str(write_plugin(tmp_path / folder, points, **modules)))
        forget()

    yield put
    monkeypatch.undo()
    forget()


@pytest.fixture
def loaded(tmp_path):
    """Builder, bytes or text -> Scene, by way of a file."""
    return partial(load_bytes, tmp_path)


@pytest.fixture
def refused(tmp_path):
    """The TexfError that loading ends in."""
    return partial(refusal, tmp_path)


@pytest.fixture
def call(capsys):
    """call("texf-enc", arguments...) -> (exit code, stdout, stderr), in this process."""

    def run(name, *arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            importlib.import_module(f"texfcodec.cli.{name.removeprefix('texf-')}").main([str(a) for a in arguments])
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    return run
