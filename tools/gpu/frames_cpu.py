"""Frames on a CPU, for tests: the functions of frames_pixel.cu compiled by a C++ compiler, bound by ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from .frames_asset import FrameAsset

HERE = Path(__file__).parent
# Sums as vectors, 20 times faster; -ffast-math would also turn off subnormal numbers in the whole process.
REORDERED = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")


def host_source() -> str:
    """The C++ text: functions of a pixel, then loops over them."""
    return _joined("frames_pixel.cu", "frames_host.cu")


def warp_source() -> str:
    """The C++20 text of warp_points(): the network of tensor cores by threads."""
    return _joined("frames_pixel.cu", "frames_warp.cu", "frames_tensor.cu", "frames_warp_points.cu")


def _joined(*names):
    return "\n".join((HERE / name).read_text(encoding="utf-8") for name in names)


def compile_host(text: str, folder: Path, standard: str = "c++17") -> ctypes.CDLL:
    """A library of C++ text, compiled into a folder. Raises FileNotFoundError without a C++ compiler and
    subprocess.CalledProcessError where it refuses the text."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        raise FileNotFoundError("there is no C++ compiler")
    source, library = folder / "frames.cpp", folder / "frames.so"
    source.write_text(text, encoding="utf-8")
    command = [compiler, f"-std={standard}", "-O3", *REORDERED, "-shared", "-fPIC", "-pthread", "-o", str(library), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    return ctypes.CDLL(str(library))


class HostFrames:
    """Draws FrameAssets on the CPU. folder: for the compiled library. Raises FileNotFoundError without a C++ compiler."""

    def __init__(self, folder: Path) -> None:
        self._library = compile_host(host_source(), folder)

    def draw(self, asset: FrameAsset, camera: np.ndarray, kind: int) -> np.ndarray:
        """uint8 [side, side, 4], alpha 255 where anything is seen. camera: frames_asset.camera_of(); kind: as the asset's, or
        VOXELS of a neural one."""
        side = int(camera["side"][0])
        seen, visible = np.empty((asset.numbers["vertices"], 4), np.float32), np.empty(side * side, np.uint64)
        image, packed = np.empty((side, side), np.uint32), asset.packed(lambda array: array.ctypes.data)
        self._library.host_frame(*(ctypes.c_void_p(a.ctypes.data) for a in (packed, camera, seen, visible, image)), kind)
        return image.view(np.uint8).reshape(side, side, 4)

    def points(self, asset: FrameAsset, positions: np.ndarray) -> np.ndarray:
        """Colours float32 [M, 3] of the network at int32 [M, 4]: x, y, z of 2**24 a side and the field."""
        return points_by(self._library.host_points, asset, positions)


def points_by(function: Any, asset: FrameAsset, positions: np.ndarray) -> np.ndarray:
    """As HostFrames.points(), by a function of a library."""
    positions = np.ascontiguousarray(positions, np.int32)
    out, packed = np.full((len(positions), 3), np.nan, np.float32), asset.packed(lambda array: array.ctypes.data)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (packed, positions)]
    function(*pointers, len(positions), ctypes.c_void_p(out.ctypes.data))
    return out


def picture_psnr(picture: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """PSNR in dB over pixels that both cover and how many one alone covers. uint8 [H, W, 4] each, alpha 0 where nothing is."""
    seen, expected = picture[..., 3] > 0, reference[..., 3] > 0
    both = seen & expected
    error = (picture[both][:, :3].astype(np.float64) - reference[both][:, :3]) ** 2
    mean = error.mean() if both.any() else np.inf
    return {"psnr_db": round(float(10 * np.log10(255.0**2 / max(mean, 1e-9))), 2) if np.isfinite(mean) else 0.0,
            "pixels_compared": int(both.sum()), "pixels_of_one_alone": int((seen ^ expected).sum())}
