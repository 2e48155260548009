"""What may go wrong with a method or a disk costs the job alone, and is told by its name."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from batches import REPOSITORY, environment, stamps, wait_for, write_ball

from tools.bench.conditions import read_conditions
from tools.bench.rate_points import main

PLUGIN = '''
import os
import pickle
import threading
from pathlib import Path

from tools.bench.methods import Method, method

PROGRAM = Path(__file__).with_name("program")


class Through(Method):
    """Hands the source through."""

    options = ("bytes",)

    def encode(self, scene, options, folder, threads, report):
        (folder / "scene").write_bytes(pickle.dumps(scene))
        (folder / "more").write_bytes(bytes(options.get("bytes", 0)))
        return {"bytes": {"total": 12, "geometry": 4}, "reconstruction_sha256": None}

    def decode(self, folder, options, threads, report):
        return pickle.loads((folder / "scene").read_bytes())


@method("through")
class Plain(Through):
    """As it is."""


@method("absent")
class Absent(Through):
    """Needs a program."""

    def missing(self, options):
        return None if PROGRAM.exists() else "program is not installed: write it beside the plug-in"


@method("plain")
class NothingToCode(Through):
    """Codes textures."""

    def encode(self, *arguments):
        raise LookupError("no face has a texture")


@method("faulty")
class Faulty(Through):
    """A fault that looks like a LookupError."""

    def encode(self, *arguments):
        return {}["key"]


@method("hungry")
class Hungry(Through):
    """Takes much memory."""

    def encode(self, *arguments):
        return bytearray(1 << 33)


@method("crash")
class Crash(Through):
    """Dies."""

    def decode(self, *arguments):
        os.abort()


@method("hang")
class Hang(Through):
    """Never ends, nor does what it starts."""

    def encode(self, *arguments):
        import subprocess

        child = subprocess.Popen(["sleep", "600"])
        Path(__file__).with_name("pid").write_text(str(child.pid))
        child.wait()
'''
EVALUATION = "[evaluation]\nsamples = 100\nviews = 0\n"


@pytest.fixture
def run(tmp_path, capsys):
    """A function: rate_points.py with these methods, a setting of each by its name: (exit code, stdout)."""
    write_ball(tmp_path)
    (tmp_path / "more.py").write_text(PLUGIN)

    def call(*methods, more=()):
        settings = "".join(f'[[settings]]\nname = "{name}"\nmethod = "{name}"\n' for name in methods)
        (tmp_path / "c.toml").write_text(f'assets = ["ball"]\nplugins = ["more.py"]\n{EVALUATION}{settings}')
        code = main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out"), "--jobs", "2", *more])
        return code, capsys.readouterr().out

    return call


def test_what_is_not_installed_or_does_not_apply_is_a_row_and_no_failure(run, tmp_path):
    code, out = run("through", "absent", "plain")
    assert code == 0 and "1 done" in out and "0 failed; 1 need what is not installed; 1 do not apply" in out
    assert "  not installed: program is not installed: write it beside the plug-in" in out
    rows = {path.parent.name: json.loads(path.read_text()) for path in (tmp_path / "out/ball").glob("*/missing.json")}
    assert {name: (row["state"], row["reason"]) for name, row in rows.items()} == {
        "absent": ("missing", "program is not installed: write it beside the plug-in"),
        "plain": ("does not apply", "no face has a texture")}
    assert all({"setting", "group", "method", "asset"} <= row.keys() for row in rows.values())
    before = stamps(tmp_path / "out")
    (tmp_path / "program").touch()
    code, out = run("through", "absent", "plain")
    assert code == 0 and "1 done" in out and "2 were finished before" in out and "not installed" not in out
    after = stamps(tmp_path / "out")
    assert after.keys() == {"ball/through", "ball/absent"} and after["ball/through"] == before["ball/through"]


def test_crash_fault_and_hunger_cost_their_own_jobs_only(run, tmp_path):
    code, out = run("faulty", "hungry", "crash", "through", more=("--memory-limit", str(3 << 30)))
    reasons = dict(line.strip().split(": ", 1) for line in out.splitlines()[1:])
    assert code == 7 and "1 done" in out and "3 failed" in out and set(stamps(tmp_path / "out")) == {"ball/through"}
    assert "KeyError" in reasons["ball/faulty"] and "MemoryError" in reasons["ball/hungry"]
    assert "decode: ended by signal 6" in reasons["ball/crash"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked up in /proc")
def test_a_job_that_takes_too_long_is_killed_with_what_it_started(run, tmp_path):
    code, out = run("hang", more=("--limit-seconds", "4"))
    assert code == 7 and "ball/hang: encode: took longer than 4 s" in out
    wait_for(lambda: not is_asleep((tmp_path / "pid").read_text()))


def is_asleep(pid):
    """Whether a process is there still, and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_the_time_limit_of_a_condition_file_is_a_number_above_zero(tmp_path):
    head = 'assets = ["sample"]\nlimit_seconds = {}\n[[settings]]\nname = "a"\n'
    (tmp_path / "c.toml").write_text(head.format("2.5"))
    assert read_conditions(tmp_path / "c.toml")["limit_seconds"] == 2.5
    for value in ("0", "-1", '"1"', "true", "inf", "nan"):
        (tmp_path / "c.toml").write_text(head.format(value))
        with pytest.raises(SystemExit, match="limit_seconds must be a number above 0"):
            read_conditions(tmp_path / "c.toml")


FULL_DISK = """
import subprocess, sys
from pathlib import Path
from tools.bench.rate_points import main
top = Path(sys.argv[1])
stamps = lambda: {p.parent.name: p.stat().st_mtime_ns for p in (top / "disk").glob("out/*/*/metrics.json")}
words = [str(top / "c.toml"), "--out", str(top / "disk/out")]
first, before = main(words), stamps()
subprocess.run(["mount", "-o", "remount,size=64m", str(top / "disk")], check=True)
second, after = main(words), stamps()
print([first, sorted(before), second, sorted(after), all(after[name] == before[name] for name in before)])
"""


def test_a_full_disk_loses_and_redoes_nothing_and_the_exit_code_tells(tmp_path):
    (tmp_path / "disk").mkdir()
    mount = ["unshare", "-Urm", "sh", "-c", 'mount -t tmpfs -o size=1m none "$0" && exec "$@"', str(tmp_path / "disk")]
    if not sys.platform.startswith("linux") or subprocess.run([*mount, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this system lets nobody mount a disk of 1 MB")
    write_ball(tmp_path)
    (tmp_path / "more.py").write_text(PLUGIN)
    settings = "".join(f'[[settings]]\nname = "b{size}"\nmethod = "through"\nbytes = {size}\n' for size in (1, 2 << 20, 2))
    (tmp_path / "c.toml").write_text(f'assets = ["ball"]\nplugins = ["more.py"]\n{EVALUATION}{settings}')
    ran = subprocess.run([*mount, sys.executable, "-c", FULL_DISK, tmp_path], capture_output=True, text=True, check=False,
                         cwd=REPOSITORY, env=environment())
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines()[-1] == "[2, ['b1'], 0, ['b1', 'b2', 'b2097152'], True]"
    assert "encode: the disk is full" in ran.stdout and "the disk is full; coding did not start" in ran.stdout
