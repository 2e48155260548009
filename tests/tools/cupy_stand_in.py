"""What tools/gpu/frames.py uses of CuPy, over numpy: kernels that shade draw by the host's functions, others do nothing."""

import ctypes
from types import ModuleType, SimpleNamespace

import numpy as np

KINDS = {"voxels_kernel": 0, "texels_kernel": 1, "neural_plain_kernel": 2, "neural_tensor_kernel": 2}
VISIBLE = 1  # where counts has visible pixels


class Array(np.ndarray):
    """An array whose `data.ptr` is its address. drawn: of an image, what stands in it."""

    drawn = ""

    @property
    def data(self):
        return SimpleNamespace(ptr=self.ctypes.data)


class Stream:
    """Counts graphs, and refuses what a capture may not hold: nothing, here."""

    def __init__(self, non_blocking=False):
        self.steps = None

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def begin_capture(self):
        self.steps = RUNNING.captured = []

    def end_capture(self):
        steps, RUNNING.captured = self.steps, None
        return SimpleNamespace(launch=lambda stream: [step() for step in steps])

    def synchronize(self):
        pass


class Event:
    """A moment, counted."""

    count = 0

    def record(self, stream):
        Event.count += 1
        self.at = Event.count


RUNNING = SimpleNamespace(captured=None)


def stand_in(host, spoilt=""):
    """A module `cupy` that draws with a HostFrames. spoilt: name of a kernel that does nothing."""
    cupy = ModuleType("cupy")
    cupy.__version__ = "0"
    cupy.asarray = lambda array: np.array(array).view(Array)
    cupy.zeros, cupy.empty = (lambda shape, dtype: np.zeros(shape, dtype).view(Array),) * 2
    cupy.full = lambda shape, value, dtype: np.full(shape, value, dtype).view(Array)
    cupy.asnumpy = lambda array: np.array(array)
    device = SimpleNamespace(synchronize=lambda: None)
    cupy.cuda = SimpleNamespace(
        Stream=Stream, Event=Event, Device=lambda: device, get_elapsed_time=lambda a, b: float(b.at - a.at),
        runtime=SimpleNamespace(getDeviceProperties=lambda number: {"name": b"none", "multiProcessorCount": 2}))
    cupy.RawModule = lambda **given: SimpleNamespace(get_function=lambda name: _kernel(host, name, spoilt))
    return cupy


def _kernel(host, name, spoilt):
    def launch(grid, block, given):
        assert all(isinstance(n, int) and n > 0 for n in (*grid, *block)), (name, grid, block)
        assert all(isinstance(g, Array | np.int32 | np.uint32 | np.int64) for g in given), name
        step = _work(host, name, given) if name != spoilt else lambda: None
        if RUNNING.captured is None:
            step()
        else:
            RUNNING.captured.append(step)

    return launch


def _work(host, name, given):
    pointers = [ctypes.c_void_p(g.ctypes.data) for g in given if isinstance(g, Array)]
    if name in KINDS:
        packed, camera, _, _, _, counts, image = given

        def draw():
            view = name + camera.tobytes().hex()
            if image.drawn == view:
                return
            image.drawn = view
            host._library.host_frame(*(pointers[i] for i in (0, 1, 2, 3, 6)), KINDS[name])
            counts[VISIBLE] = np.count_nonzero(image >> 24)

        return draw
    if name.startswith("points_"):
        return lambda: host._library.host_points(pointers[0], pointers[1], int(given[2]), pointers[2])
    return lambda: None
