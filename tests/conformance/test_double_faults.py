"""Of two faults the one that 9.2 puts first decides, in every decoder."""

import pytest

from conformance.make import double_faults
from conformance.reference import decoder as reference
from conformance.reference.bits import Invalid, Unsupported
from texfcodec import decode
from texfcodec.errors import TexfError


def _ours(data):
    with pytest.raises(TexfError) as refusal:
        decode(data)
    return refusal.value.exit_code


def _reference(data):
    with pytest.raises((Invalid, Unsupported)) as refusal:
        reference.decode(data)
    return double_faults.UNSUPPORTED if refusal.type is Unsupported else double_faults.INVALID


def test_of_two_faults_the_first_in_the_order_of_the_specification_decides():
    tried = 0
    for title, data, expect, _ in double_faults.double_faults(double_faults.SHARE):
        assert (_ours(data), _reference(data)) == (expect, expect), title
        tried += 1
    assert tried > 300
