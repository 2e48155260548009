"""Streams of public models, which the repository does not hold, decode to the same values in every release: public_streams.json
has, by the SHA-256 of each, the model's name and the SHA-256 of what it decodes to.

    python -m tools.release.public_streams FOLDER            # decodes the listed streams below the folder; exit 7 if one differs
    python -m tools.release.public_streams FOLDER --add 100  # adds up to so many of them, as many of each package as can be

A run of `make -C tools public-models` leaves streams in CACHE/coded.
"""

import argparse
import hashlib
import json
import sys
from itertools import chain, zip_longest
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("public_streams.json")


def read_list() -> dict[str, list[str]]:
    """Return {SHA-256 of a stream: [model, SHA-256 of what it decodes to]}."""
    return json.loads(LIST.read_text(encoding="utf-8")) if LIST.is_file() else {}


def streams_below(folder: Path) -> dict[str, Path]:
    """Return {SHA-256: path} of the .texf files below a folder, by path."""
    return {hashlib.sha256(path.read_bytes()).hexdigest(): path for path in sorted(folder.rglob("*.texf"), reverse=True)}


def decoded_hash(data: bytes) -> str:
    """Return the SHA-256 of the names and SHA-256 of all arrays of clause 9 that a stream decodes to."""
    if str(REPOSITORY / "conformance") not in sys.path:
        sys.path.insert(0, str(REPOSITORY / "conformance"))
    from decode_texfcodec import arrays

    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in arrays(data).items()}
    return hashlib.sha256(json.dumps(hashes, sort_keys=True).encode()).hexdigest()


def compared(listed: dict[str, list[str]], streams: dict[str, Path]) -> dict[str, list[str]]:
    """Return the names of models whose streams are "matched", "differing" and "absent"."""
    out: dict[str, list[str]] = {"matched": [], "differing": [], "absent": []}
    for stream, (name, values) in listed.items():
        kind = "absent" if stream not in streams else "differing"
        if stream in streams:
            try:
                kind = "matched" if decoded_hash(streams[stream].read_bytes()) == values else kind
            except Exception as error:  # a refusal differs, and the others still have their turn
                name = f"{name}: {error}"
        out[kind].append(name)
    return out


def chosen(streams: dict[str, Path], most: int) -> list[str]:
    """Return up to `most` streams: of each package, a folder, the largest first, in turns."""
    packages: dict[Path, list[str]] = {}
    for stream, path in sorted(streams.items(), key=lambda item: (-item[1].stat().st_size, item[1])):
        packages.setdefault(path.parent, []).append(stream)
    turns = chain.from_iterable(zip_longest(*(packages[folder] for folder in sorted(packages))))
    return [stream for stream in turns if stream][:most]


def main(arguments: list[str] | None = None) -> int:
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--add", type=int, default=0, metavar="MOST", help="add up to so many streams of the folder to the list")
    given = parser.parse_args(arguments)
    listed, streams = read_list(), streams_below(given.folder)
    if given.add:
        for stream in chosen({key: path for key, path in streams.items() if key not in listed}, given.add):
            path = streams[stream]
            listed[stream] = [f"{path.parent.name.replace('__', '/')}/{path.stem}", decoded_hash(path.read_bytes())]
        lines = [f" {json.dumps(key)}: {json.dumps(row)}" for key, row in sorted(listed.items(), key=lambda row: row[1])]
        LIST.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    names = compared(listed, streams)
    print("\n".join(f"differs: {name}" for name in names["differing"]))
    print(", ".join(f"{len(models)} {kind}" for kind, models in names.items()) + f", of {len(listed)} listed")
    return 0 if names["matched"] and not names["differing"] else 7


if __name__ == "__main__":
    sys.exit(main())
