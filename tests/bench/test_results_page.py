"""The page of results: what it draws is what was measured, it loads nothing, and names are text, whatever is in them."""

import base64
import hashlib
import html
import json
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest
from batches import metrics

from bench import collect, page
from bench.differences import pairs_of
from bench.results import read_results

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
    """Every tag with its attributes, and the text after each."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self.texts.append("")

    def handle_endtag(self, tag):
        self.handle_starttag(f"/{tag}", [])

    def handle_data(self, data):
        self.texts[-1:] = [text + data for text in self.texts[-1:]]

    def of(self, tag):
        return [(attributes, text) for (name, attributes), text in zip(self.tags, self.texts, strict=True) if name == tag]


def data_of(text):
    """What the page's block of JSON holds."""
    return json.loads(next(inside for attributes, inside in Parts(text).of("script") if attributes.get("id") == "data"))


@pytest.fixture(autouse=True)
def without_plots(monkeypatch):
    monkeypatch.setattr(collect, "draw", lambda *arguments: False)


def test_data_of_the_page_is_that_of_the_metrics(tmp_path):
    write_rows(tmp_path)
    data, rows = data_of(made(tmp_path)), read_results(tmp_path)
    assert [m["name"] for m in data["measures"]] == ["3D-PSNR Y", "3D-PSNR RGB", "image PSNR Y", "image PSNR RGB", "SSIM"]
    for told, row in zip(data["rows"], rows, strict=True):
        assert (told["setting"], told["group"], told["asset"]) == (row["setting"], row["group"], row["asset"])
        assert told["bytes"] == row["bytes"]["total"] and told["rate"] == row["bytes"]["total"] - row["bytes"]["geometry"]
        assert told["encode_seconds"] == row["seconds"]["encode"]["total"]
        assert told["decode_seconds"] == row["seconds"]["decode"]["total"]
        assert told["values"]["3D-PSNR Y"] == told["decibels"]["3D-PSNR Y"] == row["psnr_3d"]["y"]
        assert told["values"]["SSIM"] == row["image"]["ssim"] != told["decibels"]["SSIM"]
        exact = row["image"]["psnr"]["rgb"] is None
        assert told["values"]["image PSNR RGB"] == ("exact" if exact else row["image"]["psnr"]["rgb"])


def test_page_refers_to_nothing_outside_and_lets_nothing_in(tmp_path):
    write_rows(tmp_path)
    parts = Parts(made(tmp_path))
    policy = next(attributes["content"] for attributes, _ in parts.of("meta") if "http-equiv" in attributes)
    code = next(text for attributes, text in parts.of("script") if attributes["type"] == "module")
    for kind, text in (("script", code), ("style", parts.of("style")[0][1])):
        assert f"{kind}-src 'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" in policy
        assert not re.search(r"https?:|//[a-z]+\.|@import|url\(|\bfetch\(|XMLHttp|innerHTML|eval\(", text), kind
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert not [a for tag, a in parts.tags if tag in ("link", "iframe", "object", "base") or {"src", "action", "style"} & set(a)]
    assert all(a["href"].startswith("#") for tag, a in parts.tags if "href" in a)


def test_hostile_names_stay_text(tmp_path):
    write_rows(tmp_path / "tame", "vase", "new")
    write_rows(tmp_path / "wild", HOSTILE, HOSTILE)
    tame, wild = (made(tmp_path / name) for name in ("tame", "wild"))
    assert [tag for tag, _ in Parts(wild).tags] == [tag for tag, _ in Parts(tame).tags]
    assert data_of(wild)["rows"][0]["asset"] == HOSTILE == data_of(wild)["rows"][0]["group"]


def test_pictures_are_embedded_once_and_can_be_left_out(tmp_path):
    write_rows(tmp_path)
    data = data_of(made(tmp_path))
    texts = [base64.b64decode(image.removeprefix("data:image/webp;base64,")).decode() for image in data["images"]]
    assert sorted(texts) == ["new 0", "new 1", "new 2", "source"]
    for number, row in enumerate(data["rows"]):
        found = {name: texts[place] for name, place in row["pictures"].items()}
        assert found == {"picture_03": f"new {number}", "source_03": "source"}
    without = data_of(made(tmp_path, "--no-pictures"))
    assert without["images"] == [] and not any(row["pictures"] for row in without["rows"])


def test_size_is_that_of_the_file(tmp_path, capsys):
    write_rows(tmp_path)
    place = next(tmp_path.glob("*/*/picture_03.webp"))
    place.write_bytes(os.urandom(900_000))
    text = made(tmp_path)
    size = f"{(tmp_path / 'out/results.html').stat().st_size / 1e6:.1f} MB"
    assert size.startswith("1.2") and f"This page has {size}" in text and f"results.html ({size})" in capsys.readouterr().out


# In a browser. A script of the test is appended to the page's own, and what it finds becomes the page's title.


@pytest.fixture
def shown(tmp_path, monkeypatch):
    """Function (text of a script with `return`, options of collect) -> what it returns in the page of tmp_path's jobs."""
    if BROWSER is None:
        pytest.skip("there is no Chromium here")

    def run(script, *options):
        (tmp_path / "driver.js").write_text(f"document.title = JSON.stringify((() => {{{script}}})());")
        monkeypatch.setattr(page, "SCRIPTS", (*page.SCRIPTS, str(tmp_path / "driver.js")))
        made(tmp_path, *options)
        options = "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom"
        command = [BROWSER, *options, (tmp_path / "out/results.html").as_uri()]
        told = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
        return json.loads(html.unescape(re.search("<title>(.*?)</title>", told, re.DOTALL)[1]))

    return run


def test_tables_are_sorted_by_the_head_that_is_pressed(tmp_path, shown):
    write_rows(tmp_path, first=9_000)
    write_rows(tmp_path, group="old", count=2, first=100_000)
    found = shown('''
        const table = document.getElementById("row-table"), orders = [];
        const press = (name) => [...table.querySelectorAll("th button")].find((b) => b.textContent === name).click();
        for (const name of ["bytes", "bytes", "image PSNR RGB, dB", "image PSNR RGB, dB"]) {
          press(name);
          orders.push([...table.querySelectorAll("tbody tr")].map((row) => row.cells[1].textContent));
          orders.push(table.querySelector("th:not([aria-sort=none])").getAttribute("aria-sort"));
        }
        const long = element("table"), text = (row) => String(row);
        fillTable(long, [{ head: "n", key: text }], [...Array(600).keys()], { column: null, isDescending: false });
        const counts = [long.rows.length, long.rows[251].textContent];
        long.rows[251].querySelector("button").click();
        orders.push([...counts, long.rows.length]);
        const key = (row) => row, mixed = [3, null, "exact", 20, undefined, 100];
        orders.push(sorted(mixed, key, false), sorted(mixed, key, true), sorted(["r10", "r9", "R1"], key, false));
        return orders;''')
    rising = ["new0", "new1", "new2", "old0", "old1"]
    assert found[:4] == [rising, "ascending", rising[::-1], "descending"]
    assert found[4][-1] == "new2" == found[6][0]  # the exact one
    assert found[8] == [252, "350 more", 601]
    assert found[9:] == [[3, 20, 100, "exact", None, None], ["exact", 100, 20, 3, None, None], ["R1", "r9", "r10"]]


def test_curves_are_walked_by_keys_and_tell_the_metrics(tmp_path, shown):
    write_rows(tmp_path)
    write_rows(tmp_path, group="old", first=1500)
    found = shown('''
        const chart = document.getElementById("chart"), told = [];
        const press = (key) => chart.dispatchEvent(new KeyboardEvent("keydown", { key, cancelable: true }));
        for (const key of ["ArrowRight", "ArrowRight", "ArrowRight", "ArrowDown", "Enter"]) {
          press(key);
          told.push(document.getElementById("readout").textContent);
        }
        const shown = document.getElementById("right").selectedOptions[0].textContent;
        document.querySelector("#legend button").click();
        return [told, shown, chart.querySelectorAll(".curve").length];''')
    told, picture, curves = found
    for number, text in enumerate(told[:3]):
        assert f"setting new{number}, group new, texture bytes" in text and "encode 1.50 s, decode 0.50 s" in text
        assert f"image PSNR Y {29.5 + 3 * number:.2f} dB" in text
        assert f"with geometry {1000 * 2**number}" in re.sub(r"(?<=\d)\s(?=\d)", "", text)
    assert "setting old" in told[3] and picture.startswith("old: old") and curves == 1


def test_hostile_names_are_shown_as_they_are(tmp_path, shown):
    write_rows(tmp_path, HOSTILE, HOSTILE)
    write_rows(tmp_path, HOSTILE, "old", first=1500)
    (tmp_path / "x/q").mkdir(parents=True)
    (tmp_path / "x/q/missing.json").write_text(json.dumps({"reason": HOSTILE}))
    found = shown('''
        const text = (place) => [...document.querySelectorAll(place)].map((node) => node.textContent);
        return [["img", "script", "td b b"].map((name) => document.querySelectorAll(name).length), text("#row-table td"),
                text("#legend button"), text("#comparison-table td"), text("#missing-table td"), text("#thumbnails span")];''',
                  "--against", "old")
    assert found[0] == [2, 2, 0]  # as in the template
    assert all(HOSTILE in texts for texts in found[1:])


def test_table_of_differences_and_missing_rows_are_drawn(tmp_path, shown):
    write_rows(tmp_path)
    write_rows(tmp_path, group="old", first=2000)
    write_rows(tmp_path, "cup", "old")
    write_rows(tmp_path, "cup", "new", count=1)
    (tmp_path / "x/q").mkdir(parents=True)
    told = {"asset": "cup", "setting": "q", "state": "missing", "reason": "tmc3 is not here"}
    (tmp_path / "x/q/missing.json").write_text(json.dumps(told))
    found = shown('''
        const text = (place) => [...document.querySelectorAll(place)].map((cell) => cell.textContent);
        return [text("#comparison-table th"), text("#comparison-table td"), text("#missing-table td"), text("#none li"),
                document.getElementById("summary").textContent];''', "--against", "old")
    assert found[0][:3] == ["group", "mean", "median"] and set(found[0][3:]) == {"cup", "vase"}
    row = dict(zip(found[0], found[1], strict=True))
    pair, = pairs_of(read_results(tmp_path), None, "new", "old")
    expected = pair.differences("texture")["vase"]["image PSNR Y"].percent
    assert row["group"] == "new" and row["cup"] == "–" and row["vase"] == f"{expected:.1f}".replace("-", "−")
    assert row["mean"] == f"{row['vase']} (1)" and found[2] == ["cup", "q", "", "", "missing", "tmc3 is not here"]
    assert "at least two points" in found[3][0] and "1 missing" in found[4]
