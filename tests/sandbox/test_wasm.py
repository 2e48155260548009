"""The WebAssembly sandbox: the C++ decoder of native/ gives what our own gives on every vector, and stays within its caps."""

import hashlib
import json
import threading
import time
from pathlib import Path

import pytest
from engine_decoder import EngineDecoder

from conformance import run as runner
from texfcodec import DecodeOptions, decode
from texfcodec.errors import LimitError, StreamError, SupportError, TexfError
from texfcodec.limits import Limits
from texfcodec.report import Report
from texfcodec.sandbox import engines, native, wasm

pytest.importorskip("wasmtime", reason="wasmtime is not installed: there is no sandbox to try")
REPOSITORY = Path(__file__).resolve().parents[2]
VECTORS = REPOSITORY / "conformance"


@pytest.fixture(autouse=True)
def without_native(monkeypatch, tmp_path):
    monkeypatch.setattr(native, "LIBRARY", tmp_path / "none.so")


def _is_neural(folder):
    return "neural" in folder.name


@pytest.mark.parametrize("kind", ["subset", "uncommon"])
def test_every_vector_that_it_decodes_gives_the_same_arrays(kind):
    decoder, tried = EngineDecoder("wasm"), 0
    for folder in runner.cases([f"{kind}/"]):
        if not _is_neural(folder):
            assert runner.faults_of(decoder, folder) == [], folder.name
            tried += 1
    assert tried > 20


def test_every_faulty_vector_is_refused_with_the_finding_of_our_own_decoder():
    """With our own reader before it, and by the module alone, as pages have it."""
    decoder, tried = EngineDecoder("wasm"), 0
    for folder in runner.cases(["faulty/"]):
        case = json.loads((folder / "case.json").read_text(encoding="utf-8"))
        with pytest.raises(TexfError) as alone:
            wasm.Sandbox(Limits()).decode((folder / "in.texf").read_bytes(), 0)
        assert alone.value.code == case["code"], (folder.name, str(alone.value))
        exit_code, _, said = decoder(folder / "in.texf", 0)
        if _is_neural(folder) and decoder.code == "TXF-U10":
            continue
        assert (exit_code in runner.EXIT_CODES[case["expect"]], decoder.code) == (True, case["code"]), (folder.name, said)
        tried += 1
    assert tried > 250


def _stream(name):
    return (VECTORS / name / "in.texf").read_bytes()


def test_it_says_what_it_cannot_decode_and_auto_lets_the_kernels_do_it():
    neural = next(folder for folder in runner.cases(["subset/"]) if _is_neural(folder))
    data = (neural / "in.texf").read_bytes()
    with pytest.raises(SupportError, match="TXF-U10"):
        decode(data, DecodeOptions(engine="wasm"))
    assert decode(data, DecodeOptions(engine="auto")).evaluators


def test_without_wasmtime_isolate_has_its_child_and_the_engine_says_what_is_missing(monkeypatch):
    monkeypatch.setattr(wasm, "is_here", lambda: False)
    with pytest.raises(SupportError, match="wasmtime"):
        decode(_stream("subset/texels"), DecodeOptions(engine="wasm"))
    report = Report()
    decode(_stream("subset/texels"), DecodeOptions(isolate=True), report)
    assert "isolate" in report.seconds


def test_isolated_streams_go_to_the_sandbox_and_a_first_run_does():
    report = Report()
    isolated = decode(_stream("subset/texels"), DecodeOptions(isolate=True), report)
    assert "sandbox" in report.seconds and "isolate" not in report.seconds
    assert (isolated.fields[0].planes["base_colour"] == decode(_stream("subset/texels")).fields[0].planes["base_colour"]).all()


def test_a_first_run_takes_the_sandbox_until_kernels_are_compiled(monkeypatch):
    for missing, stage in ((True, "sandbox"), (False, "attributes")):
        monkeypatch.setattr(engines, "kernels_compiled", lambda missing=missing: not missing)
        report = Report()
        decode(_stream("subset/texels"), DecodeOptions(), report)
        assert stage in report.seconds


@pytest.mark.parametrize("most", [1 << 12, 1 << 21])
def test_memory_is_capped_where_isolation_is_asked_for(most):
    with pytest.raises(LimitError, match="TXF-L07"):
        decode(_stream("uncommon/texels_wide"), DecodeOptions(isolate=True, limits=Limits(isolate_bytes=most)))


def test_caps_are_those_of_isolation_alone(monkeypatch):
    capped = Limits(isolate_bytes=1 << 12, isolate_seconds=1)
    monkeypatch.setattr(engines, "kernels_compiled", lambda: False)
    for options in (DecodeOptions(engine="wasm", limits=capped), DecodeOptions(limits=capped)):
        report = Report()
        decode(_stream("subset/texels"), options, report)
        assert "sandbox" in report.seconds


def test_a_first_run_that_needs_more_memory_than_a_module_has_is_left_to_the_kernels(monkeypatch):
    def full(*_):
        raise LimitError("TXF-L07", "full")

    monkeypatch.setattr(engines, "kernels_compiled", lambda: False)
    monkeypatch.setattr(wasm.Sandbox, "decode", full)
    report = Report()
    assert decode(_stream("subset/texels"), DecodeOptions(), report).fields and "attributes" in report.seconds
    assert len(report.warnings) == len(set(report.warnings))
    with pytest.raises(LimitError, match="TXF-L07"):
        decode(_stream("subset/texels"), DecodeOptions(engine="wasm"))


def test_time_is_capped():
    with pytest.raises(LimitError, match="TXF-L08"):
        _busy(wasm.Sandbox(Limits(isolate_seconds=1)))()


def test_an_interrupt_stops_the_work_at_once(monkeypatch):
    sandbox = wasm.Sandbox(Limits())
    slow, join, calls = _busy(sandbox), threading.Thread.join, []

    def interrupted(thread, timeout=None):
        join(thread, timeout)
        calls.append(timeout)
        if len(calls) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "join", interrupted)
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        slow()
    assert time.monotonic() - begin < 2


def _busy(sandbox):
    """Work in the sandbox that never ends by itself: a module of a few bytes takes the place of ours."""
    import wasmtime

    module = wasmtime.Module(sandbox.engine, '(module (memory (export "memory") 1) (func (export "spin") (loop br 0)))')
    sandbox.exports = wasmtime.Linker(sandbox.engine).instantiate(sandbox.store, module).exports(sandbox.store)
    return lambda: sandbox._call("spin")


def test_two_at_once_do_not_stop_each_other():
    failed = []

    def work():
        try:
            decode(_stream("subset/texels"), DecodeOptions(engine="wasm"))
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []


def test_an_answer_that_makes_no_sense_is_refused(monkeypatch):
    array = wasm.Sandbox.array

    def bent(self, kind, i=0, j=0, dtype="u1"):
        found = array(self, kind, i, j, dtype)
        return found + 9999 if kind == wasm.FACES else found

    monkeypatch.setattr(wasm.Sandbox, "array", bent)
    with pytest.raises(StreamError, match="TXF-S40"):
        decode(_stream("subset/texels"), DecodeOptions(engine="wasm"))


@pytest.mark.parametrize("name, count", [("wasm", 12), ("blocks", 2)])
def test_the_module_is_what_these_sources_make(name, count):
    """`make -C native wasm blocks` writes the sums; the sources changed without it where this fails."""
    lines = (REPOSITORY / f"native/{name}.sha256").read_text(encoding="utf-8").split("\n")
    sums = [line.split() for line in lines if line]
    assert len(sums) == count
    for wanted, path in sums:
        content = (REPOSITORY / "native" / path).read_bytes()
        assert hashlib.sha256(content).hexdigest() == wanted, path
