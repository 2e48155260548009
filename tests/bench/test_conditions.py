"""Condition files: mistakes are named, what is committed is sound."""

import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

from texfcodec.options import EncodeOptions
from tools.bench.conditions import read_conditions
from tools.bench.rate_points import main

REPOSITORY = Path(__file__).resolve().parents[2]
SETTING = '[[settings]]\nname = "a"\n'


@pytest.mark.parametrize(
    "text, sentence",
    [
        ("assets = [\n", "c.toml: .*at end of document"),
        ('assets = "sample"\n' + SETTING, "assets must be a list of names"),
        ("assets = []\n" + SETTING, "assets is empty"),
        ('assets = ["sample"]\n', r"no \[\[settings\]\] table"),
        ('asset = ["sample"]\n' + SETTING, "unknown key 'asset'; there are assets, "),
        ('assets = ["sample"]\n[evaluation]\nviews = -1\n' + SETTING, "views must be a whole number, 0 or more, not -1"),
        ('assets = ["sample"]\n[evaluation]\nssim = 1\n' + SETTING, "ssim must be true or false"),
        ('assets = ["sample"]\n[[settings]]\nqp = 3\n', "number 1 has no name"),
        ('assets = ["sample"]\n' + SETTING + SETTING, "two settings are called 'a'"),
        ('assets = ["sample"]\n' + SETTING + "quality = 3\n", "number 1 .'a'. has an unknown key 'quality'; there are .*, qp, "),
        ('assets = ["sample"]\n' + SETTING + 'method = "mp3"\n', "there is no method 'mp3', only .*texf"),
        ('assets = ["sample"]\n' + SETTING + 'assets = ["vase"]\n', "'vase' is none of the file's assets"),
        ('assets = ["sample"]\n' + SETTING + "qp = []\n", r"qp must be text, a number, .* not \[\]"),
        ('assets = ["sample"]\n' + SETTING + "qp = 1979-05-27\n", "qp must be text, a number"),
        ('assets = ["sample"]\n[[settings]]\nname = "{rate}"\nqp = 3\n', "may only use .* not 'rate'"),
        ('assets = ["sample"]\n[[settings]]\nname = "../a"\n', "no folder name"),
        ('assets = ["sample"]\nplugins = ["none.py"]\n' + SETTING, "none.py cannot be loaded"),
    ],
)
def test_mistakes_in_conditions_are_named(tmp_path, text, sentence):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(SystemExit, match=sentence):
        main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_committed_conditions_are_sound():
    for path in sorted((REPOSITORY / "tools" / "conditions").glob("*.toml")):
        conditions = read_conditions(path)
        assert "sample" in conditions["assets"] and conditions["settings"]
        for setting in conditions["settings"]:
            if setting["method"] == "texf":
                EncodeOptions(**setting["options"])
    paper = read_conditions(REPOSITORY / "tools/conditions/paper.toml")["settings"]
    assert all(s["options"]["effects"] == "none" for s in paper if s["method"].startswith("texf"))
    assert all(s["options"].get("exact_rate") for s in paper if s["method"] == "texf" and s["group"].startswith("TexF voxels"))


def test_the_command_line_takes_the_place_of_the_evaluation_and_picks_assets():
    path = REPOSITORY / "tools/conditions/paper.toml"
    whole, part = read_conditions(path), read_conditions(path, ["size=256", "ssim=false"], ["bball_0001"])
    assert part["evaluation"] == whole["evaluation"] | {"size": 256, "ssim": False} and part["assets"] == ["bball_0001"]
    for wrong in (["size"], ["sice=3"], ["size=true"]):
        with pytest.raises(SystemExit, match="paper.toml"):
            read_conditions(path, wrong)
    with pytest.raises(SystemExit, match="no_such is none of its assets"):
        read_conditions(path, (), ["no_such"])


def test_smoke_has_every_method_and_each_can_say_what_it_misses(monkeypatch, tmp_path):
    from tools.bench.methods import METHODS, __path__, find

    for module in pkgutil.iter_modules(__path__):
        import_module(f"tools.bench.methods.{module.name}")
    # Plug-ins of other tests are set aside.
    ours = {name for name, kind in METHODS.items() if kind.__module__.startswith("tools.bench.methods.")}
    settings = read_conditions(REPOSITORY / "tools/conditions/smoke.toml")["settings"]
    assert {s["method"] for s in settings} == ours
    assert len({s["group"] for s in settings}) >= 12
    monkeypatch.setenv("PATH", str(tmp_path))
    for variable in ("TEXFCODEC_GLTF_TRANSFORM", "TEXFCODEC_GLTFPACK"):
        monkeypatch.delenv(variable, raising=False)
    said = {s["setting"]: find(s["method"]).missing(s["options"]) for s in settings}
    assert all(reason is None or len(reason) > 20 for reason in said.values())
    assert "npm install" in said["draco_webp"] and "npm install" in said["gltfpack_etc1s"] and said["texels_r01"] is None
