"""Puts a decoder through the conformance vectors: every array of clause 9 by its SHA-256, every faulty stream by its exit code.

    python conformance/run.py [--decoder "<command>"] [CASE ...]

The command is called as  <command> IN.texf OUT_DIR [--lod L]  and writes geometry.bin, field{i}_keys.bin,
field{i}_group{g}_values.bin and, of fields over texels, field{i}_uv.bin into OUT_DIR. Exit codes: 0 decoded, 3 invalid stream, 5
not supported, 6 over a limit. Without a command our own decoder runs in this process. CASE is a part of a case's path, such as
faulty/ or subset/k33. Exits 0 or 7.
"""

import argparse
import hashlib
import json
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
KINDS = ("subset", "uncommon", "faulty")
# A limit is the decoder's own (clause 10): one that has none finds the same stream invalid.
EXIT_CODES = {"invalid": (3,), "unsupported": (5,), "limit": (6, 3)}


class CommandDecoder:
    """Any decoder as a command. Called with a stream's path and lod: (exit code, {array name: SHA-256}, last line of stderr)."""

    def __init__(self, command, seconds):
        self.command, self.seconds = shlex.split(command), seconds

    def __call__(self, stream, lod):
        with tempfile.TemporaryDirectory() as folder:
            call = [*self.command, str(stream), folder, *(["--lod", str(lod)] if lod else [])]
            try:
                run = subprocess.run(call, capture_output=True, text=True, errors="replace", timeout=self.seconds, check=False)
            except subprocess.TimeoutExpired:
                return None, {}, f"no answer in {self.seconds} seconds"
            files = [path for path in Path(folder).rglob("*") if path.is_file()]
            hashes = {path.relative_to(folder).as_posix(): _sha256(path.read_bytes()) for path in files}
        said = run.stderr.strip().splitlines()
        return run.returncode, hashes, said[-1] if said else ""


class OwnDecoder:
    """texfcodec in this process, with the same answers as a command; `code` keeps the error code of the last stream."""

    def __init__(self):
        import decode_texfcodec

        self.ours, self.code = decode_texfcodec, None

    def __call__(self, stream, lod):
        self.code = None
        try:
            files = self.ours.arrays(stream.read_bytes(), lod)
        except self.ours.TexfError as error:
            self.code = error.code
            return error.exit_code, {}, str(error)
        except Exception as error:  # a decoder raises nothing but coded errors; the other cases still get their turn
            return None, {}, f"{type(error).__name__}: {error}"
        return 0, {f"{name}.bin": _sha256(content) for name, content in files.items()}, ""


def _sha256(content):
    return hashlib.sha256(content).hexdigest()


def faults_of(decoder, folder):
    """What a decoder gets wrong on the case in `folder`: one sentence each, none when it passes."""
    case = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    if "expect" in case:
        return _faults_of_refusal(decoder, folder / "in.texf", case)
    lods = case["lods"].items()
    return [fault for lod, arrays in lods for fault in _faults_of_arrays(decoder, folder / "in.texf", int(lod), arrays)]


def _faults_of_refusal(decoder, stream, case):
    exit_code, _, said = decoder(stream, 0)
    allowed = EXIT_CODES[case["expect"]]
    if exit_code not in allowed:
        return [f"exit code {exit_code}, expected {' or '.join(map(str, allowed))} ({case['title']}) {said}".rstrip()]
    if isinstance(decoder, OwnDecoder) and decoder.code != case["code"]:
        return [f"error {decoder.code}, expected {case['code']}: {said}"]
    return []


def _faults_of_arrays(decoder, stream, lod, arrays):
    exit_code, hashes, said = decoder(stream, lod)
    if exit_code != 0:
        return [f"lod {lod}: exit code {exit_code}: {said}"]
    wanted = {f"{name}.bin": digest for name, digest in arrays.items()}
    missing = [f"lod {lod}: {name} is missing" for name in sorted(wanted.keys() - hashes.keys())]
    unexpected = [f"lod {lod}: {name} is unexpected" for name in sorted(hashes.keys() - wanted.keys())]
    both = sorted(wanted.keys() & hashes.keys())
    return missing + unexpected + [f"lod {lod}: {name} differs" for name in both if hashes[name] != wanted[name]]


def cases(wanted):
    """Folders of the cases whose path holds one of the wanted parts (all, if none is wanted)."""
    folders = [path.parent for kind in KINDS for path in sorted((HERE / kind).glob("*/case.json"))]
    return [f for f in folders if not wanted or any(part in f.relative_to(HERE).as_posix() + "/" for part in wanted)]


def main():
    """The command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decoder", help="command, called as <command> IN.texf OUT_DIR [--lod L]; default: our own")
    parser.add_argument("--seconds", type=float, default=600, help="time that a command has for one stream (default 600)")
    parser.add_argument("cases", nargs="*", metavar="CASE", help="parts of the paths of the cases to run (default all)")
    arguments = parser.parse_args()
    folders = cases(arguments.cases)
    if not folders:
        parser.error("no case has such a path")
    decoder = CommandDecoder(arguments.decoder, arguments.seconds) if arguments.decoder else OwnDecoder()
    failed = 0
    for folder in folders:
        start = time.perf_counter()
        faults = faults_of(decoder, folder)
        failed += bool(faults)
        name, seconds = folder.relative_to(HERE).as_posix(), time.perf_counter() - start
        print(f"FAIL {name}: {'; '.join(faults)}" if faults else f"pass {name} ({seconds:.2f} s)", flush=True)
    print(f"{len(folders) - failed} passed, {failed} failed")
    return 7 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
