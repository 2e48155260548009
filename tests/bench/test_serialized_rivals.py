"""The rivals over voxels along a curve: the curve, how it fills an image, how a GPU finds a voxel, and what is counted."""

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere

from texfcodec.field.morton import encode_morton
from texfcodec.report import Report
from tools.bench.methods.addressing import STRUCTURES, enc_dag
from tools.bench.methods.space_filling import CURVES, FILLS, curve_keys, from_image, image_places, image_size, to_image


def every_cell(dimensions, bits):
    return np.stack(np.meshgrid(*[np.arange(1 << bits)] * dimensions, indexing="ij"), -1).reshape(-1, dimensions)


def sphere_keys(bits, curve):
    """Ascending keys of the voxels that a sphere touches."""
    cells = every_cell(3, bits)
    distance = np.linalg.norm(cells + 0.5 - (1 << bits - 1), axis=1)
    return np.sort(curve_keys(cells[np.abs(distance - 0.4 * (1 << bits)) < 0.8], bits, curve))


@pytest.mark.parametrize(("dimensions", "bits"), [(2, 1), (2, 5), (3, 1), (3, 4)])
def test_hilbert_goes_through_every_cell_in_unit_steps(dimensions, bits):
    cells = every_cell(dimensions, bits)
    keys = curve_keys(cells, bits, "hilbert")
    np.testing.assert_array_equal(np.sort(keys), np.arange(len(cells)))
    assert (np.abs(np.diff(cells[np.argsort(keys)], axis=0)).sum(axis=1) == 1).all()


@pytest.mark.parametrize("curve", CURVES)
def test_keys_without_their_last_digit_are_those_of_the_cell_around(curve):
    cells = every_cell(3, 4)
    around = cells[np.argsort(curve_keys(cells, 4, curve))].reshape(-1, 8, 3) >> 1
    assert (around == around[:, :1]).all()


def test_morton_keys_are_those_of_the_codec():
    cells = np.random.default_rng(0).integers(0, 1 << 13, (1000, 3))
    np.testing.assert_array_equal(curve_keys(cells, 13, "morton"), encode_morton(cells))


@pytest.mark.parametrize("curve", CURVES)
def test_keys_refuse_cells_outside(curve):
    with pytest.raises(ValueError, match=r"outside of 0\.\.15"):
        curve_keys(np.array([[0, 0, 16]]), 4, curve)


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("fill", FILLS)
@pytest.mark.parametrize("count", [1, 64, 65, 5000])
def test_every_value_has_a_pixel_of_its_own(curve, fill, count):
    values = np.random.default_rng(count).integers(0, 256, (count, 4), np.uint8)
    image = to_image(values, 8, curve, fill)
    assert image.shape[1::-1] == image_size(count, 8)
    assert len(np.unique(image_places(count, 8, curve, fill))) == count
    np.testing.assert_array_equal(from_image(image, count, 8, curve, fill), values)


def test_hilbert_tiles_of_a_row_are_one_path():
    width, height = image_size(5000, 16)
    y, x = np.divmod(image_places(5000, 16, "hilbert", "blocks"), width)
    jumps = np.abs(np.diff(x)) + np.abs(np.diff(y)) > 1
    assert jumps.sum() == height // 16 - 1


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="decodes to 9 x 8 pixels where 8 x 8"):
        from_image(np.zeros((8, 9, 4), np.uint8), 60, 8, "hilbert", "rows")


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("bits", [1, 2, 3, 5, 6])
def test_structure_gives_the_rank_of_every_voxel_and_refuses_absent_ones(structure, curve, bits):
    enc, find = STRUCTURES[structure]
    keys = sphere_keys(bits, curve)
    data = enc(keys, bits)
    every = np.arange(8**bits + 9)
    expected = np.full(len(every), -1)
    expected[keys] = np.arange(len(keys))
    np.testing.assert_array_equal(find(data, every, bits), expected)


def test_dag_has_equal_subtrees_once():
    one = sphere_keys(4, "morton")
    four = np.concatenate([one + (number << 12) for number in range(4)])
    assert len(enc_dag(four, 5)) == len(enc_dag(one, 4)) + 5 * 4


def coded(scene, folder, threads=1, **options):
    """What encoding told, and the method and Texf of the files it left in the folder."""
    from tools.bench.methods.serialized import Serialized

    folder.mkdir()
    method = Serialized()
    facts = method.encode(scene, options, folder, threads, Report())
    decoded = method.decode(folder, options, threads, Report())
    assert method.values_sha256(decoded) == facts["reconstruction_sha256"]
    return facts, method, decoded


def expected_values(scene, resolution):
    """Values of the voxels before coding, by field, uint8 [N, 4]."""
    from tools.bench.methods.voxel_values import rgba_of, voxel_values

    return [rgba_of(part) for part in voxel_values(scene, {"resolution": resolution, "threads": 1}, Report()).fields]


def check_files(folder, bytes_told):
    """What was counted stands on the disk, byte for byte."""
    sizes = {path.name: path.stat().st_size for path in folder.iterdir()}
    addresses = sum(size for name, size in sizes.items() if name.startswith("addresses"))
    assert bytes_told["addressing"] == addresses
    assert bytes_told["texture"] == sizes["image.bin"]
    assert bytes_told["geometry"] + bytes_told["other"] == sizes["stream.texf"]
    assert bytes_told["total"] == sum(sizes.values())


@pytest.mark.parametrize("curve", CURVES)
def test_serialised_astc_counts_its_files_and_decodes_to_the_voxels(tmp_path, curve):
    pytest.importorskip("astc_encoder", reason="astc-encoder-py is not installed: pip install \"texfcodec[baselines]\"")
    scene = painted_sphere()
    facts, _, decoded = coded(scene, tmp_path / "a", codec="astc", block="4x4", quality=60, resolution=64, curve=curve, tile=16)
    check_files(tmp_path / "a", facts["bytes"])
    assert facts["bytes"]["addressing"] == min(facts["dag_bytes"], facts["octree_bytes"]) > 0
    for part, values in zip(decoded.fields, expected_values(scene, 64), strict=True):
        assert np.abs(part.rgba.astype(int) - values).mean() < 2


def test_the_dag_counts_where_it_is_asked_for(tmp_path):
    pytest.importorskip("astc_encoder", reason="astc-encoder-py is not installed: pip install \"texfcodec[baselines]\"")
    facts, _, _ = coded(painted_sphere(), tmp_path / "a", codec="astc", quality=10, resolution=32, addressing="dag")
    assert facts["bytes"]["addressing"] == facts["dag_bytes"]


@pytest.mark.parametrize("fill", FILLS)
def test_serialised_hevc_counts_its_files_and_decodes_to_the_voxels(tmp_path, fill):
    pytest.importorskip("av", reason="PyAV is not installed: pip install \"texfcodec[rivals]\"")
    scene = crossing_sheets()
    facts, method, decoded = coded(scene, tmp_path / "a", codec="hevc", qp=4, resolution=32, fill=fill, tile=8)
    check_files(tmp_path / "a", facts["bytes"])
    assert facts["bytes"]["addressing"] == 0
    for part, values in zip(decoded.fields, expected_values(scene, 32), strict=True):
        assert np.abs(part.rgba.astype(int) - values).mean() < 3


@pytest.mark.parametrize(("option", "value"), [("curve", "peano"), ("fill", "spiral"), ("tile", 48), ("codec", "png"),
                                               ("addressing", "table")])
def test_options_out_of_range_are_refused_with_what_there_is(tmp_path, option, value):
    from tools.bench.methods.serialized import Serialized

    with pytest.raises(ValueError, match=f"{option} must be one of"):
        Serialized().encode(painted_sphere(), {option: value}, tmp_path, 1, Report())
