"""Recorded training steps: with a stand-in for CUDA, and on a GPU beside plain ones."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from magical.errors import DeviceError
from magical.learning import find_algorithm, train
from magical.learning.algorithms.bc import BCConfig
from magical.learning.running.checkpoints import load_optimizer, optimizer_state
from magical.learning.running.graphs import WARM_UP, GraphedStep, Recording, Step, use_graphs
from magical.learning.running.optimizers import make_adam, set_learning_rate
from magical.runs.metrics import read_metrics
from tests.learning.tiny_runs import tiny

ON_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


class Replay(Recording):
    """Stands in for CUDA: runs the step on the inputs' places, as a graph would."""

    made = 0

    def __init__(
        self, step: Step, inputs: Sequence[Tensor], generators: Sequence[torch.Generator]
    ) -> None:
        super().__init__(inputs)
        Replay.made += 1
        self._step = step

    def launch(self) -> None:
        self.outputs = self._step(*self._places)


def test_graphs_need_cuda(demos: Path, tmp_path: Path) -> None:
    assert not use_graphs("auto", "cpu")
    assert not use_graphs("off", "cpu")
    assert use_graphs("auto", "cuda")
    assert not use_graphs("off", "cuda")
    with pytest.raises(DeviceError, match=r"graphs: on needs a CUDA device.*the cpu; use auto"):
        train(tiny(BCConfig, demos=str(demos), graphs="on"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_step_is_recorded_once_for_each_shape_and_computes_the_same() -> None:
    Replay.made = 0
    seen: list[float] = []

    def step(a: Tensor, b: Tensor) -> tuple[Tensor]:
        seen.append(float(a.sum()))
        return (a * 2 + b,)

    graphed = GraphedStep(step, enabled=True, backend=Replay)
    for count in (4, 3):
        for i in range(WARM_UP + 3):
            a, b = torch.full((count,), float(i)), torch.arange(float(count))
            (out,) = graphed(a, b)
            assert torch.equal(out, a * 2 + b)
    assert Replay.made == 2
    assert len(seen) == 2 * (WARM_UP + 3)


def test_a_step_that_cannot_be_recorded_is_run_as_it_is() -> None:
    def unrecordable(*_: Any) -> Any:
        raise RuntimeError("operation not permitted when stream is capturing")

    graphed = GraphedStep(lambda a: (a * 2,), enabled=True, backend=unrecordable)
    for _ in range(WARM_UP):
        graphed(torch.ones(2))
    with pytest.warns(UserWarning, match="graphs: .* cannot be recorded .*: operation"):
        (out,) = graphed(torch.ones(2))
    assert out.tolist() == graphed(torch.ones(2))[0].tolist() == [2.0, 2.0]


def test_disabled_steps_are_plain_calls() -> None:
    graphed = GraphedStep(lambda a: (a,), enabled=False, backend=Replay)
    same = torch.ones(3)
    assert all(graphed(same)[0] is same for _ in range(WARM_UP + 2))


def test_an_input_that_stays_is_copied_again_only_after_a_change() -> None:
    recording = Replay(lambda a, b: (a + b,), [torch.zeros(2), torch.zeros(2)], [])
    stays, other = torch.ones(2), torch.ones(2)
    recording.replay([stays, other])
    recording._places[0].fill_(10.0)  # what a needless copy would overwrite
    (out,) = recording.replay([stays, torch.full((2,), 5.0)])
    assert out.tolist() == [15.0, 15.0]
    stays.add_(1.0)
    (out,) = recording.replay([stays, torch.full((2,), 5.0)])
    assert out.tolist() == [7.0, 7.0]


def test_learning_rates_stay_where_they_are() -> None:
    layer = torch.nn.Linear(2, 2)
    optimizer = make_adam(layer.parameters(), 0.1)
    rate = torch.tensor(0.1)
    optimizer.param_groups[0]["lr"] = rate  # as on a GPU
    set_learning_rate(optimizer, 0.05)
    assert optimizer.param_groups[0]["lr"] is rate
    assert float(rate) == pytest.approx(0.05)
    layer(torch.ones(1, 2)).sum().backward()
    optimizer.step()
    saved = optimizer_state(optimizer)
    assert saved["param_groups"][0]["lr"] == pytest.approx(0.05)
    set_learning_rate(optimizer, 0.01)
    load_optimizer(optimizer, saved)
    assert optimizer.param_groups[0]["lr"] is rate
    assert float(rate) == pytest.approx(0.05)


@ON_GPU
@pytest.mark.parametrize("algorithm", ["bc", "gail", "wgail-gp"])
def test_graphs_give_the_losses_of_plain_steps(algorithm: str, demos: Path, tmp_path: Path) -> None:
    """To rounding, which training enlarges: the first steps are compared."""
    sizes: Any = {"batches": 8, "log_every": 1} if algorithm == "bc" else {"total_steps": 8 * 6}
    losses = {}
    for graphs in ("off", "on"):
        kind = find_algorithm(algorithm).config
        config = tiny(kind, demos=str(demos), graphs=graphs, device="cuda", **sizes)
        train(config, tmp_path / graphs)
        name = "loss" if algorithm == "bc" else "discriminator_loss"
        losses[graphs] = [float(row[name]) for row in read_metrics(tmp_path / graphs)]
    assert losses["on"] == pytest.approx(losses["off"], rel=0.02, abs=1e-3)
