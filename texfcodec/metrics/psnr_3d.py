"""3D-PSNR of a decoded stream against its source: colours at the same surface points on both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.colour_error import ColourError
from ..core.json_text import json_ready
from ..errors import InputError
from ..geometry.areas import sample_surface
from ..scene.fetch import pack_source, sample_source
from .face_match import FaceMatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..report import Report
    from ..scene.scene import Scene
    from ..texf import Texf

SAMPLES = 1_000_000
BLOCK = 1 << 17  # points asked at a time


class SourceSamples:
    """Points spread evenly by area over the source, with its colours there; several streams can be compared at the same points.

    Parameters
    ----------
    scene : Scene
        The source.
    samples : int
        Number of points.
    threads : int
        Most threads.
    seed : int
        Of the random points.
    at : (int64 [M], float64 [M, 3]), optional
        Faces and barycentric coordinates of points that were chosen otherwise.

    Attributes
    ----------
    face : int64 [M]
        Faces of the points.
    bary : float64 [M, 3]
        Their barycentric coordinates.
    colour : float32 [M, 4]
        RGBA, 0..255, of the precision of uint8.
    """

    def __init__(self, scene: Scene, samples: int = SAMPLES, threads: int = 1, seed: int = 0,
                 at: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        self.scene, self.threads = scene, threads
        self.face, self.bary = sample_surface(scene.positions, scene.faces, samples, seed) if at is None else at
        self.colour = sample_source(pack_source(scene), self.face, self.bary, threads)

    def compare(self, texf: Texf) -> dict:
        """Return the 3D-PSNR of a decoded stream: the PSNR of its colours at these points of the surface. Errors are weighted by
        the source's alpha if texf has alpha.

        Parameters
        ----------
        texf : Texf
            The decoded stream.

        Returns
        -------
        dict
            "y", "yuv611", "rgb" in dB, None means lossless; "samples".

        Raises
        ------
        InputError
            TXF-I94 if texf has alpha and no point is visible, TXF-I70 if it has no face.
        """
        error = ColourError()
        error.add(self.colour[:, :3], self.answers(texf)[:, :3], self.weights(texf))
        return psnr_of(error)

    def weights(self, texf: Texf) -> np.ndarray | None:
        """Return the weight of each point's error: the source's alpha there, 0..1, if texf has alpha.

        Parameters
        ----------
        texf : Texf
            The decoded stream.

        Returns
        -------
        float32 [M] or None
            None if texf has no alpha and all points count alike.
        """
        return self.colour[:, 3] / 255 if texf.has_alpha else None

    def answers(self, texf: Texf) -> np.ndarray:
        """Return the values of a decoded stream at this object's points, in their order; FaceMatch finds each on the stream's
        surface.

        Parameters
        ----------
        texf : Texf
            The decoded stream.

        Returns
        -------
        float32 [M, 4]
            RGBA, 0..255.
        """
        match, out = FaceMatch(self.scene, texf, self.threads), np.empty((len(self.face), 4), np.float32)
        face_field = texf.face_field
        for begin in range(0, len(self.face), BLOCK):
            part = slice(begin, begin + BLOCK)
            places = match.find(self.face[part], self.bary[part])
            out[part] = texf.query_by_field(places.points, face_field[places.face], places.face)
        return out


def psnr_of(error: ColourError) -> dict:
    """Return the 3D-PSNR of an error that was accumulated over surface points.

    Parameters
    ----------
    error : ColourError
        Error over surface points.

    Returns
    -------
    dict
        "y", "yuv611", "rgb" in dB, None means lossless; "samples": number of points. yuv611 is (6 Y + U + V) / 8 of the decibels.

    Raises
    ------
    InputError
        TXF-I94 if no point is visible.
    """
    if not error.weight > 0:
        raise InputError("TXF-I94", "the 3D-PSNR cannot be computed: the surface is invisible, because its alpha is 0 everywhere")
    result = json_ready(error.result())
    return {name: result[f"psnr_{name}"] for name in ("y", "yuv611", "rgb")} | {"samples": error.samples}


def measure_or_warn(measured: Callable[[], dict], report: Report) -> dict | None:
    """Return the result of a measurement, or None with a warning if no point of the source is visible.

    Parameters
    ----------
    measured : function () -> dict
        The measurement.
    report : Report
        Gets the warning.

    Returns
    -------
    dict or None
        What measured() returns.
    """
    try:
        return measured()
    except InputError as error:
        if error.code != "TXF-I94":
            raise
        report.warnings.append(error.message)
        return None


def measure(scene: Scene, texf: Texf, samples: int = SAMPLES, threads: int = 1) -> dict:
    """Return the 3D-PSNR of texf against scene: the PSNR of colours at points spread evenly over the source's surface.

    Parameters
    ----------
    scene : Scene
        The source.
    texf : Texf
        Its decoded stream.
    samples : int
        Number of surface points.
    threads : int
        Most threads.

    Returns
    -------
    dict
        "y", "yuv611", "rgb" in dB, None means lossless; "samples"; as of psnr_of().

    Raises
    ------
    InputError
        TXF-I94 if no point is visible, TXF-I70 if texf has no face.
    """
    return SourceSamples(scene, samples, threads).compare(texf)
