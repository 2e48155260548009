"""The list of all parts (SBOM, CycloneDX): the packages that an installed wheel brings, and what is compiled into texf.wasm
or bundled into viewer.js."""

import json
import sys
import venv
from pathlib import Path

from tools.release.clean_copy import run

PARTS_BUNDLED = ({
    "type": "library", "bom-ref": "texf.wasm/zig", "name": "zig", "version": "0.17.1",
    "description": "wasi-libc, libc++ and compiler-rt, compiled into texfcodec/sandbox/texf_simd.wasm; libc++ into the native "
                   "library",
    "licenses": [{"license": {"id": "MIT"}}],
}, {
    "type": "library", "bom-ref": "viewer.js/three", "name": "three", "version": "0.187.0",
    "description": "three.js, bundled into texfcodec/viewer/web/viewer.js", "licenses": [{"license": {"id": "MIT"}}],
})


def environment_of(wheel: Path, folder: Path) -> Path:
    """The interpreter of a new environment that holds the wheel, what it requires, and nothing else.

    The wheel comes from its folder alone, so that no path of this machine is written down as its origin.
    """
    venv.create(folder, with_pip=False)
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    name, version = wheel.name.split("-")[:2]
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--python", python, "install")
    run(*pip, "--no-index", "--no-deps", "--find-links", wheel.parent, f"{name}=={version}")
    run(*pip, "--find-links", wheel.parent, f"{name}=={version}")
    return python


def list_of_parts(python: Path, pyproject: Path, seconds: int) -> str:
    """The list as JSON, its time that of the commit, valid by CycloneDX's own schema. SystemExit where it is not."""
    parts_json = run(sys.executable, "-m", "cyclonedx_py", "environment", "--output-reproducible", "--spec-version", "1.6",
                     "--pyproject", pyproject, "--mc-type", "library", python, SOURCE_DATE_EPOCH=str(seconds))
    parts = json.loads(parts_json)
    parts["components"] += PARTS_BUNDLED
    text = json.dumps(parts, indent=2) + "\n"
    _check(text)
    return text


def _check(text):
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    fault = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if fault is not None:
        raise SystemExit(f"the list of parts is not valid: {fault}")
