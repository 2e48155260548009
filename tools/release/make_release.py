"""Everything that is published of the last commit: sdist, wheel, wheels of single platforms with the native library, npm package,
add-ons, list of parts (SBOM) and SHA-256 sums.

Each archive is built twice, in two clean copies, and must come out the same byte for byte. What is not committed is not in it.

    python -m tools.release.make_release [--out FOLDER] [--without-npm] [--without-native]
"""

import argparse
import hashlib
import os
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path

from tools.release.add_ons import pack_add_ons
from tools.release.clean_copy import REPOSITORY, changed_files, commit_and_time, copy_commit, run
from tools.release.npm_package import pack, try_package
from tools.release.parts_list import environment_of, list_of_parts
from tools.release.platform_wheels import PLACE, PLATFORMS, build_library, install_zig, platform_wheel
from tools.release.same_bytes import normalised_tar
from tools.release.wheel_contents import faults_of_contents


def main(arguments: list[str] | None = None) -> None:
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/release"), help="emptied first  [default: out/release]")
    parser.add_argument("--without-npm", action="store_true", help="leave the npm package out, where npm is not installed")
    parser.add_argument("--without-native", action="store_true", help="leave the wheels with the native library out")
    given = parser.parse_args(arguments)
    os.umask(0o022)  # archives hold the rights of their files
    commit, seconds = commit_and_time()
    changed = changed_files()
    if changed:
        print(f"not in the release, because they are not committed: changes of {', '.join(changed)}", file=sys.stderr)
    out = given.out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as folder:
        make(commit, seconds, Path(folder), out, with_npm=not given.without_npm, with_native=not given.without_native)
    print(f"commit {commit}, SOURCE_DATE_EPOCH {seconds}")
    print((out / "SHA256SUMS").read_text(encoding="utf-8"), end="")


def make(commit: str, seconds: int, work: Path, out: Path, *, with_npm: bool, with_native: bool) -> None:
    """All files of the release of a commit, into out. work: a folder for what is only needed meanwhile."""
    copies = [work / "tree" / str(number) for number in range(2)]
    for number, copy in enumerate(copies):
        copy_commit(commit, copy)
        _say(f"sdist and wheel, {number + 1} of 2")
        _build(copy, work / "python" / str(number), seconds)
    built = [sorted((work / "python" / str(number)).iterdir()) for number in range(2)]
    archives = _keep_what_is_the_same(built, out)
    wheel = next(path for path in archives if path.suffix == ".whl")
    _check_wheel(wheel, commit)
    archives += _platform_wheels(wheel, copies, commit, work, out) if with_native else []
    _say("twine check")
    print(run(sys.executable, "-m", "twine", "--no-color", "check", "--strict", *archives).decode(), end="", file=sys.stderr)
    if with_npm:
        _say("npm package, 2 times, and a try of it")
        packed = _keep_what_is_the_same([[path] for path in pack(copies, work / "npm")], out)
        try_package(packed[0], work / "npm_try")
        archives += packed
    archives += _keep_what_is_the_same([pack_add_ons(copy, work / "add_ons" / str(n)) for n, copy in enumerate(copies)], out)
    _say("list of parts, of an environment with the wheel")
    parts = out / f"{wheel.name.rsplit('-', 3)[0]}.cdx.json"
    parts.write_text(list_of_parts(environment_of(wheel, work / "environment"), copies[0] / "pyproject.toml", seconds),
                     encoding="utf-8")
    _write_sums([*archives, parts], out / "SHA256SUMS")


def _say(line):
    print(line, file=sys.stderr, flush=True)


def _build(copy, out, seconds):
    """sdist, and the wheel from it; the sdist's bytes normalised."""
    run(sys.executable, "-m", "build", "--outdir", out, copy, SOURCE_DATE_EPOCH=str(seconds), PYTHONHASHSEED="0",
        PIP_CONSTRAINT=str(REPOSITORY / "tools" / "release" / "constraints.txt"), PIP_DISABLE_PIP_VERSION_CHECK="1")
    for archive in out.glob("*.tar.gz"):
        archive.write_bytes(normalised_tar(archive.read_bytes(), seconds))


def _keep_what_is_the_same(built, out):
    """Moves the first of two builds into out. SystemExit where the second has other names or bytes."""
    first, second = built
    if [path.name for path in first] != [path.name for path in second]:
        raise SystemExit(f"two builds made different files: {first} and {second}")
    for built_once, other in zip(first, second, strict=True):
        if built_once.read_bytes() != other.read_bytes():
            raise SystemExit(f"two builds of {built_once.name} have different bytes")
        print(f"{built_once.name}: twice {hashlib.sha256(built_once.read_bytes()).hexdigest()}", file=sys.stderr)
    return [Path(shutil.move(path, out / path.name)) for path in first]


def _platform_wheels(wheel, copies, commit, work, out):
    """Wheels with the native library, built in both copies."""
    python, built = install_zig(work / "zig"), []
    for number, copy in enumerate(copies):
        folder = work / "wheels" / str(number)
        folder.mkdir(parents=True)
        for platform in PLATFORMS:
            _say(f"native library for {platform.target}, {number + 1} of 2")
            platform_wheel(wheel, platform, build_library(copy, platform, python), folder)
        built.append(sorted(folder.iterdir()))
    wheels = _keep_what_is_the_same(built, out)
    for platform in PLATFORMS:
        _check_wheel(next(path for path in wheels if platform.tag in path.name), commit, PLACE + platform.library)
    return wheels


def _check_wheel(wheel, commit, *built):
    tracked = run("git", "ls-tree", "-r", "-z", "--name-only", commit).decode().split("\0") + list(built)
    with zipfile.ZipFile(wheel) as archive:
        faults = faults_of_contents(archive.namelist(), tracked)
    if faults:
        raise SystemExit("\n".join(faults))


def _write_sums(files, path):
    lines = [f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in sorted(files)]
    path.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
