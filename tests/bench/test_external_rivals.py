"""TMC13, signed distances and vertex colours. TMC13 is a stand-in here that speaks its command line and really codes, because the
program itself is not part of any installation."""

import sys
import time

import numpy as np
import pytest
from shapes import crossing_sheets, hand, painted_sphere, scene_of, sphere, square

from texfcodec.report import Report
from tools.bench.methods.external import External, read_ply, write_ply
from tools.bench.methods.programs import ProgramError
from tools.bench.methods.sdf import Sdf, dec_distances, dec_solid, enc_distances, enc_solid, quantised, signed_distances
from tools.bench.methods.vertex_colours import Patchwork, VertexColours, subdivided

STAND_IN = '''
import struct, sys, zlib
import numpy as np
said = dict(word[2:].split("=", 1) for word in sys.argv[1:] if word.startswith("--"))
names, stream, out = "x y z red green blue".split(), said["compressedStreamPath"], said["reconstructedDataPath"]
kind = np.dtype([(name, "<f4") for name in names[:3]] + [(name, "u1") for name in names[3:]])

def payload(number, data):
    return struct.pack(">BI", number, len(data)) + data

if said["mode"] == "0":
    assert said["transformType"] in "02" and said["attribute"] == "color"
    points = np.frombuffer(open(said["uncompressedDataPath"], "rb").read().partition(b"end_header\\n")[2], kind)[::-1]
    step = 1 << (int(said["qp"]) // 6)
    colour = np.stack([points[name] // step for name in names[3:]], 1)
    xyz = np.stack([points[name] for name in names[:3]], 1).astype("<i4")
    attributes = zlib.compress(bytes([step]) + colour.tobytes())
    data = payload(0, b"sps") + payload(2, zlib.compress(xyz.tobytes())) + payload(4, attributes)
    open(stream, "wb").write(data)
    print("colors bitstream size", len(attributes), "B")
data, parts = open(stream, "rb").read(), {}
while data:
    number, length = struct.unpack_from(">BI", data)
    parts[number], data = zlib.decompress(data[5:5 + length]) if number else b"", data[5 + length:]
xyz, step = np.frombuffer(parts[2], "<i4").reshape(-1, 3), parts[4][0]
colour = np.frombuffer(parts[4][1:], "u1").reshape(-1, 3).astype(int) * step + step // 2
with open(out, "w") as file:
    print("ply\\nformat ascii 1.0\\nelement vertex %d" % len(xyz), file=file)
    for name in names:
        print("property", "uchar" if name in names[3:] else "float", name, file=file)
    print("end_header", file=file)
    np.savetxt(file, np.hstack([xyz, np.minimum(colour, 255)]), "%d")
'''


@pytest.fixture
def stand_in(tmp_path):
    """Words of a command line that starts the stand-in of TMC13."""
    (tmp_path / "tmc3.py").write_text(STAND_IN)
    return f"{sys.executable} {tmp_path / 'tmc3.py'}"


def script(path, text):
    """Words of a command line that starts a Python program of this text."""
    path.write_text(text)
    return f"{sys.executable} {path}"


def coded(method, scene, folder, **options):
    """What encoding told, and what the files of the folder decode to."""
    folder.mkdir()
    facts = method.encode(scene, options, folder, 1, Report())
    decoded = method.decode(folder, options, 1, Report())
    assert method.values_sha256(decoded) == facts["reconstruction_sha256"]
    return facts, decoded


@pytest.mark.parametrize("transform", ["raht", "predlift"])
def test_tmc13_counts_the_attribute_bricks_that_its_log_tells(tmp_path, stand_in, transform):
    facts, decoded = coded(External(), painted_sphere(), tmp_path / "a", program=stand_in, resolution=32, qp=12,
                           transform=transform)
    sizes = {path.name: path.stat().st_size for path in (tmp_path / "a").iterdir()}
    assert 0 < facts["bytes"]["texture"] < sizes["cloud0.bin"]
    assert facts["bytes"]["geometry"] + facts["bytes"]["other"] == sizes["stream.texf"]
    assert facts["bytes"]["total"] == sizes["stream.texf"] + facts["bytes"]["texture"]
    from tools.bench.methods.voxel_values import rgba_of, voxel_values

    values = rgba_of(voxel_values(painted_sphere(), {"resolution": 32, "threads": 1}, Report()).fields[0])
    assert np.abs(decoded.fields[0].rgba.astype(int) - values).max() <= 2


def test_tmc13_that_is_not_here_is_named_with_its_variable(monkeypatch, tmp_path):
    monkeypatch.setenv("TEXFCODEC_TMC13", str(tmp_path / "nothing"))
    assert "mpeg-pcc-tmc13" in External().missing({}) and "TEXFCODEC_TMC13" in External().missing({})
    with pytest.raises(LookupError, match="make -C tools tmc13"):
        External().encode(painted_sphere(), {"resolution": 16}, tmp_path, 1, Report())


def test_other_points_than_were_coded_are_refused(tmp_path):
    """The stand-in's decoded file, with rows left out or moved."""
    for skipped, moved, sentence in ((3, 0, "points where"), (0, 1, "at other places")):
        text = STAND_IN.replace('np.hstack([xyz,', f'np.hstack([xyz[{skipped}:] + [{moved}, 0, 0],').replace(
            'np.minimum(colour, 255)', f'np.minimum(colour[{skipped}:], 255)').replace("% len(xyz)", f"% (len(xyz) - {skipped})")
        with pytest.raises(ValueError, match=sentence):
            External().encode(painted_sphere(), {"resolution": 16, "program": script(tmp_path / "other.py", text)}, tmp_path, 1,
                              Report())


def test_hanging_and_failing_programs_and_one_without_a_bitstream_are_told(tmp_path):
    hanging = script(tmp_path / "hang.py", "import subprocess, sys\nsubprocess.run([sys.executable, '-c', 'import time; "
                     "time.sleep(60)'])\n")
    failing, idle = script(tmp_path / "fail.py", "raise SystemExit('error: no')"), script(tmp_path / "idle.py", "")
    begin = time.perf_counter()
    for program, kind, sentence in ((hanging, ProgramError, "did not end within 2 s"), (failing, ProgramError, "error: no"),
                                    (idle, ValueError, "without a bitstream")):
        with pytest.raises(kind, match=sentence):
            External().encode(painted_sphere(), {"resolution": 16, "seconds": 2, "program": program}, tmp_path, 1, Report())
    assert time.perf_counter() - begin < 40


def test_ply_points_come_back_and_what_is_none_is_refused(tmp_path):
    xyz, rgb = np.arange(30).reshape(10, 3), np.arange(30, dtype=np.uint8).reshape(10, 3)
    write_ply(tmp_path / "a.ply", xyz, rgb)
    found = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(found[0], xyz)
    np.testing.assert_array_equal(found[1], rgb)
    whole = (tmp_path / "a.ply").read_bytes()
    for data in (b"", b"ply\n", whole[:-1], whole.replace(b"red", b"rad")):
        (tmp_path / "b.ply").write_bytes(data)
        with pytest.raises(ValueError, match="PLY file"):
            read_ply(tmp_path / "b.ply")


# Signed distances.


@pytest.fixture
def needs_distances():
    for module in ("igl", "imagecodecs", "skimage"):
        pytest.importorskip(module, reason=f'{module} is not installed: pip install "texfcodec[rivals]"')


@pytest.mark.parametrize("steps", [2, 9, 60])
def test_needed_distances_come_back_exactly_and_signs_everywhere(needs_distances, steps):
    positions, faces, _ = hand(12)
    placed = (positions - positions.min(axis=0)) * 4 + 2
    shape = tuple(int(n) + 4 for n in placed.max(axis=0))
    values, needed = quantised(signed_distances(placed, faces, shape), steps)
    decoded = dec_distances(enc_distances(values, needed, steps), shape, steps)
    assert needed.any() and (values < 0).any()
    np.testing.assert_array_equal(decoded[needed], values[needed])
    np.testing.assert_array_equal(decoded < 0, values < 0)


def test_marching_cubes_stay_near_the_source(needs_distances):
    positions, faces, _ = hand(24)
    data, lost = enc_solid(scene_of(positions, faces), 48, 16)
    made = dec_solid(data)
    from texfcodec.geometry.mesh import Mesh
    from texfcodec.geometry.nearest_points import NearestPoints

    cell = np.ptp(positions, axis=0).max() / 48
    for there, here in ((scene_of(positions, faces), made), (made, scene_of(positions, faces))):
        nearest = NearestPoints(Mesh(there.positions, there.faces)).find(here.positions)
        assert nearest.distance.max() < cell  # fingertips are cut by a fraction of it
    assert lost == 0
    corners = made.positions[made.faces]
    assert np.einsum("fc,fc->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() > 0  # it faces outwards


def test_sdf_counts_its_files_and_decodes_to_the_encoders_field(needs_distances, tmp_path):
    facts, decoded = coded(Sdf(), painted_sphere(16), tmp_path / "a", grid=16, resolution=32, qp=20)
    sizes = {path.name: path.stat().st_size for path in (tmp_path / "a").iterdir()}
    assert facts["bytes"]["geometry"] == sizes["distances.bin"]
    assert facts["bytes"]["total"] == sum(sizes.values())
    assert len(decoded.faces) == facts["faces"] and len(decoded.fields[0].keys) == facts["voxels"]


@pytest.mark.parametrize("scene", [scene_of(*square()), crossing_sheets()])
def test_sdf_refuses_sheets_with_a_sentence(needs_distances, tmp_path, scene):
    with pytest.raises(LookupError, match="% of the surface is seen from outside and has no inside behind it"):
        Sdf().encode(scene, {"grid": 32}, tmp_path, 1, Report())


# Vertex colours.


def test_subdivision_leaves_no_crack_and_no_long_edge():
    positions, faces = sphere(6)
    whole = Patchwork(positions * 100, faces, np.arange(len(faces)), np.tile(np.eye(3), (len(faces), 1, 1)))
    made = subdivided(whole, 12.0)
    ends = np.sort(np.stack([made.faces, np.roll(made.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    assert (count == 2).all()
    corners = made.positions[made.faces]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    assert lengths.max() <= 12 < np.linalg.norm(whole.positions[faces] - np.roll(whole.positions[faces], 1, axis=1), axis=2).max()
    np.testing.assert_allclose(np.einsum("fkj,fjc->fkc", made.bary, whole.positions[faces[made.origin]]), corners, atol=1e-9)


@pytest.mark.parametrize("scene", [painted_sphere(), crossing_sheets()])
def test_vertex_colours_count_their_file_and_come_back(tmp_path, scene):
    facts, decoded = coded(VertexColours(), scene, tmp_path / "a", density=16, colour_bits=8)
    assert facts["bytes"]["total"] == (tmp_path / "a" / "mesh.bin").stat().st_size
    assert 0 < facts["bytes"]["geometry"] < facts["bytes"]["total"] == facts["bytes"]["geometry"] + facts["bytes"]["colours"]
    assert {m.alpha_mode for m in decoded.materials} == {m.alpha_mode for m in scene.materials}


def test_smooth_vertex_colours_are_met_to_a_level(tmp_path):
    from texfcodec.metrics.views import mesh_psnr_3d

    scene = painted_sphere()
    _, decoded = coded(VertexColours(), scene, tmp_path / "a", density=24)
    assert mesh_psnr_3d(scene, decoded, 2000)["rgb"] > 48


@pytest.mark.parametrize(("method", "option", "value"), [(VertexColours, "colour_bits", 9), (VertexColours, "density", 2.5),
                                                         (Sdf, "grid", 8), (Sdf, "steps", True), (External, "transform", "dct"),
                                                         (External, "seconds", 0)])
def test_options_out_of_range_are_refused(tmp_path, method, option, value):
    with pytest.raises(ValueError, match=f"{option} must be"):
        method().encode(painted_sphere(), {option: value}, tmp_path, 1, Report())
