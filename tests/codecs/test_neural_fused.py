"""The fused GPU step in Triton's interpreter against the kernels for processors: the same state has to move the same way."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plane_fits import SIDE, plane_fit, square_keys

from texfcodec.codecs.neural.fit import Fit
from texfcodec.codecs.neural.fit_layout import Layout
from texfcodec.codecs.neural.payload import Level, Payload, Tables

STEPS = 3
CASES = {"two levels": (2, 8, 2, 3), "one level, no waves, alpha": (1, 24, 0, 4)}  # levels, features, octaves, components


def fits(case, batch=64, **settings):
    """(Fit, arguments of its kind) over a square."""
    levels, features, octaves, components = CASES[case]
    made, keys = plane_fit(count=2 * batch, components=components, uneven=True), square_keys()
    grids = (Level(SIDE, 0, 0, (len(keys),)), Level(3 * SIDE, 8, 0))[:levels]
    design = Payload(features, octaves, 2 * SIDE, (12, 8, 8), grids, components)
    tables = [Tables(design, 0, [keys, None][:levels])]
    return Fit(design, tables, made.samples, made.held_out, 3, 1, batch=batch, **settings)


def main():
    """What the interpreter's process does: the same steps by both, and how far they are apart."""
    from texfcodec.codecs.neural.fit_torch import TorchFit

    batch = int(sys.argv[3])
    compiled = fits(sys.argv[1], batch)
    fused = TorchFit(compiled.design, compiled.tables, plane_fit(count=2 * batch, components=compiled.design.components,
                                                                 uneven=True).samples,
                     compiled.held_out, 3, 1, batch=batch, device="cpu", step="fused", products=sys.argv[2], block=batch // 2)
    pool = _Now()
    errors = [fit._take_steps(STEPS, 100, pool) for fit in (compiled, fused)]
    fused.download()
    pairs = zip(compiled.values + compiled.squares + compiled.means, fused.values + fused.squares + fused.means, strict=True)
    far = [float(np.linalg.norm(a - b) / max(np.linalg.norm(a), 1e-9)) for a, b in pairs]
    print(json.dumps({"remarks": fused.remarks, "errors": np.array(errors).tolist(), "far": far, "gradients": fused.distances[:3],
                      "times": int((compiled.times != fused.times).sum())}))


@pytest.mark.long
@pytest.mark.parametrize("case, products, batch, gradients, moved", [
    ("two levels", "float32", 64, 1e-5, 1e-4), ("one level, no waves, alpha", "float32", 64, 1e-5, 1e-4),
    ("two levels", "float16", 64, 3e-3, 0.1), ("two levels", "float16", 256, 3e-3, 0.1)])
def test_the_fused_step_is_the_compiled_step_in_programs_of_32_to_128_samples(case, products, batch, gradients, moved):
    pytest.importorskip("torch", reason="torch is not installed: pip install texfcodec[ntc]")
    pytest.importorskip("triton", reason="triton is not installed; it comes with torch for CUDA")
    tests = Path(__file__).parents[1]
    path = os.pathsep.join([str(tests), *sys.path])
    environment = os.environ | {"TRITON_INTERPRET": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": path}
    done = subprocess.run([sys.executable, __file__, case, products, str(batch)], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    assert got["remarks"] == [] and got["times"] == 0
    assert max(got["gradients"]) < gradients and max(got["far"]) < moved
    np.testing.assert_allclose(*got["errors"], rtol=1e-3)


@pytest.mark.parametrize("case", CASES)
def test_a_layout_has_a_place_of_its_own_for_every_parameter(case):
    design = fits(case).design
    layout = Layout.of(design, 64)
    weight, bias = layout.places()
    used = np.concatenate([weight[weight >= 0], bias[bias >= 0]])
    assert len(used) == len(np.unique(used)) == design.parameters and used.max() < layout.size


class _Now:
    """A pool of no threads."""

    map = staticmethod(lambda function, items: [function(i) for i in items])


if __name__ == "__main__":
    main()
