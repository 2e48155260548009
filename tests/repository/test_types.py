"""mypy, as pyproject.toml sets it up, over the package."""

import shutil
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def checked(cache, *arguments):
    """What mypy prints; cache: folder that it keeps between runs."""
    command = [sys.executable, "-m", "mypy", "--no-color-output", "--cache-dir", str(cache), *arguments]
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert run.returncode in (0, 1) and not run.stderr, run.stdout + run.stderr  # 2: it could not check at all
    return run.stdout


def test_nothing_is_found_in_the_package(pytestconfig):
    said = checked(pytestconfig.cache.mkdir("mypy"))
    assert said.startswith("Success: no issues found in "), said
    folders = [path for path in (REPOSITORY / "texfcodec").rglob("*") if path.is_dir() and "__pycache__" not in path.parts]
    others = [folder for folder in folders if not any(folder.rglob("*.py"))]  # which count as one module each
    assert int(said.split()[5]) == len(list((REPOSITORY / "texfcodec").rglob("*.py"))) + len(others)


def test_a_wrong_argument_and_a_wrong_result_are_found(tmp_path, pytestconfig):
    module = tmp_path / "threads.py"
    shutil.copy(REPOSITORY / "texfcodec" / "core" / "threads.py", module)
    cache = pytestconfig.cache.mkdir("mypy_planted")  # of its own: the two tests may run at the same time
    assert checked(cache, str(module)).startswith("Success")
    with open(module, "a", encoding="utf-8") as file:
        file.write("\n\ndef half(count: int) -> int:\n    over_blocks(print, str(count), 1, 1)\n    return count / 2\n")
        file.write("\n\ndef _quarter(count):\n    return len(4) + count\n")
    said = checked(cache, str(module))
    assert "[arg-type]" in said and "[return-value]" in said and "Found 3 errors in 1 file" in said, said
