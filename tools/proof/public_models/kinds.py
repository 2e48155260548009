"""Generated files in each of which one property is the only thing that shows: each coded, decoded, and drawn by another program.

python -m tools.proof.public_models.kinds [--cache out/public_models] [--only WORD...] [--rows FILE.jsonl]

A row tells the property, the program that shows it ("like"), dB of that program's picture against the one without the property
("shows"), dB of the decoded GLB's picture ("decoded"), and the losses that the encoder names. The program is three.js by its own
loader of the format; assimp, whose GLB three.js draws; or construction: three.js draws a GLB that was made to look the same. Exit
code 7: a property is lost and no loss is named.
"""

import argparse
import hashlib
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

from texfcodec.errors import EXIT_DIFFERS, EXIT_INTERNAL
from tools.proof.public_models.judge import LEAST_PICTURE, SIZE_OFF, least_picture, losses_of, reason_of
from tools.proof.public_models.kinds_gltf import gltf_kinds
from tools.proof.public_models.kinds_text import dae_kinds, obj_kinds, ply_kinds
from tools.proof.public_models.listing import PublicModel
from tools.proof.public_models.pictures import draw_pairs
from tools.proof.public_models.rows import add_row
from tools.proof.public_models.run import Inside, code_model

FORMATS = {"COLLADA": dae_kinds, "OBJ and MTL": obj_kinds, "PLY": ply_kinds, "glTF": gltf_kinds}
RATE, INERT = "r04", 38.0  # dB; above it the other program does not show the property either
OK, NAMED, FAULT, UNSHOWN, ERROR = "ok", "named", "FAULT", "not shown", "INTERNAL ERROR"


class Unmeasured(Inside):
    """A Room that measures nothing, because kinds are judged by pictures."""

    def run(self, words, default):
        return {"exit": 0, "seconds": 0.0, "report": {"parts": [], "size": 0.0, "holds": []}, "json": "", "log": ""}


def write_kind(label, kind, cache):
    """Write the files of a Kind below the cache; return (PublicModel, path of the file without the property, path of the file
    with the expected picture), both relative to the cache."""
    folder = Path("files") / "kinds" / f"{re.sub(r'[^A-Za-z0-9_-]+', '_', label)}-1"
    shutil.rmtree(cache / folder, ignore_errors=True)
    like = {"model.glb": kind.expected} if kind.expected else {}
    for part, files in (("with", kind.files), ("without", kind.without), ("like", like)):
        for name, data in files.items():
            (cache / folder / part / name).parent.mkdir(parents=True, exist_ok=True)
            (cache / folder / part / name).write_bytes(data)
    name = next(iter(kind.files))
    model = {"path": f"with/{name}", "sha256": hashlib.sha256(kind.files[name]).hexdigest()}
    entry = PublicModel(label, {"kind": "kinds", "name": folder.name[:-2], "version": "1"}, model)
    paths = [folder / "with" / name, folder / "without" / next(iter(kind.without))]
    for number, path in enumerate(paths if kind.like == "assimp" else ()):
        paths[number] = path.with_name("by_assimp.glb")
        words = ["assimp", "export", path.name, "by_assimp.glb"]
        subprocess.run(words, cwd=(cache / path).parent, check=True, capture_output=True)
    return entry, str(paths[1]), str(folder / "like" / "model.glb" if kind.expected else paths[0])


def run_kinds(form, kinds, args):
    """Code the kinds {label: Kind} of a format and draw them; return [row]. args: of main()."""
    rows = []
    for label, kind in kinds.items():
        entry, without, expected = write_kind(label, kind, args.cache)
        row = code_model(entry, args, None, args.cache / "coded" / "kinds", Unmeasured)
        rows.append(row | {"like": kind.like, "without": without, "expected": expected})
    pairs = [{"source": row["expected"], "mesh": row["without"], "text": row["name"]} for row in rows]
    pairs += [{"source": row["expected"], "mesh": row["mesh"], "text": row["name"]} for row in rows]
    shown = draw_pairs(pairs, args.cache, args.cache / f"pictures-kinds-{form[:3]}")
    return [judged(row, *pictures) for row, *pictures in zip(rows, shown[: len(rows)], shown[len(rows) :], strict=True)]


def judged(row, control, picture):
    """Return the row of a kind with its verdict. control, picture: the facts of three.js on the expected file beside the one
    without the property, and beside the decoded one."""
    exits, losses = [row[step]["exit"] for step in ("encode", "decode") if step in row], losses_of(row) if "decode" in row else []
    shows, decoded = (math.nan if "error" in drawn else min(least_picture(drawn), 99.0) for drawn in (control, picture))
    finite = lambda value: None if math.isnan(value) else round(value, 1)
    refused = "measure" not in row
    sound = decoded >= LEAST_PICTURE and not picture.get("size", 0.0) > SIZE_OFF
    verdict = OK if not refused and sound else NAMED if losses or refused else FAULT
    verdict = UNSHOWN if shows >= INERT else verdict
    verdict = ERROR if any(code is None or code < 0 or code == EXIT_INTERNAL for code in exits) else verdict
    text = losses or [f"refused: {reason_of(row['encode'])}"] if refused else losses
    return {"name": row["name"], "like": row["like"], "shows": finite(shows), "decoded": finite(decoded), "losses": text,
            "verdict": verdict, "code": row["code"], "error": control.get("error") or picture.get("error", "")}


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    parser = argparse.ArgumentParser(prog="kinds", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=Path("out/public_models"), metavar="DIR")
    parser.add_argument("--only", action="append", metavar="WORD", help="properties whose name holds it; repeatable")
    parser.add_argument("--rows", type=Path, metavar="FILE.jsonl", help="[default: kinds.jsonl in the cache]")
    parser.add_argument("--effort", default="fast", help="of the encoder")
    args = parser.parse_args(arguments)
    args.rate = RATE
    verdicts = set()
    for form, kinds_of in FORMATS.items():
        kinds = {f"{form}: {name}": kind for name, kind in kinds_of().items()}
        chosen = {label: kind for label, kind in kinds.items() if not args.only or any(word in label for word in args.only)}
        for row in run_kinds(form, chosen, args) if chosen else ():
            add_row(args.rows or args.cache / "kinds.jsonl", row)
            verdicts.add(row["verdict"])
            print(f"{row['verdict']:14} {row['name']} ({row['like']}): {row['decoded']} dB, without it {row['shows']} dB"
                  f"{'; ' + row['losses'][0][:110] if row['losses'] else ''} {row['error']}", flush=True)
    return EXIT_DIFFERS if {FAULT, ERROR} & verdicts else 0


if __name__ == "__main__":
    sys.exit(main())
