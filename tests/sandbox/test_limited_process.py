"""Processes with capped memory: what fails under a cap has a code, and what a child answers is read within bounds."""

import errno
import io
import sys
import threading
from dataclasses import asdict
from types import SimpleNamespace

import pytest
from conftest import REPOSITORY

from texfcodec import LimitError, Limits, SupportError, TexfError
from texfcodec.sandbox import isolate
from texfcodec.sandbox.limited_process import (
    FACTS,
    FACTS_BYTES,
    LEAST_BYTES,
    cap_memory,
    is_memory,
    read_facts,
    within_cap,
)


def test_an_answer_that_is_too_long_is_not_read(tmp_path):
    with open(tmp_path / FACTS, "wb") as file:
        file.truncate(FACTS_BYTES + 1)
    with pytest.raises(ValueError, match="too long"):
        read_facts(tmp_path)


def test_want_of_memory_is_known_in_whatever_it_is_wrapped():
    wrapped = ValueError("no")
    wrapped.__cause__ = OSError(errno.ENOMEM, "x")
    assert is_memory(MemoryError()) and is_memory(wrapped) and is_memory(RuntimeError("std::bad_alloc"))
    assert not is_memory(None) and not is_memory(ValueError("no"))
    assert cap_memory(None)


@pytest.mark.parametrize("raised, code", [
    (MemoryError(), "TXF-L07"), (ImportError("no room for a module"), "TXF-L07"), (SyntaxError("expected ':'"), "TXF-L07"),
    (SupportError("TXF-U03", "no"), "TXF-U03")])
def test_what_fails_within_a_cap_has_a_code(monkeypatch, raised, code):
    def work():
        raise raised

    monkeypatch.setattr("texfcodec.sandbox.limited_process.cap_memory", lambda size: True)
    with pytest.raises(TexfError) as found:
        within_cap(Limits(), work)
    assert found.value.code == code


def test_a_module_that_is_missing_where_nothing_is_capped_is_no_want_of_memory():
    def work():
        raise ImportError("no such module")

    with pytest.raises(ImportError, match="no such module"):
        within_cap(Limits(isolate_bytes=None), work)


def test_work_within_a_cap_gives_what_it_gives_and_later_threads_have_their_usual_stack(monkeypatch):
    monkeypatch.setattr("texfcodec.sandbox.limited_process.cap_memory", lambda size: size is None)
    before = threading.stack_size()
    assert within_cap(Limits(isolate_bytes=None), lambda: 7) == (7, True) and within_cap(Limits(), lambda: 8) == (8, False)
    assert threading.stack_size() == before


def test_too_little_memory_to_begin_is_refused_before_the_work():
    with pytest.raises(LimitError) as raised:
        within_cap(Limits(isolate_bytes=LEAST_BYTES - 1), pytest.fail)
    assert raised.value.code == "TXF-L07" and raised.value.details["allowed"] == LEAST_BYTES - 1


def test_a_child_says_what_went_wrong_in_it(monkeypatch, tmp_path):
    """In this process, whose memory is not capped."""
    request = {"limits": asdict(Limits())}
    stream = io.BytesIO((REPOSITORY / "conformance/uncommon/one_voxel/in.texf").read_bytes())
    monkeypatch.setattr("texfcodec.sandbox.limited_process.cap_memory", lambda size: False)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=stream))
    isolate._child(tmp_path, dict(request))
    assert read_facts(tmp_path)["capped"] is False

    def fails(error):
        def decode_stream(*_):
            raise error

        monkeypatch.setattr("texfcodec.decoder.decode_stream", decode_stream)
        isolate._child(tmp_path, dict(request))

    fails(MemoryError())
    assert read_facts(tmp_path)["error"]["code"] == "TXF-L07"
    with pytest.raises(ZeroDivisionError):
        fails(ZeroDivisionError())
