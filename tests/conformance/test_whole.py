"""The streams of every day (conformance/make/whole.py) are made and decoded as listed."""

import pytest

from conformance.make.whole import main


@pytest.mark.slow
def test_the_sample_is_coded_and_decoded_as_listed(tmp_path):
    assert main([str(tmp_path)]) == 0
