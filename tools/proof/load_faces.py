"""What meshes of many faces, texels and voxels take to encode and to decode to GLB, and how both grow with their number: meshes
of tools/proof/face_meshes.py.

python tools/proof/load_faces.py MESH.glb WARM.glb OPTIONS      encodes both here and decodes them to GLB; JSON on stdout, of MESH
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.plots import load_pyplot
from tools.proof.face_meshes import GENERATORS, glb_of, scan_with_image
from tools.proof.memory import Memory

REPOSITORY = Path(__file__).resolve().parents[2]
SIZES = (10_000, 30_000, 100_000)  # faces
LARGE = {"scan with image": (1_000_000, 3_000_000), "scan with vertex colours": (1_000_000, 3_000_000), "slivers": (1_000_000,),
         "lone triangles": (1_000_000,), "one scroll": (3_000_000,)}  # faces where large ones are asked for, minutes each
SIDES, RESOLUTIONS = (512, 1024, 2048, 4096), (128, 256, 512, 1024)  # of images, for texels; of fields, for voxels
FEW = 10_000  # faces of the scan whose texels or voxels grow
WARM = 1000  # faces of the mesh that every process begins with, so that kernels are there
STEEPEST = 1.25  # exponent of seconds over faces, texels or voxels


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
    """{"seconds" of processor time, of children too, "memory" in bytes beyond what the process held before, "silence", "stage"}
    of call(Report)."""
    from texfcodec.report import Report

    silence, memory, begin = Silence(), Memory(), sum(os.times()[:4])
    call(Report(silence))
    seconds, held = sum(os.times()[:4]) - begin, memory.result()
    return {"seconds": seconds, "memory": held["peak"] - held["idle"], "silence": silence.seconds, "stage": silence.stage}


def run_faces(sizes=SIZES, kinds=tuple(GENERATORS), sides=SIDES, resolutions=RESOLUTIONS, large=False):
    """{"rows": one for each mesh and size: kind, of ("faces", "texels" or "voxels"), count of these, and "encode" and "save" as
    of measured()}. large: whether the sizes of LARGE are among them."""
    rows = []
    for kind in kinds:
        rows += [_row(kind, "faces", GENERATORS[kind], size, {}) for size in (*sizes, *(LARGE.get(kind, ()) if large else ()))]
    for side in sides:
        rows.append(_row("scan over texels", "texels", lambda count, side=side: scan_with_image(count, side), FEW,
                         {"support": "texels", "keep_mesh": True}))
    for resolution in resolutions:
        rows.append(_row("scan over voxels", "voxels", lambda count: scan_with_image(count, SIDES[-2]), FEW,
                         {"support": "voxels", "resolution": resolution, "keep_mesh": True}))
    return {"rows": rows}


def _row(kind, of, make, size, options):
    with tempfile.TemporaryDirectory() as folder:
        path, warm = Path(folder) / "mesh.glb", Path(folder) / "warm.glb"
        mesh = make(size)
        path.write_bytes(glb_of(mesh))
        warm.write_bytes(glb_of(make(WARM)))
        command = [sys.executable, str(REPOSITORY / "tools/proof/load_faces.py"), str(path), str(warm), json.dumps(options)]
        run = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, cwd=REPOSITORY)
    found = json.loads(run.stdout)
    return {"kind": kind, "of": of, "count": len(mesh.faces) if of == "faces" else found[of],
            "encode": found["encode"], "save": found["save"]}


def slopes(found):
    """{kind: {"encode", "save": exponents of seconds}} of what run_faces() found."""
    out = {}
    for kind in dict.fromkeys(row["kind"] for row in found["rows"]):
        own = [row for row in found["rows"] if row["kind"] == kind]
        counts = [row["count"] for row in own]
        out[kind] = {what: exponent(counts, [row[what]["seconds"] for row in own]) for what in ("encode", "save")}
    return out


def draw(found, path):
    """Seconds over counts, a line a kind, encode and save, into a PNG; whether matplotlib is there to do so."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    figure, panels = pyplot.subplots(2, 3, figsize=(12, 7), layout="constrained")
    for row, (what, title) in enumerate((("encode", "encode"), ("save", "decode to GLB"))):
        for column, of in enumerate(("faces", "texels", "voxels")):
            panel = panels[row, column]
            for kind in dict.fromkeys(one["kind"] for one in found["rows"] if one["of"] == of):
                own = [one for one in found["rows"] if one["kind"] == kind]
                panel.plot([one["count"] for one in own], [one[what]["seconds"] for one in own], marker="o", label=kind)
            panel.set(xscale="log", yscale="log", xlabel=of, ylabel=f"processor seconds, {title}")
            panel.grid(True, which="both", alpha=0.3)
            panel.legend(fontsize=7, loc="lower right")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return True


def faces_faults(found):
    """What misses the target: sentences."""
    of = {row["kind"]: row["of"] for row in found["rows"]}
    return [f"{kind}: seconds of {what} grow with the power {power:.2f} of the {of[kind]}"
            for kind, powers in slopes(found).items() for what, power in powers.items() if power > STEEPEST]


def main():
    """The child's side."""
    import warnings

    from texfcodec.api import decode, encode_to_result
    from texfcodec.options import EncodeOptions

    warnings.simplefilter("ignore")  # losses that the meshes have been made to have
    options, folder = EncodeOptions(threads=2, **json.loads(sys.argv[3])), Path(sys.argv[1]).parent
    found = {}
    for name in (sys.argv[2], sys.argv[1]):  # the small one first
        def encoding(report, name=name):
            made = encode_to_result(name, options, report)
            (folder / "made.texf").write_bytes(made.data)
            found.update(voxels=made.counts["voxels"], texels=made.counts["texels"])

        def saving(report):
            decode(folder / "made.texf", report=report).save(folder / "made.glb")

        found.update(encode=measured(encoding))
        found.update(save=measured(saving))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
