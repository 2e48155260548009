"""What meshes of many faces take to encode and to decode to GLB, and how both grow with the number of faces: those of
proof/face_meshes.py.

python proof/load_faces.py MESH.glb FOLDER      encodes one here and decodes it to GLB; JSON on stdout
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from proof.face_meshes import GENERATORS, glb_of
from proof.memory import Memory

REPOSITORY = Path(__file__).resolve().parents[1]
SIZES = (10_000, 30_000, 100_000)  # faces
WARM = 1000  # faces of the mesh that every process begins with, so that kernels are there
STEEPEST = 1.25  # exponent of seconds over faces


class Silence:
    """Longest time without a word of progress: processor seconds, and the stage that they belong to."""

    def __init__(self):
        self.seconds, self.stage, self._last, self._at = 0.0, "", time.process_time(), ""

    def __call__(self, stage, done, total):
        now = time.process_time()
        if now - self._last > self.seconds:
            self.seconds, self.stage = now - self._last, self._at or stage
        self._last, self._at = now, stage


def exponent(faces, amounts):
    """Of the power of the number of faces that amounts grow with: least squares over the logarithms."""
    return float(np.polyfit(np.log(faces), np.log(np.maximum(amounts, 1e-9)), 1)[0])


def measured(call):
    """{"seconds" of processor time, "memory" in bytes beyond what the process held before, "silence", "stage"} of
    call(Report)."""
    from texfcodec.report import Report

    silence, memory, begin = Silence(), Memory(), time.process_time()
    call(Report(silence))
    seconds, held = time.process_time() - begin, memory.result()
    return {"seconds": seconds, "memory": held["peak"] - held["idle"], "silence": silence.seconds, "stage": silence.stage}


def run_faces(sizes=SIZES, kinds=tuple(GENERATORS)):
    """{"rows": one for each generator and size: kind, faces, "encode" and "save" as of measured()}."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path, warm = Path(folder) / "mesh.glb", Path(folder) / "warm.glb"
        for kind in kinds:
            warm.write_bytes(glb_of(GENERATORS[kind](WARM)))
            for size in sizes:
                mesh = GENERATORS[kind](size)
                path.write_bytes(glb_of(mesh))
                command = [sys.executable, str(REPOSITORY / "proof" / "load_faces.py"), str(path), str(warm)]
                run = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, cwd=REPOSITORY)
                rows.append({"kind": kind, "faces": len(mesh.faces), **json.loads(run.stdout)})
    return {"rows": rows}


def slopes(found):
    """{kind: {"encode", "save": exponents of seconds}} of what run_faces() found."""
    out = {}
    for kind in dict.fromkeys(row["kind"] for row in found["rows"]):
        own = [row for row in found["rows"] if row["kind"] == kind]
        faces = [row["faces"] for row in own]
        out[kind] = {what: exponent(faces, [row[what]["seconds"] for row in own]) for what in ("encode", "save")}
    return out


def faces_faults(found):
    """What misses the target: sentences."""
    return [f"{kind}: seconds of {what} grow with the power {power:.2f} of the faces" for kind, powers in slopes(found).items()
            for what, power in powers.items() if power > STEEPEST]


def main():
    """The child's side."""
    import warnings

    from texfcodec.api import decode, encode
    from texfcodec.options import EncodeOptions

    warnings.simplefilter("ignore")  # losses that the meshes have been made to have
    options, folder = EncodeOptions(threads=2), Path(sys.argv[1]).parent
    found = {}
    for name in (sys.argv[2], sys.argv[1]):  # the small one first
        def encoding(report, name=name):
            (folder / "made.texf").write_bytes(encode(name, options, report))

        def saving(report):
            decode(folder / "made.texf", report=report).save(folder / "made.glb")

        found = {"encode": measured(encoding), "save": measured(saving)}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
