"""The encoder's look at what it made: it finds the part that is worst, mends what it can, and says what it cannot."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from shapes import painted_sphere
from walls import boxes, noisy_wall

from texfcodec import EncodeOptions, InputError, LimitError, Report, decode
from texfcodec.api import encode_loaded, encode_to_result
from texfcodec.encoder.caches import Caches
from texfcodec.encoder.encode import Encoder
from texfcodec.encoder.supports import choice
from texfcodec.encoder.supports.trial import Trials
from texfcodec.encoder.values.coder import Coder
from texfcodec.encoder.verify import Miss, _most_bytes, misses, promised_psnr, warnings_of
from texfcodec.metrics.psnr_3d import measure
from texfcodec.options import RATES
from texfcodec.scene.scene import ALPHA_BLEND


@pytest.fixture(autouse=True)
def coarse_rates(monkeypatch):
    """The rates with fewer voxels, so that this takes seconds."""
    for name, (_, qp) in RATES.items():
        monkeypatch.setitem(RATES, name, (256, qp))


def test_the_check_has_the_figures_of_a_decoder_and_names_the_worst_part():
    scene, report = noisy_wall(20), Report()
    made = encode_loaded(scene, EncodeOptions(rate="r03"), report)
    outside = measure(scene, decode(made.data), 60_000)
    assert made.check["y"] == pytest.approx(outside["y"], abs=0.3) and made.check["rgb"] == pytest.approx(outside["rgb"], abs=0.3)
    assert made.check["worst"]["name"] == "noisy" and [part["name"] for part in made.check["parts"]] == ["calm", "noisy"]
    assert made.check["lit"] > 30 and "check" in report.seconds and made.values == []


def test_values_that_the_time_allows_are_decoded_from_the_stream_and_all_have_their_checksum_compared(monkeypatch):
    scene = noisy_wall(5)
    for share, decoded in ((1e9, 2), (0.0, 0)):
        monkeypatch.setattr("texfcodec.encoder.verify.SHARE", share)
        made = encode_loaded(scene, EncodeOptions(rate="r03", support="texels"), Report())
        assert made.check["decoded_units"] == [decoded, 2]


def test_a_part_that_came_out_wrong_is_coded_again_finer(monkeypatch):
    scene, report = boxes(), Report()
    monkeypatch.setattr(choice, "rounding_errors", lambda *_: np.zeros(9))  # UVs in whole texels, 16 dB
    assert encode_to_result(scene, EncodeOptions(rate="r03", no_check=True)).check is None
    made = encode_loaded(scene, EncodeOptions(rate="r03"), report)
    assert made.check["rgb"] is None and not report.warnings
    assert len(report.remarks) == 1 and "coded again at higher quality" in report.remarks[0]


@pytest.mark.parametrize("support", ["auto", "texels"])
def test_what_a_second_coding_takes_from_the_first_is_what_it_would_make_itself(support, monkeypatch):
    scene, options, coded = noisy_wall(20, n=16), EncodeOptions(rate="r03", support=support), []
    encoder = Encoder(scene=scene, caches=Caches.of_second_try())
    code = Coder.code
    monkeypatch.setattr(Coder, "code", lambda *given: coded.append(given) or code(*given))
    encoder.encode(options, Report())
    for finer in ({0}, {1}):
        coded.clear()
        again, taken = encoder.encode(options, Report(), frozenset(finer)), len(coded)
        coded.clear()
        assert again.data == Encoder(scene=scene).encode(options, Report(), frozenset(finer)).data
        assert taken < len(coded)


def test_what_stays_worse_than_the_rate_promises_is_a_warning_that_strict_refuses():
    scene, report = noisy_wall(60), Report()
    made = encode_loaded(scene, EncodeOptions(rate="r03", support="voxels"), report)
    assert misses(made.check)[0].name == "noisy" and any("part 'noisy' has" in text for text in report.warnings)
    with pytest.raises(InputError) as caught:
        encode_loaded(scene, EncodeOptions(rate="r03", support="voxels", strict=True), Report())
    assert caught.value.code == "TXF-I52"


def test_only_a_rate_whose_supports_are_free_promises_anything():
    assert promised_psnr(EncodeOptions(rate="r03")) == pytest.approx(40.0, abs=0.2)
    for options in (EncodeOptions(resolution=64, qp=28), EncodeOptions(exact_rate=True), EncodeOptions(lossless=True),
                    EncodeOptions(target_bytes=1000), EncodeOptions(target_psnr=30.0)):
        assert promised_psnr(options) is None


def test_a_surface_that_nobody_sees_is_said_to_be_one():
    scene, report = painted_sphere(4), Report()
    scene.materials[0].alpha_mode = ALPHA_BLEND
    scene.materials[0].factor[3] = 0.0
    made = encode_loaded(scene, EncodeOptions(rate="r03"), report)
    assert not made.check["visible"] and any("no part of the source's surface is visible" in text for text in report.warnings)


def test_light_that_is_far_off_is_a_warning():
    check = {"promised": 40.0, "parts": [], "visible": True, "lit": 29.0}
    assert len(warnings_of(check, EncodeOptions(rate="r03"))) == 1
    assert warnings_of(check | {"lit": 31.0}, EncodeOptions(rate="r03")) == []


def test_a_stream_that_is_larger_than_its_source_is_a_warning():
    for size, warned in ((10, True), (1 << 20, False)):
        scene, report = painted_sphere(4), Report()
        scene.files = {"a.glb": size}
        encode_loaded(scene, EncodeOptions(rate="r01"), report)
        assert any("larger than its source" in text for text in report.warnings) is warned


def test_a_speck_that_came_out_wrong_does_not_cost_the_whole_stream_half_its_bytes():
    speck, whole = (Miss(material=0, name="a", share=share, measure="Y", psnr=20.0) for share in (0.001, 0.9))
    made = SimpleNamespace(data=bytes(1000))
    known = {size: SimpleNamespace(files={"a.glb": size} if size else {}) for size in (0, 500, 1200)}
    assert _most_bytes(made, [speck], known[0]) == 1010 and _most_bytes(made, [speck, whole], known[0]) == 1500
    assert [_most_bytes(made, [whole], known[size]) for size in (500, 1200)] == [1000, 1200]


def test_a_second_coding_over_a_limit_leaves_the_first_and_its_warning(monkeypatch):
    """Finer voxels may be more than a limit allows that the first coding kept."""
    scene, first = noisy_wall(60), Encoder.filled

    def limited(encoder, options, report, finer=frozenset(), budget=None):
        if finer:
            raise LimitError("TXF-L04", "the fields have more voxels than the limit allows", value=2, allowed=1)
        return first(encoder, replace(options, support="voxels"), report)

    monkeypatch.setattr(Encoder, "filled", limited)
    report = Report()
    made = encode_loaded(scene, EncodeOptions(rate="r03"), report)
    assert made.data and any("part 'noisy' has" in text for text in report.warnings)


def test_texels_that_came_out_too_coarse_are_coded_again_on_the_same_mesh(monkeypatch):
    """Trials that expect the errors of a much finer QP: values are coded again, and nothing before them is done again."""
    settled, filled, runs = Trials._settled, Encoder.filled, []

    def coarse(*given):
        trial = settled(*given)
        return trial and replace(trial, qp_offset=10)

    monkeypatch.setattr("texfcodec.encoder.verify.MOST_MORE", 9.0)
    monkeypatch.setattr(Trials, "_settled", coarse)
    monkeypatch.setattr(Encoder, "filled", lambda *given: runs.append(given) or filled(*given))
    made = encode_loaded(noisy_wall(20), EncodeOptions(rate="r03", keep_mesh=True), report := Report())
    assert len(runs) == 1 and "coded again at higher quality" in report.remarks[-1] and not misses(made.check)
    assert 0 in [channel["qp_offset"] for channel in made.choices["channels"]]
