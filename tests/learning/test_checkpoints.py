"""Trees of tensors on disk."""

from pathlib import Path

import pytest
import torch
from torch import nn
from torch.optim import SGD, Adam, Optimizer

from magical.errors import CheckpointError
from magical.learning.checkpoints import (
    load_checkpoint,
    load_module,
    load_optimizer,
    optimizer_state,
    save_checkpoint,
)


def test_state_dicts_are_read_as_they_were_written(tmp_path: Path) -> None:
    image = torch.rand(2, 3, 4, 5).to(memory_format=torch.channels_last)
    state = {
        "a": {"weights": image, "count": torch.tensor(3)},
        "list": [1, 2.5, None, True, torch.arange(4)],
        "rng": {"state": 2**127 + 1},
        "text": "x",
    }
    save_checkpoint(tmp_path / "c", state)
    back = load_checkpoint(tmp_path / "c")
    assert torch.equal(back["a"]["weights"], image)
    assert back["a"]["count"].shape == ()
    assert back["list"][:4] == [1, 2.5, None, True]
    assert torch.equal(back["list"][4], torch.arange(4))
    assert (back["rng"], back["text"]) == (state["rng"], "x")
    assert [file.name for file in tmp_path.iterdir()] == ["c"]


def test_missing_cut_and_foreign_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "c"
    with pytest.raises(CheckpointError, match="expected a file, found none"):
        load_checkpoint(path)
    save_checkpoint(path, {"a": torch.rand(50)})
    whole = path.read_bytes()
    for damaged in (whole[:-10], whole[:20], b"", b"\x80\x04K\x01.", whole[8:]):
        path.write_bytes(damaged)
        with pytest.raises(CheckpointError, match=r"c is damaged"):
            load_checkpoint(path)


def test_weights_of_another_network_are_refused() -> None:
    with pytest.raises(CheckpointError, match="run: the checkpoint is of another network"):
        load_module(nn.Linear(3, 2), nn.Linear(4, 2).state_dict(), "run")


@pytest.mark.parametrize("kind", ["sgd", "adam"])
def test_optimisers_continue_bit_for_bit(kind: str, tmp_path: Path) -> None:
    def made() -> tuple[nn.Module, Optimizer]:
        torch.manual_seed(0)
        net = nn.Conv2d(3, 4, 3)
        net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        if kind == "sgd":
            return net, SGD(net.parameters(), 0.1, 0.9, fused=True)
        return net, Adam(net.parameters(), 0.1, fused=True)

    def step(net: nn.Module, optimizer: Optimizer, number: int) -> None:
        images = torch.rand(2, 3, 8, 8, generator=torch.Generator().manual_seed(number))
        optimizer.zero_grad()
        net(images).square().mean().backward()
        optimizer.step()

    straight, optimizer = made()
    for number in range(6):
        step(straight, optimizer, number)
        if number == 2:
            state = {"net": straight.state_dict(), "optimizer": optimizer_state(optimizer)}
            save_checkpoint(tmp_path / "c", state)
    resumed, again = made()
    saved = load_checkpoint(tmp_path / "c")
    load_module(resumed, saved["net"], "c")
    load_optimizer(again, saved["optimizer"])
    for number in range(3, 6):
        step(resumed, again, number)
    for a, b in zip(straight.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b)
        kept = again.state[b].get("momentum_buffer", again.state[b].get("exp_avg"))
        assert kept.stride() == b.stride()
