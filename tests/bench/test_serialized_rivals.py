"""The rivals over voxels along a curve: the curve, how it fills an image, how a GPU finds a voxel, and what is counted."""

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere

from texfcodec.field.morton import encode_morton
from texfcodec.report import Report
from tools.bench.methods.serialized import RECORD_MASKS, enc_octree
from tools.bench.methods.space_filling import CURVES, curve_keys, from_image, image_places, image_size, to_image


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
@pytest.mark.parametrize("count", [1, 64, 65, 5000])
def test_every_value_has_a_pixel_of_its_own(curve, count):
    values = np.random.default_rng(count).integers(0, 256, (count, 4), np.uint8)
    image = to_image(values, 8, curve)
    assert image.shape[1::-1] == image_size(count, 8)
    assert len(np.unique(image_places(count, 8, curve))) == count
    np.testing.assert_array_equal(from_image(image, count, 8, curve), values)


def test_hilbert_tiles_of_a_row_are_one_path():
    width, height = image_size(5000, 16)
    y, x = np.divmod(image_places(5000, 16, "hilbert"), width)
    jumps = np.abs(np.diff(x)) + np.abs(np.diff(y)) > 1
    assert jumps.sum() == height // 16 - 1


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="decodes to 9 x 8 pixels where 8 x 8"):
        from_image(np.zeros((8, 9, 4), np.uint8), 60, 8, "hilbert")


def find_in_octree(data, keys, bits):
    """Rank of each key in an octree, int64 [N], -1 where it is not there, as a shader would look it up: by counting bits."""
    records = np.frombuffer(data, np.uint8).reshape(-1, 4 + RECORD_MASKS)
    counts, masks = records[:, :4].copy().view("<u4")[:, 0].astype(np.int64), records[:, 4:].reshape(-1)
    set_bits = np.unpackbits(masks[:, None], axis=1, bitorder="little").astype(np.int64)
    assert (counts == np.append(0, np.cumsum(set_bits.reshape(-1, 8 * RECORD_MASKS).sum(axis=1))[:-1])).all()
    before, begin, end = np.cumsum(set_bits) - set_bits.ravel(), 0, 1
    node, found = np.zeros(len(keys), np.int64), keys >> 3 * bits == 0
    for level in range(bits - 1, -1, -1):
        digit = keys >> 3 * level & 7
        found &= set_bits[node, digit] == 1
        node = np.where(found, before[8 * node + digit] + 1, 0)
        begin, end = end, end + set_bits[begin:end].sum()
    return np.where(found, node - begin, -1)


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("bits", [1, 2, 3, 5, 6])
def test_the_octree_gives_the_rank_of_every_voxel_and_refuses_absent_ones(curve, bits):
    keys = sphere_keys(bits, curve)
    every = np.arange(8**bits + 9)
    expected = np.full(len(every), -1)
    expected[keys] = np.arange(len(keys))
    np.testing.assert_array_equal(find_in_octree(enc_octree(keys, bits), every, bits), expected)


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
    assert facts["bytes"]["addressing"] > 0
    for part, values in zip(decoded.fields, expected_values(scene, 64), strict=True):
        assert np.abs(part.rgba.astype(int) - values).mean() < 2


def test_serialised_hevc_counts_its_files_and_decodes_to_the_voxels(tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed: pip install \"texfcodec[rivals]\"")
    scene = crossing_sheets()
    facts, method, decoded = coded(scene, tmp_path / "a", codec="hevc", qp=4, resolution=32, tile=8)
    check_files(tmp_path / "a", facts["bytes"])
    assert facts["bytes"]["addressing"] == 0
    for part, values in zip(decoded.fields, expected_values(scene, 32), strict=True):
        assert np.abs(part.rgba.astype(int) - values).mean() < 3


@pytest.mark.parametrize(("option", "value"), [("curve", "peano"), ("tile", 48), ("codec", "png")])
def test_options_out_of_range_are_refused_with_what_there_is(tmp_path, option, value):
    from tools.bench.methods.serialized import Serialized

    with pytest.raises(ValueError, match=f"{option} must be one of"):
        Serialized().encode(painted_sphere(), {option: value}, tmp_path, 1, Report())
