"""An algorithm, a network and an observation of a module that is not ours."""

import json
import sys

import pytest

from magical.cli import main
from magical.errors import PluginError, UnknownNameError
from magical.runs.folder import CONFIG
from magical_baselines import find_algorithm, read_config
from magical_baselines.networks import find_network

MODULE = '''
from dataclasses import dataclass
from types import SimpleNamespace

from torch import nn

from magical_baselines import Algorithm
from magical_baselines.algorithms.bc import BCConfig, make_policy, train
from magical_baselines.config import PositiveInt, option
from magical.observe import PixelSpec


@dataclass(frozen=True, kw_only=True)
class OwnConfig(BCConfig):
    """Behavioural cloning with a setting of its own."""

    algorithm: str = "own_learner:ALGORITHM"
    patience: PositiveInt = option(3, "how long")


ALGORITHM = Algorithm(OwnConfig, train, make_policy)
NETWORK = SimpleNamespace(
    HIDDEN=(8,), make_convolutions=lambda channels, batch_norm: nn.Conv2d(channels, 2, 8, 8)
)


class Own(PixelSpec):
    def to_dict(self):
        return "own_learner:OBSERVATION"


OBSERVATION = Own((("ego", 2),))
'''


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "own_learner.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path / "lib")
    monkeypatch.delitem(sys.modules, "own_learner", raising=False)
    return "own_learner"


SIZE = ["--batches", "4", "--batch-size", "2", "--num-demos", "1", "--threads", "1"]


def test_it_trains_resumes_and_is_evaluated_like_ours(module, demos, tmp_path, capsys):
    run = tmp_path / "run"
    command = ["train", f"{module}:ALGORITHM", "--out", str(run)]
    settings = ["--network", f"{module}:NETWORK", "--observation", f"{module}:OBSERVATION"]
    more = ["--task", "MoveToCorner", "--demos", str(demos), *settings, *SIZE, "--patience", "7"]
    assert main([*command, *more, "--stop-after", "2"]) == 0
    assert "--resume --import own_learner\n" in capsys.readouterr().err
    recorded = json.loads((run / CONFIG).read_text())
    assert {name: recorded[name] for name in ("algorithm", "network", "observation")} == {
        "algorithm": "own_learner:ALGORITHM",
        "network": "own_learner:NETWORK",
        "observation": "own_learner:OBSERVATION",
    }
    assert recorded["patience"] == 7
    assert main([*command, "--resume"]) == 0
    assert read_config(run).to_dict() == recorded
    rollouts = ["--task", "MoveToCorner", "--variants", "Demo", "--rollouts", "1"]
    assert main(["evaluate", str(run), *rollouts, "--workers", "0"]) == 0
    capsys.readouterr()
    assert main(["train", f"{module}:ALGORITHM", "--help"]) == 0
    assert "--patience N" in capsys.readouterr().out


def test_what_is_not_there_or_of_another_kind_is_named(module):
    with pytest.raises(PluginError, match=r"expected Algorithm, found SimpleNamespace"):
        find_algorithm(f"{module}:NETWORK")
    with pytest.raises(PluginError, match=r"no 'OTHER' in the module, which has: "):
        find_network(f"{module}:OTHER")
    with pytest.raises(
        UnknownNameError, match=r"algorithm 'own' is unknown; expected one of: act, al,"
    ):
        find_algorithm("own")
