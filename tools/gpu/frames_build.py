"""The kernels of frames.cu as a CuPy module: from a cubin that prepare_frames.py has carried along, by nvcc, or by NVRTC."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
ARCHITECTURE = "sm_90"


def device_source() -> str:
    """The CUDA text: functions of a pixel and of a warp, then kernels."""
    return "\n".join((HERE / name).read_text(encoding="utf-8") for name in ("frames_pixel.cu", "frames_tensor.cu", "frames.cu"))


def cubin_name() -> str:
    """Name of the cubin of this very text."""
    return f"frames_{hashlib.sha256(device_source().encode()).hexdigest()[:16]}.cubin"


def compile_cubin(folder: Path) -> Path | None:
    """Compiles the kernels into a folder; None without nvcc. Raises subprocess.CalledProcessError where nvcc refuses them."""
    compiler = shutil.which("nvcc") or shutil.which("/usr/local/cuda/bin/nvcc")
    if compiler is None:
        return None
    source, cubin = folder / "frames_device.cu", folder / cubin_name()
    source.write_text(device_source(), encoding="utf-8")
    subprocess.run([compiler, f"-arch={ARCHITECTURE}", "-cubin", "-o", str(cubin), str(source)], check=True, capture_output=True)
    source.unlink()
    return cubin


def kernels_of(cupy: Any, inputs: Path, scratch: Path) -> tuple[Any, str]:
    """(cupy.RawModule, how it was built). inputs: where a carried cubin may be; scratch: for one that is compiled now."""
    failures = []
    ways = {"cubin carried along": lambda: inputs / cubin_name(), "nvcc": lambda: compile_cubin(scratch), "NVRTC": lambda: None}
    for name, way in ways.items():
        try:
            cubin = way()
            if name != "NVRTC" and (cubin is None or not cubin.exists()):
                continue
            module = cupy.RawModule(path=str(cubin)) if cubin else cupy.RawModule(code=device_source(), options=("-std=c++17",))
            module.get_function("spin_kernel")((1,), (1,), (np.int64(0),))  # what is wrong shows at the first launch
            cupy.cuda.Device().synchronize()
            return module, name
        except Exception as error:  # whatever is wrong with one way, the next one may do
            failures.append(f"{name}: {error}")
    raise RuntimeError("; ".join(failures))
