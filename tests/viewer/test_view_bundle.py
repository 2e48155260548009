"""web/viewer.js is what app/bundle.mjs makes of its modules, js/src and three.js."""

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
APP, WEB, JS = REPOSITORY / "texfcodec/viewer/app", REPOSITORY / "texfcodec/viewer/web", REPOSITORY / "js"
needs_modules = pytest.mark.skipif(not (shutil.which("node") and (JS / "node_modules/esbuild").is_dir()),
                                   reason="no node, or no esbuild in js/node_modules: npm install in js/")


def digest_of_sources():
    """What bundle.mjs writes into the first lines."""
    versions = json.loads((JS / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    found = hashlib.sha256(f"three {versions['three']} esbuild {versions['esbuild']}\n".encode())
    for folder in (APP, JS / "src"):
        for path in sorted(path for path in folder.iterdir() if path.suffix in (".js", ".mjs")):
            found.update(f"{path.name}\n".encode())
            found.update(path.read_bytes())
    return found.hexdigest()


def test_the_bundle_is_made_of_the_sources_that_stand_here():
    """After a change in app/ or js/src: npm install in js/, then make web."""
    head = (WEB / "viewer.js").read_text(encoding="utf-8")[:2000]
    assert re.search(r"^sources ([0-9a-f]{64})$", head, re.M)[1] == digest_of_sources()
    assert "The MIT License" in head and "three.js authors" in head and "THE SOFTWARE IS PROVIDED" in head


def test_what_is_bundled_is_pinned():
    versions = json.loads((JS / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", versions[name]) for name in ("three", "esbuild"))


@needs_modules
def test_the_same_sources_give_the_same_bytes(tmp_path):
    subprocess.run(["node", APP / "bundle.mjs", tmp_path / "viewer.js"], check=True, timeout=120)
    assert (tmp_path / "viewer.js").read_bytes() == (WEB / "viewer.js").read_bytes()
