"""tools/bench/attributes.py: clouds and texels are coded and come back, and its tables agree with themselves."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from texfcodec.field.morton import encode_morton
from tools.bench import attributes

QPS = ["--qp", "22,34,46"]


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    """Folder with a coloured and a grey cloud of a wavy sheet of 64 x 64 voxels, and steep anchor curves."""
    folder = tmp_path_factory.mktemp("clouds")
    generator = np.random.default_rng(5)
    x, y = (v.ravel() for v in np.mgrid[:64, :64])
    xyz = np.stack([x, y, (20 + 10 * np.sin(x / 9) * np.cos(y / 7)).astype(int)], 1)
    waves = 128 + 60 * np.sin(xyz @ generator.normal(0, 0.15, (3, 3))) + generator.normal(0, 12, (len(x), 3))
    rgb = np.clip(waves, 0, 255).astype(np.uint8)
    anchor = {"K": 64, "points_rd": [{"bytes": 100 * 2**i, **dict.fromkeys(attributes.MEASURES.values(), 20 + 5 * i)}
                                     for i in range(7)]}
    shuffle = generator.permutation(len(x))
    for name, colours in (("colour", rgb), ("grey", np.repeat(rgb[:, :1], 3, axis=1))):
        np.savez(folder / f"{name}.npz", xyz=xyz[shuffle].astype(np.uint16), rgb=colours[shuffle],
                 area=generator.integers(1, 9, len(x)).astype(np.uint16))
        (folder / f"{name}.json").write_text(json.dumps(anchor))
    return folder


@pytest.fixture
def painted(monkeypatch):
    """Assets are the round part of an image of waves."""
    y, x = np.mgrid[:48, :64]
    waves = 128 + 70 * np.sin(x[..., None] / (9, 11, 13)) * np.cos(y[..., None] / 8)
    image = np.clip(waves + np.random.default_rng(1).normal(0, 12, waves.shape), 0, 255).astype(np.uint8)
    mask = (x - 32) ** 2 + (y - 24) ** 2 < 400
    monkeypatch.setattr(attributes, "load_texels", lambda path, crop: attributes.texels_of(Path(path).stem, image, mask, crop))
    return image, mask


def printed(capsys, *words):
    attributes.main([str(word) for word in words])
    return capsys.readouterr().out


def table(text):
    """{first cell: the others} of a Markdown table, head included."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert len({len(line) for line in lines}) == 1
    return {line[0]: line[1:] for line in [lines[0], *lines[2:]]}


def test_anchor_json_has_every_measure_and_null_for_the_chroma_of_grey(clouds, capsys):
    result = json.loads(printed(capsys, "anchor", clouds, *QPS), parse_constant=pytest.fail)
    assert set(result["mean"]) == {*attributes.MEASURES, *attributes.SPEEDS, "peak_memory_bytes"}
    colour, grey = result["clouds"]["colour"], result["clouds"]["grey"]
    for row in (colour, grey):
        assert set(row) == set(result["mean"]) | {"num_points", "points"} and row["num_points"] == 4096
        assert all(set(row[k]) == {"1", "2"} and min(row[k].values()) > 0 for k in attributes.SPEEDS)
        assert [p["qp"] for p in row["points"]] == [22, 34, 46] and row["points"][0]["bytes"] > row["points"][2]["bytes"] > 0
    assert grey["bd_yuv611"] is None and grey["bd_y"] == pytest.approx(grey["bd_rgb"])
    assert result["mean"]["bd_yuv611"] == colour["bd_yuv611"]
    assert result["mean"]["bd_y"] == pytest.approx((colour["bd_y"] + grey["bd_y"]) / 2)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from the process's account in /proc")
def test_decoder_memory_grows_with_the_cloud_and_leaves_the_parent_out(clouds):
    small = next(attributes.load_clouds(clouds))
    x, y = (v.ravel() for v in np.mgrid[:512, :512])
    keys = np.sort(encode_morton(np.stack([x, y, 0 * x], 1)))
    flat = attributes.Points("flat", keys, np.full((len(x), 3), 90, np.uint8), 512)
    peaks = [attributes.decoder_memory(points, "fast") for points in (small, flat)]
    # this process has numba's compiler in it, more than 100 MiB
    assert 0 <= peaks[0] < 20e6 and peaks[1] > max(peaks[0], flat.keys.size * 3 * 4)


def test_tools_have_a_row_each_that_changes_something(clouds, capsys):
    rows = table(printed(capsys, "tools", clouds, *QPS))
    names = attributes.changes_at("balanced", attributes.CLOUD_CHANGES)
    assert list(rows) == ["change, Y / RGB, %", *names]
    assert "8 models" not in names
    assert rows["complete set"][:3] == ["+0.00 / +0.00"] * 3 and float(rows["mixing off"][2].split(" / ")[1]) > 0
    assert all(float(s) >= 0 for name in names for s in rows[name][3:])


def test_texels_stand_against_avif_and_lossless_images(painted, capsys, monkeypatch):
    image, mask = painted
    monkeypatch.setattr(attributes, "AVIF_QUALITIES", (20, 60, 94))
    rows = table(printed(capsys, "avif", "a/waves.glb", *QPS))
    assert float(rows["waves"][0]) == round(100 * mask.mean()) and rows["mean"] == rows["waves"]
    sizes = [int(size.replace(",", "")) for size in table(printed(capsys, "lossless", "a/waves.glb"))["waves"]]
    assert len(sizes) == 5 and min(sizes) > 0 and sizes[2] < sizes[1]
    assert list(table(printed(capsys, "tools", "a/waves.glb", *QPS)))[1:] == list(attributes.TEXEL_CHANGES)


def test_a_crop_is_the_window_with_the_most_used_texels(painted):
    image, mask = painted
    points = attributes.texels_of("waves", image, mask, 16)
    assert points.mask.shape == (16, 16) and points.mask.all() and len(points.keys) == 256 and (np.diff(points.keys) > 0).all()


def test_texels_of_an_asset_are_those_that_its_faces_ask(tmp_path, sample_scene):
    from texfcodec.demo.asset import write_sample

    write_sample(tmp_path / "sample.glb")
    points = attributes.load_texels(tmp_path / "sample.glb")
    assert 0 < points.mask.mean() <= 1 and len(points.keys) == points.mask.sum() and points.image.shape[:2] == points.mask.shape


def test_a_folder_without_clouds_is_named(tmp_path):
    with pytest.raises(SystemExit, match="no NAME.npz"):
        attributes.main(["anchor", str(tmp_path)])
