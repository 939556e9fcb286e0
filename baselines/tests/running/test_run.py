"""Runs of any algorithm: logging, checkpoints, facts; and configurations."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from magical.errors import DivergedError, InvalidConfigError, RunFolderError, UnknownNameError
from magical.runs import read_metrics
from magical.runs.folder import METRICS, opened_folder
from magical_baselines import Algorithm, algorithm_names, find_algorithm, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.bc import make_policy as bc_policy
from magical_baselines.config import CHECKPOINT_SECONDS, options
from magical_baselines.running.devices import restored_threads
from magical_baselines.running.run import Run

CONFIGURATION = BCConfig.preset("paper", tasks=("MoveToCorner",), demos="demos")


def opened(folder: Path, checkpoint_every: int = 100, **options: Any) -> Run:
    return Run(folder, CONFIGURATION.replace(checkpoint_every=checkpoint_every), **options)


def finish(run: Run, step: int, state: dict[str, Any] | None = None, **metrics: float) -> bool:
    """End a step; with a state, at the end of a part, so that it is saved."""
    last = state is not None
    return run.finish_step(step, lambda: metrics, lambda: state or {}, last=last)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    with opened_folder(path, CONFIGURATION.to_dict(), resume=False):
        return path


def test_metrics_after_the_checkpoint_are_dropped(folder: Path) -> None:
    with opened(folder) as run:
        finish(run, 1, {"a": torch.ones(2)}, loss=0.5)
        finish(run, 2, loss=0.25)
    with (folder / METRICS).open("a") as file:
        file.write('{"step": 3, "lo')
    assert [line["step"] for line in read_metrics(folder)] == [1, 2]
    with opened(folder) as run:
        assert run.step == 1
        assert run.saved is not None
        assert torch.equal(run.saved["a"], torch.ones(2))
    assert read_metrics(folder) == [{"step": 1, "loss": 0.5}]


def test_what_is_not_finite_is_logged_and_never_becomes_a_checkpoint(folder: Path) -> None:
    with opened(folder) as run:
        finish(run, 5, {"a": torch.ones(2)})
        for bad in ({"a": torch.tensor([1.0, math.inf])}, {"b": [{"c": math.nan}]}):
            with pytest.raises(DivergedError, match=r"at step 6 .*keeps the checkpoint of step 5"):
                finish(run, 6, bad)
        with pytest.raises(DivergedError, match="at step 7"):
            finish(run, 7, loss=math.nan)
    assert read_metrics(folder)[-1] == {"step": 7, "loss": None}
    with opened(folder) as run:
        assert run.step == 5


def test_facts_may_not_change(folder: Path) -> None:
    with opened(folder) as run:
        run.describe(demonstrations=["a", "b"])
    with opened(folder) as run:
        run.describe(demonstrations=["a", "b"])
        with pytest.raises(RunFolderError, match="other demonstrations; expected 'b', found 'c';"):
            run.describe(demonstrations=["a", "c"])


def test_precision_and_threads_are_chosen_once_and_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with restored_threads():
        with opened(folder) as run:
            chosen = run.compute("cpu", "auto", 0)
        assert chosen.threads == torch.get_num_threads()
        monkeypatch.setattr("magical_baselines.running.devices.has_bfloat16", lambda _: None)
        torch.set_num_threads(chosen.threads + 1)
        with opened(folder) as run:
            assert run.compute("cpu", "auto", 0) == chosen
        assert torch.get_num_threads() == chosen.threads


def test_checkpoints_are_due_by_number_or_by_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("magical_baselines.running.run.time.monotonic", lambda: now)
    saved = []
    with opened(folder, checkpoint_every=3) as run:
        for step in range(1, 8):
            finish(run, step)
            saved.append(run.step)
    assert saved == [0, 0, 3, 3, 3, 6, 6]
    with opened(folder, checkpoint_every=0) as run:
        finish(run, 7)
        assert run.step == 6
        now += CHECKPOINT_SECONDS
        finish(run, 8)
        finish(run, 9)
        assert run.step == 8


def test_checkpoints_that_take_long_are_saved_less_often(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("magical_baselines.running.run.time.monotonic", lambda: now)

    def state() -> dict[str, Any]:
        nonlocal now
        now += 6.0
        return {}

    with opened(folder, checkpoint_every=0) as run:
        now += CHECKPOINT_SECONDS
        run.finish_step(1, dict, state)
        now += 119.0
        run.finish_step(2, dict, state)
        assert run.step == 1
        now += 1.0
        run.finish_step(3, dict, state)
        assert run.step == 3


def test_metrics_are_logged_every_so_many_steps_and_at_the_last(folder: Path) -> None:
    with opened(folder) as run:
        for step in range(1, 6):
            run.finish_step(step, dict, dict, log_every=2, last=step == 5)
        assert run.step == 5
    assert [line["step"] for line in read_metrics(folder)] == [2, 4, 5]


def test_stop_after_counts_from_the_checkpoint(folder: Path) -> None:
    for steps in ((1, 2, 3), (4, 5, 6)):
        with opened(folder, stop_after=3) as run:
            assert [finish(run, step) for step in steps] == [False, False, True]
            assert run.step == steps[-1]


def test_configurations_are_checked() -> None:
    def made(**fields: object) -> BCConfig:
        return BCConfig.preset("quick", **{"tasks": "MoveToCorner", "demos": "d", **fields})

    assert made().tasks == ("MoveToCorner",)
    assert made().networks.network == "narrow"
    for name, value in (("batches", 0), ("learning_rate", -1.0), ("seed", -1), ("num_demos", 0)):
        with pytest.raises(InvalidConfigError, match=name):
            made(**{name: value})
    with pytest.raises(UnknownNameError, match="'odd'"):
        made(augment="odd")
    with pytest.raises(InvalidConfigError, match="each task once"):
        made(tasks=("MoveToCorner", "MoveToCorner"))
    with pytest.raises(UnknownNameError, match="preset 'slow'"):
        BCConfig.preset("slow", tasks=("MoveToCorner",), demos="d")
    for settings, message in (({}, "demos"), ({"demos": 5}, "demos: expected str, found 5")):
        with pytest.raises(InvalidConfigError, match=f"^configuration: .*{message}"):
            BCConfig.from_dict({"algorithm": "bc", "tasks": ["MoveToCorner"], **settings})
    with pytest.raises(
        InvalidConfigError, match="setting 'odd' is unknown; expected one of: tasks"
    ):
        BCConfig.from_dict({**made().to_dict(), "odd": 1})


def test_a_precision_that_an_algorithm_would_ignore_is_refused(folder: Path) -> None:
    config = CONFIGURATION.replace(precision="bfloat16", device="cuda")
    with (
        Run(folder, config) as run,
        pytest.raises(InvalidConfigError, match="device cuda and precision bfloat16: this algorit"),
    ):
        finish(run, 1)
    assert read_metrics(folder) == []
    with restored_threads(), Run(folder, config) as run:
        run.compute("cpu", "bfloat16", 1)
        finish(run, 1)


def test_threads_are_set_before_an_algorithm_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[int] = []
    own = Algorithm(BCConfig, lambda config, run: found.append(torch.get_num_threads()), bc_policy)
    monkeypatch.setattr("magical_baselines.running.training.find_algorithm", lambda name: own)
    before = torch.get_num_threads()
    for threads in (1, 3):
        train(CONFIGURATION.replace(threads=threads), tmp_path / str(threads))
    assert found == [1, 3]
    assert torch.get_num_threads() == before


def test_options_follow_the_fields() -> None:
    found = {option.flag: option for option in options(BCConfig)}
    assert found["--tasks"].several
    assert found["--tasks"].required
    assert found["--batch-size"].kind is int
    assert found["--learning-rate"].default == 1e-3
    assert found["--anneal"].kind is bool
    assert found["--optimizer"].choices == ("sgd", "adam")
    assert (found["--batch-size"].metavar, found["--learning-rate"].metavar) == ("N", "X")


def test_every_field_with_choices_accepts_these_alone() -> None:
    for option in options(BCConfig):
        for value in option.choices:
            fields: dict[str, Any] = {option.name: value, "augment": "none"}
            made = BCConfig.preset("paper", tasks=("MoveToCorner",), demos="d", **fields)
            assert made.to_dict()[option.name] == value
        if option.choices:
            with pytest.raises(UnknownNameError, match=f"{option.name} 'odd' is unknown"):
                BCConfig.preset("paper", tasks=("MoveToCorner",), demos="d", **{option.name: "odd"})


@pytest.mark.parametrize("name", algorithm_names())
def test_every_option_is_in_the_record_once_and_replaced_by_its_name(name: str) -> None:
    kind = find_algorithm(name).config
    names = [option.name for option in options(kind)]
    assert len(names) == len(set(names))
    config = kind.preset(
        "quick", tasks="MoveToRegion", **({"demos": "d"} if "demos" in names else {})
    )
    assert set(config.to_dict()) == {"algorithm", *names}
    assert kind.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert hash(config.replace(seed=1)) != hash(config)
    assert (
        config.replace(**{n: v for n, v in config.to_dict().items() if n != "algorithm"}) == config
    )


def test_learning_is_imported_without_pytorch() -> None:
    code = (
        "import sys, magical_baselines, magical_baselines.config, magical_baselines.networks; "
        "from magical.cli import build_parser; build_parser().format_help(); "
        "magical_baselines.algorithm_names(); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
