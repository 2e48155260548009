"""Draco's bytes of many faces are reckoned from pieces of them."""

import numpy as np
import pytest
from analytic import grid_mesh

from texfcodec.encoder.mesh import draco_bytes as room
from texfcodec.encoder.mesh.draco_bytes import draco_bytes

BITS = 12


@pytest.fixture
def rough():
    """A rough square of 79,202 faces on its lattice, with UVs."""
    positions, faces = grid_mesh(200, height=0.05)
    positions[:, 2] += np.random.default_rng(0).normal(0, 0.003, len(positions))
    lattice = np.rint((positions + [0, 0, 0.1]) * 4000).astype(np.int64)
    return lattice, faces, lattice[faces][..., :2] * 2 + 40


@pytest.mark.parametrize("textured", [False, True])
def test_pieces_take_about_their_share_of_the_bytes(monkeypatch, rough, textured):
    lattice, faces, uv = rough
    whole = draco_bytes(lattice, faces, BITS, uv if textured else None)
    monkeypatch.setattr(room, "MOST_CODED", 40_000)
    monkeypatch.setattr(room, "PIECE", 1 << 13)
    sizes = []
    monkeypatch.setattr(room, "enc_geometry", lambda *args, code=room.enc_geometry: sizes.append(len(args[1])) or code(*args))
    reckoned = draco_bytes(lattice, faces, BITS, uv if textured else None)
    assert 1 < reckoned / whole < 1.2  # borders of small pieces cost; those of 32,768 faces a few per cent
    assert textured or sizes == [room.PIECES << 13]


def test_pieces_are_of_the_whole_surface_and_no_face_is_there_twice(monkeypatch, rough):
    lattice, faces, _ = rough
    monkeypatch.setattr(room, "PIECE", 1 << 10)
    chosen = room._pieces(lattice, faces, BITS)
    assert len(chosen) == len(np.unique(chosen)) == room.PIECES << 10
    spread = np.ptp(lattice[faces[chosen]].reshape(-1, 3), axis=0)[:2]
    assert (spread > 0.9 * np.ptp(lattice, axis=0)[:2]).all()
