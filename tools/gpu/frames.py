"""Milliseconds of frames by compute over the metric's views: a visibility buffer, then one pass over the visible pixels (explicit
voxels, texels, 3DNTC, a UV texture). Inputs are what prepare_frames.py wrote; pictures go into frames_pictures.zip.

On a device "cpu" the same functions draw one small view of each asset without timing.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from .frames_asset import NEURAL, FrameAsset, anchor_of, asset_of, camera_of, load_arrays
from .frames_cpu import HostFrames, picture_psnr
from .rows import Context, Row

ORDER = ("player_3dntc", "player_voxels", "player_texels", "player_uv", "helmet_3dntc", "helmet_voxels", "helmet_texels",
         "helmet_uv", "room_voxels", "room_texels", "room_uv")
SIDE, REPEATS, PICTURE, FAR = 2048, 40, 1024, 4.0
SECONDS_OF_ROW = 5.0  # what has to be left for another row
LEAST_PSNR = 40.0
FRAGMENT_REPEATS, FRAGMENT_SECONDS = 10, 60.0
MOST_MEAN, MOST_ONE = 0.5, 8.0  # levels of 255 by which tensor cores may miss the normative evaluation
PICTURES = "frames_pictures.zip"


def measure(context: Context) -> Iterator[Row]:
    """Rows "frames/<asset>/<kind>/<how>", see rows.py."""
    names = [name for name in ORDER if _path(context, name).exists()]
    if not names:
        yield Row("frames/inputs", {"skipped": f"{context.inputs} has no frames_*.npz.xz of prepare_frames.py"})
        return
    if context.device == "cpu":
        yield from _on_cpu(context, names)
        return
    with ThreadPoolExecutor(8) as pool:  # all before the first timing
        loaded = list(pool.map(lambda name: _load(context, name), names))
    yield from _on_gpu(context, dict(zip(names, loaded, strict=True)))
    yield from _by_fragments(context)


def _path(context, name):
    """The file that an asset of ORDER stands in; a UV texture stands beside the texels."""
    return context.inputs / f"frames_{name.replace('_uv', '_texels')}.npz.xz"


def _load(context, name):
    data = load_arrays(_path(context, name))
    data = anchor_of(data) if name.endswith("_uv") else data
    return data, asset_of(data)


def _key(name: str, zoom: str, how: str) -> str:
    asset, kind = name.split("_")
    return f"frames/{asset}/{kind + '-' + zoom if kind == '3dntc' else kind}/{how}"


def _zooms(data):
    return {"near": 1.0} | ({"far": FAR} if "reference_far" in data else {})


def _compared(picture, data, zoom):
    """PSNR against the reference picture; nothing where it was drawn at another size."""
    side = len(picture)
    if side != int(data["reference_side"]):
        return {}
    first, step = data[f"window_{zoom}"]
    figures = picture_psnr(picture[first : side - first : step, first : side - first : step], data[f"reference_{zoom}"])
    return figures | {"picture_is_right": figures["psnr_db"] >= LEAST_PSNR}


def _on_cpu(context, names):
    with tempfile.TemporaryDirectory() as folder:
        try:
            host = HostFrames(Path(folder))
        except FileNotFoundError as error:
            yield Row("frames/cpu", {"skipped": str(error)})
            return
        for name in names:
            data, asset = _load(context, name)
            side, view = context.scaled(SIDE, 128), int(data["reference_view"])
            for zoom, wide in _zooms(data).items():
                camera = camera_of(*data["cameras"][view], wide, side, asset.voxels_per_radius)
                picture = host.draw(asset, camera, asset.kind)
                _keep_picture(context, _key(name, zoom, "cpu"), picture)
                yield Row(_key(name, zoom, "cpu"), {"side": side, "visible_pixels": int((picture[..., 3] > 0).sum()),
                                                    **json.loads(str(data["facts"])), **_compared(picture, data, zoom)})


def _keep_picture(context, key, picture):
    """Adds a picture to the archive, on white, at most PICTURE pixels a side."""
    from PIL import Image

    times = max(1, len(picture) // PICTURE)
    small = picture[..., :3].reshape(len(picture) // times, times, len(picture) // times, times, 3).mean(axis=(1, 3))
    buffer = io.BytesIO()
    Image.fromarray(np.rint(small).astype(np.uint8)).save(buffer, "PNG")
    context.out.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(context.out / PICTURES, "a") as archive:
        archive.writestr(key.removeprefix("frames/").replace("/", "_") + ".png", buffer.getvalue())


def _by_fragments(context):
    """Rows "frames/<asset>/<kind>/fragments", of a process of its own; one sentence where there is no EGL."""
    if not context.wants("frames/fragments"):
        return
    if not (context.inputs / "frames_glsl.json").exists():
        yield Row("frames/fragments", {"skipped": "there are no shaders: prepare_frames.py makes them where node is"})
        return
    numbers = [str(SIDE), str(context.scaled(FRAGMENT_REPEATS, 2))]
    command = [sys.executable, "-m", "tools.gpu.frames_egl", str(context.inputs), *numbers]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=max(1.0, min(FRAGMENT_SECONDS, context.left())))
        lines, fault = done.stdout, done.stderr.strip().splitlines()[-1:] if done.returncode else []
    except subprocess.TimeoutExpired as error:
        lines, fault = _text(error.stdout), [f"the process was ended after {error.timeout:.0f} s"]
    for line in lines.splitlines():
        row = json.loads(line)
        yield Row(row["key"], row["figures"])
    yield Row("frames/fragments", {"skipped": f"fragment shaders through EGL: {fault[0]}"} if fault else {"drawn": "all assets"})


def _text(output):
    return output.decode() if isinstance(output, bytes) else output or ""


# ---- On a GPU


class GpuFrames:
    """Frames of one FrameAsset. module: of frames_build.kernels_of()."""

    ROOM = 1 << 22  # strips of large faces

    def __init__(self, cupy: Any, module: Any, asset: FrameAsset, side: int) -> None:
        self.cupy, self.side, self.asset = cupy, side, asset
        self.kernel = module.get_function
        self._copies = [cupy.asarray(np.ascontiguousarray(array).reshape(-1).view(np.uint8)) for array in asset.arrays.values()]
        addresses = {id(array): copy.data.ptr for array, copy in zip(asset.arrays.values(), self._copies, strict=True)}
        self.packed = cupy.asarray(asset.packed(lambda array: addresses[id(array)]).view(np.uint8))
        self.camera, self.counts = cupy.zeros(64, np.uint8), cupy.zeros(2, np.uint32)
        self.seen = cupy.empty((asset.numbers["vertices"], 4), np.float32)
        self.visible, self.image = cupy.empty(side * side, np.uint64), cupy.empty(side * side, np.uint32)
        self.list, self.queue = cupy.empty(side * side, np.uint32), cupy.empty((self.ROOM, 2), np.int32)
        self.processors = cupy.cuda.runtime.getDeviceProperties(0)["multiProcessorCount"]
        self.stream = cupy.cuda.Stream(non_blocking=True)

    def look(self, camera: np.ndarray) -> None:
        """Takes a camera of camera_of()."""
        self.camera[: camera.nbytes] = self.cupy.asarray(camera.view(np.uint8).reshape(-1))
        self.cupy.cuda.Device().synchronize()

    def find_visible(self) -> None:
        """The visibility buffer and the list of its pixels."""
        pixels, faces = self.side * self.side, int(self.asset.numbers["face_count"])
        scene, room = (self.packed, self.camera, self.seen), np.uint32(self.ROOM)
        self._run("clear_kernel", -(-pixels // 256), 256, self.visible, self.image, np.int32(pixels), self.counts)
        self._run("vertices_kernel", -(-int(self.asset.numbers["vertices"]) // 256), 256, *scene)
        self._run("faces_kernel", -(-faces // 128), 128, *scene, self.visible, self.queue, room, self.counts)
        self._run("strips_kernel", 16 * self.processors, 128, *scene, self.visible, self.queue, room, self.counts)
        tiles = -(-self.side // 16)
        self._run("list_kernel", (tiles, tiles), 256, self.visible, np.int32(self.side), self.list, self.counts)

    def shade(self, kernel: str) -> None:
        """The pass over visible pixels."""
        blocks = (5 if "tensor" in kernel else 64) * self.processors  # of the first as many as fit at once
        self._run(kernel, blocks, 128, self.packed, self.camera, self.seen, self.visible, self.list, self.counts, self.image)

    def _run(self, kernel, blocks, threads, *given):
        self.kernel(kernel)(blocks if isinstance(blocks, tuple) else (blocks,), (threads,), given)

    def repeater(self, kernel: str) -> tuple[list, str]:
        """([function that starts visibility, function that starts shading], how): graphs, or launches where they fail."""
        steps = [self.find_visible, lambda: self.shade(kernel)]
        with self.stream:
            for step in steps:
                step()
        self.stream.synchronize()
        try:
            return [self._graph(step) for step in steps], "CUDA graphs"
        except Exception as error:  # an old CuPy, say: launches are timed then, with what lies between them
            return steps, f"launches, as graphs failed: {type(error).__name__}: {error}"

    def _graph(self, step):
        with self.stream:
            self.stream.begin_capture()
            try:
                step()
            finally:
                graph = self.stream.end_capture()
        return lambda: graph.launch(self.stream)

    def times(self, steps: list, repeats: int) -> np.ndarray:
        """Milliseconds float64 [repeats, 2] of visibility and shading, by events."""
        events = [[self.cupy.cuda.Event() for _ in range(3)] for _ in range(repeats)]
        with self.stream:
            self._run("spin_kernel", 1, 1, np.int64(60_000 * repeats))  # about 35 microseconds of queueing for each
            for begin, middle, end in events:
                begin.record(self.stream)
                steps[0]()
                middle.record(self.stream)
                steps[1]()
                end.record(self.stream)
        self.stream.synchronize()
        elapsed = self.cupy.cuda.get_elapsed_time
        return np.array([(elapsed(a, b), elapsed(b, c)) for a, b, c in events])

    def picture(self) -> np.ndarray:
        """The image, uint8 [side, side, 4]."""
        return self.cupy.asnumpy(self.image).view(np.uint8).reshape(self.side, self.side, 4)


def _on_gpu(context, loaded):
    import cupy

    with tempfile.TemporaryDirectory() as folder:
        module, built = kernels_of_device(cupy, context.inputs, Path(folder))
        card = cupy.cuda.runtime.getDeviceProperties(0)["name"].decode()
        yield Row("frames/build", {"kernels": built, "card": card, "cupy": cupy.__version__})
        for name, (data, asset) in loaded.items():
            frames = GpuFrames(cupy, module, asset, SIDE)
            ways = {"compute": {2: "", 1: "texels_kernel", 0: "voxels_kernel"}[asset.kind]}
            if asset.kind == NEURAL:
                check = _check_network(frames, data)
                yield Row(f"frames/{name.split('_')[0]}/3dntc/check", check)
                ways = {"tensor": "neural_tensor_kernel"} if check["tensor_cores_agree"] else {}
                ways["plain"] = "neural_plain_kernel"
            for zoom, wide in _zooms(data).items():
                for how, kernel in ways.items():
                    key = _key(name, zoom, how)
                    if context.wants(key) and context.left() > SECONDS_OF_ROW:
                        yield Row(key, _row(context, frames, data, (zoom, wide, key), kernel))


def kernels_of_device(cupy: Any, inputs: Path, scratch: Path) -> tuple[Any, str]:
    """As frames_build.kernels_of()."""
    from .frames_build import kernels_of

    return kernels_of(cupy, inputs, scratch)


def _check_network(frames, data):
    """How far both kernels of the network are from the normative evaluation at random points, in levels of 255."""
    cupy, positions = frames.cupy, frames.cupy.asarray(np.ascontiguousarray(data["points"], np.int32))
    count, out, answers = len(data["points"]), {}, {}
    for how in ("plain", "tensor"):
        answer = cupy.full((count, 3), np.nan, np.float32)
        frames._run(f"points_{how}_kernel", -(-count // 128), 128, frames.packed, positions, np.int32(count), answer)
        answers[how] = cupy.asnumpy(answer)
        error = np.abs(answers[how] - data["exact"])
        out |= {f"{how}_mean_error_of_255": float(error.mean()), f"{how}_worst_error_of_255": float(error.max())}
    agree = out["tensor_mean_error_of_255"] <= MOST_MEAN and out["tensor_worst_error_of_255"] <= MOST_ONE
    return out | {"points": count, "tensor_cores_agree": bool(agree),
                  "kernel": "tensor cores" if agree else "plain, as tensor cores are too far off"}


def _row(context, frames, data, picture_of, kernel):
    zoom, wide, key = picture_of
    repeats, scale = context.scaled(REPEATS, 3), frames.asset.voxels_per_radius
    steps, timer = frames.repeater(kernel)
    taken, pixels, overflowed, compared = [], [], False, {}
    for number, axes in enumerate(data["cameras"]):
        camera = camera_of(*axes, wide, SIDE, scale)
        frames.look(camera)
        frames.times(steps, 2)
        taken.append(frames.times(steps, repeats))
        strips, visible = (int(n) for n in frames.cupy.asnumpy(frames.counts))
        pixels.append(visible)
        overflowed |= strips > frames.ROOM
        if number == int(data["reference_view"]):
            picture = frames.picture()
            compared = _compared(picture, data, zoom)
            _keep_picture(context, key, picture)
    return {**_summary(np.array(taken)), "visible_pixels_mean": int(np.mean(pixels)), "visible_pixels_most": max(pixels),
            "side": SIDE, "views": len(pixels), "repeats": repeats, "timer": f"CUDA events, {timer}", **compared,
            "fineness": float(camera["fineness"][0]), "queue_overflowed": overflowed, **json.loads(str(data["facts"]))}


def _summary(taken):
    """Median and 95 % over views and repetitions of milliseconds float64 [views, repeats, 2]."""
    rows = taken.reshape(-1, 2)
    parts = {"visibility": rows[:, 0], "shading": rows[:, 1], "frame": rows.sum(axis=1)}
    out = {}
    for name, values in parts.items():
        out[f"{name}_ms_median"] = round(float(np.median(values)), 4)
        out[f"{name}_ms_95"] = round(float(np.percentile(values, 95)), 4)
    slowest = taken.sum(axis=2)
    return out | {"slowest_view_ms_median": round(float(np.median(slowest, axis=1).max()), 4)}
