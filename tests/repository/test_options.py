"""EncodeOptions: what makes no sense is refused with the name of the option, before any work."""

import pytest

from texfcodec import EncodeOptions, InputError


@pytest.mark.parametrize("options", [
    {"resolution": "wide"}, {"resolution": 2.5}, {"resolution": 0}, {"resolution": 8193}, {"position_bits": 7},
    {"position_bits": 21}, {"qp": True}, {"qp": float("nan")}, {"qp": -1}, {"qp": 64}, {"threads": -1}, {"rate": "r09"},
    {"effort": "best"}, {"lossless": 1}, {"max_error": -1}, {"max_error": 128}, {"lossless": True, "max_error": 2},
    {"max_error": 0, "qp": 20}, {"max_error": 1, "target_bytes": 9000}, {"max_error": 1, "target_psnr": 30.0},
    {"codec": "raht", "point": "mpeg1"}, {"codec": "3dntc", "point": "mpeg9"}, {"codec": "3dntc", "latent_index": "tree"},
    {"codec": "3dntc", "steps": 0}, {"codec": "3dntc", "target_bytes": 1000}, {"codec": "3dntc", "max_error": 0},
    {"codec": "3dntc", "support": "texels"}, {"codec": "3dntc", "texel_size": 64}, {"codec": "3dntc", "exact_rate": True},
    {"target_psnr_of": "lit"}, {"target_psnr": 30.0, "target_psnr_of": "shiny"},
    {"codec": "3dntc", "refine": "fit"}, {"codec": "3dntc", "point": "mpeg1", "resident_bytes": 40_000},
    {"codec": "3dntc", "resident_bytes": 40_000, "latent_index": "hash"}], ids=str)
def test_options_that_make_no_sense_are_refused_by_name(options):
    with pytest.raises(InputError, match="TXF-I50") as refused:
        EncodeOptions(**options)
    assert [*options][-1] in str(refused.value).replace(" ", "_")
