"""Optimiser steps replayed as CUDA graphs."""

import pytest
import torch
from torch import Tensor
from torch.nn import Linear, functional
from torch.optim import Adam

from magical_baselines.running.optimizers import set_learning_rate
from magical_baselines.running.replay import ReplayedStep


def losses_of_steps(device: str, replayed: bool) -> list[float]:
    """The losses of steps with batches of two sizes and a falling learning rate."""
    torch.manual_seed(0)
    model = Linear(8, 1).to(device)
    optimizer = Adam(model.parameters(), fused=True)

    def step(inputs: Tensor, targets: Tensor) -> dict[str, Tensor]:
        loss = functional.mse_loss(model(inputs), targets)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        return {"loss": loss}

    take = ReplayedStep(optimizer, replayed)
    batches = [torch.randn(size, 8) for size in (16, 16, 16, 4, 16, 16)]
    losses = []
    for number, batch in enumerate(batches):
        set_learning_rate(optimizer, 0.1 / (1 + number))
        inputs = batch.to(device)
        losses.append(take(step, inputs, inputs[:, :1])["loss"].item())
    return losses


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_replayed_steps_do_what_steps_do() -> None:
    expected = losses_of_steps("cuda", replayed=False)
    assert losses_of_steps("cuda", replayed=True) == pytest.approx(expected, rel=1e-5)
    assert len(set(expected)) == len(expected)


def test_a_learning_rate_that_a_recorded_step_reads_changes_in_place() -> None:
    optimizer = Adam(Linear(2, 1).parameters(), rate := torch.tensor(0.1), fused=True)
    set_learning_rate(optimizer, 0.5)
    assert optimizer.param_groups[0]["lr"] is rate
    assert rate == 0.5
