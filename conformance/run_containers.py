"""Puts an expander of glTF files with TEXF_stream at primitives through conformance/container/: GLB in, expanded GLB out.

    python conformance/run_containers.py [--expand "<command>"] [CASE ...]

The command is called as  <command> IN.glb OUT.glb  and writes an ordinary GLB with PNG images, or ends with an exit code other
than 0. Without a command our own expand() runs in this process. expected.json of a good case has, for every primitive of
triangles, values at the corners of its faces in order, so that vertices may be merged in any way: positions, normals, stored
attributes and morph targets, and what each texture slot shows at the centres of the faces, bilinearly, whatever the atlas.
Exits 0 or 7. Needs numpy and Pillow.
"""

import argparse
import io
import json
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).resolve().parent
HOME = HERE / "container"
DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TOLERANCES = {"POSITION": 1e-5, "NORMAL": 2e-3}  # others are exact
COLOUR_TOLERANCE = 3.0  # of 255: pictures may be padded or placed in another way
CLAMP = 33071
REFUSALS = (2, 3, 5, 6)  # exit codes


class Glb:
    """An ordinary GLB. root: its JSON."""

    def __init__(self, data):
        length = int.from_bytes(data[12:16], "little")
        self.root, self._binary = json.loads(data[20 : 20 + length]), data[28 + length :]

    def view(self, number):
        """Return (bytes, byteStride or None) of a bufferView."""
        view = self.root["bufferViews"][number]
        begin = view.get("byteOffset", 0)
        return self._binary[begin : begin + view["byteLength"]], view.get("byteStride")

    def accessor(self, number):
        """Return the values of an accessor, [N, width], sparse ones too."""
        entry = self.root["accessors"][number]
        dtype, width = np.dtype(DTYPES[entry["componentType"]]), WIDTHS[entry["type"]]
        values = np.zeros((entry["count"], width), dtype)
        if "bufferView" in entry:
            values = self._rows(entry, dtype, values.shape)
        if "sparse" in entry:
            count, where = entry["sparse"]["count"], entry["sparse"]["indices"]
            rows = self._rows(where, np.dtype(DTYPES[where["componentType"]]), (count, 1))[:, 0]
            values = values.copy()
            values[rows] = self._rows(entry["sparse"]["values"], dtype, (count, width))
        return values

    def _rows(self, entry, dtype, shape):
        data, stride = self.view(entry["bufferView"])
        return np.ndarray(shape, dtype, data, entry.get("byteOffset", 0), (stride or dtype.itemsize * shape[1], dtype.itemsize))

    def pixels(self, texture):
        """Return the image of a texture, uint8 [H, W, 4]."""
        image = self.root["images"][self.root["textures"][texture]["source"]]
        return np.asarray(Image.open(io.BytesIO(self.view(image["bufferView"])[0])).convert("RGBA"))


def primitives_of(data):
    """Return what expected.json has of an expanded GLB: a dict for each primitive of triangles, arrays by name."""
    glb = Glb(data)
    return [_corners(glb, primitive) for mesh in glb.root["meshes"] for primitive in mesh["primitives"]
            if primitive.get("mode", 4) == 4]


def _corners(glb, primitive):
    """Return values at the corners of a primitive's faces, and what its slots show at the centres of its faces."""
    index = glb.accessor(primitive["indices"])[:, 0]
    arrays = {name: glb.accessor(number)[index] for name, number in primitive["attributes"].items()}
    for n, target in enumerate(primitive.get("targets", ())):
        arrays |= {f"target {n} {name}": glb.accessor(number)[index] for name, number in target.items()}
    for name, info in _slots(glb.root["materials"][primitive["material"]]) if "material" in primitive else ():
        pixels = glb.pixels(info["index"])
        centre = arrays[f"TEXCOORD_{info.get('texCoord', 0)}"].reshape(-1, 3, 2).astype(np.float64).mean(axis=1)
        sampler = glb.root.get("samplers", [{}])[glb.root["textures"][info["index"]].get("sampler", 0)]
        arrays[name] = _bilinear(pixels.astype(np.float64), centre, [sampler.get(wrap) for wrap in ("wrapS", "wrapT")])
    return arrays


def _bilinear(pixels, uv, wraps):
    """Return an image's values at UVs, float64 [N, 4]. wraps: of glTF, of each axis; what is not CLAMP_TO_EDGE repeats."""
    size = np.array(pixels.shape[1::-1])
    low = np.floor(uv * size - 0.5)
    share, out = uv * size - 0.5 - low, 0.0
    for right, down in np.ndindex(2, 2):
        column, row = ((low[:, k] + step).clip(0, size[k] - 1) if wraps[k] == CLAMP else (low[:, k] + step) % size[k]
                       for k, step in enumerate((right, down)))
        weight = abs(1 - right - share[:, 0]) * abs(1 - down - share[:, 1])
        out = out + weight[:, None] * pixels[row.astype(np.int64), column.astype(np.int64)]
    return out


def _slots(entry):
    """Return (name, textureInfo) of a material's slots."""
    places = (entry, entry.get("pbrMetallicRoughness", {}))
    return [(name, info) for place in places for name, info in place.items() if name.endswith("Texture")]


def faults_of_arrays(data, expected):
    """Return a sentence for each array of an expanded GLB that is not the expected one."""
    try:
        primitives = primitives_of(data)
    except (IndexError, KeyError, TypeError, ValueError) as error:
        return [f"the GLB cannot be read: {type(error).__name__}: {error}"]
    if len(primitives) != len(expected):
        return [f"{len(primitives)} primitives of triangles instead of {len(expected)}"]
    faults = []
    for number, (arrays, wanted) in enumerate(zip(primitives, expected, strict=True)):
        for name, values in wanted.items():
            given = arrays.get(name, np.zeros((0, 0))).astype(np.float64)
            tolerance = COLOUR_TOLERANCE if name.endswith("Texture") else TOLERANCES.get(name, 0.0)
            if given.shape != np.shape(values) or (np.abs(given - np.array(values, np.float64)) > tolerance).any():
                faults.append(f"{name} of primitive {number} differs")
    return faults


def faults_of(expand, folder):
    """Return what an expander gets wrong on the case in a folder. expand: GLB -> (exit code, GLB or b"", what it says)."""
    case = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
    exit_code, data, said = expand((folder / "in.glb").read_bytes())
    if "code" in case:
        faults = [] if exit_code in REFUSALS else [f"exit code {exit_code} for a faulty file: {said}"]
        return faults or ([] if not said.startswith("TXF-") or said.startswith(case["code"]) else [f"{said} for {case['code']}"])
    return [f"exit code {exit_code}: {said}"] if exit_code else faults_of_arrays(data, case["primitives"])


def own(data):
    """Expand a GLB by texfcodec; as the answer of a command."""
    sys.path.insert(0, str(HERE.parent))  # the checkout this file is in, installed or not
    from texfcodec import expand
    from texfcodec.errors import TexfError

    try:
        return 0, expand(data, texture_format="png"), ""
    except TexfError as error:
        return error.exit_code, b"", str(error)


def by_command(command):
    """Return the expander of a command."""
    def expand(data):
        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder) / "in.glb", Path(folder) / "out.glb"
            source.write_bytes(data)
            run = subprocess.run([*shlex.split(command), str(source), str(target)], capture_output=True, text=True, timeout=600,
                                 check=False)
            said = (run.stderr.strip().splitlines() or [""])[-1]
            return run.returncode, target.read_bytes() if target.exists() else b"", said

    return expand


def main():
    """Run the command of the module's description."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--expand", help="command, called as <command> IN.glb OUT.glb; default: our own")
    parser.add_argument("cases", nargs="*", metavar="CASE", help="parts of the names of the cases to run (default all)")
    arguments = parser.parse_args()
    expand, failed = by_command(arguments.expand) if arguments.expand else own, 0
    folders = [path.parent for path in sorted(HOME.glob("*/expected.json"))]
    for folder in folders:
        if not arguments.cases or any(part in folder.name for part in arguments.cases):
            faults = faults_of(expand, folder)
            failed += bool(faults)
            print(f"FAIL {folder.name}: {'; '.join(faults)}" if faults else f"pass {folder.name}", flush=True)
    return 7 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
