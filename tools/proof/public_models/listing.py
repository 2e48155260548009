"""The list of public models: packages of public registries by name, version and hash, and the models in them that are coded.

public_models.json has a row for each package: kind (npm, pypi or debian), name, version, archive, sha256, licence, round, and its
models: path, sha256, bytes, and the other files that a model reads or names, {path: sha256}. Paths are those in the package. A
round is what was added at one time: 1, where it is missing.
"""

import hashlib
import json
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from texfcodec.io.formats import SUFFIXES
from texfcodec.io.load import load
from tools.proof.public_models.fetch import Unfetched, archive_of, licence_of, members, unpack

LIST = Path(__file__).with_name("public_models.json")
LARGEST = 24 << 20  # bytes of a model's own file; larger ones take minutes each and show nothing that smaller ones do not


@dataclass(frozen=True)
class PublicModel:
    """A model of the list. name: PACKAGE/PATH, unique; package, model: its two rows of the list."""

    name: str
    package: dict
    model: dict

    @property
    def suffix(self):
        return PurePosixPath(self.model["path"]).suffix.lower()

    def folder(self, cache):
        """Return the folder below the cache with the unpacked models of its package."""
        return cache / "files" / self.package["kind"] / f"{self.package['name'].replace('/', '__')}-{self.package['version']}"

    def path(self, cache):
        """Return the model's path below the cache, where it is once its package has been fetched."""
        return self.folder(cache) / self.model["path"]


def read_list(path=LIST):
    """Return the package rows of the list."""
    return json.loads(path.read_text(encoding="utf-8"))["packages"]


def write_list(packages, path=LIST):
    """Write the list, one model per line, so that differences are readable. packages: its rows."""
    lines = []
    for package in sorted(packages, key=lambda row: (row["kind"], row["name"])):
        head = json.dumps({key: value for key, value in package.items() if key != "models"})
        models = ",\n  ".join(json.dumps(model) for model in package["models"])
        lines.append(f' {head[:-1]}, "models": [\n  {models}]}}')
    path.write_text('{"packages": [\n' + ",\n".join(lines) + "\n]}\n", encoding="utf-8")


def entries_of(packages):
    """Return the PublicModels of package rows, sorted by their hashes, so that the first N are a fair sample."""
    entries = [PublicModel(f"{package['name']}/{model['path']}", package, model) for package in packages
               for model in package["models"]]
    return sorted(entries, key=lambda entry: (entry.model["sha256"], entry.name))


def add_package(text, cache, packages, number=1, largest=LARGEST):
    """Return the package rows with one more, or with that one replaced. text: KIND:NAME:VERSION:MOST, where at most MOST models
    are taken, evenly over formats and sizes; number: of the round; largest: bytes of a model."""
    if not (match := re.fullmatch(r"(\w+):(.+?):(.+):(\d+)", text)):
        raise SystemExit(f"--add takes KIND:NAME:VERSION:MOST, not {text!r}")
    kind, name, version, most = match.groups()
    package = {"kind": kind, "name": name, "version": version}
    try:
        archive = archive_of(package, cache)
    except Unfetched:
        if kind != "pypi":
            raise
        archive = archive_of(package | {"archive": "any.tar.gz"}, cache)  # a package that may have no wheel
    package |= {"archive": archive.name, "sha256": _digest(archive.read_bytes()), "licence": licence_of(kind, archive)}
    package |= {"round": number} if number > 1 else {}
    seen = {model["sha256"] for row in packages if (row["kind"], row["name"]) != (kind, name) for model in row["models"]}
    with tempfile.TemporaryDirectory(dir=cache) as folder:
        unpack(archive, None, Path(folder))
        there = {}
        for file in Path(folder).resolve().rglob("*"):
            there.setdefault(file.name.lower(), []).append(file)
        package["models"] = [_model(Path(folder), path, there) for path in _chosen(archive, int(most), seen, largest)]
    return [row for row in packages if (row["kind"], row["name"]) != (kind, name)] + [package]


def _chosen(archive, most, known, largest):
    """Paths of `most` models of an archive: of every format its share, evenly spread over sizes; of equal files the first, and
    none whose hash is known."""
    sizes, seen = {}, set(known)
    for path, data in members(archive, lambda name: name.lower().endswith(SUFFIXES)):
        digest = _digest(data)
        if 0 < len(data) <= largest and digest not in seen:
            seen.add(digest)
            sizes[path] = len(data)
    groups = {}
    for path in sorted(sizes, key=lambda path: (sizes[path], path)):
        groups.setdefault(PurePosixPath(path).suffix.lower(), []).append(path)
    chosen, left = [], min(most, len(sizes))
    for number, group in enumerate(sorted(groups.values(), key=len)):
        share = min(len(group), left // (len(groups) - number))
        chosen += [group[i * len(group) // share] for i in range(share)]
        left -= share
    return sorted(chosen)


def _model(folder, path, there):
    """The list's row of a model of an unpacked package: what its loader reads beside it goes with it, and what it names."""
    data = (folder / path).read_bytes()
    row = {"path": path, "sha256": _digest(data), "bytes": len(data)}
    try:
        files = [Path(name).resolve() for name in load(folder / path).files]
    except Exception:  # a model that cannot be loaded is one to be shown by the run, not here
        files = []
    root = folder.resolve()
    files += _named(root / path, there)
    beside = {str(file.relative_to(root).as_posix()): file for file in files if file.is_file() and root in file.parents}
    more = {name: _digest(file.read_bytes()) for name, file in sorted(beside.items()) if name != path}
    return row | ({"with": more} if more else {})


SUFFIX = re.compile(rb"\.(?:mtl|bin|png|jpe?g|bmp|tga|gif|webp|dds|ktx2?|tiff?)\b", re.IGNORECASE)
TEXTS = {".obj": None, ".dae": None, ".gltf": None, ".glb": 1 << 20, ".ply": 4096, ".mtl": None}  # bytes that may hold names


def _names_in(data):
    """Names of files in a text, lower-case; of one with spaces also what follows each of them, for "map_Kd -s 1 1 1 a b.png"."""
    for hit in SUFFIX.finditer(data):
        before = re.split(rb"[\\/\"'<>\r\n=:]", data[max(hit.start() - 200, 0) : hit.start()])[-1]
        words = (before + hit.group()).decode("utf-8", "replace").lower().split(" ")
        yield from (" ".join(words[n:]).strip() for n in range(len(words)))


def _named(path, there):
    """Files of a package whose names stand in a model, whatever our own reader makes of them. there: {name: [path]}."""
    named, todo = set(), [path]
    while todo:
        file = todo.pop()
        if file.suffix.lower() in TEXTS:
            names = set(_names_in(file.read_bytes()[: TEXTS[file.suffix.lower()]]))
            new = {near for name in names for near in there.get(name, []) if len(there[name]) <= 4} - named
            named |= new
            todo += [near for near in new if near.suffix.lower() == ".mtl"]
    return sorted(named)


def _digest(data):
    return hashlib.sha256(data).hexdigest()
