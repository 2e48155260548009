"""The page as a person uses it: keys, pointers, files and what goes wrong, in headless Chromium."""

import re

import numpy as np
import pytest
from browser import needs_browser
from devtools import Page
from gltf_scenes import spinning
from shapes import mapped_sheet, noise, painted_sphere, scene_of, sphere, square

from texfcodec import EncodeOptions, decode, encode, encode_gltf
from texfcodec.viewer.dropped import glb_of_dropped
from texfcodec.viewer.glb import glb_of_scene
from texfcodec.viewer.page import export_page
from texfcodec.viewer.server import Shown, ViewServer

pytestmark = needs_browser
FRONT = {"direction": [0.0, 0.0, 1.0], "perspective": None}
START = {"camera": FRONT, "shaded": False, "mode": "single", "layer": None, "background": "rgb(255 255 255)"}
GREY = "linear-gradient(rgb(150, 150, 150), rgb(104, 104, 104))"
MIDDLE = (320, 200)
CONTEXT = "document.getElementById('view').getContext('webgl2')"
APART = "document.querySelectorAll('.problem:not([hidden])').length"


def mesh(scene, name="ball.glb"):
    data = glb_of_scene(scene)
    return Shown(name, len(data), data)


@pytest.fixture(scope="module")
def assets():
    """A sphere as a stream and as its source, and a sheet with maps that is lit, by name."""
    source = painted_sphere(10)
    stream = encode(source, EncodeOptions(resolution=32, qp=40))
    sheet = mapped_sheet({"roughness": noise(1), "emissive": noise(2)}, double_sided=True,
                         parameters={"emissive": (1.0, 0.5, 1.0)})
    return {"stream": Shown("ball.texf", len(stream), stream), "source": mesh(source), "sheet": mesh(sheet, "sheet.glb")}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Page(tmp_path_factory.mktemp("page") / "profile") as page:
        page.call("Emulation.setDeviceMetricsOverride", width=640, height=400, deviceScaleFactor=1, mobile=False)
        yield page


@pytest.fixture
def show(browser, assets):
    """show(name, ..., query, start): the browser's page of these assets, once their picture stands. Afterwards it must have
    complained of nothing that the test has not taken out of its errors."""
    servers = []

    def opened(*names, query="", start=START):
        chosen = [assets[name] if isinstance(name, str) else name for name in names]
        servers.append(ViewServer(chosen, drop=glb_of_dropped, start=start))
        servers[-1].__enter__()
        browser.errors.clear()
        browser.open(servers[-1].address + query)
        return browser

    yield opened
    browser.call("Page.navigate", url="about:blank")
    for server in servers:
        server.__exit__()
    assert browser.errors == []


def camera(page):
    """Azimuth, elevation, distance, target and field of view, as the page copies them."""
    return np.array([float(number) for number in page.run("viewer.view.link").split(",")])


def mode(page):
    return page.run("document.querySelector('input[name=mode]:checked').value")


def differ(one, two):
    """How many pixels of two pictures differ."""
    return int((one != two).any(axis=2).sum())


# The camera


def test_arrows_and_numbers_turn_the_camera_and_the_picture(show):
    page = show("stream")
    before = page.pixels()
    page.press("ArrowRight")
    page.press("ArrowUp")
    assert camera(page)[:2].tolist() == [5, 5] and differ(before, page.pixels()) > 1000
    for number, angles in enumerate(((0, 0), (180, 0), (-90, 0), (90, 0), (0, 90), (0, -90)), 1):
        page.press(str(number))
        assert camera(page)[:2] == pytest.approx(angles, abs=1e-3)
    page.press("1")
    assert differ(before, page.pixels()) == 0


def test_keys_zoom_move_and_frame(show):
    page = show("stream")
    before = camera(page)
    page.press("+")
    page.press("ArrowLeft", shift=True)
    assert camera(page)[2] < before[2] and camera(page)[3] > 0
    page.press("f")
    assert camera(page) == pytest.approx(before)


def test_projection_changes_and_what_is_seen_keeps_its_size(show):
    page = show("stream")
    size = int((page.pixels() != 255).any(axis=2).sum())
    page.press("+")  # by hand, so that it is not framed anew
    page.press("-")
    page.press("o")
    assert camera(page)[6] == 40 and page.run("viewer.panel.deep.box.checked")
    assert int((page.pixels() != 255).any(axis=2).sum()) == pytest.approx(size, rel=0.15)
    page.press("o")
    assert camera(page)[6] == 0


@pytest.mark.parametrize("perspective", [None, 40.0])
@pytest.mark.parametrize("view", ["1", "3", "5"])
def test_the_camera_frames_the_box_that_the_model_projects_to(show, view, perspective):
    """A rod fills the height or the width. Framed by a bounding sphere, most of the picture would be empty."""
    positions, faces = sphere(8)
    rod = mesh(scene_of(positions * [0.05, 1.0, 0.15], faces))
    page = show(rod, start={**START, "camera": {**FRONT, "perspective": perspective}})
    page.press(view)
    covered = (page.pixels() != 255).any(axis=2)
    rows, columns = (np.flatnonzero(covered.any(axis=k)) for k in (1, 0))
    height, width = len(rows) / covered.shape[0], len(columns) / covered.shape[1]
    assert 0.85 < max(height, width) <= 1 and abs(rows.mean() / covered.shape[0] - 0.5) < 0.05


def test_a_mouse_turns_moves_and_zooms(show):
    page = show("stream")
    first = camera(page)
    page.drag(MIDDLE, (370, 220))
    turned = camera(page)
    assert turned[0] < -20 and turned[1] > 8 and turned[2:] == pytest.approx(first[2:], abs=1e-3)
    page.drag(MIDDLE, (370, 200), button="right")
    page.drag(MIDDLE, (320, 250), shift=True)
    moved = camera(page)
    assert moved[:3] == pytest.approx(turned[:3], abs=1e-2) and np.abs(moved[3:6]).max() > 0.1
    page.mouse("mouseWheel", *MIDDLE, deltaX=0, deltaY=-200)
    page.until(f"viewer.view.distance < {0.95 * moved[2]}")
    page.run("document.getElementById('view').dispatchEvent(new MouseEvent('dblclick'))")
    page.settle()
    assert np.abs(camera(page)[3:6]).max() < 0.05


def test_two_fingers_pinch(show):
    page = show("stream")
    before = camera(page)
    page.touch([(300, 200), (340, 200)], [(280, 200), (360, 200)], [(260, 200), (380, 200)])
    assert camera(page)[2] == pytest.approx(before[2] * 40 / 120, rel=0.05)
    page.touch([(320, 200)], [(345, 200)])
    assert camera(page)[0] < -5


def test_the_address_sets_the_camera_and_a_key_writes_it_there(show):
    page = show("stream", query="#camera=30,20,2.5,0.1,0.2,0.3,35")
    assert camera(page).tolist() == [30, 20, 2.5, 0.1, 0.2, 0.3, 35]
    page.press("ArrowRight")
    page.press("c")
    assert page.run("location.hash") == "#camera=35,20,2.5,0.1,0.2,0.3,35" and "camera" in page.message()
    page.run("void (location.hash = '#camera=1,2,3,0,0,0,0')")
    page.until("viewer.view.link === '1,2,3,0,0,0,0'")
    page.run("void (location.hash = '#camera=1,2')")
    page.until("document.querySelector('#message span').textContent.includes('no camera')")
    assert camera(page).tolist() == [1, 2, 3, 0, 0, 0, 0]


# Two assets


def test_keys_choose_how_two_are_compared(show):
    page = show("stream", "source")
    seen = {mode(page): page.pixels()}
    for key, name in ((" ", "other"), ("s", "split"), ("d", "difference"), ("a", "side")):
        page.press(key)
        assert mode(page) == name
        seen[name] = page.pixels()
    page.press("a")
    assert mode(page) == "single" and differ(seen["single"], page.pixels()) == 0
    assert len({picture.tobytes() for picture in seen.values()}) == 5
    page.press("s")
    half = seen["split"].shape[1] // 2
    for part, name in ((slice(0, half - 1), "single"), (slice(half + 1, None), "other")):
        assert differ(seen["split"][:, part], seen[name][:, part]) == 0


def test_the_line_between_two_is_dragged(show):
    page = show("stream", "source", start={**START, "mode": "split"})
    before = camera(page)
    page.drag((320, 50), (200, 60))
    assert page.run("viewer.settings.slider") == pytest.approx(200 / 640, abs=0.01) and (camera(page) == before).all()
    split = page.pixels()
    page.press("ArrowRight")
    assert page.run("viewer.settings.slider") == pytest.approx(0.3325, abs=0.01), "the line has the focus"
    page.run("viewer.canvas.focus()")
    page.press(" ")
    assert differ(page.pixels()[:, 220:], split[:, 220:]) == 0
    page.drag((200, 200), (220, 200))
    assert camera(page)[0] < -8, "there is no line where one is shown alone"


@pytest.mark.parametrize("how", ["single", "split", "side"])
def test_psnr_that_is_told_is_that_of_the_two_pictures(show, how):
    page = show("stream", "source", start={**START, "mode": how})
    told = page.run("[...document.querySelectorAll('#psnr td')].map((cell) => cell.textContent)")
    found = page.run("(({rgb, channels, both}) => [rgb, ...channels, both])(viewer.stage.compare(viewer.view, viewer.settings))")
    page.run("viewer.change({mode: 'single'})")
    pictures = []
    for key in (" ", " "):
        page.press(key)
        pictures.append(page.pixels().astype(float))
    both = (pictures[0] != 255).any(axis=2) & (pictures[1] != 255).any(axis=2)
    assert told == [f"{value:.2f}" for value in found[:4]] and 15 < found[0] < 60
    psnr = 10 * np.log10(255**2 / ((pictures[0] - pictures[1])[both] ** 2).mean())
    assert how == "side" or psnr == pytest.approx(found[0], abs=0.2)


def test_an_asset_equals_itself(show):
    page = show("stream", "stream", start={**START, "mode": "difference"})
    assert page.run("document.querySelector('#psnr td').textContent") == "equal"
    assert set(map(tuple, page.pixels().reshape(-1, 3).tolist())) <= {(0, 0, 0), (255, 255, 255)}


def test_two_that_stand_in_different_places_are_framed_each_by_itself(show):
    far = scene_of(*square(side=1e4))
    alone = show(mesh(far)).pixels()
    page = show("stream", mesh(far), start={**START, "mode": "other"})
    assert page.run(APART) == 1 and (alone != 255).any() and differ(alone, page.pixels()) < 100
    assert show("stream", "source").run(APART) == 0


# Layers and light


def test_every_layer_of_the_list_is_drawn(show):
    page = show("sheet", "stream")
    layers = page.run("[...document.getElementById('layer').options].map((option) => option.value)")
    assert {"picture", "base_colour", "roughness", "emissive", "normals", "faces", "cubes", "fields", "triangles"} <= set(layers)
    seen = {}
    for layer in layers:
        page.run(f"viewer.change({{layer: '{layer}'}})")
        page.settle()
        seen[layer] = page.pixels()
        assert page.message() == "" and page.run("document.getElementById('layer').value") == layer
    assert len({seen[layer].tobytes() for layer in layers if layer not in ("picture", "faces")}) >= len(layers) - 3
    page.run("viewer.change({layer: 'roughness'})")
    page.settle()
    assert page.run("viewer.panel.missing.textContent") == "ball.texf: no such layer, shown in grey."


def test_a_layer_shows_what_is_coded(show):
    base, rough = (np.full((4, 4, 4), (level, level, level, 255), np.uint8) for level in (200, 90))
    page = show(mesh(mapped_sheet({"roughness": rough}, base)))
    for layer, level in (("base_colour", 200), ("roughness", 90)):
        page.run(f"viewer.change({{layer: '{layer}'}})")
        page.settle()
        assert np.abs(page.pixels()[100:300, 220:420].astype(int) - level).max() <= 1, layer


def test_what_is_lit_is_in_light_at_first_and_effects_are_switched_one_by_one(show):
    page = show("sheet", start={**START, "shaded": None})
    lit = page.pixels()
    assert page.run("viewer.panel.light.box.checked")
    page.press("l")
    assert differ(lit, page.pixels()) > 1000 and not page.run("viewer.panel.light.box.checked")
    page.press("l")
    ticks = "[...document.querySelectorAll('.effects .tick')]"
    names = page.run(f"{ticks}.map((label) => label.textContent)")
    assert "Emission" in names
    for at, name in enumerate(names):
        page.run(f"{ticks}[{at}].querySelector('input').click()")
        page.settle()
        assert differ(lit, page.pixels()) > 1000 and page.message() == "", name
        page.run(f"{ticks}[{at}].querySelector('input').click()")
        page.settle()
        assert differ(lit, page.pixels()) == 0, name


# Files


def test_a_dropped_stream_is_shown_and_another_beside_it(show, assets, tmp_path):
    (tmp_path / "new.texf").write_bytes(assets["stream"].data)
    page = show("sheet")
    page.drop(tmp_path / "new.texf", 100, 200)
    page.until("viewer.assets[0]?.name === 'new.texf'")
    page.drop(tmp_path / "new.texf", 500, 200)
    page.until("viewer.assets[1]?.name === 'new.texf'")
    page.settle()
    assert mode(page) == "split" and page.run("document.title") == "new.texf · new.texf · texf-view"
    assert page.run("document.querySelector('#psnr td').textContent") == "equal" and page.message() == ""


def test_a_dropped_white_mesh_is_seen_in_light_on_grey(show, tmp_path):
    (positions, faces), rows = sphere(6), []
    for corners in positions[faces]:
        rows += ["facet normal 0 0 0", "outer loop", *("vertex {} {} {}".format(*c) for c in corners), "endloop", "endfacet"]
    (tmp_path / "ball.stl").write_text("\n".join(["solid ball", *rows, "endsolid ball"]))
    page = show(start=None)
    assert page.run("document.body.style.background") == GREY and (page.pixels() == 255).all()
    page.drop(tmp_path / "ball.stl", 100, 200)
    page.until("viewer.assets[0]?.name === 'ball.stl'")
    page.settle()
    empty = np.full_like(page.pixels(), 255)
    seen = page.pixels()[(page.pixels() != empty).any(axis=2)].mean(axis=1)
    assert page.run("viewer.settings.lit") and page.message() == ""
    assert len(seen) > 5000 and np.ptp(np.percentile(seen, (5, 95))) > 8


def test_a_dropped_glb_needs_no_server_but_for_what_the_page_does_not_read(show, assets, tmp_path):
    page = show()
    (tmp_path / "new.glb").write_bytes(assets["source"].data)
    page.drop(tmp_path / "new.glb", 100, 200)
    page.until("viewer.assets[0]?.name === 'new.glb'")
    sent = "performance.getEntriesByType('resource').filter((entry) => entry.name.includes('/drop?')).length"
    assert page.run(sent) == 0 and page.message() == ""
    (tmp_path / "bad.glb").write_bytes(b"glTF" + bytes(99))
    page.drop(tmp_path / "bad.glb", 100, 200)
    page.until("/TXF-I33/.test(document.querySelector('#message span')?.textContent)")
    assert page.run(sent) == 1 and page.run("viewer.assets[0].name") == "new.glb"
    page.errors[:] = [error for error in page.errors if "422" not in error]


def test_a_dropped_scene_with_coded_meshes_is_shown_and_a_key_plays_its_animation(show, tmp_path):
    coded = encode_gltf(spinning().glb(), {"rate": "r06", "no_check": True, "effort": "fast"}).data
    (tmp_path / "spin.glb").write_bytes(coded)
    page = show()
    page.drop(tmp_path / "spin.glb", 100, 200)
    page.until("viewer.assets[0]?.name === 'spin.glb'")
    page.settle()
    assert page.run("viewer.assets[0].meshes.length") == 2 and "M plays it" in page.message()
    before = page.pixels()
    page.run("void viewer.switchMotion()")
    page.until("viewer.assets[0].mixer.time > 0.2")
    page.press("m")
    page.settle()
    assert differ(before, page.pixels()) > 1000


def test_halves_are_named_by_what_they_are(show):
    page = show("stream", "source", start={**START, "mode": "split"})
    shown = "[...document.querySelectorAll('#captions:not([hidden]) span:not([hidden])')].map((one) => one.textContent)"
    assert page.run(shown) == ["stream: ball.texf", "source: ball.glb"]
    page.press("d")
    page.settle()
    assert page.run(shown) == ["difference: 0 to 32 of 255, RMS of R, G, B"]


def test_a_refused_file_is_told_why_and_the_page_goes_on(show, assets, tmp_path):
    (tmp_path / "broken.texf").write_bytes(assets["stream"].data[:40])
    page = show("stream")
    before = page.pixels()
    page.drop(tmp_path / "broken.texf", 100, 200)
    page.until("/not shown/.test(document.querySelector('#message span')?.textContent)")
    assert re.fullmatch(r"broken\.texf is not shown\. [A-Z][^.]*\.", page.message())
    page.press("ArrowRight")
    assert differ(before, page.pixels()) > 100


# What goes wrong


def test_a_lost_context_comes_back_with_the_same_picture(show):
    page = show("stream", "source", start={**START, "mode": "split"})
    before = page.pixels()
    page.run(f"void (globalThis.loss = {CONTEXT}.getExtension('WEBGL_lose_context'), loss.loseContext())")
    page.until("document.querySelector('#message span')?.textContent.includes('lost')")
    page.run("void (viewer.switchMode('other'), viewer.frame(), viewer.switchMode('split'))")  # which a person may do meanwhile
    page.run("void loss.restoreContext()")
    page.until("!document.querySelector('#message:not([hidden])') && viewer.isSettled")
    assert differ(before, page.pixels()) == 0
    page.errors[:] = [error for error in page.errors if "Context" not in error]


def test_what_the_device_cannot_hold_is_said_and_the_other_is_shown(show):
    long = mapped_sheet({}, colour=np.full((1, 40000, 4), 200, np.uint8))
    page = show(mesh(long, "long.glb"), "stream")
    assert re.search(r"long\.glb cannot be shown\. .*40000 x 1; this device takes at most \d+", page.message())
    assert (page.pixels() != 255).any()


def test_a_browser_without_webgl2_is_told_so(show, browser):
    script = "HTMLCanvasElement.prototype.getContext = () => null;"
    number = browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)["identifier"]
    try:
        assert "no WebGL2" in show("stream").message()
        browser.errors[:] = [error for error in browser.errors if "Error creating WebGL context" not in error]
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=number)


def test_an_exported_page_shows_the_same_and_reads_streams_without_a_server(show, assets, tmp_path):
    page = show("stream", "source")
    before = page.pixels()
    (tmp_path / "page.html").write_bytes(export_page([assets["stream"], assets["source"]], "two", START, "1"))
    page.open((tmp_path / "page.html").as_uri())
    assert differ(before, page.pixels()) == 0
    page.drop(tmp_path / "page.html", 100, 200)
    page.until("document.querySelector('#message span')?.textContent.includes('reads .texf and .glb files')")
    (tmp_path / "new.texf").write_bytes(assets["stream"].data)
    page.drop(tmp_path / "new.texf", 100, 200)
    page.until("viewer.assets[0]?.name === 'new.texf'")
    page.settle()
    assert differ(before, page.pixels()) == 0 and page.message() == ""


def test_an_empty_asset_shows_the_background(show):
    page = show(mesh(scene_of(np.zeros((0, 3)), np.zeros((0, 3)))))
    assert (page.pixels() == 255).all() and page.message() == ""
    page.press("ArrowRight")
    assert page.run("document.querySelector('.facts').textContent").startswith("KindMesh")


def test_warnings_of_a_mesh_are_listed(show, assets):
    page = show(assets["source"]._replace(warnings=["a map is lost"]))
    assert page.run("document.querySelector('.rows li').textContent") == "a map is lost"


# The panel


def test_the_panel_tells_figures_of_the_asset(show, assets):
    page = show("stream")
    texf = decode(assets["stream"].data)
    rows = "[...document.querySelectorAll('.facts tr')]"
    facts = dict(page.run(f"{rows}.map((row) => [...row.cells].map((cell) => cell.textContent))"))
    assert facts["File"] == f"{assets['stream'].size:,} B" and facts["Faces"] == f"{len(texf.faces):,}" and facts["K"] == "32"
    assert facts["Voxels"] == f"{len(texf.fields[0].support):,}" and facts["Channels"] == "base colour"
    assert re.fullmatch(r"Frame [\d.]+ ms, 640 × 400", page.run("document.querySelector('.timing').textContent"))


def test_a_moving_picture_is_coarse_when_it_is_slow_and_stands_in_full_at_rest(show):
    page = show("stream")
    whole, size = page.pixels(), page.run("viewer.stage.size")
    page.run("(viewer.density = 0.25, viewer.touch())")
    page.until("viewer.stage.size[0] === 160 || viewer.isSettled")
    page.settle()
    assert page.run("viewer.stage.size") == size and differ(whole, page.pixels()) == 0


@pytest.mark.parametrize("width", [360, 1280])
def test_the_page_fits_windows_narrow_and_wide(show, browser, width):
    """The panel is open beside the picture where there is room, closed above it where there is not."""
    browser.call("Emulation.setDeviceMetricsOverride", width=width, height=640, deviceScaleFactor=1, mobile=False)
    try:
        page = show("stream", "source", start={**START, "mode": "split"})
        canvas, panel = page.run("['view', 'panel'].map((id) => document.getElementById(id).getBoundingClientRect().toJSON())")
        assert page.run("viewer.panel.root.open") == (width > 700)
        assert panel["right"] <= canvas["left"] or not page.run("viewer.panel.root.open")
        assert canvas["right"] == width and page.run("document.documentElement.scrollWidth") == width
    finally:
        browser.call("Emulation.setDeviceMetricsOverride", width=640, height=400, deviceScaleFactor=1, mobile=False)


def test_a_dark_scheme_darkens_the_page_and_black_models_are_still_seen(show, browser):
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    try:
        page = show("stream", start=None)
        assert page.run("document.body.style.background") == GREY
        assert page.run("getComputedStyle(document.getElementById('panel')).color") == "rgb(230, 232, 235)"
    finally:
        browser.call("Emulation.setEmulatedMedia", features=[])


def test_help_tells_every_key_and_is_closed(show):
    page = show("stream")
    page.press("h")
    assert page.run("viewer.helper.open") and "Space" in page.run("viewer.helper.textContent")
    before = camera(page)
    page.press("ArrowRight")
    assert (camera(page) == before).all()
    page.press("Escape")
    page.until("!viewer.helper.open")
