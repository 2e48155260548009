"""A wheel in an empty environment of each Python: it is installed, says its version, codes a tiny mesh and decodes it to GLB.

    python tools/release/try_wheel.py WHEEL PYTHON ...

Exit code 1: one of them failed. Kernels are compiled anew each time, which takes half a minute or more.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

TETRAHEDRON = """v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 0 1 0 0 0 1
v 0 0 1 1 1 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""  # OBJ, with colours at its vertices


def main(arguments: list[str]) -> int:
    """Exit code; a line on stdout for each Python."""
    if len(arguments) < 2:
        print("usage: python tools/release/try_wheel.py WHEEL PYTHON ...", file=sys.stderr)
        return 2
    wheel, failed = Path(arguments[0]).resolve(), 0
    for python in arguments[1:]:
        with tempfile.TemporaryDirectory() as folder:
            said, works = try_one(wheel, python, Path(folder))
        print(f"{python}: {said}", flush=True)
        failed += not works
    return int(failed > 0)


def try_one(wheel: Path, python: str, folder: Path) -> tuple[str, bool]:
    """(what happened, whether all went well) in an environment of its own, with a cache of its own."""
    own = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
    own |= {"NUMBA_CACHE_DIR": str(folder / "cache"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    tools = folder / "environment" / ("Scripts" if sys.platform == "win32" else "bin")
    mesh, stream, glb = folder / "mesh.obj", folder / "mesh.texf", folder / "mesh.glb"
    mesh.write_text(TETRAHEDRON, encoding="ascii")
    steps = ([python, "-m", "venv", folder / "environment"], [tools / "python", "-m", "pip", "install", "--quiet", wheel],
             [tools / "python", "--version"], [tools / "texf-enc", "--version"],
             [tools / "texf-enc", mesh, stream, "--resolution", "16"], [tools / "texf-dec", stream, glb])
    said = []
    for step in steps:
        words = [os.fspath(word) for word in step]
        try:
            done = subprocess.run(words, cwd=folder, env=own, capture_output=True, text=True, check=False)
        except OSError as error:
            return f"not to be had: {error}", False
        if done.returncode:
            return f"{' '.join(words[:3])} ended with {done.returncode}: {done.stderr.strip()}", False
        said += [done.stdout.strip()] if "--version" in words else []
    works = glb.read_bytes()[:4] == b"glTF"
    return f"{', '.join(said)}, {stream.stat().st_size} bytes of stream, {glb.stat().st_size} of GLB", works


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
