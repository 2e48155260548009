"""What tests/load/run.py measures, a run_...() for each part; most of it in child processes of this file.

python tests/load/parts.py CHILD ARGUMENT...      one of CHILDREN here, its answer as JSON on stdout
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[2] / "tests")]

from load.meshes import GENERATORS, glb_of, scan_with_image
from texfcodec.api import decode, encode_to_result
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import TexfError
from texfcodec.field.voxelise import count_samples
from texfcodec.field.voxels import VoxelSupport
from texfcodec.limits import LEVELS
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report
from tools.proof.determinism import TINY
from tools.proof.memory import Memory, resident

REPOSITORY = Path(__file__).resolve().parents[2]
HERE, CONFORMANCE = os.environ | {"PYTHONPATH": f"{REPOSITORY}{os.pathsep}{REPOSITORY / 'tests'}"}, REPOSITORY / "conformance"
FAULTY = CONFORMANCE / "faulty"


def child(*words, text="", **variables):
    """Lines of JSON that one of CHILDREN answers, in a process of its own."""
    run = subprocess.run([sys.executable, __file__, *map(str, words)], input=text, stdout=subprocess.PIPE, check=True, text=True,
                         cwd=REPOSITORY, env=HERE | variables)
    return [json.loads(line) for line in run.stdout.splitlines()]


def coded(scene, **options):
    """The stream of a scene, encoded fast."""
    return encode_scene(scene, EncodeOptions(**{"effort": "fast", "threads": 2} | options)).data


# The same again and again

CALLS, WARM = 500, 0.3  # of a kind; the first part of the calls, in which caches and the allocator's arenas fill
REFUSED_AT_ONCE = 25  # faulty vectors that one call reads


def slope_of(call, count):
    """Calls call(i) for i below count. {"calls", "bytes a call", "error", "first", "last"}: the slope of resident memory by least
    squares after the first part of the calls, its standard error, and the memory at the ends of what was fitted."""
    sizes = np.zeros(count)
    for i in range(count):
        call(i)
        sizes[i] = resident("VmRSS")
    number, size = np.arange(int(WARM * count), count), sizes[int(WARM * count):]
    centred = number - number.mean()
    slope = centred @ size / (centred @ centred)
    left = size - size.mean() - slope * centred
    error = np.sqrt(left @ left / max(len(left) - 2, 1) / (centred @ centred))
    return {"calls": count, "bytes a call": round(float(slope)), "error": round(float(error)), "first": int(size[0]),
            "last": int(size[-1])}


def small_scenes():
    """[(Scene, EncodeOptions)] of seven kinds: voxels, texels, alpha, maps, lossless, fast, 3DNTC."""
    from shapes import crossing_sheets, mapped_sheet, noise, painted_sphere, plain_image

    maps = {"normal": plain_image(140, 120, 250), "roughness": noise(3), "occlusion": noise(4)}
    rows = ((painted_sphere(6), {"resolution": 32, "qp": 24}), (crossing_sheets(), {"resolution": 24, "qp": 30}),
            (crossing_sheets(), {"support": "texels", "resolution": 24, "qp": 30}),
            (mapped_sheet(maps), {"resolution": 24, "qp": 30}), (painted_sphere(5), {"resolution": 20, "lossless": True}),
            (painted_sphere(4), {"resolution": 48, "qp": 34, "effort": "fast"}),
            (painted_sphere(4), {"codec": "3dntc", "resolution": 16, "steps": 8, "point": "mpeg1"}))
    return [(scene, EncodeOptions(threads=2, **options)) for scene, options in rows]


def refuse(data):
    """Exit code of decoding, 0 where the stream is accepted."""
    try:
        decode(data, DecodeOptions(threads=1))
        return 0
    except TexfError as error:
        return error.exit_code


def _calls_of(kind):
    """call(i) of a kind: what is done again and again."""
    if kind == "refuse":
        vectors = itertools.cycle([path.read_bytes() for path in sorted(FAULTY.glob("*/in.texf"))])
        return lambda i: [refuse(data) for data in itertools.islice(vectors, REFUSED_AT_ONCE)]
    scenes, rng, folder = small_scenes(), np.random.default_rng(0), tempfile.TemporaryDirectory()
    if kind in ("encode", "both"):
        return lambda i: [decode(data) if kind == "both" else data for data in [encode_scene(*scenes[i % len(scenes)]).data]]
    streams = [encode_scene(*row).data for row in scenes]
    if kind == "decode":
        return lambda i: decode(streams[i % len(streams)])
    assets = list(map(decode, streams))
    if kind == "save":
        return lambda i: assets[i % len(assets)].save(Path(folder.name) / "a.glb", texture_size=64)

    def query(i):
        texf = assets[i % len(assets)]
        face = rng.integers(0, len(texf.faces), 2000)
        texf.query(texf.positions[texf.faces[face]].mean(axis=1), face)

    return query


KINDS = {"encode": "encode", "decode": "decode", "encode and decode": "both", "query": "query", "save GLB": "save",
         f"{REFUSED_AT_ONCE} faulty vectors refused": "refuse"}


def run_slopes(calls=CALLS, kinds=tuple(KINDS)):
    """{kind: slope_of()}, each in a process whose allocator has one arena: glibc gives threads one each until there are eight a
    core, and what an arena keeps looks like a leak until all are in use."""
    return {kind: child("slope", KINDS[kind], calls, MALLOC_ARENA_MAX="1")[0] for kind in kinds}


# Processes at once

VECTORS = ("subset/k33", "subset/texels", "subset/maps_texels", "subset/neural_resident", "uncommon/filter_slices",
           "uncommon/slices_two_groups")


def cases_of(scenes, vectors=VECTORS):
    """The cases of a job of determinism_child: scenes that are coded and decoded, vectors that are decoded."""
    every = [{"name": name, "source": name, "options": TINY[name], "stream": None} for name in scenes]
    every += [{"name": name, "source": None, "options": {}, "stream": str(CONFORMANCE / name / "in.texf")} for name in vectors]
    return [{"keep": None, **case} for case in every]


def together(count, cases, cache=None):
    """(seconds, [{"exit code", "said", "rows"}]) of so many processes at once. Each begins at another of the cases, so that
    different kernels, and kernels for different types, are compiled together. cache: folder of kernels, not the usual one."""
    variables, begin, children = os.environ | ({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}), time.monotonic(), []
    for i in range(count):
        words = [sys.executable, str(REPOSITORY / "tools/proof/determinism_child.py")]
        children.append(subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                         env=variables, text=True, cwd=REPOSITORY))
        children[-1].stdin.write(json.dumps({"threads": 2, "cases": cases[i % len(cases):] + cases[: i % len(cases)]}))
        children[-1].stdin.close()
    answers = []
    for process in children:
        said, log = process.stdout.read(), process.stderr.read()
        rows = {row.pop("name"): row | {"seconds": 0} for row in map(json.loads, said.splitlines()[1:])}
        answers.append({"exit code": process.wait(), "said": log[-500:] if process.returncode else "", "rows": rows})
    return time.monotonic() - begin, answers


def wrong(answers, expected):
    """Sentences about processes that ended badly, and rows that are not the expected ones."""
    for number, answer in enumerate(answers, 1):
        if answer["exit code"]:
            yield f"process {number} ended with {answer['exit code']}: {answer['said']}"
        yield from (f"process {number}, {name}: {answer['rows'].get(name, {}).get('error', 'another result')}"
                    for name, row in expected.items() if answer["rows"].get(name) != row or "error" in row)


def run_together(count=8, scenes=tuple(TINY), vectors=VECTORS):
    """{"processes", "alone", "warm", "cold", "after"}: seconds and faults of one process, of many with compiled kernels, of many
    with an empty cache, and of one that comes after these, with the number of files that it changed."""
    every, cold = cases_of(scenes, vectors), cases_of(scenes[:1], vectors)
    seconds, answers = together(1, every)
    expected = answers[0]["rows"]
    found = {"processes": count, "alone": {"seconds": seconds, "faults": list(wrong(answers, expected))}}
    few = {case["name"]: expected.get(case["name"], {}) for case in cold}
    with tempfile.TemporaryDirectory() as folder:
        files = lambda: {path: path.stat().st_mtime_ns for path in Path(folder).rglob("*.nb[ci]")}
        rows = ("warm", count, every, expected), ("cold", count, cold, few), ("after", 1, cold, few)
        for name, processes, cases, wanted in rows:
            before = files()
            seconds, answers = together(processes, cases, None if name == "warm" else folder)
            left = [f"left behind: {path.name}" for path in Path(folder).rglob("*.tmp.*")]
            found[name] = {"seconds": seconds, "faults": [*wrong(answers, wanted), *left], "files": len(files()),
                           "compiled": sum(before.get(path) != stamp for path, stamp in files().items())}
    return found


# Memory of refused files

ACCEPTED = ("subset/k33", "subset/texels", "subset/maps_texels", "subset/neural_resident", "uncommon/normals_marks")
WORST = 10
PEAK = """
import json, sys
try:
    code = {}
except SystemExit as ended:
    code = ended.code or 0
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps({{"code": code, "peak": 1024 * int(peak.split()[1])}}))"""
DECODER = "__import__('texfcodec.cli.dec').cli.dec"
BASELINES = {"Python alone": "0", "with numpy and numba": "__import__('numpy') and __import__('numba') and 0",
             "with the whole decoder": f"__import__('texfcodec.decoder') and {DECODER} and 0"}


def _refused_in_forks():
    """Decodes the accepted vectors, then every stream whose path stands on a line of stdin in a fork."""
    assert not any(refuse((CONFORMANCE / name / "in.texf").read_bytes()) for name in ACCEPTED)
    yield {"idle": resident("VmRSS")}
    for line in map(str.strip, sys.stdin):
        sys.stdout.flush()
        process = os.fork()
        if process == 0:
            began = resident("VmRSS")  # less than the parent's: pages of files are mapped when they are touched
            row = {"path": line, "code": refuse(Path(line).read_bytes()), "peak": resident("VmHWM"), "began": began}
            os.write(1, json.dumps(row).encode() + b"\n")
            os._exit(0)
        os.waitpid(process, 0)


def in_forks(paths):
    """(memory of the warm process in bytes, {path: {"code", "peak", "began"}}); a fork that fell has no row."""
    head, *rows = child("forks", text="\n".join(map(str, paths)))
    return head["idle"], {Path(row.pop("path")): row for row in rows}


def peak_of(expression, *words):
    """{"code", "peak"}: the value of an expression, or the exit code that it ends with, and the highest memory of its process."""
    run = subprocess.run([sys.executable, "-c", PEAK.format(expression), *words], stdout=subprocess.PIPE, check=True, text=True,
                         cwd=REPOSITORY, env=HERE)
    return json.loads(run.stdout)


def by_tool(path):
    """peak_of() texf-dec."""
    with tempfile.TemporaryDirectory() as folder:
        return peak_of(f"{DECODER}.main(sys.argv[1:]) or 0", str(path), f"{folder}/a.npz", "--quiet")


def run_refused(every=False, paths=None):
    """{"idle", "baselines", "rows": {vector: row of its fork}, "fallen", "tool": {vector: by_tool()} of the worst or all}."""
    paths = paths or sorted(FAULTY.glob("*/in.texf"))
    idle, rows = in_forks(paths)
    named = {path.parent.name: row for path, row in rows.items()}
    worst = sorted(named, key=lambda name: -named[name]["peak"])
    base = {name: peak_of(expression)["peak"] for name, expression in BASELINES.items()}
    base[f"texf-dec of {ACCEPTED[0]}"] = by_tool(CONFORMANCE / ACCEPTED[0] / "in.texf")["peak"]
    return {"idle": idle, "baselines": base, "rows": named, "fallen": [path.parent.name for path in paths if path not in rows],
            "tool": {name: by_tool(FAULTY / name / "in.texf") for name in (worst if every else worst[:WORST])}}


# At the bounds of a level

NEAR, SMALL = 0.85, 64  # of a bound is aimed at: voxels hardly touched are not kept; resolution of the small stream
COUNTED = {"voxels": "voxels", "texels": "voxels", "faces": "faces", "samples": "samples"}  # stream: the bound that it comes near


def _torus(around, across, copies=1):
    from conformance.make.scenes import scene_of, torus

    positions, faces, colours = torus(around, across)
    return scene_of(positions, np.tile(faces, (copies, 1)), colours)


def _image(side):
    """Waves and noise, uint8 [side, side, 4], so that coefficients have to be decoded."""
    y, x = np.mgrid[:side, :side] / 64.0
    grain = [np.random.default_rng(c).normal(0, 12, (side, side)) for c in range(3)]
    waves = [np.clip(128 + 70 * np.sin(x + c) * np.cos(y * (c + 1)) + grain[c], 0, 255) for c in range(3)]
    return np.stack([*waves, np.full((side, side), 255)], -1).astype(np.uint8)


def samples_of(texf, resolution):
    """Samples of a surface of one field over voxels (10.1)."""
    return count_samples(texf.lattice_positions, texf.faces, texf.position_bits, resolution)


def streams_of(kind, bounds):
    """(small stream, one near the bound) as bytes. kind: of COUNTED; bounds: Limits of a level."""
    from shapes import mapped_sheet

    make = lambda scene, **options: coded(scene, qp=22, refine="off", **options)
    bound = NEAR * getattr(bounds, COUNTED[kind])
    if kind == "texels":
        sheet = lambda side: make(mapped_sheet({}, colour=_image(side)), support="texels")
        return sheet(SMALL), sheet(int(np.sqrt(bound)))
    if kind == "faces":
        across = 1 << (int(np.log2(bound)) // 2 - 1)
        return make(_torus(32, 16), resolution=SMALL), make(_torus(int(bound) // (2 * across), across), resolution=SMALL)
    small = make(_torus(64, 32), resolution=SMALL)
    texf = decode(small)
    resolution = int(SMALL * np.sqrt(NEAR * bounds.voxels / len(texf.fields[0].support)) * (0.7 if kind == "samples" else 1))
    copies = int(bound / samples_of(texf, resolution)) if kind == "samples" else 1
    return small, make(_torus(64, 32, copies), resolution=resolution)


def run_levels(levels=(1, 2)):
    """{"rows": one for each stream and level: level, kind, count of what it comes near, bound, bytes, seconds, memory beyond the
    idle decoder's}."""
    rows = []
    for level, kind in itertools.product(levels, COUNTED):
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / name for name in ("small.texf", "stream.texf")]
            for path, data in zip(paths, streams_of(kind, LEVELS[level]), strict=True):
                path.write_bytes(data)
            (found,) = child("level", *paths, level)
            rows.append({"level": level, "kind": kind, "bytes": paths[1].stat().st_size, **found,
                         "count": found["counts"][COUNTED[kind]], "bound": getattr(LEVELS[level], COUNTED[kind])})
    return {"rows": rows}


def _decode_level(small, stream, level):
    options = DecodeOptions(threads=2, limits=LEVELS[int(level)])
    decode(Path(small), options)  # kernels are there from now on
    memory, begin = Memory(), time.perf_counter()
    texf = decode(Path(stream), options)
    seconds, held, support = time.perf_counter() - begin, memory.result(), texf.fields[0].support
    samples = samples_of(texf, support.size) if isinstance(support, VoxelSupport) else 0
    yield {"seconds": seconds, "memory": held["peak"] - held["idle"],
           "counts": {"voxels": len(support), "faces": len(texf.faces), "samples": samples}}


# Many faces, texels and voxels

SIZES = (10_000, 30_000, 100_000)  # faces
LARGE = {"scan with image": (1_000_000, 3_000_000), "scan with vertex colours": (1_000_000, 3_000_000), "slivers": (1_000_000,),
         "lone triangles": (1_000_000,), "one scroll": (3_000_000,)}  # faces, minutes each
SIDES, RESOLUTIONS, FEW = (512, 1024, 2048, 4096), (128, 256, 512, 1024), 10_000  # of images, of fields; faces of their scan


def _measured(call):
    """{"seconds" of the processor, of children too, "memory" beyond what the process held before, "silence": the longest time
    without a word of progress, "stage": that it belongs to} of call(Report)."""
    held, begin, words = Memory(), sum(os.times()[:4]), [(time.process_time(), "")]
    call(Report(lambda stage, done, total: words.append((time.process_time(), stage))))
    silence, stage = max(((b - a, before or after) for (a, before), (b, after) in itertools.pairwise(words)), default=(0.0, ""))
    memory = held.result()
    return {"seconds": sum(os.times()[:4]) - begin, "memory": memory["peak"] - memory["idle"], "silence": silence, "stage": stage}


def _code_mesh(warm, path, options):
    import warnings

    warnings.simplefilter("ignore")  # losses that the meshes are meant to have
    options, folder, found = EncodeOptions(threads=2, **json.loads(options)), Path(path).parent, {}

    def encode(name, report):
        made = encode_to_result(name, options, report)
        (folder / "made.texf").write_bytes(made.data)
        found.update(voxels=made.counts["voxels"], texels=made.counts["texels"])

    for name in (warm, path):  # the small one first
        found["encode"] = _measured(lambda report, name=name: encode(name, report))
        found["save"] = _measured(lambda report: decode(folder / "made.texf", report=report).save(folder / "made.glb"))
    yield found


def run_faces(sizes=SIZES, kinds=tuple(GENERATORS), sides=SIDES, resolutions=RESOLUTIONS, large=False):
    """{"rows": one for each mesh and size: kind, of ("faces", "texels" or "voxels"), count of these, "encode", "save"}."""
    todo = [(kind, "faces", GENERATORS[kind], size, {}) for kind in kinds
            for size in (*sizes, *(LARGE.get(kind, ()) if large else ()))]
    todo += [("scan over texels", "texels", lambda count, side=side: scan_with_image(count, side), FEW,
              {"support": "texels", "keep_mesh": True}) for side in sides]
    todo += [("scan over voxels", "voxels", lambda count: scan_with_image(count, SIDES[-2]), FEW,
              {"support": "voxels", "resolution": resolution, "keep_mesh": True}) for resolution in resolutions]
    rows = []
    for kind, of, make, size, options in todo:
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / name for name in ("warm.glb", "mesh.glb")]
            meshes = make(1000), make(size)
            for path, mesh in zip(paths, meshes, strict=True):
                path.write_bytes(glb_of(mesh))
            (found,) = child("mesh", *paths, json.dumps(options))
        rows.append({"kind": kind, "of": of, "count": len(meshes[1].faces) if of == "faces" else found[of],
                     "encode": found["encode"], "save": found["save"]})
    return {"rows": rows}


def _slope(kind, calls):
    yield slope_of(_calls_of(kind), int(calls))


CHILDREN = {"slope": _slope, "forks": _refused_in_forks, "level": _decode_level, "mesh": _code_mesh}

if __name__ == "__main__":
    for answer in CHILDREN[sys.argv[1]](*sys.argv[2:]):
        print(json.dumps(answer), flush=True)
