"""The page draws what texf-render draws: conformance vectors, flat and in light."""

from pathlib import Path

import numpy as np
import pytest
from browser import needs_browser
from devtools import Page

from texfcodec.api import decode
from texfcodec.render.camera import direction_of_angles, orthographic
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.shade import render_texf
from texfcodec.viewer.server import Shown, ViewServer

pytestmark = needs_browser
VECTORS = Path(__file__).resolve().parents[2] / "conformance"
SIZE, ANGLES, DISTANCE = 256, (35.0, 25.0), 1.1
# dB inside what both cover: corners snap to a grid of 1/16 pixel, and three.js has terms of light of its own. Texels of noise are
# filtered in linear light and by 16 samples, which texf-render does not.
FLAT, LIT, TEXELS = 38.0, 30.0, 25.0
# Every kind of field, alpha, rule of normals and map. maps_neural is left out: its faces coincide with faces of another field.
CHOSEN = {"k33": FLAT, "two_fields": FLAT, "alpha_mask": FLAT, "maps_voxels": FLAT, "neural_hash": FLAT, "texels_repeat": TEXELS,
          "maps_texels": TEXELS}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Page(tmp_path_factory.mktemp("page") / "profile") as page:
        page.call("Emulation.setDeviceMetricsOverride", width=SIZE, height=SIZE, deviceScaleFactor=1, mobile=False)
        yield page


def agreement(browser, name, lit, theirs=None):
    """PSNR in dB of the page's picture of a vector against texf-render's. theirs: whether that is lit, as the page's if None."""
    data = next(VECTORS.glob(f"*/{name}/in.texf")).read_bytes()
    link = ",".join(map(str, (*ANGLES, DISTANCE, 0, 0, 0, 0)))
    start = {"camera": {"link": link}, "shaded": lit, "mode": "single", "layer": None, "background": "white"}
    with ViewServer([Shown(name, len(data), data)], start=start) as server:
        browser.open(server.address)
        browser.run("viewer.panel.root.open = false")
        browser.settle()
        picture, sphere = browser.pixels(), browser.run("viewer.assets[0].sphere")
        browser.call("Page.navigate", url="about:blank")
    centre = np.array([sphere["center"][axis] for axis in "xyz"])
    camera = orthographic(direction_of_angles(*ANGLES), centre, DISTANCE * sphere["radius"], SIZE)
    drawn = render_texf(decode(data), camera, shaded=DAYLIGHT if (lit if theirs is None else theirs) else None)
    covered = np.zeros(SIZE * SIZE, bool)
    covered[drawn.pixel] = True
    inside = np.lib.stride_tricks.sliding_window_view(np.pad(covered.reshape(SIZE, SIZE), 1), (3, 3)).all(axis=(2, 3))
    error = (drawn.image((255, 255, 255)).astype(float) - picture)[inside] ** 2
    assert inside.sum() > 1000 and browser.errors == []
    return 10 * np.log10(255**2 / max(error.mean(), 1e-9))


@pytest.mark.parametrize("name", CHOSEN)
def test_page_and_texf_render_agree_on_kinds_of_streams(browser, name):
    assert agreement(browser, name, False) > CHOSEN[name] and agreement(browser, name, True) > min(CHOSEN[name], LIT)


def test_a_picture_of_other_light_is_seen_by_the_measure(browser):
    """The measure can fail."""
    assert agreement(browser, "maps_voxels", True, theirs=False) < LIT - 5
