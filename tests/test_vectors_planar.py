"""The makers of the vectors of planar supports, on a flat sheet of voxels that is taken for planar."""

import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from texfcodec import EncodeOptions, decode
from texfcodec.asset.scene import Material, Scene, Texture
from texfcodec.bitstream import stream as stream_room
from texfcodec.encoder import encode_scene
from texfcodec.errors import StreamError

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))
import vectors_planar
from vectors_good import parsed, raht, values_of, written

VOXELS = stream_room.attribute_variables


@pytest.fixture(scope="module")
def sheet():
    """A stream of a square in the plane z = 0, and every unit of any stream taken for planar while the tests run."""
    corners, faces = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64), np.array([[0, 1, 2], [0, 2, 3]])
    noise = np.random.default_rng(4).integers(0, 256, (24, 24, 4)).astype(np.uint8)
    noise[..., 3] = 255
    scene = Scene(np.column_stack([corners, np.zeros(4)]), faces, np.zeros(2, np.int64), corners[faces], None,
                  [Material("sheet", texture=0)], [Texture(noise)])
    data = encode_scene(scene, EncodeOptions(resolution=24, qp=24, effort="fast")).data
    with patch.object(stream_room, "attribute_variables", lambda *unit: VOXELS(*unit) | {"Planar": 1}):
        yield data


@pytest.fixture(scope="module")
def planar(sheet):
    """The sheet as a planar stream."""
    with patch.object(stream_room, "attribute_variables", VOXELS):
        stream, fields = parsed(sheet), decode(sheet).fields
        (unit,) = stream.attributes
        unit.update(raht(values_of(unit, fields[0].keys), fields[0].keys, 24, unit["qp"], **vectors_planar.ALL))
    return written(stream)


def test_good_vectors_decode_and_differ(planar):
    made = [vector.data for vector in vectors_planar.good(planar)]
    assert len(set(made)) == len(made) == 8
    assert all(len(decode(data).fields[0].keys) > 300 for data in made)


def test_faulty_vectors_are_refused_with_their_code(planar):
    for vector in vectors_planar.faulty(planar):
        with pytest.raises(StreamError) as caught:
            decode(vector.data)
        assert caught.value.code == vector.code, vector.name
