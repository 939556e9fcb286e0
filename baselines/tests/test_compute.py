"""Device, precision and threads: the configuration and the processor decide, never the load."""

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import Linear, functional
from torch.optim import Adam

from magical.errors import DeviceError
from magical.evaluation import evaluate
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.compute import (
    Compute,
    Precision,
    ReplayedStep,
    choose_compute,
    choose_device,
    cpu_threads,
    has_bfloat16,
)
from magical_baselines.training import anneal, gradient_step


@pytest.mark.parametrize("ability", ["amx_bf16", "avx512_bf16"])
def test_a_processor_with_bfloat16_instructions_uses_them(
    ability: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    abilities = {"amx_bf16": False, "avx512_bf16": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: abilities)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX512")
    assert not has_bfloat16("cpu")
    assert choose_compute("cpu", "auto", 3) == Compute("cpu", "float32", 3)
    abilities[ability] = True
    assert choose_compute("cpu", "auto", 3) == Compute("cpu", "bfloat16", 3)
    assert choose_compute("cpu", "float32", 3) == Compute("cpu", "float32", 3)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_inputs_are_cast_as_autocast_would(precision: Precision) -> None:
    compute = Compute("cpu", precision)
    layer, images = torch.nn.Linear(16, 4), torch.rand(3, 16)
    cast = compute.cast(images)
    assert cast.dtype == getattr(torch, precision)
    with compute.autocast():
        assert torch.equal(layer(cast), layer(images))


def test_newer_instructions_that_are_switched_off_are_not_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"amx_bf16": True})
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX2")
    assert not has_bfloat16("cpu")


def test_threads_are_pytorchs_own_number_unless_given() -> None:
    with cpu_threads(0):
        torch.set_num_threads(2)
        assert choose_compute("cpu", "float32", 0).threads == 2
        assert choose_compute("cuda", "float32", 0).threads == 0


def keeps_denormals() -> bool:
    """Whether numbers below the smallest normal one are kept."""
    return bool((torch.full((64,), 2e-38) / 8.0).any())


@pytest.mark.skipif(not torch.set_flush_denormal(False), reason="the CPU always keeps denormals")
def test_denormals_are_flushed_in_training(demos: Path, tmp_path: Path) -> None:
    during: list[bool] = []
    config = BCConfig.preset(
        "quick", tasks=("MoveToCorner",), demos=str(demos), num_demos=2, network="light", batches=1
    )
    train(config, tmp_path, callback=lambda *_: during.append(keeps_denormals()))
    assert during == [False]
    assert keeps_denormals()


def float32_precisions() -> list[str]:
    """How a GPU computes with float32 in convolutions and in products of matrices."""
    cudnn: Any = torch.backends.cudnn
    return [cudnn.conv.fp32_precision, torch.backends.cuda.matmul.fp32_precision]


def test_float32_is_not_tensorfloat32_on_a_gpu(demos: Path, tmp_path: Path) -> None:
    config = BCConfig.preset(
        "paper", tasks=("MoveToCorner",), demos=str(demos), num_demos=2, network="light", batches=1
    )
    assert config.precision == "float32"
    before, during = float32_precisions(), []
    assert before[0] == "tf32"  # PyTorch's default for convolutions
    result = train(config, tmp_path, callback=lambda *_: during.extend(float32_precisions()))
    policy = result.policy()
    policy.network.register_forward_hook(lambda *_: during.extend(float32_precisions()))
    evaluate(policy, ["magical/MoveToCorner-Demo-v0"], rollouts=1, horizon=1, workers=0)
    assert set(during) == {"ieee"}
    assert float32_precisions() == before


def test_an_unknown_device_is_named() -> None:
    with pytest.raises(DeviceError, match="'gpu': expected one of auto, cpu, cuda"):
        choose_device("gpu")


def losses_of_steps(device: str, replayed: bool) -> list[float]:
    """The losses of steps with batches of two sizes and a falling learning rate."""
    torch.manual_seed(0)
    model = Linear(8, 1).to(device)
    optimizer = Adam(model.parameters(), 0.1, fused=True)

    def step(inputs: Tensor, targets: Tensor) -> dict[str, Tensor]:
        loss = functional.mse_loss(model(inputs), targets)
        gradient_step(optimizer, loss)
        return {"loss": loss}

    take = ReplayedStep(optimizer, replayed)
    batches = [torch.randn(size, 8) for size in (16, 16, 16, 4, 16, 16)]
    losses = []
    for number, batch in enumerate(batches):
        anneal(optimizer, number, len(batches))
        inputs = batch.to(device)
        losses.append(take(step, inputs, inputs[:, :1])["loss"].item())
    return losses


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_replayed_steps_do_what_steps_do() -> None:
    expected = losses_of_steps("cuda", replayed=False)
    assert losses_of_steps("cuda", replayed=True) == pytest.approx(expected, rel=1e-5)
    assert len(set(expected)) == len(expected)
