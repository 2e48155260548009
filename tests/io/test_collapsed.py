"""Faces that the lattice has no room for are named with their count, and a count of one is singular."""

import numpy as np
import pytest
from mesh_files import Builder, load_bytes
from shapes import painted_sphere

from texfcodec import EncodeOptions, Report
from texfcodec.encoder.encode import encode_scene
from texfcodec.report import plural


def remarks_of(scene, **options):
    report = Report()
    made = encode_scene(scene, EncodeOptions(resolution=8, qp=40, threads=1, **options), report)
    return [text for text in report.remarks if "without area" in text], made


@pytest.mark.parametrize("copies, says", [(0, None), (1, "1 face is"), (3, "3 faces are")])
def test_faces_that_collapse_on_the_lattice_are_named_with_their_share(copies, says):
    scene = painted_sphere(4)
    tiny = scene.positions[:1] + np.array([[0, 0, 0], [1e-7, 0, 0], [0, 1e-7, 0]])
    count = len(scene.positions)
    whole, made = remarks_of(scene)
    assert whole == []
    scene.faces = np.concatenate([scene.faces, *[[[count, count + 1, count + 2]]] * copies]).astype(np.int64)
    scene.positions = np.concatenate([scene.positions, tiny])
    last = slice(len(scene.faces) - copies, None)
    for name in ("face_material", "corner_uv", "corner_color", "corner_normal", "corner_tangent"):
        values = getattr(scene, name)
        if values is not None:
            setattr(scene, name, np.concatenate([values, values[:copies]]))
    found, again = remarks_of(scene)
    assert again.counts["faces"] == made.counts["faces"] and (again.face_field[last] == -1).all()
    if says is None:
        assert found == []
    else:
        total = len(scene.faces)
        assert found == [f"{says} left out ({100 * copies / total:.2g} % of {total}), without area at 14 position bits; "
                         "more --position-bits may keep such faces"]


def test_a_count_of_one_is_singular(tmp_path):
    assert [plural(count, "face", "faces") for count in (0, 1, 2)] == ["0 faces", "1 face", "2 faces"]
    builder = Builder()
    builder.primitive(positions=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [5, 5, 5]], np.float32),
                      indices=np.array([[0, 1, 2], [0, 1, 1]], np.uint16))
    scene = load_bytes(tmp_path, builder)
    assert scene.remarks == ["1 vertex that no face uses is left out", "1 face uses the same vertex twice (degenerate)"]
    assert repr(scene) == "<Scene: 2 faces, 1 material, 0 textures>"
