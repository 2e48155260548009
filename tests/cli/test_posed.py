"""texf-eval and texf-render at times of an animation: source and coded file stand in one pose."""

import json

import pytest
from gltf_scenes import SCENES
from PIL import Image

from texfcodec import encode_gltf

SMALL = ("--views", "4", "--size", "128", "--no-3d", "--no-ssim")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """NAME.glb and NAME.coded.glb of scenes that move."""
    folder = tmp_path_factory.mktemp("posed")
    for name in ("spinning", "morphing"):
        source = SCENES[name]().glb()
        (folder / f"{name}.glb").write_bytes(source)
        coded = encode_gltf(source, {"rate": "r06", "no_check": True, "effort": "fast", "support": "texels"}).data
        (folder / f"{name}.coded.glb").write_bytes(coded)
    return folder


@pytest.mark.parametrize("name", ["spinning", "morphing"])
def test_a_coded_file_is_as_near_to_its_source_at_every_time(folder, call, name):
    code, out, _ = call("texf-eval", folder / f"{name}.glb", folder / f"{name}.coded.glb", *SMALL, "--shaded", "--json",
                        "--time", "0,0.4", "--time", "0.8")
    assert code == 0
    moments = json.loads(out)["times"]
    assert [moment["time"] for moment in moments] == [0, 0.4, 0.8]
    assert len({moment["pixels"] for moment in moments}) == 3  # it moves
    assert all(moment["silhouette"]["share"] < 0.005 and moment["shaded"]["psnr"]["y"] > 35 for moment in moments)


def test_a_picture_stands_below_another_for_each_time(folder, call, tmp_path):
    coded, out = folder / "spinning.coded.glb", tmp_path / "a.png"
    code, said, _ = call("texf-render", folder / "spinning.glb", out, "--time", "0,1,1.5", "--size", "64x48", "--compare", coded,
                         "--animation", "spin", "--json")
    facts = json.loads(said)
    with Image.open(out) as picture:
        assert code == 0 and picture.size == (facts["width"], facts["height"]) and facts["height"] == 3 * (48 + 30)
    assert [moment["time"] for moment in facts["times"]] == [0, 1, 1.5]
    assert len({moment["covered"] for moment in facts["times"]}) > 1
    assert all(moment["compare"]["pixels_only_second"] < 20 for moment in facts["times"])


@pytest.mark.parametrize("tool", ["texf-eval", "texf-render"])
@pytest.mark.parametrize("flags, code, says", [
    (("--time", "nan"), 1, "finite"), (("--time", "0,inf"), 1, "finite"), (("--time", "soon"), 1, "finite"),
    (("--time", "0,"), 1, "finite"), (("--animation", "spin"), 1, "--animation requires --time"),
    (("--time", "0", "--animation", "walk"), 2, "TXF-I29"),
], ids=lambda value: " ".join(value) if isinstance(value, tuple) else "")
def test_a_strange_pose_is_refused(folder, call, tmp_path, tool, flags, code, says):
    source = folder / "spinning.glb"
    ended, _, said = call(tool, source, tmp_path / "out.png" if tool == "texf-render" else source, *flags)
    assert ended == code and says in said and list(tmp_path.iterdir()) == []


def test_a_stream_has_no_animation(folder, call, tmp_path):
    (tmp_path / "a.texf").write_bytes(b"\x89TXF\r\n\x1a\n")
    code, _, said = call("texf-eval", folder / "spinning.glb", tmp_path / "a.texf", *SMALL, "--time", "0")
    assert code == 2 and "TXF-I29" in said
