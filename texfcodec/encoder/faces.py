"""Numbers of faces, and surfaces, as types that mypy does not let mix: of the source, and of the sent mesh (encoder only)."""

from __future__ import annotations

from typing import NewType, TypeVar

import numpy as np

from ..geometry.surface import Surface

SourceFaces = NewType("SourceFaces", np.ndarray)  # int64 [N], numbers in the source Scene
LatticeFaces = NewType("LatticeFaces", np.ndarray)  # int64 [N], numbers in a SourceSurface, which lacks faces that collapse
SentFaces = NewType("SentFaces", np.ndarray)  # int64 [N], numbers in the SentSurface
SourceSurface = NewType("SourceSurface", Surface)  # faces of the source, on its own lattice or drawn onto the sent mesh
SentSurface = NewType("SentSurface", Surface)  # faces of the sent mesh
Faces = TypeVar("Faces", bound=np.ndarray)  # LatticeFaces or SentFaces


def source_faces(surface: SourceSurface, faces: LatticeFaces | None = None) -> SourceFaces:
    """Return the numbers in the source Scene of some faces of its surface. faces: numbers in the surface; None: all faces."""
    return SourceFaces(surface.origin_face if faces is None else surface.origin_face[faces])
