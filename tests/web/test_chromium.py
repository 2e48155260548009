"""The npm package in Chromium: vectors through its workers, and the loader on bad downloads; left out where no browser is."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from browser import BROWSER, needs_browser
from shapes import mapped_sheet
from test_js_package import NODE, needs_node

from texfcodec import EncodeOptions, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.save import save
from tools.proof import three_check

REPOSITORY = Path(__file__).resolve().parents[2]
MODULES = all((REPOSITORY / "js/node_modules" / name).is_dir() for name in ("three", "playwright-core"))
pytestmark = [needs_node, needs_browser, pytest.mark.skipif(not MODULES, reason="no js/node_modules: npm install in js/")]


def run_in_chromium(mode, *words):
    call, environment = [NODE, "../tools/proof/chromium.mjs", mode, *words], os.environ | {"CHROMIUM": BROWSER}
    return subprocess.run(call, cwd=REPOSITORY / "js", env=environment, capture_output=True, text=True, timeout=300)


def test_vectors_go_through_the_workers_under_a_narrow_policy():
    run = run_in_chromium("vectors", "subset/k33", "uncommon/normals_coded", "faulty/version")
    assert run.returncode == 0 and " 0 failed" in run.stdout and "ok   nothing else" in run.stdout, run.stdout + run.stderr


def test_the_loader_refuses_says_and_leaves_nothing():
    run = run_in_chromium("loader", "--loads", "12")
    assert run.returncode == 0 and run.stdout.count("ok  ") >= 18, run.stdout + run.stderr


def test_saturated_texels_are_filtered_in_linear_light_as_those_of_the_decoded_glb(tmp_path, monkeypatch, capsys):
    y, x = np.mgrid[:32, :32]
    colours = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 0, 255]], np.uint8)
    scene = mapped_sheet({}, colours[(x // 2 + y // 2) % 2 + 2 * (x > 15)], span=3.0, unlit=True, double_sided=True)
    data = encode_scene(scene, EncodeOptions(support="texels", max_error=0)).data
    (tmp_path / "checker.texf").write_bytes(data)
    save(decode(data), tmp_path / "checker.glb", texture_format="png")
    monkeypatch.setenv("CHROMIUM", BROWSER)
    assert three_check.main(["--pair", str(tmp_path / "checker.texf"), str(tmp_path / "checker.glb"), "--views", "1", "--modules",
                             str(REPOSITORY / "js"), "--out", str(tmp_path / "out")]) == 0
    cells = [cell.strip() for cell in capsys.readouterr().out.splitlines()[-1].split("|")]
    assert float(cells[3].split()[0]) > 32, cells


def test_blocks_take_a_quarter_of_the_texels_and_the_browser_decodes_what_was_coded(tmp_path):
    y, x = np.mgrid[:64, :64]
    ramp = np.stack([3 * x + 20, 2 * y + x, 120 + 40 * np.sin(x / 9), 0 * x + 255], axis=-1).astype(np.uint8)
    flat = np.stack([128 + 20 * np.sin(x / 7), 128 + 20 * np.cos(y / 5), 0 * x + 250, 0 * x + 255], axis=-1).astype(np.uint8)
    maps = {"normal": flat, "occlusion": ramp, "roughness": ramp, "metallic": ramp[::-1].copy()}
    data = encode_scene(mapped_sheet(maps, ramp), EncodeOptions(support="texels", rate="r05", max_error=0)).data
    (tmp_path / "sheet.texf").write_bytes(data)
    jobs = [{"file": str(tmp_path / "sheet.texf"), "blocks": hidden is not None, "hidden": hidden or []}
            for hidden in (None, ["astc"], ["bptc"])]
    (tmp_path / "jobs.json").write_text(json.dumps(jobs))
    run = subprocess.run([NODE, "../tools/bench/card.mjs", str(tmp_path / "jobs.json")], cwd=REPOSITORY / "js", text=True,
                         timeout=300, env=os.environ | {"CHROMIUM": BROWSER}, capture_output=True)
    plain, *coded = (json.loads(line) for line in run.stdout.splitlines())
    assert plain["formats"] | {"0x822f": 0} == {"0x8c43": 1, "0x8058": 2, "0x822f": 0}  # colours, normals, and all data in one
    for row, formats in zip(coded, ({"0x8e8d": 1, "0x8e8c": 2}, {"0x93d0": 1, "0x93b0": 2}), strict=True):
        assert row["formats"] | {"0x822f": 0} == formats | {"0x822f": 0} and "said" not in row, row
        assert plain["texture_bytes"] > 3.7 * row["texture_bytes"]
        assert [texture["maps"] for texture in row["psnr"]] == [["map"], ["normalMap"], ["aoMap", "roughnessMap", "metalnessMap"]]
        assert min(value for texture in row["psnr"] for value in texture["psnr"]) > 38, row
