"""The 3DNTC fit's step in torch, for CUDA: the same state, batches and formulas as fit.Fit, on the device (extra texfcodec[ntc]).

On two processor cores the fused kernels of train.py are several times faster (docs/design/neural.md), so this is taken only where
torch sees a GPU, or where it is asked for.
"""

from typing import Any

import numpy as np

from ...errors import InputError
from .fit import LATENT_RATE, NETWORK_RATE, Fit
from .infer import CODES, LOCAL_BITS, POSITION_BITS
from .train import MOMENTUM, SQUARE_DECAY, TINY

CUDA_BATCH = 1 << 16  # the paper's; a step of fewer samples would not fill a GPU


def cuda_is_there() -> bool:
    """Whether torch is installed and sees a GPU."""
    try:
        import torch
    except ImportError:
        return False
    return torch.cuda.is_available()


class TorchFit(Fit):
    """As Fit; device: "cuda" or "cpu". Raises InputError TXF-I56 where torch is not installed."""

    def __init__(self, *arguments: Any, device: str | None = None, **named: Any) -> None:
        try:
            import torch
        except ImportError:
            raise InputError("TXF-I56", "fitting with torch needs the optional extra: pip install texfcodec[ntc]") from None
        self.torch = torch
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        if self.device.type == "cuda":
            named.setdefault("batch", CUDA_BATCH)
        super().__init__(*arguments, **named)

    def _start(self):
        super()._start()
        on = lambda array: self.torch.as_tensor(np.ascontiguousarray(array), device=self.device)
        s = self.samples
        self.data = [on(a) for a in (s.position.astype(np.int64), s.target, s.share, self.cell.astype(np.int64))]
        self.rows = on(self.corners.astype(np.int64))
        self.upload()

    def upload(self) -> None:
        """Takes the state of the arrays to the device."""
        super().upload()
        on = lambda array: self.torch.as_tensor(np.array(array), device=self.device)
        self.state = [[on(a) for a in kind] for kind in (self.values, self.means, self.squares)] + [on(self.times)]
        for value in self.state[0]:
            value.requires_grad_()

    def download(self) -> None:
        """Brings the state back into the arrays."""
        for kind, arrays in zip(self.state[:3], (self.values, self.means, self.squares), strict=True):
            for tensor, array in zip(kind, arrays, strict=True):
                array[...] = tensor.detach().cpu().numpy()
        self.times[...] = self.state[3].cpu().numpy()
        super().upload()

    def _inputs(self, position, cell, latent):
        """Network inputs float32 [M, inputs] from positions int64 [M, 3], rows of corners int64 [M, L] and latents."""
        torch, parts = self.torch, []
        codes = torch.floor(latent * (CODES // 2))
        read = latent + ((codes + 0.5) / (CODES // 2) - latent).detach()  # rounded, with the gradient of what was not
        for level, resolution in enumerate(self.resolutions.tolist()):
            local = ((position * resolution) >> (POSITION_BITS - LOCAL_BITS)) - (1 << (LOCAL_BITS - 1))
            fraction = (local & ((1 << LOCAL_BITS) - 1)).float() / (1 << LOCAL_BITS)
            corner, weight = self.rows[cell[:, level]], torch.ones(len(position), 8, device=self.device)
            for q in range(8):
                for axis in range(3):
                    weight[:, q] *= fraction[:, axis] if q >> axis & 1 else 1 - fraction[:, axis]
            weight = weight * (corner >= 0)
            total = weight.sum(1, keepdim=True)
            weight = torch.where(total > 0, weight / total.clamp(min=1e-12), weight)
            parts.append((weight[:, :, None] * read[corner.clamp(min=0), : self.design.features]).sum(1))
        waves = []
        for octave in range(self.design.octaves):
            for axis in range(3):
                phase = (position[:, axis] * (self.design.first_wave << octave)) >> 9
                waves += [((p & 65535) - 32768).abs().float() / 16384 - 1 for p in (phase, phase + 16384)]
        inputs = torch.cat(parts + ([torch.stack(waves, 1)] if waves else []), 1)
        return torch.nn.functional.pad(inputs, (0, int(self.widths[0]) - inputs.shape[1]))

    def _outputs(self, x):
        torch, (_, weight, bias) = self.torch, self.state[0]
        for n, (i, o) in enumerate(zip(self.widths[:-1], self.widths[1:], strict=True)):
            x = x @ weight[n, :o, :i].T + bias[n, :o]
            if n + 2 < len(self.widths):
                inner = x.clamp(-1.5, 1.5)
                x = torch.where(x > 1.5, x, inner * (inner + 1.5) / 3)
        return x[:, : self.design.components]

    def _one_step(self, steps, pool):
        """As Fit._one_step, on the device."""
        torch, (begin, end) = self.torch, self._batch()
        position, target, share, cell = (d[begin:end] for d in self.data)
        values, means, squares, times = self.state
        got = self._outputs(self._inputs(position, cell, values[0]))
        error = (share.float() / 255 * (got - (target.float() / 127.5 - 1)) ** 2).sum()
        latent, *network = torch.autograd.grad(error / 2, values)
        decay = self._decay(steps)
        self.step += 1
        with torch.no_grad():
            power = (latent**2).sum(1) / self.design.features
            touched = power > 0
            times += touched
            running = SQUARE_DECAY * squares[0] + (1 - SQUARE_DECAY) * power
            squares[0] = torch.where(touched, running, squares[0])
            scale = torch.sqrt(squares[0] / (1 - SQUARE_DECAY ** times.float().clamp(min=1))) + TINY
            values[0] -= (touched * LATENT_RATE * decay / scale)[:, None] * latent
            values[0].clamp_(-1 + 1e-4, 1 - 1e-4)
            for n, g in enumerate(network):
                means[n] = MOMENTUM * means[n] + (1 - MOMENTUM) * g
                squares[n + 1] = SQUARE_DECAY * squares[n + 1] + (1 - SQUARE_DECAY) * g * g
                size = torch.sqrt(squares[n + 1] / (1 - SQUARE_DECAY**self.step)) + TINY
                values[n + 1] -= NETWORK_RATE * decay / (1 - MOMENTUM**self.step) * means[n] / size
        return float(error.detach() / (share.sum() / 255).clamp(min=TINY)) * 127.5**2
