"""3D-PSNR of a decoded stream against its source: the same surface points asked on both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.colour_error import ColourError
from ..core.json_text import json_ready
from ..errors import InputError
from ..geometry.areas import sample_surface
from ..scene.fetch import pack_source, sample_source
from .face_match import decoded_faces

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..report import Report
    from ..scene.scene import Scene
    from ..texf import Texf

SAMPLES = 1_000_000
BLOCK = 1 << 17  # points asked at a time


class SourceSamples:
    """Points spread evenly by area over the source, with its colours there; ask several streams with the same ones.

    scene: Scene; samples: number of points; threads; seed: of where they fall; at: (face, bary) of points that were chosen
    otherwise. face: int64 [M]; bary: float64 [M, 3]; colour: uint8-precise float32 [M, 4], 0..255.
    """

    def __init__(self, scene: Scene, samples: int = SAMPLES, threads: int = 1, seed: int = 0,
                 at: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        self.scene = scene
        self.face, self.bary = sample_surface(scene.positions, scene.faces, samples, seed) if at is None else at
        self.colour = sample_source(pack_source(scene), self.face, self.bary, threads)

    def compare(self, texf: Texf, face_field: np.ndarray | None = None) -> dict:
        """3D-PSNR of texf in dB {"y", "yuv611", "rgb", "samples"}; None means lossless.

        face_field: as of answers(). Errors weigh by the source's alpha where texf has alpha. Raises InputError TXF-I94 where texf
        has alpha and no point is visible.
        """
        error = ColourError()
        error.add(self.colour[:, :3], self.answers(texf, face_field)[:, :3], self.weights(texf))
        return psnr_of(error)

    def weights(self, texf: Texf) -> np.ndarray | None:
        """How much of each point the source shows, float32 [M]; None where texf has no alpha and all count alike."""
        return self.colour[:, 3] / 255 if texf.has_alpha else None

    def answers(self, texf: Texf, face_field: np.ndarray | None = None) -> np.ndarray:
        """What texf has at the points, float32 [M, 4], 0..255.

        face_field: int64 per scene face, the field of texf it asks, -1 for a face that was left out; None: the only field, or
        the field of the nearest decoded face. Points on faces that were left out ask the first field.
        """
        out, asked = np.empty((len(self.face), 4), np.float32), self._on_faces(texf)
        for begin in range(0, len(self.face), BLOCK):
            part = slice(begin, begin + BLOCK)
            corners = self.scene.positions[self.scene.faces[self.face[part]]]
            points = np.einsum("mk,mkc->mc", self.bary[part], corners)
            if asked is not None:
                out[part] = asked(part, points)
            elif face_field is None or len(texf.fields) == 1:
                out[part] = texf.query(points)
            else:
                out[part] = texf.query_by_field(points, np.maximum(np.asarray(face_field)[self.face[part]], 0))
        return out

    def _on_faces(self, texf):
        """Function (samples, their world points) -> colours, where texf has fields over texels: these ask the same corner weights
        of the decoded face. None where it has none."""
        if not any(part.over_texels for part in texf.fields):
            return None
        found, turn = decoded_faces(self.scene, texf)
        positions, faces, face_field = texf.positions, texf.faces, texf.face_field

        def asked(part, points):
            face = found[self.face[part]]
            there = np.flatnonzero(face >= 0)
            order = (np.arange(3) - turn[self.face[part]][there, None]) % 3
            weights = np.take_along_axis(self.bary[part][there], order, axis=1)
            points[there] = np.einsum("mk,mkc->mc", weights, positions[faces[face[there]]])
            lost = np.flatnonzero(face < 0)
            if len(lost):
                face[lost] = texf.nearest_face(points[lost])
            return texf.query_by_field(points, face_field[face], face)

        return asked


def psnr_of(error: ColourError) -> dict:
    """3D-PSNR {"y", "yuv611", "rgb", "samples"} in dB; None means lossless. InputError TXF-I94 where nothing is visible."""
    if not error.weight > 0:
        raise InputError("TXF-I94", "the 3D-PSNR is absent: no point of the surface is visible, its alpha is 0 everywhere")
    result = json_ready(error.result())
    return {name: result[f"psnr_{name}"] for name in ("y", "yuv611", "rgb")} | {"samples": error.samples}


def measure_or_warn(measured: Callable[[], dict], report: Report) -> dict | None:
    """What measured() returns, or None with a warning in report where no point of the source is visible."""
    try:
        return measured()
    except InputError as error:
        if error.code != "TXF-I94":
            raise
        report.warnings.append(error.message)
        return None


def measure(scene: Scene, texf: Texf, samples: int = SAMPLES, threads: int = 1, face_field: np.ndarray | None = None) -> dict:
    """3D-PSNR of texf against scene in dB: {"y", "yuv611", "rgb", "samples"}; see SourceSamples.compare."""
    return SourceSamples(scene, samples, threads).compare(texf, face_field)
