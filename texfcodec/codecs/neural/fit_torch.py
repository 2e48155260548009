"""The 3DNTC fit in torch, for CUDA: the batches and formulas of fit.Fit on the device (extra texfcodec[ntc]).

A step is the fused kernels of fit_triton.py, or plain torch if those do not suit the design, the torch version or the GPU. Both
are recorded as CUDA graphs, so that the host is idle between two calls of on_look. Seeds are those of Fit: one seed gives the
same samples, batches and first values, but payloads differ in their last bits from run to run, because atomic additions have no
order.

On two processor cores the fused kernels of train.py are several times faster (docs/design/neural.md), so this engine is used only
if torch detects a GPU, or on request.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import InputError
from .fit import BATCH, LATENT_RATE, NETWORK_RATE, WARMING, Fit
from .fit_layout import LEAST_BLOCK, Layout, block_of
from .fit_samples import Samples
from .infer import CODES, LOCAL_BITS, POSITION_BITS
from .train import MOMENTUM, SQUARE_DECAY, TINY

CUDA_BATCH = 1 << 16  # the most dB in as many steps and in as many seconds (docs/reports/gpu.md)
LEAST_BATCH = 1 << 10
SORTING = ("cuda",)  # devices that put samples in order and answer at held-out points themselves
RECORDED = 50  # steps of a graph
HALF_UNITS = (7, 0)  # compute capability from which there are 16-bit matrix units
GRADIENT_TOLERANCE, MOVE_TOLERANCE = 2e-2, 1e-3  # relative distance of the fused step from the plain one


def cuda_is_there() -> bool:
    """Return whether torch is installed and detects a GPU."""
    try:
        import torch
    except ImportError:
        return False
    return torch.cuda.is_available()


@dataclass
class State:
    """Tensors of a fit on the device. position int32 [S, 3], target, share uint8 [S, C], cell int32 [S, L], corners int32 [..,
    8]: the samples in batches; latent float32 [N, padded], row_square float32 [N], times int32 [N], codes int8 [N, padded]; net,
    mean, square float32 [P]: the network in the form of Layout; order int32 [T]: batch of each step; schedule float32 [T, 3]:
    decay of the rates and the two scales of Adam; errors float32 [T]; counter int32 [1]: next step; warming: as fit.WARMING."""

    position: Any
    target: Any
    share: Any
    cell: Any
    corners: Any
    warming: Any
    latent: Any = None
    row_square: Any = None
    times: Any = None
    codes: Any = None
    net: Any = None
    mean: Any = None
    square: Any = None
    order: Any = None
    schedule: Any = None
    errors: Any = None
    counter: Any = None

    MOVED = ("latent", "row_square", "times", "codes", "net", "mean", "square", "counter")

    def copy(self) -> dict[str, Any]:
        """Copies of the tensors that a step changes."""
        return {name: getattr(self, name).clone() for name in self.MOVED}

    def restore(self, kept: dict[str, Any]) -> None:
        """Set the tensors that a step changes back to the copies of copy()."""
        for name, value in kept.items():
            getattr(self, name).copy_(value)


class TorchFit(Fit):
    """Fit on a GPU, or by PyTorch on the processor. device: "cuda" or "cpu"; step: "auto", "fused" or "plain"; products:
    "float16", "tf32" or "float32" of the fused step, or "auto"; block: samples per program of the fused step, 0 to derive it from
    the batch. remarks: sentences on what could not be used. Raises InputError TXF-I56 if torch is not installed."""

    def __init__(self, *arguments: Any, device: str | None = None, step: str = "auto", products: str = "auto",
                 batch: int | None = None, block: int = 0, **named: Any) -> None:
        try:
            import torch
        except ImportError:
            raise InputError("TXF-I56", "fitting with torch needs the optional extra: pip install texfcodec[ntc]") from None
        self.torch: Any = torch
        self.state: Any = None  # a State
        self.engine: Any = None  # a fit_triton.FusedStep, where that is taken
        self.graph: Any = None
        self.planned: int | None = None
        self.asked_block = block
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.remarks: list[str] = []
        self.asked_step = step if step != "auto" else ("fused" if self.device.type == "cuda" else "plain")
        self.products = _products(torch, self.device, self.remarks) if products == "auto" else products
        named["batch"] = batch or (CUDA_BATCH if self.device.type == "cuda" else BATCH)
        while True:
            try:
                super().__init__(*arguments, **named)
                self._take_memory()
                return
            except _no_memory(torch):
                size = named["batch"]
                if size <= LEAST_BATCH:
                    raise
                self.remarks.append(f"the GPU has too little memory for batches of {size} samples; {size // 2} are taken")
                named["batch"] = size // 2
            self.state, self.engine = None, None
            torch.cuda.empty_cache()

    def _take_memory(self):
        """Allocates at once the memory of the largest step."""
        if self.device.type == "cuda":
            with self.torch.no_grad():
                self._plan(1)
                self._plain_gradients()

    def _on(self, array):
        if self.torch.is_tensor(array):
            return array.to(self.device)
        return self.torch.as_tensor(np.ascontiguousarray(array), device=self.device)

    def _arrange(self, samples, batch):
        """Arrange as Fit._arrange does, on the GPU if there is one."""
        if self.device.type not in SORTING:
            super()._arrange(samples, batch)
            s = self.samples
            self.arranged = tuple(self._on(a) for a in (s.position, s.target, s.share, self.cell))
            return
        from .fit_arrange import cells_on, order_on

        position = self._on(samples.position)
        order = order_on(position)
        self.batches = max(1, len(order) // batch)
        order = order[: len(order) // self.batches * self.batches].reshape(-1, self.batches).T.reshape(-1)
        self.samples = samples  # in any order: what is fitted stands on the device
        in_order = lambda array: self._on(array).index_select(0, order)
        position = position.index_select(0, order)
        cell, self.corners = cells_on(position, in_order(samples.field), self.tables)
        self.cell = cell
        self.arranged = position, in_order(samples.target), in_order(samples.share), cell

    def _start(self):
        whole = len(self.arranged[0]) // self.batches
        block = self.asked_block or block_of(whole)
        size = whole // block * block or whole if self.asked_step == "fused" else whole  # whole programs
        self.layout = Layout.of(self.design, size, self.asked_block)
        self.weight_places, self.bias_places = self.layout.places()
        position, target, share, cell = (self._thinned(tensor, whole, size) for tensor in self.arranged)
        self.arranged = ()
        self.state = State(position, target, share, cell, self._on(self.corners), self._on(WARMING))
        self.held_state = [self._on(a) for a in (self.held_out.position, *self.held_cells)]
        self.engine, self.graph, self.planned, self.checked = None, None, None, False
        super()._start()

    def _thinned(self, tensor, whole, size):
        """Selects `size` rows of each batch of `whole`. The omitted rows are spread evenly along the curve of the samples,
        because a part of the surface without samples would never be fitted."""
        rows = self.batches * size
        if size == whole:
            return tensor.reshape(rows, -1)
        along = self.torch.arange(rows, device=tensor.device) * whole // size
        places = (along % self.batches * whole + along // self.batches).reshape(size, self.batches).T.reshape(-1)
        return tensor.reshape(self.batches * whole, -1).index_select(0, places)

    def upload(self) -> None:
        """Copies the state from the arrays to the device."""
        super().upload()
        s, net = self.state, lambda weight, bias: self._on(self._to_net(weight, bias))
        fresh = {"latent": self._on(self.values[0].copy()), "row_square": self._on(self.squares[0].copy()),
                 "times": self._on(self.times.copy()), "codes": self._on(self.codes.copy()), "net": net(*self.values[1:]),
                 "mean": net(*self.means), "square": net(*self.squares[1:])}
        for name, value in fresh.items():
            if getattr(s, name) is None:
                setattr(s, name, value)
            else:  # graphs keep the places of tensors
                getattr(s, name).copy_(value)

    def download(self) -> None:
        """Copies the state from the device to the arrays."""
        s, back = self.state, lambda tensor: tensor.detach().cpu().numpy()
        self.values[0][...], self.squares[0][...], self.times[...] = back(s.latent), back(s.row_square), back(s.times)
        self.codes[...] = back(s.codes)
        for tensor, (weight, bias) in ((s.net, self.values[1:]), (s.mean, self.means), (s.square, self.squares[1:])):
            flat = back(tensor)
            for array, places in ((weight, self.weight_places), (bias, self.bias_places)):
                array[...] = np.where(places >= 0, flat[np.maximum(places, 0)], 0)

    def _to_net(self, weight, bias):
        flat = np.zeros(self.layout.size, np.float32)
        for array, places in ((weight, self.weight_places), (bias, self.bias_places)):
            flat[places[places >= 0]] = array[places >= 0]
        return flat

    # What a step is.

    def _inputs(self, position, cell, corners, read):
        """Network inputs float32 [M, inputs] of Layout. position: int32 [M, 3]; cell: int32 [M, L]; read: float32 [N, features],
        latents as a decoder reads them."""
        torch, lay, parts = self.torch, self.layout, []
        position = position.long()
        q = torch.arange(8, device=self.device)
        for level, resolution in enumerate(lay.resolutions):
            local = ((position * resolution) >> (POSITION_BITS - LOCAL_BITS)) - (1 << (LOCAL_BITS - 1))
            part = (local & ((1 << LOCAL_BITS) - 1)).float() / (1 << LOCAL_BITS)
            corner, weight = corners[cell[:, level].long()].long(), 1.0
            for axis in range(3):
                along = part[:, axis, None]
                weight = weight * torch.where((q >> axis & 1) > 0, along, 1 - along)
            weight = weight * (corner >= 0)
            total = weight.sum(1, keepdim=True)
            weight = torch.where(total > 0, weight / total.clamp(min=1e-12), weight)
            near = read.index_select(0, corner.clamp(min=0).reshape(-1)).reshape(len(position), 8, -1)
            parts.append(self._padded((weight[:, :, None] * near).sum(1), lay.feature_block))
        waves = []
        for octave in range(lay.octaves):
            phase = (position * (lay.first_wave << octave)) >> (POSITION_BITS + 1 - 16)
            both = torch.stack((phase, phase + 16384), 2).reshape(len(position), 6)
            waves.append(((both & 65535) - 32768).abs().float() / 16384 - 1)
        waves = torch.cat(waves, 1) if waves else torch.zeros((len(position), 0), device=self.device)
        return torch.cat((*parts, self._padded(waves, lay.wave_block)), 1)

    def _padded(self, x, width):
        return self.torch.nn.functional.pad(x, (0, width - x.shape[1]))

    def _outputs(self, x, net):
        torch, lay = self.torch, self.layout
        for n, (i, o) in enumerate(zip(lay.inputs, lay.outputs, strict=True)):
            weight = net[lay.weights[n] : lay.weights[n] + i * o].view(o, i)
            x = torch.addmm(net[lay.biases[n] : lay.biases[n] + o], x, weight.T)
            if n + 1 < len(lay.outputs):
                inner = x.clamp(-1.5, 1.5)
                x = torch.where(x > 1.5, x, inner * (inner + 1.5) / 3)
        return x[:, : lay.components]

    def _plain_gradients(self):
        """(gradients of latents and network, error and weight of the batch that the counter selects) by autograd."""
        torch, s, size = self.torch, self.state, self.layout.batch
        rows = s.order[s.counter.long()].long() * size + torch.arange(size, device=self.device)
        position, target, share, cell = (t.index_select(0, rows) for t in (s.position, s.target, s.share, s.cell))
        with torch.enable_grad():
            net = s.net.detach().requires_grad_()
            # rounded to what a decoder reads, with the gradient of what was not
            read = (s.codes[:, : self.layout.features].float() / CODES).requires_grad_()
            got = self._outputs(self._inputs(position, cell, s.corners, read), net)
            share = share.float() / 255
            error = (share * (got - (target.float() / 127.5 - 1)) ** 2).sum()
            latent, network = torch.autograd.grad(error / 2, (read, net))
        return self._padded(latent, self.layout.padded), network, error.detach(), share.sum()

    def _plain_move(self, latent, network, error, weight):
        """Moves all parameters against their gradient, as Fit.move."""
        torch, s, step = self.torch, self.state, self.state.counter.long()
        decay, mean_scale, square_scale = s.schedule.index_select(0, step).unbind(1)
        power = (latent**2).sum(1)
        touched = power > 0
        s.times += touched
        running = SQUARE_DECAY * s.row_square + (1 - SQUARE_DECAY) * power / self.layout.features
        s.row_square.copy_(torch.where(touched, running, s.row_square))
        warm = s.warming[s.times.clamp(max=len(s.warming) - 1).long()]
        warm = torch.where(s.times < len(s.warming), warm, torch.ones_like(warm))
        size = LATENT_RATE * decay / (torch.sqrt(s.row_square * warm) + TINY)
        moved = (s.latent - size[:, None] * latent).clamp(-1 + 1e-4, 1 - 1e-4)
        s.latent.copy_(torch.where(touched[:, None], moved, s.latent))
        f = self.layout.features
        s.codes[:, :f] = (2 * torch.floor(s.latent[:, :f] * (CODES // 2)) + 1).to(torch.int8)
        s.mean.mul_(MOMENTUM).add_(network, alpha=1 - MOMENTUM)
        s.square.mul_(SQUARE_DECAY).addcmul_(network, network, value=1 - SQUARE_DECAY)
        s.net -= NETWORK_RATE * decay * mean_scale * s.mean / (torch.sqrt(s.square * square_scale) + TINY)
        s.errors.index_copy_(0, step, (error / weight.clamp(min=TINY) * 127.5**2).reshape(1))
        s.counter += 1

    def _launch(self):
        """Launches one step on the device."""
        if self.engine is not None:
            self.engine.gradients()
            self.engine.move(LATENT_RATE, NETWORK_RATE)
        else:
            self._plain_move(*self._plain_gradients())

    # How many steps go.

    def _plan(self, steps):
        """Copies the order of batches and the schedule of the rates to the device."""
        if self.planned == steps:
            return
        epochs = -(-steps // self.batches)
        order = np.concatenate([self._epoch(epoch) for epoch in range(epochs)])[:steps].astype(np.int32)
        n = np.arange(steps, dtype=np.float64)
        schedule = np.stack([0.5 * (1 + np.cos(np.pi * n / steps)), 1 / (1 - MOMENTUM ** (n + 1)),
                             1 / (1 - SQUARE_DECAY ** (n + 1))], axis=1).astype(np.float32)
        s = self.state
        s.order, s.schedule, s.errors = self._on(order), self._on(schedule), self._on(np.zeros(steps, np.float32))
        s.counter = self._on(np.full(1, self.step, np.int32))
        self.planned, self.graph = steps, None

    def _choose(self):
        """Selects the fused step if it is wanted, compiles, and agrees with the plain step."""
        if self.checked:
            return
        self.checked = True
        if self.asked_step != "fused":
            return
        while reason := self._fused_fault():
            self.engine, block = None, self.layout.block
            if not self.distances or block <= LEAST_BLOCK:
                self.remarks.append(f"plain torch steps are taken: {reason}")
                return
            self.remarks.append(f"programs of {block // 2} samples are taken, since with {block} {reason}")
            self.layout = replace(self.layout, block=block // 2)  # it runs and is wrong, which can lie in what was compiled

    def _fused_fault(self):
        """Builds the fused step and compares it with the plain step. Returns a sentence if it cannot be used, else "". The state
        does not change."""
        torch, kept, self.distances = self.torch, None, []
        try:
            from .fit_triton import FusedStep, suits

            if reason := suits(self.layout, self.layout.components):
                return reason
            kept = self.state.copy()
            plain = self._plain_gradients()
            self.engine = FusedStep(self.state, self.layout, self.products)
            self.engine.gradients()
            fused = self.engine.gradient.clone(), self.engine.partial.sum(0), self.engine.sums[:, 0].sum(), plain[3]
            self.distances = [_distance(a, b) for a, b in zip(fused[:3], plain[:3], strict=True)]
            self.engine.move(LATENT_RATE, NETWORK_RATE)
            moved = self.state.copy()
            self.state.restore(kept)
            self._plain_move(*fused)
            self.distances += [_distance(moved[n].float(), getattr(self.state, n).float()) for n in ("latent", "net", "codes")]
            limits = [GRADIENT_TOLERANCE] * 3 + [MOVE_TOLERANCE] * 2 + [GRADIENT_TOLERANCE]
            if not all(d < limit for d, limit in zip(self.distances, limits, strict=True)):
                faulty = [int((~torch.isfinite(latent)).sum()) for latent in (fused[0], plain[0])]
                return ("the fused kernels disagree with plain torch by " + ", ".join(f"{d:.1e}" for d in self.distances)
                        + f"; not finite: {faulty[0]} and {faulty[1]} of the latents' gradients")
            return ""
        except _no_memory(torch):
            raise
        except Exception as error:  # a compiler's own kinds, of which there are many; the plain step does the same work
            return f"the fused kernels do not run here ({type(error).__name__}: {str(error)[:200]!r})"
        finally:
            if kept is not None:
                self.state.restore(kept)
                if self.engine is not None:
                    self.engine.gradient.zero_()

    def _record(self):
        """A CUDA graph of RECORDED steps; None if none can be recorded."""
        torch, kept = self.torch, self.state.copy()
        errors = self.state.errors.clone()
        try:
            beside = torch.cuda.Stream()
            beside.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(beside):  # whatever is made at the first call is made here
                self._launch()
            torch.cuda.current_stream().wait_stream(beside)
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph):
                for _ in range(RECORDED):
                    self._launch()
        except RuntimeError as error:
            self.remarks.append(f"steps are launched one by one, since no graph could be recorded: {str(error).splitlines()[0]}")
            graph = None
        self.state.restore(kept)
        self.state.errors.copy_(errors)
        return graph

    def warm(self, steps: int) -> None:
        """Compile, check and record the training step, which run(steps) would otherwise do at its first step."""
        with self.torch.no_grad():
            self._plan(steps)
            self._choose()
            if self.device.type == "cuda" and self.graph is None and steps > RECORDED:
                self.graph = self._record() or ()

    def _take_steps(self, until, steps, pool):
        """Take steps as Fit._take_steps does, on the device; the host waits once, at the end."""
        self.warm(steps)
        with self.torch.no_grad():
            s, begin = self.state, self.step
            s.counter.fill_(begin)
            while self.step < until:
                if self.graph and until - self.step >= RECORDED:
                    self.graph.replay()
                    self.step += RECORDED
                else:
                    self._launch()
                    self.step += 1
            return s.errors[begin:until].cpu().numpy().tolist()

    def _one_step(self, steps, pool):
        """See Fit._one_step."""
        return self._take_steps(self.step + 1, steps, pool)[0]

    def answers(self, samples: Samples, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the network's outputs at samples as Fit.answers does, computed on the device if these are the held-out
        points."""
        if samples is not self.held_out or self.device.type not in SORTING:
            return super().answers(samples, cells)
        with self.torch.no_grad():
            read = self.state.codes[:, : self.layout.features].float() / CODES
            position, cell, corners = self.held_state
            got = [self._outputs(self._inputs(*part, corners, read), self.state.net)
                   for part in zip(position.split(1 << 16), cell.split(1 << 16), strict=True)]
            return ((self.torch.cat(got) + 1) * 127.5).cpu().numpy()


def _no_memory(torch):
    """The exception class of a GPU without free memory, which older versions of torch define elsewhere."""
    return getattr(torch, "OutOfMemoryError", torch.cuda.OutOfMemoryError)


def _products(torch, device, remarks):
    """Number format of products, by the GPU's matrix units."""
    if device.type != "cuda":
        return "float32"
    capability = torch.cuda.get_device_capability(device)
    if capability >= HALF_UNITS:
        return "float16"
    remarks.append("the GPU has no 16-bit matrix units; products are taken in float32")
    return "float32"


def _distance(value, other):
    """Relative distance: norm of the difference over the norm of other."""
    value, other = value.double(), other.double()
    return float((value - other).norm() / other.norm().clamp(min=1e-30))
