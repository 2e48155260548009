"""What a job measures, and the pictures that it leaves."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from shapes import painted_sphere

from tools.bench.conditions import EVALUATION
from tools.bench.measures import measure_job, views_shown

SMALL = EVALUATION | {"samples": 500, "views": 3, "size": 64}


def darker(scene):
    return replace(scene, corner_color=scene.corner_color * np.float32(0.5))


@pytest.fixture(scope="module")
def ball():
    return painted_sphere(8)


@pytest.mark.parametrize("pictures, views, shown", [(0, 16, []), (1, 16, [8]), (2, 4, [1, 3]), (4, 16, [2, 6, 10, 14]),
                                                    (9, 3, [0, 1, 2])])
def test_pictures_are_spread_over_the_views(pictures, views, shown):
    assert views_shown(pictures, views) == shown


def test_pictures_show_the_source_and_what_was_decoded(ball, tmp_path):
    job = {"evaluation": SMALL | {"pictures": 2, "picture_size": 32}, "threads": 1}
    assert measure_job(ball, darker(ball), job, tmp_path)["pictures"] == [0, 2]
    seen = {path.name: np.asarray(Image.open(path).convert("RGB"), np.float64) for path in tmp_path.iterdir()}
    assert set(seen) == {"source_00.webp", "picture_00.webp", "source_02.webp", "picture_02.webp"}
    for view in ("00", "02"):
        source, picture = seen[f"source_{view}.webp"], seen[f"picture_{view}.webp"]
        assert source.shape == (32, 32, 3) and source[0, 0].min() > 250 < picture[0, 0].min()
        assert source[12:20, 12:20].mean() > 1.2 * picture[12:20, 12:20].mean()


def test_no_pictures_are_written_or_told_of_unless_asked_for(ball, tmp_path):
    found = measure_job(ball, ball, {"evaluation": SMALL | {"views": 0}, "threads": 1}, tmp_path)
    assert list(tmp_path.iterdir()) == [] and set(found) == {"psnr_3d", "image", "maps"} and found["image"] is None
