"""glTF skins at rest: meshes in the pose of their joints in the file (glTF 2.0 section 3.7.3.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ..parts import Part
from .accessor import read_floats
from .properties import malformed

if TYPE_CHECKING:
    from .document import Document

_BLOCK = 1 << 16  # vertices whose matrices are held at a time
_STORED = "its mesh is used as stored, placed by the node"


class Rest:
    """Poses of a file's skins by the transforms of its nodes.

    local: node -> float64 [4, 4] acting on columns; references: (entry, key) -> indices of nodes.
    """

    def __init__(self, document: Document, local: Callable[[dict], np.ndarray],
                 references: Callable[[dict, str], list[int]]) -> None:
        self.document, self._local, self._references = document, local, references
        self._skins: dict[Any, np.ndarray] = {}

    def posed(self, parts: list[Part], skin: Any, name: str) -> list[Part] | None:
        """Return the Parts of a mesh in world space, posed by the joints of a skin; None, with a fault, if that fails.

        skin: index of the file's skin. The transform of the mesh's node is ignored. name: of that node, for messages.
        """
        try:
            matrices = self._matrices(skin)
            return [self._posed(part, matrices) for part in parts]
        except InputError as error:
            self.document.notes.fault("TXF-I09", f"the skin of {name} cannot be applied: {error.message}; {_STORED}",
                                      "skin", **error.details)
            return None

    @cached_property
    def _above(self):
        """{node: parent} of all nodes with a parent."""
        nodes = self.document.entries("nodes")
        return {child: index for index, node in enumerate(nodes) for child in self._references(node, "children")}

    def _world(self, index):
        """World matrix of a node, float64 [4, 4]."""
        matrix, seen = np.eye(4), set()
        while index is not None:
            if index in seen:
                raise malformed("the node graph is not a tree: a node is its own ancestor", value=index)
            seen.add(index)
            matrix = self._local(self.document.entry("nodes", index)) @ matrix
            index = self._above.get(index)
        return matrix

    def _matrices(self, skin):
        """Matrices from mesh space to the world, float64 [joints, 3, 4]."""
        if skin not in self._skins:
            entry = self.document.entry("skins", skin)
            joints = self._references(entry, "joints")
            if not joints:
                raise malformed("a skin has no joints")
            bind = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
            if "inverseBindMatrices" in entry:
                rows = read_floats(self.document, entry["inverseBindMatrices"], ("MAT4",)).astype(np.float64)
                if len(rows) < len(joints):
                    raise malformed("a skin has fewer inverse bind matrices than joints", value=len(rows), allowed=len(joints))
                bind = rows[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
            matrices = np.array([self._world(joint) @ matrix for joint, matrix in zip(joints, bind, strict=True)])
            matrices = matrices.reshape(-1, 4, 4)
            if not np.isfinite(matrices).all():
                raise malformed("a skin has matrices that are NaN or infinite")
            self._skins[skin] = matrices[:, :3]
        return self._skins[skin]

    def _posed(self, part, matrices):
        """The Part transformed by the weighted sum of its joints' matrices; faces are reversed if that mirrors them."""
        joints, weights = self._influences(part, len(matrices))
        points = np.asarray(part.positions, np.float64).copy()
        normal = None if part.normal is None else np.asarray(part.normal, np.float64).copy()
        tangent = None if part.tangent is None else np.asarray(part.tangent, np.float64).copy()
        mirrored = np.zeros(len(points), bool)
        for begin in range(0, len(points), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            blend = np.einsum("vj,vjrc->vrc", weights[rows], matrices[joints[rows]])
            linear = blend[..., :3]
            points[rows] = np.einsum("vrc,vc->vr", linear, points[rows]) + blend[..., 3]
            x, y, z = np.moveaxis(linear, 2, 0)
            side = np.einsum("vr,vr->v", x, np.cross(y, z))
            mirrored[rows] = side < 0
            if normal is not None:  # by cofactors, as normals.place_normals
                normal[rows] = (normal[rows, :1] * np.cross(y, z) + normal[rows, 1:2] * np.cross(z, x)
                                + normal[rows, 2:] * np.cross(x, y)) * np.where(side < 0, -1.0, 1.0)[:, None]
            if tangent is not None:
                tangent[rows, :3] = np.einsum("vrc,vc->vr", linear, tangent[rows, :3])
                tangent[rows, 3] *= np.where(side < 0, -1.0, 1.0)
        faces = _turned(part.faces, mirrored)
        return replace(part, positions=points, faces=faces, normal=normal, tangent=tangent, influences=None)

    def _influences(self, part, count):
        """(joints int64 [V, J], weights float64 [V, J] that sum to 1)."""
        if part.influences is None:
            raise malformed(f"JOINTS_0 and WEIGHTS_0 of {part.label} are missing or differ in count")
        joints, weights = (np.asarray(values, np.float64) for values in part.influences)
        if len(joints) != len(part.positions) or joints.shape != weights.shape:
            raise malformed(f"{part.label} has attributes of different counts")
        broken = ~np.isfinite(weights) | (weights < 0)
        weights = np.where(broken, 0.0, weights)
        total = weights.sum(axis=1)
        bad = int((broken.any(axis=1) | ~(total > 0)).sum())
        if bad:
            self.document.notes.warn(f"{bad} of {len(total)} vertices of {part.label} have skin weights that are negative, "
                                     "NaN, infinite or all 0; their valid weights are used, else the first joint")
        weights[~(total > 0), 0] = 1.0
        beyond = (weights > 0) & ~(joints < count)
        if beyond.any():
            raise malformed(f"{part.label} refers to a joint that does not exist", value=int(joints[beyond][0]),
                            allowed=count - 1)
        joints = np.where(weights > 0, joints, 0).astype(np.int64)
        return joints, weights / weights.sum(axis=1, keepdims=True)


def _turned(faces, mirrored):
    """Faces, with the winding reversed if most of their corners are mirrored. assemble() refuses faces with invalid indices."""
    if not mirrored.any() or len(faces) == 0 or faces.max() >= len(mirrored):
        return faces
    turn = mirrored[faces].sum(axis=1) >= 2
    return np.where(turn[:, None], faces[:, [0, 2, 1]], faces)
