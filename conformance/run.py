"""Puts a decoder through the conformance vectors: every array of clause 9 by its SHA-256, every faulty stream by its exit code.

    python conformance/run.py [--decoder "<command>" [--queries]] [--home FOLDER] [CASE ...]

The command is called as  <command> IN.texf OUT_DIR [--lod L]  and writes geometry.bin, field{i}_keys.bin,
field{i}_group{g}_values.bin and, of fields over texels, field{i}_uv.bin into OUT_DIR. Exit codes: 0 decoded, 3 invalid stream, 5
not supported, 6 over a limit. With --queries, vectors that ask points (clause 8.2) give it  --queries FILE  as well, for which
it writes group{g}_answers.bin; README.md says how. Without a command our own decoder runs in this process. CASE is a part of a
case's path, such as faulty/ or subset/k33. Exits 0 or 7.
"""

import argparse
import hashlib
import json
import shlex
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
KINDS = ("subset", "uncommon", "faulty", "real")
# A limit is the decoder's own (clause 10): one that has none finds the same stream invalid.
EXIT_CODES = {"invalid": (3,), "unsupported": (5,), "limit": (6, 3)}


class CommandDecoder:
    """Any decoder as a command. Called with a stream's path, lod and queries (bytes, may be none): (exit code, {file name:
    bytes}, last line of stderr). asks: whether it knows --queries."""

    def __init__(self, command, seconds, asks=False):
        self.command, self.seconds, self.asks = shlex.split(command), seconds, asks

    def __call__(self, stream, lod, queries=b""):
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as apart:
            call = [*self.command, str(stream), folder, *(["--lod", str(lod)] if lod else [])]
            if queries:
                query_file = Path(apart) / "queries.bin"
                query_file.write_bytes(queries)
                call += ["--queries", str(query_file)]
            try:
                run = subprocess.run(call, capture_output=True, text=True, errors="replace", timeout=self.seconds, check=False)
            except subprocess.TimeoutExpired:
                return None, {}, f"no answer in {self.seconds} seconds"
            files = [path for path in Path(folder).rglob("*") if path.is_file()]
            written = {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
        said = run.stderr.strip().splitlines()
        return run.returncode, written, said[-1] if said else ""


class OwnDecoder:
    """texfcodec in this process, with the same answers as a command; `code` keeps the error code of the last stream."""

    asks = True

    def __init__(self):
        import decode_texfcodec

        self.ours, self.code = decode_texfcodec, None

    def __call__(self, stream, lod, queries=b""):
        self.code = None
        try:
            files = self.ours.arrays(stream.read_bytes(), lod, queries=queries)
        except self.ours.TexfError as error:
            self.code = error.code
            return error.exit_code, {}, str(error)
        except Exception as error:  # a decoder raises nothing but coded errors; the other cases still get their turn
            return None, {}, f"{type(error).__name__}: {error}"
        return 0, {f"{name}.bin": content for name, content in files.items()}, ""


def _sha256(content):
    return hashlib.sha256(content).hexdigest()


def faults_of(decoder, folder):
    """What a decoder gets wrong on the case in `folder`: one sentence each, none when it passes."""
    case = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    if "expect" in case:
        return _faults_of_refusal(decoder, folder / "in.texf", case)
    expected, faults = queries_of(folder), []
    for lod, arrays in case["lods"].items():
        queries = expected["lods"].get(lod, []) if decoder.asks else []
        exit_code, files, said = decoder(folder / "in.texf", int(lod), packed(queries))
        levels = {name: files.pop(name) for name in [name for name in files if name.endswith("_levels.bin")]}
        faults += [f"lod {lod}: {fault}" for fault in _faults_of_levels(levels, case.get("levels", {}))]
        if exit_code != 0:
            faults.append(f"lod {lod}: exit code {exit_code}: {said}")
            continue
        answers = {name: files.pop(name, b"") for name in [name for name in files if queries and name.endswith("_answers.bin")]}
        sentences = _faults_of_arrays(files, arrays) + (faults_of_answers(answers, queries, expected) if queries else [])
        faults += [f"lod {lod}: {fault}" for fault in sentences]
    return faults


def _faults_of_refusal(decoder, stream, case):
    exit_code, _, said = decoder(stream, 0)
    allowed = EXIT_CODES[case["expect"]]
    if exit_code not in allowed:
        return [f"exit code {exit_code}, expected {' or '.join(map(str, allowed))} ({case['title']}) {said}".rstrip()]
    if isinstance(decoder, OwnDecoder) and decoder.code != case["code"]:
        return [f"error {decoder.code}, expected {case['code']}: {said}"]
    return []


def _faults_of_arrays(files, arrays):
    wanted = {f"{name}.bin": digest for name, digest in arrays.items()}
    missing = [f"{name} is missing" for name in sorted(wanted.keys() - files.keys())]
    unexpected = [f"{name} is unexpected" for name in sorted(files.keys() - wanted.keys())]
    both = sorted(wanted.keys() & files.keys())
    return missing + unexpected + [f"{name} differs" for name in both if _sha256(files[name]) != wanted[name]]


def _faults_of_levels(files, levels):
    """One sentence for each file of checksums of levels, which no decoder has to write, that has another one than the case."""
    out = []
    for name, content in files.items():
        wanted = [int(digits, 16).to_bytes(4, "little") for digits in levels.get(name.removesuffix("_levels.bin"), [])]
        given = [content[at : at + 4] for at in range(0, len(content), 4)]
        wrong = [n for n, check in enumerate(given) if check not in wanted[n : n + 1]]
        out += [f"{name}: level {wrong[0]} is the first that differs"] if wrong else []
    return out


# Queries


def queries_of(folder):
    """Content of queries.json: components, tolerance and queries by lod; nothing is asked where there is no such file."""
    path = folder / "queries.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"lods": {}}


def packed(queries):
    """40 bytes a query: field and triangle as 64-bit integers, the point as three binary64, little endian."""
    return b"".join(struct.pack("<2q3d", q["field"], q["triangle"], *map(float.fromhex, q["point"])) for q in queries)


def faults_of_answers(files, queries, expected):
    """One sentence for the first query whose answers are none of those that are right, and for files of a wrong size."""
    columns = []
    for group, count in enumerate(expected["components"]):
        content = files.get(f"group{group}_answers.bin", b"")
        if len(content) != 8 * count * len(queries):
            return [f"group{group}_answers.bin has {len(content)} bytes, not {8 * count * len(queries)}"]
        columns.append(list(struct.iter_unpack(f"<{count}d", content)))
    answers = [[number for part in parts for number in part] for parts in zip(*columns, strict=True)]
    wrong = [n for n, answer in enumerate(answers) if not _is_one_of(answer, queries[n]["answers"], expected["tolerance"])]
    if not wrong:
        return []
    first = queries[wrong[0]]
    return [f"{len(wrong)} of {len(queries)} queries are answered wrong, the first is {wrong[0]} ({first['why']}): "
            f"{answers[wrong[0]]} instead of {' or '.join(map(str, first['answers']))}"]


def _is_one_of(answer, right, tolerance):
    """Whether all components that are asked are right at once. right: lists of components, None for those that are not asked."""
    return any(all(v is None or abs(a - v) <= tolerance for a, v in zip(answer, expected, strict=True)) for expected in right)


def cases(wanted, home=HERE):
    """Folders of the cases whose path holds one of the wanted parts (all, if none is wanted)."""
    folders = [path.parent for kind in KINDS for path in sorted((home / kind).glob("*/case.json"))]
    return [f for f in folders if not wanted or any(part in f.relative_to(home).as_posix() + "/" for part in wanted)]


def main():
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decoder", help="command, called as <command> IN.texf OUT_DIR [--lod L]; default: our own")
    parser.add_argument("--queries", action="store_true", help="the command knows --queries FILE (clause 8.2)")
    parser.add_argument("--seconds", type=float, default=600, help="time that a command has for one stream (default 600)")
    parser.add_argument("--home", type=Path, default=HERE, help="folder of other cases, with folders of the same names")
    parser.add_argument("cases", nargs="*", metavar="CASE", help="parts of the paths of the cases to run (default all)")
    arguments = parser.parse_args()
    folders = cases(arguments.cases, arguments.home)
    if not folders:
        parser.error("no case has such a path")
    decoder = CommandDecoder(arguments.decoder, arguments.seconds, arguments.queries) if arguments.decoder else OwnDecoder()
    failed = 0
    for folder in folders:
        start = time.perf_counter()
        faults = faults_of(decoder, folder)
        failed += bool(faults)
        name, seconds = folder.relative_to(arguments.home).as_posix(), time.perf_counter() - start
        left = 0 if decoder.asks else sum(map(len, queries_of(folder)["lods"].values()))
        passed = f"pass {name} ({seconds:.2f} s)" + (f", {left} queries not asked" if left else "")
        print(f"FAIL {name}: {'; '.join(faults)}" if faults else passed, flush=True)
    print(f"{len(folders) - failed} passed, {failed} failed")
    return 7 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
