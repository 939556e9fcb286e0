"""Device, precision and threads: the configuration and the processor decide, never the load."""

from typing import Any

import pytest
import torch
from torch.nn import Linear, functional
from torch.optim import Adam

from magical.evaluation import evaluate
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.compute import Compute, ReplayedStep, choose_compute, has_bfloat16
from magical_baselines.training import anneal, gradient_step


@pytest.mark.parametrize("ability", ["amx_bf16", "avx512_bf16"])
def test_a_processor_with_bfloat16_instructions_uses_them(ability, monkeypatch):
    abilities = {"amx_bf16": False, "avx512_bf16": False}
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: abilities)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX512")
    assert not has_bfloat16("cpu")
    assert choose_compute("cpu", "auto", 3) == Compute("cpu", "float32", 3)
    abilities[ability] = True
    assert choose_compute("cpu", "auto", 3) == Compute("cpu", "bfloat16", 3)
    assert choose_compute("cpu", "float32", 3) == Compute("cpu", "float32", 3)


def float32_precisions():
    """How a GPU computes with float32 in convolutions and in products of matrices."""
    cudnn: Any = torch.backends.cudnn
    return [cudnn.conv.fp32_precision, torch.backends.cuda.matmul.fp32_precision]


def test_float32_is_not_tensorfloat32_on_a_gpu(demos, tmp_path):
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


def losses_of_steps(device, replayed):
    """The losses of steps with batches of two sizes and a falling learning rate."""
    torch.manual_seed(0)
    model = Linear(8, 1).to(device)
    optimizer = Adam(model.parameters(), 0.1, fused=True)

    def step(inputs, targets):
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
def test_replayed_steps_do_what_steps_do():
    expected = losses_of_steps("cuda", replayed=False)
    assert losses_of_steps("cuda", replayed=True) == pytest.approx(expected, rel=1e-5)
    assert len(set(expected)) == len(expected)
