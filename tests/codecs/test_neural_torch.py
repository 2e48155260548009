"""The fit's step in torch against the compiled one, on the processor: the same state has to move the same way."""

from dataclasses import replace

import numpy as np
import pytest
from plane_fits import plane_fit

from texfcodec import EncodeOptions
from texfcodec.codecs.neural import fit_payload, fit_torch
from texfcodec.codecs.neural.fit import Fit
from texfcodec.codecs.neural.fit_payload import _engine
from texfcodec.errors import InputError
from texfcodec.report import Report

HINT = "torch is not installed: pip install texfcodec[ntc]"


def torch_fit(**settings):
    pytest.importorskip("torch", reason=HINT)
    made = plane_fit(**settings)
    return fit_torch.TorchFit(made.design, made.tables, made.samples, made.held_out, made.seed, 1, device="cpu")


@pytest.mark.parametrize("uneven", [False, True])
def test_a_step_in_torch_is_the_compiled_step(uneven):
    torch, compiled = torch_fit(uneven=uneven), plane_fit(uneven=uneven)
    for _ in range(3):
        errors = [one._one_step(100, _Now()) for one in (torch, compiled)]
        assert errors[0] == pytest.approx(errors[1], rel=1e-3)
    torch.download()
    for mine, other in zip(torch.values + torch.squares, compiled.values + compiled.squares, strict=True):
        np.testing.assert_allclose(mine, other, rtol=2e-2, atol=2e-4)
    assert np.array_equal(torch.times, compiled.times) and (torch.codes != compiled.codes).mean() < 0.01


def test_torch_fits_as_well_and_its_payload_is_exact():
    torch, compiled = torch_fit(), plane_fit()
    payload = torch.run(300)
    compiled.run(300)
    assert torch.psnr() == pytest.approx(compiled.psnr(), abs=1.0)
    assert torch.psnr(exact=True) == pytest.approx(torch.psnr(), abs=0.05) and payload.codes.dtype == np.int8


def test_torch_goes_on_from_a_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr("texfcodec.codecs.neural.fit.SAVE_SECONDS", 0.0)
    whole, path = torch_fit().run(20), tmp_path / "fit.ckpt"

    def stop(fit, steps):
        if fit.step >= 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        torch_fit().run(20, stop, path)
    resumed = torch_fit().run(20, checkpoint=path)
    assert (whole.codes != resumed.codes).mean() < 0.01


def test_a_device_arranges_samples_and_answers_as_the_processor_does(monkeypatch):
    torch = pytest.importorskip("torch", reason=HINT)
    here = torch_fit(uneven=True)
    monkeypatch.setattr(fit_torch, "SORTING", ("cuda", "cpu"))
    there = torch_fit(uneven=True)
    for name in ("position", "target", "share"):
        assert torch.equal(getattr(here.state, name), getattr(there.state, name))
    around = [fit.state.corners[fit.state.cell.long()] for fit in (here, there)]
    assert torch.equal(*around) and there.batches == here.batches
    for fit in (here, there):
        fit.run(20)
    assert there.psnr() == pytest.approx(here.psnr(), abs=0.01)
    assert there.log[-1]["train_psnr"] == pytest.approx(here.log[-1]["train_psnr"], abs=0.01)


def test_too_little_memory_takes_smaller_batches_and_says_so(monkeypatch):
    torch = pytest.importorskip("torch", reason=HINT)
    arrange = fit_torch.TorchFit._arrange

    def small(fit, samples, batch):
        if batch > 1024:
            raise torch.OutOfMemoryError("CUDA out of memory")
        arrange(fit, samples, batch)

    monkeypatch.setattr(fit_torch.TorchFit, "_arrange", small)
    fit = torch_fit()
    assert fit.layout.batch == 1024
    assert fit.remarks == ["the GPU has too little memory for batches of 4096 samples; 2048 are taken",
                           "the GPU has too little memory for batches of 2048 samples; 1024 are taken"]


def test_a_gpu_that_fails_leaves_the_fit_to_the_processor(monkeypatch):
    pytest.importorskip("torch", reason=HINT)

    def broken(fit, steps):
        raise RuntimeError("no kernel image is available\nfor this device")

    monkeypatch.setattr(fit_torch.TorchFit, "warm", broken)
    made, report = plane_fit(), Report()
    fit = fit_payload._begun(EncodeOptions(codec="3dntc", fit_engine="torch"), report, made.design, made.tables, made.samples,
                             made.held_out, judged=[0, 1, 2])
    assert type(fit) is Fit
    assert report.remarks == ["the fit takes the processor, because the GPU failed: no kernel image is available"]


def test_fused_kernels_that_do_not_compile_leave_the_plain_step():
    fit = torch_fit()
    fit.asked_step = "fused"  # Triton compiles nothing without a GPU
    fit.warm(10)
    assert fit.engine is None and len(fit.remarks) == 1 and fit.remarks[0].startswith("plain torch steps are taken: ")


def test_programs_that_give_nan_are_halved_before_plain_steps_are_taken(monkeypatch):
    fit = torch_fit()
    fit.asked_step, fit.layout = "fused", replace(fit.layout, block=128)

    def fault(self):
        self.distances = [float("nan")]
        return "the fused kernels disagree with plain torch by nan" if self.layout.block > least else ""

    monkeypatch.setattr(fit_torch.TorchFit, "_fused_fault", fault)
    least = 64
    fit._choose()
    assert fit.layout.block == 64 and [remark.split(",")[0] for remark in fit.remarks] == ["programs of 64 samples are taken"]
    least, fit.checked, fit.remarks = 0, False, []
    fit._choose()
    assert fit.layout.block == 32 and fit.remarks[-1].startswith("plain torch steps are taken: ")


def test_samples_that_fill_no_program_are_left_out_evenly_along_the_surface():
    torch = pytest.importorskip("torch", reason=HINT)
    fit = torch_fit()
    fit.batches, whole, size = 7, 100, 96
    along = torch.arange(700).reshape(whole, 7).T.reshape(-1)  # places along the curve, as _arrange puts them into batches
    kept = fit._thinned(along, whole, size).reshape(7, size)
    left_out = sorted(set(range(700)) - set(kept.reshape(-1).tolist()))
    assert len(left_out) == 28 and max(np.diff(left_out)) <= 26
    assert all((np.diff(batch) > 0).all() and batch[-1] > 660 for batch in kept.numpy())


def test_without_torch_the_message_names_the_extra(monkeypatch):
    import builtins

    real = builtins.__import__

    def missing(name, *rest, **named):
        if name == "torch":
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    made = plane_fit()
    with pytest.raises(InputError, match=r"texfcodec\[ntc\]") as error:
        fit_torch.TorchFit(made.design, made.tables, made.samples, made.held_out)
    assert error.value.code == "TXF-I56"
    assert _engine(EncodeOptions(codec="3dntc")) is Fit


class _Now:
    """A pool of no threads."""

    map = staticmethod(lambda function, items: [function(i) for i in items])
