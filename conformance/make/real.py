"""Makes conformance/real/: streams of the size and kind that users have, of models that code here generates. They stay as they
are, whatever later encoders write.

    python -m conformance.make.real            # names what is not there yet
    python -m conformance.make.real --add      # makes that; what is there stays as it is
"""

import hashlib
import io
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

HOME = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(HOME), str(HOME.parent / "tests")]  # called as a module or imported by a test

from decode_texfcodec import arrays  # noqa: E402
from gltf_scenes import skinned  # noqa: E402

from conformance.make.__main__ import features  # noqa: E402
from conformance.make.scenes import torus  # noqa: E402
from load.meshes import glb_of, overlapping_components, scan_with_image, scan_with_vertex_colours, slivers  # noqa: E402
from texfcodec import encode, encode_gltf  # noqa: E402
from texfcodec.demo.asset import make_sample  # noqa: E402
from texfcodec.io.load import load  # noqa: E402

FOLDER = HOME / "real"
LODS = (0, 2)
MAPS = ("roughness", "metallic", "occlusion", "emissive", "normal")


def sample_with_maps():
    """The demo asset, whose photographs are maps of its materials as well."""
    scene = make_sample()
    pictures = len(scene.textures)
    maps = lambda n: {name: i % pictures for i, name in enumerate(MAPS, n)}
    scene.materials = [replace(m, maps=maps(n), parameters={"emissive": (1.0, 1.0, 1.0)})
                       if m.texture >= 0 else m for n, m in enumerate(scene.materials)]
    return scene


def combed():
    """A scan with normals that no rule makes again: all lean to one side, the more the higher a corner stands."""
    scene = load(glb_of(scan_with_vertex_colours(2_000)))
    corners = scene.positions[scene.faces].astype(np.float64)
    normals = corners / np.linalg.norm(corners, axis=2, keepdims=True) + 0.3 * np.sin(5 * corners[:, :, 1:2]) * [1.0, 0.0, 0.5]
    scene.corner_normal = (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)
    return scene


def ring():
    """{"vertices", "faces"} of a torus in the cube from -0.5 to 0.5."""
    positions, faces, _ = torus(96, 48)
    low, high = positions.min(axis=0), positions.max(axis=0)
    return {"vertices": (positions - (low + high) / 2) / (high - low).max() * 0.98, "faces": faces}


def shaded(points):
    """Values of the channels at points, as a generator's function gives them."""
    waves = 0.5 + 0.5 * np.sin(points @ np.array([[31.0, 7.0, 3.0], [5.0, 23.0, 11.0], [2.0, 13.0, 29.0]]))
    return {"base_color": waves, "roughness": waves[:, 0], "metallic": (waves[:, 1] > 0.6).astype(np.float64)}


def voxels():
    """Voxels of the ring with values, as in a generator's .npz."""
    side, grid = 64, ring()
    corner = np.concatenate([grid["vertices"][grid["faces"]].mean(axis=1), grid["vertices"]])
    steps = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    cells = np.unique((np.floor((corner + 0.5) * side).astype(np.int64)[:, None] + steps).reshape(-1, 3), axis=0)
    cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
    return {**grid, "voxels": cells, "resolution": side, **shaded((cells + 0.5) / side - 0.5)}


def npz(content):
    """Bytes of an .npz with these arrays."""
    file = io.BytesIO()
    np.savez(file, **content)
    return file.getvalue()


def scan(generator, faces, options, **more):
    return encode(glb_of(generator(faces, **more)), options)


TEXELS = {"support": "texels"}
NEURAL = {"codec": "3dntc", "resident_bytes": 24_000, "steps": 400, "resolution": 128, "fit_engine": "numba"}
SOURCES = {
    "boxes": ("a hundred overlapping boxes, K 200", lambda: scan(overlapping_components, 1_200, {"resolution": 200, "qp": 20})),
    "scan_colours": ("a scan with vertex colours, r03", lambda: scan(scan_with_vertex_colours, 10_000, {"rate": "r03"})),
    "scan_image": ("a scan with an image, r02", lambda: scan(scan_with_image, 10_000, {"rate": "r02"})),
    "scan_k256": ("a scan with an image over voxels, K 256", lambda: scan(scan_with_image, 4_000, {"resolution": 256, "qp": 24})),
    "scan_lossless": ("a scan, lossless", lambda: scan(scan_with_image, 1_000, {"lossless": True, **TEXELS}, side=128)),
    "scan_near_lossless": ("a scan, values at most 2 off",
                           lambda: scan(scan_with_image, 1_000, {"max_error": 2, **TEXELS}, side=192)),
    "scan_neural": ("a scan, 3DNTC", lambda: scan(scan_with_vertex_colours, 2_000, NEURAL)),
    "scan_neural_transport": ("a scan, 3DNTC with coded latents",
                              lambda: scan(scan_with_image, 2_000, {**NEURAL, "transport": True})),
    "scan_normals": ("a scan with normals of its own, r03", lambda: encode(combed(), {"rate": "r03"})),
    "slivers": ("long thin faces, r03, effort fast", lambda: scan(slivers, 8_000, {"rate": "r03", "effort": "fast"})),
    "skinned": ("the mesh of a glTF with a skin, r03", lambda: encode_gltf(skinned().glb(), {"rate": "r03"}).streams[0].data),
    "values_function": ("values of a function of points", lambda: encode({**ring(), "values": shaded}, {"rate": "r02"})),
    "values_voxels": ("a generator's voxels", lambda: encode(npz(voxels()), {"rate": "r03", "effort": "fast"})),
    "vase_k256": ("the demo asset as in the demo, K 256", lambda: encode(make_sample(), {"resolution": 256, "qp": 28})),
    "vase_maps": ("the demo asset with five maps, K 128",
                  lambda: encode(sample_with_maps(), {"resolution": 128, "qp": 30, "effects": "all"})),
    "vase_texels": ("the demo asset over texels, r01", lambda: encode(make_sample(), {"rate": "r01", "support": "texels"})),
}  # fmt: skip


def case_of(title, data):
    """Content of case.json: what two engines of the package decode, as conformance/run.py compares it."""
    lods = {}
    for lod in LODS:
        ours = arrays(data, lod)
        if "3DNTC" not in title and arrays(data, lod, engine="wasm") != ours:
            raise SystemExit(f"{title}, lod {lod}: two engines differ")
        lods[str(lod)] = {name: hashlib.sha256(content).hexdigest() for name, content in sorted(ours.items())}
    return {"title": title, "features": features(SimpleNamespace(data=data)), "lods": lods}


def main(arguments):
    """The command of the module's description."""
    missing = [name for name in SOURCES if not (FOLDER / name / "case.json").is_file()]
    for name in missing:
        if arguments != ["--add"]:
            print(f"{name} is not there")
            continue
        title, make = SOURCES[name]
        data = make()
        (FOLDER / name).mkdir(parents=True, exist_ok=True)
        (FOLDER / name / "in.texf").write_bytes(data)
        (FOLDER / name / "case.json").write_text(json.dumps(case_of(title, data), indent=1) + "\n", encoding="utf-8")
        print(f"{name}: {len(data)} bytes", flush=True)
    return 7 if missing and arguments != ["--add"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
