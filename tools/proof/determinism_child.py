"""What tools/proof/determinism.py runs under each configuration: it codes and decodes what it is told, and says what comes out.

python tools/proof/determinism_child.py < job.json, where the job is {"threads", "cases": [{"name", "source", "options", "stream",
"keep"}]}: source a mesh file, the name of a scene of SCENES, or null where nothing is coded; stream the file that is decoded,
null for the stream just made; keep where the coded stream is put. The first line of stdout holds facts() about the process, every
further one a case: {"name", "stream", "bytes", "arrays", "seconds"} with SHA-256 of the stream and of every decoded array, or
{"name", "error"}. It runs in environments that hold no more than the package needs.
"""

import hashlib
import importlib
import json
import locale
import math
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
if not __package__:  # called as a file
    sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests")]

WIDE = ("AVX2", "AVX512", "X86_V3", "X86_V4", "FMA3")  # names of what AVX2 switched off must not leave on, as numpy says them
WIDE_CORES = ("haswell", "zen", "skylakex", "cooperlake", "sapphirerapids")  # the cores of OpenBLAS that use AVX2
QUESTIONS = 1000  # points that a decoded asset is asked for
COARSER = 2  # levels left out in the second decoding


# What is coded


def tiny_maps():
    """A wavy sheet with maps of normals, roughness and occlusion."""
    from shapes import mapped_sheet, noise, plain_image

    maps = {"normal": plain_image(140, 120, 250), "roughness": noise(3, 8, 8), "occlusion": noise(4, 8, 8)}
    return mapped_sheet(maps, noise(0, 8, 8), cells=3)


def from_shapes(name, *words):
    """Return a function that makes a scene by a function of tests/shapes.py, imported at the call. words: its arguments."""
    return lambda: getattr(importlib.import_module("shapes"), name)(*words)


# A sphere with vertex colours; two textured sheets that cross, one see-through, with metadata; the bundled sample
SCENES = {"tiny sphere": from_shapes("painted_sphere", 3), "tiny sheets": from_shapes("crossing_sheets"), "tiny maps": tiny_maps,
          "sample": lambda: importlib.import_module("texfcodec.demo.asset").make_sample()}


# What comes out


def fingerprint(texf):
    """Return {name: SHA-256} of every decoded array of a Texf."""
    arrays = {"lattice": texf.lattice_positions, "faces": texf.faces, "materials": texf.face_material}
    arrays |= {name: getattr(texf, name) for name in ("sharp_edges", "coded_normals") if getattr(texf, name) is not None}
    for i, unit in enumerate(texf.units):
        if unit.uv is not None:
            arrays[f"unit{i}_uv"] = unit.uv
    for i, field in enumerate(texf.fields):
        arrays[f"field{i}_keys"] = field.keys
        arrays |= {f"field{i}_{name}": plane for name, plane in field.planes.items()}
    return {name: _sha256(np.ascontiguousarray(array).tobytes()) for name, array in arrays.items()}


def answers(texf):
    """Return the SHA-256 of the colours of a Texf at the centres of evenly chosen faces."""
    chosen = np.linspace(0, len(texf.faces) - 1, min(QUESTIONS, len(texf.faces))).astype(np.int64)
    points = texf.positions[texf.faces[chosen]].mean(axis=1)
    return _sha256(texf.query(points, chosen).tobytes() if texf.fields else b"")


def _sha256(content):
    return hashlib.sha256(content).hexdigest()


def row_of(case, threads):
    """Encode and decode a case; return {"name", "stream" (SHA-256), "bytes", "arrays" ({name: SHA-256}), "seconds"}."""
    from texfcodec.api import decode, encode
    from texfcodec.options import DecodeOptions, EncodeOptions

    begin, source = time.perf_counter(), case["source"]
    encoded = None if source is None else encode(SCENES[source]() if source in SCENES else source,
                                                 EncodeOptions(threads=threads, **case["options"]))
    if encoded is not None and case["keep"]:
        Path(case["keep"]).write_bytes(encoded)
    stream = encoded if case["stream"] is None else Path(case["stream"]).read_bytes()
    whole, coarse = (decode(stream, DecodeOptions(threads=threads, lod=lod)) for lod in (0, COARSER))
    arrays = fingerprint(whole) | {f"lod{COARSER}_{name}": fingerprints for name, fingerprints in fingerprint(coarse).items()}
    return {"name": case["name"], "stream": encoded and _sha256(encoded), "bytes": len(stream if encoded is None else encoded),
            "arrays": arrays | {"answers": answers(whole)}, "seconds": round(time.perf_counter() - begin, 2)}


# What the process is


def facts():
    """What a configuration may ask of its process, measured in it and not taken from the settings."""
    import numba

    settled = subprocess.run([sys.executable, "-c", "print(hash('texfcodec'))"], env={**os.environ, "PYTHONHASHSEED": "0"},
                             capture_output=True, check=True).stdout
    return {"python": platform.python_version(), "numpy": np.__version__, "numba": numba.__version__,
            "jit": not numba.config.DISABLE_JIT, "processor": numba.config.CPU_NAME or "this one", "wide": wide_places(),
            "libm": libm(), "decimal point": locale.localeconv()["decimal_point"], "offset to UTC": time.strftime("%z"),
            "UTF-8 mode": sys.flags.utf8_mode, "encoding": locale.getpreferredencoding(False),
            "random hashes": hash("texfcodec") != int(settled), "working folder": os.getcwd()}


def wide_places():
    """Which of numpy, numba and BLAS still use registers or operations of AVX2 and later."""
    core = (np._core if hasattr(np, "_core") else np.core)._multiarray_umath
    wide = {"numpy": any(core.__cpu_features__.get(name) for name in core.__cpu_dispatch__ if name.startswith(WIDE)),
            "numba": _compiles_wide(), "BLAS": any(name.lower().startswith(WIDE_CORES) for name in blas_cores())}
    return [name for name, is_so in wide.items() if is_so]


def _compiles_wide():
    """Whether numba makes code with 32-byte registers of a loop that can use them."""
    import numba

    if numba.config.DISABLE_JIT:
        return False
    scaled = numba.njit(lambda a: a * 2.5 + 1.0)
    scaled(np.ones(64))
    return any(re.search(r"%[yz]mm", text) for text in scaled.inspect_asm().values())


def blas_cores():
    """The cores that every loaded OpenBLAS takes this processor for."""
    import ctypes

    import scipy.linalg  # noqa: F401  # it brings a second one

    maps, cores = Path("/proc/self/maps"), set()
    for library in map(ctypes.CDLL, sorted(set(re.findall(r"\S*openblas\S*\.so\S*", maps.read_text() if maps.exists() else "")))):
        for name in ("openblas_get_corename", "openblas_get_corename64_"):
            for prefix in ("", "scipy_"):
                if (ask := getattr(library, prefix + name, None)) is not None:
                    ask.restype = ctypes.c_char_p
                    cores.add(ask().decode())
    return sorted(cores)


def libm():
    """16 digits over what the C library's functions answer: it has other code for processors without FMA."""
    angles = [0.37 + 0.00123 * i for i in range(20_000)]
    values = [f(x) for f in (math.sin, math.exp, math.log, lambda x: math.pow(x, 2.4)) for x in angles]
    return _sha256(np.array(values).tobytes())[:16]


def main():
    """The command of the module's description."""
    locale.setlocale(locale.LC_ALL, "")  # as a program does that speaks its user's language
    job = json.loads(sys.stdin.buffer.read())
    print(json.dumps(facts()), flush=True)
    for case in job["cases"]:
        try:
            row = row_of(case, job["threads"])
        except Exception as error:  # the other cases still get their turn
            row = {"name": case["name"], "error": f"{type(error).__name__}: {error}"}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
