"""The conformance runner, shown to fail decoders that are wrong on purpose, and to pass a right one."""

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
RUNNER = REPOSITORY / "conformance" / "run.py"
NAIVE = f'"{sys.executable}" "{REPOSITORY / "tests" / "naive" / "decoder.py"}"'
# Quick ones: levels of detail, two fields, alpha, slices, no level at all, no geometry, and a refusal of each kind
SMALL = [
    "subset/k3/", "subset/two_fields/", "subset/alpha_mask/", "uncommon/one_voxel/", "uncommon/empty/", "uncommon/one_slice/",
    "uncommon/empty_codeword/", "faulty/cut_geometry/", "faulty/codec_id/", "faulty/num_vertices_huge/",
    "subset/neural_hash/", "faulty/neural_code/",
]

# The naive decoder with one thing wrong; `files` is what it would write.
WRONG = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from naive import decoder
from naive.bits import Invalid, Unsupported
stream, folder, lod = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]), int(sys.argv[4]) if len(sys.argv) > 3 else 0
{before}
try:
    files = decoder.arrays(decoder.decode(stream, lod))
except (Invalid, Unsupported) as error:
    {refuse}
{after}
for name, content in files.items():
    (folder / (name + ".bin")).write_bytes(content)
"""
REFUSE = "print(error, file=sys.stderr); sys.exit(3 if isinstance(error, Invalid) else 5)"
LAST = """
for name in [name for name in files if name.endswith("values")][-1:]:
    files[name] = files[name][:-1] + bytes([files[name][-1] ^ 1])
"""
MIRRORED = """
import struct
for unit in (texf := decoder.decode(stream, lod))["units"]:
    unit["faces"] = [[a, c, b] for a, b, c in unit["faces"]]
files = decoder.arrays(texf)
"""


def run(command, *cases):
    """(exit code, lines) of the runner with a decoder command, or our own where it is None."""
    call = [sys.executable, str(RUNNER), *(["--decoder", command] if command else []), *cases]
    result = subprocess.run(call, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    return result.returncode, result.stdout.splitlines()


def wrong_decoder(folder, before="", refuse=REFUSE, after=""):
    """Command of the naive decoder with other statements before, on refusal or after."""
    program = folder / "wrong.py"
    program.write_text(WRONG.format(tests=str(REPOSITORY / "tests"), before=before, refuse=refuse, after=after), encoding="utf-8")
    return f'"{sys.executable}" "{program}"'


def test_our_decoder_passes_every_vector():
    code, lines = run(None)
    assert code == 0, "\n".join(line for line in lines if line.startswith("FAIL"))
    assert int(lines[-1].split()[0]) == len(lines) - 1 >= 32


def test_naive_decoder_passes_the_small_vectors():
    code, lines = run(NAIVE, *SMALL)
    assert (code, lines[-1]) == (0, f"{len(SMALL)} passed, 0 failed"), "\n".join(lines)


def test_wrong_decoder_without_its_fault_is_right(tmp_path):
    code, lines = run(wrong_decoder(tmp_path), *SMALL)
    assert code == 0, "\n".join(lines)


@pytest.mark.parametrize(
    "case, complaint, fault",
    [
        ("subset/k3/", "field0_group0_values.bin differs", {"after": LAST}),
        ("subset/two_fields/", "field1_keys.bin is missing", {"after": "files = {n: files[n] for n in files if '1_' not in n}"}),
        ("subset/k3/", "field1_keys.bin is unexpected", {"after": "files['field1_keys'] = b''"}),
        ("subset/k3/", "lod 1: field0_keys.bin differs", {"before": "lod = 0"}),
        ("subset/k3/", "geometry.bin differs", {"after": MIRRORED}),
        ("subset/k3/", "geometry.bin differs", {"after": "files['geometry'] = files['geometry'][:-88]"}),
        ("uncommon/empty/", "geometry.bin is missing", {"after": "files = {}"}),
        ("faulty/cut_geometry/", "exit code 0, expected 3", {"refuse": "files = {}"}),
        ("faulty/cut_geometry/", "exit code 1, expected 3", {"refuse": "sys.exit(1)"}),
        ("faulty/codec_id/", "exit code 3, expected 5", {"refuse": "sys.exit(3)"}),
        ("faulty/num_vertices_huge/", "exit code 0, expected 6 or 3", {"refuse": "files = {}"}),
        ("subset/k3/", "exit code 3", {"before": "sys.exit(3)"}),
    ],
)
def test_runner_fails_a_decoder_that_is_wrong(tmp_path, case, complaint, fault):
    code, (line, last) = run(wrong_decoder(tmp_path, **fault), case)
    assert line.startswith(f"FAIL {case[:-1]}: ") and complaint in line
    assert (code, last) == (7, "0 passed, 1 failed")


def test_runner_fails_a_decoder_that_hangs(tmp_path):
    command = wrong_decoder(tmp_path, before="import time; time.sleep(60)")
    code, lines = run(command, "--seconds", "0.5", "faulty/magic/")
    assert code == 7 and "no answer in 0.5 seconds" in lines[0]


def test_runner_refuses_to_run_nothing():
    call = [sys.executable, str(RUNNER), "no/such/case"]
    assert subprocess.run(call, cwd=REPOSITORY, capture_output=True, check=False).returncode == 2
