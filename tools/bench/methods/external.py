"""TMC13, the MPEG group's G-PCC software, on our voxels, by its command line: octree, lossless geometry, lossy attributes.

It codes points: the voxels' coordinates and transferred colours (voxel_values.py) as a PLY file, one for every field. The mesh
travels as ours, so that the decoder has the voxels; geometry that the program codes as well costs nothing. What counts are the
attribute bricks of its stream, as its own log counts them. Options that are not said here are the program's own defaults; config
names a file of them, such as its common test conditions make.

Tests run a small stand-in that speaks its command line; results are of the program itself (make -C tools tmc13). A reconstruction
with other points than were coded is refused, a program that hangs is ended with all that it has started. Learned codecs come
from their authors: such a codec is a plug-in of a condition file, and this file the pattern for it.
"""

import os
import struct
from types import SimpleNamespace

import numpy as np

from texfcodec.field.morton import encode_morton
from tools.bench.methods import checked_options, method, programs, source_hash, texf
from tools.bench.methods import voxel_values as voxels
from tools.bench.methods.programs import program_of, run_program
from tools.bench.methods.texf import TexfMethod
from tools.bench.methods.voxel_values import rgba_of, voxel_values, with_values, write_mesh

DEFAULTS = {"resolution": 1024, "qp": 34, "transform": "raht", "program": "", "config": "", "seconds": 3600,
            "position_bits": None}
VARIABLE, NAME = "TEXFCODEC_TMC13", "tmc3"
GEOMETRY = ("--trisoupNodeSizeLog2=0", "--mergeDuplicatedPoints=0", "--neighbourAvailBoundaryLog2=8",
            "--intra_pred_max_node_size_log2=6", "--positionQuantizationScale=1", "--inferredDirectCodingMode=1",
            "--maxNumQtBtBeforeOt=4", "--minQtbtSizeLog2=0", "--planarEnabled=1", "--planarModeIdcmUse=0",
            "--convertPlyColourspace=1")
TRANSFORMS = {
    "raht": ("--transformType=0", "--rahtPredictionSearchRange=50000", "--qpChromaOffset=-1"),
    "predlift": ("--transformType=2", "--numberOfNearestNeighborsInPrediction=3", "--levelOfDetailCount=12", "--lodDecimator=0",
                 "--adaptivePredictionThreshold=64", "--qpChromaOffset=0"),
}
CLOUD, STREAM_FILE, RECONSTRUCTION, LOG = "cloud{}.ply", "cloud{}.bin", "cloud{}.decoded.ply", "program.txt"
ATTRIBUTE_BRICK = 4  # type of a payload: a byte, then 32 bits of length, most significant byte first
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])


@method("external")
class External(TexfMethod):
    """Options and their defaults stand in DEFAULTS: resolution K; qp as the program has it; transform "raht" or "predlift";
    program (else TEXFCODEC_TMC13, else tmc3 on PATH) and config; seconds: time limit of a run."""

    options = tuple(DEFAULTS)

    def version(self):
        """The path and time of TMC13, whose own version needs a run, and a hash of further files that results depend on."""
        program = program_of({}, VARIABLE, NAME)
        program_state = f"{program[0]} {os.path.getmtime(program[0])} " if program else ""
        return f"{program_state}{super().version()} " + source_hash(texf.__file__, voxels.__file__, programs.__file__)

    def missing(self, options):
        """Return a sentence on how to get TMC13 if the program is not there; None if it is."""
        return None if program_of(options, VARIABLE, NAME) else (
            f"{NAME} is not here: TMC13, the MPEG group's mpeg-pcc-tmc13, is built from its sources by make -C tools tmc13; then "
            f"{VARIABLE} or the option program names it")

    def warm_up(self, options, threads):
        """Load the kernels that make voxels, with a small scene."""
        from texfcodec.precompile import small_scene
        from texfcodec.report import Report

        voxel_values(small_scene(), {"resolution": 32, "threads": threads}, Report())

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene's voxels with TMC13: STREAM without values, STREAM_FILE of every field, and files of the program. Raises
        LookupError without the program, ProgramError if it fails or takes too long, ValueError for an option out of range or if
        other points come back."""
        chosen = checked(options)
        if sentence := self.missing(chosen):
            raise LookupError(sentence)
        given = {"resolution": chosen["resolution"], "threads": threads, "position_bits": chosen["position_bits"]}
        prepared = voxel_values(scene, given, report)
        if any("alpha" in part.planes for part in prepared.fields):
            report.warnings.append("alpha is not coded: the program takes points of three colours")
        with report.stage("geometry"):
            sizes = dict(zip(("geometry", "other"), write_mesh(prepared, folder, report), strict=True))
        config = [f"--config={chosen['config']}"] if chosen["config"] else [*GEOMETRY, *TRANSFORMS[chosen["transform"]]]
        sizes["texture"] = 0
        with report.stage("program"):
            for number, part in enumerate(prepared.fields):
                cloud, stream, decoded = (folder / name.format(number) for name in (CLOUD, STREAM_FILE, RECONSTRUCTION))
                write_ply(cloud, part.support.xyz(), rgba_of(part)[:, :3])
                words = ["--mode=0", f"--uncompressedDataPath={cloud}", f"--compressedStreamPath={stream}",
                         f"--reconstructedDataPath={decoded}", *config, f"--qp={chosen['qp']}", "--bitdepth=8",
                         "--attribute=color"]
                run_program([*program_of(chosen, VARIABLE, NAME), *words], folder / LOG, chosen["seconds"])
                cloud.unlink()
                sizes["texture"] += counted_bytes(stream)
        with report.stage("reconstruction"):
            fields = self._fields(prepared.fields, folder)
        return {"bytes": {"total": sum(sizes.values()), **sizes}, **chosen, "voxels": sum(len(part.keys) for part in fields),
                "reconstruction_sha256": self.values_sha256(SimpleNamespace(fields=fields))}

    def decode(self, folder, options, threads, report):
        """Return the Texf of STREAM with the colours that TMC13 decodes."""
        chosen = checked(options)
        decoded = super().decode(folder, {}, threads, report)
        with report.stage("program"):
            for number in range(len(decoded.fields)):
                stream, points = (folder / name.format(number) for name in (STREAM_FILE, RECONSTRUCTION))
                points.unlink(missing_ok=True)  # the encoder's own is not what counts
                run_program([*program_of(chosen, VARIABLE, NAME), "--mode=1", f"--compressedStreamPath={stream}",
                             f"--reconstructedDataPath={points}", "--convertPlyColourspace=1"], folder / LOG, chosen["seconds"])
        decoded.fields = self._fields(decoded.fields, folder)
        return decoded

    def _fields(self, parts, folder):
        return with_values(parts, [read_colours(folder / RECONSTRUCTION.format(n), part.keys) for n, part in enumerate(parts)])


def checked(options):
    """Return all options with defaults. Raises ValueError with the name of one that is out of range."""
    return checked_options(options, DEFAULTS, {"seconds": (1, 1_000_000)}, {"transform": tuple(TRANSFORMS)})


def counted_bytes(path):
    """Return the bytes of the attribute bricks in a TMC13 stream. Raises ValueError if the file is not a row of payloads."""
    if not path.is_file():
        raise ValueError("the program ended without a bitstream")
    data, place, total = path.read_bytes(), 0, 0
    while place < len(data):
        kind, length = struct.unpack_from(">BI", data, place) if place + 5 <= len(data) else (0, len(data))
        place += 5 + length
        if place > len(data):
            raise ValueError("TMC13's stream is cut off: the last payload is longer than the file")
        total += length * (kind == ATTRIBUTE_BRICK)
    return total


def write_ply(path, xyz, rgb):
    """Write a PLY file of points, int [N, 3], with colours uint8 [N, 3]; coordinates are floats, which every reader knows."""
    rows = np.empty(len(xyz), POINT)
    for column, name in enumerate("xyz"):
        rows[name] = xyz[:, column]
    for column, name in enumerate(("red", "green", "blue")):
        rows[name] = rgb[:, column]
    fields = "".join(f"property {'float' if name in 'xyz' else 'uchar'} {name}\n" for name in POINT.names)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\n{fields}end_header\n"
    path.write_bytes(head.encode() + rows.tobytes())


def read_ply(path):
    """Read a PLY file of points with trimesh; return (xyz float64 [N, 3], rgb uint8 [N, 3]). Raises ValueError if it has
    none."""
    import trimesh

    try:
        cloud = trimesh.load(path, file_type="ply", process=False)
        xyz, rgb = np.asarray(cloud.vertices, np.float64), np.asarray(cloud.colors)[:, :3]
    except Exception as error:  # what a program writes may be anything
        raise ValueError(f"what the program decoded is no PLY file of points with colours: {error}") from error
    if xyz.shape != rgb.shape:
        raise ValueError("what the program decoded is a PLY file of points without colours")
    return xyz, rgb


def read_colours(path, keys):
    """Return the colours of voxels, uint8 [N, 4], from a decoded PLY file. keys: their Morton keys, int64 [N], ascending. Raises
    ValueError if the file has other points."""
    xyz, rgb = read_ply(path)
    whole = np.rint(xyz)
    if len(xyz) != len(keys) or not (np.abs(whole) < 1 << 16).all() or (whole < 0).any():
        raise ValueError(f"the program decoded {len(xyz)} points where {len(keys)} were coded, or some are outside of the grid")
    file_keys = encode_morton(whole.astype(np.int64))
    order = np.argsort(file_keys, kind="stable")
    if not np.array_equal(file_keys[order], keys):
        raise ValueError("the program decoded points at other places than were coded")
    return np.column_stack([rgb[order], np.full(len(keys), 255, np.uint8)])
