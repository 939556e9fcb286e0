"""State dicts on disk."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis.strategies import binary, data, integers, lists
from safetensors import safe_open
from torch import nn
from torch.optim import SGD, Adam, Optimizer

from magical.errors import CheckpointError
from magical_baselines.checkpoints import (
    load_checkpoint,
    load_state,
    restoring,
    save_checkpoint,
    state_of,
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


def test_tensors_may_share_memory(tmp_path: Path) -> None:
    weights = torch.arange(6.0)
    save_checkpoint(tmp_path / "c", {"one": weights, "same": weights, "part": weights[2:4]})
    back = load_checkpoint(tmp_path / "c")
    assert torch.equal(back["one"], weights)
    assert torch.equal(back["same"], weights)
    assert torch.equal(back["part"], weights[2:4])


def test_missing_and_foreign_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "c"
    with pytest.raises(CheckpointError, match="expected a readable file, found No such file"):
        load_checkpoint(path)
    for damaged in (b"", b"\x80\x04K\x01."):
        path.write_bytes(damaged)
        with pytest.raises(CheckpointError, match=r"c is damaged"):
            load_checkpoint(path)


def test_a_checkpoint_is_a_safetensors_file(tmp_path: Path) -> None:
    weights = torch.rand(5)
    save_checkpoint(tmp_path / "c", {"policy": {"weight": weights}, "step": 3})
    with safe_open(tmp_path / "c", framework="pt") as file:
        assert torch.equal(file.get_tensor("/policy/weight"), weights)
    save_checkpoint(tmp_path / "c", {"step": 3})
    assert load_checkpoint(tmp_path / "c") == {"step": 3}


@given(data())
def test_damaged_bytes_are_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, draw: Any
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "c"
    save_checkpoint(path, {"a": {"weight": torch.ones(4, 3), "step": torch.tensor(5)}, "step": 3})
    raw = path.read_bytes()
    start, end = sorted(draw.draw(lists(integers(0, len(raw)), min_size=2, max_size=2)))
    path.write_bytes(raw[:start] + draw.draw(binary(max_size=40)) + raw[end:])
    with suppress(CheckpointError):
        load_checkpoint(path)


def test_an_older_checkpoint_stays_until_the_new_one_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise InterruptedError

    save_checkpoint(tmp_path / "c", {"step": 1})
    with monkeypatch.context() as patch, suppress(InterruptedError):
        patch.setattr(Path, "replace", fail)
        save_checkpoint(tmp_path / "c", {"step": 2})
    assert load_checkpoint(tmp_path / "c") == {"step": 1}
    save_checkpoint(tmp_path / "c", {"step": 3})
    assert load_checkpoint(tmp_path / "c") == {"step": 3}
    assert [file.name for file in tmp_path.iterdir()] == ["c"]


def test_weights_of_another_network_are_refused() -> None:
    with (
        pytest.raises(CheckpointError, match="run: the checkpoint is of another network"),
        restoring(Path("run")),
    ):
        nn.Linear(3, 2).load_state_dict(nn.Linear(4, 2).state_dict())


@pytest.mark.parametrize("kind", ["sgd", "adam"])
def test_optimisers_continue_bit_for_bit(kind: str, tmp_path: Path) -> None:
    def made() -> tuple[nn.Module, Optimizer]:
        torch.manual_seed(0)
        net = nn.Conv2d(3, 4, 3)
        net.to(memory_format=torch.channels_last)
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
            state = {"net": straight.state_dict(), "optimizer": state_of(optimizer)}
            save_checkpoint(tmp_path / "c", state)
    resumed, again = made()
    saved = load_checkpoint(tmp_path / "c")
    resumed.load_state_dict(saved["net"])
    load_state(again, saved["optimizer"])
    for number in range(3, 6):
        step(resumed, again, number)
    for a, b in zip(straight.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b)
        kept = again.state[b].get("momentum_buffer", again.state[b].get("exp_avg"))
        assert kept.stride() == b.stride()
