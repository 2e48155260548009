"""What hypothesis makes of assets and settings is coded or refused by a code, and comes back: never an internal error, and never
a number that JSON lacks."""

import contextlib
import io
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from asset_strategies import SLOW_RATES, Asset, assets, flags_of, settings_of_encode, usual
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from texfcodec import EncodeOptions, Report, TexfError, decode, encode_to_result
from texfcodec.cli import enc
from texfcodec.io.load import load
from texfcodec.metrics.face_match import decoded_faces
from texfcodec.validate.validate import validate

REFUSED = (2, 5, 6)  # exit codes of inputs, of what is not supported, and of limits
MADE = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow, HealthCheck.data_too_large], "derandomize": True}
ROUNDED = 0.501  # levels that rounding a colour to a byte costs


pytestmark = pytest.mark.filterwarnings("ignore::texfcodec.LossWarning")  # which is what lossy assets are for


def strictly(text):
    """JSON as its standard has it, without NaN or Infinity."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def by_command_line(folder, glb, options):
    """(exit code, what --json says, stream or None) of texf-enc in this process."""
    source, out, said = folder / "in.glb", folder / "out.texf", io.StringIO()
    source.write_bytes(glb)
    with pytest.raises(SystemExit) as ended, contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        enc.main([str(source), str(out), "--json", "--threads", "1", *flags_of(options)])
    return ended.value.code, strictly(said.getvalue()), out.read_bytes() if out.exists() else None


def by_function(glb, options):
    """The same of the Python API, whose facts must be JSON as well."""
    options = dict(options)
    if "near_lossless" in options:
        options["max_error"] = options.pop("near_lossless")
    report = Report()
    try:
        made = encode_to_result(load(glb), EncodeOptions(threads=1, **options), report)
    except TexfError as error:
        return error.exit_code, strictly(json.dumps({"error": error.as_dict()}, default=str)), None
    facts = {**made.choices, "psnr_3d": made.psnr_3d, "seconds": report.seconds, "trials": report.trials}
    return 0, strictly(json.dumps(facts, allow_nan=False)) | {"faces": made.counts["faces"]}, made.data


def check(asset, options, by_api):
    """Codes an asset and claims what holds of any."""
    glb = asset.glb()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        code, facts, data = by_function(glb, options) if by_api else by_command_line(folder, glb, options)
        if code:
            assert code in REFUSED and data is None, facts
            assert facts["error"]["code"].startswith("TXF-") and facts["error"]["code"] != "TXF-C04", facts
            return
        found = validate(data)
        assert [one for one in found["findings"] if one["severity"] == "error"] == []
        texf = decode(data)
        assert len(texf.faces) == facts["faces"]
        check_colours(load(glb), texf, asset, options)
        check_bound(facts["channels"], options)
        texf.save(folder / "back.glb", texture_size=64, atlas="fast")
        assert len(load(folder / "back.glb").faces) == len(texf.faces)


def check_colours(scene, texf, asset, options):
    """One colour comes back within a level, invisible parts invisible; palettes exactly, without loss or at a rate."""
    face, _ = decoded_faces(scene, texf)
    for number, part in enumerate(asset.parts):
        mine = np.flatnonzero(scene.face_material == number)
        there = face[mine]
        if not len(mine) or (there < 0).all():
            continue
        expected = expected_levels(part, len(mine), len(asset.parts), options)
        if expected is None:
            continue
        points = texf.positions[texf.faces[there[there >= 0]]].mean(axis=1)
        got = texf.query(points, there[there >= 0])
        wanted, columns = expected[0][there >= 0], expected[1]
        np.testing.assert_allclose(got[:, columns], wanted[:, columns], atol=expected[2])


def check_bound(channels, options):
    """No value is further off than the bound and what rounding the source costs, by the PSNR of base colour and alpha."""
    bound = 0 if "lossless" in options else options.get("near_lossless")
    least = None if bound is None else 20 * np.log10(255 / (bound + 0.5))
    for name, psnr in ((name, psnr) for one in channels for name, psnr in one["psnr"].items()):
        assert least is None or psnr is None or name not in ("base_colour", "alpha") or psnr > least - 0.01, (name, psnr)


def expected_levels(part, count, parts, options):
    """(levels [count, 4], columns that are bound, most difference), or None where nothing is claimed."""
    lossless, alone = "lossless" in options, parts == 1
    if part.is_uniform and (alone or lossless):
        return np.tile(part.levels[0], (count, 1)), [0, 1, 2], 1.0
    by_texels = options.get("support") == "texels" and "texel_size" not in options
    if part.kind == "palette" and by_texels and (lossless or "rate" in options):
        return np.array(part.levels)[part.colours_of_faces(count)], [0, 1, 2], ROUNDED
    if part.kind == "invisible" and alone:
        return np.zeros((count, 4)), [3], 1.0
    return None


FOUND = [  # what these tests have found, or were made for
    (Asset((usual("factor", levels=((255, 0, 0, 0),), mode="BLEND"),)), {"resolution": 8, "qp": 28, "measure": True}),
    (Asset((usual("invisible", levels=((0,) * 4,), mode="MASK"),)), {"support": "texels", "lossless": True, "measure": True}),
    (Asset((usual("factor", shape="flat"),)), {"resolution": 16, "qp": 20, "effort": "balanced"}),
    (Asset((usual("one colour"), usual("noise"))), {"resolution": 16, "qp": 20, "effort": "balanced"}),
    (Asset((usual("palette", levels=((9, 9, 9, 255), (200, 1, 50, 255), (0, 255, 0, 255))),)),
     {"support": "texels", "rate": "r01"}),
]


@pytest.mark.parametrize("by_api", [True, False])
@pytest.mark.parametrize("asset, options", FOUND)
def test_what_was_found_is_coded_and_comes_back(asset, options, by_api):
    check(asset, options, by_api)


@settings(max_examples=12, **MADE)
@given(assets(), settings_of_encode(), st.booleans())
def test_any_asset_at_any_setting_is_coded_and_comes_back_or_is_refused_by_a_code(asset, options, by_api):
    check(asset, options, by_api)


@pytest.mark.slow
@settings(max_examples=600, **MADE)
@given(assets(), st.one_of(settings_of_encode(), settings_of_encode(SLOW_RATES)), st.booleans())
def test_many_assets_at_any_setting_and_rate_are_coded_and_come_back(asset, options, by_api):
    check(asset, options, by_api)
