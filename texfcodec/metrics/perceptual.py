"""LPIPS (Zhang et al. 2018) over AlexNet: the distance of two images in the features of a network.

The package lpips contains its linear layers but not the backbone, whose weights come from a file that the user names: the state
dict that torchvision publishes for AlexNet. Nothing is ever downloaded.
"""

import pickle
import warnings
from os import PathLike

import numpy as np

from ..errors import InputError

EXTRA = "pip install texfcodec[lpips]"


class Lpips:
    """Function of two images: their LPIPS distance, 0 for equal images.

    An image is uint8 or float [H, W, 3] in 0..255, at least 64 x 64.

    Parameters
    ----------
    weights : str
        Path of the AlexNet state dict (.pth).

    Raises
    ------
    InputError
        TXF-I96 to TXF-I98.
    """

    def __init__(self, weights: str | PathLike) -> None:
        self._torch, lpips = _packages()
        state = _read_state(self._torch, weights)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # lpips 0.1.4 calls torchvision in a way that it deprecates
            self._net = lpips.LPIPS(net="alex", pnet_rand=True, verbose=False).eval()  # pnet_rand: no download of the backbone
        _fill_backbone(self._torch, self._net.net, state, weights)

    def __call__(self, a, b):
        with self._torch.inference_mode():
            return float(self._net(self._tensor(a), self._tensor(b)))

    def _tensor(self, image):
        image = np.asarray(image)
        if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 64:
            raise ValueError(f"LPIPS compares images [H, W, 3] of at least 64 x 64, not {list(image.shape)}")
        planes = np.ascontiguousarray(np.moveaxis(image, 2, 0)[None], np.float32)
        return self._torch.from_numpy(planes / 127.5 - 1.0)


def _packages():
    try:
        import lpips
        import torch
    except ImportError as error:
        raise InputError("TXF-I96", f"LPIPS requires an optional extra: run {EXTRA}", reason=str(error)) from None
    return torch, lpips


def _read_state(torch, weights):
    """The dict of tensors in the file, read as data only: no code in it runs."""
    try:
        state = torch.load(weights, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError("TXF-I97", "the file of AlexNet weights does not exist", path=str(weights)) from None
    except OSError as error:
        raise InputError("TXF-I97", "the file of AlexNet weights cannot be read", path=str(weights), reason=str(error)) from None
    except (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, KeyError) as error:
        reason = str(error).partition("\n")[0][:200]
        raise InputError("TXF-I98", "the file is not a state dict of torch", path=str(weights), reason=reason) from None
    if not isinstance(state, dict):
        raise InputError("TXF-I98", "the file is not a state dict of torch", path=str(weights), value=type(state).__name__)
    return state


def _fill_backbone(torch, backbone, state, weights):
    """Copies features.N.weight and .bias into the layers; lpips names each layer by its N inside a slice."""
    for piece in backbone.children():
        for number, layer in piece.named_children():
            for name, parameter in layer.named_parameters():
                key = f"features.{number}.{name}"
                given = state.get(key)
                shape = list(given.shape) if isinstance(given, torch.Tensor) else "missing"
                if shape != list(parameter.shape):
                    raise InputError("TXF-I98", f"{key} of the weights differs from torchvision's AlexNet", path=str(weights),
                                     value=shape, allowed=list(parameter.shape))
                with torch.no_grad():
                    parameter.copy_(given)
