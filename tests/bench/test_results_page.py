"""The page of results: what it draws is what was measured, it loads nothing, and names are text, whatever is in them."""

import base64
import hashlib
import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import pytest
from batches import metrics

from tools.bench import collect, page
from tools.bench.results import curve_of, read_results

HOSTILE = "</script><img src=x onerror=\"document.title='taken'\"><b>&amp;'{{data}}"
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def write_rows(folder, asset="vase", group="new", count=3, first=1000):
    """Finished jobs of one curve, each with SSIM and two pictures, the source's all the same."""
    for number in range(count):
        place = folder / digits(asset) / f"{digits(group)}{number}"
        place.mkdir(parents=True)
        row = metrics(asset, group, number, first * 2**number, 30.25 + 3 * number)
        psnr = {"y": 29.5 + 3 * number, "rgb": None if number == 2 else 28.0 + number}
        row["image"] = {"psnr": psnr, "ssim": 0.9 + 0.03 * number, "lpips": None}
        (place / "metrics.json").write_text(json.dumps(row))
        (place / "picture_03.webp").write_bytes(f"{group} {number}".encode())
        (place / "source_03.webp").write_bytes(b"source")


def digits(name):
    """A folder name for any name."""
    return hashlib.sha256(name.encode()).hexdigest()[:8]


def made(folder, *options):
    """The text of the page of a folder of jobs."""
    collect.main([str(folder), "--out", str(folder / "out"), *options])
    return (folder / "out/results.html").read_text(encoding="utf-8")


class Parts(HTMLParser):
    """Every tag with its attributes and the text after it."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes), []))

    def handle_endtag(self, tag):
        self.handle_starttag(f"/{tag}", [])

    def handle_data(self, data):
        if self.tags:
            self.tags[-1][2].append(data)

    def of(self, tag):
        return [(attributes, "".join(text)) for name, attributes, text in self.tags if name == tag]


@pytest.fixture
def plotly(monkeypatch):
    """A short script in its place: what the page is made of does not depend on it."""
    monkeypatch.setattr(page, "_plotly", lambda: "const Plotly = { newPlot() {} };")


def test_curves_are_those_that_bd_rates_compare(tmp_path, plotly):
    write_rows(tmp_path)
    write_rows(tmp_path, group="old", first=1500)
    text, rows = made(tmp_path), read_results(tmp_path)
    drawn = json.loads(next(inside for attributes, inside in Parts(text).of("script") if attributes.get("class") == "curves"))
    assert [b["label"] for b in drawn["layout"]["updatemenus"][0]["buttons"]] == [
        "3D-PSNR Y", "3D-PSNR RGB", "image PSNR Y", "image PSNR RGB", "SSIM"]
    assert {trace["meta"] for trace in drawn["data"] if trace["visible"]} == {"image PSNR Y"} and len(drawn["data"]) == 10
    for trace in drawn["data"]:
        group = [row for row in rows if row["group"] == trace["name"]]
        assert (trace["x"], trace["y"]) == curve_of(group, trace["meta"], "texture") and len(trace["x"]) >= 2


def test_page_has_the_tables_of_the_report(tmp_path, plotly):
    write_rows(tmp_path)
    write_rows(tmp_path, group="old", first=1500)
    parts, lines = Parts(made(tmp_path, "--against", "old")), (tmp_path / "out/results.md").read_text().splitlines()
    cells = [text for tag in ("th", "td", "b") for _, text in parts.of(tag)]
    for line in lines:
        if line.startswith("|") and "---" not in line:
            assert {cell.strip(" *") for cell in line.strip("|").split("|")} <= set(cells)
    assert {text for _, text in parts.of("h2")} == {line[3:] for line in lines if line.startswith("## ")} != set()
    assert {a["href"][1:] for a, _ in parts.of("a")} == {a["id"] for a, _ in parts.of("h2")}


def test_page_refers_to_nothing_outside_and_lets_nothing_in(tmp_path, plotly):
    write_rows(tmp_path)
    parts = Parts(made(tmp_path))
    policy = next(attributes["content"] for attributes, _ in parts.of("meta") if "http-equiv" in attributes)
    scripts = [text for attributes, text in parts.of("script") if "class" not in attributes]
    assert len(scripts) == 2 and policy.startswith("default-src 'none'; img-src data:;")
    for text in scripts:
        assert f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" in policy
    assert not [a for tag, a, _ in parts.tags if tag in ("link", "iframe", "object", "base") or {"action", "style"} & set(a)]
    assert all(a["src"].startswith("data:") for _, a, _ in parts.tags if "src" in a)
    assert all(a["href"].startswith("#") for _, a, _ in parts.tags if "href" in a)


def test_hostile_names_stay_text(tmp_path, plotly):
    write_rows(tmp_path / "tame", "vase", "new")
    write_rows(tmp_path / "wild", HOSTILE, HOSTILE)
    tame, wild = (Parts(made(tmp_path / name)) for name in ("tame", "wild"))
    assert [tag for tag, _, _ in wild.tags] == [tag for tag, _, _ in tame.tags]
    assert HOSTILE in [text for _, text in wild.of("td")] and HOSTILE in [text for _, text in wild.of("h2")]


def test_pictures_are_embedded_once_and_can_be_left_out(tmp_path, plotly):
    write_rows(tmp_path)
    images = [a["src"] for a, _ in Parts(made(tmp_path)).of("img")]
    texts = [base64.b64decode(image.removeprefix("data:image/webp;base64,")).decode() for image in images]
    assert texts == ["source", "new 0", "new 1", "new 2"]
    assert not Parts(made(tmp_path, "--no-pictures")).of("img")


def test_page_does_without_plotly(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    write_rows(tmp_path)
    parts = Parts(made(tmp_path))
    assert "texfcodec[plots]" in capsys.readouterr().err
    assert not parts.of("script") and "script-src 'none'" in parts.of("meta")[1][0]["content"] and parts.of("table")


def test_a_browser_draws_the_curves_under_the_page_s_own_policy(tmp_path):
    pytest.importorskip("plotly")
    if BROWSER is None:
        pytest.skip("there is no Chromium here")
    write_rows(tmp_path, HOSTILE, HOSTILE)
    write_rows(tmp_path, HOSTILE, "old", first=1500)
    made(tmp_path)
    options = "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom"
    command = [BROWSER, *options, "--virtual-time-budget=5000", (tmp_path / "out/results.html").as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    assert "<title>Rate points</title>" in shown and len(re.findall('class="points"', shown)) == 2
    assert 'data-unformatted="image PSNR Y"' in shown and not re.findall("<img src=x", shown.replace('"', ""))
