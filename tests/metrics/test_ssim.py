"""SSIM against scikit-image and the naive one, and its gradient against finite differences."""


import numpy as np
import pytest

from oracles.ssim import ssim_mean
from texfcodec.metrics.ssim import RADIUS, ssim, ssim_gradient, ssim_map

# SSIM


def noisy_pair(height, width, channels=3, seed=0, noise=20.0):
    """A smooth image with some flat areas, and the same with noise: float64 [H, W, C] in 0..255."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = [127 + 120 * np.sin(x * rng.uniform(0.02, 0.4) + y * rng.uniform(0.02, 0.4) + c) for c in range(channels)]
    a = np.clip(np.stack(waves, -1), 20, 235)
    return a, np.clip(a + rng.normal(0, noise, a.shape), 0, 255)


@pytest.mark.parametrize("dtype, tolerance", [(np.float64, 1e-9), (np.float32, 1e-4), (np.uint8, 1e-4)])
def test_ssim_is_scikit_images_inside(dtype, tolerance):
    from skimage.metrics import structural_similarity

    a, b = (np.rint(v).astype(dtype) for v in noisy_pair(90, 130))
    _, expected = structural_similarity(a.astype(np.float64), b.astype(np.float64), gaussian_weights=True, sigma=1.5, full=True,
                                        use_sample_covariance=False, data_range=255, channel_axis=2)
    inner = (slice(RADIUS, -RADIUS),) * 2
    assert np.abs(ssim_map(a, b) - expected)[inner].max() < tolerance
    mask = np.zeros(a.shape[:2], bool)
    mask[inner] = True
    assert ssim(a, b, mask) == pytest.approx(expected[inner].mean(), abs=tolerance)


@pytest.mark.parametrize("shape", [(13, 17, 3), (4, 30, 1), (70, 6, 2), (1, 1, 3)])
def test_ssim_agrees_with_the_naive_one_borders_included(shape):
    a, b = noisy_pair(*shape, seed=3)
    mask = np.random.default_rng(1).random(shape[:2]) < 0.3
    mask[-1, 0] = True
    planes = [np.moveaxis(v, 2, 0).tolist() for v in (a, b)]
    assert ssim(a, b, mask) == pytest.approx(ssim_mean(*planes, mask.tolist()), abs=1e-10)
    assert ssim(a.astype(np.float32), b.astype(np.float32), mask) == pytest.approx(ssim(a, b, mask), abs=1e-4)
    assert ssim_map(a, b)[mask].mean() == pytest.approx(ssim(a, b, mask), abs=1e-12)


def test_ssim_of_equal_images_is_one_and_its_gradient_nothing():
    a = noisy_pair(40, 50)[0].astype(np.float32)
    assert ssim(a, a) == pytest.approx(1, abs=1e-6)
    value, gradient = ssim_gradient(a, a)
    assert value == pytest.approx(1, abs=1e-6)
    assert np.abs(gradient).max() < 1e-3 * np.abs(ssim_gradient(a, noisy_pair(40, 50)[1])[1]).max()


def test_ssim_does_not_depend_on_threads_or_on_what_is_far_from_the_mask():
    a, b = (v.astype(np.float32) for v in noisy_pair(200, 90))
    mask = np.zeros((200, 90), bool)
    mask[60:75, 40:60] = mask[150, 3] = True
    one, two = ssim_gradient(a, b, mask, threads=1), ssim_gradient(a, b, mask, threads=3)
    assert one[0] == two[0] == ssim(a, b, mask) and np.array_equal(one[1], two[1])
    near = np.zeros_like(mask)
    near[60 - RADIUS : 75 + RADIUS, 40 - RADIUS : 60 + RADIUS] = near[150 - RADIUS : 151 + RADIUS, : 4 + RADIUS] = True
    assert not one[1][~near].any() and one[1][near].any()
    other = np.where(near[:, :, None], b, 0).astype(np.float32)
    assert ssim(a, other, mask) == one[0] and np.array_equal(ssim_gradient(a, other, mask)[1], one[1])


@pytest.mark.parametrize("shape", [(80, 24, 3), (9, 31, 1)])
def test_ssim_gradient_is_that_of_finite_differences(shape):
    """At values of its own choice: corners, borders, mask edges and the rest."""
    a, b = noisy_pair(*shape, seed=5)
    rng = np.random.default_rng(2)
    mask = rng.random(shape[:2]) < 0.4
    mask[0, 0] = mask[-1, -1] = True
    _, gradient = ssim_gradient(a, b, mask)
    largest, step = np.abs(gradient).max(), 1e-3
    places = [(0, 0, 0), (shape[0] - 1, shape[1] - 1, 0), *zip(*(rng.integers(0, n, 60) for n in shape), strict=True)]
    for place in places:
        up, down = b.copy(), b.copy()
        up[place] += step
        down[place] -= step
        expected = (ssim(a, up, mask) - ssim(a, down, mask)) / (2 * step)
        assert gradient[place] == pytest.approx(expected, rel=1e-3, abs=1e-6 * largest)
    single = ssim_gradient(a.astype(np.float32), b.astype(np.float32), mask)[1]
    assert single.dtype == np.float32 and np.abs(single - gradient).max() < 1e-3 * largest


@pytest.mark.parametrize("a, b, mask, word", [
    (np.zeros((5, 5, 3)), np.zeros((5, 4, 3)), None, "H, W, C"), (np.zeros((5, 5)), np.zeros((5, 5)), None, "H, W, C"),
    (np.zeros((0, 5, 3)), np.zeros((0, 5, 3)), None, "empty"), (np.zeros((5, 5, 3)),) * 2 + (np.ones((4, 5)), "mask"),
    (np.zeros((5, 5, 3)),) * 2 + (np.zeros((5, 5)), "no pixel"),
])  # fmt: skip
def test_ssim_refuses(a, b, mask, word):
    for function in (ssim, ssim_gradient):
        with pytest.raises(ValueError, match=word):
            function(a, b, mask)
