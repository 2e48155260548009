"""Of two faults the one that 9.2 puts first decides, in every decoder."""

import pytest

from conformance.make.double_faults import INVALID, SHARE, UNSUPPORTED, double_faults
from conformance.reference import decoder as reference
from conformance.reference.bits import Invalid, Unsupported
from texfcodec import DecodeOptions, Limits, decode
from texfcodec.errors import TexfError
from texfcodec.sandbox import native, wasm


def _package(data):
    decode(data, DecodeOptions(engine="numba"))


def _library(data):
    if not native.is_here():
        pytest.skip("the native library is not built: run make native")
    native.NativeAnswer(native.library(native.LIBRARY)).decode(data, DecodeOptions(), lambda done, total: None)


def _module(data):
    pytest.importorskip("wasmtime")
    wasm.Sandbox(Limits()).decode(data, 0)


@pytest.mark.parametrize(("decoder", "share"), [(_package, SHARE), (reference.decode, SHARE), (_library, 10 * SHARE),
                                               (_module, 10 * SHARE)])
def test_of_two_faults_the_first_in_the_order_of_the_specification_decides(decoder, share):
    for title, data, expect, _ in double_faults(share):
        with pytest.raises((TexfError, Invalid, Unsupported)) as refusal:
            decoder(data)
        code = {Invalid: INVALID, Unsupported: UNSUPPORTED}.get(refusal.type) or refusal.value.exit_code
        assert code == expect, title
