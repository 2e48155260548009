"""The native library: the C++ decoder of native/ in this process gives the kernels' values, and stops at an interrupt."""

import ctypes
import gc
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from engine_decoder import EngineDecoder

from conformance import run as runner
from texfcodec import Cancelled, DecodeOptions, decode
from texfcodec.errors import SupportError, TexfError
from texfcodec.report import Report
from texfcodec.sandbox import engines, native

REPOSITORY = Path(__file__).resolve().parents[2]
VECTORS = REPOSITORY / "conformance"
built = pytest.mark.skipif(not native.is_here(), reason="the native library is not built: run make native")


def _stream(name):
    return (VECTORS / name / "in.texf").read_bytes()


@built
def test_every_vector_that_it_decodes_gives_the_same_arrays():
    decoder, tried = EngineDecoder("native"), 0
    for folder in runner.cases(["subset/", "uncommon/"]):
        if "neural" not in folder.name:
            assert runner.faults_of(decoder, folder) == [], folder.name
            tried += 1
    assert tried > 60


@built
def test_every_faulty_vector_is_refused_with_the_finding_of_the_kernels():
    """By the engine, and by the library alone, which reads clauses 4 and 5 itself."""
    tried = 0
    for folder in runner.cases(["faulty/"]):
        case, data = json.loads((folder / "case.json").read_text(encoding="utf-8")), (folder / "in.texf").read_bytes()
        errors = []
        for attempt in (lambda data=data: decode(data, DecodeOptions(engine="native")),
                        lambda data=data: native.NativeAnswer(native.library(native.LIBRARY)).decode(
                            data, DecodeOptions(), lambda done, total: None)):
            with pytest.raises(TexfError) as caught:
                attempt()
            errors.append(caught.value)
        assert errors[1].code == case["code"], (folder.name, str(errors[1]))
        assert errors[0].code in (case["code"], "TXF-U10"), (folder.name, str(errors[0]))
        tried += errors[0].code == case["code"]
    assert tried > 250


def test_it_says_what_it_cannot_decode_and_auto_lets_another_engine_do_it(monkeypatch, tmp_path):
    with pytest.raises(SupportError, match="TXF-U10"):
        decode(_stream("subset/texels"), DecodeOptions(engine="native", isolate=True))
    monkeypatch.setattr(native, "LIBRARY", tmp_path / "none.so")
    with pytest.raises(SupportError, match="make native"):
        decode(_stream("subset/texels"), DecodeOptions(engine="native"))
    assert engines.first_engine(DecodeOptions()) != "native"


@built
def test_auto_takes_the_library_but_not_for_codecs_that_it_lacks_or_with_isolation():
    for options, stage in ((DecodeOptions(), "native"), (DecodeOptions(isolate=True), "native")):
        report = Report()
        decode(_stream("subset/texels"), options, report)
        assert (stage in report.seconds) == (not options.isolate)
    neural = next(folder for folder in runner.cases(["subset/"]) if "neural" in folder.name)
    with pytest.raises(SupportError, match="TXF-U10.*codec"):
        decode((neural / "in.texf").read_bytes(), DecodeOptions(engine="native"))


@pytest.mark.parametrize("content", [b"", b"\x7fELF" + bytes(60), "other version", "no functions"])
def test_a_library_that_cannot_be_used_is_passed_over_with_one_line(monkeypatch, tmp_path, content):
    path = tmp_path / native.LIBRARY.name
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        if shutil.which("cc") is None:
            pytest.skip("there is no C compiler: no library of another version to try")
        body = "int texf_version(void) { return 99; }" if content == "other version" else "int texf(void) { return 0; }"
        (tmp_path / "a.c").write_text(body)
        subprocess.run(["cc", "-shared", "-fPIC", tmp_path / "a.c", "-o", path], check=True)
    monkeypatch.setattr(native, "LIBRARY", path)
    report = Report()
    assert decode(_stream("subset/texels"), None, report).fields
    assert [line for line in report.remarks if "native library" in line] == [f"{native.fault()}; another engine decodes"]
    assert "native" not in report.seconds and "\n" not in native.fault() and str(tmp_path) not in native.fault()


class _Slow:
    """Stands in for the library: a decode that lasts until it is stopped, and counts what is freed."""

    def __init__(self):
        self.freed, self.flag = 0, None

    def texf_set_stop(self, flag):
        self.flag = flag._obj

    def texf_decode_threads(self, data, size, lod, limits, threads, asset, refusal):
        asset._obj.value = 1
        while not self.flag.value:
            time.sleep(0.01)
        return native.STOPPED

    def texf_free(self, asset):
        self.freed += 1


@pytest.mark.parametrize("error", [KeyboardInterrupt, Cancelled])
def test_an_interrupt_stops_the_work_at_once_and_frees_its_memory(error):
    def interrupted(done, total):
        raise error

    slow, begin = _Slow(), time.monotonic()
    with pytest.raises(error):
        native.NativeAnswer(slow).decode(b"", DecodeOptions(), interrupted)
    assert time.monotonic() - begin < 1 and slow.flag.value == 1
    gc.collect()
    assert slow.freed == 1


@built
def test_the_library_looks_at_the_flag():
    loaded, flag, asset = native.library(native.LIBRARY), ctypes.c_int32(1), ctypes.c_void_p()
    data = _stream("subset/texels")

    def work():
        loaded.texf_set_stop(ctypes.byref(flag))
        status.append(loaded.texf_decode_threads(data, len(data), 0, None, 2, ctypes.byref(asset), None))

    status: list = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert status == [native.STOPPED] and not asset


@built
def test_two_at_once_do_not_disturb_each_other():
    failed = []

    def work(name):
        try:
            for _ in range(5):
                decode(_stream(name), DecodeOptions(engine="native"))
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=[name]) for name in ["subset/texels", "subset/k33"] * 2]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []


@built
@pytest.mark.parametrize(("vector", "out"), [("texels", "out.npz"), ("maps_texels", "out.glb")])
def test_a_first_decode_neither_compiles_nor_imports_numba(tmp_path, vector, out):
    program = ("import sys\nfrom texfcodec.cli import dec\ntry:\n    dec.main(sys.argv[1:])\n"
               "finally:\n    print('numba' in sys.modules)")
    cache = tmp_path / "cache"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    run = subprocess.run([sys.executable, "-c", program, VECTORS / "subset" / vector / "in.texf", tmp_path / out, "--quiet"],
                         env=environment, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, "False\n"), run.stderr
    assert not list(cache.rglob("*.nbc")) and (tmp_path / out).exists()


def test_version_names_the_engine(monkeypatch, tmp_path):
    from click.testing import CliRunner

    from texfcodec.cli.info import info

    monkeypatch.setattr(native, "LIBRARY", tmp_path / "none.so")
    said = CliRunner().invoke(info, ["--version"]).output
    assert said.splitlines()[0].startswith("texf-info ") and said.splitlines()[1].startswith("engine: ")
